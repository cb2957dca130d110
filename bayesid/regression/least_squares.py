"""Least squares with known signs: parameters and their uncertainty.

Near zero effort a sample's sign is uncertain. Its expected sign is used: sum y_i (E[s_i] |tau|_i - y_i beta) = 0 are
the equations of the maximum likelihood with the signs summed out. The likelier sign would bias small efforts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects.plane import Plane
from bayesid.errors import SolverError
from bayesid.log.segments import Segments
from bayesid.log.signals import signed_effort
from bayesid.number_text import percent
from bayesid.regression.interior import interior_point
from bayesid.regression.knowledge import InformationMatrix
from bayesid.regression.log_data import LogData
from bayesid.regression.noise import Noise, noise_before_fit, relative_rms
from bayesid.regression.normal_equations import NormalEquations
from bayesid.regression.solver import MARGIN, Solution, solve_precisely
from bayesid.regression.tuning import TUNING

_SIMULATION_CUTOFF = 1e-10
"""Curvature over the largest one, below which the fit to simulated noise drops a direction."""
_ROUNDING_OF_COLUMN = 1e-12
"""Length of a column, or curvature of unit columns, over the largest one, below which it is rounding."""
_ROUNDING_OF_SHARE = 1e-9
"""Share of a coefficient below which a parameter's contribution is rounding."""


@dataclass(frozen=True)
class Fit:
    """Least squares in the cone on signed efforts.

    Attributes:
        theta: (P,) feasible parameters.
        beta: (r,) their base coefficients.
        covariance: (r, r) of the coefficients, with effective sample counts (:eq:`information`) and model error; inf
            on the diagonal where the log does not excite a coefficient.
        information: (r, r) with the prior information, without model error: the prior of the next log.
        noise: of the efforts per joint, corrected for what the fit absorbed.
        residual: of the residual itself, per joint.
        predicted: (N, n) the model's efforts, N m.
        relative_residual: (n,) RMS of the residual over RMS of the effort, in motion.
        condition: condition number of the regressor with columns of unit length (:eq:`condition-number`).
        smallest_eigenvalues: (links,) of the pseudo-inertias.
        tolerance: relative gap that the solver reached.
        moved_inside: whether parameters without effect were moved inside the cone.
        plane: plane to which equalities confine theta, and the covariances.
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
    plane: Plane

    def __repr__(self) -> str:
        residual = ", ".join(percent(share, 1) for share in self.relative_residual)
        size = f"{len(self.theta)} parameters, {len(self.beta)} coefficients"
        return f"Fit of {size}: relative residuals {residual}; condition number {self.condition:.0f}"

    @property
    def sd(self) -> Array:
        """(r,) standard deviations of the coefficients."""
        return np.sqrt(np.diag(self.covariance))

    def parameter_sd(self, projection: Array) -> Array:
        """(P,) standard deviations of the parameters, by B (r, P); NaN where a parameter is not identifiable."""
        return np.sqrt(np.diag(self.parameter_covariance(projection)))

    def parameter_covariance(self, projection: Array) -> Array:
        """(P, P) covariance of the parameters, by B (r, P); NaN where a parameter is not identifiable."""
        basis, finite = self.plane.basis, np.isfinite(self.sd)
        lift = basis @ np.linalg.pinv(projection @ basis)
        decided = np.abs(lift @ projection @ basis - basis).max(axis=1, initial=0.0) < _ROUNDING_OF_SHARE
        decided &= ~(np.abs(lift[:, ~finite]) > _ROUNDING_OF_COLUMN).any(axis=1)
        known = lift[:, finite]
        covariance = known @ self.covariance[np.ix_(finite, finite)] @ known.T
        np.fill_diagonal(covariance, np.maximum(np.diag(covariance), 0.0))
        return np.where(np.outer(decided, decided), covariance, np.nan)

    @property
    def on_edge(self) -> Mask:
        """(links,) whether a link's pseudo-inertia is on the edge of the cone."""
        return self.smallest_eigenvalues < TUNING.near_edge * MARGIN


def fit_signed(log_data: LogData, signs: Array, *, most_corrected: int = TUNING.most_corrected) -> Fit:
    """Weighted least squares in the cone once the signs are known (:eq:`cone-least-squares`).

    Args:
        log_data: the model, the log and the used samples.
        signs: (N, n) expected sign of every sample, -1 to +1.
        most_corrected: largest number of samples for which the noise is corrected for what the fit absorbed.

    Raises:
        SolverError: Clarabel failed.
    """
    model, signals, information = log_data.model, log_data.signals, log_data.information
    stretches = constant_stretches(log_data.used)
    normal_equations = log_data.normal_equations(signs, stretches, summed_out=False)
    solution, sigma = _solve(log_data, normal_equations)
    theta, moved_inside = _interior(log_data, solution.theta)
    predicted = model.effort(signals.motion, theta)
    residual = log_data.residual_noise(predicted)
    if len(signs) > most_corrected:
        noise = residual.with_time_of_model(signals.rate)
    else:
        noise = _before_fit(log_data, sigma, predicted, residual)
    effort = signed_effort(signals, np.where(signs >= 0.0, 1.0, -1.0))
    weights = noise.sigma * np.sqrt(noise.autocorrelation)
    effective = _effective(normal_equations, weights, information)
    plane = model.cone.plane()
    covariance, condition = covariance_of(effective, plane.seen_by(log_data.coefficients.projection))
    fit = Fit(
        theta=theta,
        beta=log_data.coefficients.project(theta),
        covariance=covariance,
        information=effective,
        noise=noise,
        residual=residual,
        predicted=predicted,
        relative_residual=relative_rms(effort - predicted, effort, log_data.fitted),
        condition=condition,
        smallest_eigenvalues=model.cone.smallest_eigenvalues(theta),
        tolerance=solution.tolerance,
        moved_inside=moved_inside,
        plane=plane,
    )
    return fit if log_data.nuisance is None else widened(fit, log_data, signs)


def widened(fit: Fit, log_data: LogData, signs: Array) -> Fit:
    """The fit with the nuisance effects marginalised; only the covariance changes (:eq:`nuisance-spread`)."""
    weights = fit.noise.sigma * np.sqrt(fit.noise.autocorrelation)
    normal_equations = log_data.normal_equations(signs, constant_stretches(log_data.used))
    effective, plane = _effective(normal_equations, weights, log_data.information), fit.plane
    return replace(fit, covariance=covariance_of(effective, plane.seen_by(log_data.coefficients.projection))[0])


def _effective(normal_equations: NormalEquations, weights: Array, earlier: InformationMatrix | None) -> Array:
    """(r, r) information matrix with the noise weights (n,), autocorrelation included."""
    hessian: Array = normal_equations.scaled(weights).hessian.total()
    return hessian if earlier is None else hessian + earlier.hessian


def _solve(log_data: LogData, normal_equations: NormalEquations) -> tuple[Solution, Array]:
    """The best parameters in the cone, and (n,) the residuals' sd, N m; the first fit weighs all joints equally.

    With prior information, samples count by the residual's autocorrelation time.
    """
    model, coefficients, n = log_data.model, log_data.coefficients, log_data.model.robot.n_joints
    sigma, autocorrelation = normal_equations.rms_effort(n), np.ones(n)
    rounds = 2 if log_data.information is None else 3
    earlier = InformationMatrix.none(len(coefficients)) if log_data.information is None else log_data.information
    for i in range(rounds):
        scaled = normal_equations.scaled(sigma * np.sqrt(autocorrelation))
        hessian = scaled.hessian.total() + earlier.hessian
        gradient = scaled.gradient.sum(axis=0) + earlier.gradient
        energy = float(scaled.energy.sum()) + earlier.energy
        solution = solve_precisely(model.cone, coefficients, hessian, gradient, energy)
        sigma = normal_equations.residual_sd(coefficients.project(solution.theta), normal_equations.known, n)
        if log_data.information is not None and i + 1 < rounds:
            predicted = model.effort(log_data.signals.motion, solution.theta)
            autocorrelation = log_data.residual_noise(predicted).autocorrelation
    return solution, sigma


def _before_fit(log_data: LogData, sigma: Array, predicted: Array, residual: Noise) -> Noise:
    signals, used = log_data.signals, log_data.used
    earlier = 0.0 if log_data.information is None else log_data.information.hessian
    columns = log_data.columns  # a new array, changed in place
    columns[~used] = 0.0
    columns /= sigma[:, None]
    plane = log_data.model.cone.plane().seen_by(log_data.coefficients.projection)
    if not plane.is_whole:
        columns, earlier = columns @ plane.basis, plane.basis.T @ (earlier * np.eye(len(plane.origin))) @ plane.basis
    residuals = _refit(columns, sigma, earlier)
    signs = np.where(predicted >= 0.0, 1.0, -1.0)[:, :, None]

    def after_fit(noise: Array) -> Array:
        noisy = predicted[:, :, None] + noise
        nearest = np.where(signals.signed[:, None], noisy, signs * np.abs(noisy))  # signs as in the residual itself
        return residuals(np.where(used[:, :, None], nearest - predicted[:, :, None], 0.0))

    return noise_before_fit(residual, after_fit, used, signals.rate)


def _refit(columns: Array, sigma: Array, earlier: Array | float) -> Callable[[Array], Array]:
    """A function: residuals of (N, n, K) efforts after unconstrained least squares; columns (N, n, r) over sigma."""
    rows = columns.reshape(-1, columns.shape[2])
    information = rows.T @ rows + earlier
    lengths = np.sqrt(np.maximum(np.diag(information), _SIMULATION_CUTOFF * np.diag(information).max()))
    inverse = np.linalg.pinv(information / np.outer(lengths, lengths), rcond=_SIMULATION_CUTOFF, hermitian=True)
    inverse /= np.outer(lengths, lengths)

    def residuals(effort: Array) -> Array:
        scaled = (effort / sigma[:, None]).reshape(len(rows), -1)
        remainder: Array = (scaled - rows @ (inverse @ (rows.T @ scaled))).reshape(effort.shape) * sigma[:, None]
        return remainder

    return residuals


def _interior(log_data: LogData, theta: Array) -> tuple[Array, bool]:
    """Parameters farther inside the cone with the same coefficients, and True; else theta and False."""
    cone = log_data.model.cone
    try:
        moved = interior_point(cone, log_data.coefficients, theta)
    except SolverError:
        return theta, False
    least, before = (cone.smallest_eigenvalues(point).min(initial=np.inf) for point in (moved, theta))
    return (moved, True) if least >= before else (theta, False)


def constant_stretches(moving: Mask) -> Segments:
    """One segment of known sign for every stretch in which a joint moves."""
    joint, start, end = [], [], []
    for j in range(moving.shape[1]):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], moving[:, j], [False]]).astype(int)))
        joint += [j] * (len(edges) // 2)
        start += edges[0::2].tolist()
        end += edges[1::2].tolist()
    ones = np.ones(len(joint), dtype=np.int64)
    return Segments(np.array(joint), np.array(start), np.array(end), ones, ones.astype(bool))


def covariance_of(information: Array, plane: Plane | None = None) -> tuple[Array, float]:
    """(r, r) covariance of coefficients from their information, and the condition number.

    Diagonal entries are inf without information. A plane confines the coefficients.
    """
    if plane is not None and not plane.is_whole:
        inner, condition = covariance_of(plane.basis.T @ information @ plane.basis)
        blind = np.isinf(np.diag(inner))
        inner[blind, blind] = 0.0
        covariance = plane.basis @ inner @ plane.basis.T
        unexcited = (np.abs(plane.basis[:, blind]) > TUNING.not_excited).any(axis=1)
        covariance[unexcited, unexcited] = np.inf
        return covariance, condition
    lengths = np.sqrt(np.diag(information))
    silent = lengths <= _ROUNDING_OF_COLUMN * lengths.max()
    scale = np.where(silent, 0.0, 1.0 / np.where(silent, 1.0, lengths))
    values, vectors = np.linalg.eigh(scale[:, None] * information * scale + np.diag(silent.astype(float)))
    blind = values < _ROUNDING_OF_COLUMN * values.max()
    inverse = (vectors[:, ~blind] / values[~blind]) @ vectors[:, ~blind].T
    covariance = scale[:, None] * inverse * scale
    unexcited = silent | (np.abs(vectors[:, blind]) > TUNING.not_excited).any(axis=1)
    covariance[unexcited, unexcited] = np.inf
    condition = np.inf if unexcited.any() else float(np.sqrt(values[-1] / values[0]))
    return covariance, condition
