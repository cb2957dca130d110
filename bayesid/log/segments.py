"""Segments: stretches of a joint's effort with one sign.

|effort| touches zero where the sign changes, but filters round this cusp and noise lifts it. Dry friction lets the
effort jump through zero between two samples where the velocity reverses. So cuts are generous: every prominent minimum
of the lightly filtered |effort|; every upward jump of its slope that is not a minimum (a fast crossing between unequal
efforts); every velocity reversal; every jump of the acceleration; every edge of a standstill or pause. An extra cut
costs one binary unknown; a missing cut gives samples the wrong sign.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from itertools import pairwise

import numpy as np
import scipy

from bayesid.arrays import Array, Integers, Mask
from bayesid.errors import InputError
from bayesid.log.signals import Signals
from bayesid.log.tuning import TUNING
from bayesid.motion import Motion


@dataclass(frozen=True)
class Segmentation:
    """Thresholds of the segmentation, as shares of the 99th percentile of the filtered |effort|.

    Attributes:
        prominence: depth of a minimum below its surroundings that makes it a cut.
        threshold: samples below it take no part in search and fit, as in the paper; 0 keeps all. Their signs follow
            from the identified model.

    Raises:
        InputError: a threshold is outside its range.
    """

    prominence: float = 0.02
    threshold: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.prominence < 1.0:
            remedy = "give a number between 0 and 1"
            raise InputError(f"{self.prominence:g} is out of range", field="prominence", remedy=remedy)
        if not 0.0 <= self.threshold < 1.0:
            remedy = "give 0, or a number below 1"
            raise InputError(f"{self.threshold:g} is out of range", field="threshold", remedy=remedy)


USUAL = Segmentation()


@dataclass(frozen=True)
class Segments:
    """S half-open ranges of samples, sorted by joint and start; together they cover every sample of every joint."""

    joint: Integers  #: (S,) 0-based actuator
    start: Integers  #: (S,) first sample
    end: Integers  #: (S,) sample after the last
    known: Integers  #: (S,) +1 if the effort is signed, 0 if the sign is unknown
    moving: Mask  #: (S,) whether the actuator moves
    #: (S,) whether the segment takes part in search and fit: by default if moving. One with small effort may be left
    #: out
    fitted: Mask = field(default_factory=lambda: np.empty(0, dtype=bool))

    def __post_init__(self) -> None:
        if not self.fitted.size:
            object.__setattr__(self, "fitted", self.moving)

    def __len__(self) -> int:
        return len(self.joint)

    def __getitem__(self, chosen: Mask | Integers) -> Segments:
        return Segments(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def split(self, cuts: list[tuple[int, int]]) -> Segments:
        """The segments cut at each given (joint, sample)."""
        rows = []
        for k in range(len(self)):
            inside = sorted({at for j, at in cuts if j == self.joint[k] and self.start[k] < at < self.end[k]})
            edges = [int(self.start[k]), *inside, int(self.end[k])]
            rows += [(self.joint[k], a, b, self.known[k], self.moving[k], self.fitted[k]) for a, b in pairwise(edges)]
        return _from_rows(rows)

    def sums(self, values: Array) -> Array:
        """(S,) sums of sample values (N, n)."""
        summed = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
        total: Array = summed[self.end, self.joint] - summed[self.start, self.joint]
        return total

    def per_sample(self, values: Array | Integers | Mask, n_samples: int, n_joints: int) -> Array:
        """(N, n) segment values (S,) at each sample."""
        laid = np.zeros((n_samples, n_joints))
        for j, a, b, value in zip(self.joint, self.start, self.end, values, strict=True):
            laid[a:b, j] = value
        return laid


def find_segments(signals: Signals, actuators: Motion, segmentation: Segmentation = USUAL) -> Segments:
    """Cuts the efforts of a filtered log into segments; the motion is in actuator coordinates."""
    n_samples = len(actuators)
    half_period = max(1, round(signals.rate / (2.0 * signals.effort_cutoff)))
    rows = []
    for j in range(actuators.n_joints):
        speed = actuators.dq[:, j]
        moving = signals.measured[:, j] & (np.abs(speed) > actuators.standstill_speed[j])
        edges, fitted, effort = _changes(moving), moving, signals.effort[:, j]
        if not signals.signed[j]:
            cuts = (
                _reversals(speed) | _minima(effort, segmentation.prominence) | _jerks(actuators.ddq[:, j], half_period)
            )
            edges |= cuts | _slope_jumps(effort, half_period, edges | cuts)
            fitted = moving & (np.abs(effort) >= segmentation.threshold * np.percentile(effort, 99))
            edges |= _changes(fitted)  # last: these are not sign changes and must not replace one
        bounds = sorted({0, n_samples} | edges)
        known = int(signals.signed[j])
        rows += [(j, a, b, known, bool(moving[a]), bool(fitted[a])) for a, b in pairwise(bounds)]
    return _from_rows(rows)


def _from_rows(rows: list[tuple[int, int, int, int, bool, bool]]) -> Segments:
    joint, start, end, known, moving, fitted = np.array(rows, dtype=np.int64).T
    return Segments(joint, start, end, known, moving.astype(bool), fitted.astype(bool))


def _changes(state: Mask) -> set[int]:
    return set((np.flatnonzero(np.diff(state)) + 1).tolist())


def _reversals(speed: Array) -> set[int]:
    return set((np.flatnonzero(np.sign(speed[1:]) * np.sign(speed[:-1]) < 0) + 1).tolist())


def _jerks(acceleration: Array, span: int) -> set[int]:
    """Samples at which the acceleration jumps (trapezoidal speeds); inertia lets the effort jump through zero there."""
    scale = np.percentile(np.abs(acceleration), 99)
    jump = np.zeros_like(acceleration)
    jump[span:-span] = np.abs(acceleration[2 * span :] - acceleration[: -2 * span])
    return _peaks(jump, height=TUNING.acceleration_jump * scale, distance=2 * span)


def _minima(magnitude: Array, prominence: float) -> set[int]:
    scale = np.percentile(magnitude, 99)
    return _peaks(-magnitude, prominence=prominence * scale, height=-TUNING.zero_ceiling * scale)


def _slope_jumps(magnitude: Array, span: int, known: set[int]) -> set[int]:
    """Low samples at which the slope jumps upwards, more than `span` from every known cut."""
    scale = np.percentile(magnitude, 99)
    jump = np.zeros_like(magnitude)
    jump[span:-span] = magnitude[2 * span :] - 2.0 * magnitude[span:-span] + magnitude[: -2 * span]
    low = np.where(magnitude < TUNING.zero_ceiling * scale, jump, 0.0)
    peaks = _peaks(low, height=TUNING.slope_jump * scale, distance=span)
    places = np.array(sorted(known))
    return {i for i in peaks if not places.size or np.abs(places - i).min() > span}


def _peaks(values: Array, **at_least: float) -> set[int]:
    return set(scipy.signal.find_peaks(values, **at_least)[0].tolist())
