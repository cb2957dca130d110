"""A log's variables by name: vectors, and matrices with a row (or a column) an instant; of a file or of a program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.log.formats.labels import kind_of, time_among
from bayesid.log.formats.missing import described
from bayesid.log.formats.names import choose
from bayesid.log.formats.stated import stated_columns
from bayesid.log.formats.table import Column, SourceColumn, Table, rows_of, seconds
from bayesid.log.formats.units import split_brackets

_Vector = NDArray[Any]


def table_of(
    variables: Mapping[str, Any],
    source: str,
    columns: Mapping[str, str] | None = None,
    *,
    motion: bool = False,
    currents: bool = False,
    part: bool = False,
) -> Table:
    """The columns of a log.

    Args:
        variables: `t` (N,), `q` (N, n) or (n, N) or `q1..qn` (N,) each, and so on; others are left out.
        source: where they are from, for messages.
        columns: those that a user has named, see `bayesid.log.formats.stated`; `q="q{}"` are those of a matrix q.
        motion: whether efforts are left out, and need not be there.
        currents: whether currents count where there are torques too.
        part: whether they need not be a whole log.

    Raises:
        InputError: one is missing, holds no numbers, or has another length than the time.
    """
    vectors = _vectors(variables, source, columns or {})
    chosen, notes = choose(list(vectors), source, columns, motion=motion, currents=currents, part=part)
    n_rows = len(vectors[chosen[0].label])
    for one in chosen:
        if len(vectors[one.label]) != n_rows:
            said = f"{one.label} has {len(vectors[one.label])} values, {chosen[0].label} has {n_rows}"
            raise InputError(said, source, "give all of them one value an instant")
    read = {one.name: _column(one, vectors[one.label], source) for one in chosen}
    return Table(read, source, rows_of(source), notes)


def _vectors(variables: Mapping[str, Any], where: str, columns: Mapping[str, str]) -> dict[str, _Vector]:
    """The columns, (N,) each, of vectors and matrices."""
    time = _time_label(list(variables), where, columns)
    n_rows = None if time is None else len(_time(variables[time], time, where))
    vectors: dict[str, _Vector] = {}
    origins: dict[str, str] = {}
    for name, value in variables.items():
        for label, vector in _split(value, name, n_rows if name != time else None, where).items():
            if label in vectors:
                said = f"variables {origins[label]} and {name} may be the same"
                raise InputError(said, where, "give one of them only")
            vectors[label], origins[label] = vector, name
    return vectors


def _time_label(names: Sequence[str], where: str, columns: Mapping[str, str]) -> str | None:
    """The variable that is the time, by a user's word or by its name."""
    if "t" not in columns:
        return time_among(names)
    return stated_columns(names, {"t": columns["t"]}, where, described(names))[0].label


def _time(value: Any, name: str, where: str) -> _Vector:
    t = _array(value)
    if t.ndim == 2 and t.shape[1] == 1:
        return t[:, 0]
    if t.ndim != 1:
        raise InputError(f"variable {name} has shape {t.shape}", where, "give the time as a vector")
    return t


def _split(value: Any, name: str, n_rows: int | None, where: str) -> dict[str, _Vector]:
    """The columns of one variable by their labels; none if it is nothing of a log.

    Args:
        value: of the variable.
        name: of the variable; q of all joints gives q1, q2, ...
        n_rows: number of instants; None for the time itself, and where there is none.
        where: it is from, for messages.
    """
    array = _array(value)
    numbers = array.dtype.kind in "iuf" and array.ndim > 0
    if kind_of(name) in (None, "t"):
        vector = array[:, 0] if array.ndim == 2 and array.shape[1] == 1 else array
        if vector.ndim != 2 or n_rows not in vector.shape or not numbers:
            return {name: vector} if vector.ndim == 1 else {}
    elif not numbers:
        raise InputError(f"variable {name} is not an array of numbers", where, "give it as floats")
    label, unit = split_brackets(name)
    behind = "" if unit is None else f" [{unit}]"
    matrix = array if n_rows is None and array.ndim == 2 else _rows(array, name, n_rows or len(array), where)
    return {f"{label}{j}{behind}": column for j, column in enumerate(matrix.T, start=1)}


def _rows(values: _Vector, name: str, n_rows: int, where: str) -> _Vector:
    """(N, n) a matrix with an instant a row, however it was saved."""
    matrix = values[:, None] if values.ndim == 1 else values
    if matrix.shape == (n_rows, n_rows):
        raise InputError(f"variable {name} is square: its rows or its columns may be instants", where, "cut the log")
    if matrix.ndim != 2 or n_rows not in matrix.shape:
        said = f"variable {name} has shape {values.shape} for {n_rows} instants"
        raise InputError(said, where, "give it a row an instant")
    return matrix if matrix.shape[0] == n_rows else matrix.T


def _array(value: Any) -> _Vector:
    """Anything as an array; what is none, such as rows of several lengths, as one without a dimension."""
    try:
        return np.asarray(value)
    except (TypeError, ValueError):
        return np.array(None)


def _column(one: SourceColumn, values: _Vector, where: str) -> Column:
    """A column as numbers; a time may be time stamps or durations."""
    if one.name == "t" and values.dtype.kind in "mM" and not np.isnat(values).any():
        nanoseconds = values.astype("datetime64[ns]" if values.dtype.kind == "M" else "timedelta64[ns]")
        return Column(one.label, seconds(nanoseconds.astype(np.int64)), 1.0)
    return Column(one.label, _numbers(values, one.label, where), one.unit)


def _numbers(values: _Vector, label: str, where: str) -> Array:
    if values.dtype.kind in "iuf":
        return values.astype(float)
    for row, value in enumerate(values):
        if isinstance(value, str) or not np.isscalar(value):
            plain = value.item() if isinstance(value, np.generic) else value
            said = f"column {label} holds {plain!r:.40}, not a number"
            raise InputError(said, rows_of(where)(row), "give it as floats, or give the path of the file itself")
    try:
        return values.astype(float)
    except (TypeError, ValueError):
        raise InputError(f"column {label} holds {values.dtype}, not numbers", where, "give it as floats") from None
