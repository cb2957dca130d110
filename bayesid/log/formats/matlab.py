"""MATLAB files: version 5 and older through scipy, version 7.3 (HDF5) through h5py.

Either as variables, or as the fields of one struct: `t` (N,), `q` (N, n) or (n, N), `tau` or `i` alike, and `dq` if
velocities were measured; or vectors `q1..qn` and so on, as in a CSV log; or the same by the other usual names (see
`bayesid.log.formats.names`).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.errors import InputError
from bayesid.log.formats.base import Format, Options
from bayesid.log.formats.declared import check_hdf5, check_matlab
from bayesid.log.formats.labels import WORDS, has_any_positions, kind_of, time_among
from bayesid.log.formats.memory import table_of
from bayesid.log.formats.table import Table

_NEEDED = "save t (N x 1), q (N x n) and tau or i (N x n), or one struct that holds them, or give `columns`"
_HDF5 = b"MATLAB 7.3"


class MatlabFile(Format):
    """Variables, or the fields of one struct."""

    name = "a MATLAB file"
    magic = (b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file")
    extensions = (".mat",)
    options = frozenset({"columns"})
    order = 1

    def read(self, path: Path, options: Options) -> Table:
        """The columns of a log."""
        return _read(path, options)


def _read(path: Path, options: Options) -> Table:
    with path.open("rb") as file:
        load = _load_hdf5 if file.read(len(_HDF5)) == _HDF5 else _load
    try:
        variables = load(path)
    except Exception as error:  # a damaged file raises whatever the parser stumbles over
        said = f"cannot be read as a MATLAB file ({type(error).__name__})"
        raise InputError(said, str(path), "save it again with save(..., '-v7')") from None
    found = _log_of(variables, str(path), named=bool(options.columns))
    for kind in WORDS if not options.columns else ():
        if len(same := [name for name in found if kind_of(name) == kind]) > 1:
            raise InputError(f"variables {' and '.join(same)} may be the same", str(path), "save one of them only")
    return table_of(found, str(path), options)


def _load(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    check_matlab(path)
    variables: dict[str, Any] = loadmat(path, simplify_cells=True)
    return variables


def _load_hdf5(path: Path) -> dict[str, Any]:
    """The same of version 7.3, whose arrays are transposed, structs groups, and objects under "#refs#"."""
    import h5py

    with h5py.File(path) as file:
        names = [name for name in file if not name.startswith("#")]
        check_hdf5(file, names)

        def plain(item: Any) -> Any:
            if isinstance(item, h5py.Group):
                return {name: plain(item[name]) for name in item}
            return np.squeeze(item[()]).T

        return {name: plain(file[name]) for name in names}


def _log_of(variables: Mapping[str, Any], where: str, named: bool) -> Mapping[str, Any]:
    """What holds the log: the variables, or the only struct with a time and positions, or any if they are named."""
    if _is_log(variables):
        return variables
    candidates = {name: value for name, value in variables.items() if isinstance(value, Mapping)}
    structs = {name: value for name, value in candidates.items() if _is_log(value)}
    if named and not structs:
        return next(iter(candidates.values())) if len(candidates) == 1 else variables
    if len(structs) > 1:
        raise InputError(f"structs {' and '.join(structs)} both hold a log", where, "save one of them by itself")
    if not structs:
        names = ", ".join(name for name in variables if not name.startswith("__"))
        raise InputError(f"there is no t with a q among {names or 'no variables'}", where, _NEEDED)
    return next(iter(structs.values()))


def _is_log(variables: Mapping[str, Any]) -> bool:
    return time_among(list(variables)) is not None and has_any_positions(list(variables))
