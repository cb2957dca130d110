"""The proof's tree: from combinations of the joints' patterns to branches that cover all completions.

Consequences are signs that follow from decided ones, segment by segment. Let D be the decided segments, l the least
cost of their rows with half of the Tikhonov term, beta the coefficients at that minimum and H its curvature. For
another segment k, with v_k = g_k' H^-1 g_k:

1. The residual of its efforts along their own direction costs at least (c_k - s g_k' beta)^2 / c_k. So the total cost
   under its sign s is at least :eq:`consequence`::

       l + (c_k - s g_k' beta)^2 / (c_k + v_k).

   A sign is excluded if this bound exceeds the limit. If both signs are, the decided signs are excluded.
2. The best coefficients beta* of an assignment with a cost up to L satisfy |g_k' (beta* - beta)| <= sqrt(v_k (L - l)).
   If g_k' beta* thus has the sign of g_k' beta, the other sign costs more, for any signs of the others, by the gain

       4 (|g_k' beta| - sqrt(v_k (L - l)))

   (:eq:`prediction`). So the predicted sign is assumed, which keeps a best assignment, and its rows are added.
3. Every assignment with an assumed sign flipped costs more than one without a flip, by at least the gain.

Decided and assumed signs determine further signs. An assumption depends on earlier assumptions only. When gains exclude
signs, all assumptions are derived again from the decided signs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array, Integers, Mask
from bayesid.signs.search.bounds import Flips, UnconstrainedBound
from bayesid.signs.search.combinations import Combinations
from bayesid.signs.search.patterns import log_sum
from bayesid.signs.search.problem import OutOfTimeError, SearchProblem
from bayesid.signs.search.protocol import Assignment


@dataclass(frozen=True)
class Consequences:
    """Consequences of a partial assignment."""

    decided: Integers  # (S,) +1 or -1 if the other sign is excluded, else 0
    signs: Integers  # (S,) decided and assumed signs
    gain: Array  # (S,) least extra cost of the other sign of an assumed one; else inf
    bound: float  # lower bound of the cost of all completions; if above the limit, the other fields are unused
    excluded: Array  # (k,) lower bounds of the cost with one of the excluded signs

    @property
    def free(self) -> Integers:
        """Segments that are neither decided nor assumed."""
        return np.flatnonzero(self.signs == 0)


def consequences(problem: SearchProblem, decided: Integers, limit: float) -> Consequences:
    """Consequences of decided signs (S,), 0 if undecided, for assignments with a cost up to `limit`."""
    excluded = []
    while True:
        found = _once(problem, decided, limit)
        excluded.append(found.excluded)
        flipped = found.bound + found.gain
        sure = np.isfinite(flipped) & (flipped > limit)
        decided = np.where(sure, found.signs, found.decided)
        excluded.append(flipped[sure])
        if found.bound > limit or not np.any(sure):
            return replace(found, excluded=np.concatenate(excluded))


def _once(problem: SearchProblem, decided: Integers, limit: float) -> Consequences:
    normal_equations, rows, signs = problem.normal_equations, np.flatnonzero(decided), decided.copy()
    decided, gains, excluded = decided.copy(), np.full(len(decided), np.inf), [np.empty(0)]
    known, bound = _Rows(problem), 0.0
    while rows.size:
        known.add(rows, signs)
        free = np.flatnonzero((signs == 0) & normal_equations.individual & (normal_equations.energy > 0.0))
        slope, spread = known.predict(free)
        costs = known.least + (normal_equations.energy[free] - np.array([[1.0], [-1.0]]) * slope) ** 2 / (
            normal_equations.energy[free] + spread
        )
        bound = max(bound, known.least, float(costs.min(axis=0).max(initial=-np.inf)))
        if bound > limit:
            break
        gain = 4.0 * (np.abs(slope) - np.sqrt(spread * (limit - known.least)))
        sure = costs.max(axis=0) > limit
        assumed = ~sure & (gain > problem.exact)
        excluded.append(costs[:, sure].max(axis=0))
        gains[free[assumed]] = gain[assumed]
        rows = free[sure | assumed]
        signs[rows] = np.where(slope[sure | assumed] >= 0.0, 1, -1)
        decided[free[sure]] = signs[free[sure]]
    return Consequences(decided, signs, gains, bound, np.concatenate(excluded))


class _Rows:
    def __init__(self, problem: SearchProblem) -> None:
        self._problem, self._normal_equations = problem, problem.normal_equations
        self._hessian, self._gradient, self._energy = 0.5 * problem.tikhonov, np.zeros(len(problem.tikhonov)), 0.0
        self.add(np.empty(0, dtype=np.int64), problem.normal_equations.known)

    def add(self, segments: Integers, signs: Integers) -> None:
        """Adds segments, with signs (S,) of all."""
        normal_equations = self._normal_equations
        self._hessian = self._hessian + normal_equations.hessian_of(segments)
        self._gradient = self._gradient + signs[segments] @ normal_equations.gradient[segments]
        self._energy += float(normal_equations.energy[segments].sum())
        self._unconstrained = UnconstrainedBound(self._hessian, 0.0)
        self._white = self._unconstrained.whiten(self._gradient[None])[0]
        self._problem.count(len(normal_equations))

    @property
    def least(self) -> float:
        """Lower bound of their cost."""
        return self._energy - float(self._white @ self._white) - self._problem.slack

    def predict(self, segments: Integers) -> tuple[Array, Array]:
        """(k,) g' beta and g' H^-1 g of other segments."""
        white = self._unconstrained.whiten(self._normal_equations.gradient[segments])
        return white @ self._white, np.sum(white**2, axis=1)


@dataclass(frozen=True)
class Proof:
    """Proven lower bounds of the cost of all assignments."""

    branches: tuple[Assignment, ...]  # assignments that are not excluded, cheapest first
    decided: Mask  # (branches, S) segments whose sign is the same in the whole branch
    alternatives: Array  # (branches,) lower bounds of the branch except its best assignment
    limit: float  # lower bound of the cost of all other assignments
    log_missed: float  # log of the sum of exp(-b / 2) over all other assignments, b their bounds

    @property
    def lower_bound(self) -> float:
        """Lower bound of the cost of every assignment."""
        return min([self.limit, *(branch.lower_bound for branch in self.branches)])

    @property
    def runner_up(self) -> float:
        """Lower bound of the cost of every assignment except the signs of the cheapest branch."""
        bounds = [branch.lower_bound for branch in self.branches[1:]]
        return min([self.limit, float(self.alternatives[0]), *bounds])


@dataclass(frozen=True)
class _Node:
    bound: float  # lower bound of the cost of all its completions
    decided: Integers  # (S,) +1, -1, or 0 if undecided
    gradient: Array  # (r,) of the known segments and those that the joints' lists decide
    theta: Array  # (P,) first parameters of the alternation


@dataclass(frozen=True)
class _Leaf:
    branch: Assignment  # the local optimum; its lower bound is for its signs only
    bound: float  # lower bound of the cost of all completions that are neither excluded nor in children
    alternatives: float  # the same except `branch`
    decided: Mask  # (S,) segments whose sign is the same in all of them
    children: list[_Node]  # split-off nodes
    excluded: Array  # (k,) lower bounds of the completions that were cut off

    def with_what_was_cut(self, bound: float, children: list[_Node], excluded: list[Array]) -> _Leaf:
        """The leaf of a node with this bound, with the node's children and exclusions."""
        return replace(
            self,
            bound=max(self.bound, bound),
            alternatives=max(self.alternatives, bound),
            children=children,
            excluded=np.concatenate([self.excluded, *excluded]),
        )


def prove(problem: SearchProblem, combinations: Combinations, limit: float, theta: Array) -> Proof:
    """The proof, given that all assignments outside of the combinations cost more than `limit`.

    A combination's undecided segments start from the local optimum of alternating signs and parameters, from theta
    (P,). If `Flips` prove that no flip lowers the cost, the combination is a branch. Otherwise segments whose flip
    costs more than the limit are decided. If there are none, the most influential segment is decided, and its other
    sign becomes a new node. Nodes that are open when the budget ends lower the limit.
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
    weak = np.setdiff1d(np.flatnonzero(problem.normal_equations.known == 0), patterns.segments)
    leaves: list[_Leaf] = []
    while open_nodes and not problem.budget.over:
        open_nodes.sort(key=lambda node: -node.bound)
        node = open_nodes.pop()
        further = consequences(problem, node.decided, limit)
        cut = [further.bound] if further.bound > limit else []
        excluded = [further.excluded]
        if not cut:
            try:
                leaf = _grow(problem, node, further, limit)
            except OutOfTimeError:
                open_nodes.append(node)  # it stays open, like the others
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


def _raised(problem: SearchProblem, others: list[_Node], node: _Node, leaf: _Leaf, weak: Integers) -> list[_Node]:
    """Other nodes with bounds raised to those that a node's leaf proves; unchanged with many weak segments.

    Weak segments are not decided by the joints' lists; any of them may differ between two nodes.
    """
    if not others or len(weak) > problem.tuning.charged_flips:
        return others
    steps = 0.5 * np.array([node.gradient - other.gradient for other in others])
    bounds = leaf.branch.lower_bound + problem.flips(leaf.branch, weak).forced(steps)
    return [replace(other, bound=max(other.bound, float(bound))) for other, bound in zip(others, bounds, strict=True)]


def _grow(problem: SearchProblem, node: _Node, further: Consequences, limit: float) -> _Leaf:
    """Decides segments of a node until no flip lowers its cost; raises OutOfTimeError at the end of the budget."""
    branch = problem.complete(further.signs, node.theta)
    bound = branch.lower_bound + problem.flips(branch, further.free).best[0]
    if bound > limit:
        return _Leaf(branch, bound, bound, further.decided != 0, [], np.empty(0))
    branch = problem.price(problem.local_optimum(further.signs, branch.theta).signs)
    children: list[_Node] = []
    excluded = [further.excluded[:0]]
    while True:
        flips = problem.flips(branch, further.free)
        if flips.best[0] >= -problem.exact:
            return _closed(branch, flips, further, limit).with_what_was_cut(node.bound, children, excluded)
        if problem.budget.over:
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
            leaf = _Leaf(branch, further.bound, further.bound, further.decided != 0, [], np.empty(0))
            return leaf.with_what_was_cut(node.bound, children, excluded)
        if np.any(further.signs * branch.signs < 0):
            branch = problem.price(problem.local_optimum(further.signs, branch.theta).signs)


def _closed(branch: Assignment, flips: Flips, further: Consequences, limit: float) -> _Leaf:
    least = branch.lower_bound + flips.best[0]
    alternatives = min(branch.lower_bound + flips.any, least + float(further.gain.min(initial=np.inf)))
    flipped = least + further.gain
    flipped[flips.free] = branch.lower_bound + flips.changes()
    sure = np.isfinite(flipped) & (flipped > limit)
    return _Leaf(branch, least, alternatives, (further.decided != 0) | sure, [], flipped[sure])


def persistent(problem: SearchProblem, branch: Assignment, decided: Mask, limit: float) -> Mask:
    """(S,) segments of a proof's branch that are decided, or whose flip costs more than the limit.

    Each persistent segment tightens the bounds of the others. If no bound suffices, the strongest segment is flipped
    and bounded by itself.
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
        if not hopeful.size or problem.budget.over:
            return certain
        k = hopeful[np.argmax(problem.normal_equations.energy[hopeful])]
        tried[k] = True
        certain[k] = _flipped(problem, branch, np.where(certain, branch.signs, 0), int(k)) > limit


def _flipped(problem: SearchProblem, branch: Assignment, decided: Integers, k: int) -> float:
    decided[k] = -branch.signs[k]
    flipped = problem.local_optimum(decided, branch.theta)
    return flipped.lower_bound + problem.flips(flipped, np.flatnonzero(decided == 0)).best[0]


def _improved(problem: SearchProblem, branch: Assignment, flips: Flips) -> tuple[Assignment, bool]:
    signs = branch.signs.copy()
    signs[flips.best[1]] *= -1
    flipped = problem.price(signs)
    return (flipped, True) if flipped.cost < branch.cost - problem.exact else (branch, False)
