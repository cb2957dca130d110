"""Certified search: the best signs, a proof that no others cost less, and all others of similar cost.

Candidates come first. Each joint's rows alone almost determine its pattern up to a flip of the whole joint. The best
patterns of all joints are combined, priced by the unconstrained bound, and solved in the cone in the order of that
bound.

The proof follows. U is the cost of the best signs so far, D_j the least cost of joint j's rows alone. Steps:

1. For each joint j, list the patterns of its strong segments with a bound under U + Delta - (sum of the other D_i).
2. Join these lists one after the other. Drop combinations by the unconstrained bound of all their rows.
3. Drop remaining combinations by the dual bound of the semidefinite program in the cone.
4. Decide further segments, one after the other, whose sign follows from the decided ones (`tree.consequences`).
5. Give the weak segments their best signs, and prove these by the cost of flipping them (`tree`, `bounds.Flips`).

The cost of some rows alone is a lower bound of the total cost, so weak segments need not be enumerated.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.errors import InputError
from bayesid.progress import SILENT, Progress, Steps, no_steps
from bayesid.regression.normal_equations import NormalEquations
from bayesid.regression.solver import ConeLeastSquares
from bayesid.signs.search.beam import Beam
from bayesid.signs.search.combinations import TooManyError, combinations, combine, least_costs
from bayesid.signs.search.local import searched_locally
from bayesid.signs.search.patterns import LOG2, Keep
from bayesid.signs.search.problem import OutOfTimeError, SearchProblem
from bayesid.signs.search.protocol import Assignment, Search, SearchResult, SignProblem, Way, check_limits
from bayesid.signs.search.tree import Proof, persistent, prove
from bayesid.signs.tuning import TUNING, Tuning

METHOD = "branch and bound"


@dataclass(frozen=True, kw_only=True)
class Certified(Search):
    """The certified search.

    Attributes:
        budget: nominal seconds of work for the proof (`bayesid.signs.search.protocol`), shared by all proofs of an
            identification; the fallback gets the remaining part plus a fifth of the whole.
        missed_mass: posterior mass outside of the list of assignments, relative to the best assignment's.
        fallback: another search, which runs if the budget ends before the proof.
        time_limit: wall-clock seconds for all searches of an identification (`SearchResult.timed_out`).

    Example:
        >>> search = bayesid.Certified(budget=30.0)
        >>> result = bayesid.identify(robot, log, terms, search=search, posterior=False)
        >>> result.search.certified
        True
    """

    budget: float = 30.0
    missed_mass: float = 1e-3
    fallback: Search = Beam()
    time_limit: float = 600.0

    def __post_init__(self) -> None:
        if not self.fallback.any_model:
            remedy = "use bayesid.Beam with this node solver"
            raise InputError("a certificate holds for least squares in the cone only", "node_cost", remedy)
        check_limits(self, self.budget, self.time_limit)
        if not 0.0 < self.missed_mass < 1.0:
            raise InputError(f"a missed mass of {self.missed_mass:g}", "missed_mass", "give a number between 0 and 1")

    def limited(self, budget: float, time_limit: float) -> Certified:
        """See Search."""
        return replace(self, budget=budget, time_limit=time_limit)

    def find(self, problem: SignProblem, steps: Steps = no_steps) -> SearchResult:
        """Best candidate without a proof; a local search follows if the fit is poor.

        Raises:
            SolverError: a cone problem could not be solved.
        """
        result = self._search(problem, 0.0, steps)
        if problem.starts or not problem.is_poor(result):
            return result
        return searched_locally(problem, [result], TUNING.failures_on_the_way, self._left(result), steps)

    def certify(self, problem: SignProblem, progress: Progress = SILENT) -> SearchResult:
        """The proof. If it does not end: a local search, a beam, and a local search from the beam's signs.

        Raises:
            SolverError: an optimisation failed.
        """
        with progress.stage("sign search: proof") as steps:
            result = self._search(problem, TUNING.proof_share * self.budget, steps)
        if result.certified:
            return result
        failures = TUNING.failures_on_the_way if problem.starts else TUNING.failures
        with progress.stage("sign search: local search") as steps:
            result = searched_locally(problem, [result], failures, self._left(result), steps)
        if problem.starts:
            return result
        seconds = max(min(TUNING.fallback_share * self.budget, self.budget - result.spent), 0.0)
        fallback = self.fallback.limited(seconds, self._left(result))
        with progress.stage("sign search: beam") as steps:
            other = fallback.find(replace(problem, earlier=result), steps)
        seconds, failures = self._left(result, other), TUNING.failures_on_the_way
        with progress.stage("sign search: local search") as steps:
            return searched_locally(problem, [result, other], failures, seconds, steps)

    def _left(self, *results: SearchResult) -> float:
        return max(self.time_limit - sum(result.seconds for result in results), 0.0)

    def _search(self, problem: SignProblem, budget: float, steps: Steps) -> SearchResult:
        result = certified(
            problem.normal_equations,
            problem.solver(),
            budget,
            self.missed_mass,
            None if problem.earlier is None else problem.earlier.theta,
            steps,
            time_limit=self.time_limit,
            signs=problem.starts,
        )
        return result if result.certified else replace(result, unlisted_probability=problem.unlisted_probability)


def certified(  # noqa: PLR0913  a problem, a budget, two starts, and tuning
    normal_equations: NormalEquations,
    solver: ConeLeastSquares,
    budget: float = 10.0,
    missed: float = 1e-3,
    start: Array | None = None,
    steps: Steps = no_steps,
    time_limit: float = np.inf,
    tuning: Tuning = TUNING,
    signs: Sequence[Integers] = (),
) -> SearchResult:
    """Finds the best signs, and proves within the budget which other signs cost more.

    Args:
        normal_equations: of S segments, scaled.
        solver: for the cone and for H and energy of all segments.
        budget: nominal seconds of work; the search for candidates always runs.
        missed: largest posterior mass outside of the listed branches, relative to the best assignment's.
        start: (P,) parameters of an earlier search; their predicted signs are a candidate.
        steps: called as steps(percent of the budget, 100), and as steps(100, 100) in the end.
        time_limit: wall-clock seconds.
        tuning: work limits of each stage.
        signs: likely signs, (S,) each; they replace other candidates.

    Raises:
        SolverError: a cone problem could not be solved.
    """
    began = time.perf_counter()
    steps(0, 100)
    problem = SearchProblem(normal_equations, solver, budget, time_limit, tuning, steps)
    best, lower_bound, proof = _first(problem, start, signs), 0.0, None
    ways = [Way("earlier signs" if signs else "candidates", best.cost, problem.budget.spent)]
    try:
        with problem.budget.at_most(tuning.least_cost_share * budget):
            least = least_costs(problem)
        lower_bound = float(least.sum()) - problem.slack
        proof = _prove_enough(problem, best, least, float(np.log(missed)))
    except (OutOfTimeError, TooManyError):
        pass
    result = _result(problem, best, lower_bound, proof, missed)
    if budget > 0.0:
        ways.append(Way(METHOD, result.cost, problem.budget.spent - ways[0].spent))
    steps(100, 100)
    return replace(
        result,
        nodes=problem.nodes,
        solves=problem.solves,
        tolerance=problem.tolerance,
        seconds=time.perf_counter() - began,
        spent=problem.budget.spent if budget > 0.0 else 0.0,
        timed_out=problem.budget.timed_out and budget > 0.0,
        ways=tuple(ways),
    )


def _first(problem: SearchProblem, start: Array | None, signs: Sequence[Integers]) -> Assignment:
    """First assignment of a proof: that of an earlier search; without one, or a budget, the best candidate.

    Likely signs replace the candidates.
    """
    known, starts = problem.normal_equations.known, []
    if start is not None:
        starts.append(problem.price(problem.local_optimum(known, start).signs))
    if signs:
        starts += [problem.price(problem.local_optimum_from(assignment).signs) for assignment in signs]
    elif start is None or problem.budget.over:
        starts.insert(0, candidate(problem))
    return min(starts, key=lambda branch: branch.cost)


def _result(
    problem: SearchProblem, best: Assignment, lower_bound: float, proof: Proof | None, missed: float
) -> SearchResult:
    if proof is not None and proof.branches:
        best = min([proof.branches[0], best], key=lambda branch: branch.cost)
    result = SearchResult(
        best.signs,
        best.theta,
        best.cost,
        METHOD,
        tikhonov=problem.tikhonov_of(best),
        lower_bound=max(min(lower_bound, best.lower_bound), 0.0),  # the cost is a sum of squares
    )
    if proof is None or not proof.branches or proof.branches[0].cost > best.cost + problem.exact:
        return result  # nothing is proven, or rounding has excluded the best assignment
    certified = proof.runner_up >= best.cost - problem.exact
    result = replace(
        result,
        certified=certified,
        lower_bound=max(result.lower_bound or 0.0, proof.lower_bound),
        unlisted_probability=0.0 if certified else result.unlisted_probability,
    )
    kept, optimality_gap, log_missed = _listed(proof, best.cost, missed)
    if optimality_gap < 0.0:
        return result  # the budget ended with an open node below the best cost
    if result.certified and not _data_agree(problem, best, proof.branches[1:kept]):
        result = replace(result, certified=False, uncertified_because="tikhonov")
    agreed = [
        persistent(problem, branch, decided, best.cost + optimality_gap) & (branch.signs == best.signs)
        for branch, decided in zip(proof.branches[:kept], proof.decided[:kept], strict=True)
    ]
    return replace(
        result,
        branches=proof.branches[:kept],
        optimality_gap=optimality_gap,
        missed=float(np.exp(log_missed)),
        persistent=np.all(agreed, axis=0),
        decided=proof.decided[:kept],
    )


def _data_agree(problem: SearchProblem, best: Assignment, others: Sequence[Assignment]) -> bool:
    """Whether the best assignment also has the least data cost, the cost without the Tikhonov term.

    Only assignments whose Tikhonov term could change the order are checked. If the cost depends on the weight w of that
    term as a + b w^p, the term is p b w^p. So the data cost may be 1 / p Tikhonov terms lower; p = 1/3 for masses that
    diverge near the cone's edge.
    """
    near = [
        branch
        for branch in others
        if branch.cost - TUNING.hidden_by_tikhonov * problem.tikhonov_of(branch) <= best.cost + problem.exact
    ]
    value = problem.data_cost(best)[1] if near else best.cost
    return all(problem.data_cost(branch)[0] >= value - min(problem.exact, TUNING.alike) for branch in near)


def _listed(proof: Proof, cost: float, missed: float) -> tuple[int, float, float]:
    """Number of listed branches, their Delta, and the log of the mass of all others relative to the best's.

    The most expensive branches are dropped while the mass of the others stays below `missed`.
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


def candidate(problem: SearchProblem) -> Assignment:
    """The best combination of each joint's best patterns, without a proof."""
    tuning = problem.tuning

    def best_of_all(_: list[int]) -> tuple[Keep, float]:
        return lambda bound: np.argsort(bound, kind="stable")[: tuning.candidate_combinations], np.inf

    depths = [block.strong(tuning.candidate_share, tuning.listed) for block in problem.blocks]
    lists = [block.best(tuning.candidate_patterns, depth) for block, depth in zip(problem.blocks, depths, strict=True)]
    joined = combine(problem, lists, best_of_all)
    hessian, energy = problem.decided_moments(joined)
    prepared = problem.solver.prepared(hessian)
    solved: list[tuple[float, int, Array]] = []
    for row in np.argsort(joined.bound, kind="stable")[: tuning.candidates_solved]:
        if solved and joined.bound[row] - problem.slack >= solved[0][0]:
            break
        solution = problem.solve(prepared, joined.gradient[row])
        solved.append((energy + solution.cost, int(row), solution.theta))
        solved.sort(key=lambda candidate: candidate[:2])
    optima = [
        problem.local_optimum(problem.decided(joined, row), theta)
        for _, row, theta in solved[: tuning.candidates_optimised]
    ]
    best = min(optima, key=lambda branch: branch.cost)
    return _flipped(problem, problem.price(problem.local_optimum(problem.normal_equations.known, best.theta).signs))


def _flipped(problem: SearchProblem, branch: Assignment) -> Assignment:
    """The assignment with single segments flipped where that lowers the cost, most promising first."""
    known = problem.normal_equations.known
    unknown = np.flatnonzero(known == 0)
    for _ in range(problem.tuning.flipped):
        changes = problem.single_flips(branch, unknown)
        k = int(np.argmin(changes)) if unknown.size else 0
        if not unknown.size or changes[k] >= -problem.exact:
            break
        decided = known.copy()
        decided[unknown[k]] = -branch.signs[unknown[k]]
        flipped = problem.price(problem.local_optimum(decided, branch.theta).signs)
        if flipped.cost < branch.cost:
            branch = flipped
        else:
            unknown = np.delete(unknown, k)
    return branch


def _prove_enough(problem: SearchProblem, best: Assignment, least: Array, log_missed: float) -> Proof:
    """A proof whose Delta is raised until the missed mass is allowed, or the budget ends."""
    optimality_gap = -2.0 * log_missed + problem.tuning.allowance
    while True:
        limit = best.cost + optimality_gap
        survivors = combinations(problem, limit, least)
        excess = survivors.log_missed + 0.5 * best.cost - (log_missed - LOG2)
        if excess <= 0.0 or problem.budget.over:
            proof = prove(problem, survivors, limit, best.theta)
            best = min([best, *proof.branches], key=lambda branch: branch.cost)
            excess = proof.log_missed + 0.5 * best.cost - log_missed
            if excess <= 0.0 or problem.budget.over:
                return proof
        optimality_gap += 2.0 * excess + problem.tuning.growth
