"""Draws from the posterior of one branch, by emcee, until they are enough.

Several ensembles start apart and never exchange anything; only the lines' covariance, fixed before the first draw that
counts, is common to them. All walkers of all ensembles sit in one emcee sampler, whose moves treat each by itself.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import emcee
import numpy as np

from bayesid.motion import Array
from bayesid.posterior.diagnostics import Diagnostics, diagnose
from bayesid.posterior.moves import Conditional, HitAndRun, InTurn, NoiseScales
from bayesid.posterior.start import body_blocks, find_centre, spread_walkers
from bayesid.posterior.target import Target

Progress = Callable[[int, int], None]
"""Called as progress(sweeps done, sweeps expected)."""

_FEWEST = 8
"""Sweeps that are kept however little time there is."""
_GROWTH = 1.5
"""The run grows by this factor between looks at its diagnostics."""


@dataclass(frozen=True)
class SamplerOptions:
    """How long and with how many.

    Attributes:
        ensembles: that R-hat compares.
        walkers: in each.
        warm_up: sweeps left out at the start.
        first_look: sweeps after which the diagnostics are looked at first.
        most_sweeps: after which the run ends, converged or not.
        max_rhat: wanted of every quantity.
        min_ess: wanted of every quantity, bulk and tail.
        per_walker: the same for every walker, on average.
        budget: seconds of wall time, warm-up included.
        seed: of all random numbers. Before the budget ends, the draws depend on nothing else.
        repeatable: whether they are never to depend on anything else: the budget does not count then.
    """

    ensembles: int = 4
    walkers: int = 64
    warm_up: int = 20
    first_look: int = 24
    most_sweeps: int = 2000
    max_rhat: float = 1.01
    min_ess: float = 400.0
    per_walker: float = 4.0
    budget: float = 60.0
    seed: int = 0
    repeatable: bool = False


@dataclass(frozen=True)
class Draws:
    """Draws of E ensembles of W walkers.

    Attributes:
        theta: (D, E, W, P) parameters.
        log_scale: (D, E, W, n) logarithms of the noise scales.
        beta: (D, E, W, r) coefficients.
        log_density: (D, E, W) of the target, not normalised.
        diagnostics: of the r coefficients, the n noise scales and the log density, in this order.
        parameters: of the P parameters: where data decide little they mix slowest, and no run waits for them.
        converged: whether every R-hat and effective sample size of `diagnostics` is as wanted.
        seconds: of wall time.
    """

    theta: Array
    log_scale: Array
    beta: Array
    log_density: Array
    diagnostics: Diagnostics
    parameters: Diagnostics
    converged: bool
    seconds: float

    @property
    def sweeps(self) -> int:
        """D."""
        return len(self.theta)

    @cached_property
    def coordinates(self) -> Array:
        """(D E W, P + n) all draws in one list."""
        joined = np.concatenate([self.theta, self.log_scale], axis=-1)
        return joined.reshape(-1, joined.shape[-1])


def sample(
    target: Target, theta: Array, options: SamplerOptions = SamplerOptions(), progress: Progress | None = None
) -> Draws:
    """Samples until the diagnostics are as wanted, the budget ends or `most_sweeps` are done.

    Args:
        target: the posterior of a branch.
        theta: (P,) the branch's optimum; it decides where the walkers start.
        options: see there.
        progress: called after every sweep.
    """
    began = time.perf_counter()

    def late() -> bool:
        return not options.repeatable and time.perf_counter() - began > options.budget

    random = np.random.RandomState(options.seed)
    sampler, state = _warmed_up(target, theta, options, random, late)
    look, done = options.first_look, 0
    while True:
        for latest in sampler.sample(state, iterations=look - done, skip_initial_state_check=True):
            state = latest
            done += 1
            if progress is not None:
                progress(done, look)
            if late() and done >= _FEWEST:
                break
        draws = _quantities(target, sampler, options)
        diagnostics = diagnose(draws)
        enough = done >= options.first_look  # fewer sweeps can look like anything
        converged = enough and diagnostics.passes(options.max_rhat, _wanted_ess(options))
        if converged or late() or done >= options.most_sweeps:
            return _result(target, sampler, options, diagnostics, converged, began)
        look = min(int(np.ceil(_GROWTH * done)), options.most_sweeps)


def _warmed_up(
    target: Target, theta: Array, options: SamplerOptions, random: np.random.RandomState, late: Callable[[], bool]
) -> tuple[emcee.EnsembleSampler, emcee.State]:
    """The sampler and its state after the warm-up; halfway the lines are chosen anew, for the noise found by then."""
    block = body_blocks(target.prior.region)
    none = np.zeros(target.likelihood.n_joints)
    centre = find_centre(target, theta, none)
    directions = Conditional(centre.covariance, block)
    walkers = options.ensembles * options.walkers
    coordinates = spread_walkers(target, centre, directions, walkers, random)
    for k in range(options.warm_up):
        if k == options.warm_up // 2:
            of_theta, of_scale = target.split(coordinates.mean(axis=0))
            directions = Conditional(find_centre(target, of_theta, of_scale).covariance, block)
        coordinates = _moves(target, directions).update(coordinates, random)
        if late():
            break
    sampler = emcee.EnsembleSampler(
        walkers, target.dimension, target.log_density, moves=_moves(target, directions), vectorize=True
    )
    return sampler, emcee.State(coordinates, random_state=random.get_state())


def _moves(target: Target, directions: Conditional) -> InTurn:
    return InTurn([HitAndRun(target, directions), NoiseScales(target)])


def _quantities(target: Target, sampler: emcee.EnsembleSampler, options: SamplerOptions) -> Array:
    """(D, E, W, r + n + 1) coefficients, noise scales and log density."""
    theta, log_scale = target.split(sampler.get_chain())
    log_density = sampler.get_log_prob()[..., None]
    joined = np.concatenate([theta @ target.likelihood.projection.T, log_scale, log_density], axis=-1)
    return joined.reshape(-1, options.ensembles, options.walkers, joined.shape[-1])


def _wanted_ess(options: SamplerOptions) -> float:
    """Walkers that never move are as many independent draws; so every one must have made several."""
    return max(options.min_ess, options.per_walker * options.ensembles * options.walkers)


def _result(
    target: Target, sampler: emcee.EnsembleSampler, options: SamplerOptions, diagnostics: Diagnostics,
    converged: bool, began: float,
) -> Draws:  # fmt: skip
    shape = (-1, options.ensembles, options.walkers)
    chain = sampler.get_chain()
    theta, log_scale = target.split(chain.reshape(*shape, chain.shape[-1]))
    return Draws(
        theta=theta,
        log_scale=log_scale,
        beta=theta @ target.likelihood.projection.T,
        log_density=sampler.get_log_prob().reshape(shape),
        diagnostics=diagnostics,
        parameters=diagnose(theta),
        converged=converged,
        seconds=time.perf_counter() - began,
    )
