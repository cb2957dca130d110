import numpy as np
import pytest
from conftest import random_motion, small_robot
from scipy.optimize import minimize, nnls

from bayesid.coefficients import base_coefficients
from bayesid.errors import SolverError
from bayesid.inertia import from_pseudo_inertia
from bayesid.model import Model
from bayesid.simulation import random_parameters
from bayesid.solver import MARGIN, ConeLeastSquares, solve_precisely
from bayesid.terms import DEFAULT, RigidBody, make_terms


def problem(names, seed, n=2, noise=0.3):
    """Moments of random, infeasible data on a small arm: the cone binds."""
    robot, motion = small_robot(n), random_motion(n, 200, seed)
    model = Model(robot, make_terms(names, robot, motion))
    coefficients = base_coefficients(model)
    rng = np.random.default_rng(seed)
    columns = model.columns(motion)[:, :, coefficients.kept].reshape(-1, len(coefficients))
    efforts = columns @ rng.normal(size=len(coefficients)) + noise * rng.normal(size=len(columns))
    return model, coefficients, columns.T @ columns, columns.T @ efforts, float(efforts @ efforts)


def test_without_bodies_it_is_nonnegative_least_squares():
    model, coefficients, hessian, gradient, energy = problem(["viscous_friction", "coulomb_friction"], 3)
    solution = solve_precisely(model.cone, coefficients, hessian, gradient, energy)
    root = np.linalg.cholesky(hessian).T
    expected, distance = nnls(root, np.linalg.solve(root.T, gradient))
    assert (expected == 0).any(), "the cone should bind, or the test shows nothing"
    np.testing.assert_allclose(solution.theta, expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_optimum_in_the_cone_against_a_smooth_parametrisation(seed):
    """P = L L' has no constraint left: a local search from many starts must not get below the SDP, and must meet it."""
    model, coefficients, hessian, gradient, energy = problem(["rigid_body"], seed)
    solver = ConeLeastSquares(model.cone, coefficients, hessian, energy, tolerance=1e-9)
    solution = solver.solve(gradient)
    assert model.cone.smallest_eigenvalues(solution.theta).min() > -1e-7
    unconstrained = -gradient @ np.linalg.solve(hessian, gradient)
    assert solution.cost > unconstrained * (1 - 1e-3), "the cone should bind"

    def cost(x):
        factors = np.zeros((2, 4, 4))
        factors[:, *np.tril_indices(4)] = x.reshape(2, 10)
        theta = from_pseudo_inertia(factors @ factors.swapaxes(1, 2)).ravel()
        beta = coefficients.project(theta)
        return beta @ hessian @ beta - 2 * gradient @ beta + solver.regularisation(theta)

    rng = np.random.default_rng(seed)
    options = {"maxiter": 5000, "maxfun": 200000}
    best = min(minimize(cost, rng.normal(size=20), method="L-BFGS-B", options=options).fun for _ in range(3))
    assert solution.cost <= best + 1e-6 * energy
    assert solution.cost == pytest.approx(best, abs=2e-4 * energy)


def test_hessian_and_gradient_can_change():
    model, coefficients, hessian, gradient, energy = problem(DEFAULT, 5)
    solver = ConeLeastSquares(model.cone, coefficients, hessian, energy)
    first = solver.solve(gradient)
    solver.set_hessian(3.0 * hessian)
    tripled = solver.solve(3.0 * gradient)
    assert tripled.cost == pytest.approx(3.0 * first.cost, rel=1e-2), "but for the pull, which does not triple"
    flipped = solver.solve(-3.0 * gradient)
    other = ConeLeastSquares(model.cone, coefficients, hessian, energy)
    other.set_hessian(3.0 * hessian)
    fresh = other.solve(-3.0 * gradient)
    assert flipped.cost == pytest.approx(fresh.cost, rel=1e-4)
    assert flipped.cost != pytest.approx(tripled.cost, rel=1e-2)


def test_margin_keeps_parameters_strictly_inside():
    model, coefficients, hessian, gradient, energy = problem(["rigid_body"], 2)
    theta = solve_precisely(model.cone, coefficients, hessian, gradient, energy).theta
    assert model.cone.smallest_eigenvalues(theta).min() >= 0.9 * MARGIN


def test_what_leaves_no_trace_is_drawn_to_a_typical_link():
    robot, motion = small_robot(3), random_motion(3, 300, 4)
    model = Model(robot, make_terms(DEFAULT, robot, motion))
    coefficients = base_coefficients(model)
    truth = random_parameters(model, np.random.default_rng(4))
    beta = coefficients.project(truth)
    columns = model.columns(motion)[:, :, coefficients.kept].reshape(-1, len(coefficients))
    hessian, energy = columns.T @ columns, float(np.sum((columns @ beta) ** 2))
    theta = solve_precisely(model.cone, coefficients, hessian, hessian @ beta, energy).theta
    allowed = 1e-3 * np.sqrt(energy / len(columns))
    np.testing.assert_allclose(columns @ coefficients.project(theta), columns @ beta, atol=allowed)
    first_mass = [p.name for p in model.parameters].index("m1")
    assert theta[first_mass] == pytest.approx(3.0, abs=0.3), "m1 leaves no trace"


def test_a_status_other_than_solved_is_an_error():
    model, coefficients, hessian, gradient, energy = problem(["rigid_body"], 2)
    solver = ConeLeastSquares(model.cone, coefficients, hessian, energy, tolerance=1e-30)
    with pytest.raises(SolverError, match="cone least squares"):
        solver.solve(gradient)


def test_rigid_body_alone_reaches_known_parameters():
    """Efforts of a physical robot without noise: the optimum is the truth, cost zero."""
    robot, motion = small_robot(3, seed=4), random_motion(3, 300, 9)
    model = Model(robot, (RigidBody(),))
    coefficients = base_coefficients(model)
    spread = [[0.05, 0.02, 0.08, 4.0], [0.01, 0.03, 0.02, 2.5], [0.004, 0.01, 0.006, 1.2]]
    bodies = np.array([np.diag(values) for values in spread])
    bodies[:, :3, 3] = bodies[:, 3, :3] = [[0.1, -0.05, 0.2], [0.05, 0.1, -0.03], [-0.02, 0.01, 0.04]]
    theta = from_pseudo_inertia(bodies).ravel()
    columns = model.columns(motion)[:, :, coefficients.kept].reshape(-1, len(coefficients))
    efforts = columns @ coefficients.project(theta)
    moments = columns.T @ columns, columns.T @ efforts, float(efforts @ efforts)
    solution = solve_precisely(model.cone, coefficients, *moments)
    found = coefficients.project(solution.theta)
    np.testing.assert_allclose(columns @ found, efforts, atol=1e-4 * np.abs(efforts).max())
