"""Under which model the signs are settled: the one asked for, or that one with the standard effects it leaves out.

A model without friction explains |effort| of a friction-dominated joint best with wrong signs: friction that only
changes its sign looks like a constant once rectified. No noise level tells that; another model does. So where a model
without some standard effect (`bayesid.terms.DEFAULT`) leaves a residual that lasts from sample to sample, the signs are
searched with these effects too, and both models speak, each with its weight (Bayesian model averaging).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from bayesid import terms as catalogue
from bayesid.coefficients import BaseCoefficients, base_coefficients
from bayesid.fit import Fit, fit_signed, inner_samples
from bayesid.knowledge import Information, Knowledge
from bayesid.model import Model
from bayesid.motion import Array, Mask
from bayesid.noise import residual_noise
from bayesid.segments import Segments
from bayesid.signals import Signals, signed_effort
from bayesid.signs import FoundSigns, Progress, SearchOptions, SignSearch
from bayesid.smoothing import sign_probabilities

_LASTING = 0.5
"""Coloured over white noise of a residual from which on it is worth another model's opinion."""
_TOLERATED, _UNPROVEN = 0.3, 0.1
"""Model error, as a share of the effort, that casts no doubt on signs: with a proof, and without one."""
_HOPELESS = 0.7
"""So much more, and a sign is a guess in half of the cases."""
_INFECTED = 0.6
"""Share of the worst joint's model error that all joints are suspected of: parameters are common to them."""
_LARGEST_WEIGHT = 0.95
"""The model that was asked for keeps a say: neither is the truth, whatever their odds."""


@dataclass(frozen=True)
class Settled:
    """Signs under one model.

    Attributes:
        model: robot and terms.
        coefficients: its r base coefficients.
        found: by the search.
        moving: (N, n) samples in motion.
        fitted: (N, n) those of them that the fit rests on.
        probability: (N, n) P(sign = +) of every sample, the parameters taken as known.
        fit: parameters and noise under these signs.
        known: of the coefficients, before the log.
    """

    model: Model
    coefficients: BaseCoefficients
    found: FoundSigns
    moving: Mask
    fitted: Mask
    probability: Array
    fit: Fit
    known: Information | None = None


@dataclass(frozen=True)
class Prior:
    """What is known before the log.

    Attributes:
        knowledge: of the parameters, from an earlier log.
        theta: (P,) parameters under which signs are settled too, without a search.
    """

    knowledge: Knowledge
    theta: Array


def settle_signs(
    model: Model, signals: Signals, segments: Segments, options: SearchOptions, progress: Progress | None = None,
    prior: Prior | None = None,
) -> Settled:  # fmt: skip
    """Searches the signs under a model, smooths them and fits the model to them.

    Args:
        model: robot and terms.
        signals: the log.
        segments: where its signs are constant.
        options: how to search.
        progress: called as progress(stage, done, total).
        prior: what is known before the log.

    Raises:
        SolverError: an optimisation failed.
    """
    plain = base_coefficients(model)
    found = SignSearch(model, plain, signals, options, progress).run(segments)
    moving, fitted = (
        found.segments.per_sample(which, *signals.effort.shape) > 0
        for which in (found.segments.moving, found.segments.fitted)
    )
    signs = found.segments[found.segments.fitted].per_sample(found.search.signs, *moving.shape)
    predicted = model.effort(signals.motion, found.search.theta)
    probability = _smoothed(signals, predicted, signs * signals.raw_effort, moving, fitted)
    if prior is None:
        fit = fit_signed(model, plain, signals, 2.0 * probability - 1.0, fitted)
        return Settled(model, plain, found, moving, fitted, probability, fit)
    coefficients = prior.knowledge.coefficients(model)
    known = prior.knowledge.information(model, coefficients)
    start = model.effort(signals.motion, prior.theta)
    other = _smoothed(signals, start, np.sign(start) * np.abs(signals.raw_effort), moving, fitted)
    candidates = [_agreed(model, coefficients, signals, one, moving, fitted, known) for one in (probability, other)]
    time = np.max([one.residual.autocorrelation for _, one in candidates], axis=0)
    count = fitted.sum(axis=0) / time  # the same for both: wrong signs last, and would count for little
    probability, fit = min(candidates, key=lambda one: _disagreement(one[1], count, known))
    return Settled(model, coefficients, found, moving, fitted, probability, fit, known)


def restored(model: Model, signals: Signals) -> Signals:
    """The log as it would be without what the model says of its sensors."""
    magnitude, told = model.unread(np.abs(signals.raw_effort))
    raw = np.where(signals.signed, np.sign(signals.raw_effort), 1.0) * magnitude
    changed = replace(signals, raw_effort=raw, measured=signals.measured & told)
    return replace(changed, effort=signed_effort(changed, np.ones_like(raw)))


def _agreed(
    model: Model, coefficients: BaseCoefficients, signals: Signals, probability: Array, moving: Mask, fitted: Mask,
    known: Information,
) -> tuple[Array, Fit]:  # fmt: skip
    """Signs and fit, settled once more under the fit to them and to what is known."""
    fit = fit_signed(model, coefficients, signals, 2.0 * probability - 1.0, fitted, known)
    nearest = np.sign(fit.predicted) * np.abs(signals.raw_effort)
    probability = _smoothed(signals, fit.predicted, nearest, moving, fitted)
    return probability, fit_signed(model, coefficients, signals, 2.0 * probability - 1.0, fitted, known)


def _disagreement(fit: Fit, count: Array, known: Information) -> float:
    """Minus the logarithm of how probable residuals and parameters are, up to a constant; of (n,) effective samples."""
    return float(count @ np.log(fit.residual.sigma)) + 0.5 * known.misfit(fit.beta)


def _smoothed(signals: Signals, predicted: Array, signed: Array, moving: Mask, fitted: Mask) -> Array:
    """(N, n) P(sign = +) of every sample, from the model's efforts (N, n) and the signed ones.

    The noise is that of the samples that are fitted, but the model holds for all in motion.
    """
    signed = np.where(signals.signed, signals.raw_effort, signed)
    noise = residual_noise(np.where(fitted, signed - predicted, 0.0), fitted, signals.rate)
    inside = moving & inner_samples(signals)
    smoothed = sign_probabilities(np.abs(signals.raw_effort), predicted, inside, noise, signals.rate)
    return np.where(signals.signed, (signals.raw_effort >= 0.0).astype(float), smoothed)


def richer_model(settled: Settled, signals: Signals) -> Model | None:
    """The model with all standard effects, if it lacks some and its residual lasts; else None."""
    residual = settled.fit.residual
    if signals.signed.all() or np.all(residual.coloured < _LASTING * residual.white):
        return None
    return with_standard_terms(settled.model, signals)


def with_standard_terms(model: Model, signals: Signals) -> Model | None:
    """The model with the standard effects that it lacks; None if it lacks none."""
    names = {term.name for term in model.terms}
    missing = [name for name in catalogue.DEFAULT if name not in names]
    if not missing:
        return None
    for term in catalogue.make_terms(missing, model.robot, signals.motion):
        model = model.extend(term)
    return model


def weight_against(rival: Settled, own: Settled) -> float:
    """Weight of a richer model against the one it extends, by the Bayesian information criterion on effective samples.

    Each joint's samples are divided by the longer autocorrelation time of the two residuals (:eq:`model-weight`).
    """
    time = np.maximum(rival.fit.residual.autocorrelation, own.fit.residual.autocorrelation)
    count = own.fitted.sum(axis=0) / time
    gain = float(count @ (2.0 * np.log(own.fit.residual.sigma / rival.fit.residual.sigma)))
    price = (len(rival.coefficients) - len(own.coefficients)) * float(np.log(count.sum()))
    return min(_LARGEST_WEIGHT, float(expit(0.5 * (gain - price))))


def structural_doubt(settled: Settled, signals: Signals) -> Array:
    """(n,) probability, per joint, that signs are guesses because the model is not the robot's.

    A model that leaves a large lasting error of its own finds wrong signs that suit it, joints at a time, and every
    probability that is conditional on the model follows it. A rule of thumb, in the size of the lasting error relative
    to the effort and in whether a proof was had (:eq:`doubt`); `bayesid study misfit` shows what it does.
    """
    square = np.where(settled.fitted, signals.raw_effort**2, 0.0).sum(axis=0)
    effort = np.sqrt(square / np.maximum(settled.fitted.sum(axis=0), 1))
    error = settled.fit.noise.coloured / np.maximum(effort, 1e-300)
    suspected = np.maximum(error, _INFECTED * error.max())
    tolerated = _TOLERATED if settled.found.search.certified else _UNPROVEN
    doubt: Array = np.clip((suspected - tolerated) / _HOPELESS, 0.0, 1.0)
    return np.where(signals.signed, 0.0, 0.5 * doubt)
