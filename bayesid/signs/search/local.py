"""Iterated local search: assignments of signs that fit well where branch and bound does not end.

A local optimum is an assignment that its own best parameters predict. Signs and parameters fitted in turn lead to one
from any start. With friction in the model a joint is nearly symmetric by itself (docs/certified-search.md), and some of
its segments may be mirrored while others are not, so there are many. Starts are the best assignment known with one
joint turned round, with a pair of joints turned round, then signs that parameters drawn about the best ones predict:

    beta + sqrt(T) L^-T z,   L L' = H + Q,   z standard normal,

from a normal distribution that is T times as wide as the likelihood (a tempered distribution). Whatever is better takes
the place of the best, and the search starts again from there (Lourenco, Martin and Stuetzle 2003).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Integers
from bayesid.signs.search.problem import Problem
from bayesid.signs.search.result import ALIKE, Branch

_TEMPERATURES = (30.0, 100.0, 300.0)
"""T of the draws, in turn: on a dual arm and on the Krang a fifth of the starts with 100 lead to the best assignment
known, of those with 1000 one in thirty."""
_MOST_STARTS = 2
"""Times the failures that are asked for: starts at most."""


@dataclass(frozen=True)
class LocalOptima:
    """What a local search has met.

    Attributes:
        met: distinct local optima and the assignments it began with, cheapest first.
        failed: starts since the best was met, none of which led to a better one.
        starts: all.
    """

    met: tuple[Branch, ...]
    failed: int
    starts: int

    @property
    def best(self) -> Branch:
        """The cheapest, priced as precisely as the solver can."""
        return self.met[0]


def local_search(problem: Problem, begun: Iterable[Branch], failures: int, seed: int = 0) -> LocalOptima:
    """Local optima about the best of some assignments.

    Args:
        problem: of S segments.
        begun: assignments, at least one.
        failures: starts without a better assignment after which the search ends.
        seed: of the draws.

    Raises:
        SolverError: a cone problem could not be solved.
    """
    met = {branch.signs.tobytes(): branch for branch in begun}
    best, failed, rng = min(met.values(), key=lambda branch: branch.cost), 0, np.random.default_rng(seed)
    starts, tried = _starts(problem, best, rng), 0
    while failed < failures and tried < _MOST_STARTS * failures:
        start = next(starts)
        branch = problem.settle_from(start)
        met.setdefault(branch.signs.tobytes(), branch)
        failed, tried = failed + 1, tried + 1
        if branch.cost < best.cost - max(problem.exact, ALIKE):
            best, failed = branch, 0
            starts = _starts(problem, best, rng)
    best = min(met.values(), key=lambda branch: branch.cost)
    priced = problem.price(best.signs)
    met[priced.signs.tobytes()] = priced
    return LocalOptima(tuple(sorted(met.values(), key=lambda branch: branch.cost)), failed, tried)


def _starts(problem: Problem, best: Branch, rng: np.random.Generator) -> Iterator[Integers]:
    """(S,) signs: of the best assignment with joints turned, then as drawn parameters predict; without an end."""
    moments = problem.moments
    unknown = moments.known == 0
    joints = np.unique(moments.joint[unknown]).tolist()
    for turned in (*itertools.combinations(joints, 1), *itertools.combinations(joints, 2)):
        yield np.where(np.isin(moments.joint, turned) & unknown, -best.signs, best.signs)
    beta = problem.project(best.theta)
    for temperature in itertools.cycle(_TEMPERATURES):
        drawn = beta + np.sqrt(temperature) * problem.draw(rng)
        yield np.where(unknown, np.where(moments.gradient @ drawn >= 0.0, 1, -1), moments.known)
