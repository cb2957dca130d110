"""Modes that were sampled: their weights, and the draws of all of them as one sample."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.errors import SolverError
from bayesid.posterior.diagnostics import Diagnostics
from bayesid.posterior.marginal_likelihood import Integration, MarginalLikelihood, integrate, mode_weights
from bayesid.posterior.modes import Mode
from bayesid.posterior.sampler import Draws, Sampling, nominal_sweep, sample
from bayesid.posterior.target import Target
from bayesid.progress import Progress

_SWEEPS_OF_A_MASS = 40.0
"""Sweeps that take as long as a mode's mass: 30 to 70 for arms of six and seven joints."""
_NEGLIGIBLE = 1e-3
"""A mode of less weight leaves no draws: of the 4096 that posterior.nc keeps, four."""


@dataclass(frozen=True)
class SampledMode:
    """One mode and its draws.

    Attributes:
        mode: where the walkers started.
        draws: of this mode alone.
        marginal_likelihood: its mass; None where there is but one mode.
        weight: its share of all modes' mass.
    """

    mode: Mode
    draws: Draws
    marginal_likelihood: MarginalLikelihood | None
    weight: float


def sample_modes(
    target: Target, modes: Sequence[Mode], sampling: Sampling, began: float, progress: Progress
) -> tuple[SampledMode, ...]:
    """The modes with draws and, where there are several, with their weights, heaviest first.

    Each mode has its share of the budget that remains, for its draws and its mass.

    Args:
        target: the posterior.
        modes: where walkers start.
        sampling: for all modes together.
        began: when the time limit began, on the clock of `time.perf_counter`.
        progress: called as progress(stage, sweeps done, sweeps expected).

    Raises:
        SolverError: the mass of a mode could not be computed.
    """
    draws: list[Draws] = []
    masses: list[MarginalLikelihood] = []
    several = len(modes) > 1
    mass = _SWEEPS_OF_A_MASS * nominal_sweep(target, sampling.ensembles * sampling.walkers) * several
    remaining = sampling.budget
    for k, mode in enumerate(modes):
        left = len(modes) - k
        on_the_clock = max(0.0, sampling.time_limit - (time.perf_counter() - began)) / left
        share = replace(sampling, budget=max(0.0, remaining / left), time_limit=on_the_clock)
        of_all = f" of mode {k + 1} of {len(modes)}" if len(modes) > 1 else ""
        progress(f"warm-up{of_all}", 0, 1)
        draws.append(sample(target, mode.theta, share, progress.steps(f"posterior{of_all}"), mass))
        remaining -= draws[-1].spent + mass
        if several:
            progress(f"weight{of_all}", 0, 1)
            masses.append(_mass(target, draws[-1], sampling.seed))
    if not masses:
        return (SampledMode(modes[0], draws[0], None, 1.0),)
    return weigh(modes, draws, masses)


def _mass(target: Target, draws: Draws, seed: int) -> MarginalLikelihood:
    try:
        return integrate(target, draws, Integration(seed=seed))
    except RuntimeError as error:  # what splitting says when its levels do not end
        raise SolverError("marginal likelihoods of the modes", str(error)) from error


def weigh(
    modes: Sequence[Mode], draws: Sequence[Draws], masses: Sequence[MarginalLikelihood]
) -> tuple[SampledMode, ...]:
    """Several modes with their weights, heaviest first."""
    weights = mode_weights(np.array([mass.log_value for mass in masses])).tolist()
    weighed = [SampledMode(*columns) for columns in zip(modes, draws, masses, weights, strict=True)]
    return tuple(sorted(weighed, key=lambda sampled: -sampled.weight))


def pool(modes: tuple[SampledMode, ...]) -> Draws:
    """All modes' draws as one: first those of the heaviest mode, then of the next ones, as many as their weights ask.

    The sweep at which one mode follows on another differs by one between walkers, so that shares finer than a sweep are
    held.
    """
    if len(modes) == 1:
        return modes[0].draws
    heavy, place = _pooled(modes)
    names = "theta", "log_scale", "beta", "log_density"
    return replace(
        heavy[0],
        **{name: np.concatenate([getattr(draws, name) for draws in heavy])[place] for name in names},
        diagnostics=_worst([sampled.draws.diagnostics for sampled in modes]),
        parameters=_worst([sampled.draws.parameters for sampled in modes]),
        converged=all(sampled.draws.converged for sampled in modes),
        seconds=sum(sampled.draws.seconds for sampled in modes),
        spent=sum(sampled.draws.spent for sampled in modes),
        timed_out=any(sampled.draws.timed_out for sampled in modes),
    )


def mode_of_draws(modes: tuple[SampledMode, ...]) -> Integers:
    """(D, E, W) index of the mode that each pooled draw is from."""
    if len(modes) == 1:
        return np.zeros(modes[0].draws.log_density.shape, dtype=np.int64)
    heavy, place = _pooled(modes)
    first = np.cumsum([draws.sweeps for draws in heavy])
    return np.searchsorted(first, place[0], side="right")


def _pooled(modes: tuple[SampledMode, ...]) -> tuple[list[Draws], tuple[Integers, ...]]:
    """The draws of all modes that count, and the places of the pooled ones among them."""
    heavy = [sampled for sampled in modes if sampled.weight >= _NEGLIGIBLE]
    weights = np.array([sampled.weight for sampled in heavy])
    return [sampled.draws for sampled in heavy], _places([sampled.draws for sampled in heavy], weights)


def _places(heavy: Sequence[Draws], weight: Array) -> tuple[Integers, ...]:
    """Indices (sweep, ensemble, walker) of the pooled draws among those of all modes, one mode's after the other's."""
    sweeps = np.array([draws.sweeps for draws in heavy])
    total = max(1, int(np.min(sweeps * weight.sum() / weight)))
    ensembles, walkers = heavy[0].log_density.shape[1:]
    late = (np.arange(ensembles * walkers).reshape(walkers, ensembles).T + 0.5) / (ensembles * walkers)
    shares = np.cumsum(np.append(0.0, weight / weight.sum()))
    bounds = np.floor(total * shares[:, None, None] + late).astype(int)  # where each walker's modes begin and end
    bounds[-1] = total
    sweep = np.arange(total)[:, None, None]
    mode = np.sum(sweep >= bounds[1:-1, None], axis=0)
    begin = np.take_along_axis(bounds, mode, axis=0)
    count = np.take_along_axis(bounds, mode + 1, axis=0) - begin
    chosen = (2 * (sweep - begin) + 1) * sweeps[mode] // (2 * count)  # of the mode's sweeps
    first = np.cumsum(np.append(0, sweeps[:-1]))
    return (first[mode] + chosen, *np.ogrid[:ensembles, :walkers])


def _worst(of_modes: list[Diagnostics]) -> Diagnostics:
    """The worst of any mode, of each quantity; NaN where there is one."""
    return Diagnostics(
        np.max([diagnostics.rhat for diagnostics in of_modes], axis=0),
        np.min([diagnostics.bulk for diagnostics in of_modes], axis=0),
        np.min([diagnostics.tail for diagnostics in of_modes], axis=0),
    )
