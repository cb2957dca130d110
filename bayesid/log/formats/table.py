"""The columns of a log as in its file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import pi
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from bayesid.arrays import Array, Integers
from bayesid.errors import InputError
from bayesid.log.tuning import TUNING

DEGREE = pi / 180.0  # rad
FRACTION = "fraction"  # kind of the column of nanoseconds beside one of whole seconds
DIRECTION = "dir"  # kind of the columns that hold the directions of efforts beside their absolute values


@dataclass(frozen=True, kw_only=True)
class Options:
    """Reading options besides the path; None if not given."""

    topic: str | None = None  #: the one to read, of several
    joints: Sequence[str] | None = None  #: names from base to tip
    robot_joints: Sequence[str] = ()  #: names of the robot's joints, used if the source has them all
    n_joints: int = 0  #: number of joints of the robot; 0 if unknown
    currents: bool = False  #: whether efforts without a unit are currents, A
    columns: Mapping[str, str] | None = None  #: names of the log's columns, see `bayesid.log.formats.stated`
    motion: bool = False  #: whether only the motion is read, without efforts
    encoding: str | None = None  #: how efforts hold their sign, see `bayesid.log.formats.encodings`
    part: bool = False  #: whether the source is one part of a run, which need not hold a whole log

    @property
    def velocities(self) -> bool:
        """Whether measured velocities are read: not if `columns` has dq=none."""
        return (self.columns or {}).get("dq", "").strip().casefold() != "none"

    @property
    def named(self) -> dict[str, str]:
        """The named columns; without velocities if these are not read."""
        names = self.columns or {}
        return {key: pattern for key, pattern in names.items() if self.velocities or not key.startswith("dq")}


@dataclass(frozen=True)
class Column:
    """One column."""

    label: str  #: name in the file, for messages
    values: Array  #: (N,) as the file has them
    unit: float | None = None  #: SI value of the file's unit; None if not stated

    def si(self, unit: float) -> Array:
        """(N,) values in SI units; `unit` applies if the file states none."""
        return self.values * (unit if self.unit is None else self.unit)


@dataclass(frozen=True)
class SourceColumn:
    """A column of a file, by index from 0, and its name in the log; label and unit as in `Column`."""

    name: str
    place: int
    label: str
    unit: float | None = None
    clock: bool = False  # whether it is a time of day or a date


class ReadingNote(UserWarning):
    """How a log was read, without doubt."""


class Chosen(NamedTuple):
    """The columns of a file that make a log, and notes about the choice, one sentence each."""

    columns: tuple[SourceColumn, ...]
    notes: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()  # as in `Table`


@dataclass(frozen=True)
class Table:
    """Columns of a log from a file: a time, and joints 1 to n without a gap; a part of a run may hold any of these."""

    #: t; q1..qn; tau1..taun (N m) or i1..in (A); dq1..dqn if velocities were measured; part, the number of a row's
    #: recording, if the file holds several
    columns: Mapping[str, Column]
    source: str  #: name of the file, for messages
    place: Callable[[int], str]  #: location of a row, counted from 0, for messages
    notes: tuple[str, ...] = ()  #: assumptions, one sentence each
    repairs: tuple[str, ...] = ()  #: what was decoded or left out, one sentence each
    joints: tuple[str, ...] = ()  #: joint names by which columns were chosen, from base to tip; may be empty
    encoding: str | None = None  #: how efforts held their sign before decoding, or None

    @property
    def t(self) -> Array:
        """(N,) time, s."""
        return self.columns["t"].si(1.0)

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return next(j for j in range(len(self.columns)) if f"q{j + 1}" not in self.columns)

    def block(self, kind: str, unit: float = 1.0) -> Array:
        """(N, n) columns of a kind, "q", "dq", "tau" or "i"; `unit` applies if the file states none."""
        columns = (self.columns[f"{kind}{j + 1}"] for j in range(self.n_joints))
        return np.column_stack([column.si(unit) for column in columns])

    @property
    def starts(self) -> list[int]:
        """First rows of the recordings in the file."""
        if "part" not in self.columns:
            return [0]
        return [0, *(np.flatnonzero(np.diff(self.columns["part"].values) != 0.0) + 1).tolist()]


def check(table: Table, given: Mapping[str, str] | None = None) -> Table:
    """The table itself if it has enough rows, plausible numbers and increasing times; else an InputError."""
    t = table.columns["t"]
    if len(t.values) < TUNING.fewest_rows:
        what = f"holds {len(t.values)} rows, too few to identify anything"
        raise InputError(what, table.source, f"record at least {TUNING.fewest_rows} rows, preferably thousands")
    _check_numbers(table)
    _check_resolution(table)
    _check_unit_of_time(table, given or {})
    with np.errstate(over="ignore"):
        step = np.diff(table.t)
    wrong = (step < 0.0) | (step > TUNING.longest_gap)
    wrong[np.array(table.starts[1:], dtype=int) - 1] = False
    if wrong.any():
        k = int(np.argmax(wrong))
        before, after = table.t[[k, k + 1]]
        what = f"time {'runs backwards' if step[k] < 0.0 else 'jumps'}, from {before:.12g} s to {after:.12g} s"
        raise InputError(what, table.place(k + 1), "sort or cut the log")
    if table.t[-1] == table.t[0]:
        raise InputError("time never advances", f"{table.source}, column {t.label}", "give the time of each row in s")
    return table


def with_fractions(table: Table) -> Table:
    """A table whose time column is joined with its fractions in another column."""
    if FRACTION not in table.columns:
        return table
    whole, fraction = table.columns["t"], table.columns[FRACTION]
    columns = {name: column for name, column in table.columns.items() if name != FRACTION}
    columns["t"] = Column(f"{whole.label} + {fraction.label}", whole.si(1.0) + fraction.si(1e-9), 1.0)
    return replace(table, columns=columns)


def far_positions(table: Table) -> list[float]:
    """Ranges, rad, of joints beyond two turns; empty unless these are more than half and at least two.

    Only positions without a stated unit are considered.
    """
    positions = [column for name, column in table.columns.items() if name.startswith("q")]
    reach = [float(np.abs(column.values).max()) for column in positions if column.unit is None]
    far = [highest for highest in reach if highest > TUNING.few_turns]
    return far if len(far) > max(1, len(positions) // 2) else []


def _check_unit_of_time(table: Table, given: Mapping[str, str]) -> None:
    """InputError if a time without a stated unit has steps that cannot be seconds."""
    t = table.columns["t"]
    with np.errstate(over="ignore"):
        steps = np.diff(t.values)
    if t.unit is not None or not np.any(steps > 0.0) or np.median(steps[steps > 0.0]) < TUNING.slowest_step:
        return
    if np.mean(steps < 0.0) > TUNING.unsorted:
        return
    step = float(np.median(steps[steps > 0.0]))
    parts = {"milliseconds": ("ms", 1e-3), "microseconds": ("us", 1e-6), "nanoseconds": ("ns", 1e-9)}
    likely = [(word, unit) for word, (unit, factor) in parts.items() if step * factor < TUNING.slowest_step]
    what = f"column {t.label} spans {t.values[-1] - t.values[0]:.6g} s with steps of {step:.6g} s"
    if not likely:
        raise InputError(f"{what}: too slow for a joint log in s", table.source, f"give {t.label} in s")
    word, unit = likely[0]
    stated = f"{t.label}[{unit}]"
    columns = ",".join(f'{key}="{pattern}"' for key, pattern in {**given, "t": stated}.items())
    remedy = f"name the column {stated}, or give `columns` {columns} ({t.label}[s] if it is in seconds)"
    if far := far_positions(table):
        remedy += (
            f"; positions reach {max(far):.4g}, so they may be degrees: give `degrees=True` too, or `degrees=False`"
        )
    if np.all(steps == 1.0):
        word, remedy = f"{word} or rows?", f'{remedy}; t="{t.label}[8ms]" if it counts rows of 8 ms'
    raise InputError(f"{what}: {word.removesuffix('?')}?", table.source, remedy)


def _check_resolution(table: Table) -> None:
    """InputError if the clock stands still while joints move."""
    t, positions = table.t, [column.values for name, column in table.columns.items() if name.startswith("q")]
    moved = np.any([q[1:] != q[:-1] for q in positions], axis=0)
    if np.mean(moved & (np.diff(t) == 0.0)) > TUNING.repeated_times and np.ptp(t) > 0.0:
        label, rows = table.columns["t"].label, len(t)
        instants, counts = np.unique(t, return_counts=True)
        what = f"column {label} has {len(instants):,} instants in {rows:,} rows, but positions change in between"
        period = f"{1e3 * np.median(np.diff(instants)) / counts.max():.4g}ms"
        remedy = "record the time with fractions of seconds"
        raise InputError(what, table.source, f"{remedy}, or give a column that counts rows, as {label}[{period}]")


def _check_numbers(table: Table) -> None:
    wrong: list[tuple[int, int, Column]] = []
    for name, column in table.columns.items():
        rows = np.flatnonzero(~(np.abs(column.values) < (np.inf if name == "t" else TUNING.largest_reading)))
        wrong += [(int(rows[0]), len(wrong), column)] if rows.size else []
    if wrong:
        row, _, column = min(wrong, key=lambda item: item[:2])
        what = f"column {column.label} holds {column.values[row]:g}"
        raise InputError(what, table.place(row), "remove the row or correct the value")


def seconds(nanoseconds: ArrayLike) -> Array:
    """Integers (N,), ns, in s, to float precision: a float cannot hold nanoseconds since 1970."""
    whole, remainder = np.divmod(np.asarray(nanoseconds, dtype=np.int64), 1_000_000_000)
    return whole + remainder / 1_000_000_000


def of_64_bits(readings: ArrayLike) -> Array:
    """Unsigned 64-bit integers (N,) as their two's complement; floats cannot hold all 64 bits.

    OverflowError or ValueError if they are not such integers.
    """
    whole: Array = np.asarray(readings, dtype=np.uint64).view(np.int64).astype(float)
    return whole


def rows_of(source: str) -> Callable[[int], str]:
    """Names rows of a file without lines, for messages."""
    return lambda row: f"{source}, row {row + 1}"


def distinct_rows(t: Array, readings: Sequence[Array]) -> Integers:
    """Rows with a later time (N,), s, and a changed reading of some (N, k)."""
    fresh = np.zeros(len(t), dtype=bool)
    fresh[:1] = True
    for column in (column for block in readings for column in block.T):
        fresh[1:] |= column[1:] != column[:-1]
    if fresh.all() and np.all(np.diff(t) > 0.0):
        return np.arange(len(t))
    typical = float(np.median(np.diff(t[fresh]))) if fresh.sum() > 2 else 0.0
    keep: list[int] = []
    for i in range(len(t)):
        later = not keep or t[i] > t[keep[-1]]
        if later and (fresh[i] or t[i] - t[keep[-1]] > TUNING.held_periods * typical):
            keep.append(i)
    return np.array(keep)
