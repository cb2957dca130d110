"""Doubt about signs because the model is not the robot's, joint by joint."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d

from bayesid.arrays import TINY, Array, Integers
from bayesid.fit.moments import Moments, moments
from bayesid.fit.solver import ConeLeastSquares
from bayesid.signs.settling import Settled

_TOLERATED = 0.3
"""Model error, as a share of the effort, that casts no doubt on proven signs (study `misfit`)."""
_TOLERATED_UNPROVEN = 0.1
"""The same without a proof (study `misfit`)."""
_TO_A_GUESS = 0.7
"""So much more, and a sign is a guess in half of the cases (study `misfit`)."""

_OUTLIER = 6.0
"""Standard deviations of the residual from which on a sample is an outlier: real residuals reach 5 where friction turns
round, a shock on the KR300 is 7."""


def structural_doubt(settled: Settled) -> Array:
    """(n,) probability, per joint, that signs are guesses because the model is not the robot's.

    A model that leaves a large lasting error of its own finds wrong signs that suit it, a joint at a time, and every
    probability that is conditional on the model follows it. A rule of thumb, in whether a proof was had and in the size
    of the lasting error relative to the effort: of the joint itself, or of those joints whose rows decide its signs, if
    that is larger (:eq:`doubt`). `bayesid study misfit` shows what it does.
    """
    signals, fitted = settled.evidence.signals, settled.evidence.fitted
    square = np.where(fitted, signals.raw_effort**2, 0.0).sum(axis=0)
    effort = np.sqrt(square / np.maximum(fitted.sum(axis=0), 1))
    shown = fitted.any(axis=0)  # a joint whose efforts are all in fault shows no error
    error = np.where(shown, settled.fit.noise.coloured / np.maximum(effort, TINY), 0.0)
    proven = settled.signs.search.certified
    if not np.any(error > (_TOLERATED if proven else _TOLERATED_UNPROVEN)):
        return np.zeros(len(error))
    return np.where(signals.signed, 0.0, doubt_of(error, dependence(settled), proven=proven))


def doubt_of(error: Array, dependence: Array, *, proven: bool) -> Array:
    """(n,) probability that signs are guesses (:eq:`doubt`).

    Args:
        error: (n,) lasting error of each joint, relative to its effort.
        dependence: (n, n) see `dependence`.
        proven: whether the signs are.
    """
    tolerated = _TOLERATED if proven else _TOLERATED_UNPROVEN
    suspected = np.maximum(error, dependence @ error)
    doubt: Array = 0.5 * np.clip((suspected - tolerated) / _TO_A_GUESS, 0.0, 1.0)
    return doubt


def tempered_by_outliers(settled: Settled, probability: Array) -> Array:
    """(N, n) P(sign = +) with less confidence where the model explains |effort| with neither sign (:eq:`outliers`).

    Such samples come in runs, a shock or a vibration of the drive, and their errors are one event. So within the
    residual's autocorrelation time of an outlier, confidence is bounded by what a sample says of its sign by itself: by
    a density that falls with the square of the error.

    Args:
        settled: signs and fit.
        probability: (N, n) P(sign = +).
    """
    signals, fit = settled.evidence.signals, settled.fit
    effort, predicted = signals.magnitude, np.abs(fit.predicted)
    near, far = (effort - predicted) ** 2, (effort + predicted) ** 2
    outlier = settled.evidence.moving & (near > (_OUTLIER * fit.residual.sigma) ** 2)
    reach = np.ceil(fit.residual.autocorrelation).astype(int)
    around = [maximum_filter1d(outlier[:, j], 2 * reach[j] + 1) for j in range(outlier.shape[1])]
    most = np.where(np.transpose(around), far / np.maximum(near + far, TINY), 1.0)
    return np.where(signals.signed, probability, np.clip(probability, 1.0 - most, most))


def dependence(settled: Settled) -> Array:
    """(n, n) share of what decides a joint's signs, a row each, that comes from the rows of each joint.

    That is the rise of the cost, joint by joint, when all signs of a joint are turned round.

    Raises:
        SolverError: a cone problem could not be solved.
    """
    evidence, segments = settled.evidence, settled.signs.segments[settled.signs.segments.fitted]
    motion, effort = evidence.signals.motion, evidence.signals.effort
    raw = moments(evidence.model, evidence.coefficients, motion, effort, segments, most_individual=1)
    scaled = raw.scaled(settled.signs.weights)
    hessian, energy = scaled.hessian.total(), float(scaled.energy.sum())
    solver = ConeLeastSquares(evidence.model.cone, evidence.coefficients, hessian, energy)
    return shares_by_joint(scaled, solver, settled.signs.search.signs, evidence.model.robot.n_joints)


def shares_by_joint(scaled: Moments, solver: ConeLeastSquares, signs: Integers, n_joints: int) -> Array:
    """(n, n) `dependence` of the signs (S,) of moments in units of the noise.

    Raises:
        SolverError: a cone problem could not be solved.
    """
    prepared = solver.prepared()
    grams = [scaled.hessian_of(np.flatnonzero(scaled.joint == j)) for j in range(n_joints)]

    def costs(assignment: Integers) -> Array:
        """(n,) of each joint's rows, but for their energy."""
        gradient = assignment[:, None] * scaled.gradient
        beta = prepared.project(prepared.solve(gradient.sum(axis=0)).theta)
        linear = np.bincount(scaled.joint, weights=gradient @ beta, minlength=n_joints)
        return np.array([beta @ gram @ beta for gram in grams]) - 2.0 * linear

    best, shares = costs(signs), np.eye(n_joints)
    for j in np.unique(scaled.joint[scaled.known == 0]).tolist():
        turned = np.where((scaled.joint == j) & (scaled.known == 0), -signs, signs)
        rise = np.maximum(costs(turned) - best, 0.0)
        shares[j] = rise / rise.sum() if rise.sum() > 0.0 else shares[j]
    return shares
