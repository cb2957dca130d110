"""Tables as text: CSV with the names of a log's columns. Other tables of text build on `read_text`."""

from __future__ import annotations

import csv
import io
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TextIO

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.log.formats.base import Format, Options
from bayesid.log.formats.names import SourceColumn, choose
from bayesid.log.formats.table import Column, Table


class CsvFile(Format):
    """What no other format recognises."""

    name = "a CSV table"
    order = 2

    def recognises(self, path: Path, head: bytes) -> bool:
        """It is."""
        return True

    def read(self, path: Path, options: Options) -> Table:
        """The columns of a log."""
        return read_text(path, Dialect(), partial(choose, motion=options.motion))


@dataclass(frozen=True)
class Dialect:
    """How a file writes a table: what is between two columns, and between a number's units and tenths."""

    separator: str = ","
    decimal_comma: bool = False

    def lines(self, file: TextIO) -> Iterator[str]:
        """The file's lines, their numbers with decimal points."""
        return (line.replace(",", ".") for line in file) if self.decimal_comma else iter(file)

    def header(self, line: str) -> list[str]:
        """The names of the columns."""
        return [name.strip() for name in next(csv.reader([line], delimiter=self.separator), [])]


def first_line(head: bytes) -> str:
    """The first line of a file that begins with these bytes; what is no text in it is left out."""
    return io.StringIO(head.decode("utf-8-sig", errors="ignore"), newline="").readline()


def read_text(path: Path, dialect: Dialect, select: Callable[[Sequence[str], str], Sequence[SourceColumn]]) -> Table:
    """Reads a table of text.

    Args:
        path: the file.
        dialect: how it writes a table.
        select: the columns that make a log, of a header at a place that messages name.

    Raises:
        InputError: it is not text, or no such table.
        OSError: there is no such file, or it cannot be opened.
    """
    try:
        with _open(path) as file:
            header = dialect.header(file.readline())
        if not any(header):
            raise InputError("does not begin with a header", str(path), "begin it with t,q1..qn,tau1..taun")
        chosen = sorted(select(header, f"{path}, row 1"), key=lambda source: source.place)  # the first bad one is named
        values = _read_values(path, dialect, header, [source.place for source in chosen])
    except (UnicodeDecodeError, csv.Error):
        raise InputError("is not text", str(path), "give a CSV log") from None
    columns = {source.name: Column(source.label, values[:, source.place], source.unit) for source in chosen}
    return Table(columns, str(path), lambda row: _where(path, row))


def _open(path: Path) -> TextIO:
    return path.open(newline="", encoding="utf-8-sig")


def _read_values(path: Path, dialect: Dialect, header: list[str], used: list[int]) -> Array:
    """(N, columns) numbers of the used columns; the other columns come as 0."""
    ignored: dict[int | str, Callable[[str], float]] = {i: lambda _: 0.0 for i in range(len(header)) if i not in used}
    with _open(path) as file, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of a file without rows, which is refused later
        try:
            values: Array = np.loadtxt(
                dialect.lines(file),
                delimiter=dialect.separator,
                quotechar='"',
                comments=None,
                skiprows=1,
                ndmin=2,
                converters=ignored,
            )
        except UnicodeDecodeError:
            raise
        except ValueError:
            raise _first_bad_row(path, dialect, header, used) from None
    if len(values) == 0:
        return np.empty((0, len(header)))
    if values.shape[1] != len(header):
        said = f"has {len(header)} names for {values.shape[1]} columns"
        raise InputError(said, f"{path}, row 1", "give every column one name")
    return values


def _where(path: Path, row: int) -> str:
    """The file's line of a row of values: the header is row 1, and blank lines count."""
    with _open(path) as file:
        lines = [number for number, line in enumerate(file, start=1) if number > 1 and line.strip()]
    return f"{path}, row {lines[row]}"


def _first_bad_row(path: Path, dialect: Dialect, header: list[str], used: list[int]) -> InputError:
    """Why the table cannot be read, by a slow second look."""
    with _open(path) as file:
        for number, cells in enumerate(csv.reader(dialect.lines(file), delimiter=dialect.separator), start=1):
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
