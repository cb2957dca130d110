from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import small_robot, smooth_motion

from bayesid.discrepancy.case import Case, HeldBack
from bayesid.effects.catalogue import make_terms
from bayesid.effects.drive import Delay
from bayesid.effects.hysteresis import Hysteresis
from bayesid.effects.model import Model
from bayesid.regression.knowledge import CoefficientPrior, KinematicTolerance
from bayesid.simulation.parameters import random_parameters

N = 3


def made_case(names, **tolerance):
    robot, motion = small_robot(N, seed=2), smooth_motion(N, 2.0, 50.0, seed=4)
    model = Model(robot, make_terms(names, robot, motion))
    theta = random_parameters(model, rng=np.random.default_rng(1))
    signals = SimpleNamespace(motion=motion, rate=50.0)
    trial = SimpleNamespace(signals=signals, actuators=motion, magnitude=None, used=None)
    return Case(CoefficientPrior(model, theta, np.zeros((1, 1))), None, None, trial, None, None, **tolerance), motion


def test_uncertain_columns_are_those_of_geometry_errors():
    """Without the first joint's placement. Compared with a robot whose second joint is shifted along its x axis."""
    case, motion = made_case(
        ["viscous_friction", "rigid_body"], tolerance=KinematicTolerance(length=0.004, angle=0.002)
    )
    model, theta, robot = case.model, case.knowledge.theta, case.model.robot
    moved, step = list(robot.joints), 1e-4
    place = moved[1].placement @ np.array([[1, 0, 0, step], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    moved[1] = replace(moved[1], placement=place)
    other = replace(robot, joints=tuple(moved))
    there = Model(other, make_terms(["viscous_friction", "rigid_body"], other, motion)).effort(motion, theta)
    expected = (there - model.effort(motion, theta)) / step * 0.004
    assert case.uncertain.joints == {0, 1, 2}
    np.testing.assert_array_equal(case.uncertain.sd, np.ones(6 * (N - 1)))
    for j in range(N):
        found = case.uncertain.rows[j][:, 0]
        np.testing.assert_allclose(found, expected[:, j], atol=1e-3 * np.abs(expected).max())


@pytest.mark.parametrize("added", [("payload", "hysteresis"), ("delay",)])
def test_effort_of_an_extended_model(added):
    """The model's columns are cached for additional terms; a distortion changes all of them."""
    case, motion = made_case(["viscous_friction", "rigid_body"])
    model, robot, rng = case.model, case.model.robot, np.random.default_rng(3)
    extended = model
    extra = {
        "payload": make_terms(["payload"], robot, motion)[0],
        "hysteresis": Hysteresis(joints=(2,), width=(0.03,)),
        "delay": Delay(lag=(0.011,)),
    }
    for name in added:
        extended = extended.extend(extra[name])
    held = HeldBack(SimpleNamespace(signals=SimpleNamespace(motion=motion)), "another", another_log=True)
    theta = rng.normal(size=len(extended.parameters))
    for scale in (1.0, -0.4):
        expected = extended.effort(motion, scale * theta)
        np.testing.assert_allclose(held.effort(model, extended, scale * theta), expected, atol=1e-10)
