"""The proof's tree: from combinations of the joints' patterns to branches whose every completion is accounted for."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesid.motion import Array, Integers, Mask
from bayesid.search.combinations import Combinations
from bayesid.search.flips import Flips
from bayesid.search.patterns import log_sum
from bayesid.search.problem import Problem
from bayesid.search.result import Branch


@dataclass(frozen=True)
class Proof:
    """What is proven about all assignments.

    Attributes:
        branches: those that are not excluded, cheapest first.
        decided: (branches, S) segments whose sign is the same in all that a branch stands for.
        others: (branches,) lower bounds of what a branch stands for but its own signs.
        limit: lower bound of the cost of all other assignments.
        log_missed: log of the sum of exp(-b / 2) over the others, b their bounds.
    """

    branches: tuple[Branch, ...]
    decided: Mask
    others: Array
    limit: float
    log_missed: float

    @property
    def lower_bound(self) -> float:
        """Of the cost of every assignment."""
        return min([self.limit, *(branch.lower_bound for branch in self.branches)])

    @property
    def runner_up(self) -> float:
        """Lower bound of the cost of every assignment but the cheapest branch's own signs."""
        bounds = [branch.lower_bound for branch in self.branches[1:]]
        return min([self.limit, float(self.others[0]), *bounds])


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
        others: the same of those completions but the branch's own signs.
        decided: (S,) segments whose sign is the same in all of them.
        children: nodes that split off.
        excluded: (k,) lower bounds of the completions that were cut off.
    """

    branch: Branch
    bound: float
    others: float
    decided: Mask
    children: list[_Node]
    excluded: Array


def prove(problem: Problem, combinations: Combinations, limit: float, theta: Array) -> Proof:
    """What is proven when all assignments but the combinations given cost more than `limit`.

    Undecided segments of a combination are settled together with the parameters. Where `flips` prove that none of them
    can be turned for the better, the combination is a branch. Otherwise those that cannot be turned below the limit are
    decided, and where that does not help, so is the one that weighs most, with its other sign as a node of its own.

    When the budget ends early, the nodes that are still open lower the proof's limit.

    Args:
        problem: the problem.
        combinations: of the joints' patterns.
        limit: cost up to which assignments matter.
        theta: (P,) the best parameters known.
    """
    patterns, log_missed = combinations.patterns, combinations.log_missed
    waiting = [
        _Node(float(bound), problem.decided(patterns, row), patterns.gradient[row], combinations.thetas.get(row, theta))
        for row, bound in enumerate(combinations.lower)
    ]
    weak = np.setdiff1d(np.flatnonzero(problem.moments.known == 0), patterns.segments)
    leaves: list[_Leaf] = []
    while waiting and not problem.out_of_time:
        waiting.sort(key=lambda node: -node.bound)
        leaf, waiting = _take_best(problem, waiting, weak, limit)
        cut = [node.bound for node in waiting if node.bound > limit]
        waiting = [node for node in waiting if node.bound <= limit]
        if leaf.bound <= limit:
            leaves.append(leaf)
        else:
            cut.append(leaf.bound)
        log_missed = float(np.logaddexp(log_missed, log_sum(np.concatenate([cut, leaf.excluded]))))
    leaves.sort(key=lambda leaf: leaf.branch.cost)
    return Proof(
        branches=tuple(replace(leaf.branch, lower_bound=leaf.bound) for leaf in leaves),
        decided=np.array([leaf.decided for leaf in leaves], dtype=bool),
        others=np.array([leaf.others for leaf in leaves]),
        limit=min([limit, *(node.bound for node in waiting)]),
        log_missed=np.inf if waiting else log_missed,
    )


def _take_best(problem: Problem, waiting: list[_Node], weak: Integers, limit: float) -> tuple[_Leaf, list[_Node]]:
    """Grows the last of the nodes, and what is left to do, with the bounds that it proves for the other ones.

    `weak` are the segments that the joints' lists do not decide: any of them may differ between two nodes.
    """
    node, others = waiting[-1], waiting[:-1]
    leaf = _grow(problem, node, limit)
    if others:
        steps = 0.5 * np.array([node.gradient - other.gradient for other in others])
        bounds = leaf.branch.lower_bound + problem.flips(leaf.branch, weak).forced(steps)
        others = [replace(other, bound=max(other.bound, float(b))) for other, b in zip(others, bounds, strict=True)]
    return leaf, [*others, *leaf.children]


def _grow(problem: Problem, node: _Node, limit: float) -> _Leaf:
    decided = node.decided.copy()
    branch = problem.complete(decided, node.theta)
    bound = branch.lower_bound + problem.flips(branch, np.flatnonzero(decided == 0)).best[0]
    if bound > limit:
        return _Leaf(branch, bound, bound, decided != 0, [], np.empty(0))
    branch = problem.price(problem.settle(decided, branch.theta).signs)
    children, excluded = [], [np.empty(0)]
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
    others = max(node.bound, branch.lower_bound + flips.any)
    return _Leaf(branch, bound, others, decided != 0, children, np.concatenate(excluded))


def settled(problem: Problem, branch: Branch, decided: Mask, limit: float) -> Mask:
    """(S,) the segments that are decided or cannot be turned below the limit, whatever happens to the other free ones.

    Each one found leaves fewer to interfere with the others; where that gets no further, one is turned for a trial.

    Args:
        problem: the problem.
        branch: a branch of a proof.
        decided: (S,) from the proof.
        limit: of the cost.
    """
    certain: Mask = decided.copy()
    tried = certain.copy()
    branch = problem.price(branch.signs)
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
