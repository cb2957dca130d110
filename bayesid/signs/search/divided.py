"""A lower bound of the cost of many thousand segments: theirs in groups, each of which is proven by itself.

Rows are parted among groups, and the pull is shared, so that no assignment costs less than the sum of what its groups
cost by themselves (:eq:`divided-bound`). What is lost is the freedom of each group to have parameters of its own: about
r for each but one.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.fit.moments import Moments
from bayesid.signs.search.combinations import TooManyError, combinations, least_costs
from bayesid.signs.search.problem import OutOfTimeError, Problem
from bayesid.signs.search.tree import prove


def divided_bound(problem: Problem, theta: Array) -> float:
    """Lower bound of the cost of every assignment; 0 for the groups that the budget does not reach.

    Args:
        problem: of all segments.
        theta: (P,) the best parameters known.

    Raises:
        SolverError: a cone problem could not be solved.
    """
    chosen = list(groups(problem.moments, problem.limits.together))
    total = 0.0
    for k, segments in enumerate(chosen):
        part = problem.part(segments, 1.0 / len(chosen), problem.left / (len(chosen) - k))
        total += max(_bound(part, theta), 0.0)
        problem.took(part)
    return total


def _bound(problem: Problem, theta: Array) -> float:
    """Of every assignment of one group, whose cost is a sum of squares, and the pull's share."""
    bound = -np.inf
    try:
        least = least_costs(problem)
        bound = float(least.sum()) - problem.slack
        near = problem.price(problem.settle(problem.moments.known, theta).signs)
        limit = near.cost + problem.limits.allowance
        proof = prove(problem, combinations(problem, limit, least), limit, near.theta)
        return max(bound, proof.lower_bound)
    except (OutOfTimeError, TooManyError):
        return bound


def groups(moments: Moments, size: int) -> Iterator[Integers]:
    """Segments in groups of about `size`, each with strong and weak ones of every joint.

    Segments that are known, or share a part of the Hessian, cannot be parted: all are in the first group.
    """
    apart = np.flatnonzero((moments.known == 0) & moments.individual)
    rest = np.setdiff1d(np.arange(len(moments)), apart)
    ordered = apart[np.lexsort((-moments.energy[apart], moments.joint[apart]))]
    count = max(1, -(-len(ordered) // size))
    for k in range(count):
        yield np.sort(np.concatenate([ordered[k::count], rest if k == 0 else rest[:0]]))
