"""Cross-validation over blocks of the log itself: what effects do to the error on data that had no say."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array, Mask

BLOCKS, FOLDS = 16, 4
"""Equal stretches of a log, every fourth of which is held back at a time: each fold then has data from all of the log,
and 16 blocks give a standard error to 18 %. Round numbers; not studied."""

_SHORTEST = 1.0
"""s, that a block lasts at least: the motion around a shorter one tells what happens in it. A round number; the halves
of 10 s of Panda's log are what it was found on (study `complete`)."""
SHORTEST_LOG = FOLDS * _SHORTEST
"""s: a log that does not fill one such block a fold tells nothing surely."""
_HARM = 0.04
"""Share of a joint's mean squared error by which it may rise in any case, a fiftieth of the error: nobody would see it.
A round number."""
HELP = 0.1
"""Share of the joints' mean squared errors, added up, by which an effect lowers them at least to be worth a term: five
per cent of the error. A round number."""
_SURE = 1.5
"""Standard errors over the blocks by which it does: seven chances in a hundred, beside the evidence. A round number:
two keep effects out of a half of TX40's log that hold in the other half, one lets effects enter that do not."""
_DEGREES = 4.0
"""Of Student's t: the usual choice where a few errors may be large (Lange, Little, Taylor 1989)."""
_TINY = 1e-300
"""Guard of a division."""


@dataclass(frozen=True)
class HeldBackErrors:
    """Sums of squared errors on held-back blocks.

    Attributes:
        squares: (blocks, n) (N m)^2.
        counts: (blocks, n) samples.
    """

    squares: Array
    counts: Array

    @property
    def rms(self) -> Array:
        """(n,) N m."""
        return np.sqrt(self.squares.sum(axis=0) / np.maximum(self.counts.sum(axis=0), 1))

    def rise(self, before: HeldBackErrors) -> tuple[Array, Array]:
        """(n,) rise of the mean squared error over that before, and (n,) its standard error over the blocks."""
        change, count = self.squares - before.squares, np.maximum(self.counts.sum(axis=0), 1)
        return change.sum(axis=0) / count, change.std(axis=0) * np.sqrt(len(change)) / count

    def surely_above(self, level: Array) -> Mask:
        """(n,) whether the RMS error is above a level (n,), N m, by more than its scatter over the blocks explains."""
        rise, error = self.rise(HeldBackErrors(self.counts * level**2, self.counts))
        above: Mask = rise > _SURE * error
        return above

    def surely_grown(self, before: HeldBackErrors) -> Mask:
        """(n,) whether the mean squared error has risen: by as much, and as surely, as an effect must lower it."""
        rise, error = self.rise(before)
        grown: Mask = rise > np.maximum(HELP * before.rms**2, _SURE * error)
        return grown


def blocks_of(duration: float) -> int:
    """How many blocks a log of some seconds is cut into: fewer where they would be too short, but one a fold."""
    return int(np.clip(duration / _SHORTEST, FOLDS, BLOCKS))


def bears_out(after: HeldBackErrors, before: HeldBackErrors, joints: Collection[int], least: float = HELP) -> bool:
    """Whether an effect in some (0-based) joints surely helps there, and all joints together do not lose by it.

    It must lower the joints' mean squared errors, as shares of what they were and added up, by `least`. The standard
    error is that of the blocks which it helps less than on average: what helps a lot where it acts, and does nothing
    where it does not, is no luck.
    """
    relative = (after.squares - before.squares) / np.maximum(before.squares.sum(axis=0), _TINY)
    of_blocks = relative[:, sorted(joints)].sum(axis=1)
    return bool(_surely_more(-of_blocks, least) and relative.sum() < 0.0)


def harmed(after: HeldBackErrors, before: HeldBackErrors) -> Mask:
    """(n,) whether a joint's mean squared error has risen by more than its standard error, and visibly."""
    rise, error = after.rise(before)
    risen: Mask = (rise > error) & (rise > _HARM * before.rms**2)
    return risen


def log_density(residual: Array, used: Mask, sd: Array) -> Array:
    """(N,) log predictive density of residuals (N, n), joints added up, up to a constant that all predictions share.

    Student's t of four degrees: a few samples where friction turns round, which no term claims to know, decide nothing.

    Args:
        residual: N m.
        used: (N, n) samples that count.
        sd: (n,) scale of the errors, N m.
    """
    density = -0.5 * (_DEGREES + 1.0) * np.log1p((residual / sd) ** 2 / _DEGREES)
    of_rows: Array = (density * used).sum(axis=1)
    return of_rows


def surely_better(one: Array, other: Array, least: float) -> bool:
    """Whether log densities (blocks,) of one set of effects are above those of another, as surely as `bears_out`.

    Args:
        one: of the one.
        other: of the other.
        least: by which they are at least, in sum.
    """
    return _surely_more(one - other, least)


def _surely_more(of_blocks: Array, least: float) -> bool:
    """Whether gains of blocks add up to more than `least`, and than their scatter on the side of less explains."""
    less = np.minimum(of_blocks - of_blocks.mean(), 0.0)
    return bool(of_blocks.sum() > max(least, _SURE * float(np.sqrt(2.0 * np.sum(less**2)))))
