"""Certified search: the best signs, a proof that no others cost less, and all others that still matter.

Candidates first. Each joint's rows alone almost decide its pattern up to a flip of the whole joint; the best patterns
of all joints are combined, priced by the unconstrained bound and settled in the cone in the order of that bound.

Then the proof. With U the cost of the best signs so far and D_j the least cost of joint j's own rows,

1. joint by joint: every pattern of joint j's strong segments with a bound under U + Delta - (sum of the other D_i);
2. joints together: these lists are joined one after the other and cut by the unconstrained bound of all their rows;
3. in the cone: a semidefinite program, by its dual bound, for the combinations left;
4. the weak segments: settled given the rest, and proven by what turning them would cost (`tree`, `flips`).

Dropping rows is a valid bound, so weak segments need not be enumerated.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bayesid.moments import Moments
from bayesid.motion import Array
from bayesid.search.combinations import TooManyError, combinations, combine, least_costs, shortest_first
from bayesid.search.patterns import Keep
from bayesid.search.problem import OutOfTimeError, Problem
from bayesid.search.result import Branch, SearchResult
from bayesid.search.tree import Proof, prove, settled
from bayesid.solver import ConeLeastSquares

_WIDTH, _JOINED = 64, 256
"""Patterns of each joint, and combinations of all joints, among which candidates are looked for."""
_STRONG = 0.02
"""Share of the energy of a joint's strongest segment from which a segment takes part in the search for candidates."""
_TRIED, _REFINED = 64, 3
"""Candidates that are solved in the cone at most, and how many of them are settled."""
_TURNS = 20
"""Single segments that are turned on trial."""
_ALLOWANCE, _WIDEN = 10.0, 2.0
"""Delta beyond that of a single assignment of the allowed mass; growth beyond what would have sufficed before."""
_LOG2 = float(np.log(2.0))


def certified(
    moments: Moments,
    solver: ConeLeastSquares,
    budget: float = 10.0,
    missed: float = 1e-3,
    start: Array | None = None,
    progress: Callable[[int, int], None] | None = None,
    repeatable: bool = False,
) -> SearchResult:
    """Finds the best signs and proves as much about all others as the budget allows.

    Args:
        moments: scaled moments of S segments.
        solver: prepared for the cone and for H and energy of all segments.
        budget: seconds; the candidates are looked for however few they are.
        missed: the mass, relative to the best assignment's, that the branches may leave out.
        start: (P,) parameters of an earlier search; what they predict is a candidate too.
        progress: called as progress(stages done, stages).
        repeatable: whether the budget counts work in nominal seconds instead (`Problem`).

    Raises:
        SolverError: a cone problem could not be solved.
    """
    began = time.perf_counter()
    problem = Problem(moments, solver, budget, repeatable)
    best, floor, proof = candidate(problem), 0.0, None
    if start is not None:
        earlier = problem.price(problem.settle(moments.known, start).signs)
        best = min(best, earlier, key=lambda branch: branch.cost)
    if progress is not None:
        progress(1, 2)
    try:
        least = least_costs(problem)
        floor = float(least.sum()) - problem.slack
        proof = _prove_enough(problem, best, least, float(np.log(missed)))
    except (OutOfTimeError, TooManyError):
        pass
    if progress is not None:
        progress(2, 2)
    result = _result(problem, best, floor, proof, missed)
    seconds = time.perf_counter() - began
    return replace(result, nodes=problem.nodes, solves=problem.solves, tolerance=problem.tolerance, seconds=seconds)


def _result(problem: Problem, best: Branch, floor: float, proof: Proof | None, missed: float) -> SearchResult:
    if proof is not None and proof.branches:
        best = min([proof.branches[0], best], key=lambda branch: branch.cost)
    result = SearchResult(
        signs=best.signs, theta=best.theta, cost=best.cost, method="certified", width=None,
        certified=False, lower_bound=max(min(floor, best.lower_bound), 0.0),  # the cost is a sum of squares
        nodes=0, solves=0, tolerance=0.0, seconds=0.0,
    )  # fmt: skip
    if proof is None or not proof.branches or proof.branches[0].cost > best.cost + problem.exact:
        return result  # nothing is proven, or rounding has excluded what is there
    result = replace(
        result,
        certified=proof.runner_up >= best.cost - problem.exact,
        lower_bound=max(result.lower_bound or 0.0, proof.lower_bound),
    )
    kept, within, log_missed = _what_matters(proof, best.cost, missed)
    if within < 0.0:
        return result  # the budget has ended while something below the best cost was open
    agreed = [
        settled(problem, branch, decided, best.cost + within) & (branch.signs == best.signs)
        for branch, decided in zip(proof.branches[:kept], proof.decided[:kept], strict=True)
    ]
    return replace(
        result,
        branches=proof.branches[:kept],
        within=within,
        missed=float(np.exp(log_missed)),
        settled=np.all(agreed, axis=0),
        decided=proof.decided[:kept],
    )


def _what_matters(proof: Proof, cost: float, missed: float) -> tuple[int, float, float]:
    """How many branches are kept, within which Delta, and the log of the mass left out, relative to the best one's.

    The proof went farther than it had to: its dearest branches are dropped as long as the mass allows.
    """
    least = -2.0 * float(np.log(missed))
    masses = np.array([-0.5 * (branch.lower_bound - cost) for branch in proof.branches])
    log_missed, kept = proof.log_missed + 0.5 * cost, len(proof.branches)
    while kept > 1 and proof.branches[kept - 1].lower_bound > cost + least:
        more = float(np.logaddexp(log_missed, masses[kept - 1]))
        if more > np.log(missed):
            break
        log_missed, kept = more, kept - 1
    proven = min([proof.limit, *(branch.lower_bound for branch in proof.branches[kept:])]) - cost
    return kept, min(proven, max(least, proof.branches[kept - 1].cost - cost)), log_missed


# ---------------------------------------------------------------------------------------------------------------
# Candidates
# ---------------------------------------------------------------------------------------------------------------
def candidate(problem: Problem) -> Branch:
    """The best assignment among combinations of each joint's best patterns, without any proof."""

    def best_of_all(_: list[int]) -> tuple[Keep, float]:
        return lambda bound: np.argsort(bound, kind="stable")[:_JOINED], np.inf

    lists = [block.best(_WIDTH, block.strong(_STRONG)) for block in problem.blocks]
    joined = combine(problem, lists, shortest_first(lists), best_of_all)
    hessian, energy = problem.decided_moments(joined)
    problem.set_hessian(hessian)
    found: list[tuple[float, int, Array]] = []
    for row in np.argsort(joined.bound, kind="stable")[:_TRIED]:
        if found and joined.bound[row] - problem.slack >= found[0][0]:
            break
        solution = problem.solve(joined.gradient[row])
        found = sorted([*found, (energy + solution.cost, int(row), solution.theta)], key=lambda one: one[:2])
    settled = [problem.settle(problem.decided(joined, row), theta) for _, row, theta in found[:_REFINED]]
    best = min(settled, key=lambda branch: branch.cost)
    return _turned(problem, problem.price(problem.settle(problem.moments.known, best.theta).signs))


def _turned(problem: Problem, branch: Branch) -> Branch:
    """The branch with single segments turned where that pays: those that pull the parameters over to their own sign."""
    unknown = np.flatnonzero(problem.moments.known == 0)
    for _ in range(_TURNS):
        changes = problem.single_flips(branch, unknown)
        k = int(np.argmin(changes)) if unknown.size else 0
        if not unknown.size or changes[k] >= -problem.exact:
            break
        signs = branch.signs.copy()
        signs[unknown[k]] *= -1
        other = problem.settle(
            np.where(np.arange(len(signs)) == unknown[k], signs, problem.moments.known), branch.theta
        )
        other = problem.price(other.signs)
        if other.cost < branch.cost:
            branch = other
        else:
            unknown = np.delete(unknown, k)
    return branch


def _prove_enough(problem: Problem, best: Branch, least: Array, log_missed: float) -> Proof:
    """A proof with a Delta so wide that it leaves out no more than it may, or as far as the budget goes."""
    within = -2.0 * log_missed + _ALLOWANCE
    while True:
        limit = best.cost + within
        found = combinations(problem, limit, least)
        excess = found.log_missed + 0.5 * best.cost - (log_missed - _LOG2)
        if excess <= 0.0 or problem.out_of_time:
            proof = prove(problem, found, limit, best.theta)
            best = min([best, *proof.branches], key=lambda branch: branch.cost)
            excess = proof.log_missed + 0.5 * best.cost - log_missed
            if excess <= 0.0 or problem.out_of_time:
                return proof
        within += 2.0 * excess + _WIDEN
