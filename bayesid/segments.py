"""Segments: stretches of a joint's effort over which its sign does not change.

|effort| touches zero where the sign changes, but a filter rounds that cusp off and noise lifts it, and dry friction
lets the effort jump through zero between two samples where the joint's velocity reverses. So the cuts are generous:
every prominent minimum of the lightly filtered |effort|, every velocity reversal and every edge of a standstill. A cut
too many costs a binary unknown; a cut too few costs samples of the wrong sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from bayesid.motion import Array, Motion
from bayesid.signals import Signals, lowpass
from bayesid.terms import STANDSTILL

Integers = NDArray[np.int64]

_PROMINENCE = 0.02
_CEILING = 0.35
_LIGHT = 2.0


@dataclass(frozen=True)
class Segments:
    """S half-open ranges of samples, sorted by joint and start; together they cover every sample of every joint.

    Attributes:
        joint: (S,) 0-based actuator.
        start: (S,) first sample.
        end: (S,) sample after the last.
        known: (S,) +1 where the effort is signed already, 0 where the sign is to be found.
        moving: (S,) whether the actuator moves; a segment at standstill takes no part in the fit.
    """

    joint: Integers
    start: Integers
    end: Integers
    known: Integers
    moving: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.joint)

    def __getitem__(self, chosen: NDArray[np.bool_] | Integers) -> Segments:
        return Segments(
            self.joint[chosen], self.start[chosen], self.end[chosen], self.known[chosen], self.moving[chosen]
        )

    def split(self, cuts: list[tuple[int, int]]) -> Segments:
        """The segments cut once more before each given (joint, sample)."""
        rows = []
        for k in range(len(self)):
            inside = sorted(at for j, at in cuts if j == self.joint[k] and self.start[k] < at < self.end[k])
            edges = [int(self.start[k]), *inside, int(self.end[k])]
            rows += [(self.joint[k], a, b, self.known[k], self.moving[k]) for a, b in zip(edges, edges[1:], strict=False)]
        return _from_rows(rows)

    def per_sample(self, values: Array, n_samples: int, n_joints: int) -> Array:
        """(N, n) the segments' values (S,) laid out over the samples."""
        laid = np.zeros((n_samples, n_joints))
        for j, a, b, value in zip(self.joint, self.start, self.end, values, strict=True):
            laid[a:b, j] = value
        return laid


def find_segments(signals: Signals, actuators: Motion) -> Segments:
    """Cuts every joint's effort into segments.

    Args:
        signals: the filtered log.
        actuators: its motion in actuator coordinates.
    """
    n_samples = len(actuators)
    light = lowpass(signals.raw_effort, min(_LIGHT * signals.cutoff, 0.45 * signals.rate), signals.rate)
    rows = []
    for j in range(actuators.n_joints):
        speed = actuators.dq[:, j]
        moving = np.abs(speed) > STANDSTILL * np.abs(speed).max()
        edges = set(np.flatnonzero(np.diff(moving)) + 1)
        if not signals.signed[j]:
            edges |= _reversals(speed) | _minima(light[:, j])
        bounds = sorted({0, n_samples} | edges)
        known = int(signals.signed[j])
        rows += [(j, a, b, known, bool(moving[a])) for a, b in zip(bounds, bounds[1:], strict=False)]
    return _from_rows(rows)


def _from_rows(rows: list[tuple[int, int, int, int, bool]]) -> Segments:
    joint, start, end, known, moving = (np.array(column) for column in zip(*rows, strict=True))
    return Segments(*(a.astype(np.int64) for a in (joint, start, end, known)), moving.astype(bool))


def _reversals(speed: Array) -> set[int]:
    """Samples at which the velocity has changed its sign."""
    sign = np.sign(speed)
    return {int(i) for i in np.flatnonzero(sign[1:] * sign[:-1] < 0) + 1}


def _minima(magnitude: Array) -> set[int]:
    """Prominent low minima of |effort|."""
    scale = np.percentile(magnitude, 99)
    found, _ = find_peaks(-magnitude, prominence=_PROMINENCE * scale, height=-_CEILING * scale)
    return {int(i) for i in found}
