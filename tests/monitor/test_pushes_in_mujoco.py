import runpy
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import bayesid

pytest.importorskip("mujoco")

CONTACT = SimpleNamespace(**runpy.run_path(str(Path(__file__).parents[2] / "docs" / "examples" / "contact.py")))
N = 6
PUSH = 0.2
"""Duration of a push, s."""
AFTER = PUSH + 0.2
"""Time after the start of a push in which contacts belong to it, s: the arm swings back within the motion's window."""


@pytest.fixture(scope="module")
def arm():
    return CONTACT.make_arm()


@pytest.fixture(scope="module")
def result(arm):
    return CONTACT.identify(arm)


def motion_of(seed):
    return bayesid.random_trajectory(N, 20.0, rng=seed)


def tracker_of(result):
    return bayesid.SignTracker(result, rate=CONTACT.RATE)


def largest(arm, trajectory):
    """(n,) largest efforts of a free run, N m."""
    return np.abs(arm.model.effort(trajectory.motion(np.arange(0.0, 20.0, 0.01)), arm.theta)).max(axis=0)


def test_the_example_finds_the_contact(arm, result):
    run = CONTACT.run_with_contact(arm)
    seen = CONTACT.track(tracker_of(result), run)
    threshold = np.array([now.threshold for now in seen])
    beyond = (np.abs(run.external) > threshold).any(axis=1)
    start = run.t[beyond][0]
    raised = [alarm.raised for now in seen for alarm in now.alarms]
    assert start <= raised[0] <= start + 0.06
    touched = run.t[run.external.any(axis=1)]
    assert abs(touched[0] - CONTACT.BEGIN) < 0.01
    assert "contact: detected at" in CONTACT.summary(run, seen)


@dataclass(frozen=True)
class Push:
    start: float
    joint: int  # from 0
    torque: float

    def owns(self, alarm):
        return self.start <= alarm.time <= self.start + AFTER


def random_pushes(efforts, seconds, seed):
    """Every 1.2 s with a random delay of up to 0.5 s; 15 to 40 % of a joint's largest effort."""
    rng = np.random.default_rng(seed)
    starts = np.arange(1.5, seconds - 1.0, 1.2)
    starts += rng.uniform(0.0, 0.5, len(starts))
    joints = rng.permutation(np.arange(len(starts)) % N)
    torques = rng.choice([-1.0, 1.0], len(starts)) * rng.uniform(0.15, 0.4, len(starts)) * efforts[joints]
    return [Push(*each) for each in zip(starts.tolist(), joints.tolist(), torques.tolist(), strict=True)]


def pushing(pushes):
    """The function that `record` calls at every step."""

    def disturb(t, data):
        data.qfrc_applied[:] = 0.0
        for push in pushes:
            if push.start <= t < push.start + PUSH:
                data.qfrc_applied[push.joint] = push.torque

    return disturb


def judged(arm, result, seconds, seed):
    """Pushes, the first contact of each or None, and contacts without a push."""
    other = motion_of(5 + seed)
    pushes = random_pushes(largest(arm, other), seconds, seed)
    tracker = tracker_of(result)
    CONTACT.track(tracker, CONTACT.record(arm, other, seconds, 2, pushing(pushes)))
    raised = [alarm for alarm in tracker.alarms if alarm.kind == "contact"]
    first = [next((alarm for alarm in raised if push.owns(alarm)), None) for push in pushes]
    return pushes, first, [alarm for alarm in raised if not any(push.owns(alarm) for push in pushes)]


def assert_found(pushes, first, false):
    found = [(push, alarm) for push, alarm in zip(pushes, first, strict=True) if alarm is not None]
    assert len(found) >= 0.95 * len(pushes)
    assert sum(alarm.joint == push.joint + 1 for push, alarm in found) >= 0.8 * len(found)  # a robot should reach 0.95
    assert np.median([alarm.raised - push.start for push, alarm in found]) <= 0.06
    assert len(false) <= 0.05 * len(pushes)


def test_pushes_are_found(arm, result):
    assert_found(*judged(arm, result, 24.0, 0))


@pytest.mark.long
@pytest.mark.parametrize(("seed", "motion"), [(2, 0), (3, 1)])
def test_pushes_of_minutes_are_found(seed, motion):
    arm = CONTACT.make_arm(seed)
    assert_found(*judged(arm, CONTACT.identify(arm), 60.0, motion))
