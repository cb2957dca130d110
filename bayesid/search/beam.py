"""T-PBPR: a tree of sign choices, pruned by what a feasible robot could cost (Gaz and De Luca, Algorithm 1).

The first s0 segments are enumerated (2^s0 nodes), the w cheapest nodes survive, and each step gives every survivor two
children, one for each sign of the next segment. A node's cost is that of the best parameters for the segments it has
decided. The unconstrained least squares (the paper's OLS per node) bounds that cost from below
(:eq:`unconstrained-bound`) and is nearly free, so a node whose bound already exceeds the w-th best cost is never solved
in the cone.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from bayesid.moments import Moments
from bayesid.motion import Array, Integers
from bayesid.search.result import SearchResult, UnconstrainedBound
from bayesid.solver import Solution


class NodeCost(Protocol):
    """What prices a node: `set_hessian` once per depth, `solve` per node."""

    def set_hessian(self, hessian: Array) -> None:
        """Prepares for H (r, r)."""

    def solve(self, gradient: Array) -> Solution:
        """The best parameters for g (r,)."""


@dataclass(frozen=True)
class _Level:
    """The surviving nodes at one depth.

    Attributes:
        signs: (w, d) the choices made, in search order: the path back to the root.
        gradient: (w, r) sum of s_k g_k over the decided segments.
        cost: (w,) node costs.
        theta: the best node's parameters.
    """

    signs: Integers
    gradient: Array
    cost: Array
    theta: Array


def beam(
    moments: Moments,
    node_cost: NodeCost,
    width: int | None = 5,
    initial: int = 5,
    progress: Callable[[int, int], None] | None = None,
) -> SearchResult:
    """Searches the signs of all unknown segments, those with the most energy first.

    Args:
        moments: scaled moments of S segments.
        node_cost: prices a node; `bayesid.solver.ConeLeastSquares` by default, PBPR as in the paper.
        width: w, nodes that survive each step; None for all (exhaustive).
        initial: s0, segments that are enumerated at the start.
        progress: called as progress(decided, total) after each step.

    Raises:
        SolverError: a node could not be priced.
    """
    began = time.perf_counter()
    known, order = np.flatnonzero(moments.known), _search_order(moments)
    pricing = _Pricing(node_cost)
    hessian = moments.hessian_of(known)
    energy = float(moments.energy[known].sum())
    level = _Level(
        signs=np.empty((1, 0), dtype=np.int64),
        gradient=(moments.known[known] @ moments.gradient[known])[None, :],
        cost=np.zeros(1),
        theta=np.empty(0),
    )
    depth = 0
    while True:
        group = order[depth : depth + (initial if depth == 0 else 1)]
        hessian = hessian + moments.hessian_of(group)
        energy += float(moments.energy[group].sum())
        candidates = _expand(level, moments.gradient[group])
        depth += len(group)
        level = pricing.select(candidates, hessian, energy, 1 if depth >= len(order) else width)
        if progress is not None:
            progress(depth, len(order))
        if depth >= len(order):
            break
    signs = moments.known.copy()
    signs[order] = level.signs[0]
    found = SearchResult(
        signs=signs, theta=level.theta, cost=float(level.cost[0]), method="beam", width=width,
        certified=False, lower_bound=None,
        nodes=pricing.nodes, solves=pricing.solves, tolerance=pricing.tolerance, seconds=time.perf_counter() - began,
    )  # fmt: skip
    if np.all(signs):
        return found
    unconstrained = np.linalg.lstsq(hessian, level.gradient[0], rcond=None)[0]
    return _with_weak_segments(moments, node_cost, found, unconstrained)


def _with_weak_segments(moments: Moments, node_cost: NodeCost, found: SearchResult, beta: Array) -> SearchResult:
    """Segments without a Hessian of their own take the signs that the other ones' coefficients (r,) predict."""
    predicted = np.where(moments.gradient @ beta >= 0.0, 1, -1)
    signs = np.where(found.signs != 0, found.signs, predicted)
    node_cost.set_hessian(moments.hessian.sum(axis=0))
    solution = node_cost.solve(signs @ moments.gradient)
    cost = float(moments.energy.sum()) + solution.cost
    return replace(found, signs=signs, theta=solution.theta, cost=cost, solves=found.solves + 1)


def _search_order(moments: Moments) -> Integers:
    """Unknown segments, those with the most energy first: they decide most and are mistaken least."""
    unknown = np.flatnonzero((moments.known == 0) & moments.alone)
    return unknown[np.argsort(-moments.energy[unknown], kind="stable")]


def _expand(level: _Level, gradients: Array) -> tuple[Integers, Array]:
    """Every node with every choice of signs for the next segments: (children, d') signs and (children, r) gradients."""
    d = len(gradients)
    choices = np.array(list(itertools.product((1, -1), repeat=d)), dtype=np.int64).reshape(2**d, d)
    repeated = np.repeat(level.signs, len(choices), axis=0)
    tiled = np.tile(choices, (len(level.signs), 1))
    gradient = np.repeat(level.gradient, len(choices), axis=0) + tiled @ gradients
    return np.hstack([repeated, tiled]), gradient


class _Pricing:
    """Selects the cheapest nodes of a depth, solving as few cone problems as it can; counts what it did."""

    def __init__(self, node_cost: NodeCost) -> None:
        self._node_cost = node_cost
        self.nodes = 0
        self.solves = 0
        self.tolerance = 0.0

    def select(self, candidates: tuple[Integers, Array], hessian: Array, energy: float, width: int | None) -> _Level:
        signs, gradient = candidates
        bound = energy + UnconstrainedBound(hessian)(gradient)
        self.nodes += len(signs)
        width = len(signs) if width is None else width
        self._node_cost.set_hessian(hessian)
        kept: list[tuple[float, int, Array]] = []
        for i in np.argsort(bound, kind="stable"):
            if len(kept) >= width and bound[i] >= kept[width - 1][0]:
                break
            solution = self._node_cost.solve(gradient[i])
            self.solves += 1
            self.tolerance = max(self.tolerance, solution.tolerance)
            kept.append((energy + solution.cost, int(i), solution.theta))
            kept.sort(key=lambda node: node[:2])
        kept = kept[:width]
        chosen = [i for _, i, _ in kept]
        return _Level(signs[chosen], gradient[chosen], np.array([cost for cost, _, _ in kept]), kept[0][2])


def keep_incumbent(moments: Moments, node_cost: NodeCost, found: SearchResult, beta: Array) -> SearchResult:
    """The result, or the signs that earlier coefficients beta (r,) predict where those cost less.

    A narrow beam on re-cut segments may lose what the search before it had found.
    """
    predicted = np.where(moments.gradient @ beta >= 0.0, 1, -1)
    signs = np.where(moments.known != 0, moments.known, predicted)
    node_cost.set_hessian(moments.hessian.sum(axis=0))
    solution = node_cost.solve(signs @ moments.gradient)
    cost = float(moments.energy.sum()) + solution.cost
    found = replace(found, solves=found.solves + 1, tolerance=max(found.tolerance, solution.tolerance))
    return replace(found, signs=signs, theta=solution.theta, cost=cost) if cost < found.cost else found


def turn_joints(moments: Moments, node_cost: NodeCost, found: SearchResult) -> SearchResult:
    """The result with all signs of a joint turned round wherever that lowers the cost.

    With friction in the model each joint is nearly symmetric by itself: a beam that loses the right half of that
    symmetry at its root cannot come back to it one segment at a time.
    """
    node_cost.set_hessian(moments.hessian.sum(axis=0))
    energy = float(moments.energy.sum())
    joints = np.unique(moments.joint[moments.known == 0])
    better = True
    while better:
        better = False
        for joint in joints:
            signs = np.where((moments.joint == joint) & (moments.known == 0), -found.signs, found.signs)
            solution = node_cost.solve(signs @ moments.gradient)
            better = energy + solution.cost < found.cost
            found = replace(found, solves=found.solves + 1, tolerance=max(found.tolerance, solution.tolerance))
            if better:
                found = replace(found, signs=signs, theta=solution.theta, cost=energy + solution.cost)
                break
    return found
