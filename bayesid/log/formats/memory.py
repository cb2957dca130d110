"""Logs in the memory of a program: data frames, structured arrays, and arrays by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from bayesid.errors import InputError
from bayesid.log.formats.base import Options
from bayesid.log.formats.labels import time_among
from bayesid.log.formats.table import Table, check
from bayesid.log.formats.variables import table_of


@runtime_checkable
class Frame(Protocol):
    """A data frame, of pandas or of another library: columns by their names."""

    @property
    def columns(self) -> Any:
        """The names."""

    def __getitem__(self, name: Any, /) -> Any:
        """A column."""


Variables: TypeAlias = Mapping[str, Any] | NDArray[Any] | Frame
"""A mapping of names to arrays, a structured array, or a data frame."""


def read_variables(source: object, options: Options) -> Table:
    """What a program's variables hold of a log, its numbers checked.

    Args:
        source: `Variables`, see `bayesid.log.formats.variables`; of anything else it is said that it is no log.
        options: what a user says of it.

    Raises:
        InputError: it is nothing of the kind, or cannot be used.
    """
    return check(table_of(_by_name(source), type(source).__name__, **options.choice), options.columns)


def _by_name(source: Any) -> dict[str, Any]:
    kind = type(source).__name__
    if isinstance(source, Mapping):
        return {str(name): value for name, value in source.items()}
    if isinstance(source, np.ndarray) and source.dtype.names:
        return {name: source[name] for name in source.dtype.names}
    if isinstance(source, Frame) and not isinstance(source, type):
        return _of_frame(source)
    said = "an array without names" if isinstance(source, np.ndarray) else f"no log: {kind}"
    remedy = "give a path, a Log, a data frame, a structured array, or a dict of arrays t, q and tau or i"
    raise InputError(f"is {said}", "log", f"{remedy}; bayesid.join_logs makes several one")


def _of_frame(frame: Frame) -> dict[str, Any]:
    """Columns by their names, those of several levels joined; an index that is the time counts as a column."""
    labels = list(frame.columns)
    names = ["_".join(map(str, label)) if isinstance(label, tuple) else str(label) for label in labels]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"column {name} appears twice", type(frame).__name__, "give every column its own name")
    columns = {name: np.asarray(frame[label]) for name, label in zip(names, labels, strict=True)}
    index = getattr(frame, "index", None)
    of_index = getattr(index, "name", None)
    if of_index is not None and str(of_index) not in columns:
        return {str(of_index): np.asarray(index), **columns}
    if time_among(names) is None and getattr(getattr(index, "dtype", None), "kind", "") in ("m", "M"):
        return {"t": np.asarray(index), **columns}
    return columns
