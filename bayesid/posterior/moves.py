"""Moves of an emcee ensemble for a normal distribution cut off by a cone, with unknown signs and noise scales.

Each move leaves the posterior of every walker invariant by itself; walkers of all ensembles move together, so that
numpy works on long arrays. The unknown signs are drawn given all else at the start of a move and forgotten at its end
(data augmentation: Tanner and Wong 1987). Given them, theta is normal inside the region and hit-and-run draws exactly
along each line (Smith 1984; Chen and Schmeiser 1993): nothing is ever rejected.
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
from bayesid.posterior.region import Region, draw_on_line
from bayesid.posterior.target import Target
from bayesid.posterior.tuning import TUNING

if TYPE_CHECKING:
    from emcee.state import State


# ---------------------------------------------------------------------------------------------------------------
# Directions
# ---------------------------------------------------------------------------------------------------------------
def factor(matrix: Array) -> Array:
    """(P, P) lower triangular L with L L' = matrix but for rounding.

    Args:
        matrix: (P, P) positive definite, in mixed units: its rows may differ by many orders of magnitude.

    Raises:
        LinAlgError: it is singular by more than rounding.
    """
    scale = np.sqrt(np.diag(matrix))
    scaled, ridge = matrix / np.outer(scale, scale), 0.0
    while True:
        try:
            lower: Array = scale[:, None] * np.linalg.cholesky(scaled + ridge * np.eye(len(matrix)))
            return lower
        except np.linalg.LinAlgError:
            if ridge >= 1e-9:
                raise
        ridge = max(1e-15, 10.0 * ridge)  # from four roundings on


@dataclass(frozen=True)
class Conditional:
    """Columns of a Cholesky factor of the covariance, its parameters in a new random order every time.

    Column k moves the k-th parameter of that order and, as far as they depend on it, those after it; in a normal
    distribution a sweep over all columns draws afresh. Blocks keep together, so that later columns move few bodies:
    the others do not cut such a line short. This is what mixes in the corner of the cone.

    Attributes:
        covariance: (P, P).
        block: (P,) label of each parameter's block.
    """

    covariance: Array
    block: Integers

    def draw(self, random: RandomState) -> Array:
        """(P, P)."""
        size = len(self.covariance)
        place = random.random_sample(int(self.block.max()) + 1)[self.block]
        order = np.lexsort((random.random_sample(size), place))
        columns = np.zeros((size, size))
        columns[order] = factor(self.covariance[np.ix_(order, order)])
        return columns


# ---------------------------------------------------------------------------------------------------------------
# Moves
# ---------------------------------------------------------------------------------------------------------------
class GibbsMove(ABC):
    """A move that draws from conditional distributions: every walker accepts."""

    @abstractmethod
    def update(self, coordinates: Array, random: RandomState) -> Array:
        """(W, d) new coordinates of the walkers at (W, d), distributed as the target if those are."""

    def propose(self, model: object, state: State) -> tuple[State, Array]:
        """Moves all walkers (the interface of emcee.moves.Move)."""
        from emcee.state import State  # here, as in `sampler`

        coordinates = self.update(state.coords, model.random)  # type: ignore[attr-defined]
        log_prob, _ = model.compute_log_prob_fn(coordinates)  # type: ignore[attr-defined]
        moved = State(coordinates, log_prob=log_prob, random_state=state.random_state)
        return moved, np.ones(len(coordinates), dtype=bool)


class InTurn(GibbsMove):
    """Several such moves, one after the other.

    Args:
        moves: the moves.
    """

    def __init__(self, moves: Sequence[GibbsMove]) -> None:
        self.moves = tuple(moves)

    def update(self, coordinates: Array, random: RandomState) -> Array:
        """See GibbsMove."""
        for move in self.moves:
            coordinates = move.update(coordinates, random)
        return coordinates


class HitAndRun(GibbsMove):
    """Draws theta along many lines in turn, given signs and noise scales (:eq:`chord`).

    Args:
        target: the posterior.
        directions: the lines.
        temperature: draws from the conditional density to the power of one over this.
    """

    def __init__(self, target: Target, directions: Conditional, temperature: float = 1.0) -> None:
        self.target = target
        self.directions = directions
        self.temperature = temperature

    def update(self, coordinates: Array, random: RandomState) -> Array:
        """See GibbsMove."""
        likelihood, prior, information = self.target.likelihood, self.target.prior, self.target.information
        theta, log_scale = self.target.split(coordinates)
        beta = theta @ likelihood.projection.T
        signs = likelihood.draw_signs(beta, log_scale, random.random_sample((len(theta), len(likelihood.unknown))))
        pull = likelihood.pull(beta, log_scale, signs)
        if information is not None:
            pull += information.gradient - beta @ information.hessian
        gradient = pull @ likelihood.projection + prior.precision * (prior.mean - theta)
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
    region: Region, theta: Array, lines: Array, slopes: Array, curvature: Array, weights: Array, random: RandomState
) -> Array:
    """(K, W) steps along each of K lines in turn, each drawn from a normal distribution inside the region.

    Args:
        region: where theta stays.
        theta: (P, W).
        lines: (P, K).
        slopes: (K, W) of the log density along the lines, at theta.
        curvature: (c, K, K) parts of minus the log density's Hessian between the lines.
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
        state += t * change[:, k, None]  # slack and matrices are parts of it
        steps[k] = t
    return steps


class NoiseScales(GibbsMove):
    """Draws every joint's noise scale, given theta and the signs (:eq:`noise-scale`).

    With R_j the joint's sum of squared residuals, w = exp(-2 u) has the density w^(n_j / 2) exp(-R_j w / 2) du times
    the prior's. With the tangent of the log prior at the mode u* in its place, exp(-u u* / sd^2), it is a gamma density
    of w. That is proposed, and corrected by what is left of the prior, exp(-(u - u*)^2 / (2 sd^2)) (Metropolis,
    independent proposals): no walker sticks, however far u* lies from the prior's mean.

    Args:
        target: the posterior.
    """

    def __init__(self, target: Target) -> None:
        self.target = target

    def update(self, coordinates: Array, random: RandomState) -> Array:
        """See GibbsMove."""
        likelihood, variance = self.target.likelihood, self.target.prior.log_scale_sd**2
        theta, log_scale = self.target.split(coordinates)
        beta = theta @ likelihood.projection.T
        signs = likelihood.draw_signs(beta, log_scale, random.random_sample((len(theta), len(likelihood.unknown))))
        residual = np.maximum(likelihood.residual(beta, signs), TINY)  # none of a joint whose efforts are all in fault
        # the mode u*: n + u* / sd^2 = R exp(-2 u*)
        tilted = wrightomega(2.0 * variance * likelihood.count + np.log(2.0 * variance * residual)) / (2.0 * variance)
        mode = variance * (tilted - likelihood.count)
        gamma = random.standard_gamma(0.5 * tilted, residual.shape)
        proposed = -0.5 * np.log(np.maximum(gamma, TINY) / (0.5 * residual))
        log_ratio = 0.5 * ((log_scale - mode) ** 2 - (proposed - mode) ** 2) / variance
        accepted = np.log1p(-random.random_sample(log_ratio.shape)) < log_ratio
        return np.concatenate([theta, np.where(accepted, proposed, log_scale)], axis=1)
