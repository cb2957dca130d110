"""Least squares in the cone with stated constraints: the best feasible parameters for given normal equations.

:eq:`cone-least-squares`::

    minimise  theta' B' H B theta - 2 g' B theta + rho(theta)   subject to  theta in the cone (with a margin).

Some parameters have no effect on the efforts, and the cone's projection on the coefficients is not closed: a first
moment is free if a mass without effect may grow without limit. A weak Tikhonov term,
rho(theta) = w sum ((theta_k - typical_k) / size_k)^2 with w = 1e-4 (:eq:`tikhonov`), determines them. It costs 0.5 nat
at a distance of a hundred sizes, so it does not affect what the data determine.

Equalities are eliminated: theta / size = z0 + N y, with y in place of theta (`bayesid.effects.plane`). The cone, the
solver and the cost's bound are then those of y.

`ConeLeastSquares` states the cone once. `prepared` makes a solver for one H, which solves for one g after the other in
a few milliseconds each. Only the status "solved" counts as a result.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import clarabel
import numpy as np
import scipy
from scipy.linalg import solve_triangular

from bayesid.arrays import TINY, Array
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.parameters import Cone
from bayesid.effects.plane import Plane
from bayesid.errors import SolverError
from bayesid.regression.conic import (
    Outcome,
    cones_of,
    into_cone,
    linear_count,
    offsets_of,
    rows_of,
    settings_of,
    solved,
    stacked,
    typical_parameters,
    typical_sizes,
    units_of,
)
from bayesid.regression.tuning import TUNING

MARGIN = 1e-6
"""Smallest eigenvalue of a pseudo-inertia (kg m^2 to kg): far below that of any link, far above rounding."""
_NO_TRACE = 1e-8
"""Parameters whose columns cancel to this share have no effect: the tolerance of the base coefficients, squared."""
_CANCELS = 1e-14
"""Share of a row's length below which its entries along a plane are rounding."""
_NEGLIGIBLE = 1e-12
"""Share of the largest curvature below which a parameter has no effect: the size of rounding."""


class _Attempt(NamedTuple):
    """Settings of one attempt.

    Attributes:
        coarser: factor on the requested tolerance.
        equilibrate: whether Clarabel scales the rows.
        step: largest share of the distance to the cone's boundary in one step; full steps may cycle.
        constant: on the diagonal of the linear systems, at most the finest tolerance.
        whitened: whether to solve for y = L'x with P = LL', where all curvatures are one; it helps if those of data and
            Tikhonov term differ by more than rounding.
    """

    coarser: float = 1.0
    equilibrate: bool = True
    step: float = 0.99
    constant: float = 1e-10
    whitened: bool = False


_ATTEMPTS = (
    _Attempt(),
    _Attempt(equilibrate=False),
    _Attempt(step=0.8),
    _Attempt(whitened=True),
    _Attempt(equilibrate=False, whitened=True),
    _Attempt(10.0),
    _Attempt(10.0, equilibrate=False, step=0.8),
    _Attempt(100.0, step=0.8),
    _Attempt(100.0, equilibrate=False, constant=1e-8),
    _Attempt(1e3),
    _Attempt(1e4, constant=1e-8),
)
"""Attempts after a failed update, in this order: those without loss of accuracy first. Chosen on problems that stalled
(tests/regression/test_solver.py)."""


@dataclass(frozen=True)
class Solution:
    """A point of the cone and its cost.

    Attributes:
        theta: (P,) parameters.
        cost: theta' B' H B theta - 2 g' B theta + rho(theta), without the efforts' energy.
        tolerance: relative duality gap and infeasibility that the solver reached.
        lower_bound: of the cost over the cone, from a dual point (:eq:`dual-bound`); -inf without one.
        multipliers: (m,) of the rows of K (`bayesid.regression.conic`), from the last attempt.
    """

    theta: Array
    cost: float
    tolerance: float
    lower_bound: float = -np.inf
    multipliers: Array = field(default_factory=lambda: np.empty(0))


class ConeLeastSquares:
    """The problem for one cone of P parameters and r base coefficients, stated once.

    Args:
        cone: the cone.
        coefficients: for B.
        hessian: (r, r) H of all data; it sets the scales of the parameters.
        energy: c of all data.
        min_eigenvalue: lower bound of every pseudo-inertia's eigenvalues.
        tolerance: requested relative duality gap and infeasibility.
        least_tikhonov: least weight of rho over the energy.
    """

    def __init__(
        self,
        cone: Cone,
        coefficients: BaseCoefficients,
        hessian: Array,
        energy: float,
        min_eigenvalue: float = 0.0,
        tolerance: float = 1e-6,
        least_tikhonov: float = TUNING.least_tikhonov,
    ) -> None:
        self.nonnegative, self.linear_count = cone.nonnegative, linear_count(cone)
        self.finest = np.inf if cone.stated is None else TUNING.finest_of_stated
        self.projection = coefficients.projection
        self.scale = _sizes(cone, self.projection, hessian, energy)
        self.typical = typical_parameters(cone) / self.scale
        self.plane, self._exact = cone.plane(self.scale), cone.plane()
        self.rows = _state_cone(cone, self.scale, min_eigenvalue, self.plane)
        self.tikhonov_weight = tikhonov_weight(energy, least_tikhonov)
        self.tolerance = tolerance
        self._hessian = hessian

    def lighter(self, share: float) -> ConeLeastSquares:
        """The same problem with the Tikhonov term times `share`."""
        lighter = copy(self)
        lighter.tikhonov_weight = share * self.tikhonov_weight
        return lighter

    def prepared(self, hessian: Array | None = None) -> PreparedLeastSquares:
        """A new solver for one H (r, r); None: H of all data."""
        return PreparedLeastSquares(self, self._hessian if hessian is None else hessian)

    def project(self, theta: Array) -> Array:
        """(r,) coefficients of parameters (P,)."""
        beta: Array = self.projection @ theta
        return beta

    def parameters(self, y: Array) -> Array:
        """(P,) parameters of a point y (d,) of the plane, in sizes."""
        return self._exact.nearest(self.scale * self.plane.point(y))

    def regularisation(self, theta: Array) -> float:
        """rho(theta), the Tikhonov term about typical links (:eq:`tikhonov`)."""
        return float(self.tikhonov_weight * np.sum((theta / self.scale - self.typical) ** 2))

    def tikhonov(self) -> tuple[Array, Array]:
        """Q (r, r) and b (r,): (beta - b)' Q (beta - b) is the least rho of all theta with B theta = beta.

        See :eq:`tikhonov-share`.
        """
        spread = self.projection * self.scale
        # (spread spread')^-1 = root root'
        root = solve_triangular(np.linalg.qr(spread.T, mode="r"), np.eye(len(spread)))
        return self.tikhonov_weight * (root @ root.T), spread @ self.typical


class PreparedLeastSquares:
    """The problem for one H (r, r), in units of its largest curvature, for many linear terms.

    Clarabel starts at the first solve and is then updated, so the last digits (within the tolerance) depend on earlier
    solves. Prepare a new solver if they must not.
    """

    def __init__(self, stated: ConeLeastSquares, hessian: Array) -> None:
        self._stated, self._hessian = stated, hessian
        columns = stated.projection * stated.scale
        full = columns.T @ hessian @ columns
        full = 0.5 * (full + full.T)
        self._unit = max(float(np.max(np.diag(full))), TINY)
        self._tikhonov = stated.tikhonov_weight / self._unit
        self._whole = 2.0 * full / self._unit + 2.0 * self._tikhonov * np.eye(len(full))
        quadratic = stated.plane.basis.T @ self._whole @ stated.plane.basis
        self._quadratic, self._factor = _upper_triangle(quadratic), np.linalg.cholesky(quadratic)
        self._solver: Any = None

    def project(self, theta: Array) -> Array:
        """(r,) coefficients of parameters (P,)."""
        return self._stated.project(theta)

    def solve(self, gradient: Array) -> Solution:
        """The best point for g (r,).

        If the updated solver misses its tolerance through rounding, new ones are tried, the last ones with coarser
        tolerances.

        Raises:
            SolverError: all attempts failed.
        """
        linear, tolerance = self._linear(gradient), self._stated.tolerance
        if self._solver is None:
            self._solver = self._started(linear, tolerance, _Attempt())
        else:
            self._solver.update(q=linear)
        outcome = solved(self._solver)
        tried = [outcome]
        for attempt in _ATTEMPTS:
            if outcome.failure:
                tolerance = attempt.coarser * self._stated.tolerance
                outcome = self._tried(linear, tolerance, attempt)
                tried.append(outcome)
        if outcome.failure:
            self._solver = None
            raise SolverError("cone least squares", outcome.failure)
        return self._solution(gradient, tried, tolerance)

    def solve_precisely(self, gradient: Array) -> Solution:
        """The best point for g (r,), to the finest tolerance that Clarabel reaches (returned in the solution).

        Raises:
            SolverError: the attempts of `solve` failed too.
        """
        linear, tried = self._linear(gradient), []
        for tolerance in TUNING.precise_tolerances:
            for equilibrate in (True, False):
                tried.append(self._tried(linear, tolerance, _Attempt(equilibrate=equilibrate)))
                if not tried[-1].failure:
                    return self._solution(gradient, tried, tolerance)
        return self.solve(gradient)

    def _slope(self, gradient: Array) -> Array:
        """(P,) gradient of the cost at z = 0."""
        slope: Array = self._stated.scale * (gradient @ self._stated.projection) / self._unit
        return -2.0 * (slope + self._tikhonov * self._stated.typical)

    def _linear(self, gradient: Array) -> Array:
        """(d,) gradient of the cost at y = 0."""
        plane = self._stated.plane
        return (self._slope(gradient) + self._whole @ plane.origin) @ plane.basis

    def _solution(self, gradient: Array, tried: list[Outcome], tolerance: float) -> Solution:
        """The last point, and the largest bound; bounds of failed attempts are valid too."""
        stated = self._stated
        theta = stated.parameters(tried[-1].point)
        theta[stated.nonnegative] = np.maximum(theta[stated.nonnegative], 0.0)  # violations are below the tolerance
        beta = stated.project(theta)
        cost = float(beta @ self._hessian @ beta - 2 * gradient @ beta) + stated.regularisation(theta)
        duals = [outcome.dual for outcome in tried if len(outcome.point)]
        bounds = [self.bound_of(gradient, dual) for dual in duals if np.all(np.isfinite(dual))]
        return Solution(theta, cost, tolerance, min(cost, max(bounds, default=-np.inf)), tried[-1].dual)

    def bound_of(self, gradient: Array, dual: Array) -> float:
        """Lower bound of the cost over the cone by weak duality, for any multipliers (:eq:`dual-bound`).

        For z in the dual cone, min over feasible x of x'Px/2 + q'x >= min over all x of x'Px/2 + q'x + z'(Ax - b)
        = -|L^-1 (q + A'z)|^2 / 2 - b'z with P = LL' (Boyd and Vandenberghe 2004, 5.2). The Tikhonov term makes P
        positive definite. The best multiple of z is taken; the multiple 0 is the unconstrained bound.
        """
        (offsets, rows, _), linear, origin = self._stated.rows, self._linear(gradient), self._stated.plane.origin
        z = into_cone(dual, self._stated.linear_count)
        slopes = solve_triangular(self._factor, np.column_stack([linear, rows.T @ z]), lower=True)
        plain, slope = slopes.T
        gain, length = -float(plain @ slope + offsets @ z), max(float(slope @ slope), TINY)
        value = -0.5 * float(plain @ plain) + 0.5 * max(gain, 0.0) ** 2 / length
        value += float(origin @ (0.5 * self._whole @ origin + self._slope(gradient)))
        return self._unit * (value + self._tikhonov * float(self._stated.typical @ self._stated.typical))

    def _tried(self, linear: Array, tolerance: float, attempt: _Attempt) -> Outcome:
        outcome = solved(self._started(linear, tolerance, attempt))
        if attempt.whitened and len(outcome.point):
            return outcome._replace(point=solve_triangular(self._factor.T, outcome.point))
        return outcome

    def _started(self, linear: Array, tolerance: float, attempt: _Attempt) -> Any:
        settings = settings_of(tolerance, tolerance, self._stated.finest)
        settings.presolve_enable = settings.chordal_decomposition_enable = False  # they forbid updates
        settings.equilibrate_enable = attempt.equilibrate
        settings.max_step_fraction = attempt.step
        settings.static_regularization_constant = attempt.constant
        offsets, rows, cones = self._stated.rows
        quadratic = self._quadratic
        if attempt.whitened:
            both = solve_triangular(self._factor, np.column_stack([linear, rows.T.toarray()]), lower=True)
            linear, rows = both[:, 0], scipy.sparse.csc_matrix(both[:, 1:].T)
            quadratic = scipy.sparse.eye(len(linear), format="csc")
        return clarabel.DefaultSolver(quadratic, linear, rows, offsets, cones, settings)


def tikhonov_weight(energy: float, least: float = TUNING.least_tikhonov) -> float:
    """The weight w of rho for efforts of this energy c, in units of their noise (:eq:`tikhonov`)."""
    return float(np.clip(1.0 / TUNING.pull_reach**2, least * energy, TUNING.most_pull * energy))


def solve_precisely(
    cone: Cone,
    coefficients: BaseCoefficients,
    hessian: Array,
    gradient: Array,
    energy: float,
    min_eigenvalue: float = MARGIN,
) -> Solution:
    """One cone least squares, to the finest tolerance that Clarabel reaches (returned in the solution).

    Raises:
        SolverError: no tolerance is reached.
    """
    stated = ConeLeastSquares(
        cone, coefficients, hessian, energy, min_eigenvalue, least_tikhonov=TUNING.completing_tikhonov
    )
    return stated.prepared().solve_precisely(gradient)


def _sizes(cone: Cone, projection: Array, hessian: Array, energy: float) -> Array:
    """(P,) size at which each parameter alone would explain all efforts; a typical size if it has no effect."""
    sizes = typical_sizes(cone)
    curvature = np.einsum("rp,rs,sp->p", projection, hessian, projection)
    parts = (np.abs(projection).T @ np.sqrt(np.maximum(np.diag(hessian), 0.0))) ** 2
    shows = curvature > np.maximum(_NEGLIGIBLE * curvature.max(), _NO_TRACE * parts)
    sizes[shows] = np.sqrt(energy / curvature[shows])
    return sizes


def _state_cone(
    cone: Cone, scale: Array, min_eigenvalue: float, plane: Plane
) -> tuple[Array, scipy.sparse.csc_matrix, list[Any]]:
    """The cone in Clarabel's form, b - A y in K, where theta / scale is the plane's point of y."""
    offsets, linear = offsets_of(cone), linear_count(cone)
    offsets[linear : linear + 10 * len(cone.bodies)] = -np.tile(min_eigenvalue * stacked(np.eye(4)), len(cone.bodies))
    rows = rows_of(cone, np.diag(scale))
    rows[: len(cone.nonnegative)] = np.eye(cone.size)[cone.nonnegative]
    units = units_of(cone, rows)
    rows = rows / units[:, None]
    free = rows @ plane.basis
    free[np.abs(free) < _CANCELS * np.linalg.norm(rows, axis=1)[:, None]] = 0.0
    return offsets / units + rows @ plane.origin, scipy.sparse.csc_matrix(-free), cones_of(cone)


def _upper_triangle(matrix: Array) -> scipy.sparse.csc_matrix:
    n = len(matrix)
    columns, rows = np.tril_indices(n)
    starts = np.concatenate([[0], np.cumsum(np.arange(1, n + 1))])
    return scipy.sparse.csc_matrix((matrix[rows, columns], rows, starts), shape=(n, n))
