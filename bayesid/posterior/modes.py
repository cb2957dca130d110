"""The modes of the posterior: where walkers must start, for none finds its way from one to another; and their draws.

All unknown signs are summed out, so a walker passes from an assignment of signs to its neighbours by itself. What it
does not cross is the valley between assignments that differ in much, above all between the two sides of a joint's
near-symmetry: all its signs turned, and the parameters of the rest bent to suit. The assignments to start from are
those that the search could not rule out, and the best one with each joint turned round. Information of an earlier log
pulls at all of them alike: it may rule one side out.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.posterior.marginal_likelihood import MarginalLikelihood, integrate, mode_weights
from bayesid.posterior.sampler import Diagnostics, Draws, Sampling, nominal_sweep, sample
from bayesid.posterior.target import Target
from bayesid.posterior.tuning import TUNING
from bayesid.progress import Progress
from bayesid.regression.knowledge import Information
from bayesid.regression.moments import Moments
from bayesid.regression.solver import ConeLeastSquares
from bayesid.signs.search.result import SearchResult, predicted_signs, turned_round


class Mode(NamedTuple):
    """Where walkers start."""

    theta: Array  #: (P,) centre, strictly inside the region
    signs: Integers  #: (S,) the signs that lead there
    log_density: float  #: of the target at the centre, noise scales as in the reference


def find_modes(target: Target, moments: Moments, solver: ConeLeastSquares, search: SearchResult) -> tuple[Mode, ...]:
    """The modes that matter, the densest first.

    Moments are in units of the target's reference noise; the solver is for them and the target's information, added.

    Raises:
        SolverError: a cone problem could not be solved.
    """
    starts = starting_points(moments, target.information, solver, search)
    modes = sorted((_mode(target, signs, theta) for signs, theta in starts), key=lambda mode: -mode.log_density)
    kept: list[Mode] = []
    for mode in modes:
        relevant = mode.log_density >= modes[0].log_density - TUNING.mode_depth
        if relevant and all(_valley(target, mode, denser) >= TUNING.valley for denser in kept):
            kept.append(mode)
    return tuple(kept[: TUNING.most_modes])


def starting_points(
    moments: Moments, information: Information | None, solver: ConeLeastSquares, search: SearchResult
) -> list[tuple[Integers, Array]]:
    """Signs and best parameters of the search's branches, and of its best assignment with each joint turned round.

    What is left out is hopelessly worse by a lower bound of its cost. The cost itself is not to be relied on: efforts
    of little noise make it a small difference of large numbers.

    Raises:
        SolverError: a cone problem could not be solved.
    """
    prepared, of_information = solver.prepared(), 0.0 if information is None else information.gradient

    def gradient(signs: Integers) -> Array:
        return signs @ moments.gradient + of_information

    def settled(signs: Integers) -> Integers:
        """Signs that their best parameters predict, after a few rounds of adapting one to the other."""
        for _ in range(TUNING.sign_rounds):
            theta = prepared.solve(gradient(signs)).theta
            before, signs = signs, predicted_signs(moments, prepared.project(theta))
            if np.array_equal(signs, before):
                break
        return signs

    starts = [branch.signs for branch in search.branches[: TUNING.most_branches]] or [search.signs]
    for joint in np.unique(moments.joint[moments.known == 0]):
        starts.append(settled(turned_round(moments, search.signs, joint)))
    distinct = {signs.tobytes(): signs for signs in starts}.values()
    fits = [(signs, prepared.solve_precisely(gradient(signs))) for signs in distinct]
    most = min(fit.cost for _, fit in fits) + 2.0 * TUNING.hopeless
    return [(signs, fit.theta) for signs, fit in fits if fit.lower_bound <= most]


def _mode(target: Target, signs: Integers, theta: Array) -> Mode:
    scale = np.zeros(target.likelihood.n_joints)
    centre = target.centre(theta, scale).theta
    return Mode(centre, signs, float(target.log_density(np.append(centre, scale))[0]))


def _valley(target: Target, mode: Mode, other: Mode) -> float:
    """Nats by which the density falls on the straight way between two modes, below the lower one of them.

    The region is convex: the way lies inside.
    """
    share = np.linspace(0.0, 1.0, TUNING.valley_steps + 1)[1:-1, None]
    theta = (1.0 - share) * mode.theta + share * other.theta
    scale = np.zeros((len(theta), target.likelihood.n_joints))
    lowest = float(target.log_density(np.hstack([theta, scale])).min())
    return min(mode.log_density, other.log_density) - lowest


@dataclass(frozen=True)
class SampledMode:
    """One mode and its draws."""

    mode: Mode  #: where the walkers started
    draws: Draws  #: of this mode alone
    marginal_likelihood: MarginalLikelihood | None  #: its mass; None where there is but one mode
    weight: float  #: its share of all modes' mass


def sample_modes(
    target: Target, modes: Sequence[Mode], sampling: Sampling, began: float, progress: Progress
) -> tuple[SampledMode, ...]:
    """The modes with draws and, where there are several, with their weights, heaviest first.

    Each mode has its share of the budget that remains, for its draws and its mass. The time limit of `sampling` counts
    from `began`, on the clock of `time.perf_counter`.

    Raises:
        SolverError: the mass of a mode could not be computed.
    """
    draws: list[Draws] = []
    masses: list[MarginalLikelihood] = []
    several = len(modes) > 1
    mass = TUNING.mass_sweeps * nominal_sweep(target, sampling.ensembles * sampling.walkers) * several
    remaining = sampling.budget
    for k, mode in enumerate(modes):
        left = len(modes) - k
        on_the_clock = max(0.0, sampling.time_limit - (time.perf_counter() - began)) / left
        share = replace(sampling, budget=max(0.0, remaining / left), time_limit=on_the_clock)
        of_all = f" of mode {k + 1} of {len(modes)}" if several else ""
        progress(f"warm-up{of_all}", 0, 1)
        draws.append(sample(target, mode.theta, share, progress.steps(f"posterior{of_all}"), mass))
        remaining -= draws[-1].spent + mass
        if several:
            progress(f"weight{of_all}", 0, 1)
            masses.append(integrate(target, draws[-1], sampling.seed))
    if not masses:
        return (SampledMode(modes[0], draws[0], None, 1.0),)
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
    heavy, every, place = _heavy(modes), [sampled.draws for sampled in modes], _places(_heavy(modes))
    names = "theta", "log_scale", "beta", "log_density"
    return replace(
        heavy[0].draws,
        **{name: np.concatenate([getattr(sampled.draws, name) for sampled in heavy])[place] for name in names},
        diagnostics=_worst([draws.diagnostics for draws in every]),
        parameters=_worst([draws.parameters for draws in every]),
        converged=all(draws.converged for draws in every),
        seconds=sum(draws.seconds for draws in every),
        spent=sum(draws.spent for draws in every),
        timed_out=any(draws.timed_out for draws in every),
    )


def mode_of_draws(modes: tuple[SampledMode, ...]) -> Integers:
    """(D, E, W) index of the mode that each pooled draw is from."""
    if len(modes) == 1:
        return np.zeros(modes[0].draws.log_density.shape, dtype=np.int64)
    first = np.cumsum([sampled.draws.sweeps for sampled in _heavy(modes)])
    return np.searchsorted(first, _places(_heavy(modes))[0], side="right")


def _heavy(modes: tuple[SampledMode, ...]) -> list[SampledMode]:
    return [sampled for sampled in modes if sampled.weight >= TUNING.negligible_mode]


def _places(heavy: Sequence[SampledMode]) -> tuple[Integers, ...]:
    """Indices (sweep, ensemble, walker) of the pooled draws among those of all modes, one mode's after the other's."""
    sweeps = np.array([sampled.draws.sweeps for sampled in heavy])
    weight = np.array([sampled.weight for sampled in heavy])
    total = max(1, int(np.min(sweeps * weight.sum() / weight)))
    ensembles, walkers = heavy[0].draws.log_density.shape[1:]
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
    return Diagnostics(
        np.max([diagnostics.rhat for diagnostics in of_modes], axis=0),
        np.min([diagnostics.bulk for diagnostics in of_modes], axis=0),
        np.min([diagnostics.tail for diagnostics in of_modes], axis=0),
    )
