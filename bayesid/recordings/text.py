"""Tables as text: CSV with the names of a log's columns, or those of a KUKA controller (`bayesid.recordings.kuka`)."""

from __future__ import annotations

import csv
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np

from bayesid.errors import InputError
from bayesid.motion import Array
from bayesid.recordings import kuka
from bayesid.recordings.names import Choice, choose
from bayesid.recordings.table import Column, Table


@dataclass(frozen=True)
class _Dialect:
    """How a file writes a table: what is between two columns, and between a number's units and tenths."""

    separator: str = ","
    decimal_comma: bool = False

    def lines(self, file: TextIO) -> Iterator[str]:
        """The file's lines, their numbers with decimal points."""
        return (line.replace(",", ".") for line in file) if self.decimal_comma else iter(file)

    def header(self, line: str) -> list[str]:
        """The names of the columns."""
        return [name.strip() for name in next(csv.reader([line], delimiter=self.separator), [])]


def read(path: Path) -> Table:
    """Reads a table of text.

    Raises:
        InputError: it is not text, or no such table.
        OSError: there is no such file, or it cannot be opened.
    """
    try:
        with _open(path) as file:
            line = file.readline()
        dialect = _dialect(line)
        header = dialect.header(line)
        if not any(header):
            raise InputError("does not begin with a header", str(path), "begin it with t,q1..qn,tau1..taun")
        select = kuka.choose if kuka.recognises(header) else choose
        chosen = select(header, f"{path}, row 1")
        values = _read_values(path, dialect, header, sorted(one.place for one in chosen))
    except (UnicodeDecodeError, csv.Error):
        raise InputError("is not text", str(path), "give a CSV log") from None
    columns = {one.name: Column(one.label, values[:, one.place], one.unit) for one in _in_order(chosen)}
    table = Table(columns, str(path), lambda row: _where(path, row))
    return kuka.check(table) if select is kuka.choose else table


def _in_order(chosen: Sequence[Choice]) -> list[Choice]:
    """As they stand in the file: of several bad values in a row the first is named."""
    return sorted(chosen, key=lambda one: one.place)


def _open(path: Path) -> TextIO:
    return path.open(newline="", encoding="utf-8-sig")


def _dialect(line: str) -> _Dialect:
    """By the file's header. Semicolons and tabs are KUKA's: with them it stays open what a comma is, so both are."""
    for separator in (";", "\t"):
        dialect = _Dialect(separator, decimal_comma=True)
        if separator in line and kuka.recognises(dialect.header(line)):
            return dialect
    return _Dialect()


def _read_values(path: Path, dialect: _Dialect, header: list[str], used: list[int]) -> Array:
    """(N, columns) numbers of the used columns; the other columns come as 0."""
    ignored: dict[int | str, Callable[[str], float]] = {i: lambda _: 0.0 for i in range(len(header)) if i not in used}
    with _open(path) as file, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of a file without rows, which is refused later
        try:
            values: Array = np.loadtxt(
                dialect.lines(file), delimiter=dialect.separator, quotechar='"', comments=None, skiprows=1, ndmin=2,
                converters=ignored,
            )  # fmt: skip
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


def _first_bad_row(path: Path, dialect: _Dialect, header: list[str], used: list[int]) -> InputError:
    """Why the table cannot be read, found by a slow second look."""
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
