"""What signs that are decided say about further segments, by the rows of the decided ones and of one more at a time.

Let D be the decided segments, l the least cost of their rows with half of the pull, beta the coefficients where it is
had and H its curvature. Three things follow for another segment k, with v_k = g_k' H^-1 g_k:

1. Its efforts leave (c_k - s g_k' beta)^2 / c_k along their own direction at least, so that its sign s costs at least
   :eq:`consequence`::

       l + (c_k - s g_k' beta)^2 / (c_k + v_k).

   A sign whose bound exceeds the limit is excluded; where both are, so is what has been decided.
2. An assignment that costs at most L has its best coefficients where |g_k' (beta* - beta)| <= sqrt(v_k (L - l)). Where
   that cannot change the sign of g_k' beta, the other sign is dearer, whatever the others are, by the gain

       4 (|g_k' beta| - sqrt(v_k (L - l)))

   (:eq:`prediction`). So no assignment up to L is lost if the predicted sign is assumed, and its rows count as well.
3. Every assignment in which an assumed sign is turned costs its gain more than one in which none is.

What has been decided or assumed says more about the rest: the coefficients are better known, and more rows count. The
order matters: what is assumed leans on what was assumed before, never on what came after it. So once signs have been
excluded by their gains, all that is left of the assumptions is made anew.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.signs.search.problem import Problem
from bayesid.signs.search.result import UnconstrainedBound

_BOTH = np.array([[1.0], [-1.0]])
"""Signs."""


@dataclass(frozen=True)
class Consequences:
    """What follows from a partial assignment.

    Attributes:
        decided: (S,) +1 or -1 where the other sign is excluded, else 0.
        signs: (S,) the same, and the signs that are assumed.
        gain: (S,) by how much the other sign is dearer at least where a sign is assumed, in units of the cost; else
            inf.
        bound: lower bound of the cost of all completions; where it exceeds the limit, that is all that counts.
        excluded: (k,) lower bounds of the cost with one of the excluded signs.
    """

    decided: Integers
    signs: Integers
    gain: Array
    bound: float
    excluded: Array

    @property
    def free(self) -> Integers:
        """Segments that are neither decided nor assumed."""
        return np.flatnonzero(self.signs == 0)


def consequences(problem: Problem, decided: Integers, limit: float) -> Consequences:
    """All that follows.

    Args:
        problem: the problem.
        decided: (S,) +1, -1, or 0 where a segment is undecided.
        limit: of the cost, up to which assignments matter.
    """
    excluded = []
    while True:
        found = _once(problem, decided, limit)
        excluded.append(found.excluded)
        turned = found.bound + found.gain
        sure = np.isfinite(turned) & (turned > limit)
        decided = np.where(sure, found.signs, found.decided)
        excluded.append(turned[sure])
        if found.bound > limit or not np.any(sure):
            return replace(found, excluded=np.concatenate(excluded))


def _once(problem: Problem, decided: Integers, limit: float) -> Consequences:
    """One segment after the other, decided or assumed."""
    moments, rows, signs = problem.moments, np.flatnonzero(decided), decided.copy()
    decided, gains, excluded = decided.copy(), np.full(len(decided), np.inf), [np.empty(0)]
    known, bound = _Rows(problem), 0.0
    while rows.size:
        known.add(rows, signs)
        free = np.flatnonzero((signs == 0) & moments.individual & (moments.energy > 0.0))
        slope, spread = known.predict(free)
        costs = known.least + (moments.energy[free] - _BOTH * slope) ** 2 / (moments.energy[free] + spread)
        bound = max(bound, known.least, float(costs.min(axis=0).max(initial=-np.inf)))
        if bound > limit:
            break
        gain = 4.0 * (np.abs(slope) - np.sqrt(spread * (limit - known.least)))
        sure = costs.max(axis=0) > limit
        assumed = ~sure & (gain > problem.exact)
        excluded.append(costs[:, sure].max(axis=0))
        gains[free[assumed]] = gain[assumed]
        rows = free[sure | assumed]
        signs[rows] = np.where(slope[sure | assumed] >= 0.0, 1, -1)
        decided[free[sure]] = signs[free[sure]]
    return Consequences(decided, signs, gains, bound, np.concatenate(excluded))


class _Rows:
    """The rows of segments with their signs.

    Args:
        problem: the problem.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem, self._moments = problem, problem.moments
        self._hessian, self._gradient, self._energy = 0.5 * problem.pull, np.zeros(len(problem.pull)), 0.0
        self.add(np.empty(0, dtype=np.int64), problem.moments.known)

    def add(self, segments: Integers, signs: Integers) -> None:
        """More segments, with signs (S,) of all."""
        moments = self._moments
        self._hessian = self._hessian + moments.hessian_of(segments)
        self._gradient = self._gradient + signs[segments] @ moments.gradient[segments]
        self._energy += float(moments.energy[segments].sum())
        self._unconstrained = UnconstrainedBound(self._hessian, 0.0)
        self._white = self._unconstrained.whiten(self._gradient[None])[0]
        self._problem.count(len(moments))

    @property
    def least(self) -> float:
        """Lower bound of what they cost."""
        return self._energy - float(self._white @ self._white) - self._problem.slack

    def predict(self, segments: Integers) -> tuple[Array, Array]:
        """(k,) g' beta and g' H^-1 g of other segments."""
        white = self._unconstrained.whiten(self._moments.gradient[segments])
        return white @ self._white, np.sum(white**2, axis=1)
