"""Reads logs and motions from files and from memory: units, gains, signs and checks."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, TypeAlias, overload

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.errors import InputError
from bayesid.files.bounded import whole_number
from bayesid.files.writing import numbered
from bayesid.log.corrections import corrections
from bayesid.log.formats import Column, Options, Table
from bayesid.log.formats.encodings import MAGNITUDE, TAKEN
from bayesid.log.formats.labels import factor_of, pattern_of, split_brackets
from bayesid.log.formats.memory import Variables
from bayesid.log.formats.stated import parse_columns
from bayesid.log.formats.table import DEGREE, check, far_positions, rows_of
from bayesid.log.gains import Gains, gains_of
from bayesid.log.kept_reading import OF_MOTION, read_alike
from bayesid.log.log import GIVEN, Log, RecordedMotion, join_logs
from bayesid.log.repairs import (
    at_own_rate,
    check_magnitudes,
    check_readings,
    positions_of,
    remarks_on_time,
    replace_foreign_velocities,
    wrapped_in_degrees,
)
from bayesid.log.sources import Parts, joint_names, table_of
from bayesid.log.tuning import TUNING
from bayesid.log.velocities import check_speeds
from bayesid.robot import Robot

LogSource: TypeAlias = Log | str | Path | Variables | Parts | list["LogSource"]
"""Accepted wherever a log is expected; the logs of a list are joined."""


@overload
def read_log(
    source: LogSource,
    gains: Sequence[float] | Gains | str | None = None,
    unsigned: str | None = None,
    *,
    degrees: bool | None = None,
    topic: str | None = None,
    joints: Sequence[str] | None = None,
    columns: Mapping[str, str] | str | Path | None = None,
    encoding: str | None = None,
    robot: Robot | None = None,
    correct: str | None = None,
    effort: Literal[True] = True,
) -> Log: ...


@overload
def read_log(
    source: str | Path | Variables | Parts,
    *,
    degrees: bool | None = None,
    topic: str | None = None,
    joints: Sequence[str] | None = None,
    columns: Mapping[str, str] | str | Path | None = None,
    robot: Robot | None = None,
    correct: str | None = None,
    effort: Literal[False],
) -> RecordedMotion: ...


def read_log(  # noqa: PLR0913  a source and its options
    source: LogSource,
    gains: Sequence[float] | Gains | str | None = None,
    unsigned: str | None = None,
    *,
    degrees: bool | None = None,
    topic: str | None = None,
    joints: Sequence[str] | None = None,
    columns: Mapping[str, str] | str | Path | None = None,
    encoding: str | None = None,
    robot: Robot | None = None,
    correct: str | None = None,
    effort: bool = True,
) -> Log | RecordedMotion:
    """Reads and checks a log in one of the formats of `bayesid.log.formats`, or from memory.

    A `UserWarning` states each assumption, such as the order of a bag's joints.

    Args:
        source: a file, or a folder that is a recording; a data frame, a structured array or a dict with columns named
            as in a file, or with `t` (N,), `q` (N, n), `tau` or `i` (N, n), and `dq` (N, n) if measured. The parts of
            one run, such as positions and currents, in a tuple or as in "positions.csv+currents.csv", are joined by
            time. A list of logs of one robot is joined end to end, with pauses; a `Log` in it is used unchanged.
        gains: n drive gains, N m/A, for a log of currents i1..in. Efforts without a unit in the format (a ROS bag) then
            count as currents. Uncertain gains are estimated by the identification, and may also correct torques:
            "12~20%,16~20%,10", "unknown", a CSV file with the columns gain and sd, or `Gains`.
        unsigned: "all", "none" or 1-based joints as in "1,3"; by default the joints whose effort is never negative.
        degrees: whether positions and velocities without a stated unit are in degrees, for every joint; give prismatic
            joints a unit in the header, as in `q3[m]`. The default is rad (m), refused if more than half of the joints,
            and at least two, exceed two turns either way.
        topic: topic of the joint states in a recording with several; by default the only one with efforts.
        joints: joint names from base to tip, for logs with joint names; by default all joints, in order of their
            numbers, or in that of the first message.
        columns: the file's names of t, q, dq, and tau or i, as in {"t": "Zeit [ms]", "q": "Achse{} [Grad]"}. `{}`
            stands for the joint numbers, from 0 or from 1, `{2-7}` for those from 2 to 7; q1, q2, .. name single
            joints. Units in brackets are used; "none" for dq ignores velocities. Also text as on the command line, or a
            TOML file. By default the usual names.
        encoding: how readings that are never negative hold a sign: "twos:16" (two's complement, 16 bits), "sign-bit:10"
            (bit 10 is set for negative values), "offset:2048" (reading at zero), "direction:1" (value of a direction
            column for negative efforts), or "magnitude" (no sign). By default it is detected.
        robot: its joint names select and order the log's joints, if the log has names; by default the log's order.
        correct: joints to exchange, flip or scale, and offsets, as in "q1=q3,q3=q1,tau2=-tau2,q5=q5+1.5708".
        effort: False to read a motion only; efforts may be missing and are ignored.

    Returns:
        A `Log`, or positions and velocities over time without efforts.

    Raises:
        InputError: the file, a row, a column or an option is not valid.

    Example:
        >>> t = np.arange(200) / 100.0
        >>> q = np.column_stack([np.sin(t), np.cos(3.0 * t)])
        >>> bayesid.read_log({"t": t, "q": q, "tau": 5.0 * q}).n_joints
        2
        >>> len(bayesid.read_log(["log.csv", "another_log.csv"]).pieces)
        2
        >>> bayesid.read_log("motion.csv", effort=False).q.shape
        (201, 3)
    """
    given: dict[str, Any] = {"gains": gains, "unsigned": unsigned, "degrees": degrees, "topic": topic, "joints": joints}
    given |= {"columns": columns, "encoding": encoding, "correct": correct}
    if not effort:
        return _motion_alone(source, robot, given)
    if isinstance(source, list):
        return _joined(source, robot, given)
    if isinstance(source, Log):
        raise InputError("is already a Log", source.source, "use it unchanged, or give its file")
    _check_lists(gains=None if isinstance(gains, Gains | str) else gains, joints=joints)
    stated = parse_columns(str(columns)) if isinstance(columns, str | Path) else columns
    options = Options(topic=topic, joints=joints, currents=gains is not None, columns=stated, encoding=encoding)
    if robot is not None:
        options = replace(options, robot_joints=joint_names(robot), n_joints=robot.n_joints)
    table = at_own_rate(table_of(source, options))
    angle, made_with = angle_unit(table, degrees), gains_of_table(table, gains)
    given |= {"gains": _as_read(gains, made_with), "columns": stated, "joints": table.joints or joints}
    table = wrapped_in_degrees(table) if degrees is None else table
    q, notes = positions_of(table, angle)
    measured = table.block("tau" if "tau1" in table.columns else "i")
    decoded = table.encoding is not None and unsigned is None  # a decoded joint is signed even if never negative
    signed = signed_joints(measured, "none" if decoded else unsigned, table.n_joints)
    if not any(TAKEN in note for note in table.repairs):
        notes += check_magnitudes(measured, q, signed, table.source, stated=encoding == MAGNITUDE)
    measured *= made_with.value
    dq = table.block("dq", angle) if "dq1" in table.columns else None
    check_readings(table, q, measured)
    if dq is not None:
        notes += replace_foreign_velocities(table, q, dq)
    if degrees is None:
        check_speeds(table.t, q, table.source)
    notes = [*table.repairs, *notes, *remarks_on_time(table, q)]
    if correct is not None:
        positions, efforts = corrections(correct, table.n_joints)
        q, measured = positions.of(q, zero=True), efforts.of(measured)
        made_with = made_with.ordered(efforts.order)
        dq = None if dq is None else positions.of(dq)
        signed = signed[efforts.order] if unsigned is None else signed
    for note in (*table.notes, *notes):
        warnings.warn(note, stacklevel=2)
    np.abs(measured, out=measured, where=~signed)
    recordings = [
        Log(
            t=table.t[rows],
            q=_part(q, rows),
            effort=_part(measured, rows),
            signed=signed,
            dq=dq if dq is None else _part(dq, rows),
            source=name,
            gains=None if made_with.exact.all() else made_with,
            notes=tuple(notes),
            encoding=table.encoding,
        )
        for name, rows in _recordings(table)
    ]
    used = {name: list(x) if isinstance(x, tuple) else x for name, x in given.items() if x is not None}
    return replace(join_logs(recordings), read_with=used)


def _joined(sources: list[LogSource], robot: Robot | None, given: Mapping[str, Any]) -> Log:
    if not sources:
        raise InputError("is an empty list", field="source", remedy="give at least one log")
    return join_logs([part if isinstance(part, Log) else read_log(part, **given, robot=robot) for part in sources])


def _motion_alone(source: Any, robot: Robot | None, given: Mapping[str, Any]) -> RecordedMotion:
    for name in ("gains", "unsigned", "encoding"):
        if given[name] is not None:
            remedy = "leave it out, or read a log with `effort=True`"
            raise InputError("applies to efforts, but a motion has none", field=name, remedy=remedy)
    return read_motion(source, **{name: given[name] for name in OF_MOTION}, robot=robot)


def _as_read(stated: Sequence[float] | Gains | str | None, read_by: Gains) -> list[float] | str | None:
    """Gains in a form that `read_log` takes: a list for exact gains of currents, else text; None if not given."""
    left_out = isinstance(stated, Gains) and read_by.of_torques and not stated.of_torques
    if stated is None or left_out:
        return None
    if read_by.exact.all() and not read_by.of_torques:
        exact: list[float] = read_by.value.tolist()
        return exact
    return stated if isinstance(stated, str) else read_by.text


def _recordings(table: Table) -> list[tuple[str, slice]]:
    """Names and rows of the recordings in a file; those that are too short are left out."""
    starts = table.starts
    if len(starts) == 1:
        return [(table.source, slice(None))]
    part = table.columns["part"]
    long = [slice(*ends) for ends in pairwise([*starts, len(table.t)]) if ends[1] - ends[0] >= TUNING.fewest_rows]
    if not long:
        what = f"holds {len(starts)} recordings of {part.label}, none with {TUNING.fewest_rows} rows"
        raise InputError(what, table.source, "record longer logs")
    return [(f"{table.source}, {part.label} {part.values[rows.start]:g}", rows) for rows in long]


def _part(values: Array, rows: slice) -> Array:
    """Some rows of values, made read-only; no copy if these are all rows."""
    values.setflags(write=False)
    return values if rows == slice(None) else values[rows]


def as_log(source: LogSource, robot: Robot, kept: Mapping[str, Any] = MappingProxyType({})) -> Log:
    """A `Log` unchanged; any other source as `read_log` reads it for a robot, by the kept options of a result's log."""
    return source if isinstance(source, Log) else read_alike(read_log, source, kept, {}, robot=robot)


def angle_unit(table: Table, degrees: bool | None) -> float:
    """Unit, rad, of positions without a stated unit."""
    if degrees is None and (far := far_positions(table)):
        what = f"positions reach {max(far):.4g}, so they may be degrees"
        if max(far) * DEGREE > TUNING.many_turns:
            what = f"positions reach {max(far):.4g}, too large for rad or degrees (encoder counts?)"
            raise InputError(what, table.source, "convert them to rad or degrees (`degrees=False` if they are rad)")
        raise InputError(what, table.source, "give `degrees=True`, or `degrees=False` if they are rad")
    return DEGREE if degrees else 1.0


def gains_of_table(table: Table, stated: Sequence[float] | Gains | str | None) -> Gains:
    """The gains that turn a table's readings into efforts; InputError if they do not fit the table."""
    n, where, torques = table.n_joints, table.source, "tau1" in table.columns
    if stated is None:
        if torques:
            return Gains(np.ones(n), np.zeros(n), of_torques=True)
        remedy = "give `gains` K1,..,Kn in N m/A (N m per count for raw readings), as in 12~20%,16,10 if they are "
        remedy += "uncertain, or `gains` unknown"
        raise InputError("the log holds currents but no gains are given", where, remedy)
    if isinstance(stated, Gains) and stated.exact.all():  # from an earlier result
        if torques and not stated.of_torques:
            warnings.warn(f"{where} holds torques; gains of currents are ignored", stacklevel=3)
            return Gains(np.ones(n), np.zeros(n), of_torques=True)
        if not torques and stated.of_torques:
            what = "the log holds currents, but the gains are factors on torques"
            raise InputError(what, where, "give the gains of currents with `gains`")
    elif torques and not isinstance(stated, Gains | str):
        pattern = pattern_of(table.columns["tau1"].label)
        remedy = f'drop `gains`, or give `columns` i="{pattern}" if they are currents'
        raise InputError("gains are given but the log holds torques tau1..taun", where, remedy)
    unit = None if torques else split_brackets(table.columns["i1"].label).unit
    known = unit is None or factor_of("i", unit) is not None  # otherwise another unit: %, counts
    return replace(gains_of(stated, n), of_torques=torques, unit="N m" if torques else "A" if known else str(unit))


def _check_lists(**given: object) -> None:
    for name, values in given.items():
        if not isinstance(values, Sequence | np.ndarray | None) or isinstance(values, str):
            raise InputError(
                f"{values!r} is not a list", field=name, remedy="give one entry per joint, as in [1, 2, 3]"
            )


def signed_joints(measured: Array, unsigned: str | None, n: int) -> Mask:
    """(n,) which joints are signed, from readings (N, n) or as stated."""
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


def read_motion(
    source: str | Path | Variables | Parts,
    *,
    degrees: bool | None = None,
    columns: Mapping[str, str] | str | Path | None = None,
    topic: str | None = None,
    joints: Sequence[str] | None = None,
    robot: Robot | None = None,
    correct: str | None = None,
) -> RecordedMotion:
    """`read_log` without efforts, with its options.

    Raises:
        InputError: the file, a row, a column or an option cannot be used.
    """
    stated = parse_columns(str(columns)) if isinstance(columns, str | Path) else columns
    options = Options(topic=topic, joints=joints, columns=stated, motion=True)
    if robot is not None:
        options = replace(options, robot_joints=joint_names(robot), n_joints=robot.n_joints)
    table = table_of(source, options)
    for note in table.notes:
        warnings.warn(note, stacklevel=2)
    angle = angle_unit(table, degrees)
    table = wrapped_in_degrees(table) if degrees is None else table
    q, notes = positions_of(table, angle)
    motion = _recorded(table, q, angle)
    later = np.flatnonzero(np.diff(motion.t, prepend=-np.inf) > 0.0)
    if repeated := len(motion.t) - len(later):
        notes = [*notes, f"{table.source}: {repeated:,} rows repeat the time of the row before; they are left out"]
        motion = motion.rows(later)
    for note in (*table.repairs, *notes):
        warnings.warn(note, stacklevel=2)
    if correct is None:
        return motion
    positions, _ = corrections(correct, table.n_joints)
    dq = None if motion.dq is None else positions.of(motion.dq)
    return replace(motion, q=positions.of(motion.q, zero=True), dq=dq)


def motion_of_arrays(t: object, q: object, dq: object | None = None) -> RecordedMotion:
    """The motion in arrays: (N,) s, (N, n) rad and, if given, (N, n) rad/s."""
    given = {"t": _numbers(t, "t"), "q": _numbers(q, "q"), **({} if dq is None else {"dq": _numbers(dq, "dq")})}
    shape, columns = given["q"].shape, dict[str, Column]()
    for kind, values in given.items():
        if len(shape) != 2 or values.shape != (shape[:1] if kind == "t" else shape):
            what = f"{kind} has shape {values.shape}, but q has shape {shape}"
            raise InputError(what, GIVEN, "give t (N,), and q and dq (N, n)")
        named = zip(["t"] if kind == "t" else numbered(kind, shape[1]), np.atleast_2d(values.T), strict=True)
        columns |= {name: Column(name, column) for name, column in named}
    table = check(Table(columns, GIVEN, rows_of(GIVEN)))
    if not (np.diff(table.t) > 0.0).all():
        raise InputError("t does not increase from row to row", GIVEN, "give increasing times")
    return _recorded(table, table.block("q"), 1.0)


def _recorded(table: Table, q: Array, angle: float) -> RecordedMotion:
    dq = table.block("dq", angle) if "dq1" in table.columns else None
    return RecordedMotion(table.t, q, dq, table.source)


def _numbers(values: object, name: str) -> Array:
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} holds values that are not numbers", GIVEN, "give numbers") from None
