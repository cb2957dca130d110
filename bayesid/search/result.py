"""What a search returns, and the bound that searches share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from bayesid.motion import Array, Integers

_RIDGE = 1e-9
"""Curvature added to columns of unit length; a hundredth of the solver's own pull to typical links."""


@dataclass(frozen=True)
class SearchResult:
    """The best assignment that a search found.

    Attributes:
        signs: (S,) +1 or -1 for each segment of the moments.
        theta: (P,) best feasible parameters under these signs.
        cost: f(theta, signs), efforts in units of their noise.
        method: how it was found.
        width: of the beam; None if it was unlimited.
        certified: whether no other assignment can cost less.
        lower_bound: proven bound on the cost of every assignment, or None.
        nodes: priced by the unconstrained bound.
        solves: cone problems solved.
        tolerance: coarsest relative gap among them.
        seconds: of wall time.
    """

    signs: Integers
    theta: Array
    cost: float
    method: str
    width: int | None
    certified: bool
    lower_bound: float | None
    nodes: int
    solves: int
    tolerance: float
    seconds: float


class UnconstrainedBound:
    """min over all coefficients of beta' H beta - 2 g' beta, for many g: a lower bound of the cost in the cone.

    Args:
        hessian: (r, r) H.
    """

    def __init__(self, hessian: Array) -> None:
        lengths = np.sqrt(np.maximum(np.diag(hessian), 1e-300 + _RIDGE * np.diag(hessian).max()))
        scaled = hessian / np.outer(lengths, lengths) + _RIDGE * np.eye(len(hessian))
        self._factor = solve_triangular(np.linalg.cholesky(scaled), np.diag(1.0 / lengths), lower=True)

    def __call__(self, gradient: Array) -> Array:
        """(m,) minima -g' H^-1 g for the rows of gradient (m, r)."""
        return -np.sum((gradient @ self._factor.T) ** 2, axis=1)
