"""Rows of a text stream in SI units, with the names, units and gains of a log."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from itertools import chain
from typing import NamedTuple, Protocol

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.log.corrections import corrections
from bayesid.log.formats.encodings import MAGNITUDE, TWOS_64, WIDE, Encoding
from bayesid.log.formats.labels import kind_part, slides
from bayesid.log.formats.table import (
    DEGREE,
    DIRECTION,
    FRACTION,
    Column,
    Options,
    SourceColumn,
    Table,
    of_64_bits,
    rows_of,
)
from bayesid.log.formats.text import CsvFile, Layout, clock_seconds, layout_of, select_columns
from bayesid.log.gains import Gains
from bayesid.log.reading import angle_unit, gains_of_table, signed_joints
from bayesid.log.tuning import TUNING
from bayesid.log.velocities import LiveTurns


class Stream(Protocol):
    """A source of text lines."""

    def readline(self, most: int, /) -> bytes:
        """The next line, or at most that many bytes of it; empty at the end."""


class Row(NamedTuple):
    """A sample: s; (n,) rad (m); (n,) N m with the recorded signs, nan where unknown; (n,) rad/s or None."""

    t: float
    q: Array
    effort: Array
    dq: Array | None


class RowReader:
    """Samples of a text stream, one by one: a header, then one row per line.

    Arguments are as for `bayesid.read_log`. All joints are unsigned by default unless an encoding holds the signs.
    Wrapped angles are unwrapped as they arrive.

    Attributes:
        signed: (n,) which joints are signed.
        assumed: whether the signed joints were assumed, not stated.
        notes: assumptions, one sentence each.
        bad: number of invalid rows so far.

    Raises:
        InputError: it does not begin with a log's header, or an option is not valid.
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
        self._layout, self._lines = _layout_of_stream(_lines_of(stream, source), source)
        self._columns, self.notes, _ = select_columns(self._layout, source, options or Options())
        self._source, self._degrees, self.bad = source, degrees, 0
        names = [column.name for column in self._columns]
        unit_table = self._table(np.ones(len(names)))
        self.n_joints = n = unit_table.n_joints
        self.signed, self.assumed = signed_joints(np.zeros((1, n)), unsigned, n), unsigned is None
        effort = "tau" if "tau1" in names else "i"
        angle, made_with = (DEGREE if degrees else 1.0), gains_of_table(unit_table, gains)
        units = {"q": unit_table.block("q", angle), effort: unit_table.block(effort) * made_with.value}
        if "dq1" in names:
            units["dq"] = unit_table.block("dq", angle)
        self._blocks = {}
        for kind, unit in units.items():
            self._blocks[kind] = [names.index(f"{kind}{j}") for j in range(1, n + 1)], unit[0]
        self._encoding = Encoding.parse((options or Options()).encoding or MAGNITUDE)
        self._directions = self._places_of_directions(names, (options or Options()).encoding)
        if unsigned is None and self._encoding.kind != MAGNITUDE:
            self.signed, self.assumed = np.ones(n, dtype=bool), False
        self._corrected = None if correct is None else corrections(correct, n)
        self._effort = effort
        self._clocks = [k for k, name in enumerate(names) if name in ("t", FRACTION)]
        self._seconds = np.array(
            [unit_table.columns[names[k]].si(1e-9 if names[k] == FRACTION else 1.0)[0] for k in self._clocks]
        )
        self._farthest = np.zeros(len(names))
        self._before = np.full(n, np.nan)
        self._open = np.array([unit_table.columns[f"q{j}"].unit is None for j in range(1, n + 1)]) & (degrees is None)
        self._turns = LiveTurns(np.array([not slides(unit_table.columns[f"q{j}"].label) for j in range(1, n + 1)]))

    def __iter__(self) -> Iterator[Row | None]:
        """Each sample as soon as its line arrives; None for an invalid row.

        Raises:
            InputError: positions must be in degrees, but no unit is stated.
        """
        for line in self._lines:
            try:
                cells = self._layout.cells(line.decode(self._layout.encoding))
                if not cells:
                    continue
                if len(cells) != len(self._layout.header):
                    raise ValueError("another number of cells")
                numbers = [self._number(cells[column.place], column) for column in self._columns]
                values = self._decoded(np.array(numbers))
            except InputError:
                raise
            except (OverflowError, ValueError):  # and letters
                self.bad += 1
                yield None
                continue
            yield self._row(values)

    def _number(self, cell: str, column: SourceColumn) -> float:
        if column.clock:
            return clock_seconds(cell)
        value = float(cell) if cell else np.nan
        if "_" in cell:
            raise ValueError("no number")
        if value >= WIDE and self._encoding == TWOS_64 and kind_part(column.name) == self._effort:
            return float(of_64_bits([int(cell)])[0])
        return value

    def _places_of_directions(self, names: Sequence[str], stated: str | None) -> list[int]:
        """Places of the direction columns of all joints, if they are used; else empty."""
        places = [names.index(f"{DIRECTION}{j}") for j in range(1, self.n_joints + 1) if f"{DIRECTION}{j}" in names]
        if places and stated is None:
            remedy = f"give the negative direction with `encoding`, as in direction:1 or direction:-1, or {MAGNITUDE}"
            raise InputError("has direction columns, whose meaning is not stated", self._source, remedy)
        if not places and self._encoding.kind == "direction":
            remedy = f"name columns direction1, direction2, .., or give `encoding` {MAGNITUDE}"
            raise InputError("has no direction columns", self._source, remedy)
        return places if self._encoding.kind == "direction" else []

    def _decoded(self, values: Array) -> Array:
        """A row's numbers with the signs of its efforts; ValueError if they are not plausible.

        InputError if encoded efforts are negative already.
        """
        places = self._blocks[self._effort][0]
        if self._directions:
            values[places] = self._encoding.directed(values[places], values[self._directions])
        elif self._encoding not in (Encoding(MAGNITUDE), TWOS_64):
            if (values[places] < 0.0).any():
                what = f"has negative efforts, which cannot hold {self._encoding.description}"
                raise InputError(what, self._source, f"correct `encoding`, or give {MAGNITUDE}")
            values[places] = self._encoding.decoded(values[places])
        if (np.abs(np.delete(values, self._clocks)) >= TUNING.largest_reading).any():
            raise ValueError("numbers out of range")
        return values

    def _row(self, values: Array) -> Row:
        t = float(values[self._clocks] @ self._seconds)
        blocks = {kind: values[places] * unit for kind, (places, unit) in self._blocks.items()}
        if self._degrees is None and np.nanmax(np.abs(blocks["q"]), initial=0.0) > TUNING.few_turns:
            self._farthest = np.fmax(self._farthest, np.abs(values))
            angle_unit(self._table(self._farthest), None)
        jumped = self._open & (np.abs(DEGREE * np.abs(blocks["q"] - self._before) - 2.0 * np.pi) < TUNING.wrap_slack)
        if jumped.any():
            joint = int(np.argmax(jumped)) + 1
            remedy = f"write the unit in the header, as in q{joint}[deg]"
            raise InputError(f"positions of joint {joint} jump by 360, as wrapped degrees do", self._source, remedy)
        self._before, blocks["q"] = blocks["q"], self._turns.unwrapped(t, blocks["q"])
        if self._corrected is not None:
            positions, efforts = self._corrected
            for kind, values_of in blocks.items():
                corrected = efforts if kind == self._effort else positions
                blocks[kind] = corrected.of(values_of[None], zero=kind == "q")[0]
        return Row(t, blocks["q"], blocks[self._effort], blocks.get("dq"))

    def _table(self, values: Array) -> Table:
        pairs = zip(self._columns, values, strict=True)
        columns = {column.name: Column(column.label, value[None], column.unit) for column, value in pairs}
        return Table(columns, self._source, rows_of(self._source), self.notes)


def _lines_of(stream: Stream, source: str) -> Iterator[bytes]:
    while line := stream.readline(TUNING.header_bytes):
        if len(line) == TUNING.header_bytes:
            raise InputError(f"has a line of {TUNING.header_bytes:,} bytes", source, "give one row per line")
        yield line


def _layout_of_stream(lines: Iterator[bytes], source: str) -> tuple[Layout, Iterator[bytes]]:
    """The layout of a stream's rows, from its header and units; and the lines read for it."""
    head: list[bytes] = []
    layout = Layout("utf-8")
    for line in lines:
        if head or line.strip():
            head.append(line)
        try:
            layout = layout_of(b"".join(head), whole=False)
        except (UnicodeDecodeError, csv.Error):
            raise InputError("is not text", source, "give CSV, one row per line") from None
        if layout.encoding not in ("utf-8", "utf-8-sig", "cp1252"):  # the encodings whose line end is one byte
            raise InputError(
                f"is {layout.encoding.upper()}, which cannot be read as a stream", source, "convert it to UTF-8"
            )
        if layout.first or len(head) == 3:
            break
    return layout, chain(head[layout.rows :], lines)
