"""Test whether unconstrained least squares gives a feasible robot: a linear matrix inequality, stated in cvxpy.

Unconstrained least squares determines combinations of the parameters only. Their estimate is feasible if some
parameters with these combinations have pseudo-inertias that are all positive semidefinite (Sousa and Cortesao,
"Physical feasibility of robot base inertial parameter identification: a linear matrix inequality approach", IJRR
2014)::

    maximise  t   subject to  H B theta = g,  P_k(theta) >= t E for every body,  theta_i >= t,  t <= 1.

cvxpy compiles this once; a node of a search costs some milliseconds.
"""

from __future__ import annotations

import warnings

import numpy as np

from bayesid.arrays import TINY, Array
from bayesid.effects.parameters import Cone
from bayesid.errors import SolverError
from bayesid.regression.tuning import TUNING
from bayesid.robot.inertia import PSEUDO_INERTIA_BASIS

MOST = 1.0
"""Upper limit of the margin, which is unbounded for bodies without effect on the efforts."""


class FeasibilityCheck:
    """The check for one cone of P parameters and the projection (r, P) on r coefficients."""

    def __init__(self, cone: Cone, projection: Array) -> None:
        import cvxpy as cp  # takes a second

        self._projection, self._solver, self._solved_status = projection, cp.CLARABEL, cp.OPTIMAL
        theta, self._margin = cp.Variable(cone.size), cp.Variable()
        self._rows, self._values = cp.Parameter(projection.shape), cp.Parameter(len(projection))
        self._most = cp.Parameter()
        constraints = [self._rows @ theta == self._values, self._margin <= self._most]
        if len(cone.nonnegative):
            constraints.append(theta[cone.nonnegative] >= self._margin)
        for body in cone.bodies.tolist():
            pseudo_inertia = sum(theta[i] * basis for i, basis in zip(body, PSEUDO_INERTIA_BASIS, strict=True))
            constraints.append(pseudo_inertia >> self._margin * np.eye(4))
        self._problem = cp.Problem(cp.Maximize(self._margin), constraints)

    def margins(self, hessian: Array, gradients: Array) -> Array:
        """(m,) the largest t for H (r, r) and each g of (m, r); the estimate is feasible if it is not negative.

        It is the largest common lower bound of all pseudo-inertias' eigenvalues (kg m^2 to kg), at most `MOST`.

        Raises:
            SolverError: a problem was not solved.
        """
        rows, inverse = decided_rows(hessian)
        stated = np.zeros(self._projection.shape)
        stated[: len(rows)] = rows @ self._projection
        self._rows.value = stated
        margins = np.empty(len(gradients))
        for k, gradient in enumerate(gradients):
            values = inverse @ gradient
            unit = max(1.0, float(np.abs(values).max(initial=0.0)))  # parameters in units of the largest
            self._values.value = np.concatenate([values, np.zeros(len(stated) - len(rows))]) / unit
            self._most.value = MOST / unit
            margins[k] = unit * self._solved()
        return margins

    def _solved(self) -> float:
        for tolerance in TUNING.feasibility_tolerances:
            accuracy = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), tolerance)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # an inaccurate solution is rejected below
                self._problem.solve(solver=self._solver, enforce_dpp=True, **accuracy)
            if self._problem.status == self._solved_status:
                return float(self._margin.value)
        raise SolverError("feasibility of least squares", self._problem.status)


def decided_rows(hessian: Array) -> tuple[Array, Array]:
    """(k, r) rows V that H determines, and (k, r) W: V beta = W g for every beta with H beta = g."""
    lengths = np.sqrt(np.diag(hessian))
    lengths = np.where(lengths > TUNING.undecided * lengths.max(), lengths, np.inf)
    values, vectors = np.linalg.eigh(hessian / np.outer(lengths, lengths))
    decides = values > TUNING.undecided * max(float(values[-1]), TINY)
    vectors = vectors[:, decides]
    scale = np.where(np.isfinite(lengths), lengths, 0.0)
    return vectors.T * scale, (vectors / lengths[:, None]).T / values[decides][:, None]
