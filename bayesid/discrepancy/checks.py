"""What makes a log unfit for a comparison, each said in one line."""

from __future__ import annotations

import numpy as np

from bayesid.discrepancy.compare import Trial
from bayesid.errors import InputError
from bayesid.log import Log
from bayesid.motion import Array
from bayesid.robot import Robot

_LEAST_MOTION = 1e-3
"""rad; a joint that never leaves this range stands still but for its encoder's noise."""
_FEWEST = 200
"""Samples in motion of a joint that moves at all."""
_BELIEVED = 1.05
"""A model that is so much farther from the measured |effort| than a constant, in all joints, is another robot's."""


def check_log(robot: Robot, log: Log) -> None:
    """The log has the robot's joints, and some of them move.

    Raises:
        InputError: it has not, or they do not.
    """
    if robot.n_joints != log.n_joints:
        said = f"the log has {log.n_joints} joints, the model's robot {robot.name} has {robot.n_joints}"
        raise InputError(said, log.source, "give a log of the same robot")
    if np.all(np.ptp(log.q, axis=0) < _LEAST_MOTION):
        raise InputError("no joint moves", log.source, "record a motion")


def check_same_robot(predicted: Array, trial: Trial, log: Log) -> None:
    """Enough samples in motion, and a model that is better than none.

    Raises:
        InputError: too few samples, or the model explains nothing in any joint.
    """
    count = trial.used.sum(axis=0)
    if count.max() < _FEWEST:
        said = f"only {int(count.max())} samples in motion"
        raise InputError(said, log.source, f"record at least {_FEWEST} samples in which joints move")
    worse = []
    for j in np.flatnonzero(count >= _FEWEST):
        seen, told = trial.magnitude[trial.used[:, j], j], np.abs(predicted[trial.used[:, j], j])
        constant = float(np.std(seen))
        worse.append(float(np.sqrt(np.mean((seen - told) ** 2))) > _BELIEVED * constant)
    if all(worse):
        said = "the model explains no joint's efforts better than a constant would"
        raise InputError(said, log.source, "give a log of the robot that the model was identified from")


def check_holdout(robot: Robot, log: Log, holdout: Log) -> None:
    """The holdout is another log of the same robot.

    Raises:
        InputError: it is not.
    """
    check_log(robot, holdout)
    same = len(log) == len(holdout) and np.array_equal(log.q, holdout.q)
    if same or _contains(log.q, holdout.q) or _contains(holdout.q, log.q):
        said = "holds the same motion as the log: it cannot score what the log has chosen"
        raise InputError(said, holdout.source, "give --holdout another log, or none: then stretches are held back")


def _contains(whole: Array, part: Array) -> bool:
    """Whether the rows of one log appear in another one."""
    if len(part) > len(whole):
        return False
    row = int(np.argmax(np.abs(np.diff(part, axis=0)).sum(axis=1)))  # in motion: a standstill has many equal rows
    places = np.flatnonzero(np.all(whole[row : row + len(whole) - len(part) + 1] == part[row], axis=1))
    return any(np.array_equal(whole[at : at + len(part)], part) for at in places[:20])
