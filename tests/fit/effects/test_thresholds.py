"""Thresholds are what is passed, not what a module holds."""

from dataclasses import replace

import numpy as np
import pytest

from bayesid.discrepancy.compare import NoiseFloor, Trial, noise_floor
from bayesid.discrepancy.log_checks import check_same_robot
from bayesid.errors import InputError
from bayesid.fit.effects.columns import Columns
from bayesid.fit.effects.explanation import LN10
from bayesid.fit.effects.hypotheses import Hypothesis
from bayesid.fit.effects.scores import Score
from bayesid.fit.effects.thresholds import Thresholds
from bayesid.fit.noise import Noise
from bayesid.log.log import Log
from bayesid.log.signals import Signals
from bayesid.model.terms.joint_spring import JointSpring
from tests.conftest import smooth_motion

USUAL = Thresholds()


def made_trial(effort, used=None):
    motion = smooth_motion(effort.shape[1], len(effort) / 100.0, 100.0)
    every = np.ones(effort.shape, dtype=bool)
    signals = Signals(motion, effort, effort, np.zeros(effort.shape[1], bool), 100.0, 20.0, {}, every)
    return Trial(signals, motion, every if used is None else used)


def test_a_joint_is_explained_by_the_threshold_of_its_floor():
    floor = NoiseFloor(
        np.array([1.0, 2.0]), ("", ""), np.ones((2, 2)), np.array([True, False]), np.ones(2), np.zeros(2, dtype=bool)
    )
    gap = np.array([1.3, 3.1])
    assert floor.exceeded(gap, USUAL).tolist() == [True, False]
    assert floor.exceeded(gap, replace(USUAL, above_floor=1.4, above_blunt_floor=1.5)).tolist() == [False, True]


@pytest.mark.parametrize(
    ("gain", "improvement", "qualifies"), [(2.1, 0.06, True), (1.9, 0.06, False), (2.1, 0.04, False)]
)
def test_a_score_qualifies_by_certainty_and_size(gain, improvement, qualifies):
    columns = Columns({}, {}, np.zeros(0), np.zeros(0, dtype=bool))
    score = Score(Hypothesis(JointSpring(joints=(2,)), columns, None), gain * LN10, 9.0, improvement)
    assert score.qualifies(USUAL) == qualifies
    assert score.qualifies(Thresholds(log10_bayes_factor=1.8, improvement=0.03))
    assert not score.qualifies(Thresholds(log10_bayes_factor=2.2))
    assert not score.qualifies(Thresholds(improvement=0.07))


def test_an_earlier_model_is_good_by_its_share_of_the_effort():
    """A tenth of the effort in joint 1, three tenths in joint 2."""
    effort = np.abs(5.0 + np.random.default_rng(0).standard_normal((400, 2)))
    rms = np.sqrt(np.mean(effort**2, axis=0))
    earlier = Noise(np.array([0.1, 0.3]) * rms, np.full(2, 1e-9), np.full(2, 0.1), np.ones(2))
    for share, sharp in ((0.05, [False, False]), (0.2, [True, False]), (0.4, [True, True])):
        floor = noise_floor(made_trial(effort), 0.1 * effort, earlier, thresholds=Thresholds(good_fit=share))
        assert floor.sharp.tolist() == sharp


def test_samples_in_motion_are_as_many_as_the_thresholds_ask_for():
    effort = np.abs(3.0 * np.sin(np.arange(400) / 30.0)[:, None] * np.array([1.0, 2.0]) + np.array([0.5, -1.0]))
    trial = made_trial(effort, np.arange(400)[:, None] < np.array([150, 40]))
    log = Log(trial.signals.motion.t, trial.signals.motion.q, effort, np.zeros(2, bool))
    check_same_robot(effort, trial, log, Thresholds(min_samples=150))
    with pytest.raises(InputError, match="only 150 samples"):
        check_same_robot(effort, trial, log, Thresholds(min_samples=151))
