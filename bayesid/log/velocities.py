"""Positions against velocities of a table: wrong units, foreign velocities, wrapped angles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from bayesid.arrays import Array, Mask
from bayesid.errors import InputError
from bayesid.log.formats.table import DEGREE, distinct_rows
from bayesid.log.tuning import TUNING

_TURN = 2.0 * np.pi


def unwrapped(q: Array, turning: Sequence[int], starts: Sequence[int]) -> tuple[Array, dict[int, int]]:
    """Positions (N, n), rad, with jumps by whole turns removed, and the number of jumps of each wrapped joint.

    A joint is wrapped if it jumps by about a turn and is continuous otherwise. Recordings begin at `starts`.
    """
    counted: dict[int, int] = {}
    for j in turning:
        steps = np.diff(q[:, j])
        steps[np.array(starts[1:], dtype=int) - 1] = 0.0
        turns = np.rint(steps / _TURN)
        if not turns.any() or np.ptp(q[:, j]) > _TURN + TUNING.wrap_slack:
            continue
        remainder = np.abs(steps - _TURN * turns)
        usual = max(TUNING.wrap_steps * float(np.quantile(remainder, 0.99)), TUNING.encoder)
        turns[remainder > min(usual, TUNING.wrap_slack)] = 0.0
        if not turns.any():
            continue
        counted[j] = int(np.count_nonzero(turns))
        q = np.array(q) if len(counted) == 1 else q
        q[1:, j] -= _TURN * np.cumsum(turns)
    return q, counted


class LiveTurns:
    """Unwraps the positions of n joints row by row.

    A step of about a turn is a wrap if no joint moves so fast, or if the joint wrapped before.
    """

    def __init__(self, turning: Mask) -> None:
        self._turning, self._wrapped = turning, np.zeros(len(turning), dtype=bool)
        self._last, self._t, self._turns = np.full(len(turning), np.nan), -np.inf, np.zeros(len(turning))

    def unwrapped(self, t: float, q: Array) -> Array:
        """(n,) positions, rad, of a row at t, s; a late row does not change the state."""
        step = np.nan_to_num(q - self._last)
        turns = np.rint(step / _TURN) * (np.abs(step - _TURN * np.rint(step / _TURN)) < TUNING.wrap_slack)
        sure = self._wrapped | (np.abs(step) > TUNING.fastest * max(0.0, t - self._t))
        turns = np.where(self._turning & sure, self._turns - turns, self._turns)
        if t > self._t:
            self._wrapped |= turns != self._turns
            self._last, self._t, self._turns = np.where(np.isfinite(q), q, self._last), t, turns
        return q + _TURN * turns


def slow_rows(readings: Array, starts: Sequence[int]) -> tuple[Mask, float]:
    """(N,) rows with new readings (N, n), and the typical number of rows between them.

    Returns all rows and 1 if readings change in about every second row or more, or the robot only rests at times.
    """
    fresh = np.ones(len(readings), dtype=bool)
    fresh[1:] = (np.diff(readings, axis=0) != 0.0).any(axis=1)
    fresh[list(starts)] = True
    apart = np.diff(np.flatnonzero(fresh))
    every = float(np.median(apart)) if len(apart) else 1.0
    if every < TUNING.slow_rows or np.mean(np.abs(apart - every) <= 1.0) < TUNING.regular:
        return np.ones(len(readings), dtype=bool), 1.0
    return fresh, every


def derived(t: Array, q: Array) -> Array:
    """(N, n) velocities of positions (N, n) by cubic splines, rad/s; repeated rows are ignored."""
    rows = distinct_rows(t, [q])
    if len(rows) < 2:
        return np.zeros_like(q)
    velocity: Array = scipy.interpolate.CubicSpline(t[rows], q[rows])(t, 1)
    return velocity


def check_speeds(t: Array, q: Array, source: str) -> None:
    """InputError if more than half of the joints, and at least two, are faster than any robot."""
    span = _over_window(t)
    passes = span > 0.0
    speeds = (np.abs(_over_window(joint)[passes]) / span[passes] for joint in q.T)
    fast = np.array([np.quantile(speed, 0.9) > TUNING.fastest for speed in speeds])
    if fast.sum() > max(1, q.shape[1] // 2):
        remedy = "write the units of time and positions in the header, as in t[min] or q1[deg]"
        raise InputError(f"most joints are faster than {TUNING.fastest:g} rad/s", source, remedy)


def foreign_velocities(t: Array, q: Array, dq: Array, starts: Sequence[int], source: str) -> Mask:
    """(n,) moving joints whose velocities are not the derivative of their positions; recordings begin at `starts`.

    InputError if velocities are a multiple of it, or the position stays constant: units or positions are wrong.
    """
    foreign, width = np.zeros(q.shape[1], dtype=bool), min(TUNING.speed_window, len(t) - 1)
    cut = pauses(t)
    cut[np.array(starts[1:], dtype=int) - 1] = True
    cuts, steps = np.append(0, np.cumsum(cut)), np.where(cut, 0.0, np.diff(t))
    starting = np.flatnonzero(cuts[width:] == cuts[: len(cuts) - width])
    for j in range(q.shape[1]):
        most = TUNING.burst * float(np.quantile(np.abs(dq[:, j]), 0.98))
        speed = np.clip(dq[:, j], -most, most)
        turned = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * steps))
        change, velocity = (part[starting + width] - part[starting] for part in (q[:, j], turned))
        if not change.any() and (moved := float(np.ptp(turned))) > TUNING.stuck:
            what = f"the position of joint {j + 1} is constant, but its velocity integrates to {moved:.3g} rad"
            remedy = "check the encoder; if the joint does not move, ignore velocities with `columns` dq=none"
            raise InputError(what, source, remedy)
        if not change.any() or np.ptp(q[:, j]) <= TUNING.encoder:
            continue
        factor = _multiple(change, velocity)
        factor = _multiple(*_without_outliers(change, velocity)) if factor is None else factor
        if factor is None:
            foreign[j] = _is_smooth(q[:, j])
            continue
        if not 1.0 / TUNING.another_unit < factor < TUNING.another_unit:
            what = f"the velocity of joint {j + 1} is {factor:.3g} times the derivative of its position"
            remedy = "write the units of time, positions and velocities in the header, as in t[ms] or dq1[rpm]"
            if abs(factor * DEGREE - 1.0) < TUNING.named_unit:
                remedy = "if velocities are in degrees/s, name them dq1[deg/s] and so on"
            elif abs(factor / DEGREE - 1.0) < TUNING.named_unit:
                remedy = "if positions are in degrees, name them q1[deg] and so on"
            raise InputError(what, source, f"{remedy}, or ignore velocities with `columns` dq=none")
    return foreign


def _multiple(change: Array, velocity: Array) -> float | None:
    """Ratio of the integrated velocity to the change of position over windows; None if they do not correlate."""
    power, other, both = float(change @ change), float(velocity @ velocity), float(change @ velocity)
    alike = abs(both) >= TUNING.same_motion * np.sqrt(power * other)
    return both / power if alike and power * other > 0.0 else None


def _without_outliers(change: Array, velocity: Array) -> tuple[Array, Array]:
    """Windows in motion, without the share whose ratio is farthest from the median."""
    moved = [np.abs(values) > TUNING.weak * np.quantile(np.abs(values), 0.99) for values in (change, velocity)]
    change, velocity = (values[(moved[0] | moved[1]) & (change != 0.0)] for values in (change, velocity))
    if not len(change):
        return change, velocity
    off = np.abs(velocity - np.median(velocity / change) * change)
    kept = off <= np.quantile(off, 1.0 - TUNING.foreign_share)
    return change[kept], velocity[kept]


def pauses(t: Array) -> Mask:
    """(N - 1,) steps of a clock that are too long to interpolate."""
    steps = np.diff(t)
    if not (steps > 0.0).any():
        return np.zeros(len(steps), dtype=bool)
    long: Mask = steps > 2 * TUNING.held_periods * np.median(steps[steps > 0.0])
    return long


def _is_smooth(position: Array) -> bool:
    """Whether positions lie near the mean of their neighbours, so that their changes are not noise."""
    off = position[1:-1] - 0.5 * (position[:-2] + position[2:])
    return float(np.median(np.abs(off))) < TUNING.smooth * float(np.std(position))


def _over_window(values: Array) -> Array:
    window = min(TUNING.speed_window, len(values) - 1)
    change: Array = values[window:] - values[:-window]
    return change
