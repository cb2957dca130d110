"""Scales of links from a robot's lengths and its efforts: against draws of the prior, by scaling, and on whole logs."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import small_robot, smooth_motion

from bayesid.effects import STANDARD, RigidBody
from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.identification.pipeline import identify
from bayesid.log.segments import Segments
from bayesid.posterior.sampler import Sampling
from bayesid.posterior.target import usual_links
from bayesid.regression.knowledge import LinkPrior, ParameterPrior
from bayesid.regression.normal_equations import normal_equations
from bayesid.robot import robot_from_table
from bayesid.signs.search.certified import Certified
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters

MOTION = smooth_motion(3, 8.0, 50.0, seed=3)


def scaled(robot, length):
    """An arm of which every length is so many times as long."""

    def moved(frame):
        frame = frame.copy()
        frame[:3, 3] *= length
        return frame

    joints = (replace(j, placement=moved(j.placement), link_frame=moved(j.link_frame)) for j in robot.joints)
    return replace(robot, joints=tuple(joints))


def links_of(robot, effort, motion=MOTION, terms=("rigid_body",), reach=None):
    model = Model(robot, make_terms(terms, robot, motion))
    coefficients, n = base_coefficients(model), robot.n_joints
    segments = Segments(
        np.arange(n), np.zeros(n, int), np.full(n, len(motion)), np.ones(n, int), np.ones(n, dtype=bool)
    )
    observed = normal_equations(model, coefficients, motion, effort, segments)
    return usual_links(robot, motion, coefficients, model.cone, observed, reach=reach)


@cache
def arm():
    """One whose efforts are known, N m."""
    robot = small_robot(3)
    model = Model(robot, (RigidBody(),))
    return robot, model.effort(MOTION, random_parameters(model, rng=np.random.default_rng(5)))


def test_draws_of_the_prior_make_efforts_nine_times_as_strong():
    """Their energy grows with the square of the mass, and the scale is three times the true mass."""
    robot, effort = arm()
    links, rng = links_of(robot, effort), np.random.default_rng(0)
    drawn = links.centre + links.sd * rng.standard_normal((4000, 3, 10))
    regressor = robot.regressor(MOTION[::10]).reshape(-1, 30)
    energy = np.mean((regressor @ drawn.reshape(-1, 30).T) ** 2)
    assert energy / np.mean(effort[::10] ** 2) == pytest.approx(9.0, rel=0.15)


@pytest.mark.parametrize(("mass", "length"), [(120.0, 3.0), (0.01, 0.2)])
def test_the_prior_scales_with_the_robot(mass, length):
    robot, effort = arm()
    usual = links_of(robot, effort)
    other = scaled(replace(robot, gravity=length * robot.gravity), length)  # so that all torques grow alike
    links = links_of(other, mass * length**2 * effort)
    assert links.mass == pytest.approx(mass * usual.mass, rel=1e-6)
    assert links.reach == pytest.approx(length * usual.reach)
    assert links.total_mass == pytest.approx([mass * kg for kg in usual.total_mass])
    assert links.largest_radius == pytest.approx(length * usual.largest_radius)


def test_lengths_are_those_of_the_stretched_arm():
    rows = [{"a": 0.3, "alpha": 0.5, "d": 0.4, "theta": 0.0}, {"a": 0.0, "alpha": 0.0, "d": 0.7, "theta": 1.0}]
    robot = robot_from_table({"name": "arm", "convention": "standard", "joints": rows}, "test")
    assert robot.stretched == pytest.approx(0.5 + 0.7)
    motion = smooth_motion(2, 3.0, 50.0)
    assert links_of(robot, np.ones((len(motion), 2)), motion).reach == pytest.approx(0.3)


def test_a_table_without_lengths_shows_none():
    row = {"a": 0.0, "alpha": 0.0, "d": 0.0, "theta": 0.0}
    motion = smooth_motion(1, 3.0, 50.0)
    table = {"name": "pendulum", "convention": "standard", "gravity": [0.0, -9.81, 0.0], "joints": [row]}
    robot = robot_from_table(table, "test")
    assert links_of(robot, np.full((len(motion), 1), 2.0), motion).reach == LinkPrior().reach
    held, halved = (links_of(robot, np.full((len(motion), 1), 2.0), motion, reach=reach) for reach in (0.4, 0.2))
    assert (held.reach, halved.reach) == (0.4, 0.2)
    assert halved.mass == pytest.approx(2.0 * held.mass, rel=0.1)  # the same weight times half the distance
    table["joints"] = [row | {"type": "prismatic"}]
    slide = robot_from_table(table | {"gravity": [0.0, 0.0, -9.81]}, "test")
    links = links_of(slide, np.full((len(motion), 1), 60.0), motion)
    assert links.reach == pytest.approx(np.ptp(motion.q) / 4.0)
    assert links.mass == pytest.approx(3.0 * 60.0 / 9.81, rel=0.1)  # its weight, and hardly any acceleration


def test_zero_efforts_show_no_mass():
    robot, effort = arm()
    assert links_of(robot, 0.0 * effort).mass == LinkPrior().mass


@cache
def identified(total, length, seed, links=None, sampling=Sampling(walkers=32)):
    """A log of an arm of this weight, kg, and its identification: the true parameters with it."""
    robot = scaled(small_robot(3, seed=seed), length)
    motion = smooth_motion(3, 8.0, 50.0, seed=seed)
    model = Model(robot, make_terms(STANDARD, robot, motion))
    rng = np.random.default_rng(seed)
    theta = random_parameters(model, rng=rng)
    theta *= total / theta[model.cone.bodies[:, 9]].sum()
    log = simulate(model, theta, motion, rng=rng, noise=0.03)
    search = Certified()
    prior = ParameterPrior() if links is None else ParameterPrior(link_mass=links.mass, link_reach=links.reach)
    return theta, identify(robot, log, complete="off", search=search, posterior=sampling, prior=prior)


LONG = [pytest.param(*one, marks=pytest.mark.long) for one in ((0.2, 0.25), (2000.0, 4.0))]


@pytest.mark.parametrize(("total", "length"), [(690.0, 3.0), *LONG])
def test_from_a_desktop_arm_to_a_palletiser(total, length):
    inside = []
    for seed in range(4):
        theta, result = identified(total, length, seed)
        posterior, truth = result.posterior, result.coefficients.project(theta)
        assert posterior.converged
        assert posterior.max_rhat <= 1.05
        masses = posterior.draws.theta[..., result.model.cone.bodies[:, 9]].sum(axis=-1)
        assert abs(masses.mean() - total) < 3.0 * masses.std()
        assert masses.std() > 0.05 * total  # it stands at no window
        assert posterior.active_bounds == ()
        low, high = posterior.interval(0.95)
        inside += ((low <= truth) & (truth <= high)).tolist()
    few = 0.95 - 2.0 * np.sqrt(0.95 * 0.05 / len(inside)) - 0.03  # of four logs, coefficients are no independent draws
    assert np.mean(inside) > few


@pytest.mark.parametrize(
    ("links", "named"),
    [
        (LinkPrior(), "mass of all links, from above"),
        pytest.param(LinkPrior(mass=200.0, reach=0.02), "radius", marks=pytest.mark.long),
    ],
)
def test_draws_at_a_window_are_named(links, named):
    _, result = identified(690.0, 3.0, 0, links, Sampling(walkers=32, max_sweeps=100))
    active_bounds = dict(result.posterior.active_bounds)
    assert any(named in name for name in active_bounds)
    assert all(share > 0.2 for share in active_bounds.values())
    (said,) = [warning for warning in result.warnings if "--links" in warning]
    assert named in said


def test_windows_end_where_the_region_does():
    _, result = identified(690.0, 3.0, 1)
    prior = result.posterior.target.prior
    inside = result.posterior.theta
    for window in prior.windows:
        far = inside + 1e9 * (window.part - window.whole) / np.linalg.norm(window.part - window.whole)
        assert window.share(inside) < 1.0
        low, high = 0.0, 1.0
        for _ in range(80):
            middle = 0.5 * (low + high)
            outside = window.share(inside + middle * (far - inside)) > 1.0
            low, high = (low, middle) if outside else (middle, high)
        slack = prior.region.slack((inside + high * (far - inside))[:, None])[:, 0]
        assert np.abs(slack).min() < 1e-4 * np.abs(slack).max()
