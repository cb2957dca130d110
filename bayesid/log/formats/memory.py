"""Logs in memory: data frames, structured arrays, and arrays by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from bayesid.errors import InputError
from bayesid.log.formats.encodings import TWOS_64, WIDE, decode
from bayesid.log.formats.gaps import without_gaps
from bayesid.log.formats.labels import kind_of, kind_part, split_brackets, time_among
from bayesid.log.formats.names import choose
from bayesid.log.formats.stated import EFFORTS, described, stated_columns
from bayesid.log.formats.table import (
    Column,
    Options,
    SourceColumn,
    Table,
    check,
    of_64_bits,
    rows_of,
    seconds,
    with_fractions,
)

_Vector = NDArray[Any]


def table_of(variables: Mapping[str, Any], source: str, options: Options) -> Table:
    """The columns of a log: `t` (N,), `q` (N, n) or (n, N) or `q1..qn` (N,) each, and so on; others are ignored.

    With `q="q{}"` the user names the columns of a matrix q. InputError if a column is missing, is not a number, or
    differs in length from the time.
    """
    return table_of_vectors(_vectors(variables, source, options.columns or {}), source, options)


def table_of_vectors(vectors: Mapping[str, _Vector], source: str, options: Options) -> Table:
    """The same for vectors (N,) by column labels."""
    chosen, notes, joints = choose(list(vectors), source, options)
    n_rows = len(vectors[chosen[0].label])
    for column in chosen:
        if len(vectors[column.label]) != n_rows:
            what = f"{column.label} has {len(vectors[column.label])} values, {chosen[0].label} has {n_rows}"
            raise InputError(what, source, "give all of them one value per instant")
    read = {column.name: _column(column, vectors[column.label], source) for column in chosen}
    wide = [column for column in chosen if kind_part(column.name) in EFFORTS and _is_wide(vectors[column.label])]
    read |= {column.name: replace(read[column.name], values=of_64_bits(vectors[column.label])) for column in wide}
    return Table(read, source, rows_of(source), notes, joints=joints, encoding=str(TWOS_64) if wide else None)


def _is_wide(values: _Vector) -> bool:
    """Whether integers are so large that they must be 64-bit two's complement."""
    return values.dtype == np.uint64 and bool((values >= np.uint64(WIDE)).any())


def _vectors(variables: Mapping[str, Any], where: str, columns: Mapping[str, str]) -> dict[str, _Vector]:
    """Columns (N,) of vectors and matrices, by label: q1, q2, .. of q."""
    names = list(variables)
    time = time_among(names)
    if "t" in columns:
        time = stated_columns(names, {"t": columns["t"]}, where, described(names))[0].label
    arrays = {name: _array(value) for name, value in variables.items()}
    n_rows = None
    if time is not None:
        t = arrays[time] if arrays[time].ndim != 2 or arrays[time].shape[1] != 1 else arrays[time][:, 0]
        if t.ndim != 1:
            raise InputError(f"variable {time} has shape {t.shape}", where, "give the time as a vector")
        n_rows = len(t)
    vectors: dict[str, _Vector] = {}
    origins: dict[str, str] = {}
    for name, array in arrays.items():
        for label, vector in _split(array, name, n_rows if name != time else None, where).items():
            if label in vectors:
                what = f"variables {origins[label]} and {name} may be the same"
                raise InputError(what, where, "give only one of them")
            vectors[label], origins[label] = vector, name
    return vectors


def _split(array: _Vector, name: str, n_rows: int | None, where: str) -> dict[str, _Vector]:
    """Columns of one variable; empty if it is not part of a log."""
    numbers = array.dtype.kind in "iuf" and array.ndim > 0
    if kind_of(name) in (None, "t"):
        vector = array[:, 0] if array.ndim == 2 and array.shape[1] == 1 else array
        if vector.ndim != 2 or n_rows not in vector.shape or not numbers:
            return {name: vector} if vector.ndim == 1 else {}
    elif not numbers:
        raise InputError(f"variable {name} is not an array of numbers", where, "give it as floats")
    matrix = array[:, None] if array.ndim == 1 else array
    if n_rows is not None or array.ndim != 2:
        count = n_rows or len(array)
        if matrix.shape == (count, count):
            what = f"variable {name} is square, so its rows or its columns may be instants"
            raise InputError(what, where, "shorten the log by a row")
        if matrix.ndim != 2 or count not in matrix.shape:
            what = f"variable {name} has shape {array.shape} for {count} instants"
            raise InputError(what, where, "give it one row per instant")
        matrix = matrix if matrix.shape[0] == count else matrix.T
    label, unit = split_brackets(name)
    behind = "" if unit is None else f" [{unit}]"
    return {f"{label}{j}{behind}": column for j, column in enumerate(matrix.T, start=1)}


def _array(value: Any) -> _Vector:
    """Anything as an array; without a dimension if impossible, such as rows of unequal length."""
    try:
        return np.asarray(value)
    except (TypeError, ValueError):
        return np.array(None)


def _column(column: SourceColumn, values: _Vector, where: str) -> Column:
    """A column as numbers; a time may be time stamps or durations."""
    kind, label = values.dtype.kind, column.label
    if column.name == "t" and kind in "mM" and not np.isnat(values).any():
        nanoseconds = values.astype("datetime64[ns]" if kind == "M" else "timedelta64[ns]")
        return Column(label, seconds(nanoseconds.astype(np.int64)), 1.0)
    for row, value in enumerate(values if kind in "OUS" else ()):
        if isinstance(value, str) or not np.isscalar(value):
            plain = value.item() if isinstance(value, np.generic) else value
            what = f"column {label} holds {plain!r:.40}, not a number"
            raise InputError(what, rows_of(where)(row), "give it as floats, or give the path of the file")
    try:
        return Column(label, values.astype(float, casting="unsafe" if kind in "Obiuf" else "safe"), column.unit)
    except (TypeError, ValueError):
        raise InputError(f"column {label} holds {values.dtype}, not numbers", where, "give it as floats") from None


@runtime_checkable
class Frame(Protocol):
    """A data frame of pandas or another library."""

    @property
    def columns(self) -> Any:
        """The names."""

    def __getitem__(self, name: Any, /) -> Any:
        """A column."""


Variables: TypeAlias = Mapping[str, Any] | NDArray[Any] | Frame
"""A mapping of names to arrays, a structured array, or a data frame."""


def read_variables(source: object, options: Options) -> Table:
    """The checked table of a program's variables; InputError if they are not a log."""
    table = table_of(_by_name(source), type(source).__name__, options)
    table = without_gaps(with_fractions(table), options)
    return check(decode(table, options.encoding), options.columns)


def _by_name(source: Any) -> dict[str, Any]:
    kind = type(source).__name__
    if isinstance(source, Mapping):
        return {str(name): value for name, value in source.items()}
    if isinstance(source, np.ndarray) and source.dtype.names:
        return {name: source[name] for name in source.dtype.names}
    if isinstance(source, Frame) and not isinstance(source, type):
        return _of_frame(source)
    what = "an array without names" if isinstance(source, np.ndarray) else f"not a log: {kind}"
    remedy = "give a path, a Log, a data frame, a structured array, or a dict of arrays t, q and tau or i"
    raise InputError(f"is {what}", "log", f"{remedy}; bayesid.read_log joins several logs")


def _of_frame(frame: Frame) -> dict[str, Any]:
    """Columns by name, with joined levels; a time index counts as a column."""
    labels = list(frame.columns)
    names = ["_".join(map(str, label)) if isinstance(label, tuple) else str(label) for label in labels]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"column {name} appears twice", type(frame).__name__, "give every column a unique name")
    columns = {name: np.asarray(frame[label]) for name, label in zip(names, labels, strict=True)}
    index = getattr(frame, "index", None)
    of_index = getattr(index, "name", None)
    if of_index is not None and str(of_index) not in columns:
        return {str(of_index): np.asarray(index), **columns}
    if time_among(names) is None and getattr(getattr(index, "dtype", None), "kind", "") in ("m", "M"):
        return {"t": np.asarray(index), **columns}
    return columns
