"""The affine subspace of parameters that satisfy the equalities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from bayesid.arrays import TINY, Array

_ROUNDING = 1e-9
"""Share of the largest singular value, or of a value, below which a number is rounding."""


@dataclass(frozen=True)
class Plane:
    """All theta = origin + basis y, for y of d numbers; all of space where nothing is equal to anything.

    Attributes:
        origin: (P,) the point nearest to zero.
        basis: (P, d) orthonormal; a parameter without an equality is a number of y by itself.
    """

    origin: Array
    basis: Array

    @classmethod
    def whole(cls, size: int) -> Plane:
        """All of space."""
        return cls(np.zeros(size), np.eye(size))

    @classmethod
    def of(cls, rows: Array, value: Array) -> Plane:
        """Where rows (k, P) theta = value (k,), in the sense of least squares if they contradict each other.

        Parameters that no equality links are not mixed, whatever their units.
        """
        if not len(rows):
            return cls.whole(rows.shape[1])
        length = np.maximum(np.linalg.norm(rows, axis=1), TINY)
        rows, value = rows / length[:, None], value / length
        origin, columns = np.zeros(rows.shape[1]), []
        count, part = connected_components(csr_array(np.abs(rows).T @ np.abs(rows)), directed=False)
        for k in range(count):
            (own,) = np.nonzero(part == k)
            here = np.any(rows[:, own] != 0.0, axis=1)
            left, sizes, right = np.linalg.svd(rows[np.ix_(here, own)])
            rank = int(np.count_nonzero(sizes > _ROUNDING))
            origin[own] = right[:rank].T @ ((left.T @ value[here])[:rank] / sizes[:rank])
            columns.append(np.zeros((rows.shape[1], len(own) - rank)))
            columns[-1][own] = right[rank:].T
        return cls(origin, np.column_stack(columns))

    @property
    def is_whole(self) -> bool:
        """Whether it is all of space."""
        return self.basis.shape[0] == self.basis.shape[1]

    def point(self, y: Array) -> Array:
        """(..., P) of y (..., d)."""
        point: Array = self.origin + y @ self.basis.T
        return point

    def coordinates(self, theta: Array) -> Array:
        """(..., d) of the nearest point to theta (..., P)."""
        coordinates: Array = (theta - self.origin) @ self.basis
        return coordinates

    def nearest(self, theta: Array) -> Array:
        """(..., P) the nearest point to theta (..., P)."""
        return self.point(self.coordinates(theta))

    def seen_by(self, projection: Array) -> Plane:
        """Where coefficients lie, by B (r, P) of full rank."""
        if self.is_whole:
            return Plane.whole(len(projection))
        left, sizes, _ = np.linalg.svd(projection @ self.basis)
        fixed = left[:, np.count_nonzero(sizes > _ROUNDING * sizes.max(initial=TINY)) :].T
        fixed = np.where(np.abs(fixed) > _ROUNDING, fixed, 0.0)
        return Plane.of(fixed, fixed @ projection @ self.origin)
