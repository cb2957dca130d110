"""T-PBPR: beam search over the signs of segments (Gaz and De Luca, Algorithm 1).

The first s0 segments are enumerated (2^s0 nodes), the w cheapest nodes survive, and each step gives every survivor two
children, one for each sign of the next segment. A node's cost is that of the best feasible parameters for the decided
segments. Unconstrained least squares (the paper's OLS per node) is a cheap lower bound of it
(:eq:`unconstrained-bound`). A node whose bound exceeds the w-th best cost is never solved in the cone.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.errors import InputError
from bayesid.progress import SILENT, Progress, Steps, no_steps
from bayesid.regression.normal_equations import NormalEquations
from bayesid.regression.solver import ConeLeastSquares
from bayesid.signs.search.bounds import UnconstrainedBound
from bayesid.signs.search.local import searched_locally
from bayesid.signs.search.protocol import (
    Assignment,
    Budget,
    NodeCostFactory,
    NodeSolver,
    PreparedNode,
    Pruning,
    Search,
    SearchResult,
    SignProblem,
    check_limits,
    listed_without_proof,
    predicted_signs,
    with_flipped,
)
from bayesid.signs.tuning import TUNING


@dataclass(frozen=True, kw_only=True)
class Beam(Search):
    """T-PBPR.

    Attributes:
        width: w of T-PBPR, nodes that survive each step.
        initial_segments: s0 of T-PBPR, segments enumerated at the start.
        node_solver: prices nodes, made from (cone, coefficients, hessian, energy); None for the cone.
        budget: nominal seconds of work for all beams of an identification (`bayesid.signs.search.protocol`); beams
            after that share a fifth of it. When a budget ends, each leaf predicts the signs of the undecided segments.
        time_limit: wall-clock seconds for all searches of an identification (`SearchResult.timed_out`).

    Example:
        >>> result = bayesid.identify(robot, log, terms, search=bayesid.Beam(width=3), posterior=False)
        >>> result.search.certified
        False
    """

    width: int = 5
    initial_segments: int = 5
    node_solver: NodeCostFactory | None = None
    budget: float = 10.0
    time_limit: float = 600.0

    def __post_init__(self) -> None:
        check_limits(self, self.budget, self.time_limit, endless=True)
        if self.width < 1:
            raise InputError(f"a beam of width {self.width}", field="Beam.width", remedy="give at least 1")
        if not 1 <= self.initial_segments <= TUNING.most_initial:
            what = f"{self.initial_segments} initial segments"
            raise InputError(what, field="Beam.initial_segments", remedy=f"give 1 to {TUNING.most_initial} (2^s nodes)")

    @property
    def any_model(self) -> bool:
        """False with a user's node solver, which may only know the requested model."""
        return self.node_solver is None

    def limited(self, budget: float, time_limit: float) -> Beam:
        """See Search."""
        return replace(self, budget=budget, time_limit=time_limit)

    def find(self, problem: SignProblem, steps: Steps = no_steps) -> SearchResult:
        """A beam; in the first round also a wider one, if the fit is poor.

        Raises:
            SolverError: a node could not be priced.
        """
        budget = Budget(self.budget, len(problem.hessian), self.time_limit)
        result = self._search(problem, self.width, budget, steps)
        if problem.earlier is not None or budget.over or not problem.is_poor(result):
            return replace(result, spent=budget.spent, timed_out=budget.timed_out)
        wider = self._search(problem, TUNING.wider_beam * self.width, budget, steps)
        best = min(result, wider, key=lambda candidate: candidate.cost)
        best = best.with_work_of([wider if best is result else result])
        return replace(best, spent=budget.spent, timed_out=budget.timed_out)

    def certify(self, problem: SignProblem, progress: Progress = SILENT) -> SearchResult:
        """A local search from the beam's leaves; none with a user's node solver.

        Raises:
            SolverError: a cone problem could not be solved.
        """
        result = super().certify(problem, progress)
        if self.node_solver is not None:
            return result
        seconds = max(self.time_limit - result.seconds, 0.0)
        with progress.stage("sign search: local search") as steps:
            return searched_locally(problem, [result], TUNING.failures, seconds, steps)

    def _search(self, problem: SignProblem, width: int, budget: Budget, steps: Steps) -> SearchResult:
        """A beam with joints flipped where that helps; at least as good as the signs of an earlier search."""
        normal_equations, pricing = problem.normal_equations, self._pricing(problem)
        result = beam(normal_equations, pricing, width, self.initial_segments, steps, budget)
        if problem.earlier is not None:
            result = keep_incumbent(
                normal_equations, pricing, result, problem.coefficients.project(problem.earlier.theta)
            )
        listed = _listed(normal_equations, flip_joints(normal_equations, pricing, result, budget), result.branches)
        tikhonov = pricing.regularisation(listed.theta) if isinstance(pricing, ConeLeastSquares) else None
        return replace(listed, tikhonov=tikhonov)

    def _pricing(self, problem: SignProblem) -> NodeSolver:
        if self.node_solver is None:
            return problem.solver()
        return self.node_solver(problem.cone, problem.coefficients, problem.hessian, problem.energy)


@dataclass(frozen=True)
class _Level:
    signs: Integers  # (w, d) the choices made, in search order: the path back to the root
    gradient: Array  # (w, r) sum of s_k g_k over the decided segments
    cost: Array  # (w,) node costs
    theta: Array  # (w, P) the nodes' parameters


def beam(
    normal_equations: NormalEquations,
    node_solver: NodeSolver,
    width: int | None = 5,
    initial: int = 5,
    steps: Steps = no_steps,
    budget: Budget | None = None,
) -> SearchResult:
    """Searches the signs of all unknown segments, those with the most energy first.

    Args:
        normal_equations: of S segments, scaled.
        node_solver: prices nodes; `bayesid.regression.solver.ConeLeastSquares` is PBPR as in the paper.
        width: w, nodes that survive each step; None for all (exhaustive).
        initial: s0, segments enumerated at the start.
        steps: called as steps(decided, total) after each step.
        budget: no step begins after it, except the first one; None: unlimited.

    Raises:
        SolverError: a node could not be priced.
    """
    began = time.perf_counter()
    known, unknown = (
        np.flatnonzero(normal_equations.known),
        np.flatnonzero((normal_equations.known == 0) & normal_equations.individual),
    )
    order = unknown[np.argsort(-normal_equations.energy[unknown], kind="stable")]  # they carry most information
    budget = Budget() if budget is None else budget
    pricing = _Pricing(node_solver, budget)
    hessian = normal_equations.hessian_of(known)
    energy = float(normal_equations.energy[known].sum())
    level = _Level(
        signs=np.empty((1, 0), dtype=np.int64),
        gradient=(normal_equations.known[known] @ normal_equations.gradient[known])[None, :],
        cost=np.zeros(1),
        theta=np.empty((1, 0)),
    )
    depth = 0
    while True:
        group = order[depth : depth + (initial if depth == 0 else 1)]
        hessian = hessian + normal_equations.hessian_of(group)
        energy += float(normal_equations.energy[group].sum())
        candidates = _expand(level, normal_equations.gradient[group])
        depth += len(group)
        level = pricing.select(candidates, hessian, energy, width)
        steps(depth, len(order))
        if depth >= len(order) or budget.over:
            break
    leaves = []
    for chosen, theta, cost in zip(level.signs, level.theta, level.cost, strict=True):
        signs = normal_equations.known.copy()
        signs[order[:depth]] = chosen
        leaves.append(Assignment(signs, theta, float(cost), -np.inf))
    if depth + len(known) < len(normal_equations):
        leaves = _with_undecided_segments(normal_equations, node_solver, leaves, hessian, level.gradient)
        pricing.solves += len(leaves)
    result = SearchResult(
        signs=leaves[0].signs,
        theta=leaves[0].theta,
        cost=leaves[0].cost,
        method="beam",
        width=width,
        nodes=pricing.pruning.grown,
        solves=pricing.solves,
        tolerance=pricing.tolerance,
        seconds=time.perf_counter() - began,
        pruning=replace(pricing.pruning, leaves=len(leaves), undecided=max(len(order) - depth, 0)),
    )
    return _listed(normal_equations, result, leaves)


def _with_undecided_segments(
    normal_equations: NormalEquations,
    node_solver: NodeSolver,
    leaves: list[Assignment],
    hessian: Array,
    gradients: Array,
) -> list[Assignment]:
    """Undecided segments get the signs that the other segments' coefficients predict; cheapest leaf first."""
    prepared, energy, whole = (
        node_solver.prepared(normal_equations.hessian.total()),
        float(normal_equations.energy.sum()),
        [],
    )
    for leaf, gradient in zip(leaves, gradients, strict=True):
        signs = predicted_signs(normal_equations, np.linalg.lstsq(hessian, gradient, rcond=None)[0], leaf.signs)
        solution = prepared.solve(signs @ normal_equations.gradient)
        whole.append(Assignment(signs, solution.theta, energy + solution.cost, -np.inf))
    return sorted(whole, key=lambda leaf: leaf.cost)


def _listed(normal_equations: NormalEquations, result: SearchResult, leaves: Iterable[Assignment]) -> SearchResult:
    """The result with its signs and those of the leaves as branches, without leaves of much higher cost."""
    best = Assignment(result.signs, result.theta, result.cost, -np.inf)
    branches, decided = listed_without_proof(normal_equations, best, leaves)
    return replace(result, branches=branches, decided=decided)


def _expand(level: _Level, gradients: Array) -> tuple[Integers, Array]:
    d = len(gradients)
    choices = np.array(list(itertools.product((1, -1), repeat=d)), dtype=np.int64).reshape(2**d, d)
    repeated = np.repeat(level.signs, len(choices), axis=0)
    tiled = np.tile(choices, (len(level.signs), 1))
    gradient = np.repeat(level.gradient, len(choices), axis=0) + tiled @ gradients
    return np.hstack([repeated, tiled]), gradient


class _Pricing:
    """Selects the cheapest nodes of a depth with few cone problems, and counts the work."""

    def __init__(self, node_solver: NodeSolver, budget: Budget) -> None:
        self._node_cost, self._budget = node_solver, budget
        self.pruning = Pruning()
        self.solves = 0
        self.tolerance = 0.0

    def select(self, candidates: tuple[Integers, Array], hessian: Array, energy: float, width: int | None) -> _Level:
        signs, gradient = candidates
        bound = energy + UnconstrainedBound(hessian)(gradient)
        width = len(signs) if width is None else width
        prepared = self._node_cost.prepared(hessian)
        survivors: list[tuple[float, int, Array]] = []
        before = self.solves
        self._budget.count(steps=1, choices=len(signs))
        for i in np.argsort(bound, kind="stable"):
            if len(survivors) >= width and bound[i] >= survivors[width - 1][0]:
                break
            solution = prepared.solve(gradient[i])
            self.solves += 1
            self._budget.count(parameters=len(solution.theta))
            self.tolerance = max(self.tolerance, solution.tolerance)
            survivors.append((energy + solution.cost, int(i), solution.theta))
            survivors.sort(key=lambda node: node[:2])
        survivors, solved = survivors[:width], self.solves - before
        self.pruning += Pruning(len(signs), len(signs) - solved, solved - len(survivors), len(survivors))
        chosen = [i for _, i, _ in survivors]
        cost = np.array([cost for cost, _, _ in survivors])
        return _Level(signs[chosen], gradient[chosen], cost, np.array([theta for _, _, theta in survivors]))


def keep_incumbent(
    normal_equations: NormalEquations, node_solver: NodeSolver, result: SearchResult, beta: Array
) -> SearchResult:
    """The result, or the signs that earlier coefficients beta (r,) predict if those cost less.

    A narrow beam on newly cut segments may miss the signs of the search before.
    """
    return _cheaper(
        normal_equations,
        node_solver.prepared(normal_equations.hessian.total()),
        result,
        predicted_signs(normal_equations, beta),
    )


def _cheaper(
    normal_equations: NormalEquations, prepared: PreparedNode, result: SearchResult, signs: Integers
) -> SearchResult:
    solution = prepared.solve(signs @ normal_equations.gradient)
    result = replace(result, solves=result.solves + 1, tolerance=max(result.tolerance, solution.tolerance))
    other = Assignment(signs, solution.theta, float(normal_equations.energy.sum()) + solution.cost, -np.inf)
    return result.with_best(other) if other.cost < result.cost else result


def flip_joints(
    normal_equations: NormalEquations, node_solver: NodeSolver, result: SearchResult, budget: Budget | None = None
) -> SearchResult:
    """The result with all signs of a joint flipped wherever that lowers the cost.

    With friction in the model each joint is nearly symmetric under a flip. A beam that keeps the wrong half of that
    symmetry cannot correct it segment by segment. Every joint is tried at least once, whatever the budget.
    """
    prepared, budget = node_solver.prepared(normal_equations.hessian.total()), Budget() if budget is None else budget
    joints = np.unique(normal_equations.joint[normal_equations.known == 0])
    better, tried, failed = True, 0, 0
    while better:
        better = False
        for joint in joints:
            if budget.over and tried >= len(joints):
                break
            before, result = (
                result,
                _cheaper(normal_equations, prepared, result, with_flipped(normal_equations, result.signs, joint)),
            )
            budget.count(parameters=len(result.theta))
            tried, better = tried + 1, result.cost < before.cost
            failed = 0 if better else failed + 1
            if better:
                break
    return replace(result, unlisted_probability=1.0 / (failed + 2.0))
