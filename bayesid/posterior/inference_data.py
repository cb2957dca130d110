"""The posterior in ArviZ's format, groups of named arrays, and its netCDF file posterior.nc.

Groups and their dimensions, every one with named coordinates:

- posterior (chain, draw): `beta` (coefficient), `theta` (parameter), `noise` (joint; sd of the residual, N m); the
  coordinate `mode` (chain, draw) counts from 1, the heaviest.
- sample_stats (chain, draw): `lp` (log density, not normalised), `walker`, `sweep` (index among all sweeps of the run).
- log_likelihood (chain, draw, block): `effort`, see `bayesid.posterior.likelihood.pointwise`. Blocks with the same
  likelihood in all draws, such as those without samples, are omitted (`az.loo` refuses them). The attribute `left_out`
  counts them.
- observed_data (block): `effort` (RMS, N m) and `effort_energy` (sum of squares), with each block's joint, times,
samples
  and sign.
- constant_data: the reference noise and its autocorrelation, the prior, and B of beta = B theta; units and expressions
of
  coefficients, units of parameters (`az.summary` of ArviZ 1.x fails if they are beside the draws). With an earlier log
  also its `earlier_hessian` H and `earlier_gradient` g: `lp` includes -(beta' H beta - 2 g' beta + c) / 2 with c its
  `earlier_energy`.
- nuisance (effect), if any: `scale`, the likely over the usual size of each effect that the model may lack. They have
no
  draws. They shift those of `theta` and `beta`; `lp` and `effort` are those before the shift.

A chain is an ensemble. An entry of `block` is a part of the Hessian: one block, or all weak blocks of a joint that
share a part, whose likelihoods cannot be separated for each draw.

`az.ess` of these draws is right (see `_walker_major`), but `az.rhat` compares early with late walkers instead of early
with late sweeps. Use the attributes for convergence.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray
from xarray import Dataset, DataTree

from bayesid.arrays import Array, Integers
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.parameters import Parameter
from bayesid.errors import InputError
from bayesid.parallel import one_at_a_time, quiet
from bayesid.posterior.likelihood import Likelihood, SegmentBlocks, autocorrelation_times, by_blocks, pointwise, sums
from bayesid.posterior.sampler import Draws
from bayesid.posterior.target import Target
from bayesid.posterior.tuning import TUNING
from bayesid.regression.normal_equations import NormalEquations

_LIBRARY = "bayesid"
"""Name of the library that made the draws, in the file."""
_DIMENSIONS = {"theta": "parameter", "noise": "joint", "log_gain": "joint", "beta": "coefficient"}
"""Last dimension of each variable of draws, after chain and draw."""
_REMEDY = "give the posterior that bayesid wrote, or identify again to write it anew"
_EFFORT = {"units": "N m"}
_SAMPLED = ("chain", "draw")
_POINTWISE = (
    "log likelihood of each block under the sign that all draws give it, or with its sign summed out, tempered by the "
    "autocorrelation; blocks that share a part of the Hessian are one entry"
)


@dataclass(frozen=True)
class Labels:
    """Names, times, and effects without draws."""

    coefficients: BaseCoefficients  #: the r base coefficients; their names, units and expressions
    parameters: Sequence[Parameter]  #: (P,) with names and units
    joints: Sequence[str]  #: (n,) unique names
    time: Array  #: (N,) s, of the samples that blocks refer to
    #: marginalised effects, with their joints, and their likely sizes
    nuisance: Mapping[str, float] = field(default_factory=dict)


class Moved(NamedTuple):
    """Shifts of the draws after sampling."""

    shift: Array  #: (D, E, W, P) of the parameters, by model error and unknown gains
    #: (D, E, W, n) logarithms of these gains, relative to those of the efforts; None if all are exact
    log_gain: Array | None = None


@one_at_a_time
def as_inference_data(kept: DataTree) -> Any:
    """The groups in the installed ArviZ's type: an `arviz.InferenceData`, from ArviZ 1.0 on the tree itself."""
    with quiet(FutureWarning):  # ArviZ 0.x warns of its next version on import
        import arviz  # imported on demand: takes a second

    if not hasattr(arviz, "InferenceData"):
        return kept
    groups = {name: group.to_dataset() for name, group in kept.children.items()}
    with quiet(UserWarning):  # for groups unknown to ArviZ
        return arviz.InferenceData(attrs=dict(kept.attrs), **groups)


@one_at_a_time
def keep(
    draws: Draws,
    target: Target,
    blocks: SegmentBlocks,
    labels: Labels,
    attributes: Mapping[str, object],
    most: int = TUNING.kept_draws,
    mode: Integers | None = None,
    moved: Moved | None = None,
) -> DataTree:
    """All results of the sampling, in groups.

    Args:
        draws: from the target.
        target: the posterior.
        blocks: of the S segments in the target's likelihood. Each part of their Hessian takes 4 bytes a draw.
        labels: names, units and times.
        attributes: of the run. True and False become 1 and 0; other types than text and numbers become JSON.
        most: largest number of stored draws. Whole sweeps are dropped evenly, but at least one is kept.
        mode: (D, E, W) index of each draw's mode; None for a single mode.
        moved: shifts of `theta` and `beta`; `lp` and `effort` are those before the shift.
    """
    every, kept = draws.kept_sweeps(most)
    theta, log_scale, beta, density = (
        _walker_major(values[kept]) for values in (draws.theta, draws.log_scale, draws.beta, draws.log_density)
    )
    chains, size = density.shape
    of_mode = np.zeros((chains, size), dtype=np.int64) if mode is None else _walker_major(mode[kept])
    drawn = {
        "chain": np.arange(chains),
        "draw": np.arange(size),
        "mode": (_SAMPLED, of_mode + 1, {"long_name": "of the posterior, from 1, the heaviest"}),
    }
    flat = theta.reshape(chains * size, -1), log_scale.reshape(chains * size, -1)
    blocks, likelihood = by_blocks(blocks, target.likelihood, *flat)
    block = _block_coordinates(likelihood, blocks, labels)
    terms = pointwise(likelihood, blocks.normal_equations, *flat).reshape(chains, size, -1).astype(np.float32)
    held = np.flatnonzero(np.ptp(terms, axis=(0, 1)))  # segments at the ends of a log may have no samples
    effort = Dataset(
        {"effort": ((*_SAMPLED, "block"), terms)},
        {**drawn, **block},
        {"long_name": _POINTWISE, "left_out": terms.shape[2] - len(held)},
    )
    log_gain = None
    if moved is not None:
        theta = theta + _walker_major(moved.shift[kept])
        beta = theta @ target.likelihood.projection.T
        log_gain = None if moved.log_gain is None else _walker_major(moved.log_gain[kept])
    noise = target.likelihood.sigma * np.exp(log_scale)
    groups = {
        "posterior": Dataset(_drawn_variables(beta, theta, noise, log_gain), {**drawn, **_names(labels)}),
        "sample_stats": _sample_stats(density, kept, draws.theta.shape[2], drawn),
        "log_likelihood": effort.isel(block=held),
        "observed_data": _observed(blocks.normal_equations, block).isel(block=held),
        "constant_data": _constants(target, blocks.normal_equations, labels),
    }
    if labels.nuisance:
        about = {"long_name": "likely size, relative to what is usual; of kinematics, to the stated tolerance"}
        scales = np.array(list(labels.nuisance.values()))
        groups["nuisance"] = Dataset({"scale": ("effect", scales, about)}, {"effect": list(labels.nuisance)})
    tree = xarray.DataTree.from_dict(groups)
    tree.attrs.update({key: _plain(value) for key, value in {**_run(draws, every), **attributes}.items()})
    return tree


def _run(draws: Draws, every: int) -> dict[str, object]:
    _, ensembles, walkers = draws.log_density.shape
    return {
        "inference_library": _LIBRARY,
        "ensembles": ensembles,
        "walkers": walkers,
        "sweeps": draws.sweeps,
        "kept_every": every,
        "draw_order": "all kept sweeps of an ensemble's first walker, then of the next",
    }


def _plain(value: object) -> str | int | float:
    """A valid netCDF attribute: text, a 64-bit number, 1 or 0 for a truth value, and JSON of all else."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, bool):
        return int(value)
    if isinstance(value, str | float) or (isinstance(value, int) and abs(value) < 2**63):
        return value
    return json.dumps(value, default=lambda part: part.tolist() if hasattr(part, "tolist") else str(part))


def _walker_major(values: Any) -> Any:
    """(E, W D, ...) from (D, E, W, ...): all sweeps of a chain's first walker, then all of its second.

    Concatenated independent walkers keep a share 1 - t / D of a walker's own autocorrelation at lag t, as in the
    variance of a mean over D sweeps. So `az.ess` is right, even for walkers that never move (W). In interleaved order
    (all walkers of the first sweep, then of the second) the autocorrelation is W lags away, beyond the estimator's
    window, and the ESS becomes D W.
    """
    moved = np.moveaxis(values, 0, 2)
    return np.ascontiguousarray(moved).reshape(moved.shape[0], -1, *moved.shape[3:])


def _drawn_variables(beta: Array, theta: Array, noise: Array, log_gain: Array | None) -> dict[str, Any]:
    variables = {
        "beta": ((*_SAMPLED, "coefficient"), beta, {"long_name": "base coefficients"}),
        "theta": ((*_SAMPLED, "parameter"), theta, {"long_name": "standard parameters"}),
        "noise": ((*_SAMPLED, "joint"), noise, {"long_name": "sd of the residual", **_EFFORT}),
    }
    if log_gain is not None:
        about = {"long_name": "logarithm of the gain over that of the efforts"}
        variables["log_gain"] = ((*_SAMPLED, "joint"), log_gain, about)
    return variables


def _sample_stats(density: Array, kept: Integers, walkers: int, drawn: Mapping[str, Any]) -> Dataset:
    chains = len(density)
    walker = np.tile(np.repeat(np.arange(walkers, dtype=np.int32), len(kept)), (chains, 1))
    variables = {
        "lp": (_SAMPLED, density, {"long_name": "log density, not normalised"}),
        "walker": (_SAMPLED, walker),
        "sweep": (_SAMPLED, np.tile(kept.astype(np.int32), (chains, walkers))),
    }
    return Dataset(variables, drawn)


def _block_coordinates(likelihood: Likelihood, blocks: SegmentBlocks, labels: Labels) -> dict[str, Any]:
    """The K entries of the dimension `block`: joint, times, samples and sign of each.

    An entry of several blocks starts with the first and ends with the last one. Its sign is 0 unless all have the same
    fixed one.
    """
    normal_equations = blocks.normal_equations
    size = len(normal_equations.hessian)
    start, end = np.full(size, np.inf), np.full(size, -np.inf)
    np.minimum.at(start, normal_equations.part, labels.time[blocks.start])
    np.maximum.at(end, normal_equations.part, labels.time[np.maximum(blocks.end - 1, blocks.start)])
    number = np.bincount(normal_equations.part, minlength=size)
    signs = sums(normal_equations, likelihood.fixed)
    fixed = np.where(np.abs(signs) == number, np.sign(signs), 0.0).astype(np.int64)
    unknown = sums(normal_equations, likelihood.fixed == 0).astype(np.int64)
    joint = [labels.joints[j] for j in normal_equations.hessian.joint]
    known = sums(normal_equations, np.abs(normal_equations.known)) > 0
    names = [
        f"{j} {a:.2f}-{b:.2f} s" if m == 1 else f"{j} {m} blocks of {'known' if k else 'unknown'} sign"
        for j, a, b, m, k in zip(joint, start, end, number, known, strict=True)
    ]
    return {
        "block": _distinct(names),
        "joint": ("block", joint),
        "start": ("block", start, {"units": "s"}),
        "end": ("block", end, {"units": "s"}),
        "n_samples": ("block", sums(normal_equations, normal_equations.count).astype(np.int64)),
        "n_blocks": ("block", number, {"long_name": "blocks in this entry"}),
        "n_unknown": ("block", unknown, {"long_name": "of them with a sign summed out"}),
        "fixed_sign": ("block", fixed, {"long_name": "0 if summed out"}),
    }


def _distinct(names: Sequence[str]) -> list[str]:
    """Unique names; repeated ones, as from joined logs, get a number."""
    seen: dict[str, int] = {}
    distinct = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        distinct.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return distinct


def _observed(normal_equations: NormalEquations, block: Mapping[str, Any]) -> Dataset:
    energy = sums(normal_equations, normal_equations.energy)
    rms = np.sqrt(energy / np.maximum(sums(normal_equations, normal_equations.count), 1.0))
    variables = {
        "effort": ("block", rms, {"long_name": "RMS effort", **_EFFORT}),
        "effort_energy": ("block", energy, {"long_name": "sum of squared efforts", "units": "N2 m2"}),
    }
    return Dataset(variables, block)


def _names(labels: Labels) -> dict[str, Any]:
    """Coordinates of the dimensions only; others make `az.summary` of ArviZ 1.x fail."""
    return {
        "coefficient": list(labels.coefficients.names),
        "parameter": [parameter.name for parameter in labels.parameters],
        "joint": list(labels.joints),
    }


def _constants(target: Target, normal_equations: NormalEquations, labels: Labels) -> Dataset:
    prior, likelihood, known = target.prior, target.likelihood, target.information
    lasting = {"long_name": "integrated autocorrelation time of the residual", "units": "samples"}
    uncut = {"long_name": "before the cut to what is physical"}
    variables: dict[str, Any] = {
        "sigma_ref": ("joint", likelihood.sigma, {"long_name": "reference noise", **_EFFORT}),
        "autocorrelation": ("joint", autocorrelation_times(likelihood, normal_equations), lasting),
        "log_noise_sd": ("joint", prior.log_scale_sd, {"long_name": "prior sd of log(noise / sigma_ref)"}),
        "prior_mean": ("parameter", prior.mean, uncut),
        "prior_sd": ("parameter", prior.sd, uncut),
        "projection": (("coefficient", "parameter"), likelihood.projection, {"long_name": "beta = B theta"}),
    }
    if known is not None:
        square = "coefficient", "other_coefficient"
        variables["earlier_hessian"] = (square, known.hessian, {"long_name": "H of an earlier log"})
        variables["earlier_gradient"] = ("coefficient", known.gradient, {"long_name": "g of an earlier log"})
        variables["earlier_energy"] = ((), known.energy, {"long_name": "c of an earlier log"})
    described = {
        "coefficient_unit": ("coefficient", list(labels.coefficients.units)),
        "coefficient_expression": ("coefficient", list(labels.coefficients.expressions)),
        "parameter_unit": ("parameter", [parameter.unit for parameter in labels.parameters]),
    }
    return Dataset(variables, {**_names(labels), **described})


@one_at_a_time
def write(kept: xarray.DataTree, path: Path | str) -> None:
    """Writes compressed netCDF; replaces an existing file."""
    packed = {"zlib": True, "complevel": 4, "shuffle": True}  # shuffling is needed for the compression of floats
    encoding = {
        group: {
            name: {"_FillValue": None, **(packed if variable.size > 1 else {})}
            for name, variable in node.variables.items()
            if variable.dtype.kind in "fi"
        }
        for group, node in kept.children.items()
    }
    kept.to_netcdf(path, engine="h5netcdf", encoding={f"/{group}": given for group, given in encoding.items()})


def read_draws(path: Path | str, parameters: Sequence[str] | None = None) -> tuple[Array, Array, Array | None]:
    """Parameters, noise and gains of all K draws in a file, chain after chain.

    Returns:
        (K, P) parameters theta, (K, n) noise, N m, and (K, n) logarithms of the gains; None if gains were exact.

    Raises:
        InputError: the file is missing, damaged, not a posterior of bayesid, or of a model with other parameters.
    """
    posterior = _read(path, ("theta", "noise"), ("log_gain",))
    if parameters is not None and posterior["parameter"].values.tolist() != list(parameters):
        raise InputError("is the posterior of another model, with other parameters", str(path), _REMEDY)
    flat = {name: draws.values.reshape(-1, draws.shape[2]) for name, draws in posterior.data_vars.items()}
    return flat["theta"], flat["noise"], flat.get("log_gain")


def read_coefficients(path: Path | str) -> Array:
    """(E, D W, r) coefficients of all draws in a file, in the order of sweeps, see `Draws.kept_coefficients`.

    Raises:
        InputError: the file is missing, damaged or not a posterior of bayesid.
    """
    posterior = _read(path, ("beta",))
    beta, walkers = posterior["beta"].values, int(posterior.attrs["walkers"])
    by_walker = beta.reshape(len(beta), walkers, -1, beta.shape[2])
    return np.ascontiguousarray(np.moveaxis(by_walker, 2, 1)).reshape(beta.shape)


@one_at_a_time
def _read(path: Path | str, required: Sequence[str], optional: Sequence[str] = ()) -> xarray.Dataset:
    """Draws (E, D, ...) of the posterior in a file, with their last dimensions' names and the file's attributes."""
    where = str(path)
    if not Path(path).is_file():
        raise InputError("no such file", where, _REMEDY)
    try:
        with xarray.open_dataset(path, engine="h5netcdf") as file:
            attributes = file.attrs
        with xarray.open_dataset(path, group="posterior", engine="h5netcdf") as group:
            draws = group[[*required, *(name for name in optional if name in group)]].load().assign_attrs(attributes)
    except Exception as error:  # HDF5 raises various errors for a damaged file
        raise InputError("is not a netCDF file of a posterior, or is damaged", where, _REMEDY) from error
    ours = attributes.get("inference_library") == _LIBRARY and "walkers" in attributes
    if not ours or any(
        values.dims != ("chain", "draw", _DIMENSIONS[str(name)]) for name, values in draws.data_vars.items()
    ):
        raise InputError("was not written by bayesid", where, _REMEDY)
    if not all(np.isfinite(values).all() for values in draws.data_vars.values()):
        raise InputError("some draws are not finite numbers", where, _REMEDY)
    return draws
