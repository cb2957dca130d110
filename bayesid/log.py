"""Logs: what a controller recorded, checked once on the way in.

A CSV holds the header `t,q1..qn[,dq1..dqn],tau1..taun` (s, rad, rad/s, N m), or currents `i1..in` (A) with gains
(N m/A at the link side). Other columns are ignored, whatever they hold. Efforts are those of the actuators
(see `bayesid.robot`).
"""

from __future__ import annotations

import csv
import os
import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from glob import glob
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.errors import InputError
from bayesid.motion import Array, Integers, Mask, frozen

_ABSURD = 1e6
"""No robot moves or pushes this much in SI units; logs in the wild hold 1e282 from uninitialised memory."""
_LONGEST_GAP = 3600.0
"""A log that pauses longer than this, s, is two recordings, or its clock was set in between."""
_FEWEST_ROWS = 50
_ROUNDING = 0.01
"""Share of a period by which an instant of an even grid may miss the row it belongs to."""
_PAUSE = 3.0
"""s between two logs that are joined, at least: longer than any filter looks ahead."""
_PAUSE_PERIODS = 100
"""Periods between two logs that are joined, at least: at a low rate, and where most rows repeat, 3 s are no pause."""
_SAME_RATE = 0.2
"""Logs whose rates differ by more than this share are not joined."""


@dataclass(frozen=True)
class Piece:
    """One of the recordings that a log was joined from.

    Attributes:
        source: where it came from.
        start_row: its first row in the log.
        stop_row: the row after its last.
        t: (stop_row - start_row,) its rows' time on its own clock, s, as recorded: shifted times are rounded ones.
    """

    source: str
    start_row: int
    stop_row: int
    t: Array

    def __post_init__(self) -> None:
        if not self.start_row < self.stop_row:
            raise ValueError("a piece holds no rows")
        object.__setattr__(self, "t", frozen(self.t, (self.stop_row - self.start_row,), "a piece's t"))


@dataclass(frozen=True)
class Log:
    """A recorded motion with its actuator efforts, as recorded: no filter, no resampling.

    Attributes:
        t: (N,) time, s, non-decreasing.
        q: (N, n) joint positions, rad.
        effort: (N, n) actuator efforts, N m; absolute values for the joints that are not signed.
        signed: (n,) whether the effort's sign is known.
        dq: (N, n) measured joint velocities, rad/s, or None.
        source: where it came from, for messages.
        pieces: the recordings it was joined from, which hold its rows one after the other; empty where it is one.
    """

    t: Array
    q: Array
    effort: Array
    signed: Mask
    dq: Array | None = None
    source: str = "log"
    pieces: tuple[Piece, ...] = ()

    def __post_init__(self) -> None:
        q = frozen(self.q, (None, None), "q")
        object.__setattr__(self, "q", q)
        object.__setattr__(self, "t", frozen(self.t, (q.shape[0],), "t"))
        object.__setattr__(self, "effort", frozen(self.effort, q.shape, "effort"))
        if self.dq is not None:
            object.__setattr__(self, "dq", frozen(self.dq, q.shape, "dq"))
        signed = np.array(self.signed, dtype=bool)
        if signed.shape != (q.shape[1],):
            raise ValueError(f"signed has shape {signed.shape}, expected ({q.shape[1]},)")
        signed.setflags(write=False)
        object.__setattr__(self, "signed", signed)
        if np.any(self.effort[:, ~signed] < 0.0):
            raise ValueError("the effort of an unsigned joint is an absolute value and cannot be negative")
        if np.any(np.diff(self.t) < 0.0):
            raise ValueError("time runs backwards")
        if self.pieces and [0, *(p.stop_row for p in self.pieces)] != [*(p.start_row for p in self.pieces), len(self)]:
            raise ValueError("the pieces do not hold the log's rows one after the other")

    def __len__(self) -> int:
        return len(self.t)

    def rectified(self) -> Log:
        """The log as a controller that hides every sign would have written it."""
        return replace(self, effort=np.abs(self.effort), signed=np.zeros(self.n_joints, dtype=bool))

    @property
    def pooled(self) -> bool:
        """Whether it was joined from several recordings."""
        return len(self.pieces) > 1

    def clock(self, t: Array) -> tuple[Integers, Array]:
        """Instants of the log on the clock of the recording that each lies in.

        Args:
            t: (M,) instants on the log's clock, s.

        Returns:
            (M,) the recording's place in `pieces`, 0 in a log that is one, and -1 where nothing was recorded; and (M,)
            its own time, s, as the log's clock has it where nothing was recorded.
        """
        place, own = np.full(len(t), -1 if self.pooled else 0), np.array(t, dtype=float)
        slack = _ROUNDING * self.period
        for k, piece in enumerate(self.pieces if self.pooled else ()):
            first, last = self.t[[piece.start_row, piece.stop_row - 1]]
            here = (t >= first - slack) & (t <= last + slack)
            place[here], own[here] = k, t[here] - (first - piece.t[0])
        return place, own

    @property
    def period(self) -> float:
        """Typical time between two rows, s."""
        steps = np.diff(self.t)
        return float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return int(self.q.shape[1])


def read_log(path: str | Path, gains: Sequence[float] | None = None, unsigned: str | None = None) -> Log:
    """Reads and checks a CSV log.

    Args:
        path: the file.
        gains: n drive gains, N m/A, for a log of currents i1..in.
        unsigned: "all", "none" or 1-based joints as in "1,3"; by default a joint whose effort is never negative.

    Raises:
        InputError: the file, a row, a column or an option cannot be used.
    """
    path = Path(path)
    columns, values = _read_table(path)
    _check_time(values[:, columns["t"][0]], path)
    q, measured = values[:, columns["q"]], values[:, columns["tau"] or columns["i"]]
    signed = _signed(measured, unsigned, q.shape[1])
    effort = measured * _factors(columns, gains, str(path))
    for j in np.flatnonzero(np.ptp(q, axis=0) == 0.0):
        raise InputError(f"column q{j + 1} is constant", str(path), "record a motion in which every joint moves")
    for j in np.flatnonzero(~np.any(effort, axis=0)):
        said = f"the effort of joint {j + 1} is zero in every row"
        raise InputError(said, str(path), "check that its sensor was read")
    return Log(
        t=values[:, columns["t"][0]],
        q=q,
        effort=np.where(signed, effort, np.abs(effort)),
        signed=signed,
        dq=values[:, columns["dq"]] if columns["dq"] else None,
        source=str(path),
    )


def find_logs(patterns: Sequence[str | Path]) -> list[Path]:
    """The logs that paths and patterns name, one after the other; those of a pattern in alphabetical order.

    Args:
        patterns: paths, or patterns as in "runs/*.csv" with `*`, `?` or `[`; what exists is a path.

    Raises:
        InputError: no file matches a pattern, or a log is named twice.
    """
    named: dict[str, Path] = {}
    for path in chain.from_iterable(map(_matches, patterns)):
        place = os.path.realpath(path)
        if place in named:
            said = "is named twice" if named[place] == path else f"is the same file as {named[place]}"
            raise InputError(said, str(path), "name every log once: it would count twice")
        named[place] = path
    return list(named.values())


def _matches(pattern: str | Path) -> list[Path]:
    """The path itself, whether it exists or not, or the files that match it as a pattern."""
    if os.path.exists(pattern) or not set("*?[") & set(str(pattern)):
        return [Path(pattern)]
    found = [Path(match) for match in sorted(glob(str(pattern), recursive=True)) if os.path.isfile(match)]
    if not found:
        raise InputError("matches no file", str(pattern), "give the path of a CSV log, or a pattern of several")
    return found


def join_logs(logs: Sequence[Log]) -> Log:
    """Several logs of the same robot as one, with a pause between them: identification leaves pauses out.

    Each keeps its own time in `pieces`.

    Args:
        logs: at least one; times start over in each of them.

    Raises:
        InputError: they do not have the same joints, signed joints or measured velocities, or not the same rate.
    """
    first = logs[0]
    if len(logs) == 1:
        return first
    for log in logs[1:]:
        _check_fit(first, log)
    pause = max(_PAUSE, _PAUSE_PERIODS * max(log.period for log in logs))
    times, pieces = [first.t], list(_pieces(first, 0))
    for log in logs[1:]:
        times.append(log.t - log.t[0] + (times[-1][-1] + pause))
        pieces += _pieces(log, pieces[-1].stop_row)
    measured = None if first.dq is None else np.concatenate([log.dq for log in logs if log.dq is not None])
    return Log(
        t=np.concatenate(times),
        q=np.concatenate([log.q for log in logs]),
        effort=np.concatenate([log.effort for log in logs]),
        signed=first.signed,
        dq=measured,
        source=" + ".join(log.source for log in logs),
        pieces=tuple(pieces),
    )


def _pieces(log: Log, row: int) -> tuple[Piece, ...]:
    """The log's recordings in a longer log in which it begins at a row."""
    own = log.pieces or (Piece(log.source, 0, len(log), log.t),)
    return tuple(replace(one, start_row=one.start_row + row, stop_row=one.stop_row + row) for one in own)


def _check_fit(first: Log, log: Log) -> None:
    """Two logs can only be joined where the same is known at the same rate."""
    if log.n_joints != first.n_joints:
        said = f"has {log.n_joints} joints, {first.source} has {first.n_joints}"
        raise InputError(said, log.source, "join logs of one robot")
    if not np.array_equal(log.signed, first.signed):
        said = f"other joints are signed than in {first.source}"
        raise InputError(said, log.source, "say which with --unsigned, or rectify both")
    if (log.dq is None) != (first.dq is None):
        said = f"only one of it and {first.source} has measured velocities"
        raise InputError(said, log.source, "leave the columns dq1..dqn out of the other")
    rate, expected = 1.0 / log.period, 1.0 / first.period
    if abs(rate / expected - 1.0) > _SAME_RATE:
        said = f"{rate:.4g} Hz, {first.source} has {expected:.4g} Hz"
        raise InputError(said, log.source, "bring the logs to the same rate")


def write_log(path: str | Path, log: Log) -> None:
    """Writes a log in the format that `read_log` reads, with as many digits as it takes to come back the same.

    Nothing in the file says which joints are signed: `read_log` looks for negative efforts, or is told.
    """
    blocks = {"q": log.q, **({} if log.dq is None else {"dq": log.dq}), "tau": log.effort}
    header = ["t", *(f"{name}{j}" for name in blocks for j in range(1, log.n_joints + 1))]
    aside = Path(f"{path}.part")
    try:
        with aside.open("w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(header)
            rows.writerows(np.column_stack([log.t, *blocks.values()]).tolist())
        aside.replace(path)
    finally:
        aside.unlink(missing_ok=True)


# ---------------------------------------------------------------------------------------------------------------
# The table
# ---------------------------------------------------------------------------------------------------------------
_Columns = dict[str, list[int]]
"""Column indices of t, q, dq, tau and i; those the log lacks or does not need are empty."""


def _read_table(path: Path) -> tuple[_Columns, Array]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            header = [name.strip() for name in next(csv.reader([file.readline()]), [])]
        if not any(header):
            raise InputError("does not begin with a header", str(path), "begin it with t,q1..qn,tau1..taun")
        columns = _find_columns(header, str(path))
        values = _read_values(path, header, sorted(chain.from_iterable(columns.values())))
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
        raise InputError("no such file", str(path), "give the path of a CSV log") from None
    except (UnicodeDecodeError, csv.Error):
        raise InputError("is not text", str(path), "give a CSV log") from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", str(path), "check the file") from None
    return columns, values


def _read_values(path: Path, header: list[str], used: list[int]) -> Array:
    """(N, columns) numbers of the used columns, checked; the other columns come as 0."""
    ignored: dict[int | str, Callable[[str], float]] = {i: lambda _: 0.0 for i in range(len(header)) if i not in used}
    table: dict[str, Any] = {"delimiter": ",", "quotechar": '"', "comments": None, "skiprows": 1, "encoding": "utf-8"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of a file without rows, which is refused below
        try:
            values: Array = np.loadtxt(path, converters=ignored, ndmin=2, **table)
        except UnicodeDecodeError:
            raise
        except ValueError:
            raise _first_bad_row(path, header, used) from None
    if len(values) < _FEWEST_ROWS:
        said = f"holds {len(values)} rows, too few to identify anything"
        raise InputError(said, str(path), f"record at least {_FEWEST_ROWS} rows, better thousands")
    if values.shape[1] != len(header):
        said = f"has {len(header)} names for {values.shape[1]} columns"
        raise InputError(said, f"{path}, row 1", "give every column one name")
    largest = [np.inf if header[i] == "t" else _ABSURD for i in used]
    for row, place in np.argwhere(~(np.abs(values[:, used]) < largest)):
        column = used[place]
        said = f"column {header[column]} holds {values[row, column]:g}"
        raise InputError(said, _where(path, row), "remove the row or correct the value")
    return values


def _where(path: Path, row: int) -> str:
    """The file's line of a row of values: the header is row 1, and blank lines count."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        lines = [number for number, line in enumerate(file, start=1) if number > 1 and line.strip()]
    return f"{path}, row {lines[row]}"


def _first_bad_row(path: Path, header: list[str], used: list[int]) -> InputError:
    """Why the table cannot be read, found by a slow second look."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        for number, cells in enumerate(csv.reader(file), start=1):
            if number == 1 or not cells:
                continue
            where = f"{path}, row {number}"
            if len(cells) != len(header):
                said = f"holds {len(cells)} values, the header names {len(header)}"
                return InputError(said, where, "remove the row (a truncated last row is common) or complete it")
            for i in used:
                if not _is_number(cells[i]):
                    said = f"column {header[i]} holds {cells[i].strip()!r}, not a number"
                    return InputError(said, where, "correct the value")
    return InputError("cannot be read as a table of numbers", str(path), "give a comma-separated file")


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell


def _find_columns(header: list[str], where: str) -> _Columns:
    """Which columns to use, by their names."""
    place = {name: i for i, name in enumerate(header)}
    for name in header:
        if header.count(name) > 1 and re.fullmatch(r"t|(?:q|dq|tau|i)\d+", name):
            raise InputError(f"column {name} appears twice", f"{where}, row 1", "give every column its own name")
    if "t" not in place:
        raise InputError("column t is missing", f"{where}, row 1", "add the time in s")
    n = max((int(name[1:]) for name in header if re.fullmatch(r"q[1-9]\d*", name)), default=0)
    if n == 0:
        raise InputError("column q1 is missing", f"{where}, row 1", "add the joint positions q1..qn in rad")
    columns: _Columns = {"t": [place["t"]], "q": [], "dq": [], "tau": [], "i": []}
    has_torque = any(re.fullmatch(r"tau\d+", name) for name in header)
    has_velocity = any(re.fullmatch(r"dq\d+", name) for name in header)
    for prefix in ["q", "tau" if has_torque else "i"] + (["dq"] if has_velocity else []):
        for j in range(1, n + 1):
            if f"{prefix}{j}" not in place:
                absent = f"tau{j} (or i{j} with gains)" if prefix == "i" else f"{prefix}{j}"
                raise InputError(f"column {absent} is missing", f"{where}, row 1", f"add it; q1..q{n} are there")
            columns[prefix].append(place[f"{prefix}{j}"])
        extra = [name for name in header if (m := re.fullmatch(rf"{prefix}(\d+)", name)) and int(m[1]) > n]
        if extra:
            remedy = "give q and effort columns for the same joints"
            raise InputError(f"column {extra[0]} has no q beside it", f"{where}, row 1", remedy)
    return columns


def _check_time(t: Array, path: Path) -> None:
    with np.errstate(over="ignore"):
        step = np.diff(t)
    for k in np.flatnonzero((step < 0.0) | (step > _LONGEST_GAP)):
        said = f"time {'runs backwards' if step[k] < 0.0 else 'jumps'}, from {t[k]:.12g} s to {t[k + 1]:.12g} s"
        raise InputError(said, _where(path, int(k) + 1), "sort or cut the log")
    if t[-1] == t[0]:
        raise InputError("time never advances", f"{path}, column t", "give the time of each row in s")


def _factors(columns: _Columns, gains: Sequence[float] | None, where: str) -> Array:
    """(n,) N m per unit of what was measured."""
    n = len(columns["q"])
    if columns["tau"]:
        if gains is not None:
            raise InputError("gains are given but the log holds torques tau1..taun", where, "drop --gains")
        return np.ones(n)
    if gains is None:
        raise InputError("the log holds currents but no gains are given", where, "give --gains K1,..,Kn in N m/A")
    if len(gains) != n:
        raise InputError(f"{len(gains)} gains for {n} joints", "--gains", "give one gain per joint, N m/A")
    factors = np.array(gains, dtype=float)
    if not np.all((np.abs(factors) < _ABSURD) & (factors != 0.0)):
        raise InputError("a gain is zero or not finite", "--gains", "give one gain per joint, N m/A")
    return factors


def _signed(measured: Array, unsigned: str | None, n: int) -> Mask:
    if unsigned is None:
        negative: Mask = np.any(measured < 0.0, axis=0)
        return negative
    if unsigned in ("all", "none"):
        return np.full(n, unsigned == "none")
    signed = np.full(n, True)
    for word in unsigned.split(","):
        if not word.strip().isdecimal() or not 1 <= int(word) <= n:
            remedy = f"give all, none or joints from 1 to {n}"
            raise InputError(f"{word.strip()!r} is not a joint", "--unsigned", remedy)
        signed[int(word) - 1] = False
    return signed
