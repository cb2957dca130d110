"""Effort and cost of effects: a made-up case with known errors, and a small model."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest import small_robot, smooth_motion
from made_trials import RATE, made_trial

from bayesid.discrepancy.case import Case, HeldBack
from bayesid.discrepancy.numbers import effort_of, effort_size
from bayesid.discrepancy.sets import costs
from bayesid.effects.drive import GainError, TorqueOffset
from bayesid.effects.friction import CoulombFriction
from bayesid.effects.model import Model
from bayesid.regression.knowledge import CoefficientPrior
from bayesid.regression.selection.columns import Columns
from bayesid.regression.selection.hypotheses import Hypothesis


class Acting:
    """An effect in some (0-based) joints."""

    def __init__(self, *joints):
        self.columns = SimpleNamespace(joints=set(joints))


def test_the_cost_is_the_error_without_an_effect_in_the_joint_with_the_largest_share():
    """Four rows of three joints, the last row not counted. RMS efforts 10, 2, 5; errors with all effects 1, 0.2, 3.

    Without the body the errors are 4, 1.2 and 3: 4 of 10 N m in the first joint is less than 1.2 of 2.
    Without the friction, which acts in the third joint alone, that has 5, and the second, where it does not act, 2.
    """
    used = np.repeat(np.arange(4)[:, None] < 3, 3, axis=1)
    signs = np.array([1.0, -1.0, 1.0, -1.0])[:, None]
    effort = np.where(used, np.array([10.0, 2.0, 5.0]), np.nan) * signs
    body, friction = Acting(0, 1, 2), Acting(2)

    def set_of(effects, errors):
        return SimpleNamespace(effects=effects, cross_validation=np.where(used, np.array(errors) * signs, 0.0))

    chosen = set_of((body, friction), (1.0, 0.2, 3.0))
    fewer = [set_of((friction,), (4.0, 1.2, 3.0)), set_of((body,), (1.0, 2.0, 5.0))]
    trial = made_trial(smooth_motion(3, 4 / RATE, RATE), effort, used, signed=True)
    sets = SimpleNamespace(case=SimpleNamespace(cross_validation=SimpleNamespace(trial=trial)), fewer=lambda _: fewer)
    found = costs(sets, chosen)
    for one, joint, numbers in zip(found, (2, 3), ((1.2, 0.2, 2.0, 0.6, 0.1), (5.0, 3.0, 5.0, 1.0, 0.6)), strict=True):
        assert one.joint == joint
        assert (one.before, one.after, one.effort, one.share_before, one.share_after) == pytest.approx(numbers)


FRICTION, OFFSET = CoulombFriction(smoothing=(0.1, 0.1)), TorqueOffset(joints=(2,))
MOTION = smooth_motion(2, 4.0, 100.0, seed=5)
USED = np.repeat(np.arange(len(MOTION))[:, None] >= 100, 2, axis=1)
READ = 3.0 * np.cos(np.arange(len(MOTION)) / 50.0)[:, None] * np.array([1.0, 4.0])
READ[7] = [-20.0, 30.0]  # in the log, not among the held-back samples
EARLIER = np.array([2.0, 5.0])


def hypothesis(source, changes=()):
    return Hypothesis(source, Columns({1: np.ones((1, 1))}, {}, np.ones(1), np.zeros(1, bool)), hypothesis, changes)


def case_of(rated=None, another_log=False):
    """A model of Coulomb friction alone, 2 and 5 N m; the second joint may have a rated effort."""
    robot = small_robot(2)
    object.__setattr__(robot.joints[1], "rated_effort", rated)
    knowledge = CoefficientPrior(Model(robot, (FRICTION,)), EARLIER, np.zeros((1, 1)))
    log = made_trial(MOTION, READ, USED, signed=True)
    cross_validation = HeldBack(made_trial(MOTION, READ * USED, USED, signed=True), "held back", another_log)
    return Case(knowledge, None, None, log, cross_validation, None)


def test_a_terms_effort_is_compared_with_the_rating_or_the_largest_effort_of_the_log():
    for rated, another_log, of, reference in (
        (None, True, "largest effort in this log", 30.0),
        (None, False, "largest effort in this log", 30.0),
        (56.0, True, "rated effort", 56.0),
    ):
        case = case_of(rated, another_log)
        extended = case.model.extend(OFFSET)
        found = effort_size(case, hypothesis(OFFSET), extended, np.array([2.0, 5.0, -1.4]))
        assert (found.joint, found.of, found.reference) == (2, of, reference)
        assert (found.rms, found.largest) == pytest.approx((1.4, 1.4))
        assert found.share == pytest.approx(1.4 / reference)


def test_the_effort_of_a_change_is_the_difference_of_the_change():
    """Coulomb friction of joint 2 from 5 to 8 N m: 3 N m tanh(u' / v), beside a change of joint 1."""
    case = case_of()
    changed = hypothesis(FRICTION.in_joints((2,), 2), changes=("Fc2",))
    found = effort_of(case, changed, case.model, np.array([2.6, 8.0]), MOTION)
    np.testing.assert_array_equal(found[:, 0], 0.0)
    np.testing.assert_allclose(found[:, 1], 3.0 * np.tanh(MOTION.dq[:, 1] / 0.1), atol=1e-12)


def test_the_effort_of_a_distortion_is_its_change_of_all_other_effects():
    """A gain of 1.3 in joint 2, of efforts of 5 N m tanh(u' / v) and an offset of 2 N m."""
    case, gain = case_of(), GainError(joints=(2,), gain=(1.3,))
    extended = case.model.extend(OFFSET).extend(gain)
    found = effort_of(case, hypothesis(gain), extended, np.array([2.0, 5.0, 2.0]), MOTION)
    np.testing.assert_array_equal(found[:, 0], 0.0)
    np.testing.assert_allclose(found[:, 1], 0.3 * (5.0 * np.tanh(MOTION.dq[:, 1] / 0.1) + 2.0), atol=1e-12)
