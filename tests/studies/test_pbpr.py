"""PBPR by simulated annealing: against least squares, convex programming, and constraints worked out from theta."""

import numpy as np
import pytest
from conftest import random_motion, small_robot

from bayesid.effects import RigidBody, ViscousFriction
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.effects.parameters import Cone
from bayesid.errors import InputError
from bayesid.regression.solver import solve_precisely
from bayesid.robot import load_robot
from bayesid.simulation.parameters import random_parameters
from bayesid.studies.pbpr import (
    TOLERANCE,
    AnnealedLeastSquares,
    Annealing,
    Bodies,
    Bounds,
    Constraint,
    SquaredError,
    center_of_mass_inside,
    coefficient_error,
    effort_error,
    feasible_inertia,
    make_bounds,
    retrieve_by_annealing,
    total_mass,
)

QUICK = Annealing(evaluations=500)


@pytest.fixture(scope="module")
def arm():
    """Two joints, ten coefficients, and a true theta."""
    model = Model(small_robot(2), (RigidBody(),))
    return model, base_coefficients(model), random_parameters(model, rng=np.random.default_rng(5))


def test_feasible_inertia_reaches_the_optimum_of_the_cone():
    """Noise moves the unconstrained optimum out of the cone; the least cost inside is known from convex programming."""
    model = Model(small_robot(2), (RigidBody(), ViscousFriction()))
    coefficients, motion, rng = base_coefficients(model), random_motion(2, 100, 4), np.random.default_rng(4)
    effort = model.effort(motion, random_parameters(model, rng=rng))
    effort = (effort + 0.5 * effort.std(axis=0) * rng.normal(size=effort.shape)).ravel()
    rows = model.columns(motion).reshape(len(effort), -1)[:, coefficients.selected]
    hessian, gradient, energy = rows.T @ rows, rows.T @ effort, float(effort @ effort)
    error, box = effort_error(coefficients, hessian, gradient, energy), make_bounds(model)
    cone = energy + solve_precisely(model.cone, coefficients, hessian, gradient, energy).cost
    free = retrieve_by_annealing(error, model.cone, box, constraints=())
    assert not model.cone.contains(free.theta)
    assert free.phi < 0.995 * cone, "the cone matters here"
    found = retrieve_by_annealing(error, model.cone, box, annealing=QUICK)
    assert found.satisfied
    assert model.cone.contains(found.theta)
    assert found.phi == pytest.approx(cone, rel=1e-4)


def test_feasible_parameters_of_known_coefficients_meet_constraints_on_mass_and_centre():
    kr5 = Model(load_robot("kr5"), (RigidBody(),))
    coefficients = base_coefficients(kr5)
    theta = random_parameters(kr5, rng=np.random.default_rng(3))
    bodies = Bodies(theta, kr5.cone)
    beta, mass = coefficients.project(theta), float(bodies.mass.sum())
    (xx, xy, xz, yy, yz, zz, *moment, m), c = theta[10:20], bodies.center_of_mass[1]
    about_frame = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    np.testing.assert_allclose(c, np.array(moment) / m)
    np.testing.assert_allclose(bodies.inertia_at_center[1], about_frame - m * (c @ c * np.eye(3) - np.outer(c, c)))
    hull = (bodies.center_of_mass - np.array([0.08, 0.05, 0.06]), bodies.center_of_mass + np.array([0.05, 0.09, 0.07]))
    constraints = (feasible_inertia(), total_mass(0.9 * mass, 1.05 * mass), center_of_mass_inside(*hull))
    found = retrieve_by_annealing(coefficient_error(coefficients, beta), kr5.cone, make_bounds(kr5), constraints, QUICK)
    assert found.satisfied
    assert found.violations.keys() == {"feasible inertia", "total mass", "centre of mass"}
    assert coefficients.project(found.theta) == pytest.approx(beta, abs=1e-4 * np.linalg.norm(beta))
    links = found.theta.reshape(-1, 10)
    center = links[:, 6:9] / links[:, 9:]
    assert kr5.cone.smallest_eigenvalues(found.theta).min() > 0.0
    assert 0.9 * mass - TOLERANCE <= links[:, 9].sum() <= 1.05 * mass + TOLERANCE
    assert np.all((center >= hull[0] - TOLERANCE) & (center <= hull[1] + TOLERANCE))


def test_what_cannot_be_satisfied_is_reported_repeatably_and_makes_a_node_dear(arm):
    model, coefficients, theta = arm
    hessian, beta = np.diag(np.arange(1.0, 11.0)), coefficients.project(theta)
    error, heavy = coefficient_error(coefficients, beta), total_mass(75.0, 80.0)  # two links of at most 30 kg
    bounds = make_bounds(model, {"mc1z": (0.01, 0.02)})
    annealing = Annealing(runs=4, evaluations=300)
    found, again = (retrieve_by_annealing(error, model.cone, bounds, (heavy,), annealing) for _ in range(2))
    assert found.theta.tolist() == again.theta.tolist()
    assert np.all((bounds.lower <= found.theta) & (found.theta <= bounds.upper))
    assert not found.satisfied
    assert found.violations["total mass"] == pytest.approx(15.0, abs=0.1)
    assert found.runs == 4
    assert found.penalty_weight > 0.0
    arguments = (model.cone, coefficients, make_bounds(model), float(beta @ hessian @ beta))
    free, bound = (
        AnnealedLeastSquares(*arguments, constraints, Annealing(runs=2, evaluations=100))
        .prepared(hessian)
        .solve(hessian @ beta)
        for constraints in ((), (heavy,))
    )
    assert free.cost == pytest.approx(-beta @ hessian @ beta)
    assert free.tolerance == 0.0
    assert bound.cost > free.cost + 1.0
    assert bound.tolerance > 10.0


def test_constraints_and_bounds_that_cannot_be_used(arm):
    model, coefficients, theta = arm
    away = coefficients.project(theta) - (beta := np.linspace(-1.0, 2.0, len(coefficients)))
    error = coefficient_error(coefficients, beta, np.diag(np.arange(10.0)))
    assert error(theta) == pytest.approx(np.arange(10.0) @ away**2)
    with pytest.raises(ValueError, match="empty bounds"):
        Bounds(np.array([0.0, 1.0]), np.array([1.0, 1.0]))
    for name, bounds in (("m9", (0, 1)), ("m1", (2, 1)), ("m1", (0, np.inf))):
        with pytest.raises(InputError, match=name):
            make_bounds(model, {name: bounds})
    broken = Constraint("broken", lambda _: np.nan)
    for constraints, said in (((broken,), "'broken'.*finite"), ((total_mass(0, 1), total_mass(2, 3)), "repeat")):
        with pytest.raises(InputError, match=said):
            retrieve_by_annealing(error, model.cone, make_bounds(model), constraints)


def test_what_leaves_no_trace_stays_where_the_search_starts():
    """Two parameters that act by their sum only, one of them conditional on the other: not convex."""
    error, cone = SquaredError(np.array([[1.0, 1.0]]), np.array([4.0]), 0.0), Cone.free(2)
    bounds = Bounds(np.zeros(2), np.full(2, 10.0))
    rule = Constraint("light or heavy", lambda bodies: min(bodies.theta[0] - 0.5, 3.0 - bodies.theta[0]))
    for start, expected in ((np.array([3.5, 0.5]), [3.5, 0.5]), (np.array([0.2, 3.8]), [0.2, 3.8])):
        found = retrieve_by_annealing(error, cone, bounds, [rule], start=start)
        assert found.satisfied
        np.testing.assert_allclose(found.theta, expected, atol=1e-6)
        assert found.runs == 0
    found = retrieve_by_annealing(error, cone, bounds, [rule], Annealing(evaluations=200), start=np.array([2.0, 2.0]))
    assert found.satisfied
    assert found.theta.sum() == pytest.approx(4.0, abs=1e-3)
