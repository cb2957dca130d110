"""Lower bounds of cone least squares, from improved multipliers (:eq:`dual-bound`).

An error of the multipliers within the solver's tolerance hardly lowers the bound where data determine the parameters.
Where only the Tikhonov term does, P is tiny and P^-1 magnifies the error. So the multipliers are improved. They are a
sum of parts in the cone: one for each half space and each eigenvector of a matrix. Nonnegative least squares finds the
best sum. If the x of that sum violates the cone, the eigenvectors with negative eigenvalues are added as parts (column
generation), until the bound rises by less than the tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from bayesid.arrays import TINY, Array
from bayesid.regression.conic import blocks_of, stacked
from bayesid.regression.knowledge import RIDGE
from bayesid.regression.tuning import TUNING

_PASSES = 10
"""Iterations of nonnegative least squares per part; near-parallel parts need more than scipy's three."""


@dataclass(frozen=True)
class WhiteProblem:
    """min |y|^2 / 2 + plain'y over y = L'x with offsets - white'y in K (`bayesid.regression.conic`), P = LL'.

    Attributes:
        plain: (P,) L^-1 q.
        white: (P, m) L^-1 A'.
        offsets: (m,) b.
        linear: rows of K that are not negative.
    """

    plain: Array
    white: Array
    offsets: Array
    linear: int

    def lower_bound(self, multipliers: Array, tolerance: float) -> float:
        """Lower bound from nearly optimal multipliers (m,) in the cone; -inf if none is found."""
        parts = np.column_stack([np.eye(len(self.offsets), self.linear), self._parts(multipliers)])
        best = -np.inf
        for _ in range(TUNING.dual_rounds):
            try:
                value, slope = self._best_sum(parts)
            except RuntimeError:  # nnls reached its limit; the last bound is valid
                return best
            if value <= best + tolerance * abs(value):
                return max(value, best)
            best = value
            parts = np.column_stack([parts, self._parts(-self.offsets - self.white.T @ slope)])
        return best

    def _parts(self, values: Array) -> Array:
        """(m, k) matrices v v' for the eigenvectors v with positive eigenvalues of the blocks of values (m,)."""
        eigenvalues, vectors = np.linalg.eigh(blocks_of(values, self.linear))
        block, which = np.nonzero(eigenvalues > 0.0)
        chosen = vectors[block, :, which]
        parts = np.zeros((len(self.offsets), len(block)))
        rows = self.linear + 10 * block[:, None] + np.arange(10)
        parts[rows, np.arange(len(block))[:, None]] = stacked(chosen[:, :, None] * chosen[:, None, :])
        return parts

    def _best_sum(self, parts: Array) -> tuple[float, Array]:
        """The bound of the best sum of parts (m, k), and (P,) -y there.

        Any nonnegative weights give a valid bound, so they need not be optimal.
        """
        slopes, costs = self.white @ parts, self.offsets @ parts
        active = np.any(slopes != 0.0, axis=0)  # with equalities a half space may be constant
        slopes, costs = slopes[:, active], costs[active]
        size = np.maximum(np.linalg.norm(slopes, axis=0), TINY)
        scaled = slopes / size
        root = np.linalg.cholesky(scaled.T @ scaled + RIDGE * np.eye(len(size))).T
        target = -solve_triangular(root.T, scaled.T @ self.plain + costs / size, lower=True)
        share = nnls(root, target, maxiter=_PASSES * len(size))[0] / size
        slope = self.plain + slopes @ share
        return -0.5 * float(slope @ slope) - float(costs @ share), slope
