"""The columns of a log as a file holds them."""

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
FRACTION = "rest"  # kind of the column of nanoseconds beside one of whole seconds
DIRECTION = "dir"  # kind of the columns that hold the directions of efforts beside their absolute values


@dataclass(frozen=True, kw_only=True)
class Options:
    """What a user may say about a file beside its path; None where nothing is said."""

    topic: str | None = None  #: the one to read, of several
    joints: Sequence[str] | None = None  #: names from base to tip
    robot_joints: Sequence[str] = ()  #: the same of the robot, which count where the source has them all
    n_joints: int = 0  #: of the robot; 0 where that is not known
    currents: bool = False  #: whether efforts without a unit are currents, A
    columns: Mapping[str, str] | None = None  #: what the log's columns are called, see `bayesid.log.formats.stated`
    motion: bool = False  #: whether the motion is all that is wanted: efforts are left out
    encoding: str | None = None  #: how efforts hold their sign, see `bayesid.log.formats.encodings`
    part: bool = False  #: whether the source is one of several of a run, so that it need not hold a whole log

    @property
    def velocities(self) -> bool:
        """Whether measured velocities are read: not where `columns` say dq=none."""
        return (self.columns or {}).get("dq", "").strip().casefold() != "none"

    @property
    def named(self) -> dict[str, str]:
        """The columns that have names; none of velocities where these are left out."""
        return {key: one for key, one in (self.columns or {}).items() if self.velocities or not key.startswith("dq")}


@dataclass(frozen=True)
class Column:
    """One column."""

    label: str  #: what the file calls it, for messages
    values: Array  #: (N,) as the file has them
    unit: float | None = None  #: how many SI units one of the file's is; None where the file does not say

    def si(self, unit: float) -> Array:
        """(N,) values in SI units, by a unit where the file does not say one."""
        return self.values * (unit if self.unit is None else self.unit)


@dataclass(frozen=True)
class SourceColumn:
    """A column of a file, at a place counted from 0, that a log needs under a name; label and unit as in `Column`."""

    name: str
    place: int
    label: str
    unit: float | None = None
    clock: bool = False  # whether it is a time written as one of day, or a date


class Chosen(NamedTuple):
    """The columns of a file that make a log, and what should be known of the choice, a sentence each."""

    columns: tuple[SourceColumn, ...]
    notes: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()  # as in `Table`


@dataclass(frozen=True)
class Table:
    """What a file holds of a log: a time, and columns for joints 1 to n without a gap; a part of a run any of these."""

    #: of t; q1..qn; tau1..taun (N m) or i1..in (A); dq1..dqn if velocities were measured; and part where the file
    #: holds several recordings, one after the other: the number of the one that a row is of
    columns: Mapping[str, Column]
    source: str  #: the file, for messages
    place: Callable[[int], str]  #: what a message calls a row, counted from 0
    notes: tuple[str, ...] = ()  #: what had to be assumed, a sentence each
    mended: tuple[str, ...] = ()  #: what was decoded or left out, a sentence each
    joints: tuple[str, ...] = ()  #: names from base to tip by which columns were chosen; none where they have none
    encoding: str | None = None  #: how efforts held their sign before they were decoded; None where they did not

    @property
    def t(self) -> Array:
        """(N,) time, s."""
        return self.columns["t"].si(1.0)

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return next(j for j in range(len(self.columns)) if f"q{j + 1}" not in self.columns)

    def block(self, kind: str, unit: float = 1.0) -> Array:
        """(N, n) the columns of a kind that is there, "q", "dq", "tau" or "i", by a unit where the file says none."""
        columns = (self.columns[f"{kind}{j + 1}"] for j in range(self.n_joints))
        return np.column_stack([column.si(unit) for column in columns])

    @property
    def starts(self) -> list[int]:
        """The first rows of the recordings that the file holds."""
        if "part" not in self.columns:
            return [0]
        return [0, *(np.flatnonzero(np.diff(self.columns["part"].values) != 0.0) + 1).tolist()]


def check(table: Table, given: Mapping[str, str] | None = None) -> Table:
    """The table itself, if its rows are enough, its numbers of this world and its time in order, or an InputError."""
    t = table.columns["t"]
    if len(t.values) < TUNING.fewest_rows:
        said = f"holds {len(t.values)} rows, too few to identify anything"
        raise InputError(said, table.source, f"record at least {TUNING.fewest_rows} rows, better thousands")
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
        said = f"time {'runs backwards' if step[k] < 0.0 else 'jumps'}, from {before:.12g} s to {after:.12g} s"
        raise InputError(said, table.place(k + 1), "sort or cut the log")
    if table.t[-1] == table.t[0]:
        raise InputError("time never advances", f"{table.source}, column {t.label}", "give the time of each row in s")
    return table


def with_fractions(table: Table) -> Table:
    """A table whose time is whole seconds and, in a column of its own, what is to be added to them."""
    if FRACTION not in table.columns:
        return table
    whole, rest = table.columns["t"], table.columns[FRACTION]
    columns = {name: one for name, one in table.columns.items() if name != FRACTION}
    columns["t"] = Column(f"{whole.label} + {rest.label}", whole.si(1.0) + rest.si(1e-9), 1.0)
    return replace(table, columns=columns)


def far_positions(table: Table) -> list[float]:
    """How far joints go, rad, that leave two turns; none unless these are more than half, and two at least.

    Only positions whose unit the file does not say are looked at.
    """
    positions = [column for name, column in table.columns.items() if name.startswith("q")]
    reach = [float(np.abs(column.values).max()) for column in positions if column.unit is None]
    far = [highest for highest in reach if highest > TUNING.few_turns]
    return far if len(far) > max(1, len(positions) // 2) else []


def _check_unit_of_time(table: Table, given: Mapping[str, str]) -> None:
    """A time whose unit is not stated is in s: its typical step shows whether it can be."""
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
    said = f"column {t.label} spans {t.values[-1] - t.values[0]:.6g} s with steps of {step:.6g} s"
    if not likely:
        raise InputError(f"{said}: no joint log is so slow", table.source, f"give {t.label} in s")
    word, unit = likely[0]
    stated = f"{t.label}[{unit}]"
    columns = ",".join(f'{key}="{pattern}"' for key, pattern in {**given, "t": stated}.items())
    remedy = f"name the column {stated}, or give `columns` {columns} ({t.label}[s] if it is in seconds)"
    if far := far_positions(table):
        remedy += f"; positions reach {max(far):.4g}: give `degrees=True` too, if they are degrees"
    if np.all(steps == 1.0):
        word, remedy = f"{word} or rows?", f'{remedy}; t="{t.label}[8ms]" if it counts rows of 8 ms'
    raise InputError(f"{said}: {word.removesuffix('?')}?", table.source, remedy)


def _check_resolution(table: Table) -> None:
    """A clock that stands still while the joints move is too coarse to say when each row was read."""
    t, positions = table.t, [column.values for name, column in table.columns.items() if name.startswith("q")]
    moved = np.any([q[1:] != q[:-1] for q in positions], axis=0)
    if np.mean(moved & (np.diff(t) == 0.0)) > TUNING.stands and np.ptp(t) > 0.0:
        label, rows = table.columns["t"].label, len(t)
        instants, counts = np.unique(t, return_counts=True)
        said = f"column {label} has {len(instants):,} instants in {rows:,} rows, while positions change between"
        period = f"{1e3 * np.median(np.diff(instants)) / counts.max():.4g}ms"
        remedy = "record the time with fractions of seconds"
        raise InputError(said, table.source, f"{remedy}, or give a column that counts rows, as {label}[{period}]")


def _check_numbers(table: Table) -> None:
    wrong: list[tuple[int, int, Column]] = []
    for name, column in table.columns.items():
        rows = np.flatnonzero(~(np.abs(column.values) < (np.inf if name == "t" else TUNING.absurd)))
        wrong += [(int(rows[0]), len(wrong), column)] if rows.size else []
    if wrong:
        row, _, column = min(wrong, key=lambda one: one[:2])
        said = f"column {column.label} holds {column.values[row]:g}"
        raise InputError(said, table.place(row), "remove the row or correct the value")


def seconds(nanoseconds: ArrayLike) -> Array:
    """Whole numbers (N,) in s, as exact as a float allows: it cannot hold the nanoseconds since 1970."""
    whole, rest = np.divmod(np.asarray(nanoseconds, dtype=np.int64), 1_000_000_000)
    return whole + rest / 1_000_000_000


def of_64_bits(readings: ArrayLike) -> Array:
    """Whole numbers (N,) without a sign, of which no float holds all 64 bits, as their two's complement.

    OverflowError or ValueError where they are none.
    """
    whole: Array = np.asarray(readings, dtype=np.uint64).view(np.int64).astype(float)
    return whole


def rows_of(source: str) -> Callable[[int], str]:
    """What messages call the rows of a file that has no lines."""
    return lambda row: f"{source}, row {row + 1}"


def distinct_rows(t: Array, readings: Sequence[Array]) -> Integers:
    """Rows that bring something new: a later time (N,), s, and a changed reading of some (N, k)."""
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
