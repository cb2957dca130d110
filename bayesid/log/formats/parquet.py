"""Parquet files, with the same names of columns as a CSV log; a column of lists holds all joints, as LeRobot's do."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError, missing
from bayesid.files.bounded import MOST_UNPACKED, fits_memory
from bayesid.log.formats.base import Format, Options
from bayesid.log.formats.names import choose
from bayesid.log.formats.table import Column, Table, rows_of, seconds

if TYPE_CHECKING:
    import pyarrow
    from pyarrow import parquet

_TICKS = {"s": 1, "ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000}
"""Ticks in a second, by the unit of a time."""


class ParquetFile(Format):
    """Columns named as in a CSV log; a time may be a timestamp or a duration."""

    name = "a Parquet file"
    magic = (b"PAR1",)
    options = frozenset({"columns"})

    def read(self, path: Path, options: Options) -> Table:
        """The columns of a log."""
        return _read(path, options)


class _Place(NamedTuple):
    """A column of numbers: the file's column, and its place in that column's lists, if there are lists."""

    column: str
    place: int | None = None


def _read(path: Path, options: Options) -> Table:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise missing("pyarrow", "parquet", str(path)) from None
    try:
        file = parquet.ParquetFile(path)
        places = _places(file, str(path))
        chosen, notes = choose(list(places), str(path), options)
        names = list(dict.fromkeys(places[source.label].column for source in chosen))
        _check_size(file, names, str(path))
        columns = file.read(names)
    except (pyarrow.ArrowException, pyarrow.ArrowInvalid, OSError) as error:
        if isinstance(error, FileNotFoundError):
            raise
        raise InputError(f"is damaged ({_first_line(error)})", str(path), "write it again") from None
    read = {}
    for source in chosen:
        column = _column(columns, places[source.label])
        where = f"{path}, column {source.label}"
        if column.null_count:
            row = int(np.flatnonzero(column.is_null().to_numpy())[0])
            said = f"column {source.label} holds no value"
            raise InputError(said, rows_of(str(path))(row), "remove the row or give the value")
        values, in_seconds = _numbers(column, source.name == "t", where)
        read[source.name] = Column(source.label, values, 1.0 if in_seconds else source.unit)
    return Table(read, str(path), rows_of(str(path)), notes)


def _places(file: parquet.ParquetFile, where: str) -> dict[str, _Place]:
    """Where the file holds its columns; of lists of numbers each place is one, counted from 1: state1, state2, ..."""
    from pyarrow import types

    places: dict[str, _Place] = {}
    for field in file.schema_arrow:
        is_list = types.is_list(field.type) or types.is_large_list(field.type) or types.is_fixed_size_list(field.type)
        if is_list and types.is_floating(field.type.value_type):
            _check_size(file, [field.name], where)
            width = _width(file.read([field.name]).column(field.name), f"{where}, column {field.name}")
            places |= {f"{field.name}{k + 1}": _Place(field.name, k) for k in range(width)}
        else:
            places[field.name] = _Place(field.name)
    return places


def _check_size(file: parquet.ParquetFile, names: Sequence[str], where: str) -> None:
    """Refuses columns that unpack to too much, by their number of values."""
    metadata, size = file.metadata, 0
    for k in range(metadata.num_row_groups):
        group = metadata.row_group(k)
        chunks = (group.column(j) for j in range(group.num_columns))
        used = [chunk for chunk in chunks if chunk.path_in_schema.partition(".")[0] in names]
        size += sum(max(8 * chunk.num_values, 8 * group.num_rows, chunk.total_uncompressed_size) for chunk in used)
    if not fits_memory(size, 1) or metadata.num_rows < 0:
        said = f"its columns unpack to more than {MOST_UNPACKED >> 30} GiB"
        raise InputError(said, where, "cut it into shorter logs and give all of them")


def _width(column: pyarrow.ChunkedArray, where: str) -> int:
    from pyarrow import compute

    widths = np.unique(compute.list_value_length(column).to_numpy())
    if len(widths) > 1:
        said = f"holds lists of {widths.min():g} to {widths.max():g} values"
        raise InputError(said, where, "write the same number in every row")
    return int(widths[0]) if len(widths) and np.isfinite(widths[0]) else 0


def _column(columns: pyarrow.Table, where: _Place) -> pyarrow.ChunkedArray:
    from pyarrow import compute

    column = columns.column(where.column)
    return column if where.place is None else compute.list_element(column, where.place)


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
