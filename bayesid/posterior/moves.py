"""Moves of an emcee ensemble for a truncated normal distribution with unknown signs and noise scales.

Each move leaves the posterior of every walker invariant. Walkers of all ensembles move together, so that numpy works on
long arrays. A move first draws the unknown signs given all else and drops them at its end (data augmentation: Tanner
and Wong 1987). Given the signs, theta is normal inside the region, and hit-and-run draws exactly along each line (Smith
1984; Chen and Schmeiser 1993), without rejections.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.random import RandomState
from scipy.special import wrightomega

from bayesid.arrays import TINY, Array, Integers
from bayesid.posterior.feasible_set import Centre, FeasibleSet, draw_on_line, factor
from bayesid.posterior.target import Target
from bayesid.posterior.tuning import TUNING

if TYPE_CHECKING:
    from emcee.state import State


@dataclass(frozen=True)
class Conditional:
    """Columns of a Cholesky factor of the covariance, with the parameters in a new random order each time.

    Column k moves the k-th parameter of that order and those after it, as far as they depend on it. For a normal
    distribution a sweep over all columns is an independent draw. Blocks stay together, so that later columns move few
    bodies and meet few boundaries; this gives good mixing in corners of the cone. With equalities the parameters are
    the y of the plane.
    """

    covariance: Array  #: (d, d) of y
    block: Integers  #: (d,) block of each parameter
    basis: Array  #: (P, d) of the plane

    @classmethod
    def of(cls, region: FeasibleSet, covariance: Array) -> Conditional:
        """Lines in a region, for the covariance (d, d) of its y."""
        return cls(covariance, region.flat.blocks, region.plane.basis)

    def draw(self, random: RandomState) -> Array:
        """(P, d) columns."""
        size = len(self.covariance)
        place = random.random_sample(int(self.block.max()) + 1)[self.block]
        order = np.lexsort((random.random_sample(size), place))
        columns = np.zeros((size, size))
        columns[order] = factor(self.covariance[np.ix_(order, order)])
        return self.basis @ columns


class GibbsMove(ABC):
    """A move that draws from conditional distributions; every walker accepts."""

    @abstractmethod
    def update(self, coordinates: Array, random: RandomState) -> Array:
        """(W, d) new coordinates of the walkers at (W, d); it leaves the target invariant."""

    def propose(self, model: object, state: State) -> tuple[State, Array]:
        """Moves all walkers (the interface of emcee.moves.Move)."""
        from emcee.state import State  # imported on demand, as in `sampler`

        coordinates = self.update(state.coords, model.random)  # type: ignore[attr-defined]
        log_prob, _ = model.compute_log_prob_fn(coordinates)  # type: ignore[attr-defined]
        moved = State(coordinates, log_prob=log_prob, random_state=state.random_state)
        return moved, np.ones(len(coordinates), dtype=bool)


@dataclass(frozen=True)
class MoveSequence(GibbsMove):
    """Several Gibbs moves, one after the other."""

    moves: Sequence[GibbsMove]

    def update(self, coordinates: Array, random: RandomState) -> Array:
        """See GibbsMove."""
        for move in self.moves:
            coordinates = move.update(coordinates, random)
        return coordinates


@dataclass(frozen=True)
class HitAndRun(GibbsMove):
    """Draws theta along many lines, given signs and noise scales (:eq:`chord`)."""

    target: Target
    directions: Conditional  #: the lines
    temperature: float = 1.0  #: draws from the conditional density to the power 1 / temperature

    def update(self, coordinates: Array, random: RandomState) -> Array:
        """See GibbsMove."""
        likelihood, prior, information = self.target.likelihood, self.target.prior, self.target.information
        theta, log_scale = self.target.split(coordinates)
        beta = theta @ likelihood.projection.T
        beta_gradient = likelihood.conditional_gradient(beta, log_scale, likelihood.draw_signs(beta, log_scale, random))
        if information is not None:
            beta_gradient += information.gradient - beta @ information.hessian
        gradient = beta_gradient @ likelihood.projection + prior.precision * (prior.mean - theta)
        lines = self.directions.draw(random)
        in_beta = likelihood.projection @ lines
        unscaled = lines.T @ (prior.precision[:, None] * lines)
        if information is not None:
            unscaled += in_beta.T @ information.hessian @ in_beta
        scaled = in_beta.T @ (likelihood.hessian @ in_beta)
        curvature = np.concatenate([scaled, unscaled[None]])
        weights = np.concatenate([np.exp(-2.0 * log_scale), np.ones((len(theta), 1))], axis=1).T / self.temperature
        slopes = (gradient @ lines).T / self.temperature
        steps = sweep(prior.region, theta.T, lines, slopes, curvature, weights, random)
        return np.concatenate([theta + (lines @ steps).T, log_scale], axis=1)


def sweep(
    region: FeasibleSet,
    theta: Array,
    lines: Array,
    slopes: Array,
    curvature: Array,
    weights: Array,
    random: RandomState,
) -> Array:
    """(K, W) steps along each of K lines in turn, each drawn from a normal distribution inside the region.

    Args:
        region: the region of theta.
        theta: (P, W).
        lines: (P, K).
        slopes: (K, W) of the log density along the lines, at theta.
        curvature: (c, K, K) parts of the negative Hessian of the log density, between the lines.
        weights: (c, W) of these parts.
        random: the random state.
    """
    half_spaces, shape = len(region.rows), (*region.constant.shape, theta.shape[1])
    state = np.concatenate([region.slack(theta), region.matrices(theta).reshape(-1, shape[-1])])
    slack, matrices = state[:half_spaces], state[half_spaces:].reshape(shape)
    change = np.concatenate([region.rows, region.entries.reshape(-1, region.size)]) @ lines
    rows, entries = change[:half_spaces], change[half_spaces:].reshape(*shape[:2], lines.shape[1])
    slopes, steps = slopes.copy(), np.zeros_like(slopes)
    for k in range(lines.shape[1]):
        bend = curvature[:, k, k:].T @ weights  # (K - k, W)
        t = draw_on_line(slack, matrices, rows[:, k], entries[:, :, k], slopes[k], bend[0], random, TUNING.idle)
        slopes[k + 1 :] -= t * bend[1:]
        state += t * change[:, k, None]  # slack and matrices are views of it
        steps[k] = t
    return steps


@dataclass(frozen=True)
class NoiseScales(GibbsMove):
    """Draws every joint's noise scale, given theta and the signs (:eq:`noise-scale`).

    With R_j the joint's sum of squared residuals, w = exp(-2 u) has the density w^(n_j / 2) exp(-R_j w / 2) du times
    the prior's. With the log prior replaced by its tangent at the mode u*, exp(-u u* / sd^2), w has a gamma density.
    That is the proposal of an independent Metropolis step, which the rest of the prior, exp(-(u - u*)^2 / (2 sd^2)),
    accepts or rejects. Acceptance stays high even if u* is far from the prior's mean.
    """

    target: Target

    def update(self, coordinates: Array, random: RandomState) -> Array:
        """See GibbsMove."""
        likelihood, variance = self.target.likelihood, self.target.prior.log_scale_sd**2
        theta, log_scale = self.target.split(coordinates)
        beta = theta @ likelihood.projection.T
        signs = likelihood.draw_signs(beta, log_scale, random)
        residual = np.maximum(likelihood.residual(beta, signs), TINY)  # zero for a joint with only invalid efforts
        # the mode u*: n + u* / sd^2 = R exp(-2 u*)
        tilted = wrightomega(2.0 * variance * likelihood.count + np.log(2.0 * variance * residual)) / (2.0 * variance)
        mode = variance * (tilted - likelihood.count)
        proposed = noise_scales(0.5 * tilted, residual, random)
        log_ratio = 0.5 * ((log_scale - mode) ** 2 - (proposed - mode) ** 2) / variance
        accepted = np.log1p(-random.random_sample(log_ratio.shape)) < log_ratio
        return np.concatenate([theta, np.where(accepted, proposed, log_scale)], axis=1)


def noise_scales(shape: Array, residual: Array, random: RandomState) -> Array:
    """(W, n) draws u with exp(-2 u) of a gamma density of this shape and the rate residual (W, n) / 2."""
    gamma = random.standard_gamma(shape, residual.shape)
    return -0.5 * np.log(np.maximum(gamma, TINY) / (0.5 * residual))


def spread_walkers(target: Target, centre: Centre, directions: Conditional, walkers: int, random: RandomState) -> Array:
    """(W, P + n) starting points, more dispersed than the posterior: a few sweeps at a higher temperature.

    They start inside the ellipsoid of the barrier's Hessian about the centre, which lies in the region (Nesterov and
    Nemirovskii 1994, 2.1.1).
    """
    root = factor(centre.covariance)
    noise = random.standard_normal((walkers, len(root)))
    radius = random.random_sample((walkers, 1)) / np.linalg.norm(noise, axis=1, keepdims=True)
    theta = centre.theta + TUNING.reach * radius * noise @ root.T @ target.prior.region.plane.basis.T
    coordinates = np.concatenate([theta, np.zeros((walkers, target.likelihood.n_joints))], axis=1)
    hot = MoveSequence([HitAndRun(target, directions, TUNING.hot), NoiseScales(target)])
    for _ in range(TUNING.hot_sweeps):
        coordinates = hot.update(coordinates, random)
    return coordinates
