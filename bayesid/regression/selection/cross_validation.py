"""Errors on held-back blocks, and the rule by which an effect must lower them.

Each block of a log is predicted by a fit to the other folds, or all blocks by a fit to another log. `confirms` decides
for model selection, for a discrepancy, and for a learned function.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from bayesid.arrays import TINY, Array, Mask
from bayesid.regression.tuning import TUNING

SHORTEST_LOG = TUNING.folds * TUNING.shortest_block
"""Shortest log, s, for cross-validation: one block a fold."""


@dataclass(frozen=True)
class CrossValidation:
    """Sums of squared errors (blocks, n), (N m)^2, on held-back blocks, and their numbers of samples (blocks, n)."""

    squares: Array
    counts: Array

    @property
    def rms(self) -> Array:
        """(n,) RMS error, N m."""
        return np.sqrt(self.squares.sum(axis=0) / np.maximum(self.counts.sum(axis=0), 1))

    def rise(self, before: CrossValidation) -> tuple[Array, Array]:
        """(n,) rise of the mean squared error over `before`, and (n,) its standard error over the blocks."""
        change, count = self.squares - before.squares, np.maximum(self.counts.sum(axis=0), 1)
        return change.sum(axis=0) / count, change.std(axis=0) * np.sqrt(len(change)) / count

    def surely_above(self, level: Array) -> Mask:
        """(n,) whether the RMS error exceeds a level (n,), N m, by more than its scatter over the blocks."""
        rise, error = self.rise(CrossValidation(self.counts * level**2, self.counts))
        above: Mask = rise > TUNING.sure * error
        return above

    def surely_grown(self, before: CrossValidation) -> Mask:
        """(n,) whether the mean squared error rose by as much, and as significantly, as an effect must lower it."""
        rise, error = self.rise(before)
        grown: Mask = rise > np.maximum(TUNING.help * before.rms**2, TUNING.sure * error)
        return grown


def confirms(
    after: CrossValidation, before: CrossValidation, joints: Collection[int], least: float = TUNING.help
) -> bool:
    """Whether an effect in some (0-based) joints lowers the error there, without raising that of all joints together.

    The joints' mean squared errors, relative to those before and added up, must fall by `least`. The standard error
    uses only blocks that gain less than the mean, as a large gain in few blocks is not noise.
    """
    relative = (after.squares - before.squares) / np.maximum(before.squares.sum(axis=0), TINY)
    of_blocks = relative[:, sorted(joints)].sum(axis=1)
    return bool(_surely_more(-of_blocks, least) and relative.sum() < 0.0)


def harmed(after: CrossValidation, before: CrossValidation) -> Mask:
    """(n,) whether a joint's mean squared error rose by more than its standard error and `Tuning.harm`."""
    rise, error = after.rise(before)
    risen: Mask = (rise > error) & (rise > TUNING.harm * before.rms**2)
    return risen


def log_density(residual: Array, used: Mask, sd: Array) -> Array:
    """(N,) log predictive density of residuals (N, n), summed over joints, up to a common constant.

    Student's t with four degrees of freedom about the errors' scale sd (n,), as usual with outliers (Lange, Little,
    Taylor 1989): samples at friction reversals do not dominate. Only used samples (N, n) count.
    """
    degrees = 4.0
    density = -0.5 * (degrees + 1.0) * np.log1p((residual / sd) ** 2 / degrees)
    of_rows: Array = (density * used).sum(axis=1)
    return of_rows


def surely_better(candidate: Array, other: Array, least: float) -> bool:
    """Whether the sum of log densities (blocks,) exceeds another one by `least`, significantly."""
    return _surely_more(candidate - other, least)


def _surely_more(of_blocks: Array, least: float) -> bool:
    """Whether the sum of gains (blocks,) exceeds `least` and its scatter, which uses the smaller gains."""
    less = np.minimum(of_blocks - of_blocks.mean(), 0.0)
    return bool(of_blocks.sum() > max(least, TUNING.sure * float(np.sqrt(2.0 * np.sum(less**2)))))
