"""Repeatability of a robot: difference of the efforts of two recordings of the same motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.optimize

from bayesid.arrays import Array, Mask
from bayesid.discrepancy.case import make_trial, repetition_sd
from bayesid.discrepancy.tuning import TUNING
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.log.log import Log
from bayesid.log.signals import Signals, prepare
from bayesid.number_text import percent
from bayesid.robot import Robot, check_joints


@dataclass(frozen=True)
class Repeatability:
    """Differences of the filtered efforts of two recordings, at equal times of their motion."""

    difference: Array  #: (n,) RMS, N m; of |effort| where a sign is hidden; nan for a joint that does not move
    floor: Array  #: (n,) sd of one recording, N m: smallest RMS error of any model, :eq:`noise-floor`
    relative: Array  #: (n,) the floor as a share of the joint's RMS effort
    position: Array  #: (n,) RMS difference of the positions, as a share of the joint's range
    signed: Mask  #: (n,) whether both recordings know the sign
    shift: float  #: time of the second recording minus that of the first, s
    seconds: float  #: duration of the compared motion


def repeatability(robot: Robot, log: Log, other: Log) -> Repeatability:
    """Compares two recordings of the same motion; their clocks and rates may differ.

    Raises:
        InputError: a log is not of this robot, or the motions differ.
    """
    for recording in (log, other):
        check_joints(robot, recording.n_joints, recording.source)
    signed = log.signed & other.signed
    first, second = _prepared(_hiding(log, signed), _hiding(other, signed))
    span = np.ptp(first.motion.q, axis=0)
    moving = span > TUNING.encoder_range
    shift = _shift(first, second, span, moving)
    t, u = first.motion.t - first.motion.t[0] + shift, second.motion.t - second.motion.t[0]
    common = (t >= 0.0) & (t <= u[-1])
    trials = [make_trial(Model(robot, ()), signals) for signals in (first, second)]
    q, effort, used = (
        _at(t[common], u, part) for part in (second.motion.q, second.effort, trials[1].used.astype(float))
    )
    used = (used == 1.0) & trials[0].used[common]
    apart = np.sqrt(np.mean((q - first.motion.q[common]) ** 2, axis=0)) / np.where(moving, span, np.inf)
    if apart.max() > TUNING.same_motion:
        joint = int(apart.argmax())
        share = percent(apart[joint], 0)
        problem = f"positions of joint {joint + 1} differ from those of {log.source} by {share} of its range"
        raise InputError(problem, other.source, "give two recordings of the same motion")
    compared = used.any(axis=0)
    floor = np.where(compared, repetition_sd(first.effort[common], effort, used), np.nan)
    size = np.sqrt((first.effort[common] ** 2 * used).sum(axis=0) / np.maximum(used.sum(axis=0), 1))
    return Repeatability(
        difference=np.sqrt(2.0) * floor,
        floor=floor,
        relative=floor / np.where(compared & (size > 0.0), size, np.nan),
        position=apart,
        signed=signed,
        shift=shift + float(second.motion.t[0] - first.motion.t[0]),
        seconds=float(common.sum() / first.rate),
    )


def _hiding(log: Log, signed: Mask) -> Log:
    """The log without signs that the other one lacks."""
    return replace(log, effort=np.where(signed, log.effort, np.abs(log.effort)), signed=signed)


def _prepared(log: Log, other: Log) -> tuple[Signals, Signals]:
    """Both logs with the same low-pass."""
    first, second = prepare(log), prepare(other)
    if first.cutoff == second.cutoff:
        return first, second
    cutoff = min(first.cutoff, second.cutoff)
    return prepare(log, cutoff), prepare(other, cutoff)


def _shift(first: Signals, second: Signals, span: Array, moving: Mask) -> float:
    """Time shift of the second motion, s, by least squares of the positions; they overlap by half or more."""
    every = [max(1, len(signals.motion) // TUNING.aligned) for signals in (first, second)]
    (t, q), (u, p) = (
        (signals.motion.t[::k] - signals.motion.t[0], signals.motion.q[::k][:, moving] / span[moving])
        for signals, k in zip((first, second), every, strict=True)
    )
    least = 0.5 * min(t[-1], u[-1])

    def apart(shift: float) -> float:
        common = (t + shift >= 0.0) & (t + shift <= u[-1])
        return float(np.mean((_at(t[common] + shift, u, p) - q[common]) ** 2))

    shifts = np.arange(least - t[-1], u[-1] - least, t[1])
    near = min(shifts.tolist(), key=apart)
    bounds = (max(near - t[1], shifts[0]), min(near + t[1], u[-1] - least))
    return float(scipy.optimize.minimize_scalar(apart, bounds=bounds, method="bounded").x)


def _at(t: Array, u: Array, values: Array) -> Array:
    """(M, n) values (N, n) of times u (N,) interpolated at times t (M,)."""
    return np.stack([np.interp(t, u, column) for column in values.T], axis=1)
