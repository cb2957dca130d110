"""Data of a comparison of a model with a log: selection data, held-back data, and the noise floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.discrepancy.tuning import TUNING
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.model import Model
from bayesid.log.log import Log
from bayesid.log.segments import find_segments
from bayesid.log.signals import Signals, prepare
from bayesid.motion import Motion
from bayesid.regression.knowledge import CoefficientPrior, KinematicTolerance
from bayesid.regression.least_squares import fit_signed
from bayesid.regression.log_data import LogData
from bayesid.regression.noise import Noise, residual_noise
from bayesid.regression.selection.columns import Columns, blocks_of
from bayesid.regression.selection.cross_validation import CrossValidation
from bayesid.regression.selection.fitted_effects import LN10, FittedEffects, Observations, Thresholds
from bayesid.regression.selection.modelled_log import Extension, ModelledLog
from bayesid.regression.tuning import TUNING as REGRESSION
from bayesid.signs.averaging import with_standard_terms
from bayesid.signs.search.protocol import Search
from bayesid.signs.sign_solution import SignSolution, find_signs, restored
from bayesid.signs.smoothing import sign_probabilities

REPEATED, MODELS_RESIDUAL = "repeated periods", "earlier model's residual"
REFIT, FAST_PART = "refit with standard effects", "fast part of the residual"
SMOOTHED = "fast part of the residual of a log that was low-passed"
"""Sources of a noise floor."""


@dataclass(frozen=True)
class Trial:
    """A log prepared for comparisons with models of its robot."""

    signals: Signals  #: N samples
    actuators: Motion  #: the motion in actuator coordinates
    #: (N, n) samples that count: measured, away from both ends, and clearly in motion, as the smoothing of dry friction
    #: at low speed would look like an effect
    used: Mask
    whole: Trial | None = None  #: the whole trial, if this one is shortened

    @property
    def magnitude(self) -> Array:
        """(N, n) absolute values of the unfiltered efforts, N m."""
        return self.signals.magnitude

    def nearest(self, predicted: Array) -> Array:
        """(N, n) efforts, N m, unsigned ones with the sign of the prediction."""
        return self.signals.nearest(predicted)

    def probability(self, predicted: Array) -> Array:
        """(N, n) P(sign = +) of every sample under a prediction, N m."""
        noise = residual_noise(self.residual(predicted), self.used, self.signals.rate)
        return sign_probabilities(self.signals, predicted, self.used, noise)

    def residual(self, predicted: Array) -> Array:
        """(N, n) efforts minus prediction, N m, unknown signs as predicted; zero where not used."""
        return np.where(self.used, self.nearest(predicted) - predicted, 0.0)

    def rms(self, values: Array) -> Array:
        """(n,) RMS of values (N, n) over the used samples."""
        return np.sqrt((values**2 * self.used).sum(axis=0) / np.maximum(self.used.sum(axis=0), 1))

    def gap(self, predicted: Array) -> Array:
        """(n,) RMS residual of a prediction, N m; unknown signs as predicted (:eq:`gap`)."""
        return self.rms(self.residual(predicted))

    @cached_property
    def between_periods(self) -> Array | None:
        """(n,) sd of the efforts between repetitions of the same motion, N m; None without repetitions."""
        if self.whole is not None:
            return self.whole.between_periods
        q, count = self.signals.motion.q, len(self.signals.motion)
        tolerance = np.maximum(TUNING.repeated * np.ptp(q, axis=0), TUNING.repeated_still)
        shortest = int(TUNING.shortest_period * self.signals.rate)
        near = np.abs(q[shortest : count // 2 + 1] - q[0]) < TUNING.first_sample * tolerance
        for lag in (np.flatnonzero(near.all(axis=1)) + shortest).tolist():
            if np.all(np.abs(q[lag:] - q[:-lag]).max(axis=0) < tolerance):
                return np.sqrt(_half_square(self.magnitude, self.used, lag))
        return None


def make_trial(model: Model, signals: Signals) -> Trial:
    """Prepares a log for comparisons with a model of its robot."""
    actuators = model.robot.actuators(signals.motion)
    segments = find_segments(signals, actuators)
    moving = segments.per_sample(segments.moving, *signals.effort.shape) > 0
    moving &= np.abs(actuators.dq) > TUNING.clearly_moving * actuators.standstill_speed
    moving &= np.ptp(actuators.q, axis=0) > TUNING.encoder_range
    return Trial(signals, actuators, moving & signals.inner)


def shortened(trial: Trial) -> Trial:
    """The trial, or stretches of a long one, as computing time is proportional to its samples."""
    count = len(trial.used)
    if count <= TUNING.longest:
        return trial
    length = TUNING.longest // TUNING.stretches
    starts = np.linspace(0, count - length, TUNING.stretches).astype(int)
    rows = np.concatenate([np.arange(start, start + length) for start in starts])
    place = np.arange(len(rows)) % length
    inner = ((place >= TUNING.seam) & (place < length - TUNING.seam))[:, None]
    whole = trial.signals
    signals = replace(
        whole,
        motion=whole.motion[rows],
        effort=whole.effort[rows],
        raw_effort=whole.raw_effort[rows],
        measured=whole.measured[rows] & inner,
    )
    return Trial(signals, trial.actuators[rows], trial.used[rows] & inner, trial)


# ---- The floor ----
@dataclass(frozen=True)
class NoiseFloor:
    """The part of the residual that no model can explain."""

    rms: Array  #: (n,) N m
    origin: tuple[str, ...]  #: (n,) source
    limits: Array  #: (n, 2) largest white and coloured part of noise, N m
    reliable: Mask  #: (n,) whether it includes coloured noise, so that a residual above it is significant
    white: Array  #: (n,) its white part, N m
    #: (n,) whether coloured residual of a model dominates it: model error or filtered noise, which may hide an effect
    mostly_coloured: Mask

    def exceeded(self, gap: Array) -> Mask:
        """(n,) whether a gap, N m, exceeds the noise of a joint."""
        return gap > np.where(self.reliable, REGRESSION.above_floor, REGRESSION.above_unreliable_floor) * self.rms


def noise_floor(trial: Trial, residual: Array, earlier: Noise, refit: Array | None = None) -> NoiseFloor:
    """The floor of each joint: from repeated periods, the earlier model's residual, a refit, or fast residuals.

    From differences by :eq:`noise-floor`. All in N m.

    Args:
        trial: the log.
        residual: (N, n) of the best explanation so far.
        earlier: noise of the log that the model was identified from.
        refit: (n,) RMS residual of a model with all standard effects, identified from this log alone.
    """
    repeated = trial.between_periods
    reliable = earlier.sigma < TUNING.good_fit * trial.rms(trial.magnitude)
    lag = _lag_of_noise(residual, trial.used, trial.signals.rate)
    fast = np.maximum(np.sqrt(_half_square(residual, trial.used, lag)), TUNING.least_floor * earlier.sigma)
    largest = TUNING.white_growth * earlier.white
    white = np.where(reliable, np.maximum(earlier.white, np.minimum(fast, largest)), fast)
    coloured = np.where(reliable, earlier.coloured, fast)
    rms = np.where(reliable, np.hypot(white, earlier.coloured), fast if refit is None else refit)
    unreliable = REFIT if refit is not None else FAST_PART if lag == 1 else SMOOTHED
    origin = tuple(MODELS_RESIDUAL if good else unreliable for good in reliable)
    mostly_coloured = rms > REGRESSION.above_floor * white  # significantly above the white noise
    if repeated is not None:
        rms, white = repeated, np.maximum(np.minimum(white, repeated), TUNING.repeated_white * repeated)
        origin, reliable = (REPEATED,) * len(rms), np.ones(len(rms), dtype=bool)
        mostly_coloured = ~reliable  # measured without a model
    white_limit = TUNING.white_limit * np.maximum(white, rms / np.sqrt(2.0))
    coloured_limit = TUNING.coloured_limit * coloured + TUNING.coloured_allowance * white
    limits = np.stack([white_limit, coloured_limit], axis=1)
    return NoiseFloor(rms, origin, limits, reliable, np.minimum(white, rms), mostly_coloured)


def _lag_of_noise(residual: Array, used: Mask, rate: float) -> int:
    """Lag at which noise is uncorrelated: 1 sample, more if the log was low-passed.

    The lag grows while the squared differences grow with an exponent above `Tuning.smooth`. Medians are used, as wrong
    signs make the residual jump; the filter is assumed to be the same for all joints.
    """
    lag = 1
    while lag < int(TUNING.longest_lag * rate):
        near, far = _typical_square(residual, used, lag), _typical_square(residual, used, 2 * lag)
        nonzero = near > 0.0
        if not nonzero.any() or np.median(np.log2(np.maximum(far[nonzero], 1e-300) / near[nonzero])) <= TUNING.smooth:
            break
        lag += 1
    return lag


def _typical_square(residual: Array, used: Mask, lag: int) -> Array:
    """(n,) median squared difference of samples at a lag, (N m)^2; 0 without samples."""
    squares, pairs = (residual[lag:] - residual[:-lag]) ** 2, used[lag:] & used[:-lag]
    return np.array(
        [np.median(square[pair]) if pair.any() else 0.0 for square, pair in zip(squares.T, pairs.T, strict=True)]
    )


def _half_square(residual: Array, used: Mask, lag: int) -> Array:
    """(n,) half the mean squared difference of samples at a lag, (N m)^2: the variance of white noise."""
    return repetition_sd(residual[lag:], residual[:-lag], used[lag:] & used[:-lag]) ** 2


def repetition_sd(values: Array, again: Array, used: Mask) -> Array:
    """(n,) sd of values (N, n) from their differences to repeated measurements (N, n), over used samples."""
    square = ((values - again) ** 2 * used).sum(axis=0)
    return np.sqrt(0.5 * square / np.maximum(used.sum(axis=0), 1))


# ---- The residual above the floor ----
@dataclass(frozen=True)
class Excess:
    """Where a joint's residual exceeds the floor."""

    joint: int  #: from 1
    excess: float  #: root of the residual's mean square above the floor's, N m (:eq:`excess`)
    variable: str  #: that explains most of it: velocity, position, acceleration, load or time
    range: tuple[float, float]  #: of the variable, with most of it; rad/s, rad, rad/s^2, N m or s


def where_it_shows(
    trial: Trial, residual: Array, predicted: Array, floor: Array, joints: Sequence[int]
) -> list[Excess]:
    """The variable that explains most of each (0-based) joint's residual, by its means in bins of the variable.

    Args:
        trial: the log.
        residual: (N, n) N m, zero where not used.
        predicted: (N, n) a model's effort, N m.
        floor: (n,) noise floor, N m.
        joints: joints (from 0).
    """
    excesses = []
    for j in joints:
        used = trial.used[:, j]
        of_joint = residual[used, j]
        shares = {name: _binned(value[used], of_joint) for name, value in variables(trial, predicted, j).items()}
        best = max(shares, key=lambda name: shares[name][0])
        square = float(np.mean(of_joint**2)) - floor[j] ** 2
        excesses.append(Excess(j + 1, float(np.sqrt(max(square, 0.0))), best, shares[best][1]))
    return excesses


def variables(trial: Trial, predicted: Array, joint: int) -> dict[str, Array]:
    """(N,) variables of one joint that its residual may depend on."""
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
    edges = np.unique(np.quantile(value, np.linspace(0.0, 1.0, TUNING.bins + 1)))
    if len(edges) < 3:
        return 0.0, (float(edges[0]), float(edges[-1]))
    place = np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2)
    count = np.maximum(np.bincount(place, minlength=len(edges) - 1), 1)
    mean = np.bincount(place, residual, len(edges) - 1) / count
    between = count * mean**2
    high = np.flatnonzero(between >= TUNING.in_range * between.max())
    share = float(between.sum() / max(float(residual @ residual), 1e-300))
    return share, (float(edges[high[0]]), float(edges[high[-1] + 1]))


# ---- Data and options of a comparison ----
@dataclass(frozen=True)
class HeldBack:
    """Data that score selected effects, and are not used to select them."""

    trial: Trial  #: another log, or held-back blocks of the log
    name: str  #: in reports
    another_log: bool  #: whether it is another log

    def effort(self, model: Model, extended: Model, theta: Array) -> Array:
        """(N, n) of an extended model with parameters theta (P,), N m; the model's own columns are cached."""
        own, motion = len(model.terms), self.trial.signals.motion
        if extended.distortions != model.distortions or extended.terms[:own] != model.terms:
            return extended.effort(motion, theta)
        count = len(model.parameters)
        effort = np.concatenate([columns @ theta[:count] for _, columns in model.chunks(motion)])
        if len(extended.terms) > own:
            added = replace(extended, terms=extended.terms[own:])
            effort += np.concatenate([columns @ theta[count:] for _, columns in added.chunks(motion)])
        return extended.read(effort)

    def errors(self, residual: Array) -> CrossValidation:
        """Errors in blocks of these data, from residuals (N, n), N m."""
        return CrossValidation(self.by_block(residual**2), self.by_block(self.trial.used.astype(np.float64)))

    def by_block(self, values: Array) -> Array:
        """(blocks, ...) sums of values (N, ...) over blocks of these data."""
        rows = np.flatnonzero(self.trial.used.any(axis=1))
        blocks = np.array_split(rows, blocks_of(len(rows) / self.trial.signals.rate))
        return np.stack([values[block].sum(axis=0) for block in blocks])


def divide(model: Model, log: Log, later: Log | None, trial: Trial, cutoff: float | None) -> tuple[Trial, HeldBack]:
    """The data for selection, and those for scoring: another log or, without one, blocks of the log."""
    if later is not None:
        other = shortened(make_trial(model, prepare(later, cutoff)))
        slowest = TUNING.clearly_moving * trial.actuators.standstill_speed  # as on the log, for friction
        other = replace(other, used=other.used & (np.abs(other.actuators.dq) > slowest))
        return trial, HeldBack(other, later.source, another_log=True)
    block = np.minimum(np.arange(len(trial.used)) * TUNING.blocks // len(trial.used), TUNING.blocks - 1)
    held, signals = np.isin(block, TUNING.held_back_blocks)[:, None], trial.signals
    blocks = " and ".join(str(k + 1) for k in TUNING.held_back_blocks)
    name = f"held-back blocks {blocks} of {TUNING.blocks} of {log.source}"
    selecting, scoring = (
        replace(trial, used=trial.used & which, signals=replace(signals, measured=signals.measured & which))
        for which in (~held, held)
    )
    return selecting, HeldBack(scoring, name, another_log=False)


@dataclass(frozen=True)
class Case:
    """Data and options of a selection of effects."""

    knowledge: CoefficientPrior  #: of the model's parameters, from an earlier log
    coefficients: BaseCoefficients  #: the model's base coefficients
    noise: Noise  #: of the earlier log's efforts
    trial: Trial  #: data for selection
    cross_validation: HeldBack  #: data for scoring
    search: Search  #: sign search
    thresholds: Thresholds = Thresholds()  #: of the selection
    #: remaining errors of the robot's geometry
    tolerance: KinematicTolerance = KinematicTolerance(
        length=TUNING.remaining_length, angle=float(np.deg2rad(TUNING.remaining_angle)), stated=False
    )

    @property
    def model(self) -> Model:
        """The earlier model."""
        return self.knowledge.model

    @property
    def needed(self) -> float:
        """Log evidence that an effect must add, nats."""
        return self.thresholds.log10_bayes_factor * LN10

    @cached_property
    def modelled(self) -> ModelledLog:
        """The model on the data for selection."""
        signals = self.trial.signals
        log = signals.motion, self.trial.magnitude, self.trial.used, signals.rate
        return ModelledLog(self.knowledge, self.coefficients, *log)

    @cached_property
    def uncertain(self) -> Columns:
        """Columns of possible geometry errors; an effect must explain more than these.

        The placement of the first joint is left out: an error of it is the effect `base_tilt`. Larger errors since the
        earlier log are effects too, such as `link_length`.
        """
        return self.modelled.geometry(self.tolerance, known=True)

    @cached_property
    def before(self) -> Array:
        """(N, n) efforts of the earlier model, N m."""
        return self.model.effort(self.trial.signals.motion, self.knowledge.theta)

    def data(self, predicted: Array, probability: Array | None = None) -> Observations:
        """The log with signs estimated under a prediction (N, n), N m, or with given probabilities."""
        probability = self.trial.probability(predicted) if probability is None else probability
        expected, floor = (2.0 * probability - 1.0) * self.trial.magnitude, self.floor(predicted)
        return self.modelled.observed(
            expected, floor=floor.rms, reliable=floor.reliable, limits=floor.limits, thresholds=self.thresholds
        )

    def data_under(self, fitted_effects: FittedEffects) -> Observations:
        """The log with signs estimated under fitted effects."""
        return self.data(self.modelled.effort(fitted_effects))

    def floor(self, predicted: Array) -> NoiseFloor:
        """The noise floor under a prediction (N, n), N m."""
        refit = None if self.standard_refit is None else self.standard_refit.fit.residual.sigma
        return noise_floor(self.trial, self.trial.residual(predicted), self.noise, refit)

    def unexplained(self, fitted_effects: FittedEffects, predicted: Array) -> dict[int, float]:
        """Joints (from 1) with a residual significantly above the floor under a prediction, and their ratio."""
        floor, gap = self.floor(predicted), self.trial.gap(predicted)
        significant = fitted_effects.free_evidence - fitted_effects.noise_evidence > self.needed
        above = np.flatnonzero(significant & floor.exceeded(gap)).tolist()
        return {j + 1: float(gap[j] / floor.rms[j]) for j in above}

    @cached_property
    def standard_refit(self) -> SignSolution | None:
        """Signs and fit of the log alone with all standard effects; None if the model has them or its fit was good."""
        signals = self.trial.signals
        model = with_standard_terms(self.model.before_sensors, signals)
        floor = noise_floor(self.trial, self.trial.residual(self.before), self.noise)
        if model is None or floor.reliable.all():
            return None
        segments = find_segments(signals, self.trial.actuators)
        return find_signs(model, signals, segments, self.search)

    def refitted(self, extension: Extension, predicted: Array) -> Extension:
        """The extended model with feasible parameters, from the data for selection and the earlier knowledge."""
        model, knowledge = extension.model.before_sensors, extension.knowledge
        coefficients = knowledge.coefficients(model)
        signals = restored(extension.model, self.trial.signals)
        signs = 2.0 * self.trial.probability(predicted) - 1.0
        used, information = self.trial.used & signals.measured, knowledge.information(model, coefficients)
        log_data = LogData(model, coefficients, signals, used, used, information)
        return replace(extension, theta=fit_signed(log_data, signs, most_corrected=0).theta)
