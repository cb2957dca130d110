"""Algorithm 1 of Gaz and De Luca, as published: every node of T-PBPR is solved, checked and recorded.

The first s0 segments are enumerated, the w cheapest nodes are kept, and each step gives every kept node two children:
2^s0 + 2 w (S - s0) nodes for S segments, where 2^s0 >= w. A node has two costs over the decided segments: that of
ordinary least squares (OLS), and PBPR's, the least cost of a feasible robot, which is convex
(:eq:`cone-least-squares`). A linear matrix inequality tests whether the OLS estimate is feasible; if so, both costs are
equal. Nodes are ranked by PBPR's cost. Infeasibility thus raises the cost but does not exclude a node, as noise makes
estimates of right signs infeasible too. `refuse` excludes such nodes for comparison.

`bayesid.signs.search.beam` keeps the same nodes, solves fewer of them, and searches further for the best signs.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from bayesid.arrays import Array, Integers, Mask
from bayesid.progress import Steps, no_steps
from bayesid.regression.feasibility import FeasibilityCheck
from bayesid.signs.search.bounds import UnconstrainedBound
from bayesid.signs.search.protocol import Assignment, Pruning, SearchResult, SignProblem, listed_without_proof

Fate = Literal["kept", "pruned by width", "pruned as infeasible", "leaf"]
"""A node is pruned as infeasible if its OLS cost is below the PBPR cost of a kept node: with its OLS cost it might have
been kept. Nodes of `refuse` count as infeasible too."""
Refusal = Callable[["Candidates"], Mask]
"""Selects nodes of one depth (m,) to prune whatever their cost."""


@dataclass(frozen=True)
class Candidates:
    """The m nodes of one depth, before pruning."""

    decided: Integers  #: segments
    hessian: Array  #: (r, r) of these segments
    ols_costs: Array  #: (m,)
    cone_costs: Array  #: (m,)
    margins: Array  #: (m,)

    def fates(self, refused: Mask, width: int, last: bool) -> tuple[Integers, list[Fate]]:
        """Kept nodes, cheapest first, and the fate of each node; if all are refused, the cheapest is kept."""
        ranked = np.argsort(self.cone_costs, kind="stable")
        kept = ranked[~refused[ranked]][:width] if not refused.all() else ranked[:1]
        priced_out = (self.margins < 0.0) & (self.ols_costs < self.cone_costs[kept].max())
        fates: list[Fate] = [
            "pruned as infeasible" if infeasible else "pruned by width" for infeasible in refused | priced_out
        ]
        for k in kept:
            fates[k] = "leaf" if last else "kept"
        return kept, fates


@dataclass(frozen=True)
class Node:
    """A node of the tree."""

    number: int  #: from 1, in the order of creation
    parent: int  #: number of the parent; 0 for the root
    depth: int  #: number of decided segments
    segments: tuple[int, ...]  #: 0-based, segments that this node decides
    signs: tuple[int, ...]  #: +1 or -1 for each of them
    ols_cost: float  #: of ordinary least squares over the decided segments, in units of the noise
    cone_cost: float  #: PBPR's: that of the best feasible robot, with the Tikhonov term
    min_eigenvalue: float  #: largest smallest eigenvalue of the OLS estimate's pseudo-inertias, at most 1
    fate: Fate

    @property
    def feasible(self) -> bool:
        """Whether the OLS estimate is feasible."""
        return self.min_eigenvalue >= 0.0


def algorithm1(
    problem: SignProblem, width: int = 5, initial: int = 5, *, refuse: Refusal | None = None, steps: Steps = no_steps
) -> tuple[SearchResult, tuple[Node, ...]]:
    """The cheapest leaf, and all nodes.

    Args:
        problem: with at least one segment of unknown sign; segments are decided in the order of their energy.
        width: w, kept nodes.
        initial: s0, segments enumerated at the start.
        refuse: nodes to prune whatever their cost; None: none.
        steps: called as steps(decided, total).

    Raises:
        SolverError: a node could not be solved.
    """
    began, normal_equations = time.perf_counter(), problem.normal_equations
    known, unknown = np.flatnonzero(normal_equations.known), np.flatnonzero(normal_equations.known == 0)
    order = unknown[np.argsort(-normal_equations.energy[unknown], kind="stable")]
    pricing, check = problem.solver(), FeasibilityCheck(problem.cone, problem.coefficients.projection)
    hessian, energy = normal_equations.hessian_of(known), float(normal_equations.energy[known].sum())
    root = (normal_equations.known[known] @ normal_equations.gradient[known])[None]
    level = _Level(np.empty((1, 0), dtype=np.int64), root, np.zeros(1, dtype=np.int64))
    nodes, leaves = list[Node](), list[Assignment]()
    while (depth := level.paths.shape[1]) < len(order):
        group = order[depth : depth + (1 if depth else initial)]
        hessian, energy = (
            hessian + normal_equations.hessian_of(group),
            energy + float(normal_equations.energy[group].sum()),
        )
        children, depth = _children(level, normal_equations.gradient[group]), depth + len(group)
        prepared = pricing.prepared(hessian)
        solved = [prepared.solve(gradient) for gradient in children.gradients]
        costs = energy + np.array([solution.cost for solution in solved])
        ols = energy + UnconstrainedBound(hessian)(children.gradients)
        margins = check.margins(hessian, children.gradients)
        candidates = Candidates(order[:depth], hessian, ols, costs, margins)
        refused = np.zeros(len(costs), dtype=bool) if refuse is None else refuse(candidates)
        kept, fates = candidates.fates(refused, width, depth == len(order))
        first = len(nodes) + 1
        for k, fate in enumerate(fates):
            decides = tuple(group.tolist()), tuple(children.paths[k, -len(group) :].tolist())
            numbers = float(ols[k]), float(costs[k]), float(margins[k])
            nodes.append(Node(first + k, int(children.parents[k]), depth, *decides, *numbers, fate))
        level = _Level(children.paths[kept], children.gradients[kept], first + kept)
        leaves = [
            Assignment(
                _whole(normal_equations.known, order[:depth], children.paths[k]),
                solved[k].theta,
                float(costs[k]),
                -np.inf,
            )
            for k in kept
        ]
        steps(depth, len(order))
    best = min(leaves, key=lambda leaf: leaf.cost)
    branches, decided = listed_without_proof(normal_equations, best, leaves)
    pruned = sum(node.fate.startswith("pruned") for node in nodes)
    result = SearchResult(
        signs=best.signs,
        theta=best.theta,
        cost=best.cost,
        method="Algorithm 1",
        width=width,
        nodes=len(nodes),
        solves=len(nodes),
        tolerance=pricing.tolerance,
        seconds=time.perf_counter() - began,
        branches=branches,
        decided=decided,
        tikhonov=pricing.regularisation(best.theta),
        pruning=Pruning(len(nodes), 0, pruned, len(nodes) - pruned, len(leaves)),
    )
    return result, tuple(nodes)


class _Level(NamedTuple):
    paths: Integers  # (m, depth) signs of the decided segments, in search order
    gradients: Array  # (m, r) sums of s_k g_k over the decided segments
    parents: Integers  # (m,) in a kept level their own numbers, in a level of children their parents'


def _children(level: _Level, gradients: Array) -> _Level:
    choices = np.array(list(itertools.product((1, -1), repeat=len(gradients))), dtype=np.int64)
    added = np.tile(choices, (len(level.paths), 1))
    paths = np.hstack([np.repeat(level.paths, len(choices), axis=0), added])
    grown = np.repeat(level.gradients, len(choices), axis=0) + added @ gradients
    return _Level(paths, grown, np.repeat(level.parents, len(choices)))


def _whole(known: Integers, decided: Integers, path: Integers) -> Integers:
    signs = known.copy()
    signs[decided] = path
    return signs
