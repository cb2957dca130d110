from dataclasses import replace

import numpy as np
import pytest
from conftest import small_robot, smooth_motion

from bayesid.discrepancy.compare import Trial
from bayesid.discrepancy.log_checks import check_holdout, check_log, check_same_robot
from bayesid.errors import InputError
from bayesid.log.log import Log
from bayesid.log.signals import Signals

RATE = 100.0
ROBOT = small_robot(2)


def log_of(n=2, duration=6.0, seed=1, source="log.csv"):
    motion = smooth_motion(n, duration, RATE, seed)
    return Log(motion.t, motion.q, np.abs(motion.ddq) + 1.0, np.zeros(n, bool), source=source)


def part_of(log, rows, source="part.csv"):
    return Log(log.t[rows], log.q[rows], log.effort[rows], log.signed, source=source)


def trial_of(effort, used=None):
    motion = smooth_motion(effort.shape[1], len(effort) / RATE, RATE)
    every = np.ones(effort.shape, dtype=bool)
    signals = Signals(motion, effort, effort, np.zeros(effort.shape[1], bool), RATE, 20.0, {}, every)
    return Trial(signals, motion, every if used is None else used)


def refused(check, *arguments):
    """The error, one line with a remedy."""
    with pytest.raises(InputError) as caught:
        check(*arguments)
    assert "\n" not in str(caught.value)
    assert caught.value.remedy
    assert caught.value.on_command_line == f"{caught.value.where}: {caught.value.what}; {caught.value.remedy}"
    return caught.value


# ---------------------------------------------------------------------------------------------------------------
# The log
# ---------------------------------------------------------------------------------------------------------------
def test_a_good_log_passes():
    check_log(ROBOT, log_of())
    one_still = log_of()
    check_log(ROBOT, replace(one_still, q=one_still.q * np.array([1.0, 0.0])))


@pytest.mark.parametrize("n", [1, 3])
def test_a_log_of_more_or_fewer_joints(n):
    said = refused(check_log, ROBOT, log_of(n))
    assert said.where == "log.csv"
    assert f"the log has {n} joints" in said.what
    assert "arm2 has 2" in said.what


@pytest.mark.parametrize(("rows", "passes"), [(400, False), (401, True)])
def test_a_log_of_less_than_four_seconds_is_too_short(rows, passes):
    """Rows at 100 Hz; a holdout is asked for as much."""
    log = part_of(log_of(), slice(0, rows))
    if passes:
        check_log(ROBOT, log)
        return
    said = refused(check_log, ROBOT, log)
    assert (said.what[:13], said.where) == ("lasts 3.99 s:", "part.csv")
    assert "at least 4 s" in said.remedy
    assert refused(check_holdout, ROBOT, log_of(seed=2), log).what == said.what


def test_a_log_in_which_nothing_moves():
    """But for the encoders' noise."""
    log = log_of()
    still = replace(log, q=0.3 + 1e-4 * np.random.default_rng(0).uniform(size=log.q.shape))
    said = refused(check_log, ROBOT, still)
    assert (said.what, said.where) == ("no joint moves", "log.csv")


# ---------------------------------------------------------------------------------------------------------------
# The robot
# ---------------------------------------------------------------------------------------------------------------
EFFORT = np.abs(3.0 * np.sin(np.arange(400) / 30.0)[:, None] * np.array([1.0, 2.0]) + np.array([0.5, -1.0]))


def test_a_model_that_explains_one_joint_is_the_robots():
    """The other joint's effort is a hundred times too large."""
    check_same_robot(EFFORT, trial_of(EFFORT), log_of())
    check_same_robot(EFFORT * np.array([1.0, 100.0]), trial_of(EFFORT), log_of())
    check_same_robot(-EFFORT * np.array([1.0, 100.0]), trial_of(EFFORT), log_of())


def test_a_model_that_explains_nothing_is_another_robots():
    said = refused(check_same_robot, EFFORT * np.array([9.0, 100.0]), trial_of(EFFORT), log_of())
    assert said.where == "log.csv"
    assert "no joint's efforts better than a constant" in said.what
    refused(check_same_robot, np.roll(EFFORT, 47, axis=0) + 3.0, trial_of(EFFORT), log_of())


def test_joints_with_few_samples_are_not_asked():
    """Joint 1 would pass, but it hardly moves."""
    used = np.arange(400)[:, None] < np.array([150, 400])
    refused(check_same_robot, EFFORT * np.array([1.0, 100.0]), trial_of(EFFORT, used), log_of())
    check_same_robot(EFFORT * np.array([100.0, 1.0]), trial_of(EFFORT, used), log_of())


def test_unused_samples_are_not_looked_at():
    used = np.repeat(np.arange(400)[:, None] < 300, 2, axis=1)
    check_same_robot(np.where(used, EFFORT, 1e3), trial_of(EFFORT, used), log_of())


@pytest.mark.parametrize(("count", "passes"), [(199, False), (200, True)])
def test_too_few_samples_in_motion(count, passes):
    used = np.arange(400)[:, None] < np.array([count, 50])
    if passes:
        check_same_robot(EFFORT, trial_of(EFFORT, used), log_of())
        return
    said = refused(check_same_robot, EFFORT, trial_of(EFFORT, used), log_of())
    assert "only 199 samples in motion" in said.what
    assert "200" in said.remedy


# ---------------------------------------------------------------------------------------------------------------
# The holdout
# ---------------------------------------------------------------------------------------------------------------
def test_another_log_may_be_held_out():
    check_holdout(ROBOT, log_of(), log_of(seed=2, source="later.csv"))
    check_holdout(ROBOT, log_of(), log_of(duration=9.0, seed=2))
    repeated = log_of()
    check_holdout(ROBOT, repeated, replace(repeated, q=repeated.q + 1e-6 * np.sin(np.arange(600))[:, None]))


def test_the_log_itself_scores_nothing():
    log = log_of()
    louder = replace(log, effort=2.0 * log.effort, t=log.t + 5.0, source="copy.csv")
    said = refused(check_holdout, ROBOT, log, louder)
    assert said.where == "copy.csv"
    assert "the same motion" in said.what
    assert "--holdout" in said.remedy


@pytest.mark.parametrize("rows", [slice(0, 200), slice(130, 400), slice(400, None)])
def test_a_part_of_the_log_scores_nothing_and_no_log_does_of_which_the_log_is_a_part(rows):
    whole = log_of(source="whole.csv")
    part = part_of(whole, rows)
    assert refused(check_holdout, ROBOT, whole, part).where == "part.csv"
    assert refused(check_holdout, ROBOT, part, whole).where == "whole.csv"


def test_a_part_is_found_behind_a_standstill():
    """Its first row comes a hundred times before the motion begins."""
    log = log_of()
    rested = np.concatenate([np.repeat(log.q[:1], 100, axis=0), log.q])
    t = np.arange(700) / RATE
    whole = Log(t, rested, np.ones_like(rested), log.signed, source="whole.csv")
    refused(check_holdout, ROBOT, whole, part_of(whole, slice(95, 500)))
    refused(check_holdout, ROBOT, whole, part_of(whole, slice(5, 500)))


def test_a_holdout_is_a_log_of_the_robot():
    said = refused(check_holdout, ROBOT, log_of(), log_of(3, source="later.csv"))
    assert "the log has 3 joints" in said.what
    still = replace(log_of(source="later.csv"), q=np.zeros((600, 2)))
    assert refused(check_holdout, ROBOT, log_of(), still).where == "later.csv"
