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
import importlib.util
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
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
from bayesid.robot.inertia import PSEUDO_INERTIA_BASIS, pseudo_inertia
from bayesid.simulation.logs import simulate_log
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
_LOG_2 = float(np.log(2.0))


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
# Coordinates of NUTS
# ---------------------------------------------------------------------------------------------------------------
def numpyro_installed() -> bool:
    """Whether NUTS can be run."""
    return importlib.util.find_spec("numpyro") is not None


@cache
def _jax() -> Any:
    """The optional package jax, in double precision and on one thread."""
    flags = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {flags}"
    import jax

    jax.config.update("jax_enable_x64", True)
    return jax


class Coordinates(ABC):
    """A smooth map of R^d onto the region without the bounds of the total mass.

    Coordinates z: ten per body, one per nonnegative parameter, all other parameters, the noise scales u.

    Args:
        problem: with the region.
        starts: (W, P + n) points inside, from which some maps take their scales.
    """

    name: str

    def __init__(self, problem: Problem, starts: Array) -> None:
        cone = problem.cone
        self.n_parameters, self.bodies, self.nonnegative = cone.size, cone.bodies, cone.nonnegative
        self.free = np.setdiff1d(np.arange(cone.size), np.concatenate([cone.bodies.ravel(), cone.nonnegative]))
        self.square_radius = _square_radii(problem)
        self.of_matrix = np.linalg.pinv(PSEUDO_INERTIA_BASIS.reshape(10, 16).T)
        self._ends = np.cumsum([cone.bodies.size, len(cone.nonnegative), len(self.free)])

    @abstractmethod
    def matrices(self, z: Any) -> tuple[Any, Any]:
        """(b, 4, 4) pseudo-inertias from coordinates (b, 10), and the sum of log |d triangle / d z|."""

    @abstractmethod
    def positive(self, z: Any) -> tuple[Any, Any]:
        """(k,) nonnegative parameters, and the sum of the logs of the map's derivatives."""

    @abstractmethod
    def matrices_back(self, matrices: Array) -> Array:
        """(W, b, 10) coordinates of pseudo-inertias (W, b, 4, 4)."""

    @abstractmethod
    def positive_back(self, values: Array) -> Array:
        """(W, k) coordinates of nonnegative parameters (W, k)."""

    def forward(self, z: Any) -> tuple[Any, Any]:
        """(P + n,) theta and u of one z (P + n,), and log |Jacobian|."""
        jnp = _jax().numpy
        of_bodies, of_positive, of_free, log_scale = jnp.split(z, self._ends)
        matrices, volume = self.matrices(of_bodies.reshape(-1, 10))
        positive, stretched = self.positive(of_positive)
        theta = jnp.zeros(self.n_parameters)
        theta = theta.at[self.bodies].set(matrices.reshape(-1, 16) @ self.of_matrix.T)
        theta = theta.at[self.nonnegative].set(positive).at[self.free].set(of_free)
        # the map from J to tr(J) / 2 E - J, the part of a pseudo-inertia that is not a parameter, has determinant 1 / 2
        return jnp.concatenate([theta, log_scale]), volume + stretched + len(self.bodies) * _LOG_2

    def back(self, coordinates: Array) -> Array:
        """(W, P + n) z of theta and u (W, P + n)."""
        theta = coordinates[:, : self.n_parameters]
        of_bodies = self.matrices_back(pseudo_inertia(theta[:, self.bodies])).reshape(len(theta), -1)
        of_positive = self.positive_back(theta[:, self.nonnegative])
        unchanged = theta[:, self.free], coordinates[:, self.n_parameters :]
        return np.concatenate([of_bodies, of_positive, *unchanged], axis=1)


def _windows(problem: Problem) -> tuple[Array, Array]:
    """(m, P) rows and (m,) offsets of the half spaces outside the cone, in the order of `FeasibleSet.of`."""
    region, cone = problem.target.prior.region, problem.cone
    inner = slice(len(cone.nonnegative), len(region.rows) - 4 * len(cone.bodies))
    return region.rows[inner], region.offset[inner]


def _square_radii(problem: Problem) -> Array:
    """(b,) R^2 of each body's bound tr(Sigma) <= R^2 m.

    Raises:
        ValueError: the first half spaces are of another form.
    """
    bodies = problem.cone.bodies
    rows, offset = _windows(problem)
    square = np.array([row[body[9]] for row, body in zip(rows, bodies, strict=False)])
    expected = np.zeros((len(bodies), problem.cone.size))
    for k, body in enumerate(bodies):
        expected[k, body[[0, 3, 5]]], expected[k, body[9]] = -0.5, square[k]
    if not np.array_equal(rows[: len(bodies)], expected) or np.any(offset[: len(bodies)] != 0.0):
        raise ValueError("the prior's bounds of the radii differ from those that these coordinates remove")
    return square


def _joined(second: Any, first: Any, mass: Any) -> Any:
    """(b, 4, 4) [[second, first], [first', mass]] of (b, 3, 3), (b, 3) and (b,)."""
    jnp = _jax().numpy
    top = jnp.concatenate([second, first[:, :, None]], axis=2)
    return jnp.concatenate([top, jnp.concatenate([first, mass[:, None]], axis=1)[:, None]], axis=1)


class LogCholesky(Coordinates):
    """P = U U' with U upper triangular, logarithms of its diagonal as coordinates.

    Bound of the radius: with r = tr(Sigma) / (R^2 m) of such a P, lengths are multiplied by sqrt(f), f = 1 / (1 + r),
    so that f r < 1. The determinant of this map is f^8.5.
    """

    name = "log-Cholesky"
    _upper = ((0, 0, 1, 0, 1, 2), (1, 2, 2, 3, 3, 3))

    def matrices(self, z: Any) -> tuple[Any, Any]:
        """See Coordinates."""
        jnp = _jax().numpy
        root = jnp.zeros((len(z), 4, 4)).at[:, np.arange(4), np.arange(4)].set(jnp.exp(z[:, :4]))
        root = root.at[:, self._upper[0], self._upper[1]].set(z[:, 4:])
        wide = root @ root.swapaxes(1, 2)
        trace = wide[:, 0, 0] + wide[:, 1, 1] + wide[:, 2, 2]
        log_f = -jnp.log1p(trace / (self.square_radius * wide[:, 3, 3]))
        length = jnp.exp(0.5 * log_f)[:, None] ** np.array([1.0, 1.0, 1.0, 0.0])
        volume = jnp.sum(z[:, :4] @ np.array([2.0, 3.0, 4.0, 5.0]) + 8.5 * log_f + 4.0 * _LOG_2)
        return length[:, :, None] * wide * length[:, None, :], volume

    def positive(self, z: Any) -> tuple[Any, Any]:
        """See Coordinates."""
        jnp = _jax().numpy
        return jnp.exp(z), jnp.sum(z)

    def matrices_back(self, matrices: Array) -> Array:
        """See Coordinates."""
        ratio = np.trace(matrices[..., :3, :3], axis1=-2, axis2=-1) / (self.square_radius * matrices[..., 3, 3])
        length = (1.0 - ratio)[..., None] ** np.array([-0.5, -0.5, -0.5, 0.0])
        wide = length[..., :, None] * matrices * length[..., None, :]
        root = np.linalg.cholesky(wide[..., ::-1, ::-1])[..., ::-1, ::-1]
        diagonal = np.log(np.diagonal(root, axis1=-2, axis2=-1))
        return np.concatenate([diagonal, root[..., self._upper[0], self._upper[1]]], axis=-1)

    def positive_back(self, values: Array) -> Array:
        """See Coordinates."""
        return np.log(values)


class Linear(Coordinates):
    """Coordinates in which parameters are as linear as the region allows.

    A body is h, its first moments; mu > 0 with mass m, R^2 m - |h|^2 / m = R^2 mu; and C = Sigma - h h' / m, positive
    definite with tr(C) < R^2 mu. With some positive definite W and t = tr(W) / (R^2 mu) it is C = W (1 - exp(-t)) / t;
    W is given by its pivots and the columns of its Schur complements. mu, pivots and nonnegative parameters are
    s softplus(z / s) of coordinates z, with s a tenth of the size at the starting points.
    """

    name = "linear"
    _softness = 0.1

    def __init__(self, problem: Problem, starts: Array) -> None:
        super().__init__(problem, starts)
        theta = starts[:, : self.n_parameters]
        pivots = self._eliminated(pseudo_inertia(theta[:, self.bodies]))[0]
        self._of_pivots = self._softness * np.median(pivots, axis=0)
        self._of_positive = self._softness * np.median(theta[:, self.nonnegative], axis=0)

    def matrices(self, z: Any) -> tuple[Any, Any]:
        """See Coordinates."""
        jnp = _jax().numpy
        pivots, stretched = _softplus(z[:, :4], self._of_pivots)
        mu, first = pivots[:, 0], z[:, 4:7]
        root = jnp.sqrt(mu**2 + 4.0 * jnp.sum(first**2, axis=1) / self.square_radius)
        mass = 0.5 * (mu + root)
        wide = pivots[:, 3][:, None, None]
        for pivot, column in ((pivots[:, 2], z[:, 9:10]), (pivots[:, 1], z[:, 7:9])):
            wide = wide + column[:, :, None] * column[:, None, :] / pivot[:, None, None]
            border = jnp.concatenate([pivot[:, None], column], axis=1)[:, :, None]
            wide = jnp.concatenate([border, jnp.concatenate([column[:, None], wide], axis=1)], axis=2)
        t = (wide[:, 0, 0] + wide[:, 1, 1] + wide[:, 2, 2]) / (self.square_radius * mu)
        f = -jnp.expm1(-t) / t
        second = f[:, None, None] * wide + first[:, :, None] * first[:, None, :] / mass[:, None, None]
        volume = jnp.sum(5.0 * jnp.log(f) - t + jnp.log(mass / root))
        return _joined(second, first, mass), stretched + volume

    def positive(self, z: Any) -> tuple[Any, Any]:
        """See Coordinates."""
        return _softplus(z, self._of_positive)

    def matrices_back(self, matrices: Array) -> Array:
        """See Coordinates."""
        pivots, columns = self._eliminated(matrices)
        return np.concatenate([_softplus_back(pivots, self._of_pivots), columns], axis=-1)

    def positive_back(self, values: Array) -> Array:
        """See Coordinates."""
        return _softplus_back(values, self._of_positive)

    def _eliminated(self, matrices: Array) -> tuple[Array, Array]:
        """(W, b, 4) mu and pivots, (W, b, 6) h and columns."""
        first, mass = matrices[..., :3, 3], matrices[..., 3, 3]
        mu = mass - np.sum(first**2, axis=-1) / (self.square_radius * mass)
        schur = matrices[..., :3, :3] - first[..., :, None] * first[..., None, :] / mass[..., None, None]
        ratio = np.trace(schur, axis1=-2, axis2=-1) / (self.square_radius * mu)
        schur = schur * (-np.log1p(-ratio) / ratio)[..., None, None]
        pivots, columns = [mu], [first]
        for _ in range(3):
            pivot, column = schur[..., 0, 0], schur[..., 1:, 0]
            pivots.append(pivot)
            columns.append(column)
            schur = schur[..., 1:, 1:] - column[..., :, None] * column[..., None, :] / pivot[..., None, None]
        return np.stack(pivots, axis=-1), np.concatenate(columns, axis=-1)


def _softplus(z: Any, scale: Array) -> tuple[Any, Any]:
    """Values s log(1 + exp(z / s)), and the sum of the logs of the derivatives."""
    jax = _jax()
    return scale * jax.nn.softplus(z / scale), jax.numpy.sum(jax.nn.log_sigmoid(z / scale))


def _softplus_back(values: Array, scale: Array) -> Array:
    back: Array = values + scale * np.log(-np.expm1(-values / scale))
    return back


def make_log_density(problem: Problem, coordinates: Coordinates) -> Callable[[Any], Any]:
    """Log density of z (P + n,), in jax: `Target.log_density` plus log |Jacobian|."""
    jnp = _jax().numpy
    likelihood, prior = problem.target.likelihood, problem.target.prior
    n, r, _ = likelihood.hessian.shape
    hessian, joint = jnp.asarray(likelihood.hessian.reshape(n * r, r)), likelihood.joint[likelihood.unknown]
    rows, offset = (part[len(problem.cone.bodies) :] for part in _windows(problem))

    def log_density(z: Any) -> Any:
        inner, volume = coordinates.forward(z)
        theta, log_scale = inner[: len(prior.mean)], inner[len(prior.mean) :]
        beta, weight = likelihood.projection @ theta, jnp.exp(-2.0 * log_scale)
        push = jnp.abs(likelihood.open_gradient @ beta * weight[joint])
        marginal = jnp.sum(push + jnp.log1p(jnp.exp(-2.0 * push)))
        squares = (hessian @ beta).reshape(n, r) @ beta + likelihood.energy
        data = marginal - likelihood.count @ log_scale - weight @ (0.5 * squares - likelihood.fixed_gradient @ beta)
        square = jnp.sum(((theta - prior.mean) / prior.sd) ** 2) + jnp.sum((log_scale / prior.log_scale_sd) ** 2)
        inside = jnp.all(rows @ theta + offset > 0.0)
        return jnp.where(inside, data - 0.5 * square + volume, -jnp.inf)

    return log_density


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
    jax = _jax()
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
