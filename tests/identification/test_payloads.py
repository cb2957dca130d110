"""Logs with and without payloads in one identification.

The truth is made without any of the code for payloads: a second robot, whose last link holds the payload too.
"""

from dataclasses import replace

import numpy as np
import pytest
from conftest import small_robot
from oracles import assert_close

import bayesid
from bayesid.effects.bodies import CarriedPayload
from bayesid.effects.catalogue import make_effect, make_terms
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.identification.model_file import load
from bayesid.log.log import join_logs
from bayesid.report.folders import save_identification
from bayesid.robot.inertia import NAMES
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

TERMS = ["rigid_body", "viscous_friction", "coulomb_friction"]
ROBOT = small_robot(4)
T = np.arange(1201) / 100.0
MASS, CENTRE = 2.0, np.array([0.05, -0.08, 0.12])
ABOUT_CENTRE = np.array([[0.02, 0.003, -0.002], [0.003, 0.03, 0.004], [-0.002, 0.004, 0.015]])
NOISE = 0.03


def ten(mass, centre, about_centre):
    """(10,) by Steiner's theorem."""
    inertia = about_centre + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return np.array([*inertia[np.triu_indices(3)], *(mass * centre), mass])


TOOL = ten(MASS, CENTRE, ABOUT_CENTRE)
OTHER = ten(0.7, np.array([-0.1, 0.06, 0.02]), np.diag([0.004, 0.002, 0.003]))


class TwoRobots:
    """A robot, and the same one whose last link is heavier by what it holds."""

    def __init__(self, carried):
        motions = [random_trajectory(4, 12.0, rng=seed).motion(T) for seed in (1, 2, 3)]
        self.model = Model(ROBOT, make_terms(TERMS, ROBOT, motions[0]))
        self.theta = random_parameters(self.model, rng=np.random.default_rng(3))
        self.logs = []
        for k, (motion, extra) in enumerate(zip(motions, carried, strict=False)):
            theta = self.theta.copy()
            theta[30:40] += extra
            log = simulate(self.model, theta, motion, rng=np.random.default_rng(k), noise=NOISE)
            self.logs.append(replace(log, source=f"log{k}"))


@pytest.fixture(scope="module")
def two():
    return TwoRobots([np.zeros(10), TOOL])


def test_two_payloads_have_parameters_of_their_own():
    both = TwoRobots([np.zeros(10), TOOL, OTHER])
    log = join_logs([both.logs[0], both.logs[1].carrying("tool1"), both.logs[2].carrying("part_2")])
    found = bayesid.identify(ROBOT, log, TERMS, complete="off", posterior=False)
    assert found.model.payloads == ("part_2", "tool1")
    assert [parameter.name for parameter in found.model.parameters][-10:] == [f"{part}_tool1" for part in NAMES]
    truth = np.concatenate([both.theta, OTHER, TOOL])
    assert np.abs((found.fit.beta - found.coefficients.project(truth)) / found.fit.sd).max() < 5.0
    assert found.fit.sd[found.coefficients.names.index("m_tool1")] < 0.05 * MASS
    np.testing.assert_allclose(found.fit.theta[-4:-1] / found.fit.theta[-1], CENTRE, atol=0.02)
    assert found.fit.relative_residual.max() < 1.5 * NOISE


def test_a_stated_mass_that_the_log_contradicts_is_told(two):
    log = join_logs([two.logs[0], two.logs[1].carrying("tool1")])
    for stated, contradicts in ((MASS, False), (1.3 * MASS, True)):
        prior = bayesid.ParameterPrior(nominal={"m_tool1": (stated, 0.001)})
        found = bayesid.identify(ROBOT, log, TERMS, complete="off", posterior=False, prior=prior)
        assert any("m_tool1 was stated as" in warning for warning in found.warnings) == contradicts


@pytest.mark.parametrize(
    "effect", [make_effect("delay", {"lag": [0.02]}), make_effect("gear_ratio", {"joints": [2], "error": [0.05]})]
)
def test_a_motion_that_is_changed_carries_the_same(two, effect):
    """A delay and a wrong gear ratio make a motion of a motion; the labels go with it."""
    model = two.model.extend(CarriedPayload(label=("tool1",))).extend(effect)
    motion = replace(random_trajectory(4, 5.0, rng=9).motion(np.arange(500) / 100.0), payload="tool1")
    heavier = two.theta.copy()
    heavier[30:40] += TOOL
    expected = two.model.extend(effect).effort(motion, heavier)
    assert_close(model.effort(motion, np.append(two.theta, TOOL)), expected, 1e-12)


def test_model_file_brings_the_payload_back(tmp_path, two):
    log = join_logs([two.logs[0], two.logs[1].carrying("tool1")])
    found = bayesid.identify(ROBOT, log, TERMS, complete="off", posterior=False)
    save_identification(found, tmp_path / "result", report=False)
    stored = load(tmp_path / "result")
    assert stored.model.payloads == ("tool1",)
    assert [term.shape for term in stored.model.terms if term.payloads] == [{"label": ["tool1"]}]
    np.testing.assert_allclose(stored.theta, found.theta, rtol=1e-15)
    plain, loaded = two.logs
    good = stored.validate(loaded.carrying("tool1")).relative_residual
    assert good.max() < 1.5 * NOISE
    assert stored.validate(loaded).relative_residual.max() > 3.0 * NOISE  # that says nothing carries nothing
    assert stored.validate(plain).relative_residual.max() < 1.5 * NOISE
    assert stored.predict(loaded.carrying("tool1")).mean.shape == loaded.q.shape
    with pytest.raises(InputError, match=r"no payload 'tool2'.*tool1"):
        stored.predict(loaded.carrying("tool2"))
    text = (tmp_path / "result" / "model.toml").read_text()
    written = text.replace('[\n    "tool1",\n]', '["tool 1"]')
    assert written != text
    (tmp_path / "result" / "model.toml").write_text(written)
    with pytest.raises(InputError, match=r"model\.toml"):
        load(tmp_path / "result")


def test_labels_are_letters_digits_and_underscores(two):
    for label in ("", "tool 1", "größe", "a-b", "m.1", "x" * 41, None, 3):
        with pytest.raises(InputError, match="not a valid label"):
            two.logs[0].carrying(label)


def test_payloads_without_a_log_of_the_robot_alone_are_refused(two):
    log = join_logs([two.logs[0].carrying("a"), two.logs[1].carrying("b")])
    with pytest.raises(InputError, match=r"no log without a payload.*add a log without payload"):
        bayesid.identify(ROBOT, log, TERMS)
