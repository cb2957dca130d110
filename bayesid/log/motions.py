"""Motions without efforts: what a planner wrote or a controller recorded, of which efforts are to be predicted."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bayesid.arrays import Array, Integers, Labels, frozen
from bayesid.errors import InputError
from bayesid.files.tables import numbered
from bayesid.log.formats import Column, Options, Table, read_table
from bayesid.log.formats.memory import Variables, read_variables
from bayesid.log.formats.table import check, rows_of
from bayesid.log.log import Log, angle_unit
from bayesid.motion import labels, unlabelled

GIVEN = "the motion"
"""What messages call a motion that is no file."""


@dataclass(frozen=True)
class RecordedMotion:
    """Positions over time as recorded or planned: no filter, no resampling.

    Attributes:
        t: (N,) time, s, non-decreasing.
        q: (N, n) joint positions, rad (m for a prismatic joint).
        dq: (N, n) joint velocities, rad/s, or None.
        source: where it came from, for messages.
        payload: (N,) label of what the flange carries, or one for all; empty where it carries nothing.
    """

    t: Array
    q: Array
    dq: Array | None = None
    source: str = GIVEN
    payload: Labels = field(default_factory=unlabelled)

    def __post_init__(self) -> None:
        q = frozen(self.q, (None, None), "q")
        object.__setattr__(self, "q", q)
        object.__setattr__(self, "t", frozen(self.t, (q.shape[0],), "t"))
        if self.dq is not None:
            object.__setattr__(self, "dq", frozen(self.dq, q.shape, "dq"))
        object.__setattr__(self, "payload", labels(self.payload, q.shape[0]))

    def rows(self, kept: Integers) -> RecordedMotion:
        """Some rows, in ascending order; the motion itself where these are all: long ones are not copied."""
        if len(kept) == len(self.t):
            return self
        dq = None if self.dq is None else self.dq[kept]
        return RecordedMotion(self.t[kept], self.q[kept], dq, self.source, self.payload[kept])


def read_motion(
    path: str | Path,
    *,
    degrees: bool | None = None,
    columns: Mapping[str, str] | None = None,
    topic: str | None = None,
    joints: Sequence[str] | None = None,
) -> RecordedMotion:
    """Reads and checks a motion in one of the formats of logs; efforts may be there, and are left out.

    Args:
        path: the file, or a folder that is a recording.
        degrees: as for `bayesid.read_log`.
        columns: as for `bayesid.read_log`.
        topic: as for `bayesid.read_log`.
        joints: as for `bayesid.read_log`.

    Raises:
        InputError: the file, a row, a column or an option cannot be used.

    Example:
        >>> bayesid.read_motion("motion.csv").q.shape
        (201, 3)
    """
    table = read_table(Path(path), Options(topic=topic, joints=joints, columns=columns, motion=True))
    for note in table.notes:
        warnings.warn(note, stacklevel=2)
    return _recorded(table, angle_unit(table, degrees))


def motion_of_log(log: Log) -> RecordedMotion:
    """What a log holds beside efforts."""
    return RecordedMotion(log.t, log.q, log.dq, log.source, log.payload)


def motion_of_variables(source: Variables) -> RecordedMotion:
    """The motion in a data frame, a structured array or a dict of arrays; names and units as in a log's header.

    Raises:
        InputError: a column is missing, or a value cannot be used.
    """
    table = read_variables(source, Options(motion=True))
    return _recorded(table, angle_unit(table, None))


def motion_of_arrays(t: object, q: object, dq: object | None = None) -> RecordedMotion:
    """The motion in arrays: (N,) s, (N, n) rad and, if they are given, (N, n) rad/s.

    Raises:
        InputError: their shapes do not belong together, or a value cannot be used.
    """
    given = {"t": _numbers(t, "t"), "q": _numbers(q, "q"), **({} if dq is None else {"dq": _numbers(dq, "dq")})}
    shape = given["q"].shape
    for name, values in given.items():
        expected = shape[:1] if name == "t" else shape
        if len(shape) != 2 or values.shape != expected:
            said = f"{name} has shape {values.shape} beside q of {shape}"
            raise InputError(said, GIVEN, "give t (N,), and q and dq (N, n)")
    columns = {"t": Column("t", given["t"])}
    for kind in ("q", "dq"):
        if kind in given:
            names = numbered(kind, shape[1])
            columns |= {name: Column(name, column) for name, column in zip(names, given[kind].T, strict=True)}
    return _recorded(check(Table(columns, GIVEN, rows_of(GIVEN))), 1.0)


def _recorded(table: Table, angle: float) -> RecordedMotion:
    dq = table.block("dq", angle) if "dq1" in table.columns else None
    return RecordedMotion(table.t, table.block("q", angle), dq, table.source)


def _numbers(values: object, name: str) -> Array:
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} holds something else than numbers", GIVEN, "give numbers") from None
