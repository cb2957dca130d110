"""The likelihood of parameters and noise scales with unknown signs summed out, from normal equations.

Row i of joint j is  s_k |tau|_i = y_i' beta + e_i  with s_k the sign of its segment and e_i normal. Let

- u_j be the logarithm of joint j's noise over its reference, and w_j = exp(-2 u_j),
- n_j its effective samples: samples over the integrated autocorrelation time of the residual,
- H_j, g_k, c_j the normal equations in units of the reference noise.

Then, up to a constant, :eq:`marginal-likelihood`::

    log L(beta, u) = sum_j [-n_j u_j - w_j (beta' H_j beta + c_j) / 2] + sum_k log(2 cosh(w_j(k) g_k' beta)).

A segment with a fixed sign (known, or decided by the branch) contributes s_k w_j g_k' beta instead of the log(2 cosh).
H_j are sums over segments, so the computing time does not depend on the log's length.

Models are compared by leave-one-out cross-validation over blocks of the log, from the draws given all data. This fails
if one part has much of the information (Vehtari, Gelman and Gabry 2017: a Pareto k above 0.7), and a segment may have a
tenth of a short log's. So segments are cut into blocks of at least eight autocorrelation times of the residual, which
are nearly independent. The likelihood of a segment is the product of those of its blocks if all draws agree on its
sign. If they do not, the whole segment is one block.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.random import RandomState
from scipy.special import expit

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.log.segments import Segments
from bayesid.posterior.tuning import TUNING
from bayesid.regression.normal_equations import NormalEquations


@dataclass(frozen=True)
class Likelihood:
    """Normal equations of S segments of n joints, in units of the reference noise."""

    projection: Array  #: (r, P) B with beta = B theta
    hessian: Array  #: (n, r, r) H_j
    energy: Array  #: (n,) c_j
    count: Array  #: (n,) effective samples
    gradient: Array  #: (S, r) g_k
    joint: Integers  #: (S,) 0-based joint of each segment
    fixed: Integers  #: (S,) +1 or -1; 0 if the sign is summed out
    sigma: Array  #: (n,) the reference noise, N m

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return len(self.energy)

    @cached_property
    def unknown(self) -> Integers:
        """(w,) segments whose sign is summed out."""
        return np.flatnonzero(self.fixed == 0)

    @cached_property
    def fixed_gradient(self) -> Array:
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
        """(w, n) 1 if the unknown segment belongs to the joint."""
        return (self.joint[self.unknown][:, None] == np.arange(self.n_joints)).astype(float)

    def log_likelihood(self, theta: Array, log_scale: Array) -> Array:
        """(W,) log L (:eq:`marginal-likelihood`) at parameters theta (W, P) and log noise scales (W, n)."""
        beta = theta @ self.projection.T
        weight = np.exp(-2.0 * log_scale)
        push = np.abs(beta @ self.open_gradient.T * weight[:, self.joint[self.unknown]])
        marginal = np.sum(push + np.log1p(np.exp(-2.0 * push)), axis=1)
        quadratic = 0.5 * (self.curvature(beta) + self.energy) - beta @ self.fixed_gradient.T
        return marginal - log_scale @ self.count - np.sum(weight * quadratic, axis=1)

    def pointwise(self, theta: Array, log_scale: Array) -> Array:
        """(W, S) log(2 cosh(w g_k' beta)), or s_k w g_k' beta for a fixed sign: each segment's contribution."""
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
        """(W, n) sum of squared residuals of each joint for coefficients (W, r) and unknown signs (W, w)."""
        agreement = (signs * (beta @ self.open_gradient.T)) @ self.members + beta @ self.fixed_gradient.T
        squares: Array = self.curvature(beta) - 2.0 * agreement + self.energy
        return np.maximum(squares, 1e-12 * self.energy)  # limit for rounding

    def conditional_gradient(self, beta: Array, log_scale: Array, signs: Array) -> Array:
        """(W, r) gradient of log L by beta (W, r) for given unknown signs (W, w)."""
        weight = np.exp(-2.0 * log_scale)
        of_fixed = np.einsum("wj,wjr->wr", weight, self.fixed_gradient - self.apply(beta))
        return of_fixed + (signs * weight[:, self.joint[self.unknown]]) @ self.open_gradient

    def push(self, theta: Array, log_scale: Array) -> Array:
        """(W, S) w g_k' beta, half the log odds of sign +."""
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
        """(W, w) draws of the unknown signs given all else."""
        uniform = random.random_sample((len(beta), len(self.unknown)))
        push = beta @ self.open_gradient.T * np.exp(-2.0 * log_scale)[:, self.joint[self.unknown]]
        return np.where(uniform < expit(2.0 * push), 1.0, -1.0)


def make_likelihood(
    normal_equations: NormalEquations,
    coefficients: BaseCoefficients,
    sigma: Array,
    autocorrelation: Array,
    fixed: Integers,
) -> Likelihood:
    """The likelihood of a log.

    Args:
        normal_equations: of S segments, not scaled.
        coefficients: the r base coefficients.
        sigma: (n,) sd of the residual, N m; the reference of the noise scales.
        autocorrelation: (n,) integrated autocorrelation time of the residual, samples (:eq:`effective-samples`).
        fixed: (S,) +1 or -1 for fixed signs, 0 for those to sum out. Known signs are always fixed.
    """
    n = len(sigma)
    scaled = normal_equations.scaled(sigma * np.sqrt(autocorrelation))
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


@dataclass(frozen=True)
class SegmentBlocks:
    """B stretches of S segments of a log."""

    normal_equations: NormalEquations  #: of the blocks, not scaled, with efforts as in their segments
    segment: Integers  #: (B,) segment of each block
    start: Integers  #: (B,) its first sample
    end: Integers  #: (B,) the sample after its last one

    def __len__(self) -> int:
        return len(self.segment)

    @property
    def of_segments(self) -> NormalEquations:
        """Normal equations of the S segments."""
        return self.whole(np.ones(int(self.segment.max(initial=-1)) + 1, dtype=bool)).normal_equations

    def whole(self, chosen: Mask) -> SegmentBlocks:
        """The same with the blocks of the chosen segments (S,) merged."""
        first = np.unique(self.segment, return_index=True)[1]  # every segment has at least one
        joined = np.where(chosen[self.segment], first[self.segment], np.arange(len(self)))
        kept, into = np.unique(joined, return_inverse=True)
        end = self.end[kept]
        np.maximum.at(end, into, self.end)
        return SegmentBlocks(self.normal_equations.merged(into), self.segment[kept], self.start[kept], end)


def divide(segments: Segments, autocorrelation: Array) -> tuple[Segments, Integers]:
    """Segments cut into blocks of similar length, with unknown signs, and the segment of each block.

    The length is a multiple of the integrated autocorrelation time (n,) of each joint's residual, samples.
    """
    size = np.maximum(segments.end - segments.start, 0)
    least = np.maximum(
        TUNING.block_length * autocorrelation,
        np.bincount(segments.joint, size, len(autocorrelation)) / TUNING.most_blocks,
    )
    number = np.maximum(size // least[segments.joint], 1.0).astype(np.int64)
    segment = np.repeat(np.arange(len(segments)), number)
    place = np.arange(len(segment)) - np.repeat(np.cumsum(number) - number, number)
    start, end = (segments.start[segment] + size[segment] * edge // number[segment] for edge in (place, place + 1))
    signs = np.zeros(len(segment), dtype=np.int64)  # known signs need their own likelihood too
    return replace(segments[segment], start=start, end=end, known=signs), segment


def agreed_signs(likelihood: Likelihood, theta: Array, log_scale: Array) -> Integers:
    """(S,) sign of each segment under all draws theta (W, P), log_scale (W, n); 0 if the draws do not agree."""
    least, most = np.full((2, len(likelihood.joint)), [[np.inf], [-np.inf]])
    for rows in _stretches(len(theta), len(likelihood.joint)):
        push = likelihood.push(theta[rows], log_scale[rows])
        least, most = np.minimum(least, push.min(axis=0)), np.maximum(most, push.max(axis=0))
    needed = -0.5 * np.log(np.expm1(TUNING.agreed))  # log(1 + exp(-2 push)) is the other sign's contribution
    agreed = np.where(least >= needed, 1, np.where(most <= -needed, -1, 0))
    return np.where(likelihood.fixed != 0, likelihood.fixed, agreed)


def by_blocks(
    blocks: SegmentBlocks, likelihood: Likelihood, theta: Array, log_scale: Array
) -> tuple[SegmentBlocks, Likelihood]:
    """Blocks whose likelihoods multiply to that of the log, and the likelihood in terms of these blocks.

    Blocks of a segment are merged if the draws theta (W, P) and log_scale (W, n) do not agree on its sign.
    """
    agreed = agreed_signs(likelihood, theta, log_scale)
    blocks = blocks.whole(agreed == 0)
    alone = np.bincount(blocks.segment) == 1
    fixed = np.where(alone, likelihood.fixed, agreed)[blocks.segment]
    normal_equations = blocks.normal_equations
    scaled = normal_equations.scaled(likelihood.sigma * np.sqrt(autocorrelation_times(likelihood, normal_equations)))
    return blocks, replace(likelihood, gradient=scaled.gradient, joint=normal_equations.joint, fixed=fixed)


def pointwise(likelihood: Likelihood, normal_equations: NormalEquations, theta: Array, log_scale: Array) -> Array:
    """(W, K) log likelihood of each of the K parts of the Hessian, with signs summed out.

    For a block k of joint j, with N_k samples, autocorrelation time tau, w = exp(-2 u), in units of sigma^2 tau:

        -(N_k / tau) (u + log(2 pi sigma^2) / 2) - w (beta' H_k beta + c_k) / 2 + log(cosh(w g_k' beta)).

    This is the log of the mean over both signs of the normal density to the power 1 / tau. With a fixed sign the last
    term is s_k w g_k' beta. Blocks that share a part are added. The sum over all parts is `likelihood.log_likelihood`
    minus log 2 for each unknown sign, minus sum_j (n_j / 2) log(2 pi sigma_j^2). The blocks' normal equations are not
    scaled; parameters are (W, P), log noise scales (W, n).
    """
    autocorrelation = autocorrelation_times(likelihood, normal_equations)
    scaled = normal_equations.scaled(likelihood.sigma * np.sqrt(autocorrelation))
    size, joint = len(scaled.hessian), scaled.hessian.joint
    energy = sums(normal_equations, scaled.energy)
    count = sums(normal_equations, normal_equations.count) / autocorrelation[joint]
    normal = 0.5 * np.log(2.0 * np.pi * likelihood.sigma[joint] ** 2)
    members = scipy.sparse.csr_array(
        (np.ones(len(normal_equations)), (np.arange(len(normal_equations)), normal_equations.part)),
        (len(normal_equations), size),
    )
    terms = np.empty((len(theta), size))
    for rows in _stretches(len(theta), size * scaled.hessian.size + len(normal_equations)):
        beta, scale = theta[rows] @ likelihood.projection.T, log_scale[rows]
        curvature = scaled.hessian.forms(beta)
        signs = likelihood.pointwise(theta[rows], scale) - np.log(2.0) * (likelihood.fixed == 0)
        quadratic = 0.5 * np.exp(-2.0 * scale[:, joint]) * (curvature + energy)
        terms[rows] = signs @ members - quadratic - count * (scale[:, joint] + normal)
    return terms


def _stretches(rows: int, width: int) -> Iterator[slice]:
    """Slices of rows for which an array of this width takes 32 MB."""
    most = max(1, 2**22 // max(1, width))
    for first in range(0, rows, most):
        yield slice(first, first + most)


def autocorrelation_times(likelihood: Likelihood, normal_equations: NormalEquations) -> Array:
    """(n,) integrated autocorrelation time of each joint's residual, samples; NaN for a joint without segments."""
    samples = np.bincount(normal_equations.joint, weights=normal_equations.count, minlength=likelihood.n_joints)
    return samples / np.where(samples > 0, likelihood.count, np.nan)


def sums(normal_equations: NormalEquations, values: Array | Integers) -> Array:
    """(K,) sums of the segments' values (S,) over each part of the Hessian."""
    return np.bincount(normal_equations.part, weights=values, minlength=len(normal_equations.hessian)).astype(
        np.float64
    )
