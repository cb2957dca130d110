"""Signs under one model: searched segment by segment, smoothed sample by sample, and the fit to them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayesid.arrays import Array
from bayesid.fit.evidence import Evidence
from bayesid.fit.knowledge import Information, Knowledge
from bayesid.fit.least_squares import Fit, fit_signed
from bayesid.fit.noise import residual_noise
from bayesid.log.segments import Segments
from bayesid.log.signals import Signals, signed_effort
from bayesid.model.coefficients import BaseCoefficients, base_coefficients
from bayesid.model.model import Model
from bayesid.process import in_parallel
from bayesid.progress import SILENT, Progress
from bayesid.signs.rounds import SegmentSigns, SignSearch
from bayesid.signs.search.protocol import Search
from bayesid.signs.smoothing import sign_probabilities


@dataclass(frozen=True)
class Settled:
    """Signs under one model.

    Attributes:
        evidence: the model, the log and the samples that count.
        signs: what the searches gave.
        probability: (N, n) P(sign = +) of every sample, the parameters taken as known.
        fit: parameters and noise under these signs.
    """

    evidence: Evidence
    signs: SegmentSigns
    probability: Array
    fit: Fit

    @property
    def model(self) -> Model:
        """Robot and terms."""
        return self.evidence.model

    @property
    def predicted(self) -> Array:
        """(N, n) the fitted model's efforts, N m."""
        return self.fit.predicted


@dataclass(frozen=True)
class Earlier:
    """Where an earlier log of the robot leads.

    Attributes:
        knowledge: of the parameters.
        theta: (P,) parameters under which signs are settled too, without a search.
    """

    knowledge: Knowledge
    theta: Array


def settle_signs(
    model: Model,
    signals: Signals,
    segments: Segments,
    search: Search,
    progress: Progress = SILENT,
    earlier: Earlier | None = None,
) -> Settled:
    """Searches the signs under a model, smooths them and fits the model to them.

    Args:
        model: robot and terms.
        signals: the log.
        segments: where its signs are constant.
        search: how to search.
        progress: of the searches.
        earlier: what an earlier log says.

    Raises:
        SolverError: an optimisation failed.
    """
    plain = base_coefficients(model)
    sign_search = SignSearch(model, plain, signals, search, progress)
    searched = sign_search.run(segments)
    progress("fit", 0, 1)
    settled = _fitted_to(plain, model, signals, searched)
    searched = sign_search.reweighted(settled.signs, _weights(settled.fit))
    progress("fit", 0, 1)
    if searched.proofs > settled.signs.proofs:
        settled = _fitted_to(plain, model, signals, searched)
        searched = sign_search.reweighted(searched, _weights(settled.fit), repeat=False)
    settled = replace(settled, signs=searched)
    if earlier is None:
        return settled
    evidence, probability, fitted = settled.evidence, settled.probability, settled.evidence.fitted
    coefficients = earlier.knowledge.coefficients(model)
    information = earlier.knowledge.information(model, coefficients)
    evidence = replace(evidence, coefficients=coefficients, information=information)
    start = model.effort(signals.motion, earlier.theta)
    candidates = in_parallel([partial(_agreed, evidence, probability), partial(_agreed_about, evidence, start)])
    time = np.max([fit.residual.autocorrelation for _, fit in candidates], axis=0)
    count = fitted.sum(axis=0) / time  # the same for both: wrong signs last, and would count for little
    probability, fit = min(candidates, key=lambda candidate: _disagreement(candidate[1], count, information))
    return Settled(evidence, searched, probability, fit)


def _fitted_to(coefficients: BaseCoefficients, model: Model, signals: Signals, searched: SegmentSigns) -> Settled:
    """Smooths the signs of the segments and fits the model to them."""
    moving, fitted = (
        searched.segments.per_sample(which, *signals.effort.shape) > 0
        for which in (searched.segments.moving, searched.segments.fitted)
    )
    evidence = Evidence(model, coefficients, signals, moving, fitted)
    signs = searched.segments[searched.segments.fitted].per_sample(searched.search.signs, *moving.shape)
    predicted = model.effort(signals.motion, searched.search.theta)
    probability = _smoothed(evidence, predicted, signed_effort(signals, signs, filtered=False))
    return Settled(evidence, searched, probability, fit_signed(evidence, 2.0 * probability - 1.0))


def _weights(fit: Fit) -> Array:
    """(n,) noise of each joint's effort, N m, as if only every effective sample counted."""
    weights: Array = fit.noise.sigma * np.sqrt(fit.noise.autocorrelation)
    return weights


def settled_again(settled: Settled, signals: Signals, predicted: Array) -> Settled:
    """Signs smoothed and fitted once more under the same model, without a search, on other efforts of the same log.

    Args:
        settled: as they were.
        signals: the log with its other efforts.
        predicted: (N, n) the model's effort by which signs are smoothed, N m.

    Raises:
        SolverError: an optimisation failed.
    """
    evidence = replace(settled.evidence, signals=signals)
    probability = _smoothed(evidence, predicted, signals.nearest(predicted))
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
    probability = _smoothed(evidence, predicted, evidence.signals.nearest(predicted))
    return probability, fit_signed(evidence, 2.0 * probability - 1.0)


def _agreed_about(evidence: Evidence, predicted: Array) -> tuple[Array, Fit]:
    """The same from the signs under a model's efforts (N, n), N m."""
    return _agreed(evidence, _smoothed(evidence, predicted, evidence.signals.nearest(predicted)))


def _disagreement(fit: Fit, count: Array, information: Information) -> float:
    """Minus the logarithm of how probable residuals and parameters are, up to a constant; of (n,) effective samples."""
    return float(count @ np.log(fit.residual.sigma)) + 0.5 * information.misfit(fit.beta)


def _smoothed(evidence: Evidence, predicted: Array, signed: Array) -> Array:
    """(N, n) P(sign = +) of every sample, from the model's efforts (N, n) and the signed ones.

    The noise is that of the samples that are fitted, but the model holds for all in motion.
    """
    signals, fitted = evidence.signals, evidence.fitted
    noise = residual_noise(np.where(fitted, signed - predicted, 0.0), fitted, signals.rate)
    return sign_probabilities(signals, predicted, evidence.moving & signals.inner, noise)
