"""A model against a log: the efforts it cannot explain, the noise floor, and over which variable they show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects.model import Model
from bayesid.log.segments import find_segments
from bayesid.log.signals import Signals
from bayesid.motion import Motion
from bayesid.regression.noise import Noise, residual_noise
from bayesid.regression.selection.explanation import Thresholds
from bayesid.signs.smoothing import sign_probabilities

ENCODER_RANGE = 1e-3
"""rad; a joint that never leaves this range stands still but for its encoder's noise."""
_LONG, _STRETCHES = 10_000, 8
"""Samples of a log that effects are selected on, in so many stretches: time grows with them. Round numbers."""
_SEAM = 10
"""Samples at the ends of a stretch that do not count, for filters and hysteresis see across: a round number."""
_LEAST_FLOOR = 1e-3
"""Share of the earlier noise below which no floor is: a guard against residuals that are nothing but zeros."""
_REPEATED = 1e-3
"""Share of a joint's range within which a repeated motion comes back; a round number, not studied."""
_REPEATED_STILL = 1e-4
"""rad; a joint that stands still comes back within its encoder's noise."""
_PROBED = 5.0
"""Times the tolerance within which the first sample must come back before all others are compared: it saves time."""
_SHORTEST_PERIOD = 1.0
"""s; a repeated motion lasts longer than this: whatever is shorter is a pause."""
REPEATED, MODELS_RESIDUAL = "repeated periods", "earlier model's residual"
REFIT, FAST_PART = "refit with standard effects", "fast part of the residual"
SMOOTHED = "fast part of the residual of a log that was low-passed"
"""Where a noise floor is taken from."""
_SMOOTH = 1.5
"""Exponent of the lag by which squared differences grow, from which on something is smoother than model errors are: 0
for white noise, 1 for a random walk, 2 for what has passed a low-pass and is looked at more finely than that."""
_LONGEST_LAG = 0.1
"""s; what changes more slowly is model error, however smooth: friction turns round within a tenth of a second."""
_BINS = 12
"""Of a variable, with equally many samples each; a round number, for display."""
_MOST_SHARE = 0.25
"""Of the largest bin's share, from which on a bin belongs to the range that is shown; for display."""
_TINY = 1e-300
"""Guard of a division."""


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
        return self.signals.magnitude

    def nearest(self, predicted: Array) -> Array:
        """(N, n) efforts, N m, with the sign of the prediction where they have none of their own."""
        return self.signals.nearest(predicted)

    def probability(self, predicted: Array) -> Array:
        """(N, n) P(sign = +) of every sample under a prediction, N m."""
        noise = residual_noise(self.residual(predicted), self.used, self.signals.rate)
        return sign_probabilities(self.signals, predicted, self.used, noise)

    def residual(self, predicted: Array) -> Array:
        """(N, n) what a prediction leaves of the efforts, N m, unknown signs as predicted; zero where not used."""
        return np.where(self.used, self.nearest(predicted) - predicted, 0.0)

    def rms(self, values: Array) -> Array:
        """(n,) of values (N, n) over the used samples."""
        return np.sqrt((values**2 * self.used).sum(axis=0) / np.maximum(self.used.sum(axis=0), 1))

    def gap(self, predicted: Array) -> Array:
        """(n,) RMS of what a prediction leaves of the efforts, N m; unknown signs as predicted (:eq:`gap`)."""
        return self.rms(self.residual(predicted))


def make_trial(model: Model, signals: Signals, thresholds: Thresholds = Thresholds()) -> Trial:
    """A log made ready for comparisons with a model of its robot."""
    actuators = model.robot.actuators(signals.motion)
    segments = find_segments(signals, actuators)
    moving = segments.per_sample(segments.moving, *signals.effort.shape) > 0
    moving &= np.abs(actuators.dq) > thresholds.clearly_moving * actuators.standstill_speed
    moving &= np.ptp(actuators.q, axis=0) > ENCODER_RANGE
    return Trial(signals, actuators, moving & signals.inner)


def shortened(trial: Trial) -> Trial:
    """The trial itself or, of a long log, stretches that stand for it: every effect costs as much as all samples."""
    count = len(trial.used)
    if count <= _LONG:
        return trial
    length = _LONG // _STRETCHES
    starts = np.linspace(0, count - length, _STRETCHES).astype(int)
    rows = np.concatenate([np.arange(start, start + length) for start in starts])
    place = np.arange(len(rows)) % length
    inner = ((place >= _SEAM) & (place < length - _SEAM))[:, None]
    whole = trial.signals
    signals = replace(
        whole,
        motion=whole.motion[rows],
        effort=whole.effort[rows],
        raw_effort=whole.raw_effort[rows],
        measured=whole.measured[rows] & inner,
    )
    return Trial(signals, trial.actuators[rows], trial.used[rows] & inner, _between_periods(trial))


# ---------------------------------------------------------------------------------------------------------------
# The floor
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class NoiseFloor:
    """The noise of the efforts: what no model can explain.

    Attributes:
        rms: (n,) N m.
        origin: (n,) where it was taken from.
        limits: (n, 2) largest white and coloured part of an error that is nothing but noise, N m.
        sharp: (n,) whether it holds what lasts of the noise too: a residual above it is a finding.
        white: (n,) the part of it that changes from sample to sample, N m.
        lasting: (n,) whether it is a model's residual most of which lasts: the model's own error, or noise that a
            filter has smoothed; what is below such a floor may still be wrong.
    """

    rms: Array
    origin: tuple[str, ...]
    limits: Array
    sharp: Mask
    white: Array
    lasting: Mask

    def exceeded(self, gap: Array, thresholds: Thresholds) -> Mask:
        """(n,) whether a gap, N m, is too large for the noise of a joint."""
        return gap > np.where(self.sharp, thresholds.above_floor, thresholds.above_blunt_floor) * self.rms


def noise_floor(
    trial: Trial, residual: Array, earlier: Noise, refit: Array | None = None, thresholds: Thresholds = Thresholds()
) -> NoiseFloor:
    """The floor of each joint: from repeated periods, the earlier model's residual, a refit's, or its fast part.

    :eq:`noise-floor` where it is taken from differences.

    Args:
        trial: the log.
        residual: (N, n) of the best explanation so far, N m.
        earlier: noise of the log that the model was identified from.
        refit: (n,) RMS residual of a model with all standard effects, identified from this log by itself, N m.
        thresholds: that decide.
    """
    repeated = _between_periods(trial) if trial.repeated is None else trial.repeated
    sharp = earlier.sigma < thresholds.good_fit * trial.rms(trial.magnitude)
    lag = _lag_of_noise(residual, trial.used, trial.signals.rate)
    fast = np.maximum(np.sqrt(_half_square(residual, trial.used, lag)), _LEAST_FLOOR * earlier.sigma)
    largest = thresholds.white_growth * earlier.white
    white = np.where(sharp, np.maximum(earlier.white, np.minimum(fast, largest)), fast)
    coloured = np.where(sharp, earlier.coloured, fast)
    rms = np.where(sharp, np.hypot(white, earlier.coloured), fast if refit is None else refit)
    blunt = REFIT if refit is not None else FAST_PART if lag == 1 else SMOOTHED
    origin = tuple(MODELS_RESIDUAL if good else blunt for good in sharp)
    lasting = rms > thresholds.above_floor * white  # over the white noise alone it would be a finding itself
    if repeated is not None:
        rms, white = repeated, np.maximum(np.minimum(white, repeated), thresholds.repeated_white * repeated)
        origin, sharp = (REPEATED,) * len(rms), np.ones(len(rms), dtype=bool)
        lasting = ~sharp  # a model has no part in it
    white_limit = thresholds.white_limit * np.maximum(white, rms / np.sqrt(2.0))
    coloured_limit = thresholds.coloured_limit * coloured + thresholds.coloured_allowance * white
    limits = np.stack([white_limit, coloured_limit], axis=1)
    return NoiseFloor(rms, origin, limits, sharp, np.minimum(white, rms), lasting)


def _lag_of_noise(residual: Array, used: Mask, rate: float) -> int:
    """Samples over which noise changes: 1, but more where somebody has low-passed the log.

    There neighbours differ by what the filter has left, a small part of the noise. Whatever is smooth at a lag, as by
    the exponent of its squared differences, is looked at over a longer one. They are told by their medians, for where a
    hidden sign is taken for the other one the residual jumps; a filter is one for all joints.
    """
    lag = 1
    while lag < int(_LONGEST_LAG * rate):
        near, far = _typical_square(residual, used, lag), _typical_square(residual, used, 2 * lag)
        moved = near > 0.0
        if not moved.any() or np.median(np.log2(np.maximum(far[moved], _TINY) / near[moved])) <= _SMOOTH:
            break
        lag += 1
    return lag


def _typical_square(residual: Array, used: Mask, lag: int) -> Array:
    """(n,) median squared difference of samples so far apart, (N m)^2; 0 where there are none."""
    squares, pairs = (residual[lag:] - residual[:-lag]) ** 2, used[lag:] & used[:-lag]
    return np.array(
        [np.median(square[pair]) if pair.any() else 0.0 for square, pair in zip(squares.T, pairs.T, strict=True)]
    )


def _half_square(residual: Array, used: Mask, lag: int) -> Array:
    """(n,) half the mean squared difference of samples so far apart, (N m)^2: the variance of white noise."""
    pairs = used[lag:] & used[:-lag]
    square = ((residual[lag:] - residual[:-lag]) ** 2 * pairs).sum(axis=0)
    half: Array = 0.5 * square / np.maximum(pairs.sum(axis=0), 1)
    return half


def _between_periods(trial: Trial) -> Array | None:
    """(n,) sd of the efforts between repetitions of the same motion, N m; None where nothing is repeated."""
    q, count = trial.signals.motion.q, len(trial.signals.motion)
    tolerance = np.maximum(_REPEATED * np.ptp(q, axis=0), _REPEATED_STILL)
    shortest = int(_SHORTEST_PERIOD * trial.signals.rate)
    probe = np.abs(q[shortest : count // 2 + 1] - q[0]) < _PROBED * tolerance
    for lag in np.flatnonzero(probe.all(axis=1)) + shortest:
        if np.all(np.abs(q[lag:] - q[:-lag]).max(axis=0) < tolerance):
            both = trial.used[lag:] & trial.used[:-lag]
            square = ((trial.magnitude[lag:] - trial.magnitude[:-lag]) ** 2 * both).sum(axis=0)
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
    excesses = []
    for j in joints:
        used = trial.used[:, j]
        rest = residual[used, j]
        shares = {name: _binned(value[used], rest) for name, value in variables(trial, predicted, j).items()}
        best = max(shares, key=lambda name: shares[name][0])
        square = float(np.mean(rest**2)) - floor[j] ** 2
        excesses.append(Excess(j + 1, float(np.sqrt(max(square, 0.0))), best, shares[best][1]))
    return excesses


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
    high = np.flatnonzero(between >= _MOST_SHARE * between.max())
    share = float(between.sum() / max(float(residual @ residual), _TINY))
    return share, (float(edges[high[0]]), float(edges[high[-1] + 1]))
