"""Where the walkers start, and the covariance by which they first choose their lines.

The optimum sits on the cone's edge, where nothing can be read off. The minimum of the same quadratic function with a
logarithmic barrier,

    phi(theta) = (theta - m)' A (theta - m) / 2 - sum log slack - sum log det P,

lies about as deep inside as the posterior does, and the inverse of phi's Hessian there is near the posterior's
covariance: one unit of the barrier is what a wall costs a density that may not cross it. phi is self-concordant, so
Newton's method with a line search finds its minimum from any inner point (Boyd and Vandenberghe 2004, 9.6).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import RandomState
from scipy.linalg import cho_solve

from bayesid.arrays import Array, Integers
from bayesid.posterior.moves import Conditional, HitAndRun, InTurn, NoiseScales, factor
from bayesid.posterior.region import Region
from bayesid.posterior.target import Target
from bayesid.posterior.tuning import TUNING


@dataclass(frozen=True)
class Centre:
    """The minimum of phi.

    Attributes:
        theta: (P,) strictly inside the region.
        covariance: (P, P) inverse of phi's Hessian there.
    """

    theta: Array
    covariance: Array


def find_centre(target: Target, theta: Array, log_scale: Array) -> Centre:
    """The centre for the signs that theta (P,), for example a branch's optimum, predicts for the unknown segments.

    Args:
        target: the posterior.
        theta: (P,), not necessarily feasible.
        log_scale: (n,) the noise scales u.

    Raises:
        LinAlgError: the Hessian is singular but for rounding.
    """
    precision, linear = target.quadratic(theta, log_scale)
    return barrier_minimum(target.prior.region, precision, linear, target.prior.inside)


def barrier_minimum(region: Region, precision: Array, linear: Array, start: Array) -> Centre:
    """Minimum of theta' A theta / 2 - linear' theta plus the region's barrier.

    Args:
        region: with an inner point.
        precision: (P, P) A, positive definite.
        linear: (P,).
        start: (P,) strictly inside.
    """
    theta, value = start, barrier_value(region, precision, linear, start)
    for _ in range(300):  # Newton's method needs some tens
        slope, curvature = barrier_derivatives(region, theta)
        gradient = precision @ theta - linear + slope
        step = -_inverse(precision + curvature) @ gradient
        decrement = -float(gradient @ step)
        if decrement < 1e-6:  # twice the distance from the minimum, nats (Boyd and Vandenberghe 2004, 9.6.3)
            break
        length, lower = 1.0, barrier_value(region, precision, linear, theta + step)
        while lower > value - 0.25 * length * decrement and length > 1e-12:
            length *= 0.5
            lower = barrier_value(region, precision, linear, theta + length * step)
        if lower >= value:
            break  # rounding
        theta, value = theta + length * step, lower
    return Centre(theta, _inverse(precision + barrier_derivatives(region, theta)[1]))


def _inverse(matrix: Array) -> Array:
    """Of a positive definite matrix whose rows may differ by many orders of magnitude.

    Raises:
        LinAlgError: it is singular by more than rounding.
    """
    inverse: Array = cho_solve((factor(matrix), True), np.eye(len(matrix)))
    return 0.5 * (inverse + inverse.T)


def barrier_value(region: Region, precision: Array, linear: Array, theta: Array) -> float:
    """Phi at theta (P,) but for a constant; inf outside of the region."""
    if not region.contains(theta[:, None])[0]:
        return np.inf
    logs = np.linalg.slogdet(region.full(region.matrices(theta[:, None])[..., 0]))[1]
    barrier = np.log(region.slack(theta[:, None])).sum() + logs.sum()
    return float(0.5 * theta @ precision @ theta - linear @ theta - barrier)


def barrier_derivatives(region: Region, theta: Array) -> tuple[Array, Array]:
    """Gradient (P,) and Hessian (P, P) of the barrier at theta (P,), which lies inside."""
    scaled = region.rows / region.slack(theta[:, None])
    root = np.linalg.inv(np.linalg.cholesky(region.full(region.matrices(theta[:, None])[..., 0])))
    white = root[:, None] @ region.basis @ root.swapaxes(1, 2)[:, None]  # (b, P, 4, 4), symmetric
    slope = -scaled.sum(axis=0) - np.einsum("bpii->p", white)
    flat = white.swapaxes(0, 1).reshape(len(theta), -1)
    return slope, scaled.T @ scaled + flat @ flat.T  # sums of squares: positive semidefinite however rounding goes


def spread_walkers(target: Target, centre: Centre, directions: Conditional, walkers: int, random: RandomState) -> Array:
    """(W, P + n) starting points, spread wider than the posterior: a few sweeps at a higher temperature.

    They begin inside the ellipsoid that the barrier's Hessian spans about the centre, which lies in the region
    (Nesterov and Nemirovskii 1994, 2.1.1).
    """
    root = factor(centre.covariance)
    noise = random.standard_normal((walkers, len(root)))
    radius = random.random_sample((walkers, 1)) / np.linalg.norm(noise, axis=1, keepdims=True)
    theta = centre.theta + TUNING.reach * radius * noise @ root.T
    coordinates = np.concatenate([theta, np.zeros((walkers, target.likelihood.n_joints))], axis=1)
    hot = InTurn([HitAndRun(target, directions, TUNING.hot), NoiseScales(target)])
    for _ in range(TUNING.hot_sweeps):
        coordinates = hot.update(coordinates, random)
    return coordinates


def body_blocks(region: Region) -> Integers:
    """(P,) the matrix in which each parameter shows; one more label for those that show in none."""
    shows = np.any(region.entries != 0.0, axis=0)
    if not len(shows):
        return np.zeros(region.size, dtype=np.int64)
    return np.where(shows.any(axis=0), shows.argmax(axis=0), len(shows))
