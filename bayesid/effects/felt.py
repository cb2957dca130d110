"""Columns of a model without those that a joint does not feel: no link shows in the joints behind it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array, Integers


@dataclass(frozen=True)
class FeltColumns:
    """(N, n, P) columns, of each joint those alone that are not zero: about half as many.

    Attributes:
        size: P.
        felt: of each of the n joints, (m,) the columns that it feels, ascending.
        values: of each joint, (N, m) these.

    Example:
        >>> columns = FeltColumns.of(np.array([[[1.0, 2.0], [0.0, 3.0]]]))
        >>> columns.felt[1].tolist(), columns.values[1].tolist(), columns.dense.shape
        ([1], [[3.0]], (1, 2, 2))
    """

    size: int
    felt: tuple[Integers, ...]
    values: tuple[Array, ...]

    @classmethod
    def of(cls, columns: Array) -> FeltColumns:
        """Those of (N, n, P)."""
        felt = tuple(np.flatnonzero(some) for some in np.any(columns != 0.0, axis=0))
        values = tuple(np.ascontiguousarray(columns[:, j, those]) for j, those in enumerate(felt))
        return cls(columns.shape[2], felt, values)

    def __len__(self) -> int:
        return len(self.values[0])

    @property
    def nbytes(self) -> int:
        """Of memory."""
        return sum(values.nbytes for values in self.values)

    @property
    def dense(self) -> Array:
        """(N, n, P) all of them, in an array of their own."""
        dense = np.zeros((len(self), len(self.values), self.size))
        for j, (those, values) in enumerate(zip(self.felt, self.values, strict=True)):
            dense[:, j, those] = values
        return dense

    def of_joint(self, joint: int, columns: Integers) -> Array:
        """(N, k) some columns of a joint, ascending, all that it feels among them."""
        own = self.values[joint]
        if np.array_equal(columns, self.felt[joint]):
            return own
        some = np.zeros((len(self), len(columns)))
        some[:, np.searchsorted(columns, self.felt[joint])] = own
        return some

    def chosen(self, columns: Integers) -> FeltColumns:
        """Some of the P columns, in ascending order."""
        place = np.full(self.size, -1)
        place[columns] = np.arange(len(columns))
        felt, values = [], []
        for those, own in zip(self.felt, self.values, strict=True):
            inside = place[those] >= 0
            felt.append(place[those[inside]])
            values.append(own if inside.all() else np.ascontiguousarray(own[:, inside]))
        return FeltColumns(len(columns), tuple(felt), tuple(values))
