"""Logs: what a controller recorded, checked once on the way in.

A CSV holds the header `t,q1..qn[,dq1..dqn],tau1..taun` (s, rad, rad/s, N m), or currents `i1..in` (A) with gains
(N m/A at the link side). Other columns are ignored, whatever they hold. Efforts are those of the actuators
(see `bayesid.robot`). Files of other formats hold the same in other words (see `bayesid.log.formats`).
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from glob import glob
from itertools import chain
from math import pi
from pathlib import Path
from typing import TypeAlias

import numpy as np

from bayesid.arrays import Array, Integers, Labels, Mask, frozen
from bayesid.errors import InputError, printable
from bayesid.files.bounded import whole_number
from bayesid.files.tables import numbered, write_columns
from bayesid.files.writing import replace_file
from bayesid.log.formats import Options, Table, is_log_folder, read_table
from bayesid.log.formats.labels import pattern_of
from bayesid.log.formats.memory import Variables, read_variables
from bayesid.log.formats.parts import JOINT, join_parts
from bayesid.log.formats.stated import parse_columns
from bayesid.log.formats.table import DEGREE, FEWEST_ROWS, check, far_positions
from bayesid.log.formats.units import factor_of, split_brackets
from bayesid.log.gains import Gains, gains_of, is_exact
from bayesid.log.speeds import check_speeds, check_velocities
from bayesid.motion import check_label, labels

_MANY_TURNS = 20.0 * pi
"""rad; where most joints leave ten turns either way even in degrees, they are in neither. A round number."""
_STRONGEST = 1e5
"""N m; no joint of an arm is as strong: those of the largest, for payloads of 2 t, have some 5e4."""
_MICROSECONDS = 6
"""Decimals of a time in s that is told: finer than any log's stamps, coarser than the rounding of an even grid."""
_ROUNDING = 0.01
"""Share of a period by which an instant of an even grid may miss the row it belongs to; far above the rounding of times
that count from 1970 (2.4e-7 s), far below half a period."""
_PAUSE = 3.0
"""s between two logs that are joined, at least: longer than any filter looks ahead, which is 1.5 periods of a cut-off
that is no lower than a few Hz (`bayesid.log.signals`)."""
_PAUSE_PERIODS = 100
"""Periods between two logs that are joined, at least: at a low rate, and where most rows repeat, 3 s are no pause. Well
above the 20 typical periods from which `bayesid.log.signals` leaves a pause out."""
_SAME = 0.1
"""Share by which efforts may differ from velocities that are taken for them: a derivative of noisy positions does. A
round number; not studied."""
_SAME_RATE = 0.2
"""Logs whose rates differ by more than this share are not joined. A round number; not studied."""


@dataclass(frozen=True)
class Piece:
    """One of the recordings that a log was joined from.

    Attributes:
        source: where it came from.
        start_row: its first row in the log.
        stop_row: the row after its last.
        t: (stop_row - start_row,) its rows' time on its own clock, s, as recorded: shifted times are rounded ones.
        payload: label of what the flange carried all along; empty where it carried nothing.
    """

    source: str
    start_row: int
    stop_row: int
    t: Array
    payload: str = ""

    def __post_init__(self) -> None:
        if not self.start_row < self.stop_row:
            raise ValueError("a piece holds no rows")
        if self.payload:
            check_label(self.payload)
        object.__setattr__(self, "source", printable(self.source))
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
        read_with: options of `read_log` that it was read with, where they were not the usual ones.
        gains: by which its readings were made efforts, where some of them are not exact; None where all are.

    Example:
        >>> t = np.arange(200) / 100.0
        >>> q = np.column_stack([np.sin(t), np.cos(3.0 * t)])
        >>> bayesid.Log(t, q, effort=np.abs(5.0 * q), signed=[False, False])
        Log log: 200 rows in 1.99 s, 2 joints (none signed), no velocities
    """

    t: Array
    q: Array
    effort: Array
    signed: Mask
    dq: Array | None = None
    source: str = "log"
    pieces: tuple[Piece, ...] = ()
    read_with: Mapping[str, object] = field(default_factory=dict, compare=False)
    gains: Gains | None = None

    def __post_init__(self) -> None:
        q = frozen(self.q, (None, None), "q")
        object.__setattr__(self, "source", printable(self.source))
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

    def __repr__(self) -> str:
        signed = np.flatnonzero(self.signed) + 1
        signs = "all signed" if self.signed.all() else f"signed: {', '.join(map(str, signed))}" if len(signed) else ""
        seconds = self.t[-1] - self.t[0] if len(self) else 0.0
        velocities = "velocities measured" if self.dq is not None else "no velocities"
        joints = f"{self.n_joints} joints ({signs or 'none signed'})"
        return f"Log {self.source}: {len(self)} rows in {seconds:.4g} s, {joints}, {velocities}"

    def rectified(self) -> Log:
        """The log as a controller that hides every sign would have written it.

        Example:
            >>> log = bayesid.read_log("signed.csv")
            >>> bool((log.effort < 0.0).any()), bool((log.rectified().effort < 0.0).any())
            (True, False)
        """
        return replace(self, effort=np.abs(self.effort), signed=np.zeros(self.n_joints, dtype=bool))

    def rescaled(self, factor: Array) -> Log:
        """The log with each joint's efforts, and the gain behind them, multiplied by its factor (n,).

        Example:
            >>> bool(np.allclose(log.rescaled([1.0, 2.0, 1.0]).effort[:, 1], 2.0 * log.effort[:, 1]))
            True
        """
        gains = None if self.gains is None else self.gains.times(np.asarray(factor))
        return replace(self, effort=self.effort * np.asarray(factor), gains=gains)

    def carrying(self, label: str) -> Log:
        """The log of a flange that carried a payload all along; where nothing is said it carried nothing.

        Identified together with a log without payload, each payload has ten parameters of its own (`m_tool1`,
        `mcx_tool1`, ..), which act in the logs of its label alone.

        Args:
            label: of the payload: letters, digits and underscores.

        Raises:
            InputError: it cannot be one.

        Example:
            >>> both = bayesid.join_logs([log, other_log.carrying("tool1")])
            >>> [piece.payload for piece in both.pieces]
            ['', 'tool1']
        """
        pieces = self.pieces or (Piece(self.source, 0, len(self), self.t),)
        return replace(self, pieces=tuple(replace(piece, payload=check_label(label)) for piece in pieces))

    @property
    def payload(self) -> Labels:
        """(N,) label of what the flange carried in each row; empty where it carried nothing.

        Example:
            >>> np.unique(log.carrying("tool1").payload).tolist()
            ['tool1']
        """
        if not self.pieces:
            return labels("", len(self))
        return np.repeat([piece.payload for piece in self.pieces], [len(piece.t) for piece in self.pieces])

    @property
    def pooled(self) -> bool:
        """Whether it was joined from several recordings.

        Example:
            >>> log.pooled, bayesid.join_logs([log, other_log]).pooled
            (False, True)
        """
        return len(self.pieces) > 1

    def clock(self, t: Array) -> tuple[Integers, Array]:
        """Instants of the log on the clock of the recording that each lies in.

        Args:
            t: (M,) instants on the log's clock, s.

        Returns:
            (M,) the recording's place in `pieces`, 0 in a log that is one, and -1 where nothing was recorded; and (M,)
            its own time, s, to the microsecond, as the log's clock has it where nothing was recorded.

        Example:
            >>> both = bayesid.join_logs([log, other_log])
            >>> place, time = both.clock(both.t[[0, -1]])
            >>> place.tolist(), time.tolist()
            ([0, 1], [0.0, 6.0])
        """
        place, time = np.full(len(t), -1 if self.pooled else 0), np.array(t, dtype=float)
        slack = _ROUNDING * self.period
        for k, piece in enumerate(self.pieces if self.pooled else ()):
            first, last = self.t[[piece.start_row, piece.stop_row - 1]]
            inside = (t >= first - slack) & (t <= last + slack)
            place[inside], time[inside] = k, t[inside] - (first - piece.t[0])
        return place, np.round(time, _MICROSECONDS)

    @property
    def period(self) -> float:
        """Typical time between two rows, s.

        Example:
            >>> round(log.period, 3)
            0.02
        """
        steps = np.diff(self.t)
        return float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0

    @property
    def n_joints(self) -> int:
        """Number of joints n.

        Example:
            >>> log.n_joints
            3
        """
        return int(self.q.shape[1])


Parts: TypeAlias = Sequence["str | Path | Variables"]
"""The files of one run, or what is in memory of it: they are joined by time."""
LogSource: TypeAlias = Log | str | Path | Variables | Parts
"""What stands for a log wherever one is asked for."""


def read_log(
    source: str | Path | Variables | Parts,
    gains: Sequence[float] | Gains | str | None = None,
    unsigned: str | None = None,
    *,
    degrees: bool | None = None,
    topic: str | None = None,
    joints: Sequence[str] | None = None,
    columns: Mapping[str, str] | str | Path | None = None,
) -> Log:
    """Reads and checks a log in one of the formats of `bayesid.log.formats`, or one that is in memory.

    What had to be assumed, such as the order of a bag's joints, is said in a `UserWarning`.

    Args:
        source: the file, or a folder that is a recording; or a data frame, a structured array or a dict with columns
            named as in a file, or with `t` (N,), `q` (N, n), `tau` or `i` (N, n), and `dq` (N, n) if measured. Parts of
            one run, such as positions and currents, in a list or as in "positions.csv+currents.csv" are joined by time.
        gains: n drive gains, N m/A, for a log of currents i1..in; efforts that the format leaves open (those of a ROS
            bag) are then currents. Gains that are not exact, as in "12~20%,16~20%,10" or "unknown", a CSV file with
            the columns gain and sd, or `Gains`, become unknowns of the identification; those may correct torques too.
        unsigned: "all", "none" or 1-based joints as in "1,3"; by default a joint whose effort is never negative.
        degrees: whether positions and velocities are in degrees where the file does not say their unit. All of them
            are taken as angles: give those of prismatic joints a unit in the header, as in `q3[m]`. By default they
            are in rad (m), and refused if more than half of the joints, and two at least, leave two turns either way.
        topic: of a recording with joint states of several topics; by default the only one with efforts.
        joints: names from base to tip, where joints have names; by default all, in the order of their numbers, or else
            in that of the first message.
        columns: what the file calls t, q, dq, and tau or i, as in {"t": "Zeit [ms]", "q": "Achse{} [Grad]"}: `{}`
            stands for the joints' numbers, from 0 or from 1, `{2-7}` for those from 2 to 7, and q1, q2, .. are one
            joint's. Units in brackets count. Or as on the command line, or a TOML file. By default the usual names.

    Raises:
        InputError: the file, a row, a column or an option cannot be used.

    Example:
        >>> t = np.arange(200) / 100.0
        >>> q = np.column_stack([np.sin(t), np.cos(3.0 * t)])
        >>> bayesid.read_log({"t": t, "q": q, "tau": 5.0 * q}).n_joints
        2
    """
    _check_lists(gains=None if isinstance(gains, Gains | str) else gains, joints=joints)
    stated = parse_columns(str(columns)) if isinstance(columns, str | Path) else columns
    options = Options(topic=topic, joints=joints, currents=gains is not None, columns=stated)
    table = _table_of(source, options)
    angle, made_with = angle_unit(table, degrees), gains_of_table(table, gains)
    q, effort = table.block("q", angle), table.block("tau" if "tau1" in table.columns else "i")
    signed = signed_joints(effort, unsigned, table.n_joints)
    effort *= made_with.value
    dq = table.block("dq", angle) if "dq1" in table.columns else None
    _check_blocks(table, q, effort)
    _check_no_velocities(table, q, effort)
    _check_motion(table, q, dq, degrees)
    for note in table.notes:
        warnings.warn(note, stacklevel=2)
    for j in np.flatnonzero(~signed):
        np.abs(effort[:, j], out=effort[:, j])
    uncertain = None if made_with.exact.all() else made_with
    recordings = [
        Log(
            t=table.t[rows],
            q=_part(q, rows),
            effort=_part(effort, rows),
            signed=signed,
            dq=dq if dq is None else _part(dq, rows),
            source=name,
            gains=uncertain,
        )
        for name, rows in _recordings(table)
    ]
    asked = {
        "gains": gains.text if isinstance(gains, Gains) else gains,
        "degrees": degrees,
        "topic": topic,
        "joints": joints,
        "columns": stated,
    }
    given = {name: list(value) if isinstance(value, tuple) else value for name, value in asked.items()}
    used = {name: value for name, value in given.items() if value is not None}
    return replace(join_logs(recordings), read_with=used)


def _table_of(source: str | Path | Variables | Parts, options: Options) -> Table:
    """What a file, a program's variables, or the parts of a run hold."""
    if isinstance(source, str | Path):
        return read_table(Path(source), options)
    if isinstance(source, list | tuple) and source and all(map(_is_part, source)):
        part = replace(options, part=True)
        return check(join_parts([_table_of(one, part) for one in source], options.columns), options.columns)
    return _in_memory(source, options)


def _is_part(source: object) -> bool:
    """Whether something is a path or has columns."""
    named = isinstance(source, np.ndarray) and source.dtype.names is not None
    return named or isinstance(source, str | Path | Mapping) or (hasattr(source, "columns"))


def _recordings(table: Table) -> list[tuple[str, slice]]:
    """The recordings that a file holds, with their names and rows; those that are too short are left out.

    Raises:
        InputError: all of several are.
    """
    starts = table.starts
    if len(starts) == 1:
        return [(table.source, slice(None))]
    label = table.columns["part"].label
    parts = [slice(*ends) for ends in zip(starts, [*starts[1:], len(table.t)], strict=True)]
    long = [rows for rows in parts if rows.stop - rows.start >= FEWEST_ROWS]
    if not long:
        said = f"holds {len(parts)} recordings of {label}, none with {FEWEST_ROWS} rows"
        raise InputError(said, table.source, "record longer ones")
    return [(f"{table.source}, {label} {table.columns['part'].values[rows.start]:g}", rows) for rows in long]


def _part(values: Array, rows: slice) -> Array:
    """Some rows of values to which nothing is written from now on; no copy where these are all."""
    values.setflags(write=False)
    return values if rows == slice(None) else values[rows]


def as_log(source: LogSource) -> Log:
    """A log as it is, and anything else as `read_log` reads it.

    Raises:
        InputError: it cannot be used.
    """
    return source if isinstance(source, Log) else read_log(source)


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
    """The path itself, whether it exists or not, or the logs that match it; not the files of a folder that is a log."""
    if os.path.exists(pattern) or JOINT in str(pattern) or not set("*?[") & set(str(pattern)):
        return [Path(pattern)]
    matches = [Path(match) for match in sorted(glob(str(pattern), recursive=True))]
    logs = [path for path in matches if is_log_folder(path) or (path.is_file() and not is_log_folder(path.parent))]
    if not logs:
        raise InputError("matches no file", str(pattern), "give the path of a log, or a pattern of several")
    return logs


def join_logs(logs: Sequence[Log]) -> Log:
    """Several logs of the same robot as one, with a pause between them: identification leaves pauses out.

    Each keeps its own time in `pieces`.

    Args:
        logs: at least one; times start over in each of them.

    Raises:
        InputError: they do not have the same joints, signed joints or measured velocities, or not the same rate.

    Example:
        >>> both = bayesid.join_logs([log, other_log])
        >>> len(both) == len(log) + len(other_log)
        True
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
        read_with=first.read_with,
        gains=first.gains,
    )


def _pieces(log: Log, row: int) -> tuple[Piece, ...]:
    """The log's recordings in a longer log in which it begins at a row."""
    pieces = log.pieces or (Piece(log.source, 0, len(log), log.t),)
    return tuple(replace(p, start_row=p.start_row + row, stop_row=p.stop_row + row) for p in pieces)


def _check_fit(first: Log, log: Log) -> None:
    """Two logs can only be joined where the same is known at the same rate."""
    if log.n_joints != first.n_joints:
        said = f"has {log.n_joints} joints, {first.source} has {first.n_joints}"
        raise InputError(said, log.source, "join logs of one robot")
    if not np.array_equal(log.signed, first.signed):
        said = f"other joints are signed than in {first.source}"
        raise InputError(said, log.source, "say which with `unsigned`, or rectify both")
    if (log.dq is None) != (first.dq is None):
        said = f"only one of it and {first.source} has measured velocities"
        raise InputError(said, log.source, "leave the columns dq1..dqn out of the other")
    if _as_text(log.gains) != _as_text(first.gains):
        said = f"was read with gains {_as_text(log.gains)}, {first.source} with {_as_text(first.gains)}"
        raise InputError(said, log.source, "read both with the same `gains`")
    rate, expected = 1.0 / log.period, 1.0 / first.period
    if abs(rate / expected - 1.0) > _SAME_RATE:
        said = f"{rate:.4g} Hz, {first.source} has {expected:.4g} Hz"
        raise InputError(said, log.source, "bring the logs to the same rate")


def check_exact_gains(log: Log) -> None:
    """Beside an earlier result no gain is an unknown: its model is in the scale of its own.

    Raises:
        InputError: the log was read with uncertain gains.
    """
    if log.gains is not None:
        remedy = "read it with the earlier result's own, as in bayesid.read_log(file, gains=result.gains.found)"
        raise InputError(f"was read with uncertain gains {log.gains.text}", log.source, remedy)


def _as_text(gains: Gains | None) -> str:
    return "that are exact" if gains is None else gains.text


def write_log(path: str | Path, log: Log) -> None:
    """Writes a log in the format that `read_log` reads, with as many digits as it takes to come back the same.

    Nothing in the file says which joints are signed: `read_log` looks for negative efforts, unless `unsigned` says it.

    Example:
        >>> bayesid.write_log("copy.csv", log)
        >>> len(bayesid.read_log("copy.csv")) == len(log)
        True
    """
    blocks = {"q": log.q, **({} if log.dq is None else {"dq": log.dq}), "tau": log.effort}
    names = ["t", *(name for kind in blocks for name in numbered(kind, log.n_joints))]
    replace_file(Path(path), lambda aside: write_columns(aside, names, log.t, np.hstack(list(blocks.values()))))


# ---------------------------------------------------------------------------------------------------------------
# What a table's numbers mean
# ---------------------------------------------------------------------------------------------------------------
def _in_memory(source: Variables | Parts, options: Options) -> Table:
    for name in ("topic", "joints"):
        if getattr(options, name) is not None:
            raise InputError(f"is in memory, which has no {name}", type(source).__name__, f"leave {name} out")
    return read_variables(source, options)


def _check_blocks(table: Table, q: Array, effort: Array) -> None:
    """Some joint has moved, some sensor was read, and none of them beyond all robots."""
    if not np.ptp(q, axis=0).any():
        raise InputError("all columns of positions are constant", table.source, "record a motion in which joints move")
    if not effort.any():
        raise InputError("all efforts are zero in every row", table.source, "check that the sensors were read")
    for j in np.flatnonzero(np.abs(effort).max(axis=0) > _STRONGEST):
        said = f"the effort of joint {j + 1} reaches {np.abs(effort[:, j]).max():.3g} N m"
        remedy = "say the unit of currents or torques in the header, as in i1[mA], or correct `gains`"
        raise InputError(said, table.source, remedy)


def _check_no_velocities(table: Table, q: Array, effort: Array) -> None:
    """Efforts are not what positions change by."""
    step = np.median(np.diff(table.t)[np.diff(table.t) > 0.0])
    speeds = ((np.abs(np.gradient(joint)) / step, force) for joint, force in zip(q.T, effort.T, strict=True))
    if all(np.linalg.norm(np.abs(force) - speed) < _SAME * np.linalg.norm(speed) for speed, force in speeds):
        remedy = "name the columns of torques or currents by `columns`"
        raise InputError("the efforts are the joints' velocities", table.source, remedy)


def _check_motion(table: Table, q: Array, dq: Array | None, degrees: bool | None) -> None:
    """Positions, velocities and times belong together, unless a user vouches for the unit of positions."""
    if dq is not None:
        check_velocities(table.t, q, dq, table.source)
    if degrees is None:
        check_speeds(table.t, q, table.source)


def angle_unit(table: Table, degrees: bool | None) -> float:
    """The unit, rad, of the positions of which the file does not say it."""
    if degrees is None and (far := far_positions(table)):
        said = f"positions reach {max(far):.4g}: are they degrees?"
        if max(far) * DEGREE > _MANY_TURNS:
            said = f"positions reach {max(far):.4g}: neither rad nor degrees, are they counts of an encoder?"
            raise InputError(said, table.source, "give them in rad or degrees (`degrees=False` if they are rad)")
        raise InputError(said, table.source, "give `degrees=True`, or `degrees=False` if they are rad")
    return DEGREE if degrees else 1.0


def gains_of_table(table: Table, stated: Sequence[float] | Gains | str | None) -> Gains:
    """The gains by which a table's readings become efforts.

    Raises:
        InputError: they do not suit what it holds.
    """
    n, where, torques = table.n_joints, table.source, "tau1" in table.columns
    if stated is None:
        if torques:
            return Gains(np.ones(n), np.zeros(n), of_torques=True)
        remedy = "give `gains` K1,..,Kn in N m/A, as in 12~20%,16,10 where they are uncertain, or `gains` unknown"
        raise InputError("the log holds currents but no gains are given", where, remedy)
    if isinstance(stated, Gains) and stated.exact.all():  # of an earlier result
        if torques and not stated.of_torques:
            warnings.warn(f"{where} holds torques: gains of currents are left out", stacklevel=3)
            return Gains(np.ones(n), np.zeros(n), of_torques=True)
        if not torques and stated.of_torques:
            said = "the log holds currents, the gains are factors on torques"
            raise InputError(said, where, "give the gains of currents with `gains`")
    elif torques and is_exact(stated):
        pattern = pattern_of(table.columns["tau1"].label)
        remedy = f'drop `gains`, or give `columns` i="{pattern}" if they are currents'
        raise InputError("gains are given but the log holds torques tau1..taun", where, remedy)
    return replace(gains_of(stated, n), of_torques=torques, unit="N m" if torques else _unit_of_currents(table))


def _unit_of_currents(table: Table) -> str:
    """A, unless the header says another unit that is none of currents: %, counts."""
    unit = split_brackets(table.columns["i1"].label)[1]
    return "A" if unit is None or factor_of("i", unit) is not None else unit


def _check_lists(**given: object) -> None:
    """What has an entry for every joint is a list, where it is given."""
    for name, values in given.items():
        if not isinstance(values, Sequence | np.ndarray | None) or isinstance(values, str):
            raise InputError(f"{values!r} is no list", field=name, remedy="give one entry a joint, as in [1, 2, 3]")


def signed_joints(measured: Array, unsigned: str | None, n: int) -> Mask:
    """(n,) which joints are signed, by readings (N, n), or as a user has said.

    Raises:
        InputError: it names no joints.
    """
    if unsigned is None:
        negative: Mask = np.any(measured < 0.0, axis=0)
        return negative
    if unsigned in ("all", "none"):
        return np.full(n, unsigned == "none")
    signed = np.full(n, True)
    for word in unsigned.split(","):
        joint = whole_number(word.strip())
        if joint is None or not 1 <= joint <= n:
            remedy = f"give all, none or joints from 1 to {n}"
            raise InputError(f"{word.strip()!r:.60} is not a joint", field="unsigned", remedy=remedy)
        signed[joint - 1] = False
    return signed
