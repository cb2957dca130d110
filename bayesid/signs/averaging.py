"""Bayesian averaging of two models, and limits on confidences if no model explains the log.

A model without friction explains |effort| of a friction-dominated joint best with wrong signs: friction that only
changes its sign is a constant after the rectifier. No noise estimate shows that, but a second model does. So if a model
lacks a standard effect (`bayesid.effects.STANDARD`) and its residual is correlated, the signs are searched with these
effects too. Both models are averaged with their weights (Bayesian model averaging).

If the model error is large (`model_error_probabilities`), all signs of a joint may be wrong. This limits the confidence
of each of its signs.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.special import expit

from bayesid.arrays import TINY, Array, Integers
from bayesid.effects import STANDARD, catalogue
from bayesid.effects.model import Model
from bayesid.log.segments import Segments
from bayesid.log.signals import Signals
from bayesid.progress import SILENT, Progress
from bayesid.regression.least_squares import Fit, fit_signed
from bayesid.regression.noise import rms_where, times_of
from bayesid.regression.normal_equations import NormalEquations, normal_equations
from bayesid.regression.solver import ConeLeastSquares
from bayesid.signs.search.protocol import Search, SignProblem, with_flipped
from bayesid.signs.sign_solution import SignSolution, find_signs
from bayesid.signs.tuning import TUNING


@dataclass(frozen=True)
class AveragedSigns:
    """Signs under the requested model and, if needed, a richer one."""

    requested: SignSolution  # signs under the requested model
    sign_solution: SignSolution  # signs under the model of the larger weight; it defines segments and their signs
    fit: Fit  # of the requested model
    probability: Array  # (N, n) P(sign = +) of every sample, averaged over both models
    weight: float  # of the weightier model

    @classmethod
    def alone(cls, requested: SignSolution) -> AveragedSigns:
        """The requested model alone."""
        return cls(requested, requested, requested.fit, requested.probability, 1.0)

    @classmethod
    def of(cls, requested: SignSolution, rival: SignSolution) -> AveragedSigns:
        """The weighted average of two models."""
        weight = weight_against(rival, requested)
        probability = weight * rival.probability + (1.0 - weight) * requested.probability
        if weight < 0.5:
            return cls(requested, requested, requested.fit, probability, 1.0 - weight)
        # signs of the weightier model alone: averaged ones would bias the fit, as the weight is the same for all signs
        signs = 2.0 * rival.probability - 1.0
        fit = fit_signed(replace(requested.log_data, fitted=rival.log_data.fitted), signs)
        return cls(requested, rival, fit, probability, weight)

    @property
    def mixed(self) -> Array:
        """(N, n) P(sign = +) of every sample, alternative assignments included (:eq:`mixed-signs`)."""
        return self.sign_solution.mixed_with(self.probability)

    @property
    def by_requested(self) -> bool:
        """Whether the requested model has the larger weight."""
        return self.sign_solution is self.requested


def average_over_models(
    requested: SignSolution, segments: Segments, search: Search, progress: Progress = SILENT
) -> AveragedSigns:
    """Averages with the signs under all standard effects, if the model lacks some and its residual is correlated.

    Raises:
        SolverError: an optimisation failed.
    """
    model = richer_model(requested) if search.any_model else None
    if model is None:
        return AveragedSigns.alone(requested)
    signals = requested.log_data.signals
    rival = find_signs(model, signals, segments, search, progress.under("standard effects"))
    return AveragedSigns.of(requested, rival)


def richer_model(sign_solution: SignSolution) -> Model | None:
    """The model with all standard effects, if it lacks some and its residual is correlated; else None."""
    residual, signals = sign_solution.fit.residual, sign_solution.log_data.signals
    if signals.signed.all() or np.all(residual.coloured < TUNING.coloured_ratio * residual.white):
        return None
    return with_standard_terms(sign_solution.model, signals)


def with_standard_terms(model: Model, signals: Signals) -> Model | None:
    """The model with all standard effects; None if it has them."""
    names = {term.name for term in model.terms}
    missing = [name for name in STANDARD if name not in names]
    if not missing:
        return None
    for term in catalogue.make_terms(missing, model.robot, signals.motion):
        model = model.extend(term)
    return model


def weight_against(rival: SignSolution, requested: SignSolution) -> float:
    """Weight of a richer model against the one it extends, by the Bayesian information criterion on effective samples.

    Each joint's samples are divided by the longer autocorrelation time of the two residuals (:eq:`model-weight`).
    """
    return min(TUNING.largest_weight, float(expit(0.5 * evidence_gain(rival, requested))))


def evidence_gain(rival: SignSolution, requested: SignSolution) -> float:
    """Fall of the Bayesian information criterion from the requested to the richer model.

    Both models are compared on the same samples and readings, before any sensor correction.
    """
    samples, rate = requested.log_data.used | rival.log_data.used, requested.log_data.signals.rate
    after, before = (np.maximum(rms_where(solution.error, samples), TINY) for solution in (rival, requested))
    time = np.maximum(*(times_of(solution.error, samples, rate) for solution in (rival, requested)))
    count = samples.sum(axis=0) / time
    gain = 2.0 * float(count @ np.log(before / after))
    more = len(rival.log_data.coefficients) - len(requested.log_data.coefficients)
    return gain - more * float(np.log(count.sum()))


def model_error_probabilities(sign_solution: SignSolution) -> Array:
    """(n,) probability, per joint, that signs are arbitrary because the model does not fit the robot.

    A model with a large correlated error finds wrong signs that fit it, for whole joints. All probabilities given the
    model are then wrong too. This rule of thumb (:eq:`model_error_probability`) depends on whether there is a proof, on
    the joint's correlated error, and on that of the worst joint. The probability is lower if flipping the joint would
    need a much larger error. `bayesid study misfit` measures it.
    """
    signals, fitted = sign_solution.log_data.signals, sign_solution.log_data.fitted
    square = np.where(fitted, signals.raw_effort**2, 0.0).sum(axis=0)
    effort = np.sqrt(square / np.maximum(fitted.sum(axis=0), 1))
    shown = fitted.any(axis=0)  # a joint with only invalid efforts has no error
    error = np.where(shown, sign_solution.fit.noise.coloured / np.maximum(effort, TINY), 0.0)
    proven = sign_solution.signs.search.certified
    if not np.any(error > (TUNING.tolerated_error if proven else TUNING.tolerated_error_unproven)):
        return np.zeros(len(error))
    return np.where(
        signals.signed, 0.0, arbitrary_sign_probability(error, error_if_flipped(sign_solution, effort), proven=proven)
    )


def arbitrary_sign_probability(error: Array, error_if_flipped: Array, *, proven: bool) -> Array:
    """(n,) probability that signs are arbitrary (:eq:`model_error_probability`), from relative errors (n,)."""
    tolerated, shared = (
        TUNING.tolerated_error if proven else TUNING.tolerated_error_unproven,
        TUNING.shared_error * error.max(),
    )
    assumed_error = np.maximum(error, np.minimum(shared, 2.0 * shared - error_if_flipped))
    model_error_probability: Array = 0.5 * np.clip((assumed_error - tolerated) / TUNING.error_of_a_guess, 0.0, 1.0)
    return model_error_probability


def tempered_by_outliers(sign_solution: SignSolution, probability: Array) -> Array:
    """(N, n) P(sign = +), with less confidence where neither sign explains |effort| (:eq:`outliers`).

    Outliers come in runs, such as a shock or a vibration, and count as one event. Within the residual's autocorrelation
    time of an outlier, the confidence is at most that of a single sample with a density that falls with the square of
    the error.
    """
    signals, fit = sign_solution.log_data.signals, sign_solution.fit
    effort, predicted = signals.magnitude, np.abs(fit.predicted)
    near, far = (effort - predicted) ** 2, (effort + predicted) ** 2
    outlier = sign_solution.log_data.moving & (near > (TUNING.outlier * fit.residual.sigma) ** 2)
    reach = np.ceil(fit.residual.autocorrelation).astype(int)
    around = [maximum_filter1d(outlier[:, j], 2 * reach[j] + 1) for j in range(outlier.shape[1])]
    most = np.where(np.transpose(around), far / np.maximum(near + far, TINY), 1.0)
    return np.where(signals.signed, probability, np.clip(probability, 1.0 - most, most))


def error_if_flipped(sign_solution: SignSolution, effort: Array) -> Array:
    """(n,) additional model error needed if all of a joint's signs were flipped, relative to effort (n,).

    For the set of flipped joints that needs the smallest error, in the joint where it is largest.
    """
    log_data, segments = sign_solution.log_data, sign_solution.signs.fitted
    motion, efforts = log_data.signals.motion, log_data.signals.effort
    raw = normal_equations(log_data.model, log_data.coefficients, motion, efforts, segments, most_individual=1)
    scaled, n = raw.scaled(sign_solution.signs.weights), len(effort)
    solver = SignProblem(scaled, log_data.model.cone, log_data.coefficients).solver()
    count = np.bincount(scaled.joint, weights=scaled.count, minlength=n)
    unit = sign_solution.signs.weights / np.sqrt(np.maximum(count, 1.0)) / np.maximum(effort, TINY)
    needed = np.full(n, np.inf)
    for flipped, rise in rises_by_joint(scaled, solver, sign_solution.signs.search.signs, n):
        needed[flipped] = np.minimum(needed[flipped], np.max(unit * np.sqrt(np.maximum(rise, 0.0))))
    return needed


def rises_by_joint(
    scaled: NormalEquations, solver: ConeLeastSquares, signs: Integers, n_joints: int
) -> Iterator[tuple[list[int], Array]]:
    """Sets of joints, and (n,) rise of each joint's cost if the signs (S,) of the set are flipped."""
    prepared = solver.prepared()
    grams = [scaled.hessian_of(np.flatnonzero(scaled.joint == j)) for j in range(n_joints)]

    def costs(assignment: Integers) -> Array:
        """(n,) cost of each joint's rows, without their energy."""
        gradient = assignment[:, None] * scaled.gradient
        beta = prepared.project(prepared.solve(gradient.sum(axis=0)).theta)
        linear = np.bincount(scaled.joint, weights=gradient @ beta, minlength=n_joints)
        return np.array([beta @ gram @ beta for gram in grams]) - 2.0 * linear

    best, joints = costs(signs), np.unique(scaled.joint[scaled.known == 0]).tolist()
    sizes = [
        k
        for k in range(1, len(joints) + 1)
        if len(joints) <= TUNING.joints_in_all_sets or k <= 2 or k >= len(joints) - 1
    ]
    for flipped in (list(chosen) for size in sizes for chosen in itertools.combinations(joints, size)):
        yield flipped, costs(with_flipped(scaled, signs, flipped)) - best
