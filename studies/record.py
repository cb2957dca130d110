"""Rows of a study on disk: rows.parquet, and timings.parquet with the values that differ from run to run.

Both are written under another name and then renamed, so they can be read at any time. Writing takes at most 2 % of the
time: after a kill the last few rows of short trials may be missing.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bayesid.errors import InputError, missing
from bayesid.files.writing import check_place

try:
    import pyarrow as pa
    from pyarrow import parquet
except ImportError:
    raise missing("pyarrow", "parquet", "the rows of a study") from None

Row = dict[str, Any]
KEY = "trial"
TIMINGS = "timings"
_FILE = "rows.parquet"
_SHARE = 50.0
"""Time between two writings over the time of one: writing takes at most 2 % of a study."""
_REMEDY = "give `folder` a new folder"


class MisfitError(ValueError):
    """A row's values do not fit the columns of the rows before it."""


class Record:
    """Rows by trial, on disk.

    Args:
        folder: of the files.
        marks: what all rows have in common, such as the study's name; stored in the files.
        resume: whether existing rows are kept.

    Raises:
        InputError: the folder holds rows without `resume`, or of another study, or cannot be written.
    """

    def __init__(self, folder: Path, marks: Mapping[str, str], resume: bool) -> None:
        self._folder, self._marks = folder, marks
        self._tables = {name: _Table() for name in (TIMINGS, "rows")}  # timings first: they are never fewer than rows
        self._written, self._took, self._pending = -float("inf"), 0.0, False
        check_place(folder / _FILE)
        if (folder / _FILE).exists():
            self._take_over(resume)

    @property
    def rows(self) -> Mapping[int, Row]:
        """Rows by trial."""
        return self._tables["rows"].rows

    def add(self, row: Row, timings: Row) -> None:
        """Adds a row and its timings.

        Raises:
            MisfitError: the row does not fit the columns of the others; nothing was added.
        """
        self._tables["rows"].add(row)
        self._tables[TIMINGS].add({KEY: row[KEY], **timings})
        self._pending = True

    def forget(self, trials: Sequence[int]) -> None:
        """Removes rows, so that their trials run again."""
        for table in self._tables.values():
            for trial in trials:
                table.rows.pop(trial, None)

    def save(self, now: bool = False) -> None:
        """Writes new rows if the last writing was long enough ago, or `now`."""
        began = time.perf_counter()
        if not self._pending or (not now and began - self._written < _SHARE * self._took):
            return
        self._folder.mkdir(parents=True, exist_ok=True)
        for name, table in self._tables.items():
            table.write(self._folder / f"{name}.parquet", self._marks)
        self._written, self._pending = time.perf_counter(), False
        self._took = self._written - began

    def _take_over(self, resume: bool) -> None:
        rows, marks = _read(self._folder / _FILE)
        if not resume:
            message, remedy = f"holds {len(rows)} rows of an earlier run", f"continue with `resume`, or {_REMEDY}"
            raise InputError(message, str(self._folder / _FILE), remedy)
        for key, value in self._marks.items():
            if marks.get(key) != value:
                message = f"holds rows of {key} {marks.get(key, 'unknown')}, not {value}"
                raise InputError(message, str(self._folder / _FILE), _REMEDY)
        for name, table in self._tables.items():
            path = self._folder / f"{name}.parquet"
            for row in _read(path)[0] if path.exists() else []:
                table.add(row)


class _Table:
    """Rows by trial, and columns that fit them all."""

    def __init__(self) -> None:
        self.rows: dict[int, Row] = {}
        self._schema = pa.schema([])

    def add(self, row: Row) -> None:
        """Widens columns where needed: from integers to floats, from empty lists to lists of a type."""
        try:
            row_schema = pa.Table.from_pylist([row]).schema
            schema = pa.unify_schemas([self._schema, row_schema], promote_options="permissive")
            if schema == self._schema:
                pa.Table.from_pylist([row], schema=schema)
            else:  # wider columns must fit the earlier rows too, and a file must fit the columns
                content = pa.Table.from_pylist([*self.rows.values(), row], schema=schema)
                parquet.write_table(content, pa.BufferOutputStream())
        except (pa.ArrowException, OverflowError, UnicodeError) as error:
            raise MisfitError(str(error)) from error
        self._schema = schema
        self.rows[row[KEY]] = row

    def write(self, path: Path, marks: Mapping[str, str]) -> None:
        ordered = [self.rows[trial] for trial in sorted(self.rows)]
        content = pa.Table.from_pylist(ordered, schema=self._schema.with_metadata(dict(marks)))
        aside = path.with_name(f".{path.name}.part")  # overwrites that of a killed run
        try:
            parquet.write_table(content, aside)
            aside.replace(path)
        finally:
            aside.unlink(missing_ok=True)


def read_rows(folder: str | Path) -> list[Row]:
    """Rows of a study in the order of its trials, each with its timings under "timings".

    Raises:
        InputError: they cannot be read.
    """
    rows, _ = _read(Path(folder) / _FILE)
    path = Path(folder) / f"{TIMINGS}.parquet"
    timings = {row[KEY]: row for row in (_read(path)[0] if path.exists() else [])}
    return [{**row, TIMINGS: timings.get(row[KEY], {})} for row in rows]


def _read(path: Path) -> tuple[list[Row], dict[str, str]]:
    """Rows and marks of a file."""
    try:
        # not by path, which opens the file twice; no threads, which may outlive the interpreter and abort it
        table = parquet.ParquetFile(pa.BufferReader(path.read_bytes())).read(use_threads=False)
        rows: list[Row] = table.to_pylist()
        marks = {key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items()}
    except (OSError, pa.ArrowException, UnicodeError) as error:
        raise InputError(f"cannot be read ({str(error).splitlines()[0]})", str(path), _REMEDY) from None
    if any(KEY not in row for row in rows[:1]):
        raise InputError("holds no rows of a study", str(path), _REMEDY)
    return rows, marks
