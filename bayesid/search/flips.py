"""Flips: what it would cost, at least, to turn segments round when the best parameters for some signs are known.

Let theta be the best feasible parameters for the signs s, beta = B theta. The cost under s is strongly convex, so by
the variational inequality (Boyd and Vandenberghe 2004, 4.2.3) every feasible point at a distance d costs at least
d'(H + Q)d more, Q the pull. Turning the set T of segments adds 4 sum over T of s_k g_k'(beta + d), and minimising over
all d leaves :eq:`flip-bound`::

    F(s with T turned) - F(s)  >=  4 (sum over T of a_k  -  sum over T x T of K_kl),
    a_k = s_k g_k' beta,   K_kl = s_k g_k' (H + Q)^-1 g_l s_l.

The right side is a quadratic function of binary unknowns. A segment k with a_k > K_kk + 2 sum of max(K_kl, 0) makes
every T that holds it dearer than without it (persistency, :eq:`persistency`; Boros and Hammer 2002), so it is settled,
and what is left has fewer members to interfere. Weak segments, whose signs no enumeration could afford to try, are
settled like this.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from bayesid.moments import Moments
from bayesid.motion import Array, Integers
from bayesid.search.result import UnconstrainedBound

_ENUMERATED = 14
"""Segments left by persistency of which all sets are tried."""
_MANY = 4000
"""Segments beyond which interference is bounded without looking at pairs."""
_HANDED_ON, _SWEEPS = 400, 4
"""Segments up to which charges are handed on, and how often."""
_AT_ONCE = 1000
"""Rows of K that are made at once: bounds the memory."""


class Flips:
    """Flips of some segments from a settled assignment.

    Args:
        moments: scaled moments of all segments.
        unconstrained: prepared for the H of all segments and the pull.
        signs: (S,) s.
        beta: (r,) coefficients that are best for s, up to `gap`.
        gap: how much less the best cost under s may be than that of beta.
        free: the segments that may be turned.
    """

    def __init__(
        self,
        moments: Moments,
        unconstrained: UnconstrainedBound,
        signs: Integers,
        beta: Array,
        gap: float,
        free: Integers,
    ) -> None:
        turned = signs[free, None] * moments.gradient[free]
        self.free = free
        self._unconstrained, self._beta, self._gap = unconstrained, beta, max(gap, 0.0)
        self._white = unconstrained.whiten(turned)
        self._own = np.sum(self._white**2, axis=1)
        # beta may be |d| <= sqrt(gap) off the best point, and a_k then by sqrt(gap K_kk).
        self._gain = turned @ beta - np.sqrt(self._gap * self._own)

    @property
    def undecided(self) -> Integers:
        """Positions in `free` that persistency does not settle."""
        return self._persistency[0]

    @cached_property
    def _persistency(self) -> tuple[Integers, float]:
        """Positions that are left, and the least margin (in quarters) with which the others have been settled."""
        left, least = np.arange(len(self.free)), np.inf
        while left.size:
            margin = self._gain[left] + self._own[left] - 2.0 * self._interference(left, left)
            settled = margin > 0.0
            if not np.any(settled):
                break
            least = min(least, float(margin[settled].min()))
            left = left[~settled]
        return left, least

    @property
    def alone(self) -> Array:
        """(free,) lower bounds of the change if one segment alone is turned."""
        return 4.0 * (self._gain - self._own)

    @property
    def heaviest(self) -> int:
        """Position in `free` of the undecided segment that the parameters depend on most."""
        return int(self.undecided[np.argmax(self._own[self.undecided])])

    def _interference(self, rows: Integers, columns: Integers) -> Array:
        """(rows,) sums over the columns of max(K_kl, 0), or upper bounds of them where there are very many."""
        if len(columns) > _MANY:
            return self._most_interference(rows, columns)
        sums = np.empty(len(rows))
        for start in range(0, len(rows), _AT_ONCE):
            chunk = slice(start, start + _AT_ONCE)
            sums[chunk] = np.maximum(self._white[rows[chunk]] @ self._white[columns].T, 0.0).sum(axis=1)
        return sums

    def _most_interference(self, rows: Integers, columns: Integers) -> Array:
        """The same by Cauchy and Schwarz, in time linear in the segments: sum |K_kl| <= sqrt(n sum K_kl^2)."""
        white = self._white[columns]
        plain = self._white[rows] @ white.sum(axis=0)
        squares = np.sum((self._white[rows] @ (white.T @ white)) * self._white[rows], axis=1)
        most: Array = 0.5 * (plain + np.sqrt(len(columns) * np.maximum(squares, 0.0)))
        return most

    @cached_property
    def best(self) -> tuple[float, Integers]:
        """Lower bound of the change (<= 0) over all sets of flips, and the segments of the set that it belongs to."""
        change, positions = self._least_change()
        return min(change, 0.0), self.free[positions if change < 0.0 else []]

    @property
    def any(self) -> float:
        """Lower bound of the change over all sets of flips but the empty one; inf where nothing is free."""
        # Each settled segment that is taken out of a set makes it cheaper by its margin, until only others are left.
        margin = 4.0 * self._persistency[1]
        return min(margin + self.best[0], self._least_change()[0])

    def _least_change(self) -> tuple[float, Integers]:
        """Lower bound over all sets of undecided segments but the empty one, and the positions of that set."""
        left = self.undecided
        if not left.size:
            return np.inf, left
        if len(left) > _ENUMERATED:
            slope = self._slopes(left)
            return 4.0 * float(np.minimum(slope, 0.0).sum()), left[slope < 0.0]
        chosen = (np.arange(1, 2 ** len(left))[:, None] >> np.arange(len(left))) & 1
        change = chosen @ self._gain[left] - np.sum((chosen @ self._white[left]) ** 2, axis=1)
        least = int(np.argmin(change))
        return 4.0 * float(change[least]), left[chosen[least] == 1]

    @cached_property
    def _slope(self) -> Array:
        return self._slopes(np.arange(len(self.free)))

    def _slopes(self, among: Integers) -> Array:
        """(among,) the sum of these over any set of flips bounds its change from below, in quarters.

        A pair of flips may gain 2 max(K_kl, 0) together. That is charged to the two in shares that keep as many slopes
        as possible from being negative (roof duality; Boros and Hammer 2002): first in proportion to what each costs
        by itself, then by handing charges on from segments that have a negative slope to those that have some left.
        """
        if len(among) > _MANY:
            return self._gain[among] + self._own[among] - 2.0 * self._interference(among, among)
        gain, slopes = np.maximum(self._gain[among], 1e-12), np.empty(len(among))
        handed_on = len(among) <= _HANDED_ON
        charges = np.empty((len(among), len(among)) if handed_on else (0, 0))
        for start in range(0, len(among), _AT_ONCE):
            chunk = slice(start, start + _AT_ONCE)
            pairs = np.maximum(self._white[among[chunk]] @ self._white[among].T, 0.0)
            rows = np.arange(len(pairs))
            pairs[rows, start + rows] = 0.0
            pairs *= 2.0 * gain[chunk, None] / (gain[chunk, None] + gain)
            slopes[chunk] = self._gain[among[chunk]] - self._own[among[chunk]] - pairs.sum(axis=1)
            if handed_on:
                charges[chunk] = pairs
        return _handed_on(slopes, charges) if handed_on else slopes

    def forced(self, steps: Array) -> Array:
        """(m,) lower bounds of the change if other segments are turned, whatever happens to the free ones.

        Args:
            steps: (m, r) sum of s_k g_k over the segments that are turned.
        """
        white = self._unconstrained.whiten(steps)
        own = np.sum(white**2, axis=1)
        gain = steps @ self._beta - np.sqrt(self._gap * own)
        others = np.minimum(self._slope - 2.0 * white @ self._white.T, 0.0)
        change: Array = 4.0 * (gain - own + others.sum(axis=1))
        return change

    def changes(self) -> Array:
        """(free,) lower bounds of the change over all sets of flips that hold the segment."""
        if len(self.free) > _MANY:
            return 4.0 * (self._gain - self._own + self._others_of_many())
        changes = np.empty(len(self.free))
        for start in range(0, len(self.free), _AT_ONCE):
            chunk = slice(start, start + _AT_ONCE)
            others = np.minimum(self._slope - 2.0 * self._white[chunk] @ self._white.T, 0.0)
            rows = np.arange(len(others))
            others[rows, start + rows] = 0.0
            changes[chunk] = self._gain[chunk] - self._own[chunk] + others.sum(axis=1)
        return 4.0 * changes

    def _others_of_many(self) -> Array:
        """(free,) lower bounds of what the flips of all others add, without looking at pairs of settled ones."""
        everything = np.arange(len(self.free))
        negative = np.flatnonzero(self._slope < 0.0)
        few = np.minimum(self._slope[negative] - 2.0 * self._white @ self._white[negative].T, 0.0).sum(axis=1)
        few[negative] -= np.minimum(self._slope[negative] - 2.0 * self._own[negative], 0.0)
        return few - 2.0 * self._interference(everything, everything)


def _handed_on(slopes: Array, charges: Array) -> Array:
    """Slopes (n,) after charges (n, n; row k is charged to k) were handed on to segments with slope to spare."""
    slopes = slopes.copy()
    for _ in range(_SWEEPS):
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
