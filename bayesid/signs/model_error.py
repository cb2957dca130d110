"""The model's error b, a hidden process on a grid: what makes neighbouring samples judge each other's signs.

An Ornstein-Uhlenbeck process (:eq:`model-error`), wider at standstill, where it must hold all of the static friction.
Smoothing (`bayesid.signs.smoothing`) looks at it from both sides, filtering (`bayesid.signs.filtering`) from the past.
"""

from __future__ import annotations

import numpy as np

from bayesid.arrays import Array

_IMPOSSIBLE = 1e-30
"""Transition density that no step falls below: far under any likelihood, far over the smallest double."""
_GRID = 101
"""Values of b: with `_REACH` a spacing of 0.08 standard deviations, below what transitions can resolve."""
_FINEST = 0.75
"""Spacings of the grid: a narrower transition would fall between its points. A round number; not studied."""
_REACH = 4.0
"""Half-width of the grid in standard deviations of b."""
REST_TIME = 0.5
"""s; how fast static friction may build up. A round number; not studied."""
TURNS = 0.5
"""Probability that friction turns round at once in a standstill, at any of its samples: nothing is known of it."""
TAILS = 4.0
"""Degrees of freedom of the white noise: real residuals have outliers that a normal distribution thinks impossible. A
round number; not studied."""


def error_grid(largest: Array) -> Array:
    """(n, G) values of b, N m, for processes whose largest sd is (n,), N m."""
    grid: Array = (_REACH * largest)[:, None] * np.linspace(-1.0, 1.0, _GRID)
    return grid


def stationary(grid: Array, sd: Array) -> Array:
    """(n, G) normal distribution on the grid."""
    density = np.exp(-0.5 * (grid / sd[:, None]) ** 2)
    normal: Array = density / density.sum(axis=1, keepdims=True)
    return normal


def spread(grid: Array, sd: Array, memory: Array) -> Array:
    """(n,) sd of an Ornstein-Uhlenbeck process's step, no less than the grid can show."""
    spread: Array = np.maximum(sd * np.sqrt(1.0 - memory**2), _FINEST * (grid[:, 1] - grid[:, 0]))
    return spread


def transitions(grid: Array, sd: Array, memory: Array) -> Array:
    """(n, G, G) rows of p(b' | b) of an Ornstein-Uhlenbeck process."""
    distance = grid[:, None, :] - memory[:, None, None] * grid[:, :, None]
    density = np.exp(-0.5 * (distance / spread(grid, sd, memory)[:, None, None]) ** 2)
    density += _IMPOSSIBLE  # beliefs must not die out where model and effort contradict each other
    return density / density.sum(axis=2, keepdims=True)
