"""Errors on blocks of data that had no say, and the rule by which an effect must lower them, wherever one enters.

Each block of a log is predicted by a fit to the folds that it is not in, or all blocks by a fit to another log.
`confirms` decides for a model that is completed, for a discrepancy, and for a learned function.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from bayesid.arrays import TINY, Array, Mask
from bayesid.regression.tuning import TUNING

SHORTEST_LOG = TUNING.folds * TUNING.shortest_block
"""s: a log that does not fill one block a fold tells nothing surely."""


@dataclass(frozen=True)
class CrossValidation:
    """Sums of squared errors (blocks, n), (N m)^2, on held-back blocks, and their numbers of samples (blocks, n)."""

    squares: Array
    counts: Array

    @property
    def rms(self) -> Array:
        """(n,) N m."""
        return np.sqrt(self.squares.sum(axis=0) / np.maximum(self.counts.sum(axis=0), 1))

    def rise(self, before: CrossValidation) -> tuple[Array, Array]:
        """(n,) rise of the mean squared error over that before, and (n,) its standard error over the blocks."""
        change, count = self.squares - before.squares, np.maximum(self.counts.sum(axis=0), 1)
        return change.sum(axis=0) / count, change.std(axis=0) * np.sqrt(len(change)) / count

    def surely_above(self, level: Array) -> Mask:
        """(n,) whether the RMS error is above a level (n,), N m, by more than its scatter over the blocks explains."""
        rise, error = self.rise(CrossValidation(self.counts * level**2, self.counts))
        above: Mask = rise > TUNING.sure * error
        return above

    def surely_grown(self, before: CrossValidation) -> Mask:
        """(n,) whether the mean squared error has risen: by as much, and as surely, as an effect must lower it."""
        rise, error = self.rise(before)
        grown: Mask = rise > np.maximum(TUNING.help * before.rms**2, TUNING.sure * error)
        return grown


def confirms(
    after: CrossValidation, before: CrossValidation, joints: Collection[int], least: float = TUNING.help
) -> bool:
    """Whether an effect in some (0-based) joints surely helps there, and all joints together do not lose by it.

    It must lower the joints' mean squared errors, as shares of what they were and added up, by `least`. The standard
    error is that of the blocks which it helps less than on average: what helps a lot where it acts, and does nothing
    where it does not, is no luck.
    """
    relative = (after.squares - before.squares) / np.maximum(before.squares.sum(axis=0), TINY)
    of_blocks = relative[:, sorted(joints)].sum(axis=1)
    return bool(_surely_more(-of_blocks, least) and relative.sum() < 0.0)


def harmed(after: CrossValidation, before: CrossValidation) -> Mask:
    """(n,) whether a joint's mean squared error has risen by more than its standard error, and visibly."""
    rise, error = after.rise(before)
    risen: Mask = (rise > error) & (rise > TUNING.harm * before.rms**2)
    return risen


def log_density(residual: Array, used: Mask, sd: Array) -> Array:
    """(N,) log predictive density of residuals (N, n), joints added up, up to a constant that all predictions share.

    Student's t of four degrees about the errors' scale sd (n,), the usual choice where a few errors may be large
    (Lange, Little, Taylor 1989): a few samples where friction turns round decide nothing. Only used samples (N, n)
    count.
    """
    degrees = 4.0
    density = -0.5 * (degrees + 1.0) * np.log1p((residual / sd) ** 2 / degrees)
    of_rows: Array = (density * used).sum(axis=1)
    return of_rows


def surely_better(one: Array, other: Array, least: float) -> bool:
    """Whether log densities (blocks,) of one set of effects are above another's by `least` in sum, and surely."""
    return _surely_more(one - other, least)


def _surely_more(of_blocks: Array, least: float) -> bool:
    """Whether gains of blocks add up to more than `least`, and than their scatter on the side of less explains."""
    less = np.minimum(of_blocks - of_blocks.mean(), 0.0)
    return bool(of_blocks.sum() > max(least, TUNING.sure * float(np.sqrt(2.0 * np.sum(less**2)))))
