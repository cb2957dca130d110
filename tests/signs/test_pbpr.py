import numpy as np
import pytest
from conftest import random_motion, small_robot, smooth_motion

from bayesid.errors import InputError
from bayesid.fit.hessians import Hessians
from bayesid.fit.moments import Moments
from bayesid.fit.solver import ConeLeastSquares, solve_precisely
from bayesid.model.coefficients import base_coefficients
from bayesid.model.model import Model
from bayesid.model.robot import load_robot
from bayesid.model.terms import RigidBody, ViscousFriction
from bayesid.signs.search.beam import beam
from bayesid.signs.search.pbpr import (
    TOLERANCE,
    AnnealedLeastSquares,
    Annealing,
    Bodies,
    Bounds,
    Constraint,
    center_of_mass_inside,
    coefficient_error,
    effort_error,
    feasible_inertia,
    make_bounds,
    retrieve_by_annealing,
    total_mass,
)
from bayesid.simulation.parameters import random_parameters

QUICK = Annealing(evaluations=500)


def least_squares(model, samples, noise, seed):
    """Coefficients, a true theta, and columns and noisy efforts as plain rows."""
    rng = np.random.default_rng(seed)
    coefficients, theta = base_coefficients(model), random_parameters(model, rng)
    motion = random_motion(model.robot.n_joints, samples, seed)
    effort = model.effort(motion, theta)
    effort = effort + noise * effort.std(axis=0) * rng.normal(size=effort.shape)
    rows = model.columns(motion).reshape(-1, len(theta))[:, coefficients.kept]
    return coefficients, theta, rows, effort.ravel()


def moments_of(rows, effort):
    return rows.T @ rows, rows.T @ effort, float(effort @ effort)


@pytest.fixture(scope="module")
def kr5():
    return Model(load_robot("kr5"), (RigidBody(),))


@pytest.fixture(scope="module")
def arm():
    """Two joints, ten coefficients, and a true theta."""
    model = Model(small_robot(2), (RigidBody(),))
    return model, base_coefficients(model), random_parameters(model, np.random.default_rng(5))


# ---------------------------------------------------------------------------------------------------------------
# phi
# ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("terms", [(RigidBody(),), (RigidBody(), ViscousFriction())])
def test_without_constraints_phi2_reaches_ordinary_least_squares(terms):
    model = Model(load_robot("kr5"), terms)
    coefficients, _, rows, effort = least_squares(model, 200, 0.1, seed=1)
    best, residual = np.linalg.lstsq(rows, effort, rcond=None)[:2]
    error = effort_error(coefficients, *moments_of(rows, effort))
    found = retrieve_by_annealing(error, model.cone, make_bounds(model), constraints=())
    assert found.phi == pytest.approx(residual[0], rel=1e-9)
    assert rows @ coefficients.project(found.theta) == pytest.approx(rows @ best, rel=1e-6, abs=1e-6)
    assert found.satisfied
    assert found.runs == 0


def test_phi2_is_the_squared_error_of_the_rows(kr5):
    coefficients, theta, rows, effort = least_squares(kr5, 100, 0.3, seed=2)
    error = effort_error(coefficients, *moments_of(rows, effort))
    for scale in (0.0, 1.0, 3.0):
        residual = rows @ coefficients.project(scale * theta) - effort
        assert error(scale * theta) == pytest.approx(residual @ residual, rel=1e-9)


def test_phi1_is_the_weighted_distance_of_the_coefficients(arm):
    _, coefficients, theta = arm
    beta = np.linspace(-1.0, 2.0, len(coefficients))
    root = np.random.default_rng(0).normal(size=(3, len(beta)))  # a weight without full rank
    away = coefficients.project(theta) - beta
    assert coefficient_error(coefficients, beta)(theta) == pytest.approx(away @ away)
    assert coefficient_error(coefficients, beta, root.T @ root)(theta) == pytest.approx(np.sum((root @ away) ** 2))


def test_phi2_of_moments_that_leave_directions_open(arm):
    """Two rows for ten coefficients: the beam's first nodes look like this."""
    model, coefficients, _ = arm
    rng = np.random.default_rng(0)
    rows, effort = rng.normal(size=(2, len(coefficients))), np.array([2.0, -1.0])
    error = effort_error(coefficients, *moments_of(rows, effort))
    assert error.factor.shape[0] == 2
    found = retrieve_by_annealing(error, model.cone, make_bounds(model), constraints=())
    assert found.phi == pytest.approx(0.0, abs=1e-12)


# ---------------------------------------------------------------------------------------------------------------
# Constraints
# ---------------------------------------------------------------------------------------------------------------
def test_phi1_retrieves_feasible_parameters_of_known_coefficients(kr5):
    coefficients = base_coefficients(kr5)
    theta = random_parameters(kr5, np.random.default_rng(3))
    bodies = Bodies(theta, kr5.cone)
    beta, mass = coefficients.project(theta), float(bodies.mass.sum())
    hull = (bodies.center_of_mass - np.array([0.08, 0.05, 0.06]), bodies.center_of_mass + np.array([0.05, 0.09, 0.07]))
    constraints = (feasible_inertia(), total_mass(0.9 * mass, 1.05 * mass), center_of_mass_inside(*hull))
    found = retrieve_by_annealing(coefficient_error(coefficients, beta), kr5.cone, make_bounds(kr5), constraints, QUICK)
    assert found.satisfied
    assert found.violations.keys() == {"feasible inertia", "total mass", "centre of mass"}
    assert coefficients.project(found.theta) == pytest.approx(beta, abs=1e-4 * np.linalg.norm(beta))
    # The constraints, worked out from theta alone
    bodies = found.theta.reshape(-1, 10)
    center = bodies[:, 6:9] / bodies[:, 9:]
    assert kr5.cone.smallest_eigenvalues(found.theta).min() > 0.0
    assert 0.9 * mass - TOLERANCE <= bodies[:, 9].sum() <= 1.05 * mass + TOLERANCE
    assert np.all((center >= hull[0] - TOLERANCE) & (center <= hull[1] + TOLERANCE))


def test_feasible_inertia_reaches_the_optimum_of_the_cone():
    """Noise pushes the unconstrained optimum out of the cone; convex programming says what the best inside it costs."""
    model = Model(small_robot(2), (RigidBody(), ViscousFriction()))
    coefficients, _, rows, effort = least_squares(model, 100, 0.5, seed=4)
    hessian, gradient, energy = moments_of(rows, effort)
    error, box = effort_error(coefficients, hessian, gradient, energy), make_bounds(model)
    cone = energy + solve_precisely(model.cone, coefficients, hessian, gradient, energy).cost
    free = retrieve_by_annealing(error, model.cone, box, constraints=())
    assert not model.cone.contains(free.theta)
    assert free.phi < 0.995 * cone  # the cone matters here
    found = retrieve_by_annealing(error, model.cone, box, annealing=QUICK)
    assert found.satisfied
    assert model.cone.contains(found.theta)
    assert found.phi == pytest.approx(cone, rel=1e-4)


def far_if_heavy(bodies):
    """A second link above 3 kg has its centre of mass 0.3 m away from its frame."""
    return min(bodies.mass[1] - 3.0, 0.3 - np.linalg.norm(bodies.center_of_mass[1]))


def test_a_conditional_nonlinear_constraint_is_honoured(arm):
    model, coefficients, theta = arm
    error = coefficient_error(coefficients, coefficients.project(theta))
    conditional = Constraint("far if heavy", far_if_heavy)
    without = retrieve_by_annealing(error, model.cone, make_bounds(model))
    assert without.satisfied
    assert far_if_heavy(Bodies(without.theta, model.cone)) > 0.01
    found = retrieve_by_annealing(error, model.cone, make_bounds(model), (feasible_inertia(), conditional))
    assert found.satisfied
    assert far_if_heavy(Bodies(found.theta, model.cone)) <= TOLERANCE
    assert found.phi < 1e-10


def test_a_constraint_without_a_slope_is_met_by_jumping(arm):
    """No gradient leads out of a forbidden mass of 2 to 20 kg: this is what annealing is for."""
    model, coefficients, theta = arm
    error = coefficient_error(coefficients, coefficients.project(theta))
    forbidden = Constraint("forbidden masses", lambda bodies: float(2.0 < bodies.mass[1] < 20.0))
    without = retrieve_by_annealing(error, model.cone, make_bounds(model), ())
    assert 2.0 < without.theta[19] < 20.0
    found = retrieve_by_annealing(error, model.cone, make_bounds(model), (forbidden,))
    assert found.satisfied
    assert not 2.0 < found.theta[19] < 20.0


def test_what_cannot_be_satisfied_is_reported_as_violated(arm):
    model, coefficients, theta = arm
    error = coefficient_error(coefficients, coefficients.project(theta))
    heavy = total_mass(75.0, 80.0)  # two links of at most 30 kg
    found = retrieve_by_annealing(error, model.cone, make_bounds(model), (heavy,), Annealing(runs=4, evaluations=300))
    assert not found.satisfied
    assert found.violations["total mass"] == pytest.approx(15.0, abs=0.1)
    assert found.runs == 4
    assert found.penalty_weight > 0.0
    assert found.evaluations > 4


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_violation_that_is_not_finite_is_an_input_error(arm, value):
    model, coefficients, theta = arm
    error = coefficient_error(coefficients, coefficients.project(theta))
    with pytest.raises(InputError, match=r"'broken'.*finite"):
        retrieve_by_annealing(error, model.cone, make_bounds(model), (Constraint("broken", lambda _: value),))


def test_constraints_have_names_of_their_own(arm):
    model, coefficients, theta = arm
    error = coefficient_error(coefficients, coefficients.project(theta))
    with pytest.raises(InputError, match="repeat"):
        retrieve_by_annealing(error, model.cone, make_bounds(model), (total_mass(0, 1), total_mass(2, 3)))


def test_bodies_of_two_point_masses():
    """2 kg at (0.1, 0.2, -0.3) and 1 kg at (0.4, -0.1, 0), after a parameter that belongs to no body."""
    masses, points = np.array([2.0, 1.0]), np.array([[0.1, 0.2, -0.3], [0.4, -0.1, 0.0]])

    def inertia_about(origin):
        arms = points - origin
        return sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, arms, strict=True))

    j, moment = inertia_about(np.zeros(3)), masses @ points
    body = [*j[np.triu_indices(3)], *moment, 3.0]
    model = Model(small_robot(1), (ViscousFriction(), RigidBody()))
    bodies = Bodies(np.array([0.7, *body]), model.cone)
    assert bodies.mass == pytest.approx([3.0])
    assert bodies.center_of_mass[0] == pytest.approx(moment / 3.0)
    assert bodies.inertia[0] == pytest.approx(j)
    assert bodies.inertia_at_center[0] == pytest.approx(inertia_about(moment / 3.0))
    assert bodies.theta[0] == 0.7
    # Two points span a line: two of the four eigenvalues are zero.
    assert feasible_inertia(0.01).violation(bodies) == pytest.approx(0.01 * np.sqrt(2), abs=1e-9)


# ---------------------------------------------------------------------------------------------------------------
# Bounds
# ---------------------------------------------------------------------------------------------------------------
def test_default_bounds_hold_plausible_parameters_and_keep_signs():
    model = Model(small_robot(3), (RigidBody(), ViscousFriction()))
    bounds = make_bounds(model)
    for seed in range(5):
        theta = random_parameters(model, np.random.default_rng(seed))
        assert np.all((bounds.lower <= theta) & (theta <= bounds.upper))
    position = {parameter.name: k for k, parameter in enumerate(model.parameters)}
    assert bounds.lower[position["m2"]] > 0.0
    assert bounds.lower[position["Fv3"]] == 0.0
    assert bounds.lower[position["mc1y"]] == -bounds.upper[position["mc1y"]] < 0.0


def test_bounds_override_by_name_is_kept_by_the_result(arm):
    model, coefficients, theta = arm
    bounds = make_bounds(model, {"m2": (0.4, 0.9), "mc1z": (0.01, 0.02)})
    found = retrieve_by_annealing(coefficient_error(coefficients, coefficients.project(theta)), model.cone, bounds, ())
    assert np.all((bounds.lower <= found.theta) & (found.theta <= bounds.upper))
    assert 0.4 <= found.theta[19] <= 0.9
    assert 0.01 <= found.theta[8] <= 0.02


@pytest.mark.parametrize(
    ("overrides", "message"),
    [({"m9": (0, 1)}, "m9.*choose from J1xx"), ({"m1": (2, 1)}, "m1"), ({"m1": (0, np.inf)}, "m1")],
)
def test_overrides_that_cannot_be_used(arm, overrides, message):
    with pytest.raises(InputError, match=message):
        make_bounds(arm[0], overrides)


def test_bounds_without_room():
    with pytest.raises(ValueError, match="no room"):
        Bounds(np.array([0.0, 1.0]), np.array([1.0, 1.0]))


# ---------------------------------------------------------------------------------------------------------------
# As the price of a node, and repeatability
# ---------------------------------------------------------------------------------------------------------------
def sign_moments(model, coefficients, effort, motion, n_segments):
    """Moments of |effort| cut where its sign changes, the longest runs of each joint; and the true signs."""
    columns = model.columns(motion)[:, :, coefficients.kept]
    pieces = []
    for j in range(effort.shape[1]):
        cuts = np.flatnonzero(np.diff(np.sign(effort[:, j]))) + 1
        for a, b in zip([0, *cuts], [*cuts, len(effort)], strict=True):
            pieces.append((j, columns[a:b, j], np.abs(effort[a:b, j]), int(np.sign(effort[a, j]))))
    pieces = sorted(pieces, key=lambda piece: -piece[2] @ piece[2])[:n_segments]
    parts = [moments_of(rows, magnitude) for _, rows, magnitude, _ in pieces]
    hessian, gradient, energy = (np.array(part) for part in zip(*parts, strict=True))
    joint, count = np.array([piece[0] for piece in pieces]), np.array([len(piece[2]) for piece in pieces])
    hessian = Hessians.make(joint, hessian)
    return Moments(joint, np.zeros_like(joint), hessian, gradient, energy, count), np.array([p[3] for p in pieces])


def test_as_node_cost_it_finds_the_signs_that_the_cone_finds():
    model = Model(small_robot(2, seed=3), (RigidBody(), ViscousFriction()))
    coefficients = base_coefficients(model)
    rng = np.random.default_rng(8)
    motion = smooth_motion(2, 8.0, 40.0, seed=4)
    effort = model.effort(motion, random_parameters(model, rng))
    effort = effort + 0.02 * effort.std(axis=0) * rng.normal(size=effort.shape)
    m, signs = sign_moments(model, coefficients, effort, motion, 6)
    hessian, energy = m.hessian.total(), float(m.energy.sum())
    by_cone = beam(m, ConeLeastSquares(model.cone, coefficients, hessian, energy), width=2, initial=2)
    box, quick = make_bounds(model), Annealing(runs=6, evaluations=100, growth=100.0)
    node = AnnealedLeastSquares(model.cone, coefficients, box, energy, annealing=quick)
    by_annealing = beam(m, node, width=2, initial=2)
    assert by_annealing.signs.tolist() == by_cone.signs.tolist() == signs.tolist()
    assert by_annealing.cost == pytest.approx(by_cone.cost, rel=5e-3)


def test_a_node_that_violates_a_constraint_pays_for_it(arm):
    model, coefficients, theta = arm
    hessian, beta = np.diag(np.arange(1.0, 11.0)), coefficients.project(theta)
    arguments = (model.cone, coefficients, make_bounds(model), float(beta @ hessian @ beta))
    short = Annealing(runs=2, evaluations=100)
    free, bound = (
        AnnealedLeastSquares(*arguments, constraints, short).prepared(hessian).solve(hessian @ beta)
        for constraints in ((), (total_mass(75, 80),))
    )
    assert free.cost == pytest.approx(-beta @ hessian @ beta)
    assert free.tolerance == 0.0
    assert bound.cost > free.cost + 1.0
    assert bound.tolerance > 10.0


def test_same_seed_same_result_another_seed_another(arm):
    model, coefficients, theta = arm
    error = coefficient_error(coefficients, coefficients.project(theta))
    forbidden = Constraint("forbidden masses", lambda bodies: float(2.0 < bodies.mass[1] < 20.0))

    def theta_of(seed):
        return retrieve_by_annealing(
            error, model.cone, make_bounds(model), (forbidden,), Annealing(seed=seed)
        ).theta.tolist()

    assert theta_of(0) == theta_of(0)
    assert theta_of(0) != theta_of(1)
