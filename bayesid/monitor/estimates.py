"""Coefficients from sums: the normal equations of least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array
from bayesid.monitor.stream_moments import Totals

_BLIND = 1e-12
"""Curvature of columns of unit length, relative to the largest one, that is rounding, as in
`bayesid.regression.least_squares`."""


@dataclass(frozen=True)
class Normal:
    """beta' H beta - 2 g' beta + c, rows in units of their noise.

    Attributes:
        hessian: (r, r) H.
        lost: (r, r) what H says too much, as long as signs are not certain: |effort| tells at least E[(E s)^2] of what
            the effort would, whatever that is in units of its noise (tests/monitor).
        gradient: (r,) g.
        energy: c.
    """

    hessian: Array
    lost: Array
    gradient: Array
    energy: float

    @classmethod
    def of(cls, totals: Totals, weights: Array) -> Normal:
        """Of the sums of each joint, and (n,) the noise of its efforts, N m."""
        share = 1.0 / weights**2
        hessian, lost = (np.tensordot(share, values, 1) for values in (totals.hessian, totals.lost))
        return cls(hessian, lost, share @ totals.gradient, float(share @ totals.energy))

    @classmethod
    def around(cls, centre: Array, precision: Array) -> Normal:
        """Of a normal distribution: its centre (r,) and its inverse covariance (r, r)."""
        gradient = precision @ centre
        return cls(precision, np.zeros_like(precision), gradient, float(centre @ gradient))

    def __add__(self, other: Normal) -> Normal:
        return Normal(
            self.hessian + other.hessian,
            self.lost + other.lost,
            self.gradient + other.gradient,
            self.energy + other.energy,
        )


def least_squares(hessian: Array, gradient: Array, start: Array) -> Array:
    """(r,) the coefficients that solve H beta = g and are nearest to a start (r,), in columns of unit length.

    Where H shows nothing they stay as they were.
    """
    lengths = np.sqrt(np.diag(hessian))
    seen = lengths > 0.0
    scale = np.where(seen, 1.0 / np.where(seen, lengths, 1.0), 0.0)
    values, vectors = np.linalg.eigh(scale[:, None] * hessian * scale)
    clear = values > _BLIND * max(values[-1], np.finfo(float).tiny)
    rest = vectors[:, clear].T @ (scale * (gradient - hessian @ start))
    step: Array = scale * (vectors[:, clear] @ (rest / values[clear]))
    return start + step
