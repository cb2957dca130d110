"""What makes a log unfit for a comparison, one line each."""

from __future__ import annotations

import numpy as np

from bayesid.arrays import Array
from bayesid.discrepancy.compare import ENCODER_RANGE, Trial
from bayesid.errors import InputError
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.identification.prediction import check_joints
from bayesid.log.log import Log
from bayesid.regression.selection.explanation import Thresholds
from bayesid.regression.selection.products import SHORTEST_LOG
from bayesid.robot import Robot

_PLACES = 20
"""Rows at most at which a part of a log is looked for: the row of fastest motion hardly ever stands twice."""


def check_log(robot: Robot, log: Log) -> None:
    """The log has the robot's joints, some of them move, and it lasts long enough to be held against itself.

    Raises:
        InputError: it has not, they do not, or it does not.
    """
    check_joints(robot, log)
    duration = float(log.t[-1] - log.t[0])
    if duration < SHORTEST_LOG:
        problem = f"lasts {duration:.3g} s: too short to tell what a model lacks from chance"
        remedy = f"record at least {SHORTEST_LOG:g} s: effects are judged by blocks of a second each, at least four"
        raise InputError(problem, log.source, remedy)
    if np.all(np.ptp(log.q, axis=0) < ENCODER_RANGE):
        raise InputError("no joint moves", log.source, "record a motion")


def check_unseen(earlier: IdentifiedModel, log: Log) -> None:
    """The model was not identified from the log.

    Raises:
        InputError: it was: what it lacks there, its own fit has bent it round.
    """
    if earlier.seen(log):
        problem = "is a log that the model was identified from: it cannot show what the model lacks"
        raise InputError(problem, log.source, "give another log of this robot, of another motion or load")


def check_same_robot(predicted: Array, trial: Trial, log: Log, thresholds: Thresholds = Thresholds()) -> None:
    """Enough samples in motion, and a model that is better than none.

    Raises:
        InputError: too few samples, or the model explains nothing in any joint.
    """
    count, least = trial.used.sum(axis=0), thresholds.min_samples
    if count.max() < least:
        problem = f"only {int(count.max())} samples in motion"
        raise InputError(problem, log.source, f"record at least {least} samples in which joints move")
    worse = []
    for j in np.flatnonzero(count >= least):
        used = trial.used[:, j]
        measured, modelled = trial.magnitude[used, j], np.abs(predicted[used, j])
        error = float(np.sqrt(np.mean((measured - modelled) ** 2)))
        worse.append(error > thresholds.another_robot * float(np.std(measured)))
    if all(worse):
        problem = "the model explains no joint's efforts better than a constant would"
        raise InputError(problem, log.source, "give a log of the robot that the model was identified from")


def check_holdout(robot: Robot, log: Log, holdout: Log) -> None:
    """The holdout is another log of the same robot.

    Raises:
        InputError: it is not.
    """
    check_log(robot, holdout)
    same = len(log) == len(holdout) and np.array_equal(log.q, holdout.q)
    if same or _contains(log.q, holdout.q) or _contains(holdout.q, log.q):
        problem = "holds the same motion as the log: it cannot score what the log has chosen"
        raise InputError(problem, holdout.source, "give `holdout` another log, or none: then stretches are held back")


def _contains(whole: Array, part: Array) -> bool:
    """Whether the rows of one log appear in another one."""
    if len(part) > len(whole):
        return False
    row = int(np.argmax(np.abs(np.diff(part, axis=0)).sum(axis=1)))  # in motion: a standstill has many equal rows
    places = np.flatnonzero(np.all(whole[row : row + len(whole) - len(part) + 1] == part[row], axis=1))
    return any(np.array_equal(whole[at : at + len(part)], part) for at in places[:_PLACES])
