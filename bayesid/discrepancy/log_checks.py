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
    """InputError unless a log has the robot's joints, some move, and it is long enough for cross-validation."""
    check_joints(robot, log.n_joints, log.source)
    duration = float(log.t[-1] - log.t[0])
    if duration < SHORTEST_LOG:
        problem = f"lasts {duration:.3g} s: too short for cross-validation"
        remedy = f"record at least {SHORTEST_LOG:g} s, which make four blocks of a second or more"
        raise InputError(problem, log.source, remedy)
    if np.all(np.ptp(log.q, axis=0) < TUNING.encoder_range):
        raise InputError("no joint moves", log.source, "record a motion")


def check_unseen(earlier: IdentifiedModel, log: Log) -> None:
    """InputError if the model was identified from the log: fitted parameters hide missing effects."""
    if earlier.seen(log):
        problem = "the model was identified from this log: fitted parameters hide missing effects"
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
        problem = "has the same motion as the log, so the test is not independent"
        raise InputError(problem, holdout.source, "give another log as `holdout`, or none to hold back blocks")


def _contains(whole: Array, part: Array) -> bool:
    if len(part) > len(whole):
        return False
    row = int(np.argmax(np.abs(np.diff(part, axis=0)).sum(axis=1)))  # in motion: a standstill has many equal rows
    places = np.flatnonzero(np.all(whole[row : row + len(whole) - len(part) + 1] == part[row], axis=1))
    return any(np.array_equal(whole[at : at + len(part)], part) for at in places)


# ---- Mixed-up columns ----
class _MixUp(NamedTuple):
    """Swapped or reversed columns of a log of n joints."""

    problem: str
    remedy: str
    positions: Integers  # (n,) column of each joint's position
    directions: Array  # (n,) 1, or -1 for a reversed position
    efforts: Integers  # (n,) column of each joint's effort


def check_columns(effort_of: Callable[[Motion], Array], trial: Trial, log: Log) -> None:
    """Tests whether the model, with effort (N, n) of a motion, explains the log only with swapped or reversed columns.

    Only if a joint has large errors; a mix-up is reported only if it corrects them.

    Raises:
        InputError: two joints, or their positions or efforts, are swapped, or a position is reversed.
    """
    rows = np.unique(np.linspace(0, len(trial.used) - 1, TUNING.mix_up_samples).astype(int))
    motion, n = trial.signals.motion[rows], trial.used.shape[1]

    def errors(mix_up: _MixUp) -> Array:
        """(n,) mean squared errors over the variance of the measured efforts; 0 for a joint that hardly moves."""
        measured, used = trial.magnitude[rows][:, mix_up.efforts], trial.used[rows][:, mix_up.positions]
        q, dq, ddq = (x[:, mix_up.positions] * mix_up.directions for x in (motion.q, motion.dq, motion.ddq))
        squares = (measured - np.abs(effort_of(replace(motion, q=q, dq=dq, ddq=ddq)))) ** 2
        ratio = np.zeros(n)
        for j in np.flatnonzero(used.any(axis=0)):
            ratio[j] = squares[used[:, j], j].mean() / max(float(measured[used[:, j], j].var()), np.finfo(float).tiny)
        return ratio

    as_is = errors(_MixUp("", "", np.arange(n), np.ones(n), np.arange(n)))
    if not (suspect := as_is > TUNING.suspect_error).any():
        return
    tried = [(errors(mix_up), mix_up) for mix_up in _mix_ups(n)]
    corrected, best = min(tried, key=lambda pair: float(pair[0].sum()))
    if corrected[suspect].sum() < TUNING.corrected_error * as_is[suspect].sum():
        raise InputError(f"{best.problem}: the model does not explain the log as given", log.source, best.remedy)


def _mix_ups(n: int) -> Iterator[_MixUp]:
    same, ones = np.arange(n), np.ones(n)
    for j in range(n):
        problem, directions = f"the positions of joint {j + 1} look reversed", np.where(same == j, -1.0, 1.0)
        yield _MixUp(problem, f"give `correct` q{j + 1}=-q{j + 1}", same, directions, same)
    for i, j in combinations(range(n), 2):
        swapped = same.copy()
        swapped[[i, j]] = j, i
        pair = f"joints {i + 1} and {j + 1}"
        q, tau = (f"{symbol}{i + 1}={symbol}{j + 1},{symbol}{j + 1}={symbol}{i + 1}" for symbol in ("q", "tau"))
        yield _MixUp(f"{pair} look swapped", f"give `correct` {q},{tau}", swapped, ones, swapped)
        yield _MixUp(f"the positions of {pair} look swapped", f"give `correct` {q}", swapped, ones, same)
        yield _MixUp(f"the efforts of {pair} look swapped", f"give `correct` {tau}", same, ones, swapped)
