"""Signs under one model: searched segment by segment, smoothed sample by sample, and the fit to them."""

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
from bayesid.regression.evidence import Evidence
from bayesid.regression.knowledge import Knowledge
from bayesid.regression.least_squares import Fit, fit_signed
from bayesid.regression.noise import residual_noise
from bayesid.regression.tuning import TUNING as REGRESSION
from bayesid.signs.rounds import SegmentSigns, SignSearch
from bayesid.signs.search.protocol import Branch, Search, SearchResult, SignProblem
from bayesid.signs.smoothing import sign_probabilities
from bayesid.signs.tuning import TUNING

_LESS_THAN_HALF = float(np.nextafter(0.5, 0.0))
"""What is no better than a guess keeps the best assignment's sign: that is written."""


@dataclass(frozen=True)
class Reading:
    """What sensors make of efforts."""

    model: Model  # with the sensors' distortions
    signals: Signals  # the log as it was read


@dataclass(frozen=True)
class Settled:
    """Signs under one model."""

    evidence: Evidence  # the model, the log and the samples that count
    signs: SegmentSigns  # what the searches gave
    probability: Array  # (N, n) P(sign = +) of every sample, the parameters taken as known
    fit: Fit  # parameters and noise under these signs
    reading: Reading | None = None  # where sensors show the efforts otherwise

    @property
    def error(self) -> Array:
        """(N, n) the log's efforts as read less what the model would have read, N m, unknown signs as predicted."""
        if self.reading is None:
            return self.evidence.signals.nearest(self.predicted) - self.predicted
        read = self.reading.model.read(self.predicted)
        return self.reading.signals.nearest(read) - read

    @property
    def model(self) -> Model:
        """Robot and terms."""
        return self.evidence.model

    @property
    def predicted(self) -> Array:
        """(N, n) the fitted model's efforts, N m."""
        return self.fit.predicted

    @cached_property
    def alternatives(self) -> tuple[Alternative, ...]:
        """Other assignments that neither a proof nor 20 nats exclude and that differ in much, the likeliest first."""
        listed = _listed(self)
        return (*listed, *_turned_joints(self, [one.probability for one in listed]))

    @property
    def mixed(self) -> Array:
        """(N, n) P(sign = +) of every sample, over this assignment and its alternatives (:eq:`mixed-signs`)."""
        return self.mixed_with(self.probability)

    def mixed_with(self, probability: Array) -> Array:
        """The same where this assignment says (N, n) P(sign = +)."""
        if not self.alternatives:
            return probability
        odds = np.array([one.odds for one in self.alternatives])
        every = np.array([probability, *(one.probability for one in self.alternatives)])
        mixed = np.tensordot(np.append(1.0, odds) / (1.0 + odds.sum()), every, axes=1)
        own: Array = np.where(probability >= 0.5, np.maximum(mixed, 0.5), np.minimum(mixed, _LESS_THAN_HALF))
        return own


@dataclass(frozen=True)
class Alternative:
    """Another assignment of signs."""

    odds: float  # against the best one, exp(-(its cost - the best cost) / 2), at most 1
    probability: Array  # (N, n) P(sign = +) of every sample under it


@dataclass(frozen=True)
class Earlier:
    """Where an earlier log of the robot leads."""

    knowledge: Knowledge  # of the parameters
    theta: Array  # (P,) parameters under which signs are settled too, without a search


def settle_signs(
    model: Model,
    signals: Signals,
    segments: Segments,
    search: Search,
    progress: Progress = SILENT,
    earlier: Earlier | None = None,
    begun: Settled | None = None,
    also: Sequence[Array] = (),
) -> Settled:
    """Searches the signs of segments under a model, smooths them and fits the model to them.

    The search begins from signs under another model where they are given (`begun`), and then from other ones (N, n)
    between -1 and 1 too (`also`).

    Raises:
        SolverError: an optimisation failed.
    """
    plain = base_coefficients(model)
    sign_search = SignSearch(model, plain, signals, search, progress)
    if begun is not None:
        likely = (2.0 * begun.probability - 1.0, *also)
        sign_search = replace(sign_search, likely=likely, unseen=begun.signs.search.unseen)
    searched = sign_search.run(segments)
    with progress.stage("fit"):
        settled = fitted_to(plain, model, signals, searched)
    searched = sign_search.reweighted(settled.signs, _weights(settled.fit))
    if not np.array_equal(searched.search.signs, settled.signs.search.signs) or searched.proofs > settled.signs.proofs:
        with progress.stage("fit"):
            settled = fitted_to(plain, model, signals, searched)
        searched = sign_search.reweighted(searched, _weights(settled.fit), repeat=False)
    settled = replace(settled, signs=searched)
    if earlier is None:
        return _by_direction(settled, sign_search)
    coefficients = earlier.knowledge.coefficients(model)
    information = earlier.knowledge.information(model, coefficients)
    evidence = replace(settled.evidence, coefficients=coefficients, information=information)

    def by_search() -> tuple[Array, Fit]:
        return _agreed(evidence, settled.probability)

    def by_earlier() -> tuple[Array, Fit]:
        return _agreed(evidence, _smoothed(evidence, model.effort(signals.motion, earlier.theta)))

    candidates = in_parallel([by_search, by_earlier])
    time = np.max([fit.residual.autocorrelation for _, fit in candidates], axis=0)
    count = evidence.fitted.sum(axis=0) / time  # the same for both: wrong signs last, and would count for little
    first = candidates[0][1]

    def disagreement(fit: Fit) -> float:
        """Minus the logarithm of how probable residuals and parameters are, up to a constant."""
        return 0.5 * information.misfit(fit.beta) - nats_gained(fit, first, count)

    probability, fit = min(candidates, key=lambda candidate: disagreement(candidate[1]))
    return Settled(evidence, searched, probability, fit)


def _by_direction(settled: Settled, sign_search: SignSearch) -> Settled:
    """The signs of velocity in joints that the model explains poorly, where these explain |effort| about as well.

    A poor model prefers signs that suit what it lacks. Friction opposes every motion; where it decides a joint's effort
    its sign is the velocity's. So against a poor model it has the odds `friction_odds`.
    """
    evidence, begun = settled.evidence, settled
    if settled.signs.search.certified:
        return settled
    speed = evidence.model.robot.actuators(evidence.signals.motion).dq
    poor = (settled.fit.relative_residual > REGRESSION.poor_fit) & ~evidence.signals.signed
    for joint in np.flatnonzero(poor)[::-1].tolist():
        probability = settled.probability.copy()
        probability[:, joint] = np.where(speed[:, joint] >= 0.0, 1.0, 0.0)
        fit = fit_signed(evidence, 2.0 * probability - 1.0, most_corrected=0)
        if nats_gained(fit, settled.fit, _count(evidence, fit, settled.fit)) > -np.log(TUNING.friction_odds):
            probability[:, joint] = _smoothed(evidence, fit.predicted)[:, joint]
            settled = replace(settled, probability=probability, fit=fit_signed(evidence, 2.0 * probability - 1.0))
    if settled is begun:
        return settled
    return replace(settled, signs=sign_search.following(settled.signs, settled.probability))


def _count(evidence: Evidence, fit: Fit, other: Fit) -> Array:
    """(n,) effective samples by the shorter autocorrelation time of two residuals."""
    time = np.minimum(fit.residual.autocorrelation, other.residual.autocorrelation)
    count: Array = evidence.fitted.sum(axis=0) / time
    return count


def nats_gained(fit: Fit, other: Fit, count: Array) -> float:
    """By how much likelier the residuals of a fit are than those of another one, each by its own noise, nats.

    Of (n,) effective samples of each joint.
    """
    left, before = (np.maximum(one.residual.sigma, TINY) for one in (fit, other))
    return float(count @ np.log(before / left))


def fitted_to(coefficients: BaseCoefficients, model: Model, signals: Signals, searched: SegmentSigns) -> Settled:
    """Samples in the signs of their segments, smoothed by the model, and the fit to them.

    Raises:
        SolverError: Clarabel failed.
    """
    moving, fitted = (
        searched.segments.per_sample(which, *signals.effort.shape) > 0
        for which in (searched.segments.moving, searched.segments.fitted)
    )
    evidence = Evidence(model, coefficients, signals, moving, fitted)
    probability = _smoothed_by(evidence, searched.fitted, searched.search)
    return Settled(evidence, searched, probability, fit_signed(evidence, 2.0 * probability - 1.0))


def _listed(settled: Settled) -> list[Alternative]:
    """Of what comes near the best assignment that which differs from it, and among itself, in much of a joint's energy.

    Odds are those of unfiltered efforts, in the signs that their samples are expected to have: a low-pass rounds off
    where |effort| touches zero, which looks like a little negative friction and favours the wrong side of a near tie.
    The best assignment keeps half of the probability at least.
    """
    segments = settled.signs.fitted
    energy = segments.sums(settled.evidence.signals.effort**2) * (segments.known == 0)
    joints = (np.arange(settled.probability.shape[1])[:, None] == segments.joint) * energy
    share = joints / np.maximum(joints.sum(axis=1, keepdims=True), TINY)
    distinct, chosen = [settled.signs.search.signs], list[Branch]()
    for branch in sorted(settled.signs.near, key=lambda branch: branch.cost):
        if len(chosen) < TUNING.most_alternatives and all(
            np.any(share @ (branch.signs != other) > TUNING.different_signs) for other in distinct
        ):
            distinct.append(branch.signs)
            chosen.append(branch)
    rises = _rises(settled, segments, distinct) if chosen else []
    return [
        Alternative(_odds(rise), _smoothed_by(settled.evidence, segments, branch))
        for rise, branch in zip(rises, chosen, strict=True)
    ]


def _odds(rise: float) -> float:
    return float(np.exp(-0.5 * max(rise, 0.0)))


def _turned_joints(settled: Settled, listed: Sequence[Array]) -> list[Alternative]:
    """Joints turned round whose assignment is as likely by the noise that it leaves itself.

    Costs are by the noise of the best assignment. If that is wrong, residuals are correlated and count for little, and
    the right one may cost much more. Here the residual of a joint counts for the same number of samples on both sides,
    by the shorter of its two autocorrelation times.
    """
    evidence, unknown = settled.evidence, np.flatnonzero(~settled.evidence.signals.signed)
    count = evidence.fitted.sum(axis=0)

    def rise_of(fit: Fit) -> float:
        time = np.minimum(fit.residual.autocorrelation, settled.fit.residual.autocorrelation)
        return -2.0 * nats_gained(fit, settled.fit, count / time)

    def around(joint: int) -> tuple[float, Array]:
        probability = settled.probability.copy()
        probability[:, joint] = 1.0 - probability[:, joint]
        rise = rise_of(fit_signed(evidence, 2.0 * probability - 1.0, most_corrected=0))
        if rise > 2.0 * TUNING.near:
            return rise, probability
        probability, fit = _agreed(evidence, probability)
        return rise_of(fit), probability

    share = np.where(evidence.fitted, evidence.signals.effort**2, 0.0)
    share /= np.maximum(share.sum(axis=0), TINY)
    known, found = [settled.probability, *listed], list[Alternative]()
    for rise, probability in in_parallel([partial(around, joint) for joint in unknown.tolist()]):
        different = [np.sum(share * ((probability >= 0.5) != (one >= 0.5)), axis=0).max() for one in known]
        if rise <= TUNING.near and min(different) > TUNING.different_signs:
            known.append(probability)
            found.append(Alternative(_odds(rise), probability))
    return found


def _rises(settled: Settled, segments: Segments, assignments: Sequence[Integers]) -> list[float]:
    """By how much other assignments cost more than the first one, by unfiltered efforts."""
    evidence, expected = settled.evidence, 2.0 * settled.probability - 1.0
    orientation = segments.per_sample(assignments[0], *expected.shape)
    raw = evidence.moments(expected, segments, TUNING.most_individual, orientation, summed_out=False)
    problem = SignProblem(raw.scaled(_weights(settled.fit)), evidence.model.cone, evidence.coefficients)
    prepared = problem.solver().prepared()
    costs = [prepared.solve_precisely(signs @ problem.moments.gradient).cost for signs in assignments]
    return [cost - costs[0] for cost in costs[1:]]


def _weights(fit: Fit) -> Array:
    """(n,) noise of each joint's effort, N m, as if only every effective sample counted."""
    weights: Array = fit.noise.sigma * np.sqrt(fit.noise.autocorrelation)
    return weights


def settled_again(settled: Settled, signals: Signals, predicted: Array) -> Settled:
    """Signs smoothed by predicted efforts (N, n), N m, and fitted once more under the same model, without a search.

    `signals` holds the log with other efforts.
    """
    evidence = replace(settled.evidence, signals=signals)
    probability = _smoothed(evidence, predicted)
    fit = fit_signed(evidence, 2.0 * probability - 1.0)
    return replace(settled, evidence=evidence, probability=probability, fit=fit)


def restored(model: Model, signals: Signals) -> Signals:
    """The log as it would be without what the model says of its sensors."""
    magnitude, readable = model.unread(signals.magnitude)
    raw = np.where(signals.signed, np.sign(signals.raw_effort), 1.0) * magnitude
    changed = replace(signals, raw_effort=raw, measured=signals.measured & readable)
    return replace(changed, effort=signed_effort(changed, np.ones_like(raw)))


def _agreed(evidence: Evidence, probability: Array) -> tuple[Array, Fit]:
    """Signs and fit, settled once more under the fit to them and to what is known."""
    predicted = fit_signed(evidence, 2.0 * probability - 1.0, most_corrected=0).predicted
    probability = _smoothed(evidence, predicted)
    return probability, fit_signed(evidence, 2.0 * probability - 1.0)


def _smoothed_by(evidence: Evidence, segments: Segments, found: Branch | SearchResult) -> Array:
    signs = segments.per_sample(found.signs, *evidence.moving.shape)
    predicted = evidence.model.effort(evidence.signals.motion, found.theta)
    return _smoothed(evidence, predicted, signed_effort(evidence.signals, signs, filtered=False))


def _smoothed(evidence: Evidence, predicted: Array, signed: Array | None = None) -> Array:
    """(N, n) P(sign = +) of every sample, from the model's efforts (N, n) and the signed ones, by default the nearest.

    The noise is that of the samples that are fitted, but the model holds for all in motion.
    """
    signals, fitted = evidence.signals, evidence.fitted
    signed = signals.nearest(predicted) if signed is None else signed
    noise = residual_noise(np.where(fitted, signed - predicted, 0.0), fitted, signals.rate)
    return sign_probabilities(signals, predicted, evidence.moving & signals.inner, noise)
