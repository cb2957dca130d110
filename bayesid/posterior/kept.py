"""What is kept of a posterior: groups of named arrays, as ArviZ plots, summarises and compares them, and their file.

Groups and their dimensions, every one with named coordinates:

- posterior (chain, draw): `beta` (coefficient), `theta` (parameter), `noise` (joint; sd of the residual, N m); the
  coordinate `mode` (chain, draw) counts from 1, the heaviest.
- sample_stats (chain, draw): `lp` (log density, not normalised), `walker`, `sweep` (index among all sweeps of the run).
- log_likelihood (chain, draw, block): `effort`, see `pointwise`. Held in single precision. A block is a stretch of a
  segment (see `bayesid.posterior.blocks`): little enough of a log for `az.loo`. Blocks whose likelihood is the same in
  all draws, as of those without samples, are no observations (`az.loo` refuses them): the attribute `left_out` counts
  them.
- observed_data (block): `effort` (RMS, N m) and `effort_energy` (sum of squares), beside each block's joint, times,
  samples and sign.
- constant_data: the reference noise and its autocorrelation, the prior, and B of beta = B theta; units and expressions
  of coefficients, units of parameters (beside the draws, `az.summary` of ArviZ 1.x fails on them). Where an earlier log
  is known, also its `earlier_hessian` H and `earlier_gradient` g: in `lp`, minus (beta' H beta - 2 g' beta +
  c) / 2 with c its `earlier_energy`.
- nuisance (effect), where there is any: `scale`, the likely size of each effect that the model may lack, relative to
  what is usual. They have no draws, but move those of `theta` and `beta`; `lp` and `effort` are theirs before.

A chain is an ensemble. An entry of `block` is a part of the moments' Hessian: one block, or all the weak blocks of a
joint that share a part, whose likelihoods cannot be separated draw by draw.

`az.ess` of these draws is what it should be (see `_walker_major`), but `az.rhat` compares early with late walkers
instead of early with late sweeps: whether the run has converged is in the attributes.

Neither is ArviZ needed for this nor xarray, which take two seconds to import; `bayesid.posterior.inference_data` makes
of it what they take.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import h5netcdf
import h5py
import numpy as np
import scipy
from numpy.typing import NDArray

from bayesid.arrays import Array, Integers
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.parameters import Parameter
from bayesid.posterior.blocks import SegmentBlocks
from bayesid.posterior.likelihood import Likelihood
from bayesid.posterior.sampler import Draws
from bayesid.posterior.stored import LIBRARY
from bayesid.posterior.target import Target
from bayesid.regression.knowledge import Information
from bayesid.regression.moments import Moments

MOST = 4096
"""Draws that are kept, in all; a round number: quantiles of 2.5 % then rest on a hundred draws, and the pointwise
likelihood of a thousand blocks takes 16 MB."""
_AT_ONCE = 2**22
"""Numbers that the pointwise likelihood may hold at once in one array (32 MB)."""
_PACKED = {"compression": "gzip", "compression_opts": 4, "shuffle": True}
"""How arrays are stored: unshuffled, the bytes of floats hardly shrink."""
_EFFORT = "N m"
_SAMPLED = ("chain", "draw")
_POINTWISE = (
    "log likelihood of each block under the sign that all draws give it, or with its sign summed out, tempered by the "
    "autocorrelation; blocks that share a part of the Hessian are one entry"
)


@dataclass(frozen=True)
class Labels:
    """What things are called, when samples were taken, and what has no draws.

    Attributes:
        coefficients: the r base coefficients; their names, units and expressions.
        parameters: (P,) with names and units.
        joints: (n,) one each, all different.
        time: (N,) s, of the samples that blocks count.
        nuisance: effects that were summed out, with their joints, and their likely sizes.
    """

    coefficients: BaseCoefficients
    parameters: Sequence[Parameter]
    joints: Sequence[str]
    time: Array
    nuisance: Mapping[str, float] = field(default_factory=dict)


class Variable(NamedTuple):
    """An array with a name for each of its dimensions, and what there is to say of it."""

    dims: tuple[str, ...]
    values: NDArray[Any] | list[str]
    notes: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True)
class Group:
    """Variables and their coordinates, by name, and attributes."""

    variables: Mapping[str, Variable]
    coordinates: Mapping[str, Variable]
    attributes: Mapping[str, str | int] = field(default_factory=dict)

    def of(self, dimension: str, chosen: Integers) -> Group:
        """Some places along a dimension alone."""
        variables, coordinates = (
            {name: _of(one, dimension, chosen) for name, one in named.items()}
            for named in (self.variables, self.coordinates)
        )
        return Group(variables, coordinates, self.attributes)


def _of(variable: Variable, dimension: str, chosen: Integers) -> Variable:
    if dimension not in variable.dims:
        return variable
    if isinstance(variable.values, list):
        return variable._replace(values=[variable.values[k] for k in chosen])
    return variable._replace(values=variable.values.take(chosen, axis=variable.dims.index(dimension)))


@dataclass(frozen=True)
class Kept:
    """Groups by their names, and attributes of the whole."""

    groups: Mapping[str, Group]
    attributes: Mapping[str, str | int | float]


class Moved(NamedTuple):
    """What moves draws beyond the sampling.

    Attributes:
        shift: (D, E, W, P) of the parameters: by what the model may lack, and by gains that are unknowns.
        log_gain: (D, E, W, n) logarithms of these gains, relative to those of the efforts; None where all are exact.
    """

    shift: Array
    log_gain: Array | None = None


def keep(
    draws: Draws,
    target: Target,
    blocks: SegmentBlocks,
    labels: Labels,
    attributes: Mapping[str, object],
    most: int = MOST,
    mode: Integers | None = None,
    moved: Moved | None = None,
) -> Kept:
    """All that is known after sampling.

    Args:
        draws: from the target.
        target: the posterior that they are of.
        blocks: of the S segments in the target's likelihood. Each part of their Hessian takes 4 bytes a draw:
            `moments.compact` bounds their number.
        labels: names, units and times.
        attributes: of the run: model, noise assumption, versions, seed, diagnostics. True and False become 1 and 0,
            what is neither text nor a number becomes JSON.
        most: draws to keep in all. Whole sweeps are left out, evenly, but never all of them.
        mode: (D, E, W) index of the mode that each draw is from; by default there is but one.
        moved: what moves the draws of `theta` and `beta` besides; `lp` and `effort` are theirs before.

    Raises:
        ValueError: if the blocks, labels and target are not of the same segments, joints, coefficients, parameters.
    """
    _require_same_sizes(target, blocks, labels)
    every, kept = _kept_sweeps(draws.theta.shape, most)
    theta, log_scale, beta, density = (
        _walker_major(values[kept]) for values in (draws.theta, draws.log_scale, draws.beta, draws.log_density)
    )
    chains, size = density.shape
    of_mode = np.zeros((chains, size)) if mode is None else _walker_major(mode[kept].astype(float))
    drawn = {
        "chain": Variable(("chain",), np.arange(chains)),
        "draw": Variable(("draw",), np.arange(size)),
        "mode": Variable(_SAMPLED, of_mode.astype(int) + 1, {"long_name": "of the posterior, from 1, the heaviest"}),
    }
    flat = theta.reshape(chains * size, -1), log_scale.reshape(chains * size, -1)
    blocks, likelihood = by_blocks(blocks, target.likelihood, *flat)
    block = _block_coordinates(likelihood, blocks, labels)
    terms = pointwise(likelihood, blocks.moments, *flat).reshape(chains, size, -1).astype(np.float32)
    held = np.flatnonzero(np.ptp(terms, axis=(0, 1)))  # segments at a log's ends may have no samples
    if moved is not None:
        theta = theta + _walker_major(moved.shift[kept])
        beta = theta @ target.likelihood.projection.T
    variables = {"beta": beta, "theta": theta, "noise": target.likelihood.sigma * np.exp(log_scale)}
    if moved is not None and moved.log_gain is not None:
        variables["log_gain"] = _walker_major(moved.log_gain[kept])
    said: dict[str, str | int] = {"long_name": _POINTWISE, "left_out": terms.shape[2] - len(held)}
    effort = {"effort": Variable((*_SAMPLED, "block"), terms)}
    groups = {
        "posterior": _posterior(variables, drawn, labels),
        "sample_stats": _sample_stats(density, kept, draws.theta.shape[2], drawn),
        "log_likelihood": Group(effort, {**drawn, **block}, said).of("block", held),
        "observed_data": _observed(blocks.moments, block).of("block", held),
        "constant_data": _constants(target, blocks.moments, labels),
        **({"nuisance": _nuisance(labels.nuisance)} if labels.nuisance else {}),
    }
    return Kept(groups, {key: _plain(value) for key, value in {**_run(draws, every), **attributes}.items()})


def _run(draws: Draws, every: int) -> dict[str, object]:
    """Attributes of the sampling, of which each so many sweeps are kept."""
    _, ensembles, walkers = draws.log_density.shape
    return {
        "inference_library": LIBRARY,
        "ensembles": ensembles,
        "walkers": walkers,
        "sweeps": draws.sweeps,
        "kept_every": every,
        "draw_order": "all kept sweeps of an ensemble's first walker, then of the next",
    }


def _sample_stats(density: Array, kept: Integers, walkers: int, drawn: Mapping[str, Variable]) -> Group:
    """The group of each draw's log density (E, D W), walker and sweep."""
    chains = len(density)
    walker = np.tile(np.repeat(np.arange(walkers, dtype=np.int32), len(kept)), (chains, 1))
    variables = {
        "lp": Variable(_SAMPLED, density, {"long_name": "log density, not normalised"}),
        "walker": Variable(_SAMPLED, walker),
        "sweep": Variable(_SAMPLED, np.tile(kept.astype(np.int32), (chains, walkers))),
    }
    return Group(variables, drawn)


def _posterior(variables: Mapping[str, Array], drawn: Mapping[str, Variable], labels: Labels) -> Group:
    """The group of draws (E, D W, ...) of coefficients, parameters, noise and gains that are unknowns."""
    described = {
        "beta": ("coefficient", {"long_name": "base coefficients"}),
        "theta": ("parameter", {"long_name": "standard parameters"}),
        "noise": ("joint", {"long_name": "sd of the residual", "units": _EFFORT}),
        "log_gain": ("joint", {"long_name": "logarithm of the gain over that of the efforts"}),
    }
    return Group(
        {
            name: Variable((*_SAMPLED, described[name][0]), values, described[name][1])
            for name, values in variables.items()
        },
        {**drawn, **_names(labels)},
    )


# ---------------------------------------------------------------------------------------------------------------
# Draws
# ---------------------------------------------------------------------------------------------------------------
def _kept_sweeps(shape: tuple[int, ...], most: int) -> tuple[int, Integers]:
    """The step and the sweeps kept of draws (D, E, W, ...), the last one among them; even steps, as the ESS wants."""
    sweeps, ensembles, walkers = shape[:3]
    every = -(-sweeps // max(1, most // (ensembles * walkers)))
    return every, np.arange((sweeps - 1) % every, sweeps, every)


def _walker_major(values: Array) -> Array:
    """(E, W D, ...) of values (D, E, W, ...): all sweeps of a chain's first walker, then all of its second.

    Laid end to end, walkers that know nothing of each other leave at lag t a share 1 - t / D of a walker's own
    autocorrelation: just what the variance of a mean over D sweeps has. So `az.ess` is right, even for walkers that
    never move (W). Interleaved (all walkers of the first sweep, then of the second), neighbours are independent; the
    autocorrelation sits W lags away, where the estimator has long stopped looking, and the ESS comes out as D W.
    """
    moved = np.moveaxis(values, 0, 2)
    return np.ascontiguousarray(moved).reshape(moved.shape[0], -1, *moved.shape[3:])


def kept_coefficients(draws: Draws, most: int = MOST) -> Array:
    """(E, D W, r) coefficients of the sweeps that are kept, all walkers of the first sweep first, then of the second.

    That is the order of time, for traces; a file holds the same draws walker by walker.
    """
    _, kept = _kept_sweeps(draws.theta.shape, most)
    beta = np.moveaxis(draws.beta[kept], 1, 0)
    return np.ascontiguousarray(beta).reshape(beta.shape[0], -1, beta.shape[3])


# ---------------------------------------------------------------------------------------------------------------
# Blocks
# ---------------------------------------------------------------------------------------------------------------
def pointwise(likelihood: Likelihood, moments: Moments, theta: Array, log_scale: Array) -> Array:
    """(W, K) log likelihood of each of the K parts of the moments' Hessian, signs summed out.

    Of a block k of joint j, with N_k samples, autocorrelation time tau, w = exp(-2 u) and moments over sigma^2 tau:

        -(N_k / tau) (u + log(2 pi sigma^2) / 2) - w (beta' H_k beta + c_k) / 2 + log(cosh(w g_k' beta)),

    the mean over both signs of the normal density to the power 1 / tau, or s_k w g_k' beta for the last term where the
    sign is fixed. A part that several blocks share has the sum of theirs. The sum over all parts is
    `likelihood.log_likelihood` less log 2 for each unknown sign and sum_j (n_j / 2) log(2 pi sigma_j^2).

    Args:
        likelihood: of S blocks.
        moments: of the same blocks, not scaled.
        theta: (W, P) parameters.
        log_scale: (W, n) logarithms of the noise scales.
    """
    autocorrelation = _autocorrelation(likelihood, moments)
    scaled = moments.scaled(likelihood.sigma * np.sqrt(autocorrelation))
    size, joint = len(scaled.hessian), scaled.hessian.joint
    energy = _sums(moments, scaled.energy)
    count = _sums(moments, moments.count) / autocorrelation[joint]
    normal = 0.5 * np.log(2.0 * np.pi * likelihood.sigma[joint] ** 2)
    members = scipy.sparse.csr_array(
        (np.ones(len(moments)), (np.arange(len(moments)), moments.part)), (len(moments), size)
    )
    rows = max(1, _AT_ONCE // max(1, size * scaled.hessian.size + len(moments)))
    terms = np.empty((len(theta), size))
    for first in range(0, len(theta), rows):
        here = slice(first, first + rows)
        beta, scale = theta[here] @ likelihood.projection.T, log_scale[here]
        curvature = scaled.hessian.forms(beta)
        signs = likelihood.pointwise(theta[here], scale) - np.log(2.0) * (likelihood.fixed == 0)
        quadratic = 0.5 * np.exp(-2.0 * scale[:, joint]) * (curvature + energy)
        terms[here] = signs @ members - quadratic - count * (scale[:, joint] + normal)
    return terms


def _autocorrelation(likelihood: Likelihood, moments: Moments) -> Array:
    """(n,) integrated autocorrelation time of each joint's residual, samples; NaN for a joint without segments."""
    samples = np.bincount(moments.joint, weights=moments.count, minlength=likelihood.n_joints)
    return samples / np.where(samples > 0, likelihood.count, np.nan)


def _sums(moments: Moments, values: Array | Integers) -> Array:
    """(K,) sums of the segments' values (S,) over each part."""
    return np.bincount(moments.part, weights=values, minlength=len(moments.hessian)).astype(np.float64)


def by_blocks(
    blocks: SegmentBlocks, likelihood: Likelihood, theta: Array, log_scale: Array
) -> tuple[SegmentBlocks, Likelihood]:
    """Blocks whose likelihoods multiply to that of the log, and it in terms of them instead of segments."""
    blocks, fixed = blocks.apart(likelihood, theta, log_scale)
    moments = blocks.moments
    scaled = moments.scaled(likelihood.sigma * np.sqrt(_autocorrelation(likelihood, moments)))
    return blocks, replace(likelihood, gradient=scaled.gradient, joint=moments.joint, fixed=fixed)


def _block_coordinates(likelihood: Likelihood, blocks: SegmentBlocks, labels: Labels) -> dict[str, Variable]:
    """The K entries of the dimension `block` and what belongs to each: joint, times, samples, sign.

    An entry of several blocks begins with the first and ends with the last one; its sign is 0 unless all have the same
    fixed one.
    """
    moments = blocks.moments
    size = len(moments.hessian)
    start, end = np.full(size, np.inf), np.full(size, -np.inf)
    np.minimum.at(start, moments.part, labels.time[blocks.start])
    np.maximum.at(end, moments.part, labels.time[np.maximum(blocks.end - 1, blocks.start)])
    number = np.bincount(moments.part, minlength=size)
    signs = _sums(moments, likelihood.fixed)
    joint = [labels.joints[j] for j in moments.hessian.joint]
    known = _sums(moments, np.abs(moments.known)) > 0
    names = [
        f"{j} {a:.2f}-{b:.2f} s" if m == 1 else f"{j} {m} blocks of {'known' if k else 'unknown'} sign"
        for j, a, b, m, k in zip(joint, start, end, number, known, strict=True)
    ]
    described: dict[str, tuple[Array | Integers | list[str], dict[str, str]]] = {
        "block": (_distinct(names), {}),
        "joint": (joint, {}),
        "start": (start, {"units": "s"}),
        "end": (end, {"units": "s"}),
        "n_samples": (_sums(moments, moments.count).astype(np.int64), {}),
        "n_blocks": (number, {"long_name": "blocks in this entry"}),
        "n_unknown": (
            _sums(moments, likelihood.fixed == 0).astype(np.int64),
            {"long_name": "of them with a sign summed out"},
        ),
        "fixed_sign": (
            np.where(np.abs(signs) == number, np.sign(signs), 0.0).astype(np.int64),
            {"long_name": "0 if summed out"},
        ),
    }
    return {name: Variable(("block",), values, notes) for name, (values, notes) in described.items()}


def _distinct(names: Sequence[str]) -> list[str]:
    """The names, those that came before with a number behind: joined logs have blocks at the same times."""
    seen: dict[str, int] = {}
    distinct = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        distinct.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return distinct


# ---------------------------------------------------------------------------------------------------------------
# Everything else
# ---------------------------------------------------------------------------------------------------------------
def _names(labels: Labels) -> dict[str, Variable]:
    """Coordinates of the dimensions: nothing else may stand beside draws, or `az.summary` of ArviZ 1.x fails."""
    return {
        "coefficient": Variable(("coefficient",), list(labels.coefficients.names)),
        "parameter": Variable(("parameter",), [parameter.name for parameter in labels.parameters]),
        "joint": Variable(("joint",), list(labels.joints)),
    }


def _descriptions(labels: Labels) -> dict[str, Variable]:
    """Coordinates that tell more of what is named."""
    return {
        "coefficient_unit": Variable(("coefficient",), list(labels.coefficients.units)),
        "coefficient_expression": Variable(("coefficient",), list(labels.coefficients.expressions)),
        "parameter_unit": Variable(("parameter",), [parameter.unit for parameter in labels.parameters]),
    }


def _observed(moments: Moments, block: Mapping[str, Variable]) -> Group:
    """RMS effort and energy of each entry of `block`."""
    energy = _sums(moments, moments.energy)
    rms = np.sqrt(energy / np.maximum(_sums(moments, moments.count), 1.0))
    variables = {
        "effort": Variable(("block",), rms, {"long_name": "RMS effort", "units": _EFFORT}),
        "effort_energy": Variable(("block",), energy, {"long_name": "sum of squared efforts", "units": "N2 m2"}),
    }
    return Group(variables, block)


def _constants(target: Target, moments: Moments, labels: Labels) -> Group:
    """Noise, prior and projection, and what an earlier log has shown."""
    prior, likelihood = target.prior, target.likelihood
    lasting = {"long_name": "integrated autocorrelation time of the residual", "units": "samples"}
    uncut = {"long_name": "before the cut to what is physical"}
    variables = {
        "sigma_ref": Variable(("joint",), likelihood.sigma, {"long_name": "reference noise", "units": _EFFORT}),
        "autocorrelation": Variable(("joint",), _autocorrelation(likelihood, moments), lasting),
        "log_noise_sd": Variable(("joint",), prior.log_scale_sd, {"long_name": "prior sd of log(noise / sigma_ref)"}),
        "prior_mean": Variable(("parameter",), prior.mean, uncut),
        "prior_sd": Variable(("parameter",), prior.sd, uncut),
        "projection": Variable(("coefficient", "parameter"), likelihood.projection, {"long_name": "beta = B theta"}),
        **({} if target.information is None else _earlier(target.information)),
    }
    return Group(variables, {**_names(labels), **_descriptions(labels)})


def _earlier(known: Information) -> dict[str, Variable]:
    square = "coefficient", "other_coefficient"
    return {
        "earlier_hessian": Variable(square, known.hessian, {"long_name": "H of an earlier log"}),
        "earlier_gradient": Variable(("coefficient",), known.gradient, {"long_name": "g of an earlier log"}),
        "earlier_energy": Variable((), np.array(known.energy), {"long_name": "c of an earlier log"}),
    }


def _plain(value: object) -> str | int | float:
    """What a netCDF attribute can hold: text, a number of 64 bits, 1 or 0 for a truth value, and JSON of all else."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, bool):
        return int(value)
    if isinstance(value, str | float) or (isinstance(value, int) and abs(value) < 2**63):
        return value
    return json.dumps(value, default=lambda part: part.tolist() if hasattr(part, "tolist") else str(part))


def _nuisance(scales: Mapping[str, float]) -> Group:
    about = {"long_name": "likely size, relative to what is usual; of kinematics, to the stated tolerance"}
    scale = Variable(("effect",), np.array(list(scales.values())), about)
    return Group({"scale": scale}, {"effect": Variable(("effect",), list(scales))})


def _require_same_sizes(target: Target, blocks: SegmentBlocks, labels: Labels) -> None:
    likelihood = target.likelihood
    pairs = {
        "segments": (len(likelihood.joint), int(blocks.segment.max(initial=-1)) + 1),
        "joints": (likelihood.n_joints, len(labels.joints)),
        "coefficients": (likelihood.projection.shape[0], len(labels.coefficients)),
        "parameters": (target.n_parameters, len(labels.parameters)),
    }
    for what, (ours, theirs) in pairs.items():
        if ours != theirs:
            raise ValueError(f"{what}: {ours} of one and {theirs} of the other do not belong together")
    if not np.array_equal(likelihood.joint[blocks.segment], blocks.moments.joint):
        raise ValueError("the blocks and the likelihood have their segments in different joints")
    if blocks.end.max(initial=0) > len(labels.time):
        raise ValueError(f"{len(labels.time)} times and a block to sample {blocks.end.max()} do not belong together")


# ---------------------------------------------------------------------------------------------------------------
# File
# ---------------------------------------------------------------------------------------------------------------
def write(kept: Kept, path: Path | str) -> None:
    """Writes netCDF, compressed, over whatever is there. What a crash leaves half-written is the caller's business."""
    with h5netcdf.File(path, "w") as file:
        file.attrs.update(kept.attributes)
        for name, group in kept.groups.items():
            _write_group(file.create_group(name), group)


def _write_group(place: h5netcdf.Group, group: Group) -> None:
    """Its arrays; those of `variables` name the coordinates that belong to them, as CF conventions have it."""
    every = {**group.coordinates, **group.variables}
    place.dimensions = {
        name: size for one in every.values() for name, size in zip(one.dims, np.shape(one.values), strict=True)
    }
    place.attrs.update(group.attributes)
    for name, one in every.items():
        if isinstance(one.values, list):
            stored = place.create_variable(name, one.dims, h5py.string_dtype(), np.array(one.values, dtype=object))
        else:
            packed = _PACKED if one.values.size > 1 else {}
            stored = place.create_variable(name, one.dims, one.values.dtype, one.values, **packed)
        stored.attrs.update(one.notes)
        named = group.coordinates.items()
        beside = [key for key, other in named if (key,) != other.dims and set(other.dims) <= set(one.dims)]
        if name in group.variables and beside:
            stored.attrs["coordinates"] = " ".join(sorted(beside))
