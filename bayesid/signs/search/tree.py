"""The proof's tree: from combinations of the joints' patterns to branches whose every completion is accounted for."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array, Integers, Mask
from bayesid.signs.search.combinations import Combinations
from bayesid.signs.search.consequences import Consequences, consequences
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

    def with_what_was_cut(self, bound: float, children: list[_Node], excluded: list[Array]) -> _Leaf:
        """The same within a node with this bound, and with what was cut off before."""
        return replace(
            self,
            bound=max(self.bound, bound),
            alternatives=max(self.alternatives, bound),
            children=children,
            excluded=np.concatenate([self.excluded, *excluded]),
        )


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
        _Node(
            bound=float(bound),
            decided=problem.decided(patterns, row),
            gradient=patterns.gradient[row],
            theta=combinations.thetas.get(row, theta),
        )
        for row, bound in enumerate(combinations.lower)
    ]
    weak = np.setdiff1d(np.flatnonzero(problem.moments.known == 0), patterns.segments)
    leaves: list[_Leaf] = []
    while open_nodes and not problem.out_of_time:
        open_nodes.sort(key=lambda node: -node.bound)
        node = open_nodes.pop()
        further = consequences(problem, node.decided, limit)
        cut = [further.bound] if further.bound > limit else []
        excluded = [further.excluded]
        if not cut:
            try:
                leaf = _grow(problem, node, further, limit)
            except OutOfTimeError:
                open_nodes.append(node)  # it stays open, as the others do
                break
            open_nodes = [*_raised(problem, open_nodes, node, leaf, weak), *leaf.children]
            if leaf.bound <= limit:
                leaves.append(leaf)
            else:
                cut.append(leaf.bound)
            excluded.append(leaf.excluded)
        cut.extend(node.bound for node in open_nodes if node.bound > limit)
        open_nodes = [node for node in open_nodes if node.bound <= limit]
        log_missed = float(np.logaddexp(log_missed, log_sum(np.concatenate([cut, *excluded]))))
    leaves.sort(key=lambda leaf: leaf.branch.cost)
    return Proof(
        branches=tuple(replace(leaf.branch, lower_bound=leaf.bound) for leaf in leaves),
        decided=np.array([leaf.decided for leaf in leaves], dtype=bool),
        alternatives=np.array([leaf.alternatives for leaf in leaves]),
        limit=min([limit, *(node.bound for node in open_nodes)]),
        log_missed=np.inf if open_nodes else log_missed,
    )


def _raised(problem: Problem, others: list[_Node], node: _Node, leaf: _Leaf, weak: Integers) -> list[_Node]:
    """Other nodes with the bounds that the leaf of a node proves for them.

    `weak` are the segments that the joints' lists do not decide: any of them may differ between two nodes. Where they
    are many, nothing is proven.
    """
    if not others or len(weak) > problem.limits.charged_flips:
        return others
    steps = 0.5 * np.array([node.gradient - other.gradient for other in others])
    bounds = leaf.branch.lower_bound + problem.flips(leaf.branch, weak).forced(steps)
    return [replace(other, bound=max(other.bound, float(bound))) for other, bound in zip(others, bounds, strict=True)]


def _grow(problem: Problem, node: _Node, further: Consequences, limit: float) -> _Leaf:
    """A node until nothing in it can be turned for the better.

    Args:
        problem: the problem.
        node: the node.
        further: what follows from what it decides.
        limit: of the cost.

    Raises:
        OutOfTimeError: the budget has ended before.
    """
    branch = problem.complete(further.signs, node.theta)
    bound = branch.lower_bound + problem.flips(branch, further.free).best[0]
    if bound > limit:
        return _Leaf(branch, bound, bound, further.decided != 0, [], np.empty(0))
    branch = problem.price(problem.settle(further.signs, branch.theta).signs)
    children: list[_Node] = []
    excluded = [further.excluded[:0]]
    while True:
        flips = problem.flips(branch, further.free)
        if flips.best[0] >= -problem.exact:
            return _closed(branch, flips, further, limit).with_what_was_cut(node.bound, children, excluded)
        if problem.out_of_time:
            raise OutOfTimeError
        branch, better = _improved(problem, branch, flips)
        if better:
            continue
        chosen, decided = flips.undecided, further.decided.copy()
        bounds = branch.lower_bound + flips.changes(chosen)
        sure = bounds > limit
        if np.any(sure):
            excluded.append(bounds[sure])
            chosen = chosen[sure]
        else:
            bound = max(node.bound, float(bounds[chosen == flips.heaviest][0]))
            chosen = np.array([flips.heaviest])
            decided[flips.free[chosen]] = -branch.signs[flips.free[chosen]]
            children.append(_Node(bound, decided.copy(), node.gradient, branch.theta))
        decided[flips.free[chosen]] = branch.signs[flips.free[chosen]]
        further = consequences(problem, decided, limit)
        excluded.append(further.excluded)
        if further.bound > limit:
            left = _Leaf(branch, further.bound, further.bound, further.decided != 0, [], np.empty(0))
            return left.with_what_was_cut(node.bound, children, excluded)
        if np.any(further.signs * branch.signs < 0):
            branch = problem.price(problem.settle(further.signs, branch.theta).signs)


def _closed(branch: Branch, flips: Flips, further: Consequences, limit: float) -> _Leaf:
    """The leaf where none of the free segments can be turned for the better."""
    least = branch.lower_bound + flips.best[0]
    alternatives = min(branch.lower_bound + flips.any, least + float(further.gain.min(initial=np.inf)))
    turned = least + further.gain
    turned[flips.free] = branch.lower_bound + flips.changes()
    sure = np.isfinite(turned) & (turned > limit)
    return _Leaf(branch, least, alternatives, (further.decided != 0) | sure, [], turned[sure])


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
