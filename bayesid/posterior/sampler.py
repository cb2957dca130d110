"""Draws from the posterior of one branch, by emcee, until they are enough.

Several ensembles start apart and never exchange anything; only the lines' covariance, fixed before the first draw that
counts, is common to them. Half of the ensembles sit in one emcee sampler, whose moves treat each walker by itself, and
half in another: two processors sweep side by side. More and smaller parts would cost one processor much more, for numpy
is as good as its arrays are long.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TypeVar

import numpy as np

from bayesid.arrays import TINY, Array, Integers
from bayesid.errors import InputError
from bayesid.posterior.diagnostics import Diagnostics, diagnose
from bayesid.posterior.moves import Conditional, HitAndRun, InTurn, NoiseScales
from bayesid.posterior.start import HOT_SWEEPS, Centre, body_blocks, find_centre, spread_walkers
from bayesid.posterior.target import Target
from bayesid.process import in_parallel
from bayesid.progress import Steps, no_steps

Result = TypeVar("Result")

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
_TICK = 1.0
"""s of sweeps after which the clock is looked at, and progress told. A round number."""
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
        return self.coordinates[self.places(count)]

    def places(self, count: int) -> Integers:
        """(K,) where these stand in a list of all draws."""
        chains = int(np.prod(self.log_density.shape[1:]))
        stride = round(_GOLDEN * chains)
        while math.gcd(stride, chains) != 1:
            stride += 1
        k = np.arange(min(count, self.sweeps * chains))
        places: Integers = k * self.sweeps // len(k) * chains + k * stride % chains
        return places


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
    moves, halves = _warmed_up(target, theta, sampling, clock)
    drawn: list[list[_Stretch]] = []
    next_check, sweeps = sampling.first_look, 0
    while True:
        while sweeps < next_check and not (sweeps >= _FEWEST and clock.late(sweeps)):
            count = clock.at_once(sweeps, next_check - sweeps)
            drawn.append(clock.timed(count, [partial(_draw, target, moves, half, count) for half in halves]))
            halves, sweeps = [stretch.end for stretch in drawn[-1]], sweeps + count
            steps(sweeps, next_check + 1)
        theta, log_scale, beta, log_density = _chains(target, drawn, sampling, _too_early(sweeps, sampling))
        quantities = np.concatenate([beta, log_scale, log_density[..., None]], axis=-1)
        diagnostics = clock.diagnosed(quantities, theta.shape[-1])
        enough = sweeps >= sampling.first_look  # fewer sweeps can look like anything
        converged = enough and diagnostics.passes(sampling.max_rhat, sampling.wanted_ess)
        if converged or clock.late(sweeps) or sweeps >= sampling.most_sweeps:
            parameters = diagnose(theta)
            return Draws(theta, log_scale, beta, log_density, diagnostics, parameters, converged, clock.seconds)
        next_check = max(next_check, min(int(np.ceil(_GROWTH * sweeps)), sampling.most_sweeps))


class _Clock:
    """What a run has taken, and what it will take to end it.

    Args:
        sampling: its budget.
        leave: see `sample`.
    """

    def __init__(self, sampling: Sampling, leave: Callable[[float], float]) -> None:
        self._sampling, self._leave = sampling, leave
        self._began = time.perf_counter()
        self._sweeping, self._swept, self._closing = 0.0, 0, np.nan

    @property
    def seconds(self) -> float:
        """Since it began."""
        return time.perf_counter() - self._began

    @property
    def _sweep(self) -> float:
        """Seconds of a sweep."""
        return self._sweeping / max(self._swept, 1)

    def at_once(self, sweeps: int, planned: int) -> int:
        """How many of the planned sweeps to do before the clock is looked at again, after so many."""
        if self._sweep * planned > _TICK:
            planned = max(1, int(_TICK / self._sweep))
        if self._sampling.repeatable:
            return planned
        spare = self._sampling.budget - self.seconds - self._to_come(sweeps)
        least = max(1, _FEWEST - sweeps)
        return min(planned, least + max(0, int(spare / max(self._sweep + self._closing_of_a_sweep, TINY))))

    def timed(self, sweeps: int, halves: Sequence[Callable[[], Result]]) -> list[Result]:
        """What comes of so many sweeps by each half of the walkers."""
        began = time.perf_counter()
        results = in_parallel(halves)
        self._sweeping, self._swept = self._sweeping + time.perf_counter() - began, self._swept + sweeps
        return results

    def diagnosed(self, quantities: Array, parameters: int) -> Diagnostics:
        """Diagnostics of draws (D, E, W, K): what they take, those of the parameters will take in proportion."""
        before, (sweeps, *_, count) = self.seconds, quantities.shape
        diagnostics = diagnose(quantities)
        self._closing = (self.seconds - before) * (1.0 + parameters / count) / (sweeps + _OVERHEAD)
        return diagnostics

    def late(self, sweeps: int = 0) -> bool:
        """Whether to end after so many sweeps is as much as the budget allows."""
        return not self._sampling.repeatable and self.seconds + self._to_come(sweeps) > self._sampling.budget

    def _to_come(self, sweeps: int) -> float:
        """Seconds that follow if the run ends after so many sweeps, or the fewest."""
        most = max(sweeps, _FEWEST)
        closing = self._closing_of_a_sweep * (most + _OVERHEAD)
        return (most - sweeps) * self._sweep + closing + self._leave(self._sweep)

    @property
    def _closing_of_a_sweep(self) -> float:
        """Seconds of the diagnostics at the end, a sweep."""
        return _OF_A_SWEEP * self._sweep if np.isnan(self._closing) else self._closing


@dataclass(frozen=True)
class _Walkers:
    """Walkers (W, P + n) of half of the ensembles, and random numbers of their own."""

    coordinates: Array
    random: np.random.RandomState


@dataclass(frozen=True)
class _Stretch:
    """Sweeps of half of the ensembles: coordinates (D, W, P + n), log densities (D, W), and where they end."""

    chain: Array
    log_density: Array
    end: _Walkers


def _warmed_up(target: Target, theta: Array, sampling: Sampling, clock: _Clock) -> tuple[InTurn, list[_Walkers]]:
    """Moves, and the walkers after the warm-up; halfway the lines are chosen anew, for the noise of the walkers."""
    block = body_blocks(target.prior.region)
    centre = find_centre(target, theta, np.zeros(target.likelihood.n_joints))
    lines = Conditional(centre.covariance, block)
    first = sampling.ensembles // 2
    walkers = [sampling.walkers * count for count in (sampling.ensembles - first, first) if count]
    randoms = [np.random.RandomState([sampling.seed, half]) for half in range(len(walkers))]
    spread = [
        partial(_spread, target, centre, lines, count, random) for count, random in zip(walkers, randoms, strict=True)
    ]
    halves = clock.timed(HOT_SWEEPS, spread)
    moves, done, halfway = _moves(target, lines), 0, sampling.warm_up // 2
    while done < sampling.warm_up:
        if done == halfway:
            centre = find_centre(target, *target.split(np.concatenate([h.coordinates for h in halves]).mean(axis=0)))
            moves = _moves(target, Conditional(centre.covariance, block))
        count = clock.at_once(0, (halfway if done < halfway else sampling.warm_up) - done)
        halves = clock.timed(count, [partial(_move, moves, half, count) for half in halves])
        done += count
        if clock.late():
            break
    return moves, halves


def _spread(
    target: Target, centre: Centre, lines: Conditional, walkers: int, random: np.random.RandomState
) -> _Walkers:
    return _Walkers(spread_walkers(target, centre, lines, walkers, random), random)


def _move(moves: InTurn, walkers: _Walkers, sweeps: int) -> _Walkers:
    coordinates = walkers.coordinates
    for _ in range(sweeps):
        coordinates = moves.update(coordinates, walkers.random)
    return _Walkers(coordinates, walkers.random)


def _draw(target: Target, moves: InTurn, walkers: _Walkers, sweeps: int) -> _Stretch:
    import emcee  # here, for it takes a third of a second that a result without posterior should not wait

    sampler = emcee.EnsembleSampler(
        len(walkers.coordinates), target.dimension, target.log_density, moves=moves, vectorize=True
    )
    start = emcee.State(walkers.coordinates, random_state=walkers.random.get_state())
    end = sampler.run_mcmc(start, sweeps, skip_initial_state_check=True)
    walkers.random.set_state(end.random_state)
    return _Stretch(sampler.get_chain(), sampler.get_log_prob(), _Walkers(end.coords, walkers.random))


def _moves(target: Target, directions: Conditional) -> InTurn:
    return InTurn([HitAndRun(target, directions), NoiseScales(target)])


def _too_early(sweeps: int, sampling: Sampling) -> int:
    """Sweeps to leave out besides the warm-up: what takes long to converge takes long to forget where it began."""
    return max(0, math.ceil(_EARLY * (sampling.warm_up + sweeps)) - sampling.warm_up)


def _chains(
    target: Target, drawn: Sequence[Sequence[_Stretch]], sampling: Sampling, early: int
) -> tuple[Array, Array, Array, Array]:
    """Parameters, noise scales, coefficients (D, E, W, ...) and log densities (D, E, W), the early sweeps left out."""
    shape = -1, sampling.ensembles, sampling.walkers
    chain = np.concatenate([np.concatenate([half.chain for half in halves], axis=1) for halves in drawn])
    density = np.concatenate([np.concatenate([half.log_density for half in halves], axis=1) for halves in drawn])
    theta, log_scale = target.split(chain[early:].reshape(*shape, chain.shape[-1]))
    return theta, log_scale, theta @ target.likelihood.projection.T, density[early:].reshape(shape)
