"""The likelihood of parameters and noise scales, the unknown signs summed out, from moments alone.

Row i of joint j says  s_k |tau|_i = y_i' beta + e_i  with s_k the sign of its segment and e_i normal. With u_j the
logarithm of joint j's noise over the reference one, w_j = exp(-2 u_j), n_j its effective samples (samples over the
integrated autocorrelation time of the residual), and H_j, g_k, c_j moments in units of the reference noise,
:eq:`marginal-likelihood`::

    log L(beta, u) = sum_j [-n_j u_j - w_j (beta' H_j beta + c_j) / 2] + sum_k log(2 cosh(w_j(k) g_k' beta)),

up to a constant that no sign and no parameter changes. A segment whose sign is fixed (known, or decided by the branch)
has s_k w_j g_k' beta in place of its log(2 cosh). H_j are sums over segments, so the price does not depend on the
log's length.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import RandomState
from scipy.special import expit

from bayesid.arrays import Array, Integers
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.regression.moments import Moments


@dataclass(frozen=True)
class Likelihood:
    """Moments of S segments of n joints, in units of the reference noise."""

    projection: Array  #: (r, P) B with beta = B theta
    hessian: Array  #: (n, r, r) H_j
    energy: Array  #: (n,) c_j
    count: Array  #: (n,) effective samples
    gradient: Array  #: (S, r) g_k
    joint: Integers  #: (S,) 0-based joint of each segment
    fixed: Integers  #: (S,) +1 or -1; 0 where the sign is summed out
    sigma: Array  #: (n,) the reference noise, N m

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return len(self.energy)

    @cached_property
    def unknown(self) -> Integers:
        """(w,) the segments whose sign is summed out."""
        return np.flatnonzero(self.fixed == 0)

    @cached_property
    def settled(self) -> Array:
        """(n, r) sum of s_k g_k over each joint's segments of fixed sign."""
        total = np.zeros((self.n_joints, self.gradient.shape[1]))
        np.add.at(total, self.joint, self.fixed[:, None] * self.gradient)
        return total

    @cached_property
    def open_gradient(self) -> Array:
        """(w, r) g_k of the segments whose sign is summed out."""
        return self.gradient[self.unknown]

    @cached_property
    def members(self) -> Array:
        """(w, n) 1 where the unknown segment belongs to the joint."""
        return (self.joint[self.unknown][:, None] == np.arange(self.n_joints)).astype(float)

    def log_likelihood(self, theta: Array, log_scale: Array) -> Array:
        """(W,) log L (:eq:`marginal-likelihood`) of parameters theta (W, P) and logarithms of noise scales (W, n)."""
        beta = theta @ self.projection.T
        weight = np.exp(-2.0 * log_scale)
        push = np.abs(beta @ self.open_gradient.T * weight[:, self.joint[self.unknown]])
        marginal = np.sum(push + np.log1p(np.exp(-2.0 * push)), axis=1)
        quadratic = 0.5 * (self.curvature(beta) + self.energy) - beta @ self.settled.T
        return marginal - log_scale @ self.count - np.sum(weight * quadratic, axis=1)

    def pointwise(self, theta: Array, log_scale: Array) -> Array:
        """(W, S) log(2 cosh(w g_k' beta)), or s_k w g_k' beta where the sign is fixed: what each sign contributes."""
        push = self.push(theta, log_scale)
        size = np.abs(push)
        return np.where(self.fixed == 0, size + np.log1p(np.exp(-2.0 * size)), self.fixed * push)

    def curvature(self, beta: Array) -> Array:
        """(W, n) beta' H_j beta of coefficients (W, r)."""
        return np.einsum("wjr,wr->wj", self.apply(beta), beta)

    def apply(self, beta: Array) -> Array:
        """(W, n, r) H_j beta of coefficients (W, r)."""
        n, r, _ = self.hessian.shape
        return (beta @ self.hessian.reshape(n * r, r).T).reshape(-1, n, r)

    def residual(self, beta: Array, signs: Array) -> Array:
        """(W, n) sum of squared residuals of each joint for coefficients (W, r) and the unknown signs (W, w)."""
        agreement = (signs * (beta @ self.open_gradient.T)) @ self.members + beta @ self.settled.T
        squares: Array = self.curvature(beta) - 2.0 * agreement + self.energy
        return np.maximum(squares, 1e-12 * self.energy)  # less is rounding

    def pull(self, beta: Array, log_scale: Array, signs: Array) -> Array:
        """(W, r) gradient of log L in beta (W, r) for given unknown signs (W, w)."""
        weight = np.exp(-2.0 * log_scale)
        of_fixed = np.einsum("wj,wjr->wr", weight, self.settled - self.apply(beta))
        return of_fixed + (signs * weight[:, self.joint[self.unknown]]) @ self.open_gradient

    def push(self, theta: Array, log_scale: Array) -> Array:
        """(W, S) w g_k' beta: half the log odds of a plus."""
        return theta @ self.projection.T @ self.gradient.T * np.exp(-2.0 * log_scale)[:, self.joint]

    def plus_probability(self, theta: Array, log_scale: Array) -> Array:
        """(W, S) P(s_k = + | theta, u) = 1 / (1 + exp(-2 w g_k' beta)), for fixed segments too.

        :eq:`sign-probability`.
        """
        return expit(2.0 * self.push(theta, log_scale))

    def likelier_signs(self, theta: Array, log_scale: Array) -> Array:
        """(W, w) the likelier signs of the unknown segments."""
        return np.where(self.push(theta, log_scale)[:, self.unknown] >= 0.0, 1.0, -1.0)

    def draw_signs(self, beta: Array, log_scale: Array, random: RandomState) -> Array:
        """(W, w) signs of the unknown segments given all else."""
        uniform = random.random_sample((len(beta), len(self.unknown)))
        push = beta @ self.open_gradient.T * np.exp(-2.0 * log_scale)[:, self.joint[self.unknown]]
        return np.where(uniform < expit(2.0 * push), 1.0, -1.0)


def make_likelihood(
    moments: Moments, coefficients: BaseCoefficients, sigma: Array, autocorrelation: Array, fixed: Integers
) -> Likelihood:
    """The likelihood of a log.

    Args:
        moments: of S segments, not scaled.
        coefficients: the r base coefficients.
        sigma: (n,) sd of the residual, N m; the reference of the noise scales.
        autocorrelation: (n,) integrated autocorrelation time of the residual, samples: so many count as one
            (:eq:`effective-samples`).
        fixed: (S,) +1 or -1 for the signs that are given, 0 for those to sum out. Known signs are given anyway.
    """
    n = len(sigma)
    scaled = moments.scaled(sigma * np.sqrt(autocorrelation))
    return Likelihood(
        projection=coefficients.projection,
        hessian=scaled.hessian.by_joint(n),
        energy=np.bincount(scaled.joint, weights=scaled.energy, minlength=n).astype(float),
        count=np.bincount(scaled.joint, weights=scaled.count, minlength=n) / autocorrelation,
        gradient=scaled.gradient,
        joint=scaled.joint,
        fixed=np.where(scaled.known != 0, scaled.known, fixed),
        sigma=sigma,
    )
