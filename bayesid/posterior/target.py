"""What is sampled: prior times likelihood over coordinates (theta, u), times the information of an earlier log.

That information is a normal distribution of the coefficients beta = B theta, exp(-(beta' H beta - 2 g' beta + c) / 2).
Its noise is settled: it does not go with the scales u of the new log's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array
from bayesid.posterior.likelihood import Likelihood
from bayesid.posterior.prior import Prior
from bayesid.regression.knowledge import Information


@dataclass(frozen=True)
class Target:
    """The posterior of one branch, over P parameters and n logarithms of noise scales.

    Attributes:
        prior: of both.
        likelihood: of both.
        information: of the coefficients, from an earlier log; its H is positive semidefinite.
    """

    prior: Prior
    likelihood: Likelihood
    information: Information | None = None

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
        """A (P, P) and b (P,) of log p = -theta' A theta / 2 + b' theta + const, given noise scales and all signs.

        A is that of :eq:`posterior-precision`.

        Args:
            theta: (P,) whose predictions decide the unknown signs.
            log_scale: (n,) the noise scales u.
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
