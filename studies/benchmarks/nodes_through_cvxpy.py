"""T-PBPR with every node solved through cvxpy: time of a plain implementation of the paper."""

from __future__ import annotations

import itertools
import warnings
from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.effects.parameters import Cone
from bayesid.errors import SolverError
from bayesid.regression.solver import tikhonov_weight
from bayesid.robot.inertia import PSEUDO_INERTIA_BASIS
from bayesid.studies.benchmarks.problems import LogProblem

try:
    import cvxpy as cp
except ImportError:
    raise SystemExit("cvxpy is not installed: pip install 'bayesid[bench]'") from None


@dataclass(frozen=True)
class PlainNode:
    """A node's problem in cvxpy, stated anew for every node.

    Attributes:
        cone: the cone of the P parameters.
        projection: (r, P) B.
        size: (P,) scales of the parameters.
        typical: (P,) centre of the Tikhonov term rho(theta) = w sum of ((theta - typical) / size)^2.
        energy: c of all data.
    """

    cone: Cone
    projection: Array
    size: Array
    typical: Array
    energy: float

    def cost(self, hessian: Array, gradient: Array, energy: float) -> float:
        """The least cost of a feasible robot for the H (r, r), g (r,) and energy of some data.

        Raises:
            SolverError: Clarabel failed.
        """
        scaled = cp.Variable(self.cone.size)
        theta = cp.multiply(self.size, scaled)
        columns = self.projection * self.size
        data = cp.quad_form(scaled, cp.psd_wrap(columns.T @ hessian @ columns / self.energy))
        tikhonov = tikhonov_weight(self.energy) / self.energy * cp.sum_squares(scaled - self.typical / self.size)
        constraints = [theta[self.cone.nonnegative] >= 0.0] if len(self.cone.nonnegative) else []
        for body in self.cone.bodies:
            constraints.append(sum(theta[int(i)] * PSEUDO_INERTIA_BASIS[k] for k, i in enumerate(body)) >> 0)
        linear = 2.0 * (gradient @ columns / self.energy) @ scaled
        problem = cp.Problem(cp.Minimize(data - linear + tikhonov), constraints)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of inaccurate solutions: some nodes reach only 1e-5
            problem.solve(solver=cp.CLARABEL)
        if problem.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
            raise SolverError("a node through cvxpy", problem.status)
        return energy + self.energy * float(problem.value)


def plain_node(problem: LogProblem) -> PlainNode:
    """A node with the Tikhonov term of the fast solver, recovered from its values."""
    solver, cone = problem.solver(), problem.model.cone
    steps = np.eye(cone.size)
    up, down = (np.array([solver.regularisation(sign * step) for step in steps]) for sign in (1.0, -1.0))
    weight = 0.5 * (up + down) - solver.regularisation(np.zeros(cone.size))
    size = np.sqrt(tikhonov_weight(problem.energy) / weight)
    return PlainNode(cone, problem.coefficients.projection, size, 0.25 * (down - up) / weight, problem.energy)


def tree_through_cvxpy(problem: LogProblem, width: int = 5, initial: int = 5) -> tuple[Integers, float, int]:
    """T-PBPR (Gaz and De Luca, Algorithm 1), every node solved: signs (S,), cost, and the number of nodes.

    Unlike `bayesid.signs.search.beam`, it skips no node by a bound and prepares no node's problem.
    """
    normal_equations, node = problem.normal_equations, plain_node(problem)
    order = np.argsort(-normal_equations.energy)
    survivors: list[tuple[float, tuple[int, ...]]] = [(0.0, ())]
    nodes, depth = 0, 0
    while depth < len(order):
        step = initial if depth == 0 else 1
        depth = min(depth + step, len(order))
        decided = order[:depth]
        hessian, energy = normal_equations.hessian_of(decided), float(normal_equations.energy[decided].sum())
        children = []
        for _, path in survivors:
            for choice in itertools.product((1, -1), repeat=depth - len(path)):
                child = (*path, *choice)
                children.append(
                    (node.cost(hessian, np.array(child) @ normal_equations.gradient[decided], energy), child)
                )
        nodes += len(children)
        survivors = sorted(children)[:width]
    cost, best = survivors[0]
    signs = np.zeros(len(order), dtype=np.int64)
    signs[order] = best
    return signs, cost, nodes
