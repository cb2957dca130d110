"""Samples of a stream of text: its rows in SI units, by the same names, units and gains as those of a log."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple, Protocol

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.log.formats.base import Options
from bayesid.log.formats.names import choose
from bayesid.log.formats.table import DEGREE, Column, SourceColumn, Table, rows_of
from bayesid.log.formats.text import CsvFile, Layout, clock_seconds, look, select_columns
from bayesid.log.gains import Gains
from bayesid.log.reading import angle_unit, gains_of_table, signed_joints
from bayesid.log.tuning import TUNING

_FOLLOWED = "utf-8", "utf-8-sig", "cp1252"
"""Encodings in which a line ends with the byte of a line's end."""


class Stream(Protocol):
    """What gives lines of text."""

    def readline(self, most: int, /) -> bytes:
        """The next line, or so many bytes of it; empty at the end."""


@dataclass(frozen=True)
class TextRows:
    """How a line becomes numbers: the K columns that make a log, and the place of a time that is a time of day."""

    layout: Layout
    chosen: tuple[SourceColumn, ...]
    clock: int | None
    source: str
    notes: tuple[str, ...]

    def values(self, line: bytes) -> Array | None:
        """(K,) what a line holds in the columns, an empty cell as nan; None where it is blank, or a remark.

        Raises:
            ValueError: it is no row of the table, or holds what is no number of this world.
        """
        cells = self.layout.cells(line.decode(self.layout.encoding))
        if not cells:
            return None
        if len(cells) != len(self.layout.header):
            raise ValueError("another number of cells")
        return np.array([self._number(cells[one.place], one) for one in self.chosen])

    def _number(self, cell: str, column: SourceColumn) -> float:
        if column.place == self.clock:
            return clock_seconds(cell)
        if "_" in cell:
            raise ValueError("no number")
        value = float(cell) if cell else np.nan
        if column.name != "t" and abs(value) >= TUNING.absurd:
            raise ValueError("no number of this world")
        return value

    def table(self, values: Array) -> Table:
        """A table of rows (N, K)."""
        units = {one.name: 1.0 if one.place == self.clock else one.unit for one in self.chosen}
        named = zip(self.chosen, values.T, strict=True)
        columns = {one.name: Column(one.label, column, units[one.name]) for one, column in named}
        return Table(columns, self.source, rows_of(self.source), self.notes)


def lines_of(stream: Stream, source: str) -> Iterator[bytes]:
    """The lines of a stream as soon as each is there; InputError where one is longer than any of a log."""
    while line := stream.readline(TUNING.header_bytes):
        if len(line) == TUNING.header_bytes:
            raise InputError(f"has a line of {TUNING.header_bytes:,} bytes", source, "give one row a line")
        yield line


def follow_rows(lines: Iterator[bytes], options: Options, source: str) -> tuple[TextRows, Iterator[bytes]]:
    """How the rows of a stream are to be read, by its header and the units beneath it; and the lines that hold them."""
    CsvFile().check_options(options, source)
    head: list[bytes] = []
    layout = Layout("utf-8")
    for line in lines:
        if head or line.strip():
            head.append(line)
        layout = _layout(head, source)
        if layout.first or len(head) == 3:
            break
    selected, clock = select_columns(layout, source, lambda header, where: choose(header, where, options))
    rows = TextRows(layout, selected.columns, clock, source, selected.notes)
    return rows, chain(head[layout.rows :], lines)


def _layout(head: list[bytes], source: str) -> Layout:
    try:
        layout = look(b"".join(head))
    except (UnicodeDecodeError, csv.Error):
        raise InputError("is not text", source, "give CSV, one row a line") from None
    if layout.encoding not in _FOLLOWED:
        raise InputError(f"is {layout.encoding.upper()}, which cannot be followed", source, "give it as UTF-8")
    return layout


class Row(NamedTuple):
    """A sample: s; (n,) rad (m); (n,) N m with the signs that were written, nan where none was; (n,) rad/s or None."""

    t: float
    q: Array
    effort: Array
    dq: Array | None


class RowReader:
    """Samples of a stream, one after the other.

    Args:
        stream: of text: a header, then one row a line.
        source: what messages call it.
        gains: as `bayesid.read_log` takes them.
        unsigned: "all", "none" or joints as in "1,3"; all by default, as nobody knows what is to come.
        degrees: whether positions and velocities are in degrees where the header does not say their unit.
        options: what else a user has said about the columns.

    Attributes:
        signed: (n,) which joints are.
        assumed: whether nobody has said which.
        notes: what had to be assumed, a sentence each.
        bad: rows that were none so far.

    Raises:
        InputError: it begins with no header of a log, or an option cannot be used.
    """

    def __init__(
        self,
        stream: Stream,
        source: str,
        gains: Sequence[float] | Gains | str | None = None,
        unsigned: str | None = None,
        degrees: bool | None = None,
        options: Options | None = None,
    ) -> None:
        self._text, self._lines = follow_rows(lines_of(stream, source), options or Options(), source)
        self._degrees, self.notes, self.bad = degrees, self._text.notes, 0
        names = [column.name for column in self._text.chosen]
        one = self._text.table(np.ones((1, len(names))))
        self.n_joints = n = one.n_joints
        self.signed, self.assumed = signed_joints(np.zeros((1, n)), unsigned, n), unsigned is None
        effort = "tau" if "tau1" in names else "i"
        angle, made_with = (DEGREE if degrees else 1.0), gains_of_table(one, gains)
        self._places = {kind: [names.index(f"{kind}{j}") for j in range(1, n + 1)] for kind in ("q", effort)}
        self._units = {"q": one.block("q", angle)[0], effort: one.block(effort)[0] * made_with.value}
        self._time, self._unit, self._effort = names.index("t"), float(one.t[0]), effort
        self._velocities = "dq1" in names
        if self._velocities:
            self._places["dq"] = [names.index(f"dq{j}") for j in range(1, n + 1)]
            self._units["dq"] = one.block("dq", angle)[0]
        self._farthest = np.zeros(len(names))

    def __iter__(self) -> Iterator[Row | None]:
        """Each sample as soon as its line is there; None in place of a row that is none.

        Raises:
            InputError: positions can only be degrees, and nobody has said so.
        """
        for line in self._lines:
            try:
                values = self._text.values(line)
            except ValueError:  # and letters that are none
                self.bad += 1
                yield None
                continue
            if values is not None:
                yield self._row(values)

    def _row(self, values: Array) -> Row:
        q = self._block("q", values)
        if np.nanmax(np.abs(q), initial=0.0) > TUNING.few_turns and self._degrees is None:
            self._farthest = np.fmax(self._farthest, np.abs(values))
            angle_unit(self._text.table(self._farthest[None]), None)
        dq = self._block("dq", values) if self._velocities else None
        return Row(float(values[self._time]) * self._unit, q, self._block(self._effort, values), dq)

    def _block(self, kind: str, values: Array) -> Array:
        block: Array = values[self._places[kind]] * self._units[kind]
        return block
