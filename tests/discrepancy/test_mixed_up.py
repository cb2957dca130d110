import numpy as np
import pytest
from conftest import smooth_motion
from made_trials import RATE, made_trial

from bayesid.discrepancy.log_checks import check_columns
from bayesid.errors import InputError
from bayesid.log.log import Log
from bayesid.motion import Motion

N = 3


def effort_of(motion):
    """Joints of different sizes, with gravity that is not symmetric in the position, and a coupling."""
    q, ddq = motion.q, motion.ddq
    return np.array([8.0, 3.0, 1.0]) * np.sin(q + np.array([0.4, 0.9, -0.7])) + 0.1 * ddq @ np.triu(np.ones((N, N)))


MOTION = smooth_motion(N, 20.0, RATE, seed=3)
EFFORT = np.abs(effort_of(MOTION) + 0.05 * np.random.default_rng(0).standard_normal((len(MOTION), N)))


def mixed(positions=(0, 1, 2), efforts=(0, 1, 2), sides=(1, 1, 1), model=effort_of):
    """The check of a log with such columns."""
    q, dq, ddq = (x[:, positions] * np.array(sides) for x in (MOTION.q, MOTION.dq, MOTION.ddq))
    motion, effort = Motion(MOTION.t, q, dq, ddq), EFFORT[:, efforts]
    log = Log(motion.t, q, effort, np.zeros(N, dtype=bool), source="log.csv")
    check_columns(model, made_trial(motion, effort), log)


def test_mixed_up_columns_are_reported_with_their_correction():
    for what, message, remedy in (
        ({"positions": [0, 2, 1], "efforts": [0, 2, 1]}, "joints 2 and 3", "`correct` q2=q3,q3=q2,tau2=tau3,tau3=tau2"),
        ({"positions": [1, 0, 2]}, "positions of joints 1 and 2", "`correct` q1=q2,q2=q1"),
        ({"efforts": [2, 1, 0]}, "efforts of joints 1 and 3", "`correct` tau1=tau3,tau3=tau1"),
        ({"sides": [1, -1, 1]}, "positions of joint 2", "`correct` q2=-q2"),
    ):
        with pytest.raises(InputError) as caught:
            mixed(**what)
        assert message in caught.value.what
        assert caught.value.where == "log.csv"
        assert remedy in caught.value.remedy
        assert "\n" not in str(caught.value)


def test_correct_columns_and_errors_that_no_exchange_corrects_pass():
    mixed()
    mixed(model=lambda motion: 5.0 * np.cos(3.0 * motion.q))  # another robot: for others to say
