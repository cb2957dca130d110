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
    """The error, one line with a remedy."""
    with pytest.raises(InputError) as caught:
        check(*arguments)
    assert "\n" not in str(caught.value)
    assert caught.value.remedy
    assert caught.value.on_command_line == f"{caught.value.where}: {caught.value.what}; {caught.value.remedy}"
    return caught.value


def test_a_good_log_passes_and_one_of_other_joints_or_without_motion_does_not():
    check_log(ROBOT, log_of())
    one_still = log_of()
    check_log(ROBOT, replace(one_still, q=one_still.q * np.array([1.0, 0.0])))
    for n in (1, 3):
        said = refused(check_log, ROBOT, log_of(n))
        assert said.where == "log.csv"
        assert f"{n} joints" in said.what
        assert "arm2 has 2" in said.what
    noise = 1e-4 * np.random.default_rng(0).uniform(size=log_of().q.shape)  # of encoders
    assert "no joint moves" in refused(check_log, ROBOT, replace(log_of(), q=0.3 + noise)).what


def test_a_log_of_less_than_four_seconds_is_too_short():
    """Rows at 100 Hz; a holdout is asked for as much."""
    check_log(ROBOT, part_of(log_of(), slice(0, 401)))
    short = part_of(log_of(), slice(0, 400))
    said = refused(check_log, ROBOT, short)
    assert "3.99 s" in said.what
    assert said.where == "part.csv"
    assert "at least 4 s" in said.remedy
    assert refused(check_holdout, ROBOT, log_of(seed=2), short).what == said.what


MOTION = smooth_motion(2, 4.0, RATE)
EFFORT = np.abs(3.0 * np.sin(np.arange(400) / 30.0)[:, None] * np.array([1.0, 2.0]) + np.array([0.5, -1.0]))


def test_a_model_that_explains_one_joint_is_the_robots_and_one_that_explains_none_is_another_ones():
    """The other joint's effort may be a hundred times too large."""
    check_same_robot(EFFORT, made_trial(MOTION, EFFORT), log_of())
    check_same_robot(EFFORT * np.array([1.0, 100.0]), made_trial(MOTION, EFFORT), log_of())
    check_same_robot(-EFFORT * np.array([1.0, 100.0]), made_trial(MOTION, EFFORT), log_of())
    assert (
        refused(check_same_robot, EFFORT * np.array([9.0, 100.0]), made_trial(MOTION, EFFORT), log_of()).where
        == "log.csv"
    )
    refused(check_same_robot, np.roll(EFFORT, 47, axis=0) + 3.0, made_trial(MOTION, EFFORT), log_of())


def test_samples_that_are_not_used_and_joints_with_few_are_not_asked():
    """Joint 1 would pass, but it hardly moves."""
    used = np.arange(400)[:, None] < np.array([150, 400])
    refused(check_same_robot, EFFORT * np.array([1.0, 100.0]), made_trial(MOTION, EFFORT, used), log_of())
    check_same_robot(EFFORT * np.array([100.0, 1.0]), made_trial(MOTION, EFFORT, used), log_of())
    used = np.repeat(np.arange(400)[:, None] < 300, 2, axis=1)
    check_same_robot(np.where(used, EFFORT, 1e3), made_trial(MOTION, EFFORT, used), log_of())


def test_two_hundred_samples_in_motion_are_enough():
    enough, few = (np.arange(400)[:, None] < np.array([count, 50]) for count in (200, 199))
    check_same_robot(EFFORT, made_trial(MOTION, EFFORT, enough), log_of())
    said = refused(check_same_robot, EFFORT, made_trial(MOTION, EFFORT, few), log_of())
    assert "199 samples in motion" in said.what
    assert "200" in said.remedy


def test_another_log_of_the_robot_may_be_held_out():
    check_holdout(ROBOT, log_of(), log_of(seed=2, source="later.csv"))
    check_holdout(ROBOT, log_of(), log_of(duration=9.0, seed=2))
    repeated = log_of()
    check_holdout(ROBOT, repeated, replace(repeated, q=repeated.q + 1e-6 * np.sin(np.arange(600))[:, None]))
    assert "3 joints" in refused(check_holdout, ROBOT, log_of(), log_of(3, source="later.csv")).what
    still = replace(log_of(source="later.csv"), q=np.zeros((600, 2)))
    assert refused(check_holdout, ROBOT, log_of(), still).where == "later.csv"


def test_the_log_itself_and_parts_of_it_score_nothing():
    """Louder and later it is the same motion; a part's first row may come before the motion begins."""
    log = log_of()
    louder = replace(log, effort=2.0 * log.effort, t=log.t + 5.0, source="copy.csv")
    said = refused(check_holdout, ROBOT, log, louder)
    assert said.where == "copy.csv"
    assert "same motion" in said.what
    assert "--holdout" in said.remedy
    whole = log_of(source="whole.csv")
    for rows in (slice(0, 200), slice(130, 400), slice(400, None)):
        part = part_of(whole, rows)
        assert refused(check_holdout, ROBOT, whole, part).where == "part.csv"
        assert refused(check_holdout, ROBOT, part, whole).where == "whole.csv"
    rested = np.concatenate([np.repeat(log.q[:1], 100, axis=0), log.q])
    whole = Log(np.arange(700) / RATE, rested, np.ones_like(rested), log.signed, source="whole.csv")
    refused(check_holdout, ROBOT, whole, part_of(whole, slice(95, 500)))
    refused(check_holdout, ROBOT, whole, part_of(whole, slice(5, 500)))
