"""Draws from the posterior of one mode, by emcee, until they have converged.

Several ensembles start apart and stay independent; they share only the lines' covariance, which is fixed before the
first kept draw. One emcee sampler holds half of the ensembles, another one the other half, and two processors sweep in
parallel. More and smaller parts would slow down one processor, as numpy is fast on long arrays. ArviZ measures
convergence: R-hat between ensembles, effective sample sizes over walkers.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.random import RandomState

from bayesid.arrays import Array, Integers, seed_of
from bayesid.errors import InputError
from bayesid.parallel import in_parallel, one_at_a_time
from bayesid.posterior.feasible_set import Centre
from bayesid.posterior.moves import Conditional, HitAndRun, MoveSequence, NoiseScales, spread_walkers
from bayesid.posterior.target import Target
from bayesid.posterior.tuning import TUNING
from bayesid.progress import Steps, no_steps
from bayesid.signs.search.protocol import check_limits

_ROUNDING = 1e-12
"""Largest relative difference between draws of a constant, such as a sum that an equality fixes: rounding."""


@dataclass(frozen=True)
class Sampling:
    """Options of the sampling.

    Attributes:
        ensembles: number of ensembles that R-hat compares.
        walkers: in each ensemble.
        warm_up: dropped sweeps at the start, at least a quarter of all; `bayesid study sbc` tests the number.
        first_check: sweeps before the first check of the diagnostics.
        max_sweeps: the run ends after these sweeps, converged or not.
        max_rhat: largest R-hat of every quantity; 1.01 as in Vehtari et al. (2021).
        min_ess: least effective sample size of every quantity, bulk and tail; 400 as in the same paper.
        per_walker: the same for each walker, on average.
        budget: nominal seconds of work, about those of an idle machine, including warm-up, diagnostics and the masses
            of several modes. Each mode gets a few sweeps and its mass, however small the budget.
        time_limit: wall-clock seconds (`Draws.timed_out`).
        rng: a seed, a generator that draws one, or None for a new one each time. Unless the time limit ends the run,
            the draws depend on nothing else.
        mode: number of the mode whose mean becomes the model, from 1, the heaviest.

    Raises:
        InputError: the budget is not a number of seconds, a goal is not finite, or the mode is below 1.

    Example:
        >>> sampling = bayesid.Sampling(budget=300.0, rng=3)  # bayesid.identify(..., posterior=sampling)
        >>> sampling.ensembles * sampling.walkers
        256
    """

    ensembles: int = 4
    walkers: int = 64
    warm_up: int = 12
    first_check: int = 24
    max_sweeps: int = 2000
    max_rhat: float = 1.01
    min_ess: float = 400.0
    per_walker: float = 4.0
    budget: float = 60.0
    time_limit: float = 600.0
    rng: np.random.Generator | int | None = 0
    mode: int = 1

    def __post_init__(self) -> None:
        if self.mode < 1:
            raise InputError(
                f"there is no mode {self.mode}", field="Sampling.mode", remedy="give 1, the heaviest, or 2, 3, .."
            )
        for goal in ("max_rhat", "min_ess", "per_walker"):
            if not np.isfinite(getattr(self, goal)):
                problem = f"{goal} is {getattr(self, goal):g}, expected a number"
                raise InputError(problem, field=f"Sampling.{goal}", remedy="give a number; max_sweeps ends the run")
        check_limits(self, self.budget, self.time_limit)
        object.__setattr__(self, "rng", seed_of(self.rng))

    @property
    def seed(self) -> int:
        """Seed of all random numbers; it reproduces the run."""
        return seed_of(self.rng)

    @property
    def wanted_ess(self) -> float:
        """Required effective sample size; walkers that never move look independent, so each must make several."""
        return max(self.min_ess, self.per_walker * self.ensembles * self.walkers)


@dataclass(frozen=True)
class Diagnostics:
    """Diagnostics of K quantities."""

    #: (K,) rank-normalised split R-hat (Vehtari et al. 2021), the larger of bulk and tail, between ensembles: all
    #: walkers of an ensemble together are one chain, split into its earlier and its later half
    rhat: Array
    #: (K,) effective sample size of the bulk, with every walker as a chain, so that walkers that do not mix count; at
    #: most the number of draws, which a constant has
    bulk: Array
    tail: Array  #: (K,) effective sample size of the 5 % or the 95 % quantile, the smaller one

    @property
    def max_rhat(self) -> float:
        """The worst R-hat."""
        return float(np.max(self.rhat))

    @property
    def min_ess(self) -> float:
        """The worst effective sample size, of bulk or tail."""
        return float(min(np.min(self.bulk), np.min(self.tail)))

    def passes(self, max_rhat: float, min_ess: float) -> bool:
        """Whether all quantities pass; NaN does not."""
        return self.max_rhat <= max_rhat and self.min_ess >= min_ess


@one_at_a_time  # ArviZ changes warning filters
def diagnose(draws: Array) -> Diagnostics:
    """Diagnostics of draws (D, E, W, K): D sweeps of E ensembles of W walkers; D >= 4.

    A constant counts as converged. Draws that are not finite give NaN, which passes no test. With an odd number of
    sweeps R-hat leaves out the middle one, as ArviZ would; with one ensemble it compares quarters, not halves.
    """
    from arviz_stats.base import array_stats  # imported on demand: takes a second

    sweeps, ensembles = draws.shape[:2]
    count = float(draws[..., 0].size)
    finite = np.isfinite(draws).all(axis=(0, 1, 2))
    moving = finite & (np.ptp(draws, axis=(0, 1, 2)) > _ROUNDING * np.abs(draws).max(axis=(0, 1, 2), initial=0.0))
    rhat = np.where(finite, 1.0, np.nan)
    bulk, tail = np.where(finite, [[count], [count]], np.nan)
    halves = np.r_[: sweeps // 2, sweeps - sweeps // 2 : sweeps]
    for k in np.flatnonzero(moving).tolist():
        by_walker = draws[..., k].transpose(1, 2, 0).reshape(-1, sweeps)
        by_ensemble = draws[halves, ..., k].swapaxes(0, 1).reshape(max(ensembles, 2), -1)
        with np.errstate(divide="ignore", invalid="ignore"):  # infinite if no ensemble moves
            rhat[k] = array_stats.rhat(by_ensemble)
        bulk[k] = array_stats.ess(by_walker, method="bulk")
        tail[k] = array_stats.ess(by_walker, method="tail", prob=(0.05, 0.95))
    return Diagnostics(rhat, np.minimum(bulk, count), np.minimum(tail, count))  # estimates exceed it for few sweeps


@dataclass(frozen=True)
class Draws:
    """Draws of E ensembles of W walkers."""

    theta: Array  #: (D, E, W, P) parameters
    log_scale: Array  #: (D, E, W, n) logarithms of the noise scales
    beta: Array  #: (D, E, W, r) coefficients
    log_density: Array  #: (D, E, W) of the target, not normalised
    diagnostics: Diagnostics  #: of the r coefficients, the n noise scales and the log density, in this order
    #: of the P parameters; the run does not wait for them, as they mix slowly without data
    parameters: Diagnostics
    converged: bool  #: whether every R-hat and effective sample size of `diagnostics` meets the options
    seconds: float  #: wall-clock time
    spent: float = 0.0  #: nominal seconds of the budget
    timed_out: bool = False  #: whether the time limit ended the run before it converged

    @property
    def sweeps(self) -> int:
        """Number of sweeps D."""
        return len(self.theta)

    @cached_property
    def coordinates(self) -> Array:
        """(D E W, P + n) all draws in one array."""
        joined = np.concatenate([self.theta, self.log_scale], axis=-1)
        return joined.reshape(-1, joined.shape[-1])

    def spread(self, count: int) -> Array:
        """(K, P + n) coordinates of at most `count` different draws, evenly from all sweeps, ensembles and walkers.

        A constant stride would be in step with the walkers and take few of them. Multiples of the golden section are
        evenly spread for any number (Knuth, TAOCP 3, 6.4).
        """
        return self.coordinates[self.places(count)]

    def places(self, count: int) -> Integers:
        """(K,) indices of these draws among all."""
        chains = int(np.prod(self.log_density.shape[1:]))
        stride = round(0.5 * (5.0**0.5 - 1.0) * chains)
        while math.gcd(stride, chains) != 1:
            stride += 1
        k = np.arange(min(count, self.sweeps * chains))
        places: Integers = k * self.sweeps // len(k) * chains + k * stride % chains
        return places

    def kept_sweeps(self, most: int) -> tuple[int, Integers]:
        """Step and indices of the kept sweeps, the last one included, for at most `most` draws."""
        chains = int(np.prod(self.log_density.shape[1:]))
        every = -(-self.sweeps // max(1, most // chains))
        return every, np.arange((self.sweeps - 1) % every, self.sweeps, every)

    def kept_coefficients(self) -> Array:
        """(E, D W, r) coefficients of the draws stored in posterior.nc, in the order of time, for trace plots.

        All walkers of the first sweep come first, then those of the second; the file stores them walker by walker.
        """
        _, kept = self.kept_sweeps(TUNING.kept_draws)
        beta = np.moveaxis(self.beta[kept], 1, 0)
        return np.ascontiguousarray(beta).reshape(beta.shape[0], -1, beta.shape[3])


class _Walkers(NamedTuple):
    """Walkers (W, P + n) of half of the ensembles, and their random state."""

    coordinates: Array
    random: RandomState


class _Stretch(NamedTuple):
    """Sweeps of half of the ensembles: coordinates (D, W, P + n), log densities (D, W), and the last state."""

    chain: Array
    log_density: Array
    end: _Walkers


def sample(
    target: Target, theta: Array, sampling: Sampling = Sampling(), steps: Steps = no_steps, leave: float = 0.0
) -> Draws:
    """Samples until the diagnostics pass, the budget or the time limit ends, or `max_sweeps` are done.

    Args:
        target: the posterior of a branch.
        theta: (P,) the branch's optimum, where the walkers start.
        sampling: options.
        steps: called as steps(sweeps done, sweeps expected); the diagnostics count as one more sweep.
        leave: nominal seconds of the budget that later stages need.
    """
    clock = _Clock(sampling, nominal_sweep(target, sampling.ensembles * sampling.walkers), leave)
    moves, halves = _warmed_up(target, theta, sampling, clock)
    drawn: list[list[_Stretch]] = []
    next_check, sweeps = min(sampling.first_check, clock.allowed), 0
    while True:
        while sweeps < next_check and not (sweeps >= TUNING.fewest_sweeps and clock.timed_out):
            count = min(next_check - sweeps, TUNING.sweeps_at_once)
            drawn.append(in_parallel([partial(_draw, target, moves, half, count) for half in halves]))
            halves, sweeps = [stretch.end for stretch in drawn[-1]], sweeps + count
            clock.swept(count)
            steps(sweeps, next_check + 1)
        # slow convergence means a long memory of the start, so more sweeps are dropped
        early = max(0, math.ceil(TUNING.early * (sampling.warm_up + sweeps)) - sampling.warm_up)
        shape = (-1, sampling.ensembles, sampling.walkers)
        chain = np.concatenate([np.concatenate([half.chain for half in both], axis=1) for both in drawn])[early:]
        density = np.concatenate([np.concatenate([half.log_density for half in both], axis=1) for both in drawn])
        theta, log_scale = target.split(chain.reshape(*shape, chain.shape[-1]))
        beta, log_density = theta @ target.likelihood.projection.T, density[early:].reshape(shape)
        diagnostics = diagnose(np.concatenate([beta, log_scale, log_density[..., None]], axis=-1))
        enough = sweeps >= sampling.first_check  # fewer sweeps give unreliable diagnostics
        converged = enough and diagnostics.passes(sampling.max_rhat, sampling.wanted_ess)
        if converged or clock.timed_out or sweeps >= clock.allowed:
            return Draws(
                theta,
                log_scale,
                beta,
                log_density,
                diagnostics,
                parameters=diagnose(theta),
                converged=converged,
                seconds=clock.seconds,
                spent=clock.spent,
                timed_out=clock.timed_out and not converged,
            )
        next_check = max(next_check, min(int(np.ceil(TUNING.growth * sweeps)), clock.allowed))


def nominal_sweep(target: Target, walkers: int) -> float:
    """Nominal seconds of a sweep: P lines cut by the cone, and a sign for each of S blocks.

    The prices approximate times on logs of a UR10e, a TX40 and a Panda. On other machines a budget takes another time,
    but gives the same result.
    """
    parameters, (blocks, coefficients) = target.n_parameters, target.likelihood.gradient.shape
    noises = target.likelihood.n_joints + 1
    return parameters * TUNING.line_seconds + walkers * (
        TUNING.entry_seconds * noises * parameters**2 + TUNING.product_seconds * blocks * coefficients
    )


class _Clock:
    """Counts sweeps after the warm-up against the budget, `max_sweeps` and the wall-clock limit."""

    def __init__(self, sampling: Sampling, sweep: float, leave: float) -> None:
        began_with = TUNING.hot_sweeps + sampling.warm_up
        within = int((sampling.budget - leave) / ((1.0 + TUNING.diagnostics_work) * sweep)) - began_with
        self.allowed = max(TUNING.fewest_sweeps, min(within, sampling.max_sweeps))
        self._began, self._sweep, self._done = time.perf_counter(), sweep, began_with
        self._limit, self.timed_out = sampling.time_limit, False

    @property
    def seconds(self) -> float:
        return time.perf_counter() - self._began

    @property
    def spent(self) -> float:
        """Nominal seconds of the sweeps made, with warm-up and diagnostics."""
        return (1.0 + TUNING.diagnostics_work) * self._sweep * self._done

    def swept(self, sweeps: int) -> None:
        self._done += sweeps
        self.timed_out = self.timed_out or self.seconds > self._limit


def _warmed_up(target: Target, theta: Array, sampling: Sampling, clock: _Clock) -> tuple[MoveSequence, list[_Walkers]]:
    """Moves, and the walkers after the warm-up; halfway the lines are chosen again for the walkers' noise scales."""
    centre = target.centre(theta, np.zeros(target.likelihood.n_joints))
    first = sampling.ensembles // 2
    walkers = [sampling.walkers * count for count in (sampling.ensembles - first, first) if count]
    randoms = [RandomState([sampling.seed, half]) for half in range(len(walkers))]
    spread = [partial(_spread, target, centre, *half) for half in zip(walkers, randoms, strict=True)]
    halves, moves, halfway = in_parallel(spread), _moves(target, centre), sampling.warm_up // 2
    halves = in_parallel([partial(_move, moves, half, halfway) for half in halves])
    clock.swept(0)
    if clock.timed_out or not sampling.warm_up:
        return moves, halves
    mean = np.concatenate([half.coordinates for half in halves]).mean(axis=0)
    moves, remaining = _moves(target, target.centre(*target.split(mean))), sampling.warm_up - halfway
    return moves, in_parallel([partial(_move, moves, half, remaining) for half in halves])


def _moves(target: Target, centre: Centre) -> MoveSequence:
    lines = Conditional.of(target.prior.region, centre.covariance)
    return MoveSequence([HitAndRun(target, lines), NoiseScales(target)])


def _spread(target: Target, centre: Centre, walkers: int, random: RandomState) -> _Walkers:
    lines = Conditional.of(target.prior.region, centre.covariance)
    return _Walkers(spread_walkers(target, centre, lines, walkers, random), random)


def _move(moves: MoveSequence, walkers: _Walkers, sweeps: int) -> _Walkers:
    coordinates = walkers.coordinates
    for _ in range(sweeps):
        coordinates = moves.update(coordinates, walkers.random)
    return _Walkers(coordinates, walkers.random)


def _draw(target: Target, moves: MoveSequence, walkers: _Walkers, sweeps: int) -> _Stretch:
    import emcee  # imported on demand: takes a third of a second

    sampler = emcee.EnsembleSampler(
        len(walkers.coordinates), target.dimension, target.log_density, moves=moves, vectorize=True
    )
    start = emcee.State(walkers.coordinates, random_state=walkers.random.get_state())
    end = sampler.run_mcmc(start, sweeps, skip_initial_state_check=True)
    walkers.random.set_state(end.random_state)
    return _Stretch(sampler.get_chain(), sampler.get_log_prob(), _Walkers(end.coords, walkers.random))
