"""MATLAB files: version 5 and older through scipy, version 7.3 (HDF5) through h5py.

Either as variables, or as the fields of one struct: `t` (N,), `q` (N, n) or (n, N), `tau` or `i` alike, and `dq` if
velocities were measured; or vectors `q1..qn` and so on, as in a CSV log. Some other names are understood:
see `_ALIASES`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.log.formats.base import Format, Options
from bayesid.log.formats.names import choose
from bayesid.log.formats.table import Column, Table, rows_of

_ALIASES = {
    "t": ("t", "time"),
    "q": ("q", "position"),
    "dq": ("dq", "qd", "velocity"),
    "tau": ("tau", "torque"),
    "i": ("i", "current"),
}
"""What the variables of a log are called."""
_NEEDED = "save t (N x 1), q (N x n) and tau or i (N x n), or one struct that holds them"
_HDF5 = b"MATLAB 7.3"


class MatlabFile(Format):
    """Variables, or the fields of one struct."""

    name = "a MATLAB file"
    magic = (b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file")
    extensions = (".mat",)
    order = 1

    def read(self, path: Path, options: Options) -> Table:
        """The columns of a log."""
        return _read(path, options.motion)


def _read(path: Path, motion: bool) -> Table:
    with path.open("rb") as file:
        load = _load_hdf5 if file.read(len(_HDF5)) == _HDF5 else _load
    try:
        variables = load(path)
    except Exception as error:  # a damaged file raises whatever the parser stumbles over
        said = f"cannot be read as a MATLAB file ({type(error).__name__})"
        raise InputError(said, str(path), "save it again with save(..., '-v7')") from None
    columns = _columns(_log_of(variables, str(path)), str(path))
    chosen = choose(list(columns), str(path), motion)
    return Table(
        {source.name: Column(source.label, columns[source.label], source.unit) for source in chosen},
        str(path),
        rows_of(str(path)),
    )


def _load(path: Path) -> dict[str, Any]:
    """Variables by name, structs as dictionaries."""
    from scipy.io import loadmat

    variables: dict[str, Any] = loadmat(path, simplify_cells=True)
    return variables


def _load_hdf5(path: Path) -> dict[str, Any]:
    """The same of version 7.3, whose arrays are transposed, structs groups, and objects under "#refs#"."""
    import h5py

    def plain(item: Any) -> Any:
        return {name: plain(item[name]) for name in item} if isinstance(item, h5py.Group) else np.squeeze(item[()]).T

    with h5py.File(path) as file:
        return {name: plain(file[name]) for name in file if not name.startswith("#")}


def _log_of(variables: Mapping[str, Any], where: str) -> Mapping[str, Any]:
    """What holds the log: the variables themselves, or the only struct with a time and positions."""
    if _is_log(variables):
        return variables
    structs = {name: value for name, value in variables.items() if isinstance(value, Mapping) and _is_log(value)}
    if len(structs) > 1:
        raise InputError(f"structs {' and '.join(structs)} both hold a log", where, "save one of them by itself")
    if not structs:
        names = ", ".join(name for name in variables if not name.startswith("__"))
        raise InputError(f"there is no t with a q among {names or 'no variables'}", where, _NEEDED)
    return next(iter(structs.values()))


def _is_log(variables: Mapping[str, Any]) -> bool:
    return all(set(names) & set(variables) for names in (_ALIASES["t"], (*_ALIASES["q"], "q1")))


def _columns(variables: Mapping[str, Any], where: str) -> dict[str, Array]:
    """The columns, (N,) each, of vectors and matrices."""
    named = {kind: [name for name in names if name in variables] for kind, names in _ALIASES.items()}
    for names in named.values():
        if len(names) > 1:
            raise InputError(f"variables {' and '.join(names)} may be the same", where, "save one of them only")
    t = _numbers(variables, named["t"][0], where)
    if t.ndim != 1:
        raise InputError(f"variable {named['t'][0]} has shape {t.shape}", where, "save the time as a vector")
    columns = {"t": t}
    for kind in ("q", "dq", "tau", "i"):
        for name in named[kind]:
            matrix = _rows(_numbers(variables, name, where), name, len(t), where)
            columns |= {f"{kind}{j + 1}": column for j, column in enumerate(matrix.T)}
        for name in variables:
            if re.fullmatch(rf"{kind}[1-9]\d*", name):
                if name in columns:
                    said = f"variables {named[kind][0]} and {name} may be the same"
                    raise InputError(said, where, "save one of them only")
                columns[name] = _rows(_numbers(variables, name, where), name, len(t), where)[:, 0]
    return columns


def _rows(values: Array, name: str, n_rows: int, where: str) -> Array:
    """(N, n) a matrix with an instant a row, however it was saved."""
    matrix = values[:, None] if values.ndim == 1 else values
    if matrix.shape == (n_rows, n_rows):
        raise InputError(f"variable {name} is square: its rows or its columns may be instants", where, "cut the log")
    if matrix.ndim != 2 or n_rows not in matrix.shape:
        said = f"variable {name} has shape {values.shape} for {n_rows} instants"
        raise InputError(said, where, "save it with a row an instant")
    return matrix if matrix.shape[0] == n_rows else matrix.T


def _numbers(variables: Mapping[str, Any], name: str, where: str) -> Array:
    values = np.asarray(variables[name])
    if values.dtype.kind not in "iuf":
        raise InputError(f"variable {name} is not an array of numbers", where, "save it as double")
    return values.astype(float)
