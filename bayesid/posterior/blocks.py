"""Blocks: the stretches of a log that are left out one at a time where models are compared by their draws.

A segment may hold a tenth of what a short log says: without it the posterior is another one, and draws given all the
data cannot stand for it (Vehtari, Gelman and Gabry 2017: a Pareto k above 0.7). So segments are cut into blocks, of at
least eight autocorrelation times of the residual, that neighbours say little of each other. Under a sign s_k on which
all draws agree, the likelihoods of a segment's blocks multiply to that of the segment; where draws disagree, the blocks
of a segment have only one likelihood together, and it is left out as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array, Integers, Mask
from bayesid.log.segments import Segments
from bayesid.posterior.likelihood import Likelihood
from bayesid.regression.moments import Moments

_SHORTEST = 8.0
"""Autocorrelation times that a block lasts at least, so that neighbours say little of each other. On six real logs 1 to
7 % of the blocks then have a Pareto k above 0.7, of whole segments 5 to 30 % (docs/posterior.md, section 7)."""
_MOST = 64
"""Blocks of a joint, but for those that are shorter because their segment is: each then holds a few hundredths of what
a log says, whatever its length, and posterior.nc stays small. A round number; not studied."""
_AGREED = 1e-3
"""Nats that a draw may leave to the other sign of a segment on which draws agree: what summing it out would add to the
segment's likelihood, and ArviZ's summaries have two digits."""
_ROWS = 256
"""Draws whose signs are looked at together: a thousand segments take 2 MB. A round number."""


@dataclass(frozen=True)
class SegmentBlocks:
    """B stretches of S segments of a log.

    Attributes:
        moments: of the blocks, not scaled, efforts as those of their segments.
        segment: (B,) the segment that each is a part of.
        start: (B,) its first sample.
        end: (B,) the sample after its last one.
    """

    moments: Moments
    segment: Integers
    start: Integers
    end: Integers

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

    def apart(self, likelihood: Likelihood, theta: Array, log_scale: Array) -> tuple[SegmentBlocks, Integers]:
        """Blocks whose likelihoods multiply to that of the log, and their signs (B,): 0 where it is summed out.

        Args:
            likelihood: of the S segments.
            theta: (W, P) draws of the parameters.
            log_scale: (W, n) of the logarithms of the noise scales.
        """
        agreed = agreed_signs(likelihood, theta, log_scale)
        blocks = self.whole(agreed == 0)
        alone = np.bincount(blocks.segment) == 1
        return blocks, np.where(alone, likelihood.fixed, agreed)[blocks.segment]


def divide(segments: Segments, autocorrelation: Array) -> tuple[Segments, Integers]:
    """Segments cut into blocks of about the same length, as if of unknown sign, and the segment that each is a part of.

    Args:
        segments: S of them.
        autocorrelation: (n,) integrated autocorrelation time of each joint's residual, samples.
    """
    size = np.maximum(segments.end - segments.start, 0)
    least = np.maximum(_SHORTEST * autocorrelation, np.bincount(segments.joint, size, len(autocorrelation)) / _MOST)
    number = np.maximum(size // least[segments.joint], 1.0).astype(np.int64)
    segment = np.repeat(np.arange(len(segments)), number)
    place = np.arange(len(segment)) - np.repeat(np.cumsum(number) - number, number)
    start, end = (segments.start[segment] + size[segment] * edge // number[segment] for edge in (place, place + 1))
    signs = np.zeros(len(segment), dtype=np.int64)  # known ones too want a likelihood of their own
    return replace(segments[segment], start=start, end=end, known=signs), segment


def agreed_signs(likelihood: Likelihood, theta: Array, log_scale: Array) -> Integers:
    """(S,) the sign of each segment that all draws (W, P) and (W, n) are sure of; 0 where there is none."""
    least, most = np.full((2, len(likelihood.joint)), [[np.inf], [-np.inf]])
    for first in range(0, len(theta), _ROWS):
        push = likelihood.push(theta[first : first + _ROWS], log_scale[first : first + _ROWS])
        least, most = np.minimum(least, push.min(axis=0)), np.maximum(most, push.max(axis=0))
    needed = -0.5 * np.log(np.expm1(_AGREED))  # log(1 + exp(-2 push)) is what the other sign adds
    agreed = np.where(least >= needed, 1, np.where(most <= -needed, -1, 0))
    return np.where(likelihood.fixed != 0, likelihood.fixed, agreed)
