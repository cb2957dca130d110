"""What is sampled: prior times likelihood over coordinates (theta, u), times the information of an earlier log.

That information is a normal distribution of the coefficients beta = B theta, exp(-(beta' H beta - 2 g' beta + c) / 2).
Its noise is settled: it does not go with the scales u of the new log's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.parameters import Cone
from bayesid.posterior.likelihood import Likelihood, SegmentBlocks, make_likelihood
from bayesid.posterior.prior import Prior, make_prior
from bayesid.posterior.region import Centre, barrier_minimum
from bayesid.posterior.tuning import TUNING
from bayesid.regression.knowledge import Information, Links, Nominal
from bayesid.regression.moments import Moments
from bayesid.regression.noise import Noise
from bayesid.regression.solver import ConeLeastSquares


@dataclass(frozen=True)
class Target:
    """The posterior of one branch, over P parameters and n logarithms of noise scales."""

    prior: Prior
    likelihood: Likelihood
    information: Information | None = None  #: of the coefficients, from an earlier log; its H is positive semidefinite

    @property
    def n_parameters(self) -> int:
        """P."""
        return len(self.prior.mean)

    @property
    def dimension(self) -> int:
        """P + n."""
        return self.n_parameters + self.likelihood.n_joints

    def split(self, coordinates: Array) -> tuple[Array, Array]:
        """Parameters theta (..., P) and u (..., n) of coordinates (..., P + n)."""
        return coordinates[..., : self.n_parameters], coordinates[..., self.n_parameters :]

    def log_density(self, coordinates: Array) -> Array:
        """(W,) log posterior of (W, P + n), not normalised; -inf outside of the region."""
        theta, log_scale = self.split(np.atleast_2d(coordinates))
        value = self.prior.log_density(theta, log_scale)
        inside = np.isfinite(value)
        value[inside] += self.likelihood.log_likelihood(theta[inside], log_scale[inside])
        if self.information is not None:
            beta = theta[inside] @ self.likelihood.projection.T
            pulled = beta @ self.information.hessian - 2.0 * self.information.gradient
            value[inside] -= 0.5 * (np.sum(pulled * beta, axis=1) + self.information.energy)
        return value

    def quadratic(self, theta: Array, log_scale: Array) -> tuple[Array, Array]:
        """A (P, P) and b (P,) of log p = -theta' A theta / 2 + b' theta + const (:eq:`posterior-precision`).

        Given noise scales u (n,) and the signs that theta (P,) predicts for the unknown segments.
        """
        likelihood, prior = self.likelihood, self.prior
        scale = log_scale[None]
        signs = likelihood.likelier_signs(theta[None], scale)
        data = likelihood.pull(np.zeros((1, likelihood.hessian.shape[1])), scale, signs)[0]
        hessian = np.einsum("j,jrs->rs", np.exp(-2.0 * log_scale), likelihood.hessian)
        if self.information is not None:
            data, hessian = data + self.information.gradient, hessian + self.information.hessian
        precision = likelihood.projection.T @ hessian @ likelihood.projection + np.diag(prior.precision)
        return 0.5 * (precision + precision.T), likelihood.projection.T @ data + prior.precision * prior.mean

    def centre(self, theta: Array, log_scale: Array) -> Centre:
        """The region's centre for the same signs and noise scales; theta need not be feasible.

        Raises:
            LinAlgError: the Hessian is singular but for rounding.
        """
        return barrier_minimum(self.prior.region, *self.quadratic(theta, log_scale), self.prior.inside)


@dataclass(frozen=True)
class PosteriorProblem:
    """All that decides a posterior but the signs."""

    blocks: SegmentBlocks  #: of S segments, efforts in expected signs relative to their segment's
    coefficients: BaseCoefficients  #: the r base coefficients
    cone: Cone  #: of the P parameters
    noise: Noise  #: of the efforts; the reference of the noise scales
    links: Links  #: what is believed of any link
    nominal: Nominal | None = None  #: what is stated of the parameters
    #: of the r coefficients, from an earlier log; its c says what effort it explains: sizes are judged by it
    information: Information | None = None

    def with_least_noise(self) -> PosteriorProblem:
        """The same problem with a thousandth of each effort added to its noise, and to what the residual shows."""
        floor = TUNING.least_noise * self.moments.rms_effort(len(self.noise.sigma))
        noise = self.noise.scaled(np.hypot(self.noise.sigma, floor) / self.noise.sigma)
        energy = (1.0 + TUNING.least_noise**2) * self.blocks.moments.energy
        return replace(
            self, noise=noise, blocks=replace(self.blocks, moments=replace(self.blocks.moments, energy=energy))
        )

    @cached_property
    def moments(self) -> Moments:
        """Of the segments, not scaled."""
        return self.blocks.of_segments

    @cached_property
    def target(self) -> Target:
        """What is sampled: all signs summed out that are not known."""
        unknown = np.zeros(len(self.moments), dtype=np.int64)
        likelihood = make_likelihood(
            self.moments, self.coefficients, self.noise.sigma, self.noise.autocorrelation, unknown
        )
        prior = make_prior(self.cone, likelihood, self.links, self.nominal, information=self.information)
        return Target(prior, likelihood, self.information)

    @cached_property
    def scaled_moments(self) -> Moments:
        """In units of the reference noise."""
        return self.moments.scaled(self.noise.sigma * np.sqrt(self.noise.autocorrelation))

    @cached_property
    def solver(self) -> ConeLeastSquares:
        """For the scaled moments and the information, added."""
        hessian, energy = self.scaled_moments.hessian.total(), float(self.scaled_moments.energy.sum())
        if self.information is not None:
            hessian, energy = hessian + self.information.hessian, energy + self.information.energy
        return ConeLeastSquares(self.cone, self.coefficients, hessian, energy)
