"""Signs under one model: searched by segments, smoothed by samples, and the fit to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from bayesid.arrays import TINY, Array, Integers
from bayesid.effects.coefficients import BaseCoefficients, base_coefficients
from bayesid.effects.model import Model
from bayesid.log.segments import Segments
from bayesid.log.signals import Signals, signed_effort
from bayesid.parallel import in_parallel
from bayesid.progress import SILENT, Progress
from bayesid.regression.knowledge import CoefficientPrior
from bayesid.regression.least_squares import Fit, fit_signed
from bayesid.regression.log_data import LogData
from bayesid.regression.noise import residual_noise
from bayesid.regression.tuning import TUNING as REGRESSION
from bayesid.signs.rounds import SegmentSigns, SignSearch
from bayesid.signs.search.protocol import Assignment, Search, SearchResult, SignProblem
from bayesid.signs.smoothing import sign_probabilities
from bayesid.signs.tuning import TUNING

_LESS_THAN_HALF = float(np.nextafter(0.5, 0.0))
"""Probability of the best assignment's sign if the other sign is as likely."""


@dataclass(frozen=True)
class Reading:
    """Sensors that change the efforts."""

    model: Model  # with the sensors' distortions
    signals: Signals  # the log as read


@dataclass(frozen=True)
class SignSolution:
    """Signs under one model."""

    log_data: LogData  # the model, the log and the used samples
    signs: SegmentSigns  # results of the searches
    probability: Array  # (N, n) P(sign = +) of every sample, given the parameters
    fit: Fit  # parameters and noise under these signs
    reading: Reading | None = None  # set if sensors change the efforts

    @property
    def error(self) -> Array:
        """(N, n) efforts as read minus the readings that the model predicts, N m; unknown signs as predicted."""
        if self.reading is None:
            return self.log_data.signals.nearest(self.predicted) - self.predicted
        read = self.reading.model.read(self.predicted)
        return self.reading.signals.nearest(read) - read

    @property
    def model(self) -> Model:
        """Robot and terms."""
        return self.log_data.model

    @property
    def predicted(self) -> Array:
        """(N, n) the fitted model's efforts, N m."""
        return self.fit.predicted

    @cached_property
    def alternatives(self) -> tuple[Alternative, ...]:
        """Other possible assignments that differ in enough energy, the likeliest first."""
        listed = _listed(self)
        return (*listed, *_flipped_joints(self, [alternative.probability for alternative in listed]))

    @property
    def mixed(self) -> Array:
        """(N, n) P(sign = +) of every sample, averaged over all alternatives (:eq:`mixed-signs`)."""
        return self.mixed_with(self.probability)

    def mixed_with(self, probability: Array) -> Array:
        """The same, with (N, n) P(sign = +) under this assignment."""
        if not self.alternatives:
            return probability
        odds = np.array([alternative.odds for alternative in self.alternatives])
        every = np.array([probability, *(alternative.probability for alternative in self.alternatives)])
        mixed = np.tensordot(np.append(1.0, odds) / (1.0 + odds.sum()), every, axes=1)
        result: Array = np.where(probability >= 0.5, np.maximum(mixed, 0.5), np.minimum(mixed, _LESS_THAN_HALF))
        return result


@dataclass(frozen=True)
class Alternative:
    """Another assignment of signs."""

    odds: float  # odds against the best one, exp(-(its cost - the best cost) / 2), at most 1
    probability: Array  # (N, n) P(sign = +) of every sample under it


@dataclass(frozen=True)
class Earlier:
    """Results of an earlier log of the robot."""

    knowledge: CoefficientPrior  # of the parameters
    theta: Array  # (P,) parameters that give another solution without a search


def find_signs(
    model: Model,
    signals: Signals,
    segments: Segments,
    search: Search,
    progress: Progress = SILENT,
    earlier: Earlier | None = None,
    start: SignSolution | None = None,
    also: Sequence[Array] = (),
) -> SignSolution:
    """Searches the signs of segments under a model, smooths them and fits the model.

    The search starts from signs under another model (`start`), and from further ones (N, n) between -1 and 1 (`also`).

    Raises:
        SolverError: an optimisation failed.
    """
    plain = base_coefficients(model)
    sign_search = SignSearch(model, plain, signals, search, progress)
    if start is not None:
        likely = (2.0 * start.probability - 1.0, *also)
        sign_search = replace(sign_search, likely=likely, unlisted_probability=start.signs.search.unlisted_probability)
    searched = sign_search.run(segments)
    with progress.stage("least-squares fit"):
        sign_solution = fitted_to(plain, model, signals, searched)
    searched = sign_search.reweighted(sign_solution.signs, _weights(sign_solution.fit))
    if (
        not np.array_equal(searched.search.signs, sign_solution.signs.search.signs)
        or searched.proofs > sign_solution.signs.proofs
    ):
        with progress.stage("least-squares fit"):
            sign_solution = fitted_to(plain, model, signals, searched)
        searched = sign_search.reweighted(searched, _weights(sign_solution.fit), repeat=False)
    sign_solution = replace(sign_solution, signs=searched)
    if earlier is None:
        return _by_direction(sign_solution, sign_search)
    coefficients = earlier.knowledge.coefficients(model)
    information = earlier.knowledge.information(model, coefficients)
    log_data = replace(sign_solution.log_data, coefficients=coefficients, information=information)

    def by_search() -> tuple[Array, Fit]:
        return _agreed(log_data, sign_solution.probability)

    def by_earlier() -> tuple[Array, Fit]:
        return _agreed(log_data, _smoothed(log_data, model.effort(signals.motion, earlier.theta)))

    candidates = in_parallel([by_search, by_earlier])
    time = np.max([fit.residual.autocorrelation for _, fit in candidates], axis=0)
    # the same count for both, as wrong signs give long correlations, which would reduce theirs
    count = log_data.fitted.sum(axis=0) / time
    first = candidates[0][1]

    def disagreement(fit: Fit) -> float:
        """Negative log density of residuals and parameters, up to a constant."""
        return 0.5 * information.misfit(fit.beta) - nats_gained(fit, first, count)

    probability, fit = min(candidates, key=lambda candidate: disagreement(candidate[1]))
    return SignSolution(log_data, searched, probability, fit)


def _by_direction(sign_solution: SignSolution, sign_search: SignSearch) -> SignSolution:
    """The velocity's signs in poorly explained joints, if they explain |effort| about as well.

    A poor model prefers signs that fit its error. Friction opposes every motion; in a friction-dominated joint the sign
    of the effort is the velocity's. So it is preferred with the odds `friction_odds`.
    """
    log_data, given = sign_solution.log_data, sign_solution
    if sign_solution.signs.search.certified:
        return sign_solution
    speed = log_data.model.robot.actuators(log_data.signals.motion).dq
    poor = (sign_solution.fit.relative_residual > REGRESSION.poor_fit) & ~log_data.signals.signed
    for joint in np.flatnonzero(poor)[::-1].tolist():
        probability = sign_solution.probability.copy()
        probability[:, joint] = np.where(speed[:, joint] >= 0.0, 1.0, 0.0)
        fit = fit_signed(log_data, 2.0 * probability - 1.0, most_corrected=0)
        if nats_gained(fit, sign_solution.fit, _count(log_data, fit, sign_solution.fit)) > -np.log(
            TUNING.friction_odds
        ):
            probability[:, joint] = _smoothed(log_data, fit.predicted)[:, joint]
            sign_solution = replace(
                sign_solution, probability=probability, fit=fit_signed(log_data, 2.0 * probability - 1.0)
            )
    if sign_solution is given:
        return sign_solution
    return replace(sign_solution, signs=sign_search.following(sign_solution.signs, sign_solution.probability))


def _count(log_data: LogData, fit: Fit, other: Fit) -> Array:
    """(n,) effective samples, by the shorter autocorrelation time of two residuals."""
    time = np.minimum(fit.residual.autocorrelation, other.residual.autocorrelation)
    count: Array = log_data.fitted.sum(axis=0) / time
    return count


def nats_gained(fit: Fit, other: Fit, count: Array) -> float:
    """Log-likelihood ratio of two fits' residuals, each with its own noise, nats.

    `count` (n,) are the effective samples of each joint.
    """
    after, before = (np.maximum(each.residual.sigma, TINY) for each in (fit, other))
    return float(count @ np.log(before / after))


def fitted_to(coefficients: BaseCoefficients, model: Model, signals: Signals, searched: SegmentSigns) -> SignSolution:
    """The fit to samples in the signs of their segments, smoothed by the model.

    Raises:
        SolverError: Clarabel failed.
    """
    moving, fitted = (
        searched.segments.per_sample(which, *signals.effort.shape) > 0
        for which in (searched.segments.moving, searched.segments.fitted)
    )
    log_data = LogData(model, coefficients, signals, moving, fitted)
    probability = _smoothed_by(log_data, searched.fitted, searched.search)
    return SignSolution(log_data, searched, probability, fit_signed(log_data, 2.0 * probability - 1.0))


def _listed(sign_solution: SignSolution) -> list[Alternative]:
    """Assignments close to the best one that differ from it, and from each other, in enough of a joint's energy.

    Odds use unfiltered efforts in their expected signs. A low-pass rounds off |effort| at zero, which acts as negative
    friction and favours the wrong one of two close assignments. The best assignment keeps a probability of at least one
    half.
    """
    segments = sign_solution.signs.fitted
    energy = segments.sums(sign_solution.log_data.signals.effort**2) * (segments.known == 0)
    joints = (np.arange(sign_solution.probability.shape[1])[:, None] == segments.joint) * energy
    share = joints / np.maximum(joints.sum(axis=1, keepdims=True), TINY)
    distinct, chosen = [sign_solution.signs.search.signs], list[Assignment]()
    for branch in sorted(sign_solution.signs.near, key=lambda branch: branch.cost):
        if len(chosen) < TUNING.most_alternatives and all(
            np.any(share @ (branch.signs != other) > TUNING.different_signs) for other in distinct
        ):
            distinct.append(branch.signs)
            chosen.append(branch)
    rises = _rises(sign_solution, segments, distinct) if chosen else []
    return [
        Alternative(_odds(rise), _smoothed_by(sign_solution.log_data, segments, branch))
        for rise, branch in zip(rises, chosen, strict=True)
    ]


def _odds(rise: float) -> float:
    return float(np.exp(-0.5 * max(rise, 0.0)))


def _flipped_joints(sign_solution: SignSolution, listed: Sequence[Array]) -> list[Alternative]:
    """Assignments with flipped joints that are as likely, each with the noise of its residual.

    The search uses the noise of the best assignment. If that is wrong, residuals are correlated and count little, so
    the right one may cost more. Here both sides of a joint have equally many samples, by the shorter autocorrelation
    time.
    """
    log_data, unknown = sign_solution.log_data, np.flatnonzero(~sign_solution.log_data.signals.signed)
    count = log_data.fitted.sum(axis=0)

    def rise_of(fit: Fit) -> float:
        time = np.minimum(fit.residual.autocorrelation, sign_solution.fit.residual.autocorrelation)
        return -2.0 * nats_gained(fit, sign_solution.fit, count / time)

    def around(joint: int) -> tuple[float, Array]:
        probability = sign_solution.probability.copy()
        probability[:, joint] = 1.0 - probability[:, joint]
        rise = rise_of(fit_signed(log_data, 2.0 * probability - 1.0, most_corrected=0))
        if rise > 2.0 * TUNING.near:
            return rise, probability
        probability, fit = _agreed(log_data, probability)
        return rise_of(fit), probability

    share = np.where(log_data.fitted, log_data.signals.effort**2, 0.0)
    share /= np.maximum(share.sum(axis=0), TINY)
    known, found = [sign_solution.probability, *listed], list[Alternative]()
    for rise, probability in in_parallel([partial(around, joint) for joint in unknown.tolist()]):
        different = [np.sum(share * ((probability >= 0.5) != (other >= 0.5)), axis=0).max() for other in known]
        if rise <= TUNING.near and min(different) > TUNING.different_signs:
            known.append(probability)
            found.append(Alternative(_odds(rise), probability))
    return found


def _rises(sign_solution: SignSolution, segments: Segments, assignments: Sequence[Integers]) -> list[float]:
    """Extra cost of other assignments over the first one, with unfiltered efforts."""
    log_data, expected = sign_solution.log_data, 2.0 * sign_solution.probability - 1.0
    orientation = segments.per_sample(assignments[0], *expected.shape)
    raw = log_data.normal_equations(expected, segments, TUNING.most_individual, orientation, summed_out=False)
    problem = SignProblem(raw.scaled(_weights(sign_solution.fit)), log_data.model.cone, log_data.coefficients)
    prepared = problem.solver().prepared()
    costs = [prepared.solve_precisely(signs @ problem.normal_equations.gradient).cost for signs in assignments]
    return [cost - costs[0] for cost in costs[1:]]


def _weights(fit: Fit) -> Array:
    """(n,) noise of each joint's effort, N m, including the autocorrelation."""
    weights: Array = fit.noise.sigma * np.sqrt(fit.noise.autocorrelation)
    return weights


def solution_again(sign_solution: SignSolution, signals: Signals, predicted: Array) -> SignSolution:
    """Signs smoothed by predicted efforts (N, n), N m, and a new fit under the same model, without a search.

    `signals` may hold other efforts.
    """
    log_data = replace(sign_solution.log_data, signals=signals)
    probability = _smoothed(log_data, predicted)
    fit = fit_signed(log_data, 2.0 * probability - 1.0)
    return replace(sign_solution, log_data=log_data, probability=probability, fit=fit)


def restored(model: Model, signals: Signals) -> Signals:
    """The log corrected for the model's sensor distortions."""
    magnitude, readable = model.invert_sensor(signals.magnitude)
    raw = np.where(signals.signed, np.sign(signals.raw_effort), 1.0) * magnitude
    changed = replace(signals, raw_effort=raw, measured=signals.measured & readable)
    return replace(changed, effort=signed_effort(changed, np.ones_like(raw)))


def _agreed(log_data: LogData, probability: Array) -> tuple[Array, Fit]:
    """Signs and fit, repeated with the fit to these signs and the prior."""
    predicted = fit_signed(log_data, 2.0 * probability - 1.0, most_corrected=0).predicted
    probability = _smoothed(log_data, predicted)
    return probability, fit_signed(log_data, 2.0 * probability - 1.0)


def _smoothed_by(log_data: LogData, segments: Segments, found: Assignment | SearchResult) -> Array:
    signs = segments.per_sample(found.signs, *log_data.moving.shape)
    predicted = log_data.model.effort(log_data.signals.motion, found.theta)
    return _smoothed(log_data, predicted, signed_effort(log_data.signals, signs, filtered=False))


def _smoothed(log_data: LogData, predicted: Array, signed: Array | None = None) -> Array:
    """(N, n) P(sign = +) of every sample, from the model's efforts (N, n) and the signed ones; None: the nearest.

    The noise is that of the fitted samples; it applies to all samples in motion.
    """
    signals, fitted = log_data.signals, log_data.fitted
    signed = signals.nearest(predicted) if signed is None else signed
    noise = residual_noise(np.where(fitted, signed - predicted, 0.0), fitted, signals.rate)
    return sign_probabilities(signals, predicted, log_data.moving & signals.inner, noise)
