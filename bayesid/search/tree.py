"""The proof's tree: from combinations of the joints' patterns to branches whose every completion is accounted for."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesid.motion import Array, Integers, Mask
from bayesid.search.flips import Flips
from bayesid.search.patterns import Patterns, log_sum
from bayesid.search.problem import Problem
from bayesid.search.result import Branch, UnconstrainedBound


@dataclass(frozen=True)
class Proof:
    """What is proven about all assignments.

    Attributes:
        branches: those that are not excluded, cheapest first.
        certain: (branches, S) segments whose sign cannot differ from the branch's within `limit`.
        limit: lower bound of the cost of all other assignments.
        log_missed: log of the sum of exp(-b / 2) over the others, b their bounds.
    """

    branches: tuple[Branch, ...]
    certain: Mask
    limit: float
    log_missed: float

    @property
    def lower_bound(self) -> float:
        """Of the cost of every assignment."""
        return min([self.limit, *(branch.lower_bound for branch in self.branches)])


@dataclass(frozen=True)
class _Node:
    """A partial assignment.

    Attributes:
        bound: lower bound of the cost of all its completions.
        decided: (S,) +1, -1, or 0 where undecided.
        gradient: (r,) of the segments known beforehand and those that the joints' lists decide.
        theta: (P,) where settling starts.
    """

    bound: float
    decided: Integers
    gradient: Array
    theta: Array


@dataclass(frozen=True)
class _Leaf:
    """A node grown to its end.

    Attributes:
        branch: the settled assignment; its lower bound is that of its signs alone.
        bound: lower bound of the cost of all completions that are neither excluded nor children's.
        certain: (S,) segments whose sign cannot differ within the limit.
        children: nodes that split off.
        excluded: (k,) lower bounds of the completions that were cut off.
    """

    branch: Branch
    bound: float
    certain: Mask
    children: list[_Node]
    excluded: Array


def prove(problem: Problem, joined: Patterns, limit: float, theta: Array) -> Proof:
    """What is proven when all assignments that `joined` leaves out cost more than `limit`.

    Undecided segments of a combination are settled together with the parameters. Where `flips` prove that none of them
    can be turned for the better, the combination is a branch. Otherwise those that cannot be turned below the limit are
    decided, and where that does not help, so is the one that weighs most, with its other sign as a node of its own.

    When the budget ends early, the nodes that are still open lower the proof's limit.

    Args:
        problem: the problem.
        joined: combinations of the joints' patterns.
        limit: cost up to which assignments matter.
        theta: (P,) the best parameters known.
    """
    lower, thetas = _in_the_cone(problem, joined, limit)
    left = [int(row) for row in np.flatnonzero(lower <= limit)]
    decided = [problem.decided(joined, row) for row in left]
    waiting = [
        _Node(float(lower[row]), signs, joined.gradient[row], thetas.get(row, theta))
        for row, signs in zip(left, decided, strict=True)
    ]
    log_missed = np.logaddexp(joined.left_out + 0.5 * problem.slack, log_sum(np.delete(lower, left)))
    branches: list[tuple[Branch, Mask]] = []
    while waiting and not problem.out_of_time:
        waiting.sort(key=lambda node: -node.bound)
        leaf, waiting = _take_best(problem, waiting, limit)
        cut = [node.bound for node in waiting if node.bound > limit]
        waiting = [node for node in waiting if node.bound <= limit]
        if leaf.bound <= limit:
            branches.append((replace(leaf.branch, lower_bound=leaf.bound), leaf.certain))
        else:
            cut.append(leaf.bound)
        log_missed = np.logaddexp(log_missed, log_sum(np.concatenate([cut, leaf.excluded])))
    branches.sort(key=lambda one: one[0].cost)
    return Proof(
        branches=tuple(branch for branch, _ in branches),
        certain=np.array([certain for _, certain in branches], dtype=bool),
        limit=min([limit, *(node.bound for node in waiting)]),
        log_missed=np.inf if waiting else float(log_missed),
    )


def _in_the_cone(problem: Problem, patterns: Patterns, limit: float) -> tuple[Array, dict[int, Array]]:
    """(m,) lower bounds in the cone of all combinations, and the parameters of those that were solved.

    A solved problem bounds the others too: with other signs its cost changes by -2 step' beta, it is strongly convex
    around its optimum, and the least over all d of d'(H + Q)d - 2 step'(beta + d) is left. So few need be solved.
    """
    hessian, energy = problem.decided_moments(patterns)
    problem.set_hessian(hessian)
    white = UnconstrainedBound(hessian + problem.pull, ridge=0.0).whiten(patterns.gradient)
    lower = patterns.bound - problem.slack
    solved: dict[int, Array] = {}
    waiting = lower <= limit
    while np.any(waiting) and not problem.out_of_time:
        row = int(np.flatnonzero(waiting)[np.argmin(lower[waiting])])
        solution = problem.solve(patterns.gradient[row])
        solved[row] = solution.theta
        reach = np.sum((white - white[row]) ** 2, axis=1)
        change = -2.0 * (patterns.gradient - patterns.gradient[row]) @ problem.project(solution.theta)
        doubt = 2.0 * np.sqrt((solution.cost - solution.lower_bound) * reach)
        lower = np.maximum(lower, energy + solution.lower_bound + change - reach - doubt)
        waiting = (lower <= limit) & waiting
        waiting[row] = False
    return lower, solved


def _take_best(problem: Problem, waiting: list[_Node], limit: float) -> tuple[_Leaf, list[_Node]]:
    """Grows the last of the nodes, and what is left to do, with the bounds that it proves for the other ones."""
    node, others = waiting[-1], waiting[:-1]
    leaf = _grow(problem, node, limit)
    if others:
        weak = np.flatnonzero(node.decided == 0)
        steps = 0.5 * np.array([node.gradient - other.gradient for other in others])
        bounds = leaf.branch.lower_bound + problem.flips(leaf.branch, weak).forced(steps)
        others = [replace(other, bound=max(other.bound, float(b))) for other, b in zip(others, bounds, strict=True)]
    return leaf, [*others, *leaf.children]


def _grow(problem: Problem, node: _Node, limit: float) -> _Leaf:
    branch = problem.price(problem.settle(node.decided, node.theta).signs)
    decided, children, excluded = node.decided.copy(), [], []
    while True:
        flips = problem.flips(branch, np.flatnonzero(decided == 0))
        if flips.best[0] >= -problem.exact:
            break
        branch, better = _improved(problem, branch, flips)
        if better:
            continue
        bounds = branch.lower_bound + flips.changes()
        sure = bounds > limit
        if np.any(sure):
            excluded.append(bounds[sure])
        else:
            k = flips.heaviest
            sure[k] = True
            other = decided.copy()
            other[flips.free[k]] = -branch.signs[flips.free[k]]
            children.append(_Node(max(node.bound, float(bounds[k])), other, node.gradient, branch.theta))
        decided[flips.free[sure]] = branch.signs[flips.free[sure]]
    bound = max(node.bound, branch.lower_bound + flips.best[0])
    certain = _certain(problem, branch, decided, limit)
    return _Leaf(branch, bound, certain, children, np.concatenate([np.empty(0), *excluded]))


def _certain(problem: Problem, branch: Branch, decided: Integers, limit: float) -> Mask:
    """(S,) the segments that are decided or cannot be turned below the limit.

    Each one found leaves fewer to interfere with the others; where that gets no further, one is turned for a trial.
    """
    certain: Mask = decided != 0
    tried = certain.copy()
    while True:
        flips = problem.flips(branch, np.flatnonzero(~certain))
        sure = branch.lower_bound + flips.changes() > limit
        certain[flips.free[sure]] = True
        if np.any(sure):
            continue
        hopeful = flips.free[~tried[flips.free] & (branch.lower_bound + flips.alone > limit)]
        if not hopeful.size or problem.out_of_time:
            return certain
        k = hopeful[np.argmax(problem.moments.energy[hopeful])]
        tried[k] = True
        certain[k] = _turned(problem, branch, np.where(certain, branch.signs, 0), int(k)) > limit


def _turned(problem: Problem, branch: Branch, decided: Integers, k: int) -> float:
    """Lower bound of all completions in which segment k is turned."""
    decided[k] = -branch.signs[k]
    other = problem.settle(decided, branch.theta)
    return other.lower_bound + problem.flips(other, np.flatnonzero(decided == 0)).best[0]


def _improved(problem: Problem, branch: Branch, flips: Flips) -> tuple[Branch, bool]:
    """The branch with the flips that may pay, if they do."""
    signs = branch.signs.copy()
    signs[flips.best[1]] *= -1
    other = problem.price(signs)
    return (other, True) if other.cost < branch.cost - problem.exact else (branch, False)
