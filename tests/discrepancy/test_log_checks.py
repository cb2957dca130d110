from dataclasses import replace

import numpy as np
import pytest
from conftest import small_robot, smooth_motion
from made_trials import RATE, made_trial

from bayesid.discrepancy.log_checks import check_holdout, check_log, check_same_robot
from bayesid.errors import InputError
from bayesid.log.log import Log

ROBOT = small_robot(2)


def log_of(n=2, duration=6.0, seed=1, source="log.csv"):
    motion = smooth_motion(n, duration, RATE, seed)
    return Log(motion.t, motion.q, np.abs(motion.ddq) + 1.0, np.zeros(n, bool), source=source)


def part_of(log, rows, source="part.csv"):
    return Log(log.t[rows], log.q[rows], log.effort[rows], log.signed, source=source)


def refused(check, *arguments):
    with pytest.raises(InputError) as caught:
        check(*arguments)
    assert "\n" not in str(caught.value)
    assert caught.value.remedy
    return caught.value


def test_logs_of_other_joints_without_motion_or_of_less_than_four_seconds_are_refused():
    log = log_of()
    check_log(ROBOT, replace(log, q=log.q * np.array([1.0, 0.0])))
    check_log(ROBOT, part_of(log, slice(0, 401)))
    for n in (1, 3):
        assert f"{n} joints" in refused(check_log, ROBOT, log_of(n)).what
    noise = 1e-4 * np.random.default_rng(0).uniform(size=log.q.shape)  # of encoders
    assert "no joint moves" in refused(check_log, ROBOT, replace(log, q=0.3 + noise)).what
    short = part_of(log, slice(0, 400))
    error = refused(check_log, ROBOT, short)
    assert (error.where, "3.99 s" in error.what) == ("part.csv", True)
    assert refused(check_holdout, ROBOT, log_of(seed=2), short).what == error.what


MOTION = smooth_motion(2, 4.0, RATE)
EFFORT = np.abs(3.0 * np.sin(np.arange(400) / 30.0)[:, None] * np.array([1.0, 2.0]) + np.array([0.5, -1.0]))


def test_a_model_that_explains_no_joint_in_motion_is_of_another_robot():
    """One joint is enough, even if the effort of the other is 100 times too large; slow joints do not count."""

    def check(effort, used=None):
        check_same_robot(effort, made_trial(MOTION, EFFORT, used), log_of())

    one, other = EFFORT * np.array([1.0, 100.0]), EFFORT * np.array([100.0, 1.0])
    for effort in (EFFORT, one, -one):
        check(effort)
    refused(check, EFFORT * np.array([9.0, 100.0]))
    refused(check, np.roll(EFFORT, 47, axis=0) + 3.0)
    rows = np.arange(400)[:, None]
    first_rests, few, enough = (rows < np.array(counts) for counts in ((150, 400), (199, 50), (200, 50)))
    refused(check, one, first_rests)
    check(other, first_rests)
    used = np.repeat(rows < 300, 2, axis=1)
    check(np.where(used, EFFORT, 1e3), used)
    check(EFFORT, enough)
    assert "199 samples in motion" in refused(check, EFFORT, few).what


def test_a_holdout_is_another_log_and_not_the_log_or_a_part_of_it():
    """Scaled efforts and shifted times are the same motion; a part may begin at a standstill."""
    log, whole = log_of(), log_of(source="whole.csv")
    check_holdout(ROBOT, log, log_of(duration=9.0, seed=2))
    check_holdout(ROBOT, log, replace(log, q=log.q + 1e-6 * np.sin(np.arange(600))[:, None]))  # repeated
    louder = replace(log, effort=2.0 * log.effort, t=log.t + 5.0, source="copy.csv")
    error = refused(check_holdout, ROBOT, log, louder)
    assert error.where == "copy.csv"
    assert "same motion" in error.what
    for rows in (slice(0, 200), slice(130, 400), slice(400, None)):
        part = part_of(whole, rows)
        assert refused(check_holdout, ROBOT, whole, part).where == "part.csv"
        assert refused(check_holdout, ROBOT, part, whole).where == "whole.csv"
    rested = np.concatenate([np.repeat(log.q[:1], 100, axis=0), log.q])
    whole = Log(np.arange(700) / RATE, rested, np.ones_like(rested), log.signed, source="whole.csv")
    for first in (95, 5):
        refused(check_holdout, ROBOT, whole, part_of(whole, slice(first, 500)))
