"""The modes of the posterior: their start points, their draws and their masses.

All unknown signs are summed out, so a walker moves between similar assignments. It does not cross the valley between
very different ones, mostly an assignment and the same with all signs of a joint flipped. So each mode is sampled by
itself. Start points are the assignments that the search could not exclude, and the best one with each joint flipped.
Information of an earlier log acts on all of them, and may exclude some.

The mass of a mode is its marginal likelihood: prior times likelihood, integrated over the region. Steps:

1. The first normal distribution has its mean at the region's centre, and as covariance the inverse Hessian of the log
   density with a barrier. Its mass inside the region is found by splitting (Kahn and Harris 1951; Au and Beck 2001):
   the region is widened until it includes all walkers, then narrowed level by level so that a fixed share of the
   walkers is inside. The mass is the product of the shares. Hit-and-run moves the walkers at each level.
2. Inside the region, this distribution is changed in a few steps to the normal distribution of theta given noise scales
   and all signs, exp(-theta' A theta / 2 + b' theta). Bridge sampling (Meng and Wong 1996) gives the ratios of the
   integrals, and so the mass of the second distribution inside the region, even if it is 1e-30.
3. A last bridge leads from the second distribution, with noise scales drawn given theta, to the draws of the posterior.
   So sums over signs and integrals over noise scales are exact.

Every step uses several groups of walkers, which share only the levels; their spread gives the standard error. The
prior's normalisation is omitted, as it is common to all modes.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy
from numpy.random import RandomState
from scipy.linalg import solve_triangular
from scipy.special import expit, gammaln, logsumexp

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects.plane import Plane
from bayesid.errors import SolverError
from bayesid.posterior.feasible_set import FeasibleSet, barrier_minimum
from bayesid.posterior.moves import Conditional, noise_scales, sweep
from bayesid.posterior.sampler import Diagnostics, Draws, Sampling, nominal_sweep, sample
from bayesid.posterior.target import Target
from bayesid.posterior.tuning import TUNING
from bayesid.progress import Progress
from bayesid.regression.knowledge import RIDGE, InformationMatrix
from bayesid.regression.normal_equations import NormalEquations
from bayesid.regression.solver import ConeLeastSquares
from bayesid.signs.search.protocol import SearchResult, predicted_signs, with_flipped


class MarginalLikelihood(NamedTuple):
    """The mass of a mode: log of the integral of exp(target.log_density), and its standard error."""

    log_value: float
    standard_error: float


@dataclass(frozen=True)
class Normal:
    """The density exp(-theta' A theta / 2 + b' theta), not normalised."""

    precision: Array  #: (P, P) A, positive definite
    linear: Array  #: (P,) b

    @classmethod
    def of_moments(cls, mean: Array, covariance: Array) -> Normal:
        """From its mean (P,) and covariance (P, P), in mixed units."""
        scale = np.sqrt(np.diag(covariance))
        inverse = np.linalg.inv(covariance / np.outer(scale, scale) + RIDGE * np.eye(len(mean)))
        precision = 0.5 * (inverse + inverse.T) / np.outer(scale, scale)
        return cls(precision, precision @ mean)

    @property
    def log_integral(self) -> float:
        """Log of the integral over all space."""
        factor = np.linalg.cholesky(self.precision)
        white = solve_triangular(factor, self.linear, lower=True)
        return float(0.5 * (white @ white + len(white) * np.log(2.0 * np.pi)) - np.log(np.diag(factor)).sum())

    def log_density(self, theta: Array) -> Array:
        """(W,) log density at theta (W, P)."""
        value: Array = np.sum(theta * (self.linear - 0.5 * theta @ self.precision), axis=1)
        return value

    def on(self, plane: Plane) -> tuple[Normal, float]:
        """The density of the coordinates y of a plane, and the log of its constant factor."""
        origin, basis = plane.origin, plane.basis
        gradient = self.linear - self.precision @ origin
        return Normal(basis.T @ self.precision @ basis, gradient @ basis), float(
            0.5 * (self.linear + gradient) @ origin
        )

    def toward(self, other: Normal, share: float) -> Normal:
        """The geometric mean with another normal distribution of weight `share`."""
        return Normal(
            (1.0 - share) * self.precision + share * other.precision, (1.0 - share) * self.linear + share * other.linear
        )

    def draw(self, walkers: int, random: RandomState) -> Array:
        """(W, P) draws over the whole space."""
        root = np.linalg.inv(np.linalg.cholesky(self.precision))
        return (root @ self.linear + random.standard_normal((walkers, len(root)))) @ root

    def move(self, region: FeasibleSet, theta: Array, lines: Conditional, sweeps: int, random: RandomState) -> Array:
        """(W, P) walkers after sweeps of hit-and-run inside the region, from theta (W, P)."""
        ones = np.ones((1, len(theta)))
        for _ in range(sweeps):
            columns = lines.draw(random)
            slopes = columns.T @ (self.linear[:, None] - self.precision @ theta.T)
            curvature = (columns.T @ self.precision @ columns)[None]
            theta = theta + (columns @ sweep(region, theta.T, columns, slopes, curvature, ones, random)).T
        return theta


def integrate(
    target: Target, draws: Draws, seed: int = 0, groups: int = TUNING.mass_groups, walkers: int = TUNING.mass_walkers
) -> MarginalLikelihood:
    """The mass of a mode from its draws, by at least 2 groups of walkers.

    Raises:
        SolverError: the splitting did not converge.
    """
    random = RandomState(seed)
    centre, scale = target.split(draws.coordinates.mean(axis=0))
    signs = target.likelihood.likelier_signs(centre[None], scale[None])
    normal = Normal(*target.quadratic(centre, scale))
    truncated = truncate(target.prior.region, normal, target.prior.inside, random, groups, walkers)
    likelihood = target.likelihood

    def residual(theta: Array) -> Array:
        return likelihood.residual(theta @ likelihood.projection.T, signs)

    def log_ratio(coordinates: Array) -> Array:
        theta, log_scale = target.split(coordinates)
        noise = _log_noise(0.5 * likelihood.count, residual(theta), log_scale)
        return target.log_density(coordinates) - normal.log_density(theta) - noise

    joined = np.concatenate([draws.theta, draws.log_scale], axis=-1)
    parts = np.array_split(np.moveaxis(joined, 0, 2).reshape(-1, joined.shape[-1]), groups)
    values = []
    for part, theta, mass in zip(parts, *truncated, strict=True):
        log_scale = noise_scales(0.5 * likelihood.count, residual(theta), random)
        values.append(mass + bridge(log_ratio(part), log_ratio(np.concatenate([theta, log_scale], axis=1))))
    return MarginalLikelihood(float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(len(values))))


def _log_noise(shape: Array, residual: Array, log_scale: Array) -> Array:
    constant = np.log(2.0) + shape * np.log(0.5 * residual) - gammaln(shape)
    value: Array = np.sum(constant - 2.0 * shape * log_scale - 0.5 * residual * np.exp(-2.0 * log_scale), axis=1)
    return value


def mode_weights(log_values: Array) -> Array:
    """(M,) masses of the modes, summing to one, from their logarithms (M,) (:eq:`mode-weight`)."""
    return np.exp(log_values - logsumexp(log_values))


def truncate(
    region: FeasibleSet, normal: Normal, inner: Array, random: RandomState, groups: int, walkers: int
) -> tuple[Array, Array]:
    """(G, W, P) draws of a normal distribution inside the region, and (G,) estimates of the log of its integral there.

    The mass inside may be tiny; `inner` (P,) lies strictly inside. The integral is over the region's plane.

    Raises:
        SolverError: the splitting did not converge.
    """
    plane, (flat, factor) = region.plane, normal.on(region.plane)
    y, log_mass = _truncate(region.flat, flat, plane.coordinates(inner), random, groups, walkers)
    return plane.point(y), log_mass + factor


def _truncate(
    region: FeasibleSet, normal: Normal, inner: Array, random: RandomState, groups: int, walkers: int
) -> tuple[Array, Array]:
    """The same for a region without equalities."""
    centre = barrier_minimum(region, normal.precision, normal.linear, inner)
    precision = np.linalg.inv(centre.covariance)
    first = Normal(0.5 * (precision + precision.T), precision @ centre.theta)
    theta, log_mass = truncate_by_splitting(region, first, centre.theta, random, groups, walkers)
    lines, current = Conditional.of(region, centre.covariance), first
    for k in range(TUNING.mass_steps):
        following = first.toward(normal, (k + 1) / TUNING.mass_steps)
        moved = following.move(region, theta.reshape(-1, region.size), lines, TUNING.step_sweeps, random)
        moved = moved.reshape(theta.shape)
        ratio = [
            bridge(*(following.log_density(points) - current.log_density(points) for points in pair))
            for pair in zip(moved, theta, strict=True)
        ]
        theta, log_mass, current = moved, log_mass + np.array(ratio), following
    return theta, log_mass


def truncate_by_splitting(
    region: FeasibleSet, normal: Normal, inner: Array, random: RandomState, groups: int, walkers: int
) -> tuple[Array, Array]:
    """The same by splitting only; its work grows with -log(mass inside); `inner` should lie deep inside."""
    most_levels = 2000  # each keeps a share of 0.3, so masses down to 1e-1000
    theta = normal.draw(groups * walkers, random)
    log_share = np.zeros(groups)
    for _ in range(most_levels):
        excess = region.excess(theta.T, inner).reshape(groups, -1)
        second = float(np.sort(excess, axis=1)[:, 1].max())  # at least two walkers of each group survive
        relaxation = max(float(np.quantile(excess, TUNING.mass_share)), second, 0.0)
        stays = excess <= relaxation if relaxation > 0.0 else excess < 0.0
        log_share += np.log(stays.mean(axis=1))
        theta = theta[_resample(stays, random)]
        relaxed = region.relaxed(relaxation * (1.0 + 1e-9), inner)  # keeps the last survivor despite rounding
        lines = Conditional.of(relaxed, barrier_minimum(relaxed, normal.precision, normal.linear, inner).covariance)
        theta = normal.move(relaxed, theta, lines, TUNING.level_sweeps, random)
        if relaxation == 0.0:
            return theta.reshape(groups, walkers, region.size), log_share + normal.log_integral
    status = f"{most_levels} levels are too few for the mass inside the region"
    raise SolverError("marginal likelihoods of the modes", status)


def _resample(stays: Mask, random: RandomState) -> Integers:
    """(G W,) indices of walkers: those of each group that stay, each about equally often."""
    groups, walkers = stays.shape
    chosen = []
    for g in range(groups):
        members = np.flatnonzero(stays[g])
        members = members[np.argsort(random.random_sample(len(members)))]
        chosen.append(g * walkers + np.resize(members, walkers))
    return np.concatenate(chosen)


def bridge(of_target: Array, of_other: Array) -> float:
    """Log of the ratio of two integrals, target over other: Meng and Wong's optimal bridge, as Bennett's equation.

    The arguments are log(target / other) at (M,) draws of the target, and at (N,) draws of the other.
    """
    shift = np.log(len(of_target) / len(of_other))

    def excess(ratio: float) -> float:
        up = np.mean(expit(of_other - ratio + shift)) * len(of_other)
        down = np.mean(expit(ratio - shift - of_target)) * len(of_target)
        return float(up - down)  # falls from N to -M

    values = np.concatenate([of_target, of_other])
    low, high = float(values.min()) - 50.0, float(values.max()) + 50.0  # 50 exceeds the log of any ratio of N and M
    return float(scipy.optimize.brentq(excess, low, high, xtol=1e-10))


class Mode(NamedTuple):
    """The start point of a mode's walkers."""

    theta: Array  #: (P,) centre, strictly inside the region
    signs: Integers  #: (S,) signs of the start point
    log_density: float  #: of the target at the centre, at the reference noise


def find_modes(
    target: Target, normal_equations: NormalEquations, solver: ConeLeastSquares, search: SearchResult
) -> tuple[Mode, ...]:
    """The modes with enough density at their centre, the densest first.

    The normal equations are in units of the target's reference noise. The solver is prepared for their sum with the
    information of an earlier log.

    Raises:
        SolverError: a cone problem could not be solved.
    """
    starts = starting_points(normal_equations, target.information, solver, search)
    modes = sorted((_mode(target, signs, theta) for signs, theta in starts), key=lambda mode: -mode.log_density)
    kept: list[Mode] = []
    for mode in modes:
        relevant = mode.log_density >= modes[0].log_density - TUNING.mode_depth
        if relevant and all(_valley(target, mode, denser) >= TUNING.valley for denser in kept):
            kept.append(mode)
    return tuple(kept[: TUNING.most_modes])


def starting_points(
    normal_equations: NormalEquations,
    information: InformationMatrix | None,
    solver: ConeLeastSquares,
    search: SearchResult,
) -> list[tuple[Integers, Array]]:
    """Signs and best parameters of the search's branches, and of its best assignment with each joint flipped.

    Starts with a lower bound far above the best cost are dropped. The bound allows for rounding errors of the cost,
    which with little noise is a small difference of large numbers.

    Raises:
        SolverError: a cone problem could not be solved.
    """
    prepared, of_information = solver.prepared(), 0.0 if information is None else information.gradient

    def gradient(signs: Integers) -> Array:
        return signs @ normal_equations.gradient + of_information

    def alternated(signs: Integers) -> Integers:
        """Signs after a few alternations of parameters and signs."""
        for _ in range(TUNING.sign_rounds):
            theta = prepared.solve(gradient(signs)).theta
            before, signs = signs, predicted_signs(normal_equations, prepared.project(theta))
            if np.array_equal(signs, before):
                break
        return signs

    starts = [branch.signs for branch in search.branches[: TUNING.most_branches]] or [search.signs]
    for joint in np.unique(normal_equations.joint[normal_equations.known == 0]):
        starts.append(alternated(with_flipped(normal_equations, search.signs, joint)))
    distinct = {signs.tobytes(): signs for signs in starts}.values()
    fits = [(signs, prepared.solve_precisely(gradient(signs))) for signs in distinct]
    most = min(fit.cost for _, fit in fits) + 2.0 * TUNING.start_depth
    return [(signs, fit.theta) for signs, fit in fits if fit.lower_bound <= most]


def _mode(target: Target, signs: Integers, theta: Array) -> Mode:
    scale = np.zeros(target.likelihood.n_joints)
    centre = target.centre(theta, scale).theta
    return Mode(centre, signs, float(target.log_density(np.append(centre, scale))[0]))


def _valley(target: Target, mode: Mode, other: Mode) -> float:
    """Depth of the density's minimum on the straight line between two modes, nats below the lower mode.

    The region is convex, so the line lies inside.
    """
    share = np.linspace(0.0, 1.0, TUNING.valley_steps + 1)[1:-1, None]
    theta = (1.0 - share) * mode.theta + share * other.theta
    scale = np.zeros((len(theta), target.likelihood.n_joints))
    lowest = float(target.log_density(np.hstack([theta, scale])).min())
    return min(mode.log_density, other.log_density) - lowest


@dataclass(frozen=True)
class SampledMode:
    """One mode and its draws."""

    mode: Mode  #: start point of the walkers
    draws: Draws  #: of this mode alone
    marginal_likelihood: MarginalLikelihood | None  #: its mass; None for a single mode
    weight: float  #: its share of all modes' mass


def sample_modes(
    target: Target, modes: Sequence[Mode], sampling: Sampling, began: float, progress: Progress
) -> tuple[SampledMode, ...]:
    """The modes with draws and, if there are several, with weights, heaviest first.

    Budget and time that remain are divided equally among the remaining modes, for draws and mass. The time limit of
    `sampling` counts from `began`, on the clock of `time.perf_counter`.

    Raises:
        SolverError: the mass of a mode could not be computed.
    """
    draws: list[Draws] = []
    masses: list[MarginalLikelihood] = []
    several = len(modes) > 1
    mass = TUNING.mass_sweeps * nominal_sweep(target, sampling.ensembles * sampling.walkers) * several
    remaining = sampling.budget
    for k, mode in enumerate(modes):
        remaining_modes = len(modes) - k
        on_the_clock = max(0.0, sampling.time_limit - (time.perf_counter() - began)) / remaining_modes
        share = replace(sampling, budget=max(0.0, remaining / remaining_modes), time_limit=on_the_clock)
        of_all = f" of mode {k + 1} of {len(modes)}" if several else ""
        with progress.stage(f"sampling{of_all}") as steps:
            draws.append(sample(target, mode.theta, share, steps, mass))
        remaining -= draws[-1].spent + mass
        if several:
            with progress.stage(f"sampling: weight{of_all}"):
                masses.append(integrate(target, draws[-1], sampling.seed))
    if not masses:
        return (SampledMode(modes[0], draws[0], None, 1.0),)
    weights = mode_weights(np.array([mass.log_value for mass in masses])).tolist()
    weighed = [SampledMode(*columns) for columns in zip(modes, draws, masses, weights, strict=True)]
    return tuple(sorted(weighed, key=lambda sampled: -sampled.weight))


def pool(modes: tuple[SampledMode, ...]) -> Draws:
    """All modes' draws in one array, in proportion to the weights; those of the heaviest mode first.

    Some walkers change to the next mode one sweep earlier than others, so that shares are finer than a sweep.
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
    """(D, E, W) index of each pooled draw's mode."""
    if len(modes) == 1:
        return np.zeros(modes[0].draws.log_density.shape, dtype=np.int64)
    first = np.cumsum([sampled.draws.sweeps for sampled in _heavy(modes)])
    return np.searchsorted(first, _places(_heavy(modes))[0], side="right")


def _heavy(modes: tuple[SampledMode, ...]) -> list[SampledMode]:
    return [sampled for sampled in modes if sampled.weight >= TUNING.negligible_mode]


def _places(heavy: Sequence[SampledMode]) -> tuple[Integers, ...]:
    """Indices (sweep, ensemble, walker) of the pooled draws in the concatenated draws of all modes."""
    sweeps = np.array([sampled.draws.sweeps for sampled in heavy])
    weight = np.array([sampled.weight for sampled in heavy])
    total = max(1, int(np.min(sweeps * weight.sum() / weight)))
    ensembles, walkers = heavy[0].draws.log_density.shape[1:]
    late = (np.arange(ensembles * walkers).reshape(walkers, ensembles).T + 0.5) / (ensembles * walkers)
    shares = np.cumsum(np.append(0.0, weight / weight.sum()))
    # first and last sweep of each mode, for each walker
    bounds = np.floor(total * shares[:, None, None] + late).astype(int)
    bounds[-1] = total
    sweep = np.arange(total)[:, None, None]
    mode = np.sum(sweep >= bounds[1:-1, None], axis=0)
    begin = np.take_along_axis(bounds, mode, axis=0)
    count = np.take_along_axis(bounds, mode + 1, axis=0) - begin
    chosen = (2 * (sweep - begin) + 1) * sweeps[mode] // (2 * count)  # index among the mode's sweeps
    first = np.cumsum(np.append(0, sweeps[:-1]))
    return (first[mode] + chosen, *np.ogrid[:ensembles, :walkers])


def _worst(of_modes: list[Diagnostics]) -> Diagnostics:
    return Diagnostics(
        np.max([diagnostics.rhat for diagnostics in of_modes], axis=0),
        np.min([diagnostics.bulk for diagnostics in of_modes], axis=0),
        np.min([diagnostics.tail for diagnostics in of_modes], axis=0),
    )
