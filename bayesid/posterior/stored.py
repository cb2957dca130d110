"""Draws in a file that `bayesid.posterior.kept` has written, read without ArviZ, xarray and pandas.

These take half a second to import, which whoever predicts or draws a report does not wait for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.files.bounded import fits_memory

LIBRARY = "bayesid"
"""What such a file names as the library that made its draws."""
_STRING = np.dtype([("length", "<u4"), ("place", "V12")])
"""What stands for a string of any length in an HDF5 file."""
_LONGEST_NAME = 10_000
"""Letters of a parameter's or coefficient's name; a coefficient's own are some ten."""
_REMEDY = "give the posterior that bayesid wrote, or identify again to write it anew"


def read_draws(path: Path | str, parameters: Sequence[str] | None = None) -> tuple[Array, Array]:
    """Parameters theta (K, P) and noise (K, n), N m, of all draws in a file, chain after chain.

    Args:
        path: a file that `write` has written.
        parameters: (P,) names that the parameters must have; none are wanted by default.

    Raises:
        InputError: if the file is missing, damaged, not a posterior of bayesid or that of another model.
    """
    where = str(path)
    theta, noise, names, joints = _read(path, ("theta", "noise"), ("parameter", "joint"))
    if theta.shape[2:] != (len(names),) or noise.shape != (*theta.shape[:2], len(joints)):
        raise InputError("the posterior of another program", where, _REMEDY)
    if parameters is not None and names != list(parameters):
        raise InputError("the posterior of another model, with other parameters", where, _REMEDY)
    return theta.reshape(-1, len(names)), noise.reshape(-1, len(joints))


def read_log_gains(path: Path | str) -> Array | None:
    """(K, n) logarithms of the gains of all draws in a file, as `read_draws` has them; None where gains were exact.

    Raises:
        InputError: if the file is missing, damaged or not a posterior of bayesid.
    """
    try:
        with h5py.File(path) as file:
            held = "log_gain" in file["posterior"]
    except Exception as error:  # HDF5 raises anything at all at a damaged file
        raise InputError("not the netCDF file of a posterior, or damaged", str(path), _REMEDY) from error
    if not held:
        return None
    log_gain, joints = _read(path, ("log_gain",), ("joint",))
    if log_gain.shape[2:] != (len(joints),):
        raise InputError("the posterior of another program", str(path), _REMEDY)
    return np.asarray(log_gain.reshape(-1, len(joints)))


def read_coefficients(path: Path | str) -> Array:
    """(E, D W, r) coefficients of all draws in a file, in the order of sweeps, see `kept_coefficients`.

    Raises:
        InputError: if the file is missing, damaged or not a posterior of bayesid.
    """
    beta, names = _read(path, ("beta",), ("coefficient",))
    with h5py.File(path) as file:
        walkers = np.ravel(file.attrs.get("walkers", 0))[:1].tolist()  # netCDF knows no scalar attributes
    counted = len(walkers) == 1 and isinstance(walkers[0], int) and walkers[0] > 0
    if not counted or beta.shape[2:] != (len(names),) or beta.shape[1] % walkers[0]:
        raise InputError("the posterior of another program", str(path), _REMEDY)
    return _sweep_major(beta, walkers[0])


def _words(stored: h5py.Dataset, path: Path | str) -> list[str]:
    """Strings, none of which says that it is longer than any name: HDF5 takes memory by what each says.

    Each is a length of four bytes and twelve that say where it is (HDF5 file format, IV.B); netCDF keeps them in a row.
    """
    start, size = stored.id.get_offset(), stored.id.get_storage_size()
    if start is None or size != _STRING.itemsize * stored.size:
        raise ValueError("names are kept in another way")
    with Path(path).open("rb") as file:
        file.seek(start)
        lengths = np.frombuffer(file.read(size), _STRING)["length"]
    if len(lengths) != stored.size or np.any(lengths > _LONGEST_NAME):
        raise ValueError("a name is longer than any")
    words: list[str] = stored.asstr()[()].tolist()
    return words


def _read(path: Path | str, variables: Sequence[str], names: Sequence[str]) -> list[Any]:
    """Variables (E, D, ...) of the posterior in a file, checked, and lists of names."""
    where = str(path)
    if not Path(path).is_file():
        raise InputError("there is no such file", where, _REMEDY)
    try:
        with h5py.File(path) as file:  # h5netcdf would print a traceback of its own for a file it cannot open
            library = file.attrs.get("inference_library")
            group = file["posterior"]
            if not fits_memory(sum(math.prod(group[name].shape) for name in (*variables, *names))):
                raise ValueError("more than is written")
            values = [np.asarray(group[name][()], dtype=float) for name in variables]
            words = [_words(group[name], path) for name in names]
    except Exception as error:  # HDF5 raises anything at all at a damaged file
        raise InputError("not the netCDF file of a posterior, or damaged", where, _REMEDY) from error
    if library != LIBRARY or any(variable.ndim != 3 for variable in values):
        raise InputError("the posterior of another program", where, _REMEDY)
    if not all(np.isfinite(variable).all() for variable in values):
        raise InputError("some draws are not finite numbers", where, _REMEDY)
    return [*values, *words]


def _sweep_major(values: Array, walkers: int) -> Array:
    """(E, D W, ...) in the order of sweeps, of values in the order of walkers."""
    apart = values.reshape(values.shape[0], walkers, -1, *values.shape[2:])
    return np.ascontiguousarray(np.moveaxis(apart, 2, 1)).reshape(values.shape)
