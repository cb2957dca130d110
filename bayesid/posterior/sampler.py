"""Draws from the posterior of one branch, by emcee, until they are enough.

Several ensembles start apart and never exchange anything; only the lines' covariance, fixed before the first draw that
counts, is common to them. All walkers of all ensembles sit in one emcee sampler, whose moves treat each by itself.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.posterior.diagnostics import Diagnostics, diagnose
from bayesid.posterior.moves import Conditional, HitAndRun, InTurn, NoiseScales
from bayesid.posterior.start import body_blocks, find_centre, spread_walkers
from bayesid.posterior.target import Target
from bayesid.progress import Steps, no_steps

if TYPE_CHECKING:
    import emcee

_FEWEST = 8
"""Sweeps that are kept however little time remains: R-hat of split chains is defined from four on (ArviZ)."""
_EARLY = 0.25
"""Share of all sweeps, the warm-up among them, that is left out at least: half of what Gelman and Rubin (1992) leave
out of chains whose warm-up is no part of them, and R-hat still compares early with late."""
_GROWTH = 1.5
"""The run grows by this factor between checks of its diagnostics: at most a third of it is more than was needed."""
_OVERHEAD = 10.0
"""Sweeps whose diagnostics take as long as what diagnostics take of however few; measured for arms of six joints."""
_OF_A_SWEEP = 0.2
"""Seconds of the last diagnostics a sweep, over those of the sweep, until they have been measured: 0.1 to 0.2 for
arms of six and seven joints."""
_GOLDEN = 0.5 * (5.0**0.5 - 1.0)
"""The golden section: its multiples spread evenly over the circle, however many they are (Knuth, TAOCP 3, 6.4)."""


@dataclass(frozen=True)
class Sampling:
    """How a posterior is sampled: with how many walkers, how long, and how well.

    Attributes:
        ensembles: that R-hat compares.
        walkers: in each.
        warm_up: sweeps left out at the start, a quarter of all at the least; `bayesid study sbc` would show too few.
        first_look: sweeps after which the diagnostics are looked at first.
        most_sweeps: after which the run ends, converged or not.
        max_rhat: wanted of every quantity; 1.01 is that of Vehtari et al. (2021).
        min_ess: wanted of every quantity, bulk and tail; 400 is theirs too.
        per_walker: the same for every walker, on average.
        budget: seconds of wall time, warm-up, diagnostics and what weighs several modes included. However few, a mode
            takes a few sweeps and its weighing.
        seed: of all random numbers. Before the budget ends, the draws depend on nothing else.
        repeatable: whether they are never to depend on anything else: the budget does not count then.
        mode: whose mean the model holds where there are several, from 1, the heaviest.

    Raises:
        InputError: the budget is no number of seconds, or the mode none from 1 on.

    Example:
        >>> sampling = bayesid.Sampling(budget=300.0, seed=3)  # bayesid.identify(..., posterior=sampling)
        >>> sampling.ensembles * sampling.walkers
        256
    """

    ensembles: int = 4
    walkers: int = 64
    warm_up: int = 12
    first_look: int = 24
    most_sweeps: int = 2000
    max_rhat: float = 1.01
    min_ess: float = 400.0
    per_walker: float = 4.0
    budget: float = 60.0
    seed: int = 0
    repeatable: bool = False
    mode: int = 1

    def __post_init__(self) -> None:
        if self.mode < 1:
            raise InputError(f"there is no mode {self.mode}", "--mode", "give 1, the heaviest, or 2, 3, ..")
        if not 0.0 <= self.budget < np.inf:
            raise InputError(f"a budget of {self.budget:g} s", "--posterior-budget", "give 0 or more seconds")

    @property
    def wanted_ess(self) -> float:
        """Walkers that never move are as many independent draws; so every one must have made several.

        Example:
            >>> bayesid.Sampling(walkers=64).wanted_ess
            1024.0
        """
        return max(self.min_ess, self.per_walker * self.ensembles * self.walkers)


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

    def spread(self, count: int) -> Array:
        """(K, P + n) coordinates of at most `count` different draws: all sweeps, ensembles and walkers alike.

        A constant stride through the list would fall into step with the walkers, and take the draws of very few.
        """
        chains = int(np.prod(self.log_density.shape[1:]))
        stride = round(_GOLDEN * chains)
        while math.gcd(stride, chains) != 1:
            stride += 1
        k = np.arange(min(count, self.sweeps * chains))
        return self.coordinates[k * self.sweeps // len(k) * chains + k * stride % chains]


def sample(
    target: Target,
    theta: Array,
    sampling: Sampling = Sampling(),
    steps: Steps = no_steps,
    leave: Callable[[float], float] = lambda sweep: 0.0,
) -> Draws:
    """Samples until the diagnostics are as wanted, the budget ends or `most_sweeps` are done.

    Args:
        target: the posterior of a branch.
        theta: (P,) the branch's optimum; it decides where the walkers start.
        sampling: with how many walkers, how long, how well.
        steps: called as steps(sweeps done, sweeps expected), after every sweep; to look at them counts as one more.
        leave: seconds of the budget to leave for what comes after, given those of a sweep.
    """
    clock = _Clock(sampling, leave)
    random = np.random.RandomState(sampling.seed)
    sampler, state = _warmed_up(target, theta, sampling, random, clock)
    next_check, sweeps = sampling.first_look, 0
    while True:
        clock.go_on()
        for latest in sampler.sample(state, iterations=next_check - sweeps, skip_initial_state_check=True):
            state = latest
            sweeps += 1
            steps(sweeps, next_check + 1)
            clock.swept()
            if sweeps >= _FEWEST and clock.late(sweeps):
                break
        theta, log_scale, beta, log_density = _chains(target, sampler, sampling, _too_early(sweeps, sampling))
        quantities = np.concatenate([beta, log_scale, log_density[..., None]], axis=-1)
        diagnostics = clock.diagnosed(quantities, theta.shape[-1])
        enough = sweeps >= sampling.first_look  # fewer sweeps can look like anything
        converged = enough and diagnostics.passes(sampling.max_rhat, sampling.wanted_ess)
        if converged or clock.late(sweeps) or sweeps >= sampling.most_sweeps:
            parameters = diagnose(theta)
            return Draws(theta, log_scale, beta, log_density, diagnostics, parameters, converged, clock.seconds)
        # where time seemed up, and was not, what was planned goes on: emcee has made room for it
        next_check = max(next_check, min(int(np.ceil(_GROWTH * sweeps)), sampling.most_sweeps))


class _Clock:
    """What a run has taken, and what it will take to end it.

    Args:
        sampling: its budget.
        leave: see `sample`.
    """

    def __init__(self, sampling: Sampling, leave: Callable[[float], float]) -> None:
        self._sampling, self._leave = sampling, leave
        self._began = self._mark = time.perf_counter()
        self._sweeping, self._swept, self._closing = 0.0, 0, np.nan

    @property
    def seconds(self) -> float:
        """Since it began."""
        return time.perf_counter() - self._began

    def go_on(self) -> None:
        """Sweeps begin, or begin again."""
        self._mark = time.perf_counter()

    def swept(self) -> None:
        """A sweep is done."""
        now = time.perf_counter()
        self._sweeping, self._swept, self._mark = self._sweeping + now - self._mark, self._swept + 1, now

    def diagnosed(self, quantities: Array, parameters: int) -> Diagnostics:
        """Diagnostics of draws (D, E, W, K): what they take, those of the parameters will take in proportion."""
        before, (sweeps, *_, count) = self.seconds, quantities.shape
        diagnostics = diagnose(quantities)
        self._closing = (self.seconds - before) * (1.0 + parameters / count) / (sweeps + _OVERHEAD)
        return diagnostics

    def late(self, sweeps: int = 0) -> bool:
        """Whether to end after so many sweeps is as much as the budget allows."""
        if self._sampling.repeatable:
            return False
        sweep = self._sweeping / max(self._swept, 1)
        closing = _OF_A_SWEEP * sweep if np.isnan(self._closing) else self._closing
        more = max(0, _FEWEST - sweeps)
        to_come = more * sweep + closing * (sweeps + more + _OVERHEAD) + self._leave(sweep)
        return self.seconds + to_come > self._sampling.budget


def _warmed_up(
    target: Target, theta: Array, sampling: Sampling, random: np.random.RandomState, clock: _Clock
) -> tuple[emcee.EnsembleSampler, emcee.State]:
    """The sampler and its state after the warm-up; halfway the lines are chosen anew, for the noise of the walkers."""
    import emcee  # here, for it takes a third of a second that a result without posterior should not wait

    block = body_blocks(target.prior.region)
    centre = find_centre(target, theta, np.zeros(target.likelihood.n_joints))
    moves = _moves(target, Conditional(centre.covariance, block))
    walkers = sampling.ensembles * sampling.walkers
    coordinates = spread_walkers(target, centre, Conditional(centre.covariance, block), walkers, random)
    clock.go_on()
    for k in range(sampling.warm_up):
        if k == sampling.warm_up // 2:
            centre = find_centre(target, *target.split(coordinates.mean(axis=0)))
            moves = _moves(target, Conditional(centre.covariance, block))
        coordinates = moves.update(coordinates, random)
        clock.swept()
        if clock.late():
            break
    sampler = emcee.EnsembleSampler(walkers, target.dimension, target.log_density, moves=moves, vectorize=True)
    return sampler, emcee.State(coordinates, random_state=random.get_state())


def _moves(target: Target, directions: Conditional) -> InTurn:
    return InTurn([HitAndRun(target, directions), NoiseScales(target)])


def _too_early(sweeps: int, sampling: Sampling) -> int:
    """Sweeps to leave out besides the warm-up: what takes long to converge takes long to forget where it began."""
    return max(0, math.ceil(_EARLY * (sampling.warm_up + sweeps)) - sampling.warm_up)


def _chains(
    target: Target, sampler: emcee.EnsembleSampler, sampling: Sampling, early: int
) -> tuple[Array, Array, Array, Array]:
    """Parameters, noise scales, coefficients (D, E, W, ...) and log densities (D, E, W), the early sweeps left out."""
    shape, chain = (-1, sampling.ensembles, sampling.walkers), sampler.get_chain(discard=early)
    theta, log_scale = target.split(chain.reshape(*shape, chain.shape[-1]))
    log_density = sampler.get_log_prob(discard=early).reshape(shape)
    return theta, log_scale, theta @ target.likelihood.projection.T, log_density
