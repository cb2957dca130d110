"""Rows of a table of text that come one after the other: its header is understood as a file's is."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass, fields
from itertools import chain
from typing import Protocol

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.log.formats.base import Options
from bayesid.log.formats.clocks import clock_seconds
from bayesid.log.formats.names import choose
from bayesid.log.formats.table import ABSURD, Column, SourceColumn, Table, rows_of
from bayesid.log.formats.text import CsvFile, Layout, look, select_columns

_LONGEST = 1 << 20
"""Bytes of a line: more than any has."""
_ENOUGH = 3
"""Lines that show how a table is written: the header, units beneath it, and the first row of values."""
_FOLLOWED = "utf-8", "utf-8-sig", "cp1252"
"""Encodings in which a line ends with the byte of a line's end."""


class Stream(Protocol):
    """What gives lines of text."""

    def readline(self, most: int, /) -> bytes:
        """The next line, or so many bytes of it; empty at the end."""


@dataclass(frozen=True)
class TextRows:
    """How a row's line becomes numbers.

    Attributes:
        layout: how the table is written.
        chosen: its columns that make a log, K of them.
        clock: the place of a time that is written as one of day; None where it is a number.
        source: the table, for messages.
        notes: what had to be assumed, a sentence each.
    """

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
        if column.name != "t" and abs(value) >= ABSURD:
            raise ValueError("no number of this world")
        return value

    def table(self, values: Array) -> Table:
        """A table of rows (N, K)."""
        units = {one.name: 1.0 if one.place == self.clock else one.unit for one in self.chosen}
        named = zip(self.chosen, values.T, strict=True)
        columns = {one.name: Column(one.label, column, units[one.name]) for one, column in named}
        return Table(columns, self.source, rows_of(self.source), self.notes)


def lines_of(stream: Stream, source: str) -> Iterator[bytes]:
    """The lines of a stream as soon as each is there.

    Raises:
        InputError: a line is longer than any of a log.
    """
    while line := stream.readline(_LONGEST):
        if len(line) == _LONGEST:
            raise InputError(f"has a line of {_LONGEST:,} bytes", source, "give one row a line")
        yield line


def follow_rows(lines: Iterator[bytes], options: Options, source: str) -> tuple[TextRows, Iterator[bytes]]:
    """How the rows of a stream are to be read, and the lines that hold them.

    The header is the first line; units may stand beneath it. It is understood when the first row of values is there.

    Args:
        lines: of the stream.
        options: what a user has said about it.
        source: the stream, for messages.

    Raises:
        InputError: it begins with no header of a log, or is written in a way that cannot be followed.
    """
    for field in fields(options):
        said = getattr(options, field.name) not in (None, False)
        if said and field.name not in {*CsvFile.options, "currents"}:
            raise InputError(f"is {CsvFile.name}, which has no {field.name}", source, f"leave `{field.name}` out")
    head: list[bytes] = []
    layout = Layout("utf-8")
    for line in lines:
        if head or line.strip():
            head.append(line)
        layout = _layout(head, source)
        if layout.first or len(head) == _ENOUGH:
            break
    selected, clock = select_columns(layout, source, lambda header, where: choose(header, where, **options.choice))
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
