"""Coefficients that an effect would look like: worked out by hand, and against a log that has the effect."""

import numpy as np
import pytest

from bayesid.effects.catalogue import make_effect, make_terms
from bayesid.effects.model import Model
from bayesid.identification.pipeline import identify
from bayesid.regression.selection.unseen import TooNarrow, geometry_far_off, too_narrow
from bayesid.robot import robot_from_table
from bayesid.signs.search.certified import Certified
from bayesid.simulation.logs import simulate
from bayesid.simulation.trajectories import random_trajectory

NAMES = ("J1zz", "mc2x", "mc2y", "Fc2", "offset2")
SD = np.array([0.1, 0.2, np.inf, 0.05, 0.5])
OF_LINKS = np.array([True, True, True, False, False])


@pytest.mark.parametrize(
    ("moves", "expected"),
    [
        ([0.25, 1.0, 9.0, 0.08, 0.0], ("mc2x", "J1zz")),  # times: 2.5, 5, unknown, 1.6, 0
        ([0.25, 0.4, 9.0, 0.2, 0.0], None),  # most of it is friction
        ([0.15, 0.3, 9.0, 0.05, 0.0], None),  # too small
    ],
)
def test_an_effect_that_mostly_looks_like_links_names_what_it_moves(moves, expected):
    found = too_narrow([(("gravity_spring", (2,)), np.array(moves))], NAMES, SD, OF_LINKS)
    assert found == (() if expected is None else (TooNarrow(("gravity_spring",), (2,), expected),))


def test_effects_of_one_joint_are_one_statement():
    first, second = np.array([0.3, 0.5, 0.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0, 0.0, 2.0])
    effects = [(("joint_spring", (2,)), first), (("base_tilt", ()), first), (("cable_drag", (2,)), second)]
    springs, tilt = too_narrow(effects, NAMES, SD, OF_LINKS)
    assert springs == TooNarrow(("cable_drag", "joint_spring"), (2,), ("mc2x", "offset2", "J1zz"))
    assert tilt == TooNarrow(("base_tilt",), (), ("J1zz", "mc2x"))


@pytest.mark.parametrize(
    ("scale", "expected"), [(1.9, ()), (3.5, (TooNarrow(("kinematics",), (), ("mc2x", "J1zz"), 3.5),))]
)
def test_a_geometry_far_off_names_what_it_makes_uncertain(scale, expected):
    by_geometry = np.array([0.25, 0.9, 1.0, 0.01, 0.2])
    assert geometry_far_off(scale, by_geometry, NAMES, SD) == expected


def test_a_geometry_far_off_that_moves_nothing_is_not_spoken_of():
    assert geometry_far_off(9.0, np.full(5, 0.01), NAMES, SD) == ()


def arm(alpha):
    """Two parallel axes, horizontal if alpha is a right angle."""
    rows = [{"a": 0.0, "alpha": alpha, "d": 0.0, "theta": 0.3}, {"a": 0.45, "alpha": 0.0, "d": 0.0, "theta": -0.2}]
    return robot_from_table({"convention": "modified", "joints": rows}, "an arm in a plane")


TERMS = ("rigid_body", "viscous_friction", "coulomb_friction")
MOTION = random_trajectory(2, 8.0, seed=6).motion(np.arange(401) / 50.0)
LINKS = [0.1, 0, 0, 0.2, 0, 0.3, 0.9, 0.35, 0, 3.0, 0.05, 0, 0, 0.1, 0, 0.12, 0.4, -0.1, 0, 1.5]
FRICTION = [0.8, 0.5, 2.0, 1.1]
SPRING = (6.0, -2.5)
"""N m per sine and cosine of the first joint: gravity of a first link with other first moments."""


def identified_arm(spring=(0.0, 0.0), alpha=np.pi / 2.0):
    robot = arm(alpha)
    model = Model(robot, make_terms(TERMS, robot, MOTION)).extend(make_effect("gravity_spring", {"joints": [1]}))
    log = simulate(model, np.array([*LINKS, *FRICTION, *spring]), MOTION, rng=np.random.default_rng(3), noise=0.02)
    return identify(robot, log, TERMS, search=Certified(budget=2.0), posterior=False)


@pytest.mark.parametrize("spring", [(0.0, 0.0), SPRING])
def test_a_counterbalance_is_gravity_to_the_log_and_its_coefficients_are_named(spring):
    """With a spring the first link's first moments are wrong by many standard deviations, and nothing shows it."""
    result = identified_arm(spring)
    assert "gravity_spring" not in {effect.effect for effect in result.completion.effects}
    (found,) = [one for one in result.completion.too_narrow if one.joints == (1,)]
    assert "gravity_spring" in found.effects
    assert found.times is None
    truth = result.coefficients.project(np.array([*LINKS, *FRICTION]))
    off = np.abs(result.fit.beta - truth) / result.fit.sd
    wrong = {name for name, times in zip(result.coefficients.names, off.tolist(), strict=True) if times > 5.0}
    assert bool(wrong) == any(spring)
    assert wrong <= set(found.coefficients)
    assert not {"Fc1", "Fv1", "Fc2", "Fv2"} & set(found.coefficients[:2])


def test_a_log_that_tells_them_apart_names_none():
    """About vertical axes there is no gravity that a spring could look like; only a rotor like its link's inertia."""
    (found,) = identified_arm(alpha=0.0).completion.too_narrow
    assert found == TooNarrow(("rotor_inertia",), (1,), ("J1zz",))
