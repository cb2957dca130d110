"""The affine subspace of parameters that satisfy the equalities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from bayesid.arrays import TINY, Array

_ROUNDING = 1e-9
"""Numbers below this, relative to the largest singular value, count as rounding."""


@dataclass(frozen=True)
class Plane:
    """All theta = origin + basis y, with y (d,); the whole space if there are no equalities.

    Attributes:
        origin: (P,) the point nearest to zero.
        basis: (P, d) orthonormal; a parameter without an equality is an entry of y.
    """

    origin: Array
    basis: Array

    @classmethod
    def whole(cls, size: int) -> Plane:
        return cls(np.zeros(size), np.eye(size))

    @classmethod
    def of(cls, rows: Array, value: Array) -> Plane:
        """The plane rows (k, P) theta = value (k,), by least squares if these contradict each other.

        Parameters that no equality links are not mixed, whatever their units.
        """
        if not len(rows):
            return cls.whole(rows.shape[1])
        length = np.maximum(np.linalg.norm(rows, axis=1), TINY)
        rows, value = rows / length[:, None], value / length
        origin, columns = np.zeros(rows.shape[1]), []
        count, part = connected_components(csr_array(np.abs(rows).T @ np.abs(rows)), directed=False)
        for k in range(count):
            (members,) = np.nonzero(part == k)
            here = np.any(rows[:, members] != 0.0, axis=1)
            left, sizes, right = np.linalg.svd(rows[np.ix_(here, members)])
            rank = int(np.count_nonzero(sizes > _ROUNDING))
            origin[members] = right[:rank].T @ ((left.T @ value[here])[:rank] / sizes[:rank])
            columns.append(np.zeros((rows.shape[1], len(members) - rank)))
            columns[-1][members] = right[rank:].T
        return cls(origin, np.column_stack(columns))

    @property
    def is_whole(self) -> bool:
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
        """The plane of the coefficients B theta, with B (r, P) of full rank."""
        if self.is_whole:
            return Plane.whole(len(projection))
        left, sizes, _ = np.linalg.svd(projection @ self.basis)
        fixed = left[:, np.count_nonzero(sizes > _ROUNDING * sizes.max(initial=TINY)) :].T
        fixed = np.where(np.abs(fixed) > _ROUNDING, fixed, 0.0)
        return Plane.of(fixed, fixed @ projection @ self.origin)
