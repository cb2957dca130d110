"""Posterior of a log after the sign search; sign probabilities, fit and model that follow from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.model import Model
from bayesid.identification.gains import links_of, spread_by_gains
from bayesid.identification.identified_model import IdentifiedModel, ParameterDraws
from bayesid.identification.tuning import TUNING
from bayesid.log.segments import Segments
from bayesid.log.signals import Signals
from bayesid.posterior.inference import Posterior, infer, widened
from bayesid.posterior.likelihood import SegmentBlocks, divide
from bayesid.posterior.sampler import Sampling
from bayesid.posterior.target import PosteriorProblem
from bayesid.posterior.tuning import TUNING as POSTERIOR
from bayesid.progress import Progress
from bayesid.regression.gains import GainFit
from bayesid.regression.knowledge import ParameterPrior, nominal_parameters, of_base
from bayesid.regression.least_squares import Fit, fit_signed
from bayesid.regression.log_data import LogData
from bayesid.signs.averaging import AveragedSigns
from bayesid.signs.smoothing import sign_probabilities


def sample(averaged: AveragedSigns, sampling: Sampling, prior: ParameterPrior, progress: Progress) -> Posterior:
    """Posterior of the given model; unknown signs are summed out unless another model determined them."""
    log_data, sign_solution, fit = averaged.requested.log_data, averaged.sign_solution, averaged.fit
    search = sign_solution.signs.search
    segments = _inner(sign_solution.signs.segments[sign_solution.signs.segments.fitted], log_data.signals)
    orientation = segments.per_sample(search.signs, *sign_solution.probability.shape)
    known = segments.known if averaged.by_requested else search.signs
    pieces, segment = divide(segments, fit.noise.autocorrelation)
    expected = 2.0 * sign_solution.probability - 1.0
    normal_equations = log_data.normal_equations(
        expected, pieces, TUNING.pointwise_blocks, orientation, summed_out=False
    )
    blocks = SegmentBlocks(replace(normal_equations, known=known[segment]), segment, pieces.start, pieces.end)
    if not averaged.by_requested or log_data.information is not None:
        search = replace(search, theta=fit.theta, branches=(), persistent=None)
    problem = PosteriorProblem(
        blocks=blocks,
        coefficients=log_data.coefficients,
        cone=log_data.model.cone,
        noise=fit.noise,
        links=links_of(prior, log_data, normal_equations),
        nominal=nominal_parameters(prior, log_data.model.parameters),
        information=log_data.information,
    )
    posterior = infer(problem, search, sampling, progress)
    return posterior if log_data.nuisance is None else widened(posterior, fit.information, _lacking(fit, log_data))


def _lacking(fit: Fit, log_data: LogData) -> Array:
    """(r, r) covariance of the coefficients in addition to the inverse information: effects that the model may lack."""
    known, basis = np.isfinite(fit.sd), fit.plane.seen_by(log_data.coefficients.projection).basis
    model_error_covariance: Array = np.where(np.outer(known, known), fit.covariance, 0.0)
    of_data = basis @ _inverse(basis.T @ fit.information @ basis) @ basis.T
    model_error_covariance[np.ix_(known, known)] -= of_data[np.ix_(known, known)]
    return model_error_covariance


def _inner(segments: Segments, signals: Signals) -> Segments:
    """Segments without the samples at both ends of the log."""
    inside = np.flatnonzero(signals.inner)
    ends = int(inside[0]), int(inside[-1]) + 1
    return replace(segments, start=np.clip(segments.start, *ends), end=np.clip(segments.end, *ends))


def average_over_draws(averaged: AveragedSigns, posterior: Posterior, progress: Progress) -> Array:
    """(N, n) P(sign = +) of every sample, averaged over draws of each mode and then over modes by weight."""
    log_data = averaged.requested.log_data
    signals = log_data.signals
    known = log_data.moving & signals.inner  # accelerations at both ends are uncertain
    probability = np.zeros(known.shape)
    for sampled in posterior.modes:
        draws, log_scale = posterior.target.split(
            sampled.draws.spread(TUNING.smoothed_draws if sampled.weight > 0.5 else TUNING.smoothed_draws_light)
        )
        predicted = log_data.model.effort(signals.motion, draws.T)
        noise = averaged.requested.fit.noise.scaled(np.exp(log_scale.mean(axis=0)))
        with progress.stage("probability of the samples' signs") as steps:
            probability += sampled.weight * sign_probabilities(signals, predicted, known, noise, steps)
    return probability


def fit_of_mode(averaged: AveragedSigns, posterior: Posterior) -> Fit:
    """Least squares with the signs of the chosen mode; the fit of the search unless the mode flips a joint."""
    log_data = averaged.requested.log_data
    if not averaged.by_requested or not posterior.flipped_joints(
        posterior.chosen, averaged.sign_solution.signs.search.signs
    ):
        return averaged.fit
    signals, draws = log_data.signals, posterior.modes[posterior.chosen].draws
    predicted = log_data.model.effort(signals.motion, draws.theta.mean(axis=(0, 1, 2)))
    known = log_data.moving & signals.inner
    noise = averaged.requested.fit.noise
    return fit_signed(log_data, 2.0 * sign_probabilities(signals, predicted, known, noise) - 1.0)


def identified_model(
    model: Model, log_data: LogData, fit: Fit, posterior: Posterior | None, gains: GainFit | None
) -> IdentifiedModel:
    """The model from the posterior, or from least squares without one.

    `precision` leaves out the model error, as the next log is fitted with the same model.
    """
    if posterior is None:
        precision = of_base(model, log_data.coefficients, fit.information)
        model_error_covariance = None if log_data.nuisance is None else _lacking(fit, log_data)
        by_gains = None if gains is None else spread_by_gains(gains, log_data)
        return IdentifiedModel(
            model, fit.theta, fit.noise, precision, model_error_covariance=model_error_covariance, by_gains=by_gains
        )
    basis = fit.plane.seen_by(log_data.coefficients.projection).basis
    known = basis @ _inverse(basis.T @ posterior.covariance_of_log @ basis) @ basis.T
    precision = of_base(model, log_data.coefficients, known)
    theta, log_scale = posterior.target.split(posterior.uncertain.spread(POSTERIOR.few_draws))
    log_gain = None if gains is None else posterior.gains_of(posterior.uncertain.places(POSTERIOR.few_draws))
    draws = ParameterDraws(theta, posterior.target.likelihood.sigma * np.exp(log_scale), log_gain)
    return IdentifiedModel(model, posterior.theta, fit.noise, precision, draws)


def _inverse(covariance: Array) -> Array:
    """Inverse of a covariance in mixed units, scaled to a diagonal of 1 first."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    inverse: Array = np.outer(scale, scale) * np.linalg.pinv(np.outer(scale, scale) * covariance, hermitian=True)
    return inverse
