"""Cholesky factors of matrices in mixed units, whose rows may differ by many orders of magnitude."""

from __future__ import annotations

import numpy as np

from bayesid.arrays import Array

_LEAST_RIDGE = 1e-15
"""The first ridge that a factorisation tries, relative to a unit diagonal: four roundings."""
_MOST_RIDGE = 1e-9
"""The largest: what asks for more is singular, not rounded."""


def factor(matrix: Array) -> Array:
    """(P, P) lower triangular L with L L' = matrix but for rounding; the matrix is scaled to a unit diagonal first.

    Args:
        matrix: (P, P) positive definite.

    Raises:
        LinAlgError: it is singular by more than rounding.
    """
    scale = np.sqrt(np.diag(matrix))
    scaled, ridge = matrix / np.outer(scale, scale), 0.0
    while True:
        try:
            lower: Array = scale[:, None] * np.linalg.cholesky(scaled + ridge * np.eye(len(matrix)))
            return lower
        except np.linalg.LinAlgError:
            if ridge >= _MOST_RIDGE:
                raise
        ridge = max(_LEAST_RIDGE, 10.0 * ridge)
