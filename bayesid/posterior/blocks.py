"""Blocks: the stretches of a log that are left out one at a time where models are compared by their draws.

A segment may hold a tenth of what a short log says: without it the posterior is another one, and draws given all the
data cannot stand for it (Vehtari, Gelman and Gabry 2017: a Pareto k above 0.7). So segments are cut into blocks, of at
least eight autocorrelation times of the residual, that neighbours say little of each other. Under a sign s_k on which
all draws agree, the likelihoods of a segment's blocks multiply to that of the segment; where draws disagree, the blocks
of a segment have only one likelihood together, and it is left out as a whole.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy

from bayesid.arrays import Array, Integers, Mask
from bayesid.log.segments import Segments
from bayesid.posterior.likelihood import Likelihood
from bayesid.posterior.tuning import TUNING
from bayesid.regression.moments import Moments


@dataclass(frozen=True)
class SegmentBlocks:
    """B stretches of S segments of a log."""

    moments: Moments  #: of the blocks, not scaled, efforts as those of their segments
    segment: Integers  #: (B,) the segment that each is a part of
    start: Integers  #: (B,) its first sample
    end: Integers  #: (B,) the sample after its last one

    def __len__(self) -> int:
        return len(self.segment)

    @property
    def of_segments(self) -> Moments:
        """Moments of the segments."""
        return self.whole(np.ones(int(self.segment.max(initial=-1)) + 1, dtype=bool)).moments

    def whole(self, chosen: Mask) -> SegmentBlocks:
        """The blocks of the chosen segments (S,) joined to one each."""
        first = np.unique(self.segment, return_index=True)[1]  # every segment has one
        joined = np.where(chosen[self.segment], first[self.segment], np.arange(len(self)))
        kept, into = np.unique(joined, return_inverse=True)
        end = self.end[kept]
        np.maximum.at(end, into, self.end)
        return SegmentBlocks(self.moments.merged(into), self.segment[kept], self.start[kept], end)


def divide(segments: Segments, autocorrelation: Array) -> tuple[Segments, Integers]:
    """Segments cut into blocks of about the same length, as if of unknown sign, and the segment that each is a part of.

    By the integrated autocorrelation time (n,) of each joint's residual, samples.
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
    signs = np.zeros(len(segment), dtype=np.int64)  # known ones too want a likelihood of their own
    return replace(segments[segment], start=start, end=end, known=signs), segment


def agreed_signs(likelihood: Likelihood, theta: Array, log_scale: Array) -> Integers:
    """(S,) the sign of each segment that all draws (W, P) and (W, n) are sure of; 0 where there is none."""
    least, most = np.full((2, len(likelihood.joint)), [[np.inf], [-np.inf]])
    for some in _stretches(len(theta), len(likelihood.joint)):
        push = likelihood.push(theta[some], log_scale[some])
        least, most = np.minimum(least, push.min(axis=0)), np.maximum(most, push.max(axis=0))
    needed = -0.5 * np.log(np.expm1(TUNING.agreed))  # log(1 + exp(-2 push)) is what the other sign adds
    agreed = np.where(least >= needed, 1, np.where(most <= -needed, -1, 0))
    return np.where(likelihood.fixed != 0, likelihood.fixed, agreed)


def by_blocks(
    blocks: SegmentBlocks, likelihood: Likelihood, theta: Array, log_scale: Array
) -> tuple[SegmentBlocks, Likelihood]:
    """Blocks whose likelihoods multiply to that of the log, and it in terms of them instead of S segments.

    Which those are is decided by draws (W, P) of the parameters and (W, n) of the logarithms of the noise scales.
    """
    agreed = agreed_signs(likelihood, theta, log_scale)
    blocks = blocks.whole(agreed == 0)
    alone = np.bincount(blocks.segment) == 1
    fixed = np.where(alone, likelihood.fixed, agreed)[blocks.segment]
    moments = blocks.moments
    scaled = moments.scaled(likelihood.sigma * np.sqrt(autocorrelation_times(likelihood, moments)))
    return blocks, replace(likelihood, gradient=scaled.gradient, joint=moments.joint, fixed=fixed)


def pointwise(likelihood: Likelihood, moments: Moments, theta: Array, log_scale: Array) -> Array:
    """(W, K) log likelihood of each of the K parts of the moments' Hessian, signs summed out.

    Of a block k of joint j, with N_k samples, autocorrelation time tau, w = exp(-2 u) and moments over sigma^2 tau:

        -(N_k / tau) (u + log(2 pi sigma^2) / 2) - w (beta' H_k beta + c_k) / 2 + log(cosh(w g_k' beta)),

    the mean over both signs of the normal density to the power 1 / tau, or s_k w g_k' beta for the last term where the
    sign is fixed. A part that several blocks share has the sum of theirs. The sum over all parts is
    `likelihood.log_likelihood` less log 2 for each unknown sign and sum_j (n_j / 2) log(2 pi sigma_j^2). The moments of
    the blocks are not scaled; parameters are (W, P), logarithms of noise scales (W, n).
    """
    autocorrelation = autocorrelation_times(likelihood, moments)
    scaled = moments.scaled(likelihood.sigma * np.sqrt(autocorrelation))
    size, joint = len(scaled.hessian), scaled.hessian.joint
    energy = sums(moments, scaled.energy)
    count = sums(moments, moments.count) / autocorrelation[joint]
    normal = 0.5 * np.log(2.0 * np.pi * likelihood.sigma[joint] ** 2)
    members = scipy.sparse.csr_array(
        (np.ones(len(moments)), (np.arange(len(moments)), moments.part)), (len(moments), size)
    )
    terms = np.empty((len(theta), size))
    for some in _stretches(len(theta), size * scaled.hessian.size + len(moments)):
        beta, scale = theta[some] @ likelihood.projection.T, log_scale[some]
        curvature = scaled.hessian.forms(beta)
        signs = likelihood.pointwise(theta[some], scale) - np.log(2.0) * (likelihood.fixed == 0)
        quadratic = 0.5 * np.exp(-2.0 * scale[:, joint]) * (curvature + energy)
        terms[some] = signs @ members - quadratic - count * (scale[:, joint] + normal)
    return terms


def _stretches(rows: int, width: int) -> Iterator[slice]:
    """Rows so many at once that an array of this width holds 32 MB."""
    most = max(1, 2**22 // max(1, width))
    for first in range(0, rows, most):
        yield slice(first, first + most)


def autocorrelation_times(likelihood: Likelihood, moments: Moments) -> Array:
    """(n,) integrated autocorrelation time of each joint's residual, samples; NaN for a joint without segments."""
    samples = np.bincount(moments.joint, weights=moments.count, minlength=likelihood.n_joints)
    return samples / np.where(samples > 0, likelihood.count, np.nan)


def sums(moments: Moments, values: Array | Integers) -> Array:
    """(K,) sums of the segments' values (S,) over each part of the Hessian."""
    return np.bincount(moments.part, weights=values, minlength=len(moments.hessian)).astype(np.float64)
