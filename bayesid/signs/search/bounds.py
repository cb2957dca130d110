"""Lower bounds of the cost in the cone: without the cone, and after flipping segments of a given assignment.

Let theta be the best feasible parameters for the signs s, beta = B theta. The cost under s is strongly convex. By the
variational inequality (Boyd and Vandenberghe 2004, 4.2.3) every feasible point at a distance d costs at least d'(H +
Q)d more, Q the Tikhonov term. Flipping the set T of segments adds 4 sum over T of s_k g_k'(beta + d). Minimising over
all d gives :eq:`flip-bound`::

    F(s with T flipped) - F(s)  >=  4 (sum over T of a_k  -  sum over T x T of K_kl),
    a_k = s_k g_k' beta,   K_kl = s_k g_k' (H + Q)^-1 g_l s_l.

The right side is a quadratic function of binary unknowns. If a_k > K_kk + 2 sum of max(K_kl, 0), every T with segment k
costs more than T without it (persistency, :eq:`persistency`; Boros and Hammer 2002). So k keeps its sign, and the
others have fewer segments to interact with. This proves weak segments, which are too many to enumerate.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dtrtri

from bayesid.arrays import Array, Integers
from bayesid.regression.normal_equations import NormalEquations
from bayesid.signs.tuning import TUNING, Tuning

_RIDGE = 1e-13
"""Curvature added to columns of unit length: a hundredth of the solver's least Tikhonov term
(`bayesid.regression.solver.tikhonov_weight`), so that the bound stays below the cost."""


class UnconstrainedBound:
    """min over all coefficients of beta' H beta - 2 g' beta, for many g: a lower bound of the cost in the cone.

    It is the minimum over beta of :eq:`binary-quadratic`, and the bound of :eq:`unconstrained-bound`, without the
    energy c. `ridge` is curvature added to columns of unit length; 0 if H (r, r) includes a share of the Tikhonov term.
    """

    def __init__(self, hessian: Array, ridge: float = _RIDGE) -> None:
        lengths = np.sqrt(np.maximum(np.diag(hessian), 1e-300 + ridge * np.diag(hessian).max()))
        scaled = hessian / np.outer(lengths, lengths) + ridge * np.eye(len(hessian))
        self._factor = dtrtri(cholesky(scaled), lower=1)[0] / lengths

    def __call__(self, gradient: Array) -> Array:
        """(m,) minima -g' H^-1 g for the rows of gradient (m, r)."""
        return -np.sum(self.whiten(gradient) ** 2, axis=1)

    def whiten(self, gradient: Array) -> Array:
        """(m, r) rows W g with |W g|^2 = g' H^-1 g."""
        white: Array = gradient @ self._factor.T
        return white

    def draw(self, rng: np.random.Generator) -> Array:
        """(r,) normal draw with mean zero and covariance H^-1."""
        drawn: Array = rng.standard_normal(len(self._factor)) @ self._factor
        return drawn


def cholesky(matrix: Array, most: float = 1e-11) -> Array:
    """L with L L' = matrix, of unit diagonal, plus the smallest ridge, at least a few rounding units, that it needs.

    Raises:
        LinAlgError: the matrix needs a ridge above `most`.
    """
    ridge = 0.0
    while True:
        try:
            return np.linalg.cholesky(matrix + ridge * np.eye(len(matrix))).astype(np.float64)
        except np.linalg.LinAlgError:
            if ridge >= most:
                raise
        ridge = max(1e-15, 10.0 * ridge)


class Flips:
    """Flips of the free segments of an assignment s (S,).

    Coefficients beta (r,) are the best for s, up to a cost of `gap`. The unconstrained bound is that of H of all
    segments and the Tikhonov term.
    """

    def __init__(
        self,
        normal_equations: NormalEquations,
        unconstrained: UnconstrainedBound,
        signs: Integers,
        beta: Array,
        gap: float,
        free: Integers,
        tuning: Tuning = TUNING,
    ) -> None:
        flipped = signs[free, None] * normal_equations.gradient[free]
        self.free, self._tuning = free, tuning
        self._unconstrained, self._beta, self._gap = unconstrained, beta, max(gap, 0.0)
        self._white = unconstrained.whiten(flipped)
        self._diagonal = np.sum(self._white**2, axis=1)
        # beta may be |d| <= sqrt(gap) from the best point, which changes a_k by up to sqrt(gap K_kk).
        self._linear = flipped @ beta - np.sqrt(self._gap * self._diagonal)

    @property
    def undecided(self) -> Integers:
        """Positions in `free` without persistency."""
        return self._persistency[0]

    @cached_property
    def _persistency(self) -> tuple[Integers, float]:
        """Positions without persistency, and the least margin (in quarters) of the others."""
        remaining, least = np.arange(len(self.free)), np.inf
        while remaining.size:
            margin = self._linear[remaining] + self._diagonal[remaining]
            margin = margin - 2.0 * self._interference(remaining, remaining)
            persistent = margin > 0.0
            if not np.any(persistent):
                break
            least = min(least, float(margin[persistent].min()))
            remaining = remaining[~persistent]
        return remaining, least

    @property
    def alone(self) -> Array:
        """(free,) lower bounds of the change if one segment alone is flipped."""
        return 4.0 * (self._linear - self._diagonal)

    @property
    def heaviest(self) -> int:
        """Position in `free` of the segment without persistency that affects the parameters most."""
        return int(self.undecided[np.argmax(self._diagonal[self.undecided])])

    def _chunks(self, size: int) -> Iterator[slice]:
        at_once = self._tuning.rows_at_once
        return (slice(start, start + at_once) for start in range(0, size, at_once))

    def _interference(self, rows: Integers, columns: Integers) -> Array:
        """(rows,) sums over the columns of max(K_kl, 0), or upper bounds of them for very many segments."""
        if len(columns) > self._tuning.many_flips:
            return self._most_interference(rows, columns)
        sums = np.empty(len(rows))
        for chunk in self._chunks(len(rows)):
            sums[chunk] = np.maximum(self._white[rows[chunk]] @ self._white[columns].T, 0.0).sum(axis=1)
        return sums

    def _most_interference(self, rows: Integers, columns: Integers) -> Array:
        """Upper bounds by Cauchy-Schwarz, in linear time: sum |K_kl| <= sqrt(n sum K_kl^2)."""
        white = self._white[columns]
        plain = self._white[rows] @ white.sum(axis=0)
        squares = np.sum((self._white[rows] @ (white.T @ white)) * self._white[rows], axis=1)
        most: Array = 0.5 * (plain + np.sqrt(len(columns) * np.maximum(squares, 0.0)))
        return most

    @cached_property
    def best(self) -> tuple[float, Integers]:
        """Lower bound of the change (<= 0) over all sets of flips, and the segments of that set."""
        change, positions = self._least_change()
        return min(change, 0.0), self.free[positions if change < 0.0 else []]

    @property
    def any(self) -> float:
        """Lower bound of the change over all nonempty sets of flips; inf without free segments."""
        # Removing a persistent segment from a set lowers its cost by the segment's margin.
        margin = 4.0 * self._persistency[1]
        return min(margin + self.best[0], self._least_change()[0])

    def _least_change(self) -> tuple[float, Integers]:
        """Lower bound over all nonempty sets of segments without persistency, and the positions of that set."""
        undecided = self.undecided
        if not undecided.size:
            return np.inf, undecided
        if len(undecided) > self._tuning.enumerated:
            slope = self._slopes(undecided)
            return 4.0 * float(np.minimum(slope, 0.0).sum()), undecided[slope < 0.0]
        chosen = (np.arange(1, 2 ** len(undecided))[:, None] >> np.arange(len(undecided))) & 1
        change = chosen @ self._linear[undecided] - np.sum((chosen @ self._white[undecided]) ** 2, axis=1)
        least = int(np.argmin(change))
        return 4.0 * float(change[least]), undecided[chosen[least] == 1]

    @cached_property
    def _slope(self) -> Array:
        return self._slopes(np.arange(len(self.free)))

    def _slopes(self, among: Integers) -> Array:
        """(among,) slopes whose sum over any set of flips is a lower bound of its change, in quarters.

        A pair of flips may gain 2 max(K_kl, 0) together. That is charged to both so that as many slopes as possible
        stay nonnegative (roof duality; Boros and Hammer 2002): first in proportion to their own costs, then charges are
        shifted from negative to positive slopes.
        """
        if len(among) > self._tuning.many_flips:
            return self._linear[among] + self._diagonal[among] - 2.0 * self._interference(among, among)
        linear, slopes = np.maximum(self._linear[among], 1e-12), np.empty(len(among))
        charged = len(among) <= self._tuning.charged_flips
        charges = np.empty((len(among), len(among)) if charged else (0, 0))
        for chunk in self._chunks(len(among)):
            pairs = np.maximum(self._white[among[chunk]] @ self._white[among].T, 0.0)
            rows = np.arange(len(pairs))
            pairs[rows, chunk.start + rows] = 0.0
            pairs *= 2.0 * linear[chunk, None] / (linear[chunk, None] + linear)
            slopes[chunk] = self._linear[among[chunk]] - self._diagonal[among[chunk]] - pairs.sum(axis=1)
            if charged:
                charges[chunk] = pairs
        return _charges_shifted(slopes, charges, self._tuning.sweeps) if charged else slopes

    def forced(self, steps: Array) -> Array:
        """(m,) lower bounds of the change if other segments are flipped, for any signs of the free ones.

        Steps (m, r) are the sums of s_k g_k over the flipped segments.
        """
        white = self._unconstrained.whiten(steps)
        diagonal = np.sum(white**2, axis=1)
        linear = steps @ self._beta - np.sqrt(self._gap * diagonal)
        of_free = np.minimum(self._slope - 2.0 * white @ self._white.T, 0.0)
        change: Array = 4.0 * (linear - diagonal + of_free.sum(axis=1))
        return change

    def changes(self, among: Integers | None = None) -> Array:
        """(m,) lower bounds of the change over all sets of flips that include one of these m positions in `free`."""
        if len(self.free) > self._tuning.many_flips:
            many: Array = 4.0 * (self._linear - self._diagonal + self._rest_of_many())
            return many if among is None else many[among]
        among = np.arange(len(self.free)) if among is None else among
        changes = np.empty(len(among))
        for places in self._chunks(len(among)):
            chunk = among[places]
            rest = np.minimum(self._slope - 2.0 * self._white[chunk] @ self._white.T, 0.0)
            rest[np.arange(len(chunk)), chunk] = 0.0
            changes[places] = self._linear[chunk] - self._diagonal[chunk] + rest.sum(axis=1)
        return 4.0 * changes

    def _rest_of_many(self) -> Array:
        """(free,) lower bounds of the contribution of all other flips, without pairs of persistent segments."""
        everything = np.arange(len(self.free))
        negative = np.flatnonzero(self._slope < 0.0)
        few, white = np.empty(len(everything)), 2.0 * self._white[negative].T
        for chunk in self._chunks(len(everything)):
            few[chunk] = np.minimum(self._slope[negative] - self._white[chunk] @ white, 0.0).sum(axis=1)
        few[negative] -= np.minimum(self._slope[negative] - 2.0 * self._diagonal[negative], 0.0)
        return few - 2.0 * self._interference(everything, everything)


def _charges_shifted(slopes: Array, charges: Array, sweeps: int) -> Array:
    """Slopes (n,) after charges (n, n; row k is charged to k) were shifted to segments with positive slope."""
    slopes = slopes.copy()
    for _ in range(sweeps):
        if np.all(slopes >= 0.0):
            break
        for k in np.flatnonzero(slopes > 0.0):
            needed = np.minimum(np.maximum(-slopes, 0.0), charges[:, k])
            total = float(needed.sum())
            if total <= 0.0:
                continue
            needed *= min(1.0, slopes[k] / total)
            charges[:, k] -= needed
            charges[k] += needed
            slopes += needed
            slopes[k] -= needed.sum()
    return slopes
