"""Lower bounds of cone least squares, from multipliers that are better than the solver's (:eq:`dual-bound`).

Multipliers that are off by the solver's tolerance cost the bound little where data determine the parameters. Where
only the Tikhonov term does, P is tiny and P^-1 magnifies what is off. So the multipliers are improved: they are a sum
of parts in the cone, a part for each half space and for each eigenvector of a matrix, and the best sum is found by
nonnegative least squares. The x of that sum may violate the cone. The eigenvectors of its matrices with negative
eigenvalues are further parts (column generation), until they raise the bound by less than the tolerance.
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
"""Steps of nonnegative least squares, a part; near-parallel parts enter and leave more than scipy's three times."""


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
        """Of the minimum, from multipliers (m,) in the cone that are nearly the best ones; -inf where none is found."""
        parts = np.column_stack([np.eye(len(self.offsets), self.linear), self._parts(multipliers)])
        best = -np.inf
        for _ in range(TUNING.dual_rounds):
            try:
                value, slope = self._best_sum(parts)
            except RuntimeError:  # nnls has not ended: what is proven stays proven
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
        """The bound by the best sum of parts (m, k), and (P,) -y there.

        The shares only have to be good: any that are not negative prove what they prove.
        """
        slopes, costs = self.white @ parts, self.offsets @ parts
        says = np.any(slopes != 0.0, axis=0)  # beside equalities a half space may say nothing
        slopes, costs = slopes[:, says], costs[says]
        size = np.maximum(np.linalg.norm(slopes, axis=0), TINY)
        scaled = slopes / size
        root = np.linalg.cholesky(scaled.T @ scaled + RIDGE * np.eye(len(size))).T
        target = -solve_triangular(root.T, scaled.T @ self.plain + costs / size, lower=True)
        share = nnls(root, target, maxiter=_PASSES * len(size))[0] / size
        slope = self.plain + slopes @ share
        return -0.5 * float(slope @ slope) - float(costs @ share), slope
