"""Faulty readings: outliers, dropouts and frozen channels.

A channel is divided into runs of equal readings, so that a slowly updated channel is compared with its own updates. An
outlier is far from all its neighbours and returns at once. A lasting step is friction; a slow return is motion. A
dropout is an unusually long run of zeros or of the last reading while the joint moves, followed by a jump. All
thresholds are ratios within one channel, independent of units and rates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy

from bayesid.arrays import Array, Integers, Mask
from bayesid.log.tuning import TUNING
from bayesid.log.velocities import pauses
from bayesid.motion import STANDSTILL

_NO_ROWS = np.empty(0, dtype=np.int64)
_BEFORE = np.arange(2 * TUNING.neighbours + 1) < TUNING.neighbours
"""Which entries of a window of neighbours precede its centre."""


@dataclass(frozen=True)
class Fault:
    """A fault of one reading of one joint."""

    joint: int  #: 0-based; -1 for all joints
    reading: str  #: "position", "velocity" or "effort"; "row" for all of these
    kind: str  #: "outlier", "zero", "held", or "foreign": a velocity that is not the derivative of the position
    rows: Integers  #: (K,) faulty rows, ascending; empty if they were dropped
    start: Array  #: (M,) start of each stretch, s
    seconds: float  #: total duration, s

    def joined(self, later: Fault) -> Fault:
        """The fault together with the same fault of a later recording."""
        rows, start = np.concatenate([self.rows, later.rows]), np.concatenate([self.start, later.start])
        return replace(self, rows=rows, start=start, seconds=self.seconds + later.seconds)

    def __str__(self) -> str:
        when = ", ".join(f"{t:.3f}" for t in self.start[:3]) + (" ..." if len(self.start) > 3 else "")
        lasting = f"{self.seconds:.3g} s in all, from {when} s on"
        if self.reading == "row":
            how = "are zero" if self.kind == "zero" else "are frozen in motion"
            return f"all joints: all readings {how} for {lasting}; these rows are dropped"
        if self.kind == "foreign":
            what = f"velocity differs from the derivative of the position for {lasting}"
        elif self.kind == "outlier":
            count = f"{len(self.rows)} sample{'s' * (len(self.rows) > 1)}"
            what = f"{count} of the {self.reading} far from neighbouring samples, at {when} s"
        else:
            how = "reads exactly zero" if self.kind == "zero" else "is frozen"
            often = f"{len(self.start)} times, " if len(self.start) > 1 else ""
            what = f"{self.reading} {how} in motion, {often}{lasting}"
        return f"joint {self.joint + 1}: {what}; left out"


@dataclass(frozen=True)
class _Runs:
    """Runs of equal readings: values, first rows (last entry: number of rows) and durations, s."""

    value: Array
    first: Integers
    seconds: Array

    @classmethod
    def of(cls, t: Array, reading: Array) -> _Runs:
        first = np.concatenate([[0], np.flatnonzero(np.diff(reading)) + 1, [len(t)]])
        ends = np.append(t, t[-1] + np.median(np.diff(t)))
        return cls(reading[first[:-1]], first, np.diff(ends[first]))

    def rows(self, chosen: Mask) -> Integers:
        return np.flatnonzero(np.repeat(chosen, np.diff(self.first)))

    def repeated(self, chosen: Mask) -> Integers:
        """Rows of the chosen runs without the first row of each."""
        rows = self.rows(chosen)
        return rows[~np.isin(rows, self.first[:-1])]

    def long(self, period: float) -> Integers:
        """Runs long enough for a dropout and much longer than the others."""
        usual = float(np.quantile(self.seconds, 0.95)) if len(self.value) > 1 else period
        least = max(TUNING.dropout - 0.5 * period, TUNING.unusual * usual)
        return np.flatnonzero((self.seconds >= least) & (np.diff(self.first) >= TUNING.dropout_rows))


def find_faults(
    t: Array, q: Array, effort: Array, dq: Array | None = None, starts: Sequence[int] = (0,)
) -> tuple[Fault, ...]:
    """All faults of a log of N rows, by joint; recordings begin at `starts`; efforts may be absolute values."""
    found: dict[tuple[int, str, str], Fault] = {}
    for first, stop in pairwise([*starts, len(t)]):
        rows = slice(first, stop)
        if stop - first < 3:
            continue
        for fault in _of_recording(t[rows], q[rows], effort[rows], None if dq is None else dq[rows]):
            key, here = (fault.joint, fault.reading, fault.kind), replace(fault, rows=fault.rows + first)
            found[key] = found[key].joined(here) if key in found else here
    return tuple(sorted(found.values(), key=lambda fault: fault.joint))


def _of_recording(t: Array, q: Array, effort: Array, dq: Array | None) -> list[Fault]:
    faults: list[Fault] = []
    every = np.arange(len(t))
    for j in range(q.shape[1]):
        jumps = np.union1d(_jumps(t, q[:, j]), _excursions(t, q[:, j]))
        stopped = _stopped(t, without(t, q[:, j], ~np.isin(every, jumps)))
        faults += _named(t, j, "position", {"outlier": jumps, "held": stopped})
        known = ~np.isin(every, [*jumps, *stopped])
        position = without(t, q[:, j], known)
        speed = np.abs(np.gradient(position, t))
        if dq is not None:
            peaks = _peaks(t, dq[:, j])
            speeds = without(t, dq[:, j], ~np.isin(every, peaks), smooth=False)
            faults += _named(t, j, "velocity", {"outlier": peaks, "foreign": _foreign(t, position, speeds, known)})
            faults += _named(t, j, "velocity", _dropouts(t, speeds, speed))
        faults += _named(t, j, "effort", {"outlier": _peaks(t, effort[:, j]), **_dropouts(t, effort[:, j], speed)})
    return faults


def lost_rows(t: Array, q: Array, effort: Array, dq: Array | None = None) -> tuple[Integers, tuple[Fault, ...]]:
    """Rows of lost packets, and their faults: all zeros, or repeats of one row followed by a jump.

    A robot at rest repeats rows too, but it stops and starts slowly.
    """
    parts = [part for part in (q, effort, dq) if part is not None]
    zero = ~np.any([part.any(axis=1) for part in parts], axis=0)
    same = np.append(False, np.all([(part[1:] == part[:-1]).all(axis=1) for part in parts], axis=0))
    found = {"zero": _stretches(zero), "held": _stretches(same & ~zero)}
    first, stop = found["held"].T
    inner = np.minimum(stop, len(t) - 1)
    long = (t[inner] - t[first] >= TUNING.dropout) & (stop - first >= TUNING.dropout_rows)
    found["held"] = found["held"][long & (stop < len(t))]
    if not any(map(len, found.values())):
        return _NO_ROWS, ()
    steps, periods = np.abs(np.diff(q, axis=0)), np.diff(t)
    least = np.maximum(TUNING.outlier_steps * np.percentile(steps, 95, axis=0), TUNING.slight * np.ptp(q, axis=0))
    jumps = (steps > least).any(axis=1)
    beside = periods < 2.0 * np.median(periods)  # otherwise a pause or the start of another log
    rows, faults = [_NO_ROWS], []
    for kind, edges in found.items():
        ends = [((first - 1, stop - 1) if kind == "zero" else (stop - 1,)) for first, stop in edges]
        inside = [[k for k in both if 0 <= k < len(steps) and beside[k]] for both in ends]
        lost = [edge for edge, both in zip(edges, inside, strict=True) if both and jumps[both].all()]
        if lost:
            rows += [np.arange(first, stop) for first, stop in lost]
            seconds = sum(t[min(stop, len(t) - 1)] - t[first] for first, stop in lost)
            faults.append(Fault(-1, "row", kind, _NO_ROWS, t[[first for first, _ in lost]], float(seconds)))
    return np.sort(np.concatenate(rows)), tuple(faults)


def _stretches(chosen: Mask) -> Integers:
    """(K, 2) first row of each stretch, and the row after its last."""
    return np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]))).reshape(-1, 2)


def without(t: Array, reading: Array, known: Mask, smooth: bool = True) -> Array:
    """(N,) a channel with unknown readings interpolated: smoothly, or monotonically; the ends stay."""
    between = ~known & np.logical_or.accumulate(known) & np.logical_or.accumulate(known[::-1])[::-1]
    filled = np.array(reading)
    if between.any():
        bent = smooth and known.sum() > TUNING.neighbours
        spline = scipy.interpolate.CubicSpline if bent else scipy.interpolate.PchipInterpolator
        filled[between] = spline(t[known], reading[known])(t[between])
    return filled


def _named(t: Array, joint: int, reading: str, rows_of: dict[str, Integers]) -> list[Fault]:
    period, found = float(np.median(np.diff(t))), []
    for kind, rows in rows_of.items():
        if rows.size:
            start = t[rows[np.concatenate([[True], np.diff(rows) > 1])]]
            found.append(Fault(joint, reading, kind, rows, start, len(rows) * period))
    return found


# ---- Outliers ----
def _peaks(t: Array, reading: Array) -> Integers:
    """Rows of an effort or velocity many times larger than their neighbours."""
    runs = _Runs.of(t, reading)
    size = np.abs(runs.value)
    if len(size) <= 2 * TUNING.neighbours:
        return _NO_ROWS
    around = _ranked(size, _BEFORE | _BEFORE[::-1], 2 * TUNING.neighbours - 2)
    least = np.maximum(TUNING.outlier * around, around + TUNING.outlier_steps * _usual_step(runs.value))
    strong = size >= TUNING.weak * np.percentile(np.abs(reading), 99)
    return runs.rows((size > 0.0) & strong & (size >= least) & (runs.seconds < TUNING.dropout))


def _foreign(t: Array, position: Array, velocity: Array, known: Mask) -> Integers:
    """Rows whose velocity is far from the derivative of the position, in a channel where both usually agree.

    No comparison spans a pause of the clock or unknown positions.
    """
    span = TUNING.velocity_rows
    if len(t) <= 4 * span or not np.all(np.diff(t) > 0.0):
        return _NO_ROWS
    turned = np.append(0.0, np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(t)))
    off = np.abs((turned[span:] - turned[:-span]) - (position[span:] - position[:-span])) / (t[span:] - t[:-span])
    unsure = np.append(0, np.cumsum(~known | np.append(pauses(t), False)))
    off[unsure[span + 1 :] > unsure[: -span - 1]] = 0.0
    usual, top = float(np.quantile(off, 1.0 - TUNING.foreign_share)), float(np.percentile(np.abs(velocity), 99))
    least = max(TUNING.outlier * usual, TUNING.foreign * top)
    wrong = off > least
    if wrong.mean() > TUNING.foreign_share:
        return _NO_ROWS
    rows = np.zeros(len(t), dtype=bool)
    for k in np.flatnonzero(wrong):
        rows[k : k + span + 1] = True
    found = np.flatnonzero(rows)
    begins = np.flatnonzero(found != np.arange(len(found)))  # at the start of the log it is a filter's transient
    return found[begins[0] :] if len(begins) else _NO_ROWS


def _jumps(t: Array, position: Array) -> Integers:
    """Rows of a position that differ from the rows before and after by the same large step."""
    runs = _Runs.of(t, position)
    if len(runs.value) <= 2 * TUNING.neighbours:
        return _NO_ROWS
    middle = 0.5 * (TUNING.neighbours - 1)
    off = [runs.value - _ranked(runs.value, side, middle) for side in (_BEFORE, _BEFORE[::-1])]
    departs = np.where(off[0] * off[1] > 0.0, np.minimum(np.abs(off[0]), np.abs(off[1])), 0.0)
    least = np.maximum(_small_jump(position), TUNING.outlier_steps * _usual_step(runs.value))
    return runs.rows((departs > 0.0) & (departs >= least) & (runs.seconds < TUNING.dropout))


def _excursions(t: Array, position: Array) -> Integers:
    """Rows of a position that jumps away and soon jumps back to where it would have been."""
    runs = _Runs.of(t, position)
    if len(runs.value) <= 2 * TUNING.neighbours:
        return _NO_ROWS
    steps, usual = np.abs(np.diff(runs.value)), _usual_step(runs.value)
    usual, begin = np.maximum(usual[:-1], usual[1:]), t[runs.first[:-1]]
    least = np.maximum(_small_jump(position), TUNING.outlier_steps * usual)
    jumps = np.flatnonzero((steps > least) & ~pauses(begin))
    away, last = np.zeros(len(runs.value), dtype=bool), -1
    for before, after in ((k, m) for n, k in enumerate(jumps) for m in jumps[n + 1 :][: TUNING.neighbours]):
        gone = after - before
        back = abs(runs.value[after + 1] - runs.value[before]) <= TUNING.abrupt * (gone + 1) * usual[before]
        if before > last and back and begin[after + 1] - begin[before + 1] < TUNING.excursion:
            away[before + 1 : after + 1], last = True, after
    return runs.rows(away)


def _ranked(values: Array, chosen: Mask, rank: float) -> Array:
    """(R,) value of a rank, from 0, among the chosen values around each value; the ends are mirrored."""
    row, window = values[None], chosen[None]  # scipy 1.17 ignores the footprint for a vector
    ranks = sorted({int(np.floor(rank)), int(np.ceil(rank))})
    return np.mean([scipy.ndimage.rank_filter(row, k, footprint=window, mode="mirror")[0] for k in ranks], axis=0)


def _usual_step(values: Array) -> Array:
    """(R,) median step among the neighbours of each value, without the steps to and from it."""
    steps = np.abs(np.diff(np.pad(values, TUNING.neighbours, mode="reflect")))
    others = np.abs(np.arange(2 * TUNING.neighbours) - (TUNING.neighbours - 0.5)) > 1.0
    ranked = _ranked(steps, others, 0.5 * (2 * TUNING.neighbours - 3))
    return ranked[TUNING.neighbours :][: len(values)]


def _small_jump(position: Array) -> float:
    return TUNING.slight * float(np.ptp(np.percentile(position, [1, 99])))


# ---- Dropouts ----
def _stopped(t: Array, position: Array) -> Integers:
    """Rows of a position that is frozen and then catches up, or stops abruptly for good."""
    runs, period = _Runs.of(t, position), float(np.median(np.diff(t)))
    count, chosen = len(runs.value), np.zeros(len(runs.value), dtype=bool)
    if count <= 2 * TUNING.neighbours:
        return _NO_ROWS
    steps = np.abs(np.diff(runs.value))
    speed = np.abs(np.diff(position)) / np.diff(t)
    fast = TUNING.clearly_moving * float(np.percentile(speed, 95))
    for k in runs.long(period):
        if 0 < k < count - 1:
            sides = steps[max(0, k - 1 - TUNING.neighbours) : k - 1], steps[k + 1 : k + 1 + TUNING.neighbours]
            usual = max((float(np.median(side)) for side in sides if side.size), default=np.inf)
            chosen[k] = steps[k] > max(TUNING.abrupt * usual, _small_jump(position))
        else:
            moving = speed[: runs.first[k]] if k else speed[runs.first[1] - 1 :][::-1]
            least = max(fast, TUNING.abrupt * np.abs(np.diff(moving)).max())
            chosen[k] = np.median(moving[-TUNING.neighbours :]) > least
    return runs.repeated(chosen)


def _dropouts(t: Array, effort: Array, speed: Array) -> dict[str, Integers]:
    """Rows of an effort that is zero, and of one that is frozen, while the joint moves at speed (N,)."""
    runs, period = _Runs.of(t, effort), float(np.median(np.diff(t)))
    moving = speed > STANDSTILL * np.percentile(speed, 99)
    zero, held = (np.zeros(len(runs.value), dtype=bool) for _ in range(2))
    for k in runs.long(period):
        inside = speed[runs.first[k] : runs.first[k + 1]]
        seconds = moving[runs.first[k] : runs.first[k + 1]].mean() * runs.seconds[k]
        if seconds >= TUNING.dropout - 0.5 * period and np.ptp(inside) > TUNING.steady * inside.max():
            if runs.value[k] == 0.0:
                zero[k] = _drops_to_zero(runs.value, k)
            else:
                held[k] = len(runs.value) == 1 or effort.min() < runs.value[k] < effort.max()  # otherwise clipped
    return {"zero": runs.rows(zero), "held": runs.repeated(held) if len(runs.value) > 1 else runs.rows(held)}


def _drops_to_zero(values: Array, k: int) -> bool:
    """Whether readings fall abruptly to the zero of run k and rise as abruptly; a dead zone does not."""
    size = np.abs(values)
    if not size.any():
        return True
    before, after = size[max(0, k - TUNING.neighbours) : k], size[k + 1 : k + 1 + TUNING.neighbours]
    edges = np.concatenate([before[-1:], after[:1]])
    steps = np.abs(np.concatenate([np.diff(before), np.diff(after)]))
    step, blind = (float(np.median(steps)) if steps.size else 0.0), float(size[size > 0.0].min())
    return bool(edges.min() > max(TUNING.abrupt * step, TUNING.past_blind * blind))
