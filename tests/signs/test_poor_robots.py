"""Robots of which the standard model is far from true, signs unknown."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import small_robot

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_effect, make_terms
from bayesid.effects.model import Model
from bayesid.identification.pipeline import identify
from bayesid.regression.least_squares import fit_signed
from bayesid.regression.log_data import LogData
from bayesid.regression.selection.detected import SignedLog
from bayesid.signs.proposals import PoorRobot
from bayesid.signs.search.certified import Certified
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

ROBOT = small_robot(3, 3)


def made(seed, change=lambda model, theta, size, speed: model):
    """A log whose signs are known, of a model that a function changes, and its parameters in place."""
    motion = random_trajectory(3, 10.0, rng=seed).motion(np.arange(501) / 50.0)
    model = Model(ROBOT, make_terms(STANDARD, ROBOT, motion))
    theta = random_parameters(model, rng=np.random.default_rng(seed))
    size, speed = (np.sqrt(np.mean(x**2, axis=0)) for x in (model.effort(motion, theta), motion.dq))
    model = change(model, theta, size, speed)
    return simulate(model, theta, motion, signed=True, rng=np.random.default_rng(7), noise=0.03), motion


def right_signs(log, **options):
    result = identify(ROBOT, log.rectified(), search=Certified(budget=3.0), posterior=False, **options)
    strong = np.abs(log.effort) > 0.05 * np.abs(log.effort).max(axis=0)
    right = result.sample_signs == np.sign(log.effort)
    return result, np.array([right[strong[:, j], j].mean() for j in range(3)])


def overcompensate(model, theta, size, speed):
    names = [parameter.name for parameter in model.parameters]
    for j, much in ((1, 1.5), (2, 1.1)):
        theta[names.index(f"Fv{j + 1}")] = -much * size[j] / speed[j]
        theta[names.index(f"Fc{j + 1}")] = 0.3 * size[j]
    return model


@pytest.mark.parametrize("seed", [0, 4])
def test_overcompensated_viscous_friction_is_detected(seed):
    """Under Fv >= 0 their signs are wrong and, with seed 0, proven: residuals of 17 % are not even poor."""
    log, _ = made(seed, overcompensate)
    _, before = right_signs(log, complete="off")
    assert before[1:].max() < 0.1
    result, right = right_signs(log)
    assert right.min() > 0.995
    assert {(e.effect, e.joints) for e in result.model_selection.effects} == {
        ("overcompensated_friction", (2,)),
        ("overcompensated_friction", (3,)),
    }
    names = [parameter.name for parameter in result.model.parameters]
    assert all(result.theta[names.index(name)] < 0.0 for name in ("Fv2", "Fv3"))
    assert result.theta[names.index("Fv1")] >= 0.0


def test_a_drive_without_feedforward_keeps_its_bound():
    result, right = right_signs(made(0)[0])
    assert right.min() > 0.995
    assert not any(e.effect == "overcompensated_friction" for e in result.model_selection.effects)


@pytest.mark.parametrize("seed", [0, 5])
def test_friction_determines_signs_of_a_poorly_explained_joint(seed):
    """A wrist of which the sensor shows bursts of friction alone, the rest as zero."""
    log, motion = made(seed)
    speed, rng = motion.dq[:, 2], np.random.default_rng(3)
    moving = np.abs(speed) > 0.3 * np.sqrt(np.mean(speed**2))
    burst = np.sign(speed) * (0.5 + 0.9 * rng.exponential(1.0, len(speed)) * moving)
    effort = log.effort.copy()
    effort[:, 2] = np.where(np.abs(burst) < 2.2, 0.0, burst) * np.sqrt(np.mean(effort[:, 2] ** 2))
    result, right = right_signs(replace(log, effort=effort), complete="off")
    assert right.min() > 0.95
    assert not result.search.certified
    confident = np.maximum(result.probability, 1.0 - result.probability)[:, 2]
    assert confident.max() < 0.99, "a guess is none that is sure"


def test_a_tilted_base_is_proposed_while_signs_are_wrong():
    """Two thirds of the third joint's signs are wrong: the tilt shows by the signs that it would have itself."""
    tilt = make_effect("base_tilt", {"angle": [0.1, -0.15]})
    log, motion = made(1, lambda model, *_: model.extend(tilt))
    result, right = right_signs(log)
    assert right.min() > 0.995
    (found,) = [e for e in result.model_selection.effects if e.effect == "base_tilt"]
    np.testing.assert_allclose(found.source.angle, tilt.angle, atol=0.02)
    plain, _ = right_signs(log, complete="off")
    log_data = LogData.of(plain.model, plain.signals, plain.segments.per_sample(plain.segments.moving, 501, 3) > 0)
    wrong = np.where(np.arange(501) % 150 < 100, -1.0, 1.0)
    probability = plain.probability.copy()
    probability[:, 2] = np.where(wrong > 0.0, probability[:, 2], 1.0 - probability[:, 2])
    poor = SignedLog.of(log_data, fit_signed(log_data, 2.0 * probability - 1.0), probability)
    (proposal,) = PoorRobot(poor, plain.segments, np.array([False, False, True])).propose()
    assert [effect.effect for effect in proposal.effects] == ["base_tilt"]
    strong = (np.abs(log.effort) > 0.1 * np.abs(log.effort).max(axis=0)) & (proposal.signs != 0.0)
    assert np.mean((proposal.signs == np.sign(log.effort))[strong]) > 0.97
