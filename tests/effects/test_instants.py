"""A model at one instant after the other, against the same model of the whole motion."""

import numpy as np
import pytest
from conftest import small_robot, smooth_motion

from bayesid.effects import STANDARD, catalogue
from bayesid.effects.drive import Delay, GainError
from bayesid.effects.friction import LoadDependentFriction, StribeckFriction
from bayesid.effects.hysteresis import ElasticHysteresis, Hysteresis, LayeredHysteresis, SmoothHysteresis
from bayesid.effects.kinematic_errors import BaseTilt, LinkLength
from bayesid.effects.model import Model
from bayesid.motion import Instant, unlabelled
from bayesid.robot import load_robot
from bayesid.simulation.parameters import random_parameters

MOTION = smooth_motion(3, 3.0, 100.0)
ROBOT = small_robot(3)
LINKS = tuple(np.random.default_rng(3).uniform(0.1, 1.0, 30).tolist())
EFFECTS = [
    StribeckFriction(joints=(2,), smoothing=(0.02,), speed=(0.1,)),
    LoadDependentFriction(joints=(3,), smoothing=(0.02,), links=LINKS),
    Hysteresis(joints=(1,), width=(0.05,)),
    LayeredHysteresis(joints=(2,), width=(0.08,)),
    SmoothHysteresis(joints=(3,), width=(0.05,)),
    ElasticHysteresis(joints=(2,), width=(0.04,)),
    BaseTilt(angle=(0.02, -0.05)),
    LinkLength(joints=(2,), error=(0.01,)),
    GainError(joints=(1,), gain=(1.1,)),
]


def instants(motion, past=None):
    memory = {}
    for k in range(len(motion)):
        row = [part[k : k + 1] for part in (motion.t, motion.q, motion.dq, motion.ddq)]
        yield Instant(*row, motion.origin, unlabelled().reshape(1), past, memory)


def model_with(*effects, robot=ROBOT):
    model = Model(robot, catalogue.make_terms(STANDARD, robot, MOTION))
    for effect in effects:
        model = model.extend(effect)
    return model, random_parameters(model, rng=np.random.default_rng(0))


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_instants_are_those_of_the_whole_motion(effect):
    model, theta = model_with(effect)
    whole = model.effort(MOTION, theta)
    scale = np.abs(whole).max()
    by_terms = np.array([model.effort_at(instant, theta)[0] for instant in instants(MOTION)])
    by_columns = np.array([model.columns(instant)[0] @ theta for instant in instants(MOTION)])
    np.testing.assert_allclose(by_terms, whole, atol=1e-9 * scale)
    np.testing.assert_allclose(by_columns, model.before_sensors.effort(MOTION, theta), atol=1e-9 * scale)


def test_effects_of_one_kind_remember_apart():
    """Two joints of equal width, which differ in their motion."""
    model, theta = model_with(Hysteresis(joints=(1,), width=(0.05,)), Hysteresis(joints=(2,), width=(0.05,)))
    whole = model.effort(MOTION, theta)
    found = np.array([model.effort_at(instant, theta)[0] for instant in instants(MOTION)])
    np.testing.assert_allclose(found, whole, atol=1e-9 * np.abs(whole).max())


@pytest.mark.parametrize("joints", [(), (2,)])
def test_a_delay_asks_for_the_past(joints):
    """By the motion's own formula, shifted: against the spline that logs are shifted by."""
    model, theta = model_with(Delay(joints=joints, lag=(0.013,)))
    assert model.lag == (0.0 if joints else 0.013)
    late = smooth_motion(3, 3.0, 100.0)

    def at(k):
        def past(lag):
            back = late[max(0, k - 30) : k + 2].ago(lag)
            return tuple(part[-2 if k + 2 <= len(late) else -1] for part in (back.q, back.dq, back.ddq))

        return past

    whole = model.effort(MOTION, theta)
    for k in (60, 150, 250):
        row = [part[k : k + 1] for part in (MOTION.t, MOTION.q, MOTION.dq, MOTION.ddq)]
        found = model.effort_at(Instant(*row, 0.0, unlabelled().reshape(1), at(k), {}), theta)[0]
        np.testing.assert_allclose(found, whole[k], atol=1e-4 * np.abs(whole).max())


def test_coupled_motors():
    robot = load_robot("tx40")
    motion = smooth_motion(6, 1.0, 100.0)
    model = Model(robot, catalogue.make_terms(STANDARD, robot, motion))
    theta = random_parameters(model, rng=np.random.default_rng(0))
    found = np.array([model.effort_at(instant, theta)[0] for instant in instants(motion)])
    whole = model.effort(motion, theta)
    np.testing.assert_allclose(found, whole, atol=1e-9 * np.abs(whole).max())


def test_dynamics_conserve_what_they_should():
    """M symmetric; torque = M ddq + (C dq + g); and d/dt (M dq) = torque + drift, by a central difference."""
    model, theta = model_with()
    links = model.links(theta).ravel()
    at = [ROBOT.dynamics(instant, links) for instant in instants(MOTION)]
    k, step = 137, MOTION.t[1] - MOTION.t[0]
    np.testing.assert_allclose(at[k].mass, at[k].mass.T, atol=1e-12)
    np.testing.assert_allclose(at[k].torque, ROBOT.inverse_dynamics(MOTION[k : k + 1], links)[0], rtol=1e-12)
    momenta = [at[k + shift].mass @ MOTION.dq[k + shift] for shift in (-2, -1, 1, 2)]
    slope = (momenta[0] - 8.0 * momenta[1] + 8.0 * momenta[2] - momenta[3]) / (12.0 * step)
    np.testing.assert_allclose(slope, at[k].torque + at[k].drift, atol=1e-5 * np.abs(at[k].torque).max())
