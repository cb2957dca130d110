"""Many samples as a figure can show them: thinned, or averaged over a variable."""

from __future__ import annotations

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.report.tuning import TUNING


def binned(value: Array, residual: Array) -> tuple[Array, Array, Array]:
    """(b,) means of the variable and the residual over equally many samples each, and the latter's standard error.

    Args:
        value: (N,) a variable.
        residual: (N,) what goes with it; samples are taken as independent.
    """
    order = np.array_split(np.argsort(value, kind="stable"), min(TUNING.bins, max(1, len(value) // 2)))
    full = [rows for rows in order if len(rows) > 1]
    centre, mean = (np.array([values[rows].mean() for rows in full]) for values in (value, residual))
    error = np.array([residual[rows].std(ddof=1) / np.sqrt(len(rows)) for rows in full])
    return centre, mean, error


def evenly(count: int, most: int) -> Integers:
    """Indices of at most so many of `count` samples, evenly spread, both ends among them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))


def envelope(values: Array, most: int) -> Integers:
    """Indices of at most about so many samples of a curve (N,) that look like all of it: each stretch's extremes."""
    if len(values) <= most:
        return np.arange(len(values))
    edges = np.linspace(0, len(values), most // 2 + 1).astype(np.int64)
    starts, stretch = edges[:-1], np.repeat(np.arange(len(edges) - 1), np.diff(edges))
    low, high = (np.lexsort((way * values, stretch))[starts] for way in (1.0, -1.0))
    return np.unique(np.concatenate([[0], low, high, [len(values) - 1]]))
