"""The posterior's sampler, compared with others: effective samples per second of the same density.

    python -m bayesid.studies.benchmarks.posterior [--data DIR] [--seconds 60] [--short]

The density is the posterior of ur10e/a_50s, its signs hidden (--short, or without the real logs: of a simulated KR5).
Samplers:

    bayesid       `bayesid.posterior.sampler.sample`, until it has converged: the median of several seeds, run in turn
                  with the others, since the machine's load may change
    stretch       emcee's stretch move: four ensembles, each of at least twice as many walkers as dimensions, without
                  the first half of the steps
    NUTS          NumPyro's, dense mass matrix, four chains (needs the extra `bench`), in two kinds of coordinates, each
                  a smooth map of R^d onto the region, with log |Jacobian| added to the density. Only the bounds of the
                  total mass, far away, remain as hard constraints.
      log-Cholesky  of each pseudo-inertia: Rucker and Wensing (2022); logarithms of nonnegative parameters
      linear        first moments are coordinates; masses, pivots and nonnegative parameters by a softplus, which is the
                    identity except near zero; bounds of the radii are removed link by link. The efforts, linear in the
                    parameters, stay nearly linear in the coordinates, so NUTS is much faster than with log-Cholesky. A
                    chain in a tail lowers the smallest ESS: runs differ severalfold.

All start from the same points (`bayesid.posterior.moves.spread_walkers`); their covariance is the initial mass matrix
of NUTS. NUTS samples for `--seconds` after its warm-up, the stretch move for `--seconds` in all. Times include warm-up
(figures without it are printed too) and bayesid's diagnostics, but not the others' diagnostics or jax's compilation.
Everything runs on one thread; on a busy machine compare processor seconds.

ESS is the smallest of bulk and tail over all base coefficients and noise scales, by the same functions for all; a chain
of NUTS counts as an ensemble of one walker. Converged: R-hat between ensembles <= 1.01, ESS >= 400 and >= 4 per walker
(walkers that never move look like independent draws). Otherwise ESS per second is an upper bound: "<=". `off` is the
largest difference of a mean from bayesid's, in standard errors; with so many quantities 3 is common.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import emcee
import numpy as np
from threadpoolctl import threadpool_limits

from bayesid.arrays import Array
from bayesid.effects.parameters import Cone
from bayesid.identification.identification import Identification
from bayesid.identification.pipeline import identify
from bayesid.log.reading import read_log
from bayesid.posterior.moves import Conditional, spread_walkers
from bayesid.posterior.sampler import Diagnostics, Sampling, diagnose, sample
from bayesid.posterior.target import Target
from bayesid.posterior.tuning import TUNING
from bayesid.robot import load_robot
from bayesid.simulation.logs import simulate_log
from bayesid.studies.benchmarks.nuts_coordinates import (
    Coordinates,
    Linear,
    LogCholesky,
    jax_module,
    make_log_density,
    numpyro_installed,
)
from bayesid.studies.benchmarks.problems import Check, Table
from bayesid.studies.real import DATA

LOG = "ur10e/a_50s"
DEMAND = Sampling()
"""Default criteria of convergence of `bayesid.posterior`, for all samplers."""
CHAINS = 4
"""Of NUTS, and ensembles of the stretch move."""
_WALKERS = 768
"""Starting points; the stretch move uses more in high dimensions."""
_STRETCH_BLOCK, _STRETCH_THIN = 500, 25
"""Steps between readings of the clock, and between kept steps."""
_STRETCH_KEPT = 800
"""Largest number of steps per walker for the diagnostics."""
_NUTS_BLOCK = 25
"""Draws between readings of the clock."""


# ---------------------------------------------------------------------------------------------------------------
# The density
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Problem:
    """A density to be sampled.

    Attributes:
        name: of the log.
        target: the density.
        cone: of its parameters.
        theta: (P,) the optimum, from which starting points are drawn.
    """

    name: str
    target: Target
    cone: Cone
    theta: Array

    def starts(self, walkers: int) -> Array:
        """(W, P + n) the starting points of bayesid's walkers."""
        centre = self.target.centre(self.theta, np.zeros(self.target.likelihood.n_joints))
        lines = Conditional.of(self.target.prior.region, centre.covariance)
        return spread_walkers(self.target, centre, lines, walkers, np.random.RandomState(0))


def real_problem(path: Path) -> Problem:
    """The posterior of a real log, its signs hidden."""
    return _problem(
        path.stem, identify(load_robot(path.parent / "robot.toml"), read_log(path).rectified(), complete="off")
    )


def simulated_problem(terms: Sequence[str] = ("rigid_body",)) -> Problem:
    """The posterior of a simulated log of the KR5 with rigid bodies only."""
    robot = load_robot("kr5")
    log, _ = simulate_log(robot, duration=8.0, rate=50.0, noise=0.1, effects=[], seed=3)
    return _problem("simulated kr5", identify(robot, log, terms=terms, complete="off"))


def _problem(name: str, result: Identification) -> Problem:
    """The target of `identify`, and its starting point."""
    assert result.posterior is not None
    return Problem(name, result.posterior.target, result.model.cone, result.posterior.modes[0].mode.theta)


# ---------------------------------------------------------------------------------------------------------------
# Results of a sampler
# ---------------------------------------------------------------------------------------------------------------
class Clock:
    """Wall and processor seconds since its creation, and seconds of the warm-up."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.perf_counter(), time.process_time()
        self.warm = 0.0

    @property
    def wall(self) -> float:
        """Seconds of wall time."""
        return time.perf_counter() - self._wall

    @property
    def cpu(self) -> float:
        """Seconds of the processor."""
        return time.process_time() - self._cpu

    def warmed_up(self) -> None:
        """Marks the end of the warm-up."""
        self.warm = self.wall


@dataclass(frozen=True)
class Outcome:
    """One sampler's draws.

    Attributes:
        name: of the sampler.
        draws: (D, E, W, r + n) coefficients and logarithms of the noise scales.
        warm_up: seconds of it.
        seconds: in all.
        cpu: seconds of the processor in all.
        note: lengths and acceptance, to be printed.
    """

    name: str
    draws: Array
    warm_up: float
    seconds: float
    cpu: float
    note: str

    @cached_property
    def diagnostics(self) -> Diagnostics:
        """Diagnostics between ensembles."""
        return diagnose(self.draws)

    @cached_property
    def between_walkers(self) -> float:
        """The worst R-hat between walkers."""
        return diagnose(self.draws.reshape(len(self.draws), -1, 1, self.draws.shape[-1])).max_rhat

    @property
    def converged(self) -> bool:
        """Whether R-hat and ESS satisfy `DEMAND`."""
        walkers = self.draws.shape[1] * self.draws.shape[2]
        return self.diagnostics.passes(DEMAND.max_rhat, max(DEMAND.min_ess, DEMAND.per_walker * walkers))

    @property
    def per_second(self) -> float:
        """ESS per second, including warm-up."""
        return self.diagnostics.min_ess / self.seconds

    @property
    def per_cpu_second(self) -> float:
        """ESS per processor second."""
        return self.diagnostics.min_ess / self.cpu

    @property
    def per_second_after_warm_up(self) -> float:
        """ESS per second without the warm-up."""
        return self.diagnostics.min_ess / (self.seconds - self.warm_up)

    def off(self, other: Outcome) -> float:
        """The largest difference of means, in standard errors of both."""
        difference = np.mean(self.draws, axis=(0, 1, 2)) - np.mean(other.draws, axis=(0, 1, 2))
        variances = [np.var(outcome.draws, axis=(0, 1, 2)) / outcome.diagnostics.bulk for outcome in (self, other)]
        return float(np.max(np.abs(difference) / np.sqrt(sum(variances))))


def _outcome(name: str, target: Target, coordinates: Array, clock: tuple[float, float, float], note: str) -> Outcome:
    """The outcome of draws (D, E, W, P + n); clock: seconds of warm-up, in all, and of the processor."""
    theta, log_scale = target.split(coordinates)
    return Outcome(name, np.concatenate([theta @ target.likelihood.projection.T, log_scale], axis=-1), *clock, note)


# ---------------------------------------------------------------------------------------------------------------
# bayesid and the stretch move
# ---------------------------------------------------------------------------------------------------------------
def bayesid_sampler(problem: Problem, seconds: float, seed: int) -> Outcome:
    """The sampler of `bayesid.posterior`, until it has converged."""
    times: list[tuple[int, float]] = []
    clock, sampling = Clock(), Sampling(budget=seconds, rng=seed)
    draws = sample(problem.target, problem.theta, sampling, lambda done, _: times.append((done, clock.wall)))
    spent, before, (done, wall) = (clock.wall, clock.cpu), TUNING.hot_sweeps + sampling.warm_up, times[0]
    warm = wall * before / (before + done)  # sweeps of the warm-up take as long as later ones
    coordinates = np.concatenate([draws.theta, draws.log_scale], axis=-1)
    return _outcome("bayesid", problem.target, coordinates, (warm, *spent), f"{draws.sweeps} sweeps")


def stretch(problem: Problem, seconds: float) -> Outcome:
    """The stretch move of emcee."""
    target = problem.target
    walkers = max(_WALKERS // CHAINS, 2 * target.dimension)
    starts = problem.starts(CHAINS * walkers).reshape(CHAINS, walkers, -1)
    ensembles = [
        emcee.EnsembleSampler(
            walkers, target.dimension, target.log_density, moves=emcee.moves.StretchMove(), vectorize=True
        )
        for _ in starts
    ]
    states = [emcee.State(start) for start in starts]
    clock, steps = Clock(), 0
    while not steps or clock.wall < seconds:
        for k, ensemble in enumerate(ensembles):
            states[k] = ensemble.run_mcmc(
                states[k], _STRETCH_BLOCK // _STRETCH_THIN, thin_by=_STRETCH_THIN, skip_initial_state_check=True
            )
        steps += _STRETCH_BLOCK
    spent = clock.wall, clock.cpu
    kept = steps // _STRETCH_THIN
    thin = max(1, kept // _STRETCH_KEPT)
    chains = [ensemble.get_chain(discard=kept // 2, thin=thin) for ensemble in ensembles]
    accepted = np.mean([ensemble.acceptance_fraction for ensemble in ensembles])
    note = f"{steps} steps of {CHAINS} x {walkers} walkers, {accepted:.1%} accepted"
    return _outcome("emcee stretch", target, np.stack(chains, axis=1), (0.5 * spent[0], *spent), note)


# ---------------------------------------------------------------------------------------------------------------
# NUTS
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Setting:
    """Settings of NUTS.

    Attributes:
        coordinates: their class.
        accept: target acceptance for the step size.
        warm_up: draws per chain.
        depth: largest depth of a tree.
    """

    coordinates: type[Coordinates]
    accept: float
    warm_up: int
    depth: int = 10


def nuts(problem: Problem, setting: Setting, seconds: float) -> Outcome:
    """NumPyro's NUTS, one chain after the other, so that no chain waits for the trees of others."""
    jax = jax_module()
    from numpyro.infer import NUTS

    starts = problem.starts(_WALKERS)
    coordinates = setting.coordinates(problem, starts)
    log_density = make_log_density(problem, coordinates)
    points = coordinates.back(starts)
    kernel = NUTS(
        potential_fn=lambda z: -log_density(z),
        target_accept_prob=setting.accept,
        dense_mass=True,
        inverse_mass_matrix=np.cov(points.T),
        max_tree_depth=setting.depth,
    )

    def step(state: Any, _: None) -> Any:
        state = kernel.sample(state, (), {})
        return state, (coordinates.forward(state.z)[0], state.num_steps, state.diverging)

    def block(states: Any) -> Any:
        return jax.lax.map(lambda state: jax.lax.scan(step, state, None, length=_NUTS_BLOCK), states)

    began = time.perf_counter()
    keys = jax.random.split(jax.random.PRNGKey(0), CHAINS)
    init = jax.jit(jax.vmap(lambda key, z: kernel.init(key, setting.warm_up, z, (), {})))
    states = init(keys, jax.numpy.asarray(points[:CHAINS]))
    run = jax.jit(block).lower(states).compile()
    compiled = time.perf_counter() - began

    clock = Clock()
    for _ in range(0, setting.warm_up, _NUTS_BLOCK):
        states, _ = jax.block_until_ready(run(states))
    clock.warmed_up()
    blocks: list[list[Array]] = []
    while not blocks or clock.wall < clock.warm + seconds:
        states, seen = run(states)
        blocks.append([np.asarray(part) for part in seen])
    spent = clock.wall, clock.cpu
    chains, steps, diverging = (np.concatenate(parts, axis=1) for parts in zip(*blocks, strict=True))
    note = (
        f"{setting.warm_up} + {chains.shape[1]} draws of {CHAINS} chains, {steps.mean():.0f} steps per draw"
        f" ({100 * np.mean(steps >= 2**setting.depth - 1):.0f} % of the trees at the largest depth),"
        f" {100 * diverging.mean():.1f} % diverge;"
        f" step sizes {np.round(np.asarray(states.adapt_state.step_size), 3).tolist()}; compiled in {compiled:.0f} s"
    )
    name = f"NUTS {coordinates.name} {setting.accept:g}"
    return _outcome(name, problem.target, chains.swapaxes(0, 1)[:, :, None], (clock.warm, *spent), note)


# ---------------------------------------------------------------------------------------------------------------
# Table
# ---------------------------------------------------------------------------------------------------------------
def compare(problem: Problem, settings: list[Setting], seconds: float, again: bool = True) -> list[Check]:
    """Runs all samplers and prints the table; bayesid's sampler runs again after each other one, or once."""
    target = problem.target
    count = np.round(target.likelihood.count).astype(int).tolist()
    print(
        f"{problem.name}: {target.dimension} dimensions, {len(target.likelihood.unknown)} of"
        f" {len(target.likelihood.fixed)} signs summed out, effective samples {count}"
    )
    bayesid_sampler(problem, 0.0, 0)  # imports and fills caches
    runs = [partial(stretch, problem, seconds), *(partial(nuts, problem, setting, seconds) for setting in settings)]
    repeats, others = [bayesid_sampler(problem, seconds, 0)], []
    for seed, run in enumerate(runs, start=1):
        others.append(run())
        print(f"{others[-1].name}: {others[-1].note}", flush=True)
        if again:
            repeats.append(bayesid_sampler(problem, seconds, seed))
    rates = [repeat.per_second for repeat in repeats]
    ours = repeats[int(np.argsort(rates)[len(rates) // 2])]
    print(f"bayesid: {ours.note}; ESS/s of {len(rates)} seeds: {', '.join(f'{rate:.0f}' for rate in rates)}\n")
    table = Table(*_HEADER)
    for outcome in (ours, *others):
        _row(table, ours, outcome)
    return [*_ratio(ours, others[:1], 10.0), *_ratio(ours, others[1:], 3.0)]


_HEADER = (
    *("sampler", "converged", "R-hat", "of walkers", "min ESS", "s", "warm-up s", "cpu s", "ESS/s", "after warm-up"),
    *("ESS/cpu s", "off", "ours/theirs", "after warm-up", "of cpu"),
)


def _row(table: Table, ours: Outcome, outcome: Outcome) -> None:
    at_most, at_least = ("", "") if outcome.converged else ("<= ", ">= ")
    rates, our_rates = (
        (shown.per_second, shown.per_second_after_warm_up, shown.per_cpu_second) for shown in (outcome, ours)
    )
    table.row(
        outcome.name,
        "yes" if outcome.converged else "NO",
        f"{outcome.diagnostics.max_rhat:.4f}",
        f"{outcome.between_walkers:.4f}",
        f"{outcome.diagnostics.min_ess:.0f}",
        *(f"{seconds:.1f}" for seconds in (outcome.seconds, outcome.warm_up, outcome.cpu)),
        *(f"{at_most}{rate:.4g}" for rate in rates),
        "" if outcome is ours else f"{outcome.off(ours):.1f}",
        *(f"{at_least}{our_rate / rate:.1f}" for our_rate, rate in zip(our_rates, rates, strict=True)),
    )


def _ratio(ours: Outcome, others: list[Outcome], least: float) -> list[Check]:
    """The ratio to the best other sampler, converged ones first, beside its target."""
    if not others:
        return []
    best = max(others, key=lambda other: (other.converged, other.per_second))
    ratio = ours.per_second / best.per_second
    text = f"{'' if best.converged else 'at least '}{ratio:.1f} x"
    return [Check(f"ESS/s over {best.name}'s", text, f">= {least:g} x", ours.converged and ratio >= least)]


@threadpool_limits.wrap(limits=1, user_api="blas")
def main(arguments: Sequence[str] | None = None) -> None:
    """Prints the table and the targets."""
    parser = argparse.ArgumentParser(description="The posterior's sampler, compared with others.")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--seconds", type=float, default=60.0, help="of each other sampler, after its warm-up")
    parser.add_argument("--short", action="store_true", help="a simulated log, two seconds per sampler")
    options = parser.parse_args(arguments)
    path = options.data / f"{LOG}.csv"
    real = path.is_file() and not options.short
    if not real and not options.short:
        print(f"no file {path} (set BAYESID_DATA): a simulated log instead")
    problem = real_problem(path) if real else simulated_problem()
    settings = [Setting(Linear, 0.9, 50, depth=6)]
    if not options.short:
        settings = [Setting(LogCholesky, 0.9, 500), Setting(Linear, 0.9, 1000), Setting(Linear, 0.95, 1000)]
    if not numpyro_installed():
        print("NUTS is not run: numpyro is missing; pip install 'bayesid[bench]'")
        settings = []
    seconds = min(options.seconds, 2.0) if options.short else options.seconds
    checks = compare(problem, settings, seconds, again=not options.short)
    if not settings:
        print("NUTS                        not run: numpyro is missing")
    print()
    for check in checks:
        print(check)


if __name__ == "__main__":
    main()
