"""Effects without a name: learned, borne out, added and kept; refused where held-back data do not bear them out."""

import json

import numpy as np
import pytest
from conftest import small_robot, smooth_motion

import bayesid
from bayesid.log.log import Log
from bayesid.model.catalogue import make_terms
from bayesid.model.model import Model
from bayesid.motion import Motion
from bayesid.results.discrepancy_json import discrepancy_summary
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters

TERMS = ("rigid_body", "viscous_friction")


def arm_log(seed, extra=None):
    """An arm of three joints; `extra` adds to the effort of its second one."""
    robot, motion = small_robot(3, seed=2), smooth_motion(3, 20.0, 100.0, seed=seed)
    model = Model(robot, make_terms(TERMS, robot, motion))
    theta = random_parameters(model, np.random.default_rng(5))
    log = simulate(model, theta, motion, rng=np.random.default_rng(seed), noise=0.02, signed=True)
    effort = log.effort.copy()
    effort[:, 1] += 0.0 if extra is None else extra(motion)
    return Log(log.t, log.q, np.abs(effort), np.zeros(3, dtype=bool), source=f"log{seed}")


def magnets(motion):
    """Of the positions of joints 1 and 3, in joint 2."""
    return 6.0 * np.sin(2.0 * motion.q[:, 0] + 0.4) * np.cos(3.0 * motion.q[:, 2])


@pytest.fixture(scope="module")
def healthy():
    return bayesid.identify(small_robot(3, seed=2), arm_log(1), terms=TERMS, posterior=False)


@pytest.fixture(scope="module")
def found(healthy):
    return bayesid.find_discrepancy(healthy, arm_log(2, magnets), arm_log(3, magnets), posterior=False)


def test_a_hidden_function_is_learned(found):
    (effect,) = [one for one in found.added if one.effect == "learned_effect"]
    assert effect.joints == (2,)
    assert effect.variables == ("q1", "q3")
    assert "no part of friction" in effect.description.families
    assert effect.probability > 0.9
    assert found.status == "explained"
    assert found.before[1] > 3.0 * found.floor.rms[1]
    assert found.after[1] < 1.2 * found.floor.rms[1]
    assert all(score.hypothesis.effect != "learned_effect" for score in found.scores)  # no candidate by name
    assert all(effect != "learned_effect" for effect, _ in found.not_testable)


def test_it_is_the_function_that_was_hidden(found):
    """On a motion of its own, within the ranges of the log, but for an offset, which the model has none of."""
    (effect,) = [one for one in found.added if one.effect == "learned_effect"]
    ((term, amplitudes),) = [
        part for part in found.identification.model.parts(found.identification.theta) if part[0].name == effect.effect
    ]
    seen = found.trial.signals.motion.q
    rng, still = np.random.default_rng(4), np.zeros((200, 3))
    q = rng.uniform(np.quantile(seen, 0.1, axis=0), np.quantile(seen, 0.9, axis=0), (200, 3))
    motion = Motion(np.arange(200) / 100.0, q, still, still)
    learned = term.columns(found.identification.model.robot, motion)[:, 1] @ amplitudes
    truth = magnets(motion)
    assert np.sqrt(np.mean((learned - truth) ** 2)) < 0.05 * np.sqrt(np.mean(truth**2))


def test_its_band_holds_the_function(found):
    (effect,) = [one for one in found.added if one.effect == "learned_effect"]
    (curve,) = effect.hypothesis.curves
    assert (curve.variable, curve.other, curve.turning) == ("q1", "q3", "")
    inside = []
    for level, mean, sd in zip(curve.levels, curve.mean, curve.sd, strict=True):
        truth = 6.0 * np.sin(2.0 * curve.x + 0.4) * np.cos(3.0 * level)
        inside.append(np.abs(mean - truth) < 3.0 * sd + 0.02)
    assert np.mean(inside) > 0.9
    assert curve.mean.shape == curve.sd.shape == (len(curve.levels), len(curve.x))


def test_it_is_told_in_json_and_kept_in_the_model_file(found, tmp_path):
    (told,) = [one for one in discrepancy_summary(found)["found"] if one["effect"] == "learned_effect"]
    assert told["variables"] == ["q1", "q3"]
    assert told["formula"].endswith(" N m")
    assert "depends on the positions of joints 1 and 3" in told["description"]
    bayesid.save_discrepancy(found, tmp_path)
    assert json.loads((tmp_path / "discrepancy.json").read_text())["found"][0]["variables"] == ["q1", "q3"]
    stored, motion = bayesid.load_model(tmp_path), smooth_motion(3, 3.0, 50.0, seed=9)
    again = found.identification
    np.testing.assert_array_equal(stored.model.effort(motion, stored.theta), again.model.effort(motion, again.theta))
    assert told["formula"] in (tmp_path / "robot.urdf").read_text()
    assert "learned" in (tmp_path / "discrepancy.html").read_text()


def churning(motion):
    """Drag by the square of the speed of joint 2: no effect of the catalogue, and several of them together nearly."""
    return 3.0 * motion.dq[:, 1] * np.abs(motion.dq[:, 1])


@pytest.mark.long
def test_one_function_stands_in_the_place_of_several_effects(healthy):
    """Viscous friction less dry friction reaches the floor of a log, and is no friction that a model could have."""
    result = bayesid.find_discrepancy(healthy, arm_log(2, churning), arm_log(3, churning), posterior=False)
    ((effect,), floor) = result.added, result.floor.rms[1]
    assert (effect.effect, effect.joints, effect.variables) == ("learned_effect", (2,), ("dq2",))
    assert "dq2 |dq2|" in effect.description.formula
    assert result.after[1] < 1.1 * floor < result.before[1]


def test_what_only_the_log_shows_is_refused_and_said(healthy):
    result = bayesid.find_discrepancy(healthy, arm_log(2, magnets), arm_log(3), posterior=False)
    assert not result.added
    assert result.status == "unexplained"
    (refused,) = [one for one in result.refused if one.effect == "learned_effect"]
    assert refused.variables
    assert refused.formula
    (said,) = [one for one in discrepancy_summary(result)["not_borne_out"] if one["effect"] == "learned_effect"]
    assert said["variables"] == list(refused.variables)
