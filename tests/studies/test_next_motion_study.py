"""The study of next motions: limits are checked with the true robot; short runs have a report."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import small_robot

from bayesid.effects import RigidBody
from bayesid.effects.model import Model
from bayesid.excitation.splines import SplineBasis, SplineTrajectory
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import MotionLimits
from bayesid.studies import load, next_motion
from bayesid.studies.next_motion import COEFFICIENTS, HYPOTHESES, Scenario, kept_limits

STUDY = load("next_motion")
_CHANGES = 20


def test_a_limit_that_is_broken_between_samples_is_seen():
    robot, basis = small_robot(3), SplineBasis(2.0)
    control = np.zeros((len(basis), 3))
    control[4:-4, 2] = 0.2
    model = Model(robot, (RigidBody(),))
    truth = SimpleNamespace(model=model, theta=random_parameters(model, rng=np.random.default_rng(1)))
    wide = MotionLimits(jerk=1e6, effort=1e6)
    trajectory = SplineTrajectory(basis, control)

    def held(**limits):
        own = replace(wide, **{"velocity": 1e6, "acceleration": 1e6, **limits})
        return kept_limits(truth, SimpleNamespace(trajectory=trajectory, limits=own))

    fastest, strongest, jerkiest = (np.abs(trajectory.bounds(order)).max() for order in (1, 2, 3))
    assert held(velocity=1.001 * fastest, acceleration=1.001 * strongest, jerk=1.001 * jerkiest)["motion_held"]
    for name, largest in (("velocity", fastest), ("acceleration", strongest), ("jerk", jerkiest)):
        assert not held(**{name: 0.8 * largest})["motion_held"], name  # bounds are a few per cent wide
    effort = np.abs(truth.model.effort(trajectory.motion(np.linspace(0.0, 2.0, 4001)), truth.theta)).max(axis=0)
    assert held(effort=tuple(1.0001 * effort))["effort_held"]
    assert not held(effort=tuple(0.999 * effort))["effort_held"]


@pytest.mark.long
@pytest.mark.parametrize(
    "scenario",
    [
        Scenario(COEFFICIENTS, "kr5", changes=_CHANGES),
        Scenario(COEFFICIENTS, "arm", limited=False, changes=_CHANGES),
        Scenario(HYPOTHESES, "kr5", "joint_spring", changes=_CHANGES),
    ],
    ids=lambda scenario: f"{scenario.part}-{scenario.robot}",
)
def test_a_short_trial_of_each_kind(scenario):
    row = next_motion.trial(scenario, 0)
    assert row["motion_held"]
    assert row["effort_held"] in ((True,) if scenario.limited else (None,))
    if scenario.part == COEFFICIENTS:
        assert row["open_designed"] < row["open_now"]
        assert max(row["error_designed"], row["error_random"]) < 1.5
        assert row["noise_above"] < 0.2 * row["coefficients"]
    else:
        assert row["named_designed"]
        assert row["discriminated_designed"]
