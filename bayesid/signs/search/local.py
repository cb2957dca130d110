"""Iterated local search: assignments of signs that fit well when branch and bound does not end.

A local optimum is an assignment that its own best parameters predict. Alternating signs and parameters reaches one from
any start. With friction in the model a joint is nearly symmetric under a flip (docs/certified-search.md), and so may be
single segments, so there are many local optima. Starts are the best known assignment with one joint flipped, with two
joints flipped, then signs predicted by parameters drawn as

    beta + sqrt(T) L^-T z,   L L' = H + Q,   z standard normal,

a normal distribution T times as wide as the likelihood (tempered). A better assignment becomes the best, and the search
starts again from it (Lourenco, Martin and Stuetzle 2003).
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
from bayesid.signs.search.problem import SearchProblem
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
    """Result of a local search."""

    #: distinct local optima and first assignments, cheapest first; the best is solved precisely
    met: tuple[Assignment, ...]
    failed: int  #: starts without improvement since the best was found
    starts: int  #: number of starts


def local_search(
    problem: SearchProblem, optima: Iterable[Assignment], failures: int, seed: int = 0, steps: Steps = no_steps
) -> LocalOptima:
    """Local optima around the best of the given ones, at least one.

    Ends after `failures` starts without improvement. `steps` is called as steps(starts, largest number of starts).
    """
    met = {branch.signs.tobytes(): branch for branch in optima}
    best, failed, rng = min(met.values(), key=lambda branch: branch.cost), 0, np.random.default_rng(seed)
    starts, tried, most = _starts(problem, best, rng), 0, TUNING.most_starts * failures
    while failed < failures and tried < most and not problem.budget.over:
        steps(tried, most)
        start = next(starts)
        branch = problem.local_optimum_from(start)
        met.setdefault(branch.signs.tobytes(), branch)
        failed, tried = failed + 1, tried + 1
        if branch.cost < best.cost - max(problem.exact, TUNING.alike):
            best, failed = branch, 0
            starts = _starts(problem, best, rng)
    best = min(met.values(), key=lambda branch: branch.cost)
    priced = problem.price(best.signs)
    met[priced.signs.tobytes()] = priced
    return LocalOptima(tuple(sorted(met.values(), key=lambda branch: branch.cost)), failed, tried)


def _starts(problem: SearchProblem, best: Assignment, rng: np.random.Generator) -> Iterator[Integers]:
    """(S,) signs: the best assignment with joints flipped, then predictions of drawn parameters; never ends."""
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
    """The best of some results after a local search; local optima of similar cost are its branches.

    Proofs are those of the first result. The search ends after `failures` starts without improvement, or `time_limit`.
    """
    began, inner = time.perf_counter(), SearchProblem(problem.normal_equations, problem.solver(), np.inf, time_limit)
    known, first = problem.normal_equations.known, results[0]
    thetas = [
        [result.theta, *(branch.theta for branch in result.branches[: TUNING.local_starts])] for result in results
    ]
    optima = [inner.local_optimum(known, theta) for theta in itertools.chain(*thetas)]
    found = local_search(inner, optima, failures, steps=steps)
    best, work = found.met[0], inner.budget.spent
    ways = (way for result in results for way in result.ways or (Way(result.method, result.cost, result.spent),))
    worked = first.with_work_of(results[1:])
    result = worked.with_best(
        best,
        tikhonov=inner.tikhonov_of(best),
        width=results[-1].width,
        pruning=results[-1].pruning,
        unlisted_probability=_unlisted_probability(first, found),
        seconds=sum(result.seconds for result in results) + time.perf_counter() - began,
        solves=worked.solves + inner.solves,
        timed_out=worked.timed_out or inner.budget.timed_out,
        spent=worked.spent + (work if first.spent > 0.0 else 0.0),
        tolerance=max(inner.tolerance, *(result.tolerance for result in results)),
        ways=(*ways, Way("local search", best.cost, work, found.starts)),
    )
    if first.persistent is not None and np.array_equal(first.signs, best.signs):
        return result
    branches, decided = listed_without_proof(problem.normal_equations, best, found.met)
    return replace(result, branches=branches, decided=decided, optimality_gap=0.0, missed=np.inf, persistent=None)


def _unlisted_probability(first: SearchResult, found: LocalOptima) -> float:
    """Probability that another start finds a better assignment: Laplace's rule of succession.

    If no start improved on the first result, the starts that led to it count too.
    """
    before = 0.5 if found.met[0].cost < first.cost - TUNING.alike else first.unlisted_probability
    return before / (1.0 + found.failed * before)  # 1 / (starts + 2)
