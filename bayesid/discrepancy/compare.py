"""A model against a log: the efforts it cannot explain, the noise floor, and over which variable they show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.fit import inner_samples
from bayesid.model import Model
from bayesid.motion import Array, Mask, Motion
from bayesid.noise import Noise, residual_noise
from bayesid.segments import find_segments
from bayesid.signals import Signals
from bayesid.smoothing import sign_probabilities

GOOD = 0.2
"""An earlier model that left less than this share of a joint's effort tells the noise floor."""
_CLEARLY_MOVING = 2.5
"""Speed, in units of standstill, from which friction's direction is beyond doubt."""
_MOST, _PIECES, _SEAM = 10_000, 8, 10
"""Samples of a log that effects are chosen on, in so many stretches, and how many at their ends do not count."""
_ENCODER = 1e-3
"""rad; a joint that never leaves this range shows its encoder's noise."""
_BINS = 12
_LEAST = 1e-3
"""Of the earlier noise: no floor is lower."""
_SAME = 1e-3
"""Share of a joint's range within which a repeated motion comes back."""
_STILL = 1e-4
"""rad; a joint that stands still comes back within its encoder's noise."""
_SHORTEST = 1.0
"""s; a repeated motion lasts longer than this."""


@dataclass(frozen=True)
class Trial:
    """A log made ready for comparisons with models of its robot.

    Attributes:
        signals: N instants.
        actuators: the motion in actuator coordinates.
        used: (N, n) samples that count: measured, away from both ends, and clearly in motion: where dry friction is
            smoothed, the smoothing would look like an effect of its own.
        repeated: (n,) sd of the efforts between repetitions of the motion, N m, found before a log was shortened.
    """

    signals: Signals
    actuators: Motion
    used: Mask
    repeated: Array | None = None

    @property
    def magnitude(self) -> Array:
        """(N, n) absolute values of the unfiltered efforts, N m."""
        return np.abs(self.signals.raw_effort)

    def nearest(self, predicted: Array) -> Array:
        """(N, n) efforts, N m, with the sign of the prediction where they have none of their own."""
        signs = np.where(predicted >= 0.0, 1.0, -1.0)
        return np.where(self.signals.signed, self.signals.raw_effort, signs * self.magnitude)

    def probability(self, predicted: Array) -> Array:
        """(N, n) P(sign = +) of every sample under a prediction, N m."""
        residual = np.where(self.used, self.nearest(predicted) - predicted, 0.0)
        noise = residual_noise(residual, self.used, self.signals.rate)
        smoothed = sign_probabilities(self.magnitude, predicted, self.used, noise, self.signals.rate)
        return np.where(self.signals.signed, (self.signals.raw_effort >= 0.0).astype(float), smoothed)

    def gap(self, predicted: Array) -> Array:
        """(n,) RMS of what a prediction leaves of the efforts, N m; unknown signs as predicted (:eq:`gap`)."""
        used = self.used
        residual = np.where(used, self.nearest(predicted) - predicted, 0.0)
        return np.sqrt((residual**2).sum(axis=0) / np.maximum(used.sum(axis=0), 1))


def make_trial(model: Model, signals: Signals) -> Trial:
    """A log made ready for comparisons with a model of its robot."""
    actuators = model.robot.actuators(signals.motion)
    segments = find_segments(signals, actuators)
    moving = segments.per_sample(segments.moving, *signals.effort.shape) > 0
    moving &= np.abs(actuators.dq) > _CLEARLY_MOVING * actuators.standstill_speed
    moving &= np.ptp(actuators.q, axis=0) > _ENCODER
    return Trial(signals, actuators, moving & inner_samples(signals))


def shortened(trial: Trial) -> Trial:
    """The trial itself or, of a long log, stretches that stand for it: every effect costs as much as all samples."""
    count = len(trial.used)
    if count <= _MOST:
        return trial
    length = _MOST // _PIECES
    starts = np.linspace(0, count - length, _PIECES).astype(int)
    rows = np.concatenate([np.arange(start, start + length) for start in starts])
    seam = np.isin(np.arange(len(rows)) % length, np.arange(_SEAM)) | (np.arange(len(rows)) % length >= length - _SEAM)
    old = trial.signals
    signals = replace(
        old, motion=old.motion[rows], effort=old.effort[rows], raw_effort=old.raw_effort[rows],
        measured=old.measured[rows] & ~seam[:, None],
    )  # fmt: skip
    return Trial(signals, trial.actuators[rows], trial.used[rows] & ~seam[:, None], _between_periods(trial))


# ---------------------------------------------------------------------------------------------------------------
# The floor
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Floor:
    """The noise of the efforts: what no model can explain.

    Attributes:
        rms: (n,) N m.
        origin: (n,) where it was taken from.
        limits: (n, 2) largest white and coloured part of an error that is nothing but noise, N m.
        sharp: (n,) whether it holds what lasts of the noise too: a residual above it is a finding.
    """

    rms: Array
    origin: tuple[str, ...]
    limits: Array
    sharp: Mask


def noise_floor(trial: Trial, residual: Array, earlier: Noise, refit: Array | None = None) -> Floor:
    """The floor of each joint: from repeated periods, the earlier model's residual, a refit's, or its fast part.

    :eq:`noise-floor` where it is taken from differences.

    Args:
        trial: the log.
        residual: (N, n) of the best explanation so far, N m.
        earlier: noise of the log that the model was identified from.
        refit: (n,) RMS residual of a model with all standard effects, identified from this log by itself, N m.
    """
    repeated = _between_periods(trial) if trial.repeated is None else trial.repeated
    effort = np.sqrt((trial.magnitude**2 * trial.used).sum(axis=0) / np.maximum(trial.used.sum(axis=0), 1))
    good = earlier.sigma < GOOD * effort
    fast = np.maximum(_fast_part(residual, trial.used), _LEAST * earlier.sigma)
    white = np.where(good, np.maximum(earlier.white, np.minimum(fast, 1.5 * earlier.white)), fast)
    coloured = np.where(good, earlier.coloured, fast)
    blunt_rms = fast if refit is None else refit
    rms, origin = np.where(good, np.hypot(white, earlier.coloured), blunt_rms), list[str]()
    for j in range(len(rms)):
        if repeated is not None:
            origin.append("repeated periods")
        else:
            blunt = "fast part of the residual" if refit is None else "refit with standard effects"
            origin.append("earlier model's residual" if good[j] else blunt)
    if repeated is not None:
        rms, white = repeated, np.maximum(np.minimum(white, repeated), 0.3 * repeated)
    limits = np.stack([1.1 * np.maximum(white, rms / np.sqrt(2.0)), 1.25 * coloured + 0.1 * white], axis=1)
    sharp = good if repeated is None else np.ones(len(rms), dtype=bool)
    return Floor(rms, tuple(origin), limits, sharp)


def _fast_part(residual: Array, used: Mask) -> Array:
    """(n,) sd of what changes from sample to sample: the root of half the mean squared difference of neighbours."""
    pairs = used[1:] & used[:-1]
    square = (np.diff(residual, axis=0) ** 2 * pairs).sum(axis=0) / np.maximum(pairs.sum(axis=0), 1)
    return np.sqrt(0.5 * square)


def _between_periods(trial: Trial) -> Array | None:
    """(n,) sd of the efforts between repetitions of the same motion, N m; None where nothing is repeated."""
    q, count = trial.signals.motion.q, len(trial.signals.motion)
    tolerance = np.maximum(_SAME * np.ptp(q, axis=0), _STILL)
    shortest = int(_SHORTEST * trial.signals.rate)
    probe = np.abs(q[shortest : count // 2 + 1] - q[0]) < 5.0 * tolerance
    for lag in np.flatnonzero(probe.all(axis=1)) + shortest:
        if np.all(np.abs(q[lag:] - q[:-lag]).max(axis=0) < tolerance):
            both = trial.used[lag:] & trial.used[:-lag]
            square = (np.diff(np.stack([trial.magnitude[:-lag], trial.magnitude[lag:]]), axis=0)[0] ** 2 * both).sum(0)
            return np.sqrt(0.5 * square / np.maximum(both.sum(axis=0), 1))
    return None


# ---------------------------------------------------------------------------------------------------------------
# Where
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Excess:
    """Where a joint's residual exceeds the floor.

    Attributes:
        joint: from 1.
        excess: root of the residual's mean square above the floor's, N m (:eq:`excess`).
        variable: over which it shows best: velocity, position, acceleration, load or time.
        range: of the variable, where most of it lies; rad/s, rad, rad/s^2, N m or s.
    """

    joint: int
    excess: float
    variable: str
    range: tuple[float, float]


def where_it_shows(
    trial: Trial, residual: Array, predicted: Array, floor: Array, joints: Sequence[int]
) -> list[Excess]:
    """The variable that orders each joint's residual best: whose bins' means explain the largest share of it.

    Args:
        trial: the log.
        residual: (N, n) N m, zero where not used.
        predicted: (N, n) the model's effort, N m.
        floor: (n,) RMS of the noise, N m.
        joints: (0-based) to look at.
    """
    found = []
    for j in joints:
        used = trial.used[:, j]
        values = variables(trial, predicted, j)
        left = residual[used, j]
        shares = {name: _binned(value[used], left) for name, value in values.items()}
        best = max(shares, key=lambda name: shares[name][0])
        square = float(np.mean(left**2)) - floor[j] ** 2
        found.append(Excess(j + 1, float(np.sqrt(max(square, 0.0))), best, shares[best][1]))
    return found


def variables(trial: Trial, predicted: Array, joint: int) -> dict[str, Array]:
    """(N,) each of what a residual may depend on, of one joint."""
    motion = trial.actuators
    return {
        "velocity": motion.dq[:, joint],
        "position": motion.q[:, joint],
        "acceleration": motion.ddq[:, joint],
        "load": predicted[:, joint],
        "time": motion.t - motion.origin,
    }


def _binned(value: Array, residual: Array) -> tuple[float, tuple[float, float]]:
    """Share of the residual's variance between bins, and the range of bins that hold most of it."""
    edges = np.unique(np.quantile(value, np.linspace(0.0, 1.0, _BINS + 1)))
    if len(edges) < 3:
        return 0.0, (float(edges[0]), float(edges[-1]))
    place = np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2)
    count = np.maximum(np.bincount(place, minlength=len(edges) - 1), 1)
    mean = np.bincount(place, residual, len(edges) - 1) / count
    between = count * mean**2
    high = np.flatnonzero(between >= 0.25 * between.max())
    share = float(between.sum() / max(float(residual @ residual), 1e-300))
    return share, (float(edges[high[0]]), float(edges[high[-1] + 1]))
