from pathlib import Path
from types import SimpleNamespace

import clarabel
import cvxpy as cp
import numpy as np
import pytest
from conftest import random_motion, small_robot
from scipy.optimize import minimize, nnls
from sign_problems import synthetic

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.friction import LoadDependentFriction
from bayesid.effects.model import Model
from bayesid.errors import SolverError
from bayesid.regression.interior import interior_point
from bayesid.regression.solver import MARGIN, ConeLeastSquares, solve_precisely
from bayesid.regression.tuning import TUNING
from bayesid.robot import load_robot
from bayesid.robot.inertia import PSEUDO_INERTIA_BASIS, from_pseudo_inertia, pseudo_inertia
from bayesid.simulation.parameters import random_parameters


def problem(names, seed, n=2, noise=0.3):
    """Moments of random, infeasible data on a small arm: the cone binds."""
    robot, motion = small_robot(n), random_motion(n, 200, seed)
    model = Model(robot, make_terms(names, robot, motion))
    coefficients = base_coefficients(model)
    rng = np.random.default_rng(seed)
    columns = model.columns(motion)[:, :, coefficients.selected].reshape(-1, len(coefficients))
    efforts = columns @ rng.normal(size=len(coefficients)) + noise * rng.normal(size=len(columns))
    return model, coefficients, columns.T @ columns, columns.T @ efforts, float(efforts @ efforts)


def test_bodies_are_moved_as_far_inside_as_cvxpy_finds():
    model, coefficients, *_ = problem(STANDARD, 4, n=3)
    cone, theta = model.cone, random_parameters(model, rng=np.random.default_rng(3))
    typical = np.diag([0.03, 0.03, 0.03, 3.0])
    moved, t = cp.Variable(cone.size), cp.Variable()
    constraints = [coefficients.projection @ moved == coefficients.project(theta), moved[cone.nonnegative] >= 0]
    for body in cone.bodies:
        flat = PSEUDO_INERTIA_BASIS.reshape(10, 16).T @ moved[body]
        constraints.append(cp.reshape(flat, (4, 4), order="C") - t * typical >> 0)
    farthest = cp.Problem(cp.Maximize(t), constraints).solve(solver=cp.CLARABEL)
    inside = interior_point(cone, coefficients, theta)
    np.testing.assert_allclose(coefficients.project(inside), coefficients.project(theta), atol=1e-9)
    root = np.sqrt(np.outer(np.diag(typical), np.diag(typical)))

    def distance(point):
        """The largest t with P >= t Q for every body, Q diagonal."""
        return min(np.linalg.eigvalsh(pseudo_inertia(point[body]) / root).min() for body in cone.bodies)

    assert distance(inside) == pytest.approx(farthest, rel=0.02), "a little is left for what has no trace at all"
    assert distance(inside) > 1.05 * distance(theta)


def test_optimum_in_the_cone_against_a_smooth_parametrisation():
    """P = L L' has no constraint left: a local search from many starts must not get below the SDP, and must meet it."""
    model, coefficients, hessian, gradient, energy = problem(["rigid_body"], 1)
    solver = ConeLeastSquares(model.cone, coefficients, hessian, energy, tolerance=1e-9)
    solution = solver.prepared().solve(gradient)
    assert model.cone.smallest_eigenvalues(solution.theta).min() > -1e-7
    unconstrained = -gradient @ np.linalg.solve(hessian, gradient)
    assert solution.cost > unconstrained * (1 - 1e-3), "the cone should bind"

    def cost(x):
        factors = np.zeros((2, 4, 4))
        factors[:, *np.tril_indices(4)] = x.reshape(2, 10)
        theta = from_pseudo_inertia(factors @ factors.swapaxes(1, 2)).ravel()
        beta = coefficients.project(theta)
        return beta @ hessian @ beta - 2 * gradient @ beta + solver.regularisation(theta)

    rng = np.random.default_rng(1)
    options = {"maxiter": 5000, "maxfun": 200000}
    best = min(minimize(cost, rng.normal(size=20), method="L-BFGS-B", options=options).fun for _ in range(2))
    assert solution.cost <= best + 1e-6 * energy
    assert solution.cost == pytest.approx(best, abs=2e-4 * energy)


def test_margin_keeps_parameters_strictly_inside():
    model, coefficients, hessian, gradient, energy = problem(["rigid_body"], 2)
    theta = solve_precisely(model.cone, coefficients, hessian, gradient, energy).theta
    assert model.cone.smallest_eigenvalues(theta).min() >= 0.9 * MARGIN


def test_parameters_without_effect_are_near_a_typical_link():
    robot, motion = small_robot(3), random_motion(3, 300, 4)
    model = Model(robot, make_terms(STANDARD, robot, motion))
    coefficients = base_coefficients(model)
    truth = random_parameters(model, rng=np.random.default_rng(4))
    beta = coefficients.project(truth)
    columns = model.columns(motion)[:, :, coefficients.selected].reshape(-1, len(coefficients))
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
        solver.prepared().solve(gradient)


def feasible(cone, rng):
    """A random point of the cone, of any size."""
    theta = rng.normal(size=cone.size) * 10.0 ** rng.uniform(-3, 1)
    theta[cone.nonnegative] = np.abs(theta[cone.nonnegative])
    for body in cone.bodies:
        root = rng.normal(size=(4, rng.integers(1, 5))) * 10.0 ** rng.uniform(-2, 0)
        theta[body] = from_pseudo_inertia(root @ root.T)
    return theta


def objective(solver, hessian, gradient, theta):
    beta = solver.project(theta)
    return beta @ hessian @ beta - 2 * gradient @ beta + solver.regularisation(theta)


@pytest.mark.parametrize(("names", "tolerance"), [(STANDARD, 1e-6), (["rigid_body"], 1e-2)])
def test_no_feasible_point_costs_less_than_the_lower_bound(names, tolerance):
    """However coarse the solver: the random points, those near the best one, and the best one."""
    for seed in range(2):
        model, coefficients, hessian, gradient, energy = problem(names, seed)
        solver = ConeLeastSquares(model.cone, coefficients, hessian, energy, tolerance=tolerance)
        bound = solver.prepared().solve(gradient).lower_bound
        best = solver.prepared().solve_precisely(gradient).theta
        rng = np.random.default_rng(seed)
        points = [feasible(model.cone, rng) for _ in range(200)]
        points += [(1 - t) * best + t * point for t in (1e-4, 1e-2, 0.3) for point in points[:50]]
        costs = [objective(solver, hessian, gradient, point) for point in points]
        assert bound <= min(costs)
        cost = objective(solver, hessian, gradient, best)
        assert bound <= cost + 1e-9 * energy, "best may be off the cone by 1e-9"
        assert solver.prepared().solve_precisely(gradient).cost == pytest.approx(cost, rel=1e-12)


def test_the_lower_bound_meets_what_active_sets_find():
    model, coefficients, hessian, gradient, energy = problem(["viscous_friction", "coulomb_friction"], 3)
    solver = ConeLeastSquares(model.cone, coefficients, hessian, energy)
    ridge = [solver.regularisation(step) for step in np.eye(model.cone.size)]  # the Tikhonov term is to zero
    root = np.linalg.cholesky(coefficients.projection.T @ hessian @ coefficients.projection + np.diag(ridge)).T
    target = np.linalg.solve(root.T, gradient @ coefficients.projection)
    least = nnls(root, target)[1] ** 2 - target @ target
    solution = solver.prepared().solve_precisely(gradient)
    assert solution.lower_bound <= least + 1e-12 * energy
    assert solution.lower_bound == pytest.approx(least, abs=1e-8 * energy)


@pytest.mark.parametrize("margin", [0.0, 1e-3])
def test_the_lower_bound_knows_the_margin(margin):
    """Points inside by the margin are bounded; the bound rises with the margin, as there are fewer of them."""
    model, coefficients, hessian, gradient, energy = problem(["rigid_body"], 1)
    solver = ConeLeastSquares(model.cone, coefficients, hessian, energy, margin)
    solution = solver.prepared().solve_precisely(gradient)
    assert solution.lower_bound == pytest.approx(solution.cost, abs=1e-8 * energy)
    rng, inside = np.random.default_rng(0), from_pseudo_inertia(margin * np.eye(4))
    for _ in range(200):
        theta = feasible(model.cone, rng) + np.tile(inside, len(model.cone.bodies))
        assert solution.lower_bound <= objective(solver, hessian, gradient, theta)
    closest = ConeLeastSquares(model.cone, coefficients, hessian, energy).prepared().solve_precisely(gradient)
    assert (solution.cost > closest.cost + 1e-6 * energy) == (margin > 0.0)


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_the_lower_bound_follows_a_change_of_the_hessian(factor):
    """More curvature or less than that of all data; a coarse solver, whose own cost would be too high a bound."""
    model, coefficients, hessian, gradient, energy = problem(STANDARD, 5)
    solver = ConeLeastSquares(model.cone, coefficients, hessian, energy, tolerance=1e-2)
    other = factor * np.diag(np.linspace(0.1, 1.0, len(hessian))) * np.trace(hessian) / len(hessian)
    prepared = solver.prepared(other)
    coarse, precise = prepared.solve(gradient), prepared.solve_precisely(gradient)
    assert coarse.cost > precise.cost + 1e-6 * energy, "or a bound that is too high would not show"
    assert coarse.lower_bound <= precise.cost + 1e-9 * energy
    assert precise.lower_bound == pytest.approx(precise.cost, rel=1e-7)  # the cost is 24 times the energy: 1e-8 of it


@pytest.fixture
def answering(monkeypatch):
    """Has clarabel's answers changed: `change(answer, k)` of the k-th solver that is made, as (status, x, z)."""
    make = clarabel.DefaultSolver

    def use(change):
        made = []

        class Changed:
            def __init__(self, *arguments):
                self.inner, self.place = make(*arguments), len(made)
                made.append(self)

            def solve(self):
                status, x, z = change(self.inner.solve(), self.place)
                return SimpleNamespace(status=status, x=x, z=z)

        monkeypatch.setattr("bayesid.regression.solver.clarabel.DefaultSolver", Changed)
        return made

    return use


@pytest.mark.parametrize(("names", "size"), [(STANDARD, 0.1), (["rigid_body"], 3.0)])
def test_multipliers_need_not_be_right_for_the_bound_to_hold(names, size, answering):
    """For any multipliers, far from optimal or outside the cone."""
    model, coefficients, hessian, gradient, energy = problem(names, 3)
    best = ConeLeastSquares(model.cone, coefficients, hessian, energy).prepared().solve_precisely(gradient)
    rng = np.random.default_rng(3)
    answering(lambda right, _: (right.status, 1.1 * np.array(right.x), right.z + size * rng.normal(size=len(right.z))))
    for _ in range(20):
        solution = ConeLeastSquares(model.cone, coefficients, hessian, energy).prepared().solve(gradient)
        assert solution.cost > best.cost + 1e-4 * energy, "or a bound that is too high would not show"
        assert solution.lower_bound <= best.cost + 1e-9 * energy


def test_the_tikhonov_term_does_not_grow_with_the_data():
    """The same log ten times: the Tikhonov cost of a parameter at equal distance stays the same."""
    model, coefficients, hessian, _, energy = problem(STANDARD, 8)
    theta = feasible(model.cone, np.random.default_rng(8))
    factor = 1e5 / energy  # of efforts in units of their noise
    once, often = (ConeLeastSquares(model.cone, coefficients, k * hessian, k * energy) for k in (factor, 10.0 * factor))
    assert often.regularisation(theta) == pytest.approx(once.regularisation(theta), rel=1e-9)
    assert once.regularisation(
        once.scale * (once.typical + np.eye(len(theta))[0] * TUNING.pull_reach)
    ) == pytest.approx(1.0)
    lighter = once.lighter(0.01)
    assert lighter.regularisation(theta) == pytest.approx(0.01 * once.regularisation(theta))
    assert once.tikhonov_weight == pytest.approx(1.0 / TUNING.pull_reach**2), "the first is as it was"


def test_a_cone_without_constraints_is_plain_least_squares():
    """The solver is given no cone at all: the optimum is that of the normal equations."""
    names = ["torque_offset"]
    model, coefficients, hessian, gradient, energy = problem(names, 10)
    solver = ConeLeastSquares(model.cone, coefficients, hessian, energy)
    solution = solver.prepared().solve_precisely(gradient)
    best = np.linalg.solve(hessian, gradient)
    np.testing.assert_allclose(coefficients.project(solution.theta), best, rtol=1e-5)
    assert solution.lower_bound == pytest.approx(solution.cost, abs=1e-9 * energy)


STALLED = (
    (1645, {"segments": 8, "size": 5, "noise": 0.5, "spread": 3.0, "longest": 4, "scale": 100.0}),
    (14496, {"segments": 8, "size": 7, "noise": 0.5, "longest": 3, "scale": 10.0}),
)


@pytest.mark.parametrize(("seed", "options"), STALLED)
def test_well_conditioned_nonnegative_least_squares_are_solved(seed, options):
    """Condition numbers of 3 to 5, and full steps of the solver go back and forth without end."""
    small = synthetic(seed, **options)
    solver = small.solver().prepared()
    for signs, cost in zip(small.assignments, small.costs, strict=True):
        solution = solver.solve(signs @ small.normal_equations.gradient)
        assert solution.cost + small.energy == pytest.approx(cost, abs=1e-5 * small.energy)


def test_a_problem_of_curvatures_that_differ_by_twelve_orders_is_solved_to_the_tolerance():
    """From the identification of a simulated UR10e one of whose joints hardly moves, with friction by the load.

    In the parameters' own units Clarabel ended with a numerical error, or a gap of a thousandth of the cost.
    """
    stalled = np.load(Path(__file__).with_name("stalled_cone.npz"))
    robot = load_robot("ur10e")
    by_load = LoadDependentFriction(joints=(3,), smoothing=(0.02,), links=(1.0,) * 60)
    model = Model(robot, (*make_terms(STANDARD, robot, random_motion(6, 200)), by_load))
    coefficients = base_coefficients(model)
    hessian = np.zeros((len(coefficients), len(coefficients)))
    hessian[np.triu_indices(len(coefficients))] = stalled["hessian"]
    hessian += np.triu(hessian, 1).T
    gradient = stalled["gradient"].astype(float)
    for energy in (1e6, 1e7):
        solution = ConeLeastSquares(model.cone, coefficients, hessian, energy).prepared().solve(gradient)
        assert solution.tolerance == 1e-6
        assert 0.0 <= solution.cost - solution.lower_bound < 1e-6 * abs(solution.cost)


class PanicException(BaseException):
    """As pyo3 raises it where Rust code panics; it is no Exception, and cannot be imported."""


def test_a_solver_that_panics_is_an_error(answering):
    """Clarabel does where the eigenvalues of a nearly optimal block fail: about one cone problem in 100 000."""

    def panic(*_):
        raise PanicException("Eigval error: Eigen(1)")

    model, coefficients, hessian, gradient, energy = problem(["rigid_body"], 2)
    solver = ConeLeastSquares(model.cone, coefficients, hessian, energy)
    answering(panic)
    for solve in (solver.prepared().solve, solver.prepared().solve_precisely):
        with pytest.raises(SolverError, match="cone least squares"):
            solve(gradient)


def test_an_attempt_that_fails_counts_for_the_bound(answering):
    """A coarser attempt is the solution, but its multipliers prove less than those of the one that failed before."""
    model, coefficients, hessian, gradient, energy = problem(["rigid_body"], 2)
    stated = ConeLeastSquares(model.cone, coefficients, hessian, energy)
    best, wrong = stated.prepared().solve_precisely(gradient), np.random.default_rng(0)

    def first_fails(right, k):
        return (
            ("NumericalError", right.x, right.z) if k == 0 else (right.status, right.x, wrong.normal(size=len(right.z)))
        )

    made = answering(first_fails)
    solution = stated.prepared().solve(gradient)
    assert len(made) == 2
    assert solution.lower_bound == pytest.approx(best.cost, abs=1e-5 * energy)


def test_useless_multipliers_leave_the_bound_without_a_cone(answering):
    """None of them is the least that is proven, and their size does not matter."""
    model, coefficients, hessian, gradient, energy = problem(["rigid_body", "viscous_friction"], 4)
    stated = ConeLeastSquares(model.cone, coefficients, hessian, energy)
    tikhonov, centre = stated.tikhonov()
    curvature, slope = hessian + tikhonov, gradient + tikhonov @ centre
    plain = float(centre @ tikhonov @ centre - slope @ np.linalg.solve(curvature, slope))
    right = stated.prepared().solve_precisely(gradient).lower_bound
    assert right > plain + 1e-3 * energy, "the cone binds"
    bounds = []
    for size in (0.0, 1.0, 7.0, -1.0):
        answering(lambda solved, _, size=size: (solved.status, solved.x, size * np.array(solved.z)))
        bounds.append(stated.prepared().solve(gradient).lower_bound)
    assert bounds[0] == pytest.approx(plain, abs=1e-8 * energy)
    assert bounds[1] == pytest.approx(right, abs=1e-5 * energy)
    assert bounds[2] == pytest.approx(bounds[1], abs=1e-9 * energy)
    assert bounds[0] - 1e-9 * energy <= bounds[3] <= right + 1e-9 * energy


def test_the_tikhonov_term_of_coefficients_is_the_least_of_parameters():
    """(beta - b)' Q (beta - b) = min of rho(theta) over B theta = beta: the optimality conditions, solved as such."""
    model, coefficients, hessian, gradient, energy = problem(STANDARD, 7)
    solver, size = ConeLeastSquares(model.cone, coefficients, hessian, energy), model.cone.size
    rho, steps = solver.regularisation, np.eye(size)
    at_zero = rho(np.zeros(size))
    ahead, behind = (np.array([rho(sign * step) for step in steps]) for sign in (1.0, -1.0))
    weight = 0.5 * (ahead + behind) - at_zero
    centre = 0.25 * (behind - ahead) / weight
    projection = coefficients.projection
    tikhonov, drawn_to = solver.tikhonov()
    np.testing.assert_allclose(tikhonov, tikhonov.T, rtol=1e-9, atol=1e-12 * np.abs(tikhonov).max())
    for beta in np.random.default_rng(7).normal(size=(5, len(coefficients))):
        # stationary: 2 w (theta - t) = B' l,  so  theta = t + B' l / 2 w  with  B theta = beta
        inner = (projection / weight) @ projection.T
        multipliers = np.linalg.solve(inner, beta - projection @ centre)
        theta = centre + (projection.T @ multipliers) / weight
        np.testing.assert_allclose(projection @ theta, beta, atol=1e-8)
        assert (beta - drawn_to) @ tikhonov @ (beta - drawn_to) == pytest.approx(rho(theta), rel=1e-6)
