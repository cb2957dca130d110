"""posterior.nc, the netCDF file of a posterior's draws: see `bayesid.posterior.inference_data` for what it holds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.parallel import one_at_a_time

LIBRARY = "bayesid"
"""What such a file names as the library that made its draws."""
_DIMENSIONS = {"theta": "parameter", "noise": "joint", "log_gain": "joint", "beta": "coefficient"}
"""The last dimension of each variable of draws, behind chain and draw."""
_REMEDY = "give the posterior that bayesid wrote, or identify again to write it anew"


@one_at_a_time
def write(kept: xarray.DataTree, path: Path | str) -> None:
    """Writes netCDF, compressed, over whatever is there. What a crash leaves half-written is the caller's business."""
    packed = {"zlib": True, "complevel": 4, "shuffle": True}  # unshuffled, the bytes of floats hardly shrink
    encoding = {
        group: {
            name: {"_FillValue": None, **(packed if one.size > 1 else {})}
            for name, one in node.variables.items()
            if one.dtype.kind in "fi"
        }
        for group, node in kept.children.items()
    }
    kept.to_netcdf(path, engine="h5netcdf", encoding={f"/{group}": given for group, given in encoding.items()})


def read_draws(path: Path | str, parameters: Sequence[str] | None = None) -> tuple[Array, Array, Array | None]:
    """Of all K draws in a file, chain after chain, parameters, noise and gains.

    Returns:
        (K, P) parameters theta, (K, n) noise, N m, and (K, n) logarithms of the gains; None where gains were exact.

    Args:
        path: a file that `write` has written.
        parameters: (P,) names that the parameters must have; none are wanted by default.

    Raises:
        InputError: if the file is missing, damaged, not a posterior of bayesid or that of another model.
    """
    posterior = _read(path, ("theta", "noise"), ("log_gain",))
    if parameters is not None and posterior["parameter"].values.tolist() != list(parameters):
        raise InputError("the posterior of another model, with other parameters", str(path), _REMEDY)
    flat = {name: draws.values.reshape(-1, draws.shape[2]) for name, draws in posterior.data_vars.items()}
    return flat["theta"], flat["noise"], flat.get("log_gain")


def read_coefficients(path: Path | str) -> Array:
    """(E, D W, r) coefficients of all draws in a file, in the order of sweeps, see `Draws.kept_coefficients`.

    Raises:
        InputError: if the file is missing, damaged or not a posterior of bayesid.
    """
    posterior = _read(path, ("beta",))
    beta, walkers = posterior["beta"].values, int(posterior.attrs["walkers"])
    by_walker = beta.reshape(len(beta), walkers, -1, beta.shape[2])
    return np.ascontiguousarray(np.moveaxis(by_walker, 2, 1)).reshape(beta.shape)


@one_at_a_time
def _read(path: Path | str, wanted: Sequence[str], optional: Sequence[str] = ()) -> xarray.Dataset:
    """Draws (E, D, ...) of the posterior in a file, with names of their last dimensions and the file's attributes."""
    where = str(path)
    if not Path(path).is_file():
        raise InputError("there is no such file", where, _REMEDY)
    try:
        with xarray.open_dataset(path, engine="h5netcdf") as file:
            attributes = file.attrs
        with xarray.open_dataset(path, group="posterior", engine="h5netcdf") as group:
            draws = group[[*wanted, *(name for name in optional if name in group)]].load().assign_attrs(attributes)
    except Exception as error:  # HDF5 raises anything at all at a damaged file
        raise InputError("not the netCDF file of a posterior, or damaged", where, _REMEDY) from error
    ours = attributes.get("inference_library") == LIBRARY and "walkers" in attributes
    if not ours or any(one.dims != ("chain", "draw", _DIMENSIONS[str(name)]) for name, one in draws.data_vars.items()):
        raise InputError("the posterior of another program", where, _REMEDY)
    if not all(np.isfinite(one).all() for one in draws.data_vars.values()):
        raise InputError("some draws are not finite numbers", where, _REMEDY)
    return draws
