"""Rows that only repeat the one before: controllers write their last reading until there is a new one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesid.arrays import Array, Integers

HELD = 10
"""A repeated row is kept after this many typical periods without a new one: the robot stood still. A round number; not
studied."""


def distinct_rows(t: Array, readings: Sequence[Array]) -> Integers:
    """Rows that bring something new: a later time and a changed reading.

    Args:
        t: (N,) s, non-decreasing.
        readings: (N, k) each.
    """
    fresh = np.zeros(len(t), dtype=bool)
    fresh[:1] = True
    for column in (column for block in readings for column in block.T):
        fresh[1:] |= column[1:] != column[:-1]
    if fresh.all() and np.all(np.diff(t) > 0.0):
        return np.arange(len(t))
    typical = float(np.median(np.diff(t[fresh]))) if fresh.sum() > 2 else 0.0
    keep: list[int] = []
    for i in range(len(t)):
        later = not keep or t[i] > t[keep[-1]]
        if later and (fresh[i] or t[i] - t[keep[-1]] > HELD * typical):
            keep.append(i)
    return np.array(keep)
