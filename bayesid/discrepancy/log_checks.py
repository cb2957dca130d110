"""Checks of a log before a comparison, and detection of mixed-up columns with their correction."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.discrepancy.case import Trial
from bayesid.discrepancy.tuning import TUNING
from bayesid.errors import InputError
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.identification.tuning import TUNING as IDENTIFICATION
from bayesid.log.log import Log
from bayesid.motion import Motion
from bayesid.regression.selection.cross_validation import SHORTEST_LOG
from bayesid.robot import Robot, check_joints


def check_log(robot: Robot, log: Log) -> None:
    """InputError unless a log has the robot's joints, some of them move, and it is long enough to hold parts back."""
    check_joints(robot, log.n_joints, log.source)
    duration = float(log.t[-1] - log.t[0])
    if duration < SHORTEST_LOG:
        problem = f"lasts {duration:.3g} s: too short for cross-validation"
        remedy = f"record at least {SHORTEST_LOG:g} s, which make four blocks of a second or more"
        raise InputError(problem, log.source, remedy)
    if np.all(np.ptp(log.q, axis=0) < TUNING.encoder_range):
        raise InputError("no joint moves", log.source, "record a motion")


def check_unseen(earlier: IdentifiedModel, log: Log) -> None:
    """InputError if the model was identified from the log, whose residual hides what the model lacks."""
    if earlier.seen(log):
        problem = "the model was identified from this log, which cannot show what the model lacks"
        raise InputError(problem, log.source, "give another log of this robot, of another motion or load")


def check_same_robot(predicted: Array, trial: Trial, log: Log) -> None:
    """InputError if a log has too few samples in motion, or the model explains nothing in any joint."""
    count, least = trial.used.sum(axis=0), IDENTIFICATION.min_samples
    if count.max() < least:
        problem = f"only {int(count.max())} samples in motion"
        raise InputError(problem, log.source, f"record at least {least} samples in which joints move")
    worse = []
    for j in np.flatnonzero(count >= least):
        used = trial.used[:, j]
        measured, modelled = trial.magnitude[used, j], np.abs(predicted[used, j])
        error = float(np.sqrt(np.mean((measured - modelled) ** 2)))
        worse.append(error > TUNING.another_robot * float(np.std(measured)))
    if all(worse):
        problem = "the model explains no joint's efforts better than a constant"
        raise InputError(problem, log.source, "give a log of the robot that the model was identified from")


def check_holdout(robot: Robot, log: Log, holdout: Log) -> None:
    """InputError unless the holdout is another log of the same robot."""
    check_log(robot, holdout)
    same = len(log) == len(holdout) and np.array_equal(log.q, holdout.q)
    if same or _contains(log.q, holdout.q) or _contains(holdout.q, log.q):
        problem = "has the same motion as the log and is no independent test"
        raise InputError(
            problem, holdout.source, "give another log as `holdout`, or none: then stretches are held back"
        )


def _contains(whole: Array, part: Array) -> bool:
    if len(part) > len(whole):
        return False
    row = int(np.argmax(np.abs(np.diff(part, axis=0)).sum(axis=1)))  # in motion: a standstill has many equal rows
    places = np.flatnonzero(np.all(whole[row : row + len(whole) - len(part) + 1] == part[row], axis=1))
    return any(np.array_equal(whole[at : at + len(part)], part) for at in places)


# ---------------------------------------------------------------------------------------------------------------
# Columns that are mixed up
# ---------------------------------------------------------------------------------------------------------------
class _MixUp(NamedTuple):
    """What may have happened to the columns of a log of n joints."""

    said: str
    remedy: str
    positions: Integers  # (n,) which column holds the position of each joint
    sides: Array  # (n,) 1 or -1, by what it is multiplied
    efforts: Integers  # (n,) which column holds the effort of each joint


def check_columns(effort_of: Callable[[Motion], Array], trial: Trial, log: Log) -> None:
    """The log's columns belong to the joints that they name, as far as the model can tell.

    Only where the model, with the effort (N, n) in a motion, explains some joint badly are mix-ups tried; one is said
    if mending it mends these joints.

    Raises:
        InputError: two joints, or two columns of positions or efforts, are exchanged, or a position is reversed.
    """
    some = np.unique(np.linspace(0, len(trial.used) - 1, TUNING.mix_up_samples).astype(int))
    motion, n = trial.signals.motion[some], trial.used.shape[1]

    def errors(mix_up: _MixUp) -> Array:
        """(n,) mean squared, over what the measured efforts vary by; 0 of a joint that hardly moves."""
        measured, used = trial.magnitude[some][:, mix_up.efforts], trial.used[some][:, mix_up.positions]
        q, dq, ddq = (x[:, mix_up.positions] * mix_up.sides for x in (motion.q, motion.dq, motion.ddq))
        misses = (measured - np.abs(effort_of(replace(motion, q=q, dq=dq, ddq=ddq)))) ** 2
        ratio = np.zeros(n)
        for j in np.flatnonzero(used.any(axis=0)):
            ratio[j] = misses[used[:, j], j].mean() / max(float(measured[used[:, j], j].var()), np.finfo(float).tiny)
        return ratio

    as_is = errors(_MixUp("", "", np.arange(n), np.ones(n), np.arange(n)))
    if not (suspect := as_is > TUNING.suspect).any():
        return
    tried = [(errors(one), one) for one in _mix_ups(n)]
    left, best = min(tried, key=lambda pair: float(pair[0].sum()))
    if left[suspect].sum() < TUNING.mended * as_is[suspect].sum():
        raise InputError(f"{best.said}: the model does not explain the log as given", log.source, best.remedy)


def _mix_ups(n: int) -> Iterator[_MixUp]:
    own = np.arange(n)
    for j in range(n):
        sides = np.where(own == j, -1.0, 1.0)
        said = f"the positions of joint {j + 1} look reversed"
        yield _MixUp(said, f"give `correct` q{j + 1}=-q{j + 1}", own, sides, own)
    for i, j in combinations(range(n), 2):
        other, ones = own.copy(), np.ones(n)
        other[[i, j]] = j, i
        pair = f"joints {i + 1} and {j + 1}"
        q, tau = (f"{symbol}{i + 1}={symbol}{j + 1},{symbol}{j + 1}={symbol}{i + 1}" for symbol in ("q", "tau"))
        yield _MixUp(f"{pair} look swapped", f"give `correct` {q},{tau}", other, ones, other)
        yield _MixUp(f"the positions of {pair} look swapped", f"give `correct` {q}", other, ones, own)
        yield _MixUp(f"the efforts of {pair} look swapped", f"give `correct` {tau}", own, ones, other)
