"""Draws inside constraints against rejection sampling; and the mass inside."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from conftest import random_motion, small_robot
from posterior_logs import FEW, infer_from, make_log

from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.posterior.modes import integrate
from bayesid.regression.stated import constraints_of
from bayesid.robot.inertia import from_pseudo_inertia

FORMS = {
    "box": lambda p: [p.com_in_box(1, [-0.05, -0.3, 0.0], [0.22, 0.08, 0.31]), p["m1"] <= 2.6, p["Fv1"] >= 0.15],
    "norm": lambda p: [cp.norm(p.first_moment(1) - np.array([0.1, 0, 0.2])) <= 0.2 * p["m1"]],
    "ellipsoid": lambda p: [p.density_in_ellipsoid(1, [0.1, 0.0, 0.15], [0.5, 0.42, 0.46])],
}
MORE = replace(FEW, walkers=64, min_ess=3000.0, budget=200.0)


@pytest.fixture(scope="module")
def log():
    """Of one body with friction; the data show nine combinations, and some signs are hidden."""
    robot = small_robot(1)
    model = Model(robot, make_terms(["rigid_body", "viscous_friction"], robot, random_motion(1, 100, 1)))
    rng = np.random.default_rng(5)
    centre = np.array([0.12, -0.05, 0.18])
    matrix = np.diag([0.06, 0.04, 0.09, 2.1])
    matrix[:3, :3] += 2.1 * np.outer(centre, centre)
    matrix[:3, 3] = matrix[3, :3] = 2.1 * centre
    theta = np.append(from_pseudo_inertia(matrix), 0.3)
    sd = np.array([0.3] * 6 + [0.6] * 3 + [1.5, 0.5])
    mean = theta + 0.5 * sd * rng.standard_normal(len(theta))
    made = make_log(
        theta, (7,) * 5, None, (1, 1, 0, 1, 0), mean, sd, model.cone, (0.6,), (1.3,), 8, rng.normal(size=(5, 11)) * 0.6
    )
    return model, made, infer_from(made, options=MORE)


@pytest.mark.parametrize("form", FORMS)
def test_draws_are_those_that_satisfy_the_constraints(form, log):
    model, made, free = log
    names = [parameter.name for parameter in model.parameters]
    stated = constraints_of(FORMS[form], model).of(names)
    posterior = infer_from(replace(made, cone=replace(made.cone, stated=stated)), options=MORE)
    draws, every = (one.draws.theta.reshape(-1, len(names)) for one in (posterior, free))
    assert all(stated.contains(theta) for theta in draws[::7])
    assert stated.contains(posterior.theta)
    inside = np.array([stated.contains(theta) for theta in every])
    assert 0.02 < inside.mean() < 0.7, "the constraints cut something off, and leave enough to compare"
    few = every[inside]
    spread = few.std(axis=0)
    error = spread * np.sqrt(2.0 / min(len(few), 0.5 * inside.mean() * MORE.min_ess * 4) + 1.0 / MORE.min_ess)
    np.testing.assert_array_less(np.abs(draws.mean(axis=0) - few.mean(axis=0)), 4.0 * error + 0.02 * spread)
    np.testing.assert_allclose(draws.std(axis=0), spread, rtol=0.12)
    with_them, without = (integrate(one.target, one.draws, seed=3) for one in (posterior, free))
    tolerance = 4.0 * np.hypot(with_them.standard_error, without.standard_error) + 0.15
    assert with_them.log_value - without.log_value == pytest.approx(np.log(inside.mean()), abs=tolerance)


def test_a_window_that_contradicts_constraints_is_dropped(log):
    model, made, free = log
    names = [parameter.name for parameter in model.parameters]
    stated = constraints_of(lambda p: p.total_mass >= 5000, model).of(names)
    prior = replace(made, cone=replace(made.cone, stated=stated)).target.prior
    assert "mass of all links, from above" in [window.name for window in free.target.prior.windows]
    assert "mass of all links, from above" not in [window.name for window in prior.windows]
    assert len(prior.windows) == len(free.target.prior.windows) - 1
    assert prior.region.contains(prior.inside[:, None])[0]
    assert prior.inside[names.index("m1")] > 5000
