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
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bayesid.arrays import Integers
from bayesid.progress import Steps, no_steps
from bayesid.signs.search.problem import Problem
from bayesid.signs.search.protocol import (
    Assignment,
    SearchResult,
    SignProblem,
    Way,
    listed_without_proof,
    predicted_signs,
    with_flipped,
)
from bayesid.signs.tuning import TUNING


class LocalOptima(NamedTuple):
    """What a local search has met."""

    #: distinct local optima and the assignments it began with, cheapest first; the best is priced as precisely as the
    #: solver can
    met: tuple[Assignment, ...]
    failed: int  #: starts since the best was met, none of which led to a better one
    starts: int  #: all


def local_search(
    problem: Problem, begun: Iterable[Assignment], failures: int, seed: int = 0, steps: Steps = no_steps
) -> LocalOptima:
    """Local optima about the best of some assignments, at least one.

    It ends after so many starts without a better assignment (`failures`). `steps` is called as steps(starts, starts at
    most).
    """
    met = {branch.signs.tobytes(): branch for branch in begun}
    best, failed, rng = min(met.values(), key=lambda branch: branch.cost), 0, np.random.default_rng(seed)
    starts, tried, most = _starts(problem, best, rng), 0, TUNING.most_starts * failures
    while failed < failures and tried < most and not problem.budget.over:
        steps(tried, most)
        start = next(starts)
        branch = problem.settle_from(start)
        met.setdefault(branch.signs.tobytes(), branch)
        failed, tried = failed + 1, tried + 1
        if branch.cost < best.cost - max(problem.exact, TUNING.alike):
            best, failed = branch, 0
            starts = _starts(problem, best, rng)
    best = min(met.values(), key=lambda branch: branch.cost)
    priced = problem.price(best.signs)
    met[priced.signs.tobytes()] = priced
    return LocalOptima(tuple(sorted(met.values(), key=lambda branch: branch.cost)), failed, tried)


def _starts(problem: Problem, best: Assignment, rng: np.random.Generator) -> Iterator[Integers]:
    """(S,) signs: of the best assignment with joints turned, then as drawn parameters predict; without an end."""
    normal_equations = problem.normal_equations
    joints = np.unique(normal_equations.joint[normal_equations.known == 0]).tolist()
    for flipped in (*itertools.combinations(joints, 1), *itertools.combinations(joints, 2)):
        yield with_flipped(normal_equations, best.signs, flipped)
    beta = problem.solver.project(best.theta)
    for temperature in itertools.cycle(TUNING.temperatures):
        yield predicted_signs(normal_equations, beta + np.sqrt(temperature) * problem.unconstrained.draw(rng))


def searched_locally(
    problem: SignProblem,
    results: Sequence[SearchResult],
    failures: int,
    time_limit: float = np.inf,
    steps: Steps = no_steps,
) -> SearchResult:
    """The best of some results, searched further; the local optima that come near are its branches.

    The first result says what is proven, if anything. The search ends after so many `failures`, or seconds.
    """
    began, inner = time.perf_counter(), Problem(problem.normal_equations, problem.solver(), np.inf, time_limit)
    known, first = problem.normal_equations.known, results[0]
    thetas = [[one.theta, *(branch.theta for branch in one.branches[: TUNING.most_begun])] for one in results]
    begun = [inner.settle(known, theta) for theta in itertools.chain(*thetas)]
    found = local_search(inner, begun, failures, steps=steps)
    best, work = found.met[0], inner.budget.spent
    ways = (way for one in results for way in one.ways or (Way(one.method, one.cost, one.spent),))
    worked = first.with_work_of(results[1:])
    result = worked.with_best(
        best,
        tikhonov=inner.tikhonov_of(best),
        width=results[-1].width,
        pruning=results[-1].pruning,
        unlisted_probability=_unseen(first, found),
        seconds=sum(one.seconds for one in results) + time.perf_counter() - began,
        solves=worked.solves + inner.solves,
        timed_out=worked.timed_out or inner.budget.timed_out,
        spent=worked.spent + (work if first.spent > 0.0 else 0.0),
        tolerance=max(inner.tolerance, *(one.tolerance for one in results)),
        ways=(*ways, Way("local search", best.cost, work, found.starts)),
    )
    if first.persistent is not None and np.array_equal(first.signs, best.signs):
        return result
    branches, decided = listed_without_proof(problem.normal_equations, best, found.met)
    return replace(result, branches=branches, decided=decided, optimality_gap=0.0, missed=np.inf, persistent=None)


def _unseen(first: SearchResult, found: LocalOptima) -> float:
    """Probability that one start more leads to a better assignment, after so many that did not: Laplace's rule.

    Where nothing is better than the result that the search began with, the starts that led there count too.
    """
    before = 0.5 if found.met[0].cost < first.cost - TUNING.alike else first.unlisted_probability
    return before / (1.0 + found.failed * before)  # 1 / (starts + 2)
