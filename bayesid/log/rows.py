"""Samples of a stream of text: its rows in SI units, by the same names, units and gains as those of a log."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from itertools import chain
from typing import NamedTuple, Protocol

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.log.corrections import corrections
from bayesid.log.formats.encodings import MAGNITUDE, Encoding
from bayesid.log.formats.table import DEGREE, Column, Options, SourceColumn, Table, rows_of
from bayesid.log.formats.text import CsvFile, Layout, clock_seconds, look, select_columns
from bayesid.log.gains import Gains
from bayesid.log.reading import angle_unit, gains_of_table, signed_joints
from bayesid.log.tuning import TUNING


class Stream(Protocol):
    """What gives lines of text."""

    def readline(self, most: int, /) -> bytes:
        """The next line, or so many bytes of it; empty at the end."""


class Row(NamedTuple):
    """A sample: s; (n,) rad (m); (n,) N m with the signs that were written, nan where none was; (n,) rad/s or None."""

    t: float
    q: Array
    effort: Array
    dq: Array | None


class RowReader:
    """Samples of a stream of text, one after the other: a header, then one row a line.

    Arguments are as `bayesid.read_log` takes them; all joints are unsigned by default, as nobody knows what is to come.

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
        correct: str | None = None,
    ) -> None:
        CsvFile().check_options(options or Options(), source)
        self._layout, self._lines = _look_at(_lines_of(stream, source), source)
        self._columns, self.notes, _ = select_columns(self._layout, source, options or Options())
        self._source, self._degrees, self.bad = source, degrees, 0
        names = [column.name for column in self._columns]
        one = self._table(np.ones(len(names)))
        self.n_joints = n = one.n_joints
        self.signed, self.assumed = signed_joints(np.zeros((1, n)), unsigned, n), unsigned is None
        effort = "tau" if "tau1" in names else "i"
        angle, made_with = (DEGREE if degrees else 1.0), gains_of_table(one, gains)
        units = {"q": one.block("q", angle), effort: one.block(effort) * made_with.value}
        if "dq1" in names:
            units["dq"] = one.block("dq", angle)
        self._blocks = {}
        for kind, unit in units.items():
            self._blocks[kind] = [names.index(f"{kind}{j}") for j in range(1, n + 1)], unit[0]
        self._encoding = Encoding.parse((options or Options()).encoding or MAGNITUDE)
        self._corrected = None if correct is None else corrections(correct, n)
        self._time, self._second, self._effort = names.index("t"), float(one.t[0]), effort
        self._farthest = np.zeros(len(names))

    def __iter__(self) -> Iterator[Row | None]:
        """Each sample as soon as its line is there; None in place of a row that is none.

        Raises:
            InputError: positions can only be degrees, and nobody has said so.
        """
        for line in self._lines:
            try:
                cells = self._layout.cells(line.decode(self._layout.encoding))
                if not cells:
                    continue
                if len(cells) != len(self._layout.header):
                    raise ValueError("another number of cells")
                values = np.array([self._number(cells[one.place], one) for one in self._columns])
            except ValueError:  # and letters that are none
                self.bad += 1
                yield None
                continue
            yield self._row(values)

    def _number(self, cell: str, column: SourceColumn) -> float:
        if column.clock:
            return clock_seconds(cell)
        value = float(cell) if cell else np.nan
        if "_" in cell or (column.name != "t" and abs(value) >= TUNING.absurd):
            raise ValueError("no number of this world")
        return value

    def _row(self, values: Array) -> Row:
        values = np.array(values)
        places = self._blocks[self._effort][0]
        values[places] = self._encoding.decoded(values[places])
        blocks = {kind: values[places] * unit for kind, (places, unit) in self._blocks.items()}
        if self._degrees is None and np.nanmax(np.abs(blocks["q"]), initial=0.0) > TUNING.few_turns:
            self._farthest = np.fmax(self._farthest, np.abs(values))
            angle_unit(self._table(self._farthest), None)
        if self._corrected is not None:
            positions, efforts = self._corrected
            for kind, values_of in blocks.items():
                corrected = efforts if kind == self._effort else positions
                blocks[kind] = corrected.of(values_of[None], zero=kind == "q")[0]
        t = float(values[self._time]) * self._second
        return Row(t, blocks["q"], blocks[self._effort], blocks.get("dq"))

    def _table(self, values: Array) -> Table:
        pairs = zip(self._columns, values, strict=True)
        columns = {one.name: Column(one.label, value[None], one.unit) for one, value in pairs}
        return Table(columns, self._source, rows_of(self._source), self.notes)


def _lines_of(stream: Stream, source: str) -> Iterator[bytes]:
    while line := stream.readline(TUNING.header_bytes):
        if len(line) == TUNING.header_bytes:
            raise InputError(f"has a line of {TUNING.header_bytes:,} bytes", source, "give one row a line")
        yield line


def _look_at(lines: Iterator[bytes], source: str) -> tuple[Layout, Iterator[bytes]]:
    """How the rows of a stream are to be read, by its header and the units beneath it; and the lines that hold them."""
    head: list[bytes] = []
    layout = Layout("utf-8")
    for line in lines:
        if head or line.strip():
            head.append(line)
        try:
            layout = look(b"".join(head), whole=False)
        except (UnicodeDecodeError, csv.Error):
            raise InputError("is not text", source, "give CSV, one row a line") from None
        if layout.encoding not in ("utf-8", "utf-8-sig", "cp1252"):  # where a line ends with one byte
            raise InputError(f"is {layout.encoding.upper()}, which cannot be followed", source, "give it as UTF-8")
        if layout.first or len(head) == 3:
            break
    return layout, chain(head[layout.rows :], lines)
