"""The certified search with constraints that are no cone, against brute force through cvxpy."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from sign_problems import arm, synthetic

from bayesid.effects.constraints import Constraints
from bayesid.robot.inertia import PSEUDO_INERTIA_BASIS
from bayesid.signs.search.certified import certified


def stated_for(cone, seed, matrices):
    """Random half spaces, matrices and equalities, no cones, that leave some room about a random feasible point."""
    rng = np.random.default_rng([seed, 7])
    point = np.abs(rng.normal(size=cone.size)) * 0.4
    for body in cone.bodies:
        point[body] = np.array([0.3, 0.02, 0.01, 0.28, -0.03, 0.25, 0.1, -0.05, 0.08, 1.3])
    rows = rng.normal(size=(4, cone.size)) * (rng.random((4, cone.size)) < 0.6)
    rows[:, 0] = rng.normal(size=4)
    offset = -rows @ point + 0.1 * np.linalg.norm(rows, axis=1) + 0.05
    basis = rng.normal(size=(matrices, cone.size, 4, 4)) * (rng.random((matrices, cone.size, 1, 1)) < 0.4)
    basis[:, 0] = rng.normal(size=(matrices, 4, 4))
    basis = basis + basis.swapaxes(2, 3)
    constant = 0.8 * np.eye(4) - np.einsum("bqij,q->bij", basis, point)
    equal = rng.normal(size=(seed % 3, cone.size)) * (rng.random((seed % 3, cone.size)) < 0.6)
    kinds = ("half space", 4), ("matrix", matrices), ("equality", len(equal))
    labels = tuple(f"{kind} {k}" for kind, count in kinds for k in range(count))
    names, of_equal = tuple(f"p{k}" for k in range(cone.size)), 4 + matrices + np.arange(len(equal))
    inequalities = rows, offset, np.arange(4), basis, constant, 4 + np.arange(matrices)
    return Constraints(names, labels, *inequalities, equal, equal @ point, of_equal)


def brute_force(problem):
    """Costs of all assignments, the Tikhonov term included, each by a program of cvxpy."""
    cone, solver, normal_equations = problem.cone, problem.solver(), problem.normal_equations
    z = cp.Variable(cone.size)  # in sizes
    theta = cp.multiply(solver.scale, z)
    root = np.linalg.cholesky(
        normal_equations.hessian.total() + 1e-13 * problem.energy * np.eye(len(normal_equations.gradient[0]))
    ).T
    target = cp.Parameter(len(root))
    feasible = [cone.stated.rows @ theta + cone.stated.offset >= 0]
    if len(cone.stated.equal):
        feasible.append(cone.stated.equal @ theta == cone.stated.value)
    if len(cone.nonnegative):
        feasible.append(z[cone.nonnegative] >= 0)
    for basis, constant in [
        *((PSEUDO_INERTIA_BASIS @ np.eye(4), body) for body in cone.bodies),
        *zip(cone.stated.basis, cone.stated.constant, strict=True),
    ]:
        of_body = constant.dtype.kind == "i"
        part, more = (theta[constant], np.zeros((4, 4))) if of_body else (theta, constant)
        feasible.append(cp.reshape(basis.reshape(-1, 16).T @ part, (4, 4), order="C") + more >> 0)
    misfit = cp.sum_squares(root @ (problem.coefficients.projection @ theta) - target)
    pull = solver.tikhonov_weight * cp.sum_squares(z - solver.typical)
    program = cp.Problem(cp.Minimize(misfit + pull), feasible)
    costs = []
    for signs in problem.assignments:
        target.value = np.linalg.solve(root.T, signs @ normal_equations.gradient)
        costs.append(program.solve(solver=cp.CLARABEL) - float(target.value @ target.value) + problem.energy)
    return np.array(costs)


def problems(count):
    for seed in range(count):
        if seed % 4 == 3:
            made = arm(seed, 4 + seed % 3, 1 + seed % 2, ("rigid_body", "viscous_friction"), (0.1, 0.5)[seed % 2])
        else:
            cone = ("free", "orthant", "body")[seed % 4]
            made = synthetic(seed, 4 + seed % 3, 1 + seed % 3, cone, 3 + seed % 4, (0.1, 0.4, 1.0)[seed % 3], 2.0)
        yield replace(made, cone=replace(made.cone, stated=stated_for(made.cone, seed, seed % 3)))


def agree(count):
    binding = 0
    for seed, problem in enumerate(problems(count)):
        costs = brute_force(problem)
        found = certified(problem.normal_equations, problem.solver(), 10.0)
        close = 2e-6 * problem.energy
        row = np.flatnonzero(np.all(problem.assignments == found.signs, axis=1))
        assert found.cost == pytest.approx(costs[row[0]], abs=close), seed
        assert found.lower_bound <= costs.min() + close, seed
        if found.certified:
            assert found.cost <= costs.min() + close, seed
        if found.persistent is not None:
            near = problem.assignments[costs <= found.cost + found.optimality_gap - close]
            assert np.all(near[:, found.persistent] == found.signs[found.persistent]), seed
        assert found.certified or found.uncertified_because == "tikhonov", seed
        free = replace(problem, cone=replace(problem.cone, stated=None))
        other = certified(free.normal_equations, free.solver(), 10.0)
        binding += found.cost > other.cost + 1e-3 * problem.energy
        assert not np.array_equal(found.signs, -found.signs)
    assert binding >= 0.5 * count, "constraints bind"


def test_the_proof_with_constraints_agrees_with_brute_force():
    agree(12)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:Solution may be inaccurate")
def test_sixty_proofs_with_constraints_agree_with_brute_force():
    agree(60)
