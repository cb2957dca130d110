import json

import numpy as np
import pytest
from conftest import small_robot
from made_trials import TERMS, arm_log

import bayesid
from bayesid.motion import Motion
from bayesid.report.discrepancy import discrepancy_summary


def magnets(motion):
    """A torque in joint 2 that depends on the positions of joints 1 and 3."""
    torque = 6.0 * np.sin(2.0 * motion.q[:, 0] + 0.4) * np.cos(3.0 * motion.q[:, 2])
    return torque[:, None] * [0.0, 1.0, 0.0]


@pytest.fixture(scope="module")
def healthy():
    return bayesid.identify(small_robot(3, seed=2), arm_log(1, duration=20.0), terms=TERMS, posterior=False)


@pytest.fixture(scope="module")
def found(healthy):
    logs = (arm_log(seed, magnets, 20.0) for seed in (2, 3))
    return bayesid.find_discrepancy(healthy, *logs, posterior=False)


def test_a_hidden_function_is_learned(found):
    (effect,) = [one for one in found.added if one.effect == "learned_effect"]
    assert effect.joints == (2,)
    assert effect.variables == ("q1", "q3")
    assert "not a friction effect" in effect.description.families
    assert effect.probability > 0.9
    assert found.status == "explained"
    assert found.before[1] > 3.0 * found.floor.rms[1]
    assert found.after[1] < 1.2 * found.floor.rms[1]


def test_it_is_the_function_that_was_hidden(found):
    """On another motion, within the ranges of the log, except for an offset, which the model lacks."""
    (effect,) = [one for one in found.added if one.effect == "learned_effect"]
    ((term, amplitudes),) = [
        part for part in found.identification.model.parts(found.identification.theta) if part[0].name == effect.effect
    ]
    seen = found.trial.signals.motion.q
    rng, still = np.random.default_rng(4), np.zeros((200, 3))
    q = rng.uniform(np.quantile(seen, 0.1, axis=0), np.quantile(seen, 0.9, axis=0), (200, 3))
    motion = Motion(np.arange(200) / 100.0, q, still, still)
    learned = term.columns(found.identification.model.robot, motion)[:, 1] @ amplitudes
    truth = magnets(motion)[:, 1]
    assert np.sqrt(np.mean((learned - truth) ** 2)) < 0.05 * np.sqrt(np.mean(truth**2))


def test_it_is_kept_with_the_model_and_drawn_on_the_page(found, tmp_path):
    folder = bayesid.save(found, tmp_path / "found")
    motion = found.trial.signals.motion
    kept = bayesid.load(folder)
    assert np.allclose(kept.predict(motion).mean, found.identification.predict(motion).mean, rtol=1e-9)
    (saved,) = [one for one in json.loads((folder / "discrepancy.json").read_text())["found"] if one["variables"]]
    assert saved["effect"] == "learned_effect"
    assert saved["formula"]
    assert "learned" in (folder / "report.html").read_text()


@pytest.mark.long
def test_an_effect_of_the_log_alone_is_refused_and_reported(healthy):
    result = bayesid.find_discrepancy(healthy, arm_log(2, magnets, 20.0), arm_log(3, duration=20.0), posterior=False)
    assert not result.added
    assert result.status == "unexplained"
    (refused,) = [one for one in result.refused if one.effect == "learned_effect"]
    (saved,) = [one for one in discrepancy_summary(result)["not_borne_out"] if one["effect"] == "learned_effect"]
    assert saved["variables"] == list(refused.variables)
