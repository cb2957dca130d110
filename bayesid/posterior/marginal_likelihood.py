"""The marginal likelihood of a mode: prior times likelihood, integrated over the region. It is the mode's mass.

1. A normal distribution that fits the region, N(centre, inverse Hessian of the quadratic function with a barrier).
   Its share inside the region comes by splitting (Kahn and Harris 1951; Au and Beck 2001): the region is widened until
   it holds all draws, then narrowed again so that a part of the walkers stays at each level; the product of these parts
   is the share. The walkers follow by hit-and-run.
2. Restricted to the region, it is led in a few steps to the normal distribution of theta given noise scales and all
   signs, exp(-theta' A theta / 2 + b' theta). Bridge sampling (Meng and Wong 1996) gives the ratio of integrals from
   step to step, and with them the share of that normal distribution inside the region, be it 1e-30.
3. This distribution, with the noise scales drawn given theta, is q. A last bridge between q and the posterior's own
   draws makes sums over signs and integrals over noise scales exact.

Every step is done by several groups of walkers, which share the levels alone; their spread gives the standard error.
The prior's normalisation is left out: it is the same for all modes.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.random import RandomState
from scipy.linalg import solve_triangular
from scipy.special import expit, gammaln, logsumexp

from bayesid.arrays import TINY, Array, Integers, Mask
from bayesid.errors import SolverError
from bayesid.posterior.moves import Conditional, sweep
from bayesid.posterior.region import Region
from bayesid.posterior.sampler import Draws
from bayesid.posterior.start import barrier_minimum, body_blocks
from bayesid.posterior.target import Target
from bayesid.posterior.tuning import TUNING


@dataclass(frozen=True)
class MarginalLikelihood:
    """The mass of a mode.

    Attributes:
        log_value: of the integral of exp(target.log_density).
        standard_error: of log_value.
        log_share: of the normal distribution's mass inside the region.
        levels: of the splitting.
        seconds: of wall time.
    """

    log_value: float
    standard_error: float
    log_share: float
    levels: int
    seconds: float


@dataclass(frozen=True)
class Normal:
    """The density exp(-theta' A theta / 2 + b' theta), not normalised.

    Attributes:
        precision: (P, P) A, positive definite.
        linear: (P,) b.
    """

    precision: Array
    linear: Array

    @property
    def log_integral(self) -> float:
        """Log of the integral over all space."""
        factor = np.linalg.cholesky(self.precision)
        white = solve_triangular(factor, self.linear, lower=True)
        return float(0.5 * (white @ white + len(white) * np.log(2.0 * np.pi)) - np.log(np.diag(factor)).sum())

    def log_density(self, theta: Array) -> Array:
        """(W,) at theta (W, P)."""
        value: Array = np.sum(theta * (self.linear - 0.5 * theta @ self.precision), axis=1)
        return value

    def toward(self, other: Normal, share: float) -> Normal:
        """The normal distribution on the way to another one: the geometric mean with this weight of the other."""
        return Normal(
            (1.0 - share) * self.precision + share * other.precision, (1.0 - share) * self.linear + share * other.linear
        )

    def draw(self, walkers: int, random: RandomState) -> Array:
        """(W, P) draws over all space."""
        root = np.linalg.inv(np.linalg.cholesky(self.precision))
        return (root @ self.linear + random.standard_normal((walkers, len(root)))) @ root

    def move(self, region: Region, theta: Array, lines: Conditional, sweeps: int, random: RandomState) -> Array:
        """(W, P) walkers after sweeps of hit-and-run inside the region, from theta (W, P)."""
        ones = np.ones((1, len(theta)))
        for _ in range(sweeps):
            columns = lines.draw(random)
            slopes = columns.T @ (self.linear[:, None] - self.precision @ theta.T)
            curvature = (columns.T @ self.precision @ columns)[None]
            theta = theta + (columns @ sweep(region, theta.T, columns, slopes, curvature, ones, random)).T
        return theta


@dataclass(frozen=True)
class TruncatedNormal:
    """A normal distribution restricted to a region, by G groups of walkers.

    Attributes:
        theta: (G, W, P) draws.
        log_mass: (G,) each group's estimate of the log of the integral over the region.
        levels: of the splitting.
    """

    theta: Array
    log_mass: Array
    levels: int


def integrate(
    target: Target, draws: Draws, seed: int = 0, groups: int = TUNING.mass_groups, walkers: int = TUNING.mass_walkers
) -> MarginalLikelihood:
    """The mass of a mode from its draws.

    Args:
        target: the posterior.
        draws: of the mode.
        seed: of all random numbers.
        groups: of walkers; at least 2.
        walkers: in each group.

    Raises:
        SolverError: the levels do not come to an end.
    """
    began = time.perf_counter()
    random = np.random.RandomState(seed)
    centre, scale = target.split(draws.coordinates.mean(axis=0))
    signs = target.likelihood.likelier_signs(centre[None], scale[None])
    normal = Normal(*target.quadratic(centre, scale))
    truncated = truncate(target.prior.region, normal, target.prior.inside, random, groups, walkers)

    def log_ratio(coordinates: Array) -> Array:
        theta, log_scale = target.split(coordinates)
        return target.log_density(coordinates) - normal.log_density(theta) - _log_noise(target, theta, log_scale, signs)

    joined = np.concatenate([draws.theta, draws.log_scale], axis=-1)
    parts = np.array_split(np.moveaxis(joined, 0, 2).reshape(-1, joined.shape[-1]), groups)
    values = []
    for part, theta, mass in zip(parts, truncated.theta, truncated.log_mass, strict=True):
        proposed = np.concatenate([theta, _draw_noise(target, theta, signs, random)], axis=1)
        values.append(mass + bridge(log_ratio(part), log_ratio(proposed)))
    return MarginalLikelihood(
        log_value=float(np.mean(values)),
        standard_error=float(np.std(values, ddof=1) / np.sqrt(len(values))),
        log_share=float(np.mean(truncated.log_mass)) - normal.log_integral,
        levels=truncated.levels,
        seconds=time.perf_counter() - began,
    )


def mode_weights(log_values: Array) -> Array:
    """(M,) masses of the modes, summing to one, from their logarithms (M,) (:eq:`mode-weight`)."""
    return np.exp(log_values - logsumexp(log_values))


# ---------------------------------------------------------------------------------------------------------------
# The normal distribution inside the region
# ---------------------------------------------------------------------------------------------------------------
def truncate(
    region: Region, normal: Normal, inner: Array, random: RandomState, groups: int, walkers: int
) -> TruncatedNormal:
    """Draws of a normal distribution inside the region, and its integral over it.

    Args:
        region: convex.
        normal: the distribution; nearly all of it may lie outside.
        inner: (P,) a point strictly inside the region.
        random: the random state.
        groups: G of walkers.
        walkers: W in each group.

    Raises:
        SolverError: the levels do not come to an end.
    """
    centre = barrier_minimum(region, normal.precision, normal.linear, inner)
    precision = np.linalg.inv(centre.covariance)
    first = Normal(0.5 * (precision + precision.T), precision @ centre.theta)
    fitting = truncate_by_splitting(region, first, centre.theta, random, groups, walkers)
    lines = Conditional(centre.covariance, body_blocks(region))
    theta, log_mass, current = fitting.theta, fitting.log_mass, first
    for k in range(TUNING.mass_steps):
        following = first.toward(normal, (k + 1) / TUNING.mass_steps)
        moved = following.move(region, theta.reshape(-1, region.size), lines, TUNING.step_sweeps, random)
        moved = moved.reshape(theta.shape)
        ratio = [
            bridge(*(following.log_density(points) - current.log_density(points) for points in pair))
            for pair in zip(moved, theta, strict=True)
        ]
        theta, log_mass, current = moved, log_mass + np.array(ratio), following
    return TruncatedNormal(theta, log_mass, fitting.levels)


def truncate_by_splitting(
    region: Region, normal: Normal, inner: Array, random: RandomState, groups: int, walkers: int
) -> TruncatedNormal:
    """The same by splitting alone, whose price grows with the log of the share; `inner` is best deep inside."""
    block, most_levels = body_blocks(region), 2000  # each keeps a share of 0.3: masses down to 1e-1000
    theta = normal.draw(groups * walkers, random)
    log_share = np.zeros(groups)
    for level in range(1, most_levels + 1):
        excess = region.excess(theta.T, inner).reshape(groups, -1)
        second = float(np.sort(excess, axis=1)[:, 1].max())  # two walkers of each group stay at least
        relaxation = max(float(np.quantile(excess, TUNING.mass_share)), second, 0.0)
        stays = excess <= relaxation if relaxation > 0.0 else excess < 0.0
        log_share += np.log(stays.mean(axis=1))
        theta = theta[_resample(stays, random)]
        relaxed = region.relaxed(relaxation * (1.0 + 1e-9), inner)  # rounding must not shut out the last one that stays
        lines = Conditional(barrier_minimum(relaxed, normal.precision, normal.linear, inner).covariance, block)
        theta = normal.move(relaxed, theta, lines, TUNING.level_sweeps, random)
        if relaxation == 0.0:
            shape = (groups, walkers, region.size)
            return TruncatedNormal(theta.reshape(shape), log_share + normal.log_integral, level)
    status = f"{most_levels} levels do not reach the mass inside the region"
    raise SolverError("marginal likelihoods of the modes", status)


def _resample(stays: Mask, random: RandomState) -> Integers:
    """(G W,) indices of walkers: in each group those that stay, each about equally often."""
    groups, walkers = stays.shape
    chosen = []
    for g in range(groups):
        members = np.flatnonzero(stays[g])
        members = members[np.argsort(random.random_sample(len(members)))]
        chosen.append(g * walkers + np.resize(members, walkers))
    return np.concatenate(chosen)


# ---------------------------------------------------------------------------------------------------------------
# Noise scales and bridge
# ---------------------------------------------------------------------------------------------------------------
def _draw_noise(target: Target, theta: Array, signs: Array, random: RandomState) -> Array:
    """(W, n) noise scales u given theta (W, P) and the unknown signs (1, w), without their prior."""
    likelihood = target.likelihood
    residual = likelihood.residual(theta @ likelihood.projection.T, signs)
    gamma = random.standard_gamma(0.5 * likelihood.count, residual.shape)
    return -0.5 * np.log(np.maximum(gamma, TINY) / (0.5 * residual))


def _log_noise(target: Target, theta: Array, log_scale: Array, signs: Array) -> Array:
    """(W,) log density of these draws."""
    likelihood = target.likelihood
    residual = likelihood.residual(theta @ likelihood.projection.T, signs)
    shape = 0.5 * likelihood.count
    constant = np.log(2.0) + shape * np.log(0.5 * residual) - gammaln(shape)
    value: Array = np.sum(constant - 2.0 * shape * log_scale - 0.5 * residual * np.exp(-2.0 * log_scale), axis=1)
    return value


def bridge(of_target: Array, of_other: Array) -> float:
    """Log of the ratio of two integrals, target over other: Meng and Wong's optimal bridge, as Bennett's equation.

    Args:
        of_target: (M,) log(target / other) at draws of the target.
        of_other: (N,) the same at draws of the other.
    """
    shift = np.log(len(of_target) / len(of_other))

    def excess(ratio: float) -> float:
        up = np.mean(expit(of_other - ratio + shift)) * len(of_other)
        down = np.mean(expit(ratio - shift - of_target)) * len(of_target)
        return float(up - down)  # falls from N to -M

    values = np.concatenate([of_target, of_other])
    low, high = float(values.min()) - 50.0, float(values.max()) + 50.0  # no numbers of draws differ by exp(50)
    return float(scipy.optimize.brentq(excess, low, high, xtol=1e-10))
