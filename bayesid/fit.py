"""Ordinary identification: the parameters and their uncertainty once the signs are known, or known but for chance.

Near zero nobody knows the sign of a noisy sample. Its expected sign takes its place: the equations
sum y_i (E[s_i] |tau|_i - y_i beta) = 0 are those of the maximum of the likelihood with the signs summed out, where the
likelier sign would pull every small effort away from zero.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayesid.coefficients import BaseCoefficients
from bayesid.errors import SolverError
from bayesid.knowledge import Information
from bayesid.model import Model
from bayesid.moments import Moments, moments
from bayesid.motion import Array, Mask
from bayesid.noise import Noise, noise_before_fit, relative_rms, residual_noise
from bayesid.segments import Segments
from bayesid.signals import Signals, signed_effort
from bayesid.solver import MARGIN, Solution, move_inside, solve_precisely

_MOST_CORRECTED = 30_000
"""Samples; what a fit takes from the noise of a longer log is not worth the while."""
_BLIND = 1e-10
"""Curvature, relative to the largest one, in which a fit to noise alone has no say."""


@dataclass(frozen=True)
class Fit:
    """Least squares in the cone on signed efforts.

    Attributes:
        theta: (P,) feasible parameters.
        beta: (r,) their base coefficients.
        covariance: (r, r) of the coefficients, from the information matrix with effective sample counts
            (:eq:`information`); inf on the diagonal where the log does not excite a coefficient.
        information: (r, r) that matrix, what was known before included.
        noise: of the efforts, per joint: what was there before the fit took its share.
        residual: of the residual itself, per joint.
        predicted: (N, n) the model's efforts, N m.
        relative_residual: (n,) RMS of the residual over RMS of the effort, in motion.
        condition: condition number of the regressor with columns of unit length (:eq:`condition-number`).
        smallest_eigenvalues: (links,) of the pseudo-inertias.
        tolerance: relative gap the solver reached.
        moved_inside: whether what leaves no trace was chosen to lie as far inside the cone as the data allow.
    """

    theta: Array
    beta: Array
    covariance: Array
    information: Array
    noise: Noise
    residual: Noise
    predicted: Array
    relative_residual: Array
    condition: float
    smallest_eigenvalues: Array
    tolerance: float
    moved_inside: bool

    @property
    def sd(self) -> Array:
        """(r,) standard deviations of the coefficients."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def on_edge(self) -> Mask:
        """(links,) whether a link's pseudo-inertia sits on the edge of the feasible set."""
        return self.smallest_eigenvalues < 10.0 * MARGIN


def fit_signed(
    model: Model, coefficients: BaseCoefficients, signals: Signals, signs: Array, moving: Mask,
    known: Information | None = None,
) -> Fit:  # fmt: skip
    """Ordinary identification once the signs are known: weighted least squares in the cone (:eq:`cone-least-squares`).

    Args:
        model: the model.
        coefficients: its base coefficients.
        signals: the log.
        signs: (N, n) expected sign of every sample: +1 or -1 where it is known, between them where it is not.
        moving: (N, n) samples that count.
        known: of the r coefficients, from earlier logs.

    Raises:
        SolverError: Clarabel failed.
    """
    used = moving & inner_samples(signals)
    raw = expected_moments(model, coefficients, signals, signs, _stretches(used))
    solution, sigma = _solve(model, coefficients, signals, raw, used, known)
    theta, moved_inside = _move_inside(model, coefficients, solution.theta)
    predicted = model.effort(signals.motion, theta)
    residual = residual_noise(_nearest(signals, predicted) - predicted, used, signals.rate)
    noise = _before_fit(model, coefficients, signals, used, sigma, predicted, residual, known)
    effort = signed_effort(signals, np.where(signs >= 0.0, 1.0, -1.0))
    effective = raw.scaled(noise.sigma * np.sqrt(noise.autocorrelation)).hessian.sum(axis=0)
    effective = effective if known is None else effective + known.hessian
    covariance, condition = _covariance(effective)
    return Fit(
        theta=theta,
        beta=coefficients.project(theta),
        covariance=covariance,
        information=effective,
        noise=noise,
        residual=residual,
        predicted=predicted,
        relative_residual=relative_rms(effort - predicted, effort, moving),
        condition=condition,
        smallest_eigenvalues=model.cone.smallest_eigenvalues(theta),
        tolerance=solution.tolerance,
        moved_inside=moved_inside,
    )


def _solve(
    model: Model, coefficients: BaseCoefficients, signals: Signals, raw: Moments, used: Mask,
    known: Information | None,
) -> tuple[Solution, Array]:  # fmt: skip
    """The best parameters in the cone, and (n,) the residuals' sd, N m.

    The noise levels follow from a first fit with equal relative weights. Where something is known beforehand, samples
    count by the residual's autocorrelation: only then can the two be weighed against each other.
    """
    sigma, n = raw.rms_effort(model.robot.n_joints), model.robot.n_joints
    rounds = 2 if known is None else 3
    given = Information.none(len(coefficients)) if known is None else known
    as_one = np.ones(n)
    for i in range(rounds):
        scaled = raw.scaled(sigma * np.sqrt(as_one))
        hessian = scaled.hessian.sum(axis=0) + given.hessian
        gradient = scaled.gradient.sum(axis=0) + given.gradient
        energy = float(scaled.energy.sum()) + given.energy
        solution = solve_precisely(model.cone, coefficients, hessian, gradient, energy)
        sigma = raw.residual_sd(coefficients.project(solution.theta), raw.known, n)
        if known is not None and i + 1 < rounds:
            predicted = model.effort(signals.motion, solution.theta)
            as_one = residual_noise(_nearest(signals, predicted) - predicted, used, signals.rate).autocorrelation
    return solution, sigma


def expected_moments(
    model: Model, coefficients: BaseCoefficients, signals: Signals, signs: Array, segments: Segments,
    own: int | None = None,
) -> Moments:  # fmt: skip
    """Moments of the unfiltered efforts (a filter would blur friction's steps, not the columns') in expected signs.

    Args:
        model: the model.
        coefficients: its r base coefficients.
        signals: the log.
        signs: (N, n) expected sign of every sample, -1 to +1.
        segments: where to sum.
        own: see `bayesid.moments.moments`.
    """
    effort = signed_effort(signals, signs, filtered=False)
    return moments(model, coefficients, signals.motion, effort, segments, own, square=signals.raw_effort**2)


# ---------------------------------------------------------------------------------------------------------------
# Noise
# ---------------------------------------------------------------------------------------------------------------
def _nearest(signals: Signals, predicted: Array) -> Array:
    """(N, n) efforts, N m, with the sign of the prediction where they have none of their own."""
    signs = np.where(predicted >= 0.0, 1.0, -1.0)
    return np.where(signals.signed, signals.raw_effort, signs * np.abs(signals.raw_effort))


def _before_fit(
    model: Model, coefficients: BaseCoefficients, signals: Signals, used: Mask, sigma: Array, predicted: Array,
    residual: Noise, known: Information | None,
) -> Noise:  # fmt: skip
    """The noise of the efforts from that of the residual; of a long log the residual's own."""
    if len(used) > _MOST_CORRECTED:
        return residual.with_time_of_model(signals.rate)
    columns = np.concatenate([rows[:, :, coefficients.kept] for _, rows in model.chunks(signals.motion)])
    given = np.zeros((len(coefficients),) * 2) if known is None else known.hessian
    residuals = _refit(np.where(used[:, :, None], columns, 0.0), sigma, given)
    signs = np.where(predicted >= 0.0, 1.0, -1.0)[:, :, None]

    def after_fit(noise: Array) -> Array:
        noisy = predicted[:, :, None] + noise
        nearest = np.where(signals.signed[:, None], noisy, signs * np.abs(noisy))  # as for the residual itself
        return residuals(np.where(used[:, :, None], nearest - predicted[:, :, None], 0.0))

    return noise_before_fit(residual, after_fit, used, signals.rate)


def _refit(columns: Array, sigma: Array, given: Array) -> Callable[[Array], Array]:
    """What least squares without the cone leaves of (N, n, K) efforts.

    For columns (N, n, r), sigma (n,) and what is given beforehand (r, r).
    """
    rows = (columns / sigma[:, None]).reshape(-1, columns.shape[2])
    information = rows.T @ rows + given
    lengths = np.sqrt(np.maximum(np.diag(information), _BLIND * np.diag(information).max()))
    inverse = np.linalg.pinv(information / np.outer(lengths, lengths), rcond=_BLIND, hermitian=True)
    inverse /= np.outer(lengths, lengths)

    def residuals(effort: Array) -> Array:
        scaled = (effort / sigma[:, None]).reshape(len(rows), -1)
        left: Array = (scaled - rows @ (inverse @ (rows.T @ scaled))).reshape(effort.shape) * sigma[:, None]
        return left

    return residuals


def _move_inside(model: Model, coefficients: BaseCoefficients, theta: Array) -> tuple[Array, bool]:
    """Parameters farther inside the cone with the same coefficients, and whether any were found; else theta itself."""
    try:
        moved = move_inside(model.cone, coefficients, theta)
    except SolverError:
        return theta, False
    least, before = (model.cone.smallest_eigenvalues(point).min(initial=np.inf) for point in (moved, theta))
    better = least >= before
    return (moved, True) if better else (theta, False)


def inner_samples(signals: Signals) -> Mask:
    """(N, 1) samples far enough from both ends for their accelerations to be trusted: half a period of the cut-off."""
    margin = 0.5 / signals.cutoff
    t = signals.motion.t
    return ((t >= t[0] + margin) & (t <= t[-1] - margin))[:, None]


def _stretches(moving: Mask) -> Segments:
    """One segment of known sign for every stretch in which a joint moves."""
    joint, start, end = [], [], []
    for j in range(moving.shape[1]):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], moving[:, j], [False]]).astype(int)))
        joint += [j] * (len(edges) // 2)
        start += edges[0::2].tolist()
        end += edges[1::2].tolist()
    ones = np.ones(len(joint), dtype=np.int64)
    return Segments(np.array(joint), np.array(start), np.array(end), ones, ones.astype(bool))


def _covariance(information: Array) -> tuple[Array, float]:
    """Covariance of the coefficients (inf where the data say nothing) and the scaled condition number."""
    lengths = np.sqrt(np.diag(information))
    silent = lengths <= 1e-12 * lengths.max()
    scale = np.where(silent, 0.0, 1.0 / np.where(silent, 1.0, lengths))
    values, vectors = np.linalg.eigh(scale[:, None] * information * scale + np.diag(silent.astype(float)))
    blind = values < 1e-12 * values.max()
    inverse = (vectors[:, ~blind] / values[~blind]) @ vectors[:, ~blind].T
    covariance = scale[:, None] * inverse * scale
    unexcited = silent | (np.abs(vectors[:, blind]) > 1e-3).any(axis=1)
    covariance[unexcited, unexcited] = np.inf
    condition = np.inf if unexcited.any() else float(np.sqrt(values[-1] / values[0]))
    return covariance, condition
