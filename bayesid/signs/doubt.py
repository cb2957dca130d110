"""Doubt about signs because the model is not the robot's, joint by joint."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from scipy.ndimage import maximum_filter1d

from bayesid.arrays import TINY, Array, Integers
from bayesid.regression.moments import Moments, moments
from bayesid.regression.solver import ConeLeastSquares
from bayesid.signs.settling import Settled

_TOLERATED = 0.3
"""Model error, as a share of the effort, that casts no doubt on proven signs (study `misfit`)."""
_TOLERATED_UNPROVEN = 0.1
"""The same without a proof (study `misfit`)."""
_TO_A_GUESS = 0.7
"""So much more, and a sign is a guess in half of the cases (study `misfit`)."""
_SHARED = 0.6
"""Share of the worst joint's model error that all joints are suspected of: parameters are common to them (study
`misfit`)."""
_ALL_SETS = 7
"""Joints up to which all sets of them are turned, 127; of more, those of one or two, and all but one or none."""

_OUTLIER = 6.0
"""Standard deviations of the residual from which on a sample is an outlier. Set by hand: with 4, signs where friction
turns round lose confidence too."""


def structural_doubt(settled: Settled) -> Array:
    """(n,) probability, per joint, that signs are guesses because the model is not the robot's.

    A model that leaves a large lasting error of its own finds wrong signs that suit it, joints at a time, and every
    probability that is conditional on the model follows it. A rule of thumb (:eq:`doubt`), in whether a proof was had,
    in the lasting error of the joint itself, and in that of the worst joint, unless the other side of the joint would
    need errors larger still. `bayesid study misfit` shows what it does.
    """
    signals, fitted = settled.evidence.signals, settled.evidence.fitted
    square = np.where(fitted, signals.raw_effort**2, 0.0).sum(axis=0)
    effort = np.sqrt(square / np.maximum(fitted.sum(axis=0), 1))
    shown = fitted.any(axis=0)  # a joint whose efforts are all in fault shows no error
    error = np.where(shown, settled.fit.noise.coloured / np.maximum(effort, TINY), 0.0)
    proven = settled.signs.search.certified
    if not np.any(error > (_TOLERATED if proven else _TOLERATED_UNPROVEN)):
        return np.zeros(len(error))
    return np.where(signals.signed, 0.0, doubt_of(error, other_side(settled, effort), proven=proven))


def doubt_of(error: Array, other_side: Array, *, proven: bool) -> Array:
    """(n,) probability that signs are guesses (:eq:`doubt`).

    Args:
        error: (n,) lasting error of each joint, relative to its effort.
        other_side: (n,) see `other_side`.
        proven: whether the signs are.
    """
    tolerated, shared = _TOLERATED if proven else _TOLERATED_UNPROVEN, _SHARED * error.max()
    suspected = np.maximum(error, np.minimum(shared, 2.0 * shared - other_side))
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


def other_side(settled: Settled, effort: Array) -> Array:
    """(n,) error that the model would need besides if a joint's signs were all turned round, relative to the effort.

    Of the joint where it is largest, for those sets of joints turned together that need least.

    Args:
        settled: signs and fit.
        effort: (n,) RMS, N m.

    Raises:
        SolverError: a cone problem could not be solved.
    """
    evidence, segments = settled.evidence, settled.signs.segments[settled.signs.segments.fitted]
    motion, efforts = evidence.signals.motion, evidence.signals.effort
    raw = moments(evidence.model, evidence.coefficients, motion, efforts, segments, most_individual=1)
    scaled, n = raw.scaled(settled.signs.weights), len(effort)
    hessian, energy = scaled.hessian.total(), float(scaled.energy.sum())
    solver = ConeLeastSquares(evidence.model.cone, evidence.coefficients, hessian, energy)
    count = np.bincount(scaled.joint, weights=scaled.count, minlength=n)
    unit = settled.signs.weights / np.sqrt(np.maximum(count, 1.0)) / np.maximum(effort, TINY)
    needed = np.full(n, np.inf)
    for turned, rise in rises_by_joint(scaled, solver, settled.signs.search.signs, n):
        needed[turned] = np.minimum(needed[turned], np.max(unit * np.sqrt(np.maximum(rise, 0.0))))
    return needed


def rises_by_joint(
    scaled: Moments, solver: ConeLeastSquares, signs: Integers, n_joints: int
) -> Iterator[tuple[list[int], Array]]:
    """Sets of joints, and (n,) by how much the cost of each joint's rows rises if their signs (S,) are turned round.

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

    best, unknown = costs(signs), scaled.known == 0
    joints = np.unique(scaled.joint[unknown]).tolist()
    sizes = [k for k in range(1, len(joints) + 1) if len(joints) <= _ALL_SETS or k <= 2 or k >= len(joints) - 1]
    for turned in (list(chosen) for size in sizes for chosen in itertools.combinations(joints, size)):
        yield turned, costs(np.where(np.isin(scaled.joint, turned) & unknown, -signs, signs)) - best
