"""The proof's tree: from combinations of the joints' patterns to branches whose every completion is accounted for."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array, Integers, Mask
from bayesid.signs.search.combinations import Combinations
from bayesid.signs.search.flips import Flips
from bayesid.signs.search.patterns import log_sum
from bayesid.signs.search.problem import OutOfTimeError, Problem
from bayesid.signs.search.result import Branch


@dataclass(frozen=True)
class Proof:
    """What is proven about all assignments.

    Attributes:
        branches: those that are not excluded, cheapest first.
        decided: (branches, S) segments whose sign is the same in all that a branch stands for.
        alternatives: (branches,) lower bounds of what a branch stands for but the branch itself.
        limit: lower bound of the cost of all other assignments.
        log_missed: log of the sum of exp(-b / 2) over these, b their bounds.
    """

    branches: tuple[Branch, ...]
    decided: Mask
    alternatives: Array
    limit: float
    log_missed: float

    @property
    def lower_bound(self) -> float:
        """Of the cost of every assignment."""
        return min([self.limit, *(branch.lower_bound for branch in self.branches)])

    @property
    def runner_up(self) -> float:
        """Lower bound of the cost of every assignment but the signs of the cheapest branch."""
        bounds = [branch.lower_bound for branch in self.branches[1:]]
        return min([self.limit, float(self.alternatives[0]), *bounds])


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
        alternatives: the same of those completions but the branch itself.
        decided: (S,) segments whose sign is the same in all of them.
        children: nodes that split off.
        excluded: (k,) lower bounds of the completions that were cut off.
    """

    branch: Branch
    bound: float
    alternatives: float
    decided: Mask
    children: list[_Node]
    excluded: Array


def prove(problem: Problem, combinations: Combinations, limit: float, theta: Array) -> Proof:
    """What is proven when all assignments but the combinations given cost more than `limit`.

    Undecided segments of a combination are settled together with the parameters. Where `flips` prove that none of them
    can be turned for the better, the combination is a branch. Otherwise those that cannot be turned below the limit are
    decided, and where that does not help, so is the one that weighs most, with its other sign as a node of its own.

    When the budget ends early, the nodes that are still open lower the limit.

    Args:
        problem: the problem.
        combinations: of the joints' patterns.
        limit: cost up to which assignments matter.
        theta: (P,) the best parameters known.
    """
    patterns, log_missed = combinations.patterns, combinations.log_missed
    open_nodes = [
        _Node(float(bound), problem.decided(patterns, row), patterns.gradient[row], combinations.thetas.get(row, theta))
        for row, bound in enumerate(combinations.lower)
    ]
    weak = np.setdiff1d(np.flatnonzero(problem.moments.known == 0), patterns.segments)
    leaves: list[_Leaf] = []
    while open_nodes and not problem.out_of_time:
        open_nodes.sort(key=lambda node: -node.bound)
        try:
            leaf, open_nodes = _take_best(problem, open_nodes, weak, limit)
        except OutOfTimeError:
            break  # it stays open, as the others do
        cut = [node.bound for node in open_nodes if node.bound > limit]
        open_nodes = [node for node in open_nodes if node.bound <= limit]
        if leaf.bound <= limit:
            leaves.append(leaf)
        else:
            cut.append(leaf.bound)
        log_missed = float(np.logaddexp(log_missed, log_sum(np.concatenate([cut, leaf.excluded]))))
    leaves.sort(key=lambda leaf: leaf.branch.cost)
    return Proof(
        branches=tuple(replace(leaf.branch, lower_bound=leaf.bound) for leaf in leaves),
        decided=np.array([leaf.decided for leaf in leaves], dtype=bool),
        alternatives=np.array([leaf.alternatives for leaf in leaves]),
        limit=min([limit, *(node.bound for node in open_nodes)]),
        log_missed=np.inf if open_nodes else log_missed,
    )


def _take_best(problem: Problem, open_nodes: list[_Node], weak: Integers, limit: float) -> tuple[_Leaf, list[_Node]]:
    """Grows the last of the nodes; the leaf, and the open nodes with the bounds that it proves for them.

    `weak` are the segments that the joints' lists do not decide: any of them may differ between two nodes.
    """
    node, remaining = open_nodes[-1], open_nodes[:-1]
    leaf = _grow(problem, node, limit)
    if remaining:
        steps = 0.5 * np.array([node.gradient - other.gradient for other in remaining])
        bounds = leaf.branch.lower_bound + problem.flips(leaf.branch, weak).forced(steps)
        remaining = [
            replace(other, bound=max(other.bound, float(bound))) for other, bound in zip(remaining, bounds, strict=True)
        ]
    return leaf, [*remaining, *leaf.children]


def _grow(problem: Problem, node: _Node, limit: float) -> _Leaf:
    """A node until nothing in it can be turned for the better.

    Raises:
        OutOfTimeError: the budget has ended before.
    """
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
        if problem.out_of_time:
            raise OutOfTimeError
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
            turned = decided.copy()
            turned[flips.free[k]] = -branch.signs[flips.free[k]]
            children.append(_Node(max(node.bound, float(bounds[k])), turned, node.gradient, branch.theta))
        decided[flips.free[sure]] = branch.signs[flips.free[sure]]
    bound = max(node.bound, branch.lower_bound + flips.best[0])
    alternatives = max(node.bound, branch.lower_bound + flips.any)
    return _Leaf(branch, bound, alternatives, decided != 0, children, np.concatenate(excluded))


def settled(problem: Problem, branch: Branch, decided: Mask, limit: float) -> Mask:
    """(S,) the segments that are decided or cannot be turned below the limit, whatever happens to the other free ones.

    Each that is settled leaves fewer to interfere with; where that gets no further, the strongest is turned on trial.

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
    turned = problem.settle(decided, branch.theta)
    return turned.lower_bound + problem.flips(turned, np.flatnonzero(decided == 0)).best[0]


def _improved(problem: Problem, branch: Branch, flips: Flips) -> tuple[Branch, bool]:
    """The branch with the flips that may pay, if they do."""
    signs = branch.signs.copy()
    signs[flips.best[1]] *= -1
    flipped = problem.price(signs)
    return (flipped, True) if flipped.cost < branch.cost - problem.exact else (branch, False)
