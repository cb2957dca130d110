"""What other noise weights make of a proof: whether its signs stay the best, and which of them stay settled.

A proof holds for the weights with which its rows were scaled. Other weights need no new proof to be seen through: the
assignments that come near are those that it lists, its best one with a joint turned round or single segments turned,
and what a search for candidates finds anew.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from bayesid.arrays import Integers, Mask
from bayesid.parallel import in_parallel
from bayesid.progress import Steps, no_steps
from bayesid.signs.search.certified import candidate
from bayesid.signs.search.problem import Problem
from bayesid.signs.search.protocol import SignProblem
from bayesid.signs.search.result import NEAR, Branch, SearchResult

_MOST_LISTED = 32
"""Of the listed assignments, cheapest first, that are priced again. A round number; not studied."""


@dataclass(frozen=True)
class Rivals:
    """What other weights make of a proof.

    Attributes:
        best: the one that costs least.
        near: distinct ones that cost at most `NEAR` more than the best of the search, that one among them.
        changed: whether another assignment costs less than the best of the search.
        settled: (S,) whether no rival within Delta gives the segment another sign.
    """

    best: Branch
    near: tuple[Branch, ...]
    changed: bool
    settled: Mask


def rivals(problem: SignProblem, result: SearchResult, steps: Steps = no_steps) -> Rivals:
    """Prices what comes near the best assignment of a search; where it has proven something, candidates too.

    Args:
        problem: of the search, with its moments scaled by other weights.
        result: of the search.
        steps: called as steps(assignments priced, all).

    Raises:
        SolverError: a cone problem could not be solved.
    """
    inner = Problem(problem.moments, problem.solver(), np.inf)
    known, joint, far = problem.moments.known, problem.moments.joint, max(result.within, NEAR)
    best = inner.price(result.signs)
    listed = [branch.signs for branch in result.branches[1 : 1 + _MOST_LISTED]]
    around = [np.where((joint == j) & (known == 0), -best.signs, best.signs) for j in np.unique(joint[known == 0])]

    def priced(roughly: Branch) -> Branch:
        """Precisely, where it may come near."""
        return inner.price(roughly.signs) if roughly.lower_bound <= best.cost + far else roughly

    def settled(start: Branch) -> list[Branch]:
        """What settling from a start leads to, and the start."""
        return [start, priced(inner.settle(known, start.theta))]

    def near_to(signs: Integers) -> list[Branch]:
        return settled(priced(inner.complete(signs, best.theta)))

    def by_search() -> list[Branch]:
        return settled(candidate(inner))

    def from_best() -> list[Branch]:
        return settled(best)[1:]

    ways: list[Callable[[], list[Branch]]] = [from_best] if result.settled is None else [by_search, from_best]
    ways += [partial(near_to, signs) for signs in (*listed, *around)]
    everything = [branch for found in in_parallel(ways, steps) for branch in found]
    limit = min(branch.cost for branch in [best, *everything]) + result.within
    alike = [branch.signs == best.signs for branch in everything if branch.cost <= limit]
    unknown = np.flatnonzero(known == 0)
    agreed: Mask = np.all([np.ones(len(known), dtype=bool), *alike], axis=0)
    agreed[unknown] &= best.lower_bound + inner.single_flips(best, unknown) > limit
    distinct = {branch.signs.tobytes(): branch for branch in [*everything, best]}.values()
    least = min(distinct, key=lambda branch: branch.cost)
    near = tuple(branch for branch in distinct if branch.cost <= best.cost + NEAR)
    return Rivals(least, near, least.cost < best.cost - inner.exact, agreed)
