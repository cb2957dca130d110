"""Parquet files, with the same names of columns as a CSV log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bayesid.errors import InputError
from bayesid.motion import Array
from bayesid.recordings.names import choose
from bayesid.recordings.table import Column, Table, rows_of, seconds

if TYPE_CHECKING:
    import pyarrow

_TICKS = {"s": 1, "ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000}
"""A second's, by the unit of a time."""


def read(path: Path) -> Table:
    """Reads the columns of a log; a time may be a timestamp or a duration.

    Raises:
        InputError: it is damaged, a column is missing or holds no numbers, or a value is missing.
        OSError: it cannot be opened.
    """
    import pyarrow
    from pyarrow import parquet

    try:
        file = parquet.ParquetFile(path)
        chosen = choose(file.schema_arrow.names, str(path))
        columns = file.read([one.label for one in chosen])
    except (pyarrow.ArrowException, pyarrow.ArrowInvalid, OSError) as error:
        if isinstance(error, FileNotFoundError):
            raise
        raise InputError(f"is damaged ({_first_line(error)})", str(path), "write it again") from None
    found = {}
    for one in chosen:
        column = columns.column(one.label)
        where = f"{path}, column {one.label}"
        if column.null_count:
            row = int(np.flatnonzero(column.is_null().to_numpy())[0])
            said = f"column {one.label} holds no value"
            raise InputError(said, rows_of(str(path))(row), "remove the row or give the value")
        values, told = _numbers(column, one.name == "t", where)
        found[one.name] = Column(one.label, values, 1.0 if told else one.unit)
    return Table(found, str(path), rows_of(str(path)))


def _numbers(column: pyarrow.ChunkedArray, is_time: bool, where: str) -> tuple[Array, bool]:
    """A column's numbers, and whether its type says that they are s."""
    import pyarrow

    kind = column.type
    if is_time and (pyarrow.types.is_timestamp(kind) or pyarrow.types.is_duration(kind)):
        return seconds(column.cast(pyarrow.int64()).to_numpy(), _TICKS[kind.unit]), True
    if pyarrow.types.is_integer(kind) or pyarrow.types.is_floating(kind) or pyarrow.types.is_decimal(kind):
        return np.asarray(column.cast(pyarrow.float64(), safe=False).to_numpy(), dtype=float), False
    raise InputError(f"holds {kind}, not numbers", where, "write it as floats")


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
