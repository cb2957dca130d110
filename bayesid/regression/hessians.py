"""Many symmetric matrices, one a part of a log's segments, each held in the columns that its joint feels.

The efforts of a robot's last joint depend on a few coefficients only. Of the (r, r) numbers of its Hessians all others
are zero: those of an hour's segments, held in full, would take several times the memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesid.arrays import Array, Integers


@dataclass(frozen=True)
class Hessians:
    """Symmetric matrices (r, r) of K parts.

    Attributes:
        size: r.
        joint: (K,) 0-based joint of each part.
        columns: of each joint, (m,) the columns that it feels, ascending.
        values: of each joint, (parts, m, m) its matrices in these columns, in the order of its parts; they are zero in
            all others.

    Example:
        >>> hessians = Hessians.make(np.array([0, 1]), np.array([np.eye(3), np.diag([0.0, 2.0, 5.0])]))
        >>> len(hessians), hessians.columns[1].tolist()
        (2, [1, 2])
        >>> hessians.total().diagonal().tolist()
        [1.0, 3.0, 6.0]
    """

    size: int
    joint: Integers
    columns: tuple[Integers, ...]
    values: tuple[Array, ...]

    @classmethod
    def make(cls, joint: Integers, dense: Array) -> Hessians:
        """Of matrices (K, r, r) that are held in full, and the joint (K,) of each."""
        joints = int(joint.max(initial=-1)) + 1
        columns = [np.flatnonzero(np.any(dense[joint == j] != 0.0, axis=(0, 1))) for j in range(joints)]
        values = [dense[np.ix_(joint == j, felt, felt)] for j, felt in enumerate(columns)]
        return cls(dense.shape[1], joint, tuple(columns), tuple(values))

    @cached_property
    def place(self) -> Integers:
        """(K,) of each part among those of its joint."""
        return _places(self.joint)

    def __len__(self) -> int:
        return len(self.joint)

    def __getitem__(self, parts: int | Integers | slice) -> Array:
        """(r, r) of a part, or (k, r, r) of some of them, in full."""
        chosen = np.arange(len(self))[parts]
        dense = np.zeros((np.size(chosen), self.size, self.size))
        for row, part in enumerate(np.atleast_1d(chosen)):
            felt = self.columns[self.joint[part]]
            dense[row][np.ix_(felt, felt)] = self.values[self.joint[part]][self.place[part]]
        return dense if np.ndim(chosen) else dense[0]

    def total(self) -> Array:
        """(r, r) the sum of all."""
        return self.by_joint(len(self.values)).sum(axis=0)

    def by_joint(self, n: int) -> Array:
        """(n, r, r) the sums of each of n joints."""
        sums = np.zeros((n, self.size, self.size))
        for j, (felt, values) in enumerate(zip(self.columns, self.values, strict=True)):
            sums[j][np.ix_(felt, felt)] = values.sum(axis=0)
        return sums

    def of(self, parts: Integers) -> Array:
        """(r, r) the sum over some parts, each of which counts once."""
        total = np.zeros((self.size, self.size))
        for j in np.unique(self.joint[parts]):
            here = self.place[parts[self.joint[parts] == j]]
            total[np.ix_(self.columns[j], self.columns[j])] += self.values[j][here].sum(axis=0)
        return total

    def forms(self, beta: Array) -> Array:
        """(W, K) beta' H beta for coefficients (W, r)."""
        forms = np.empty((len(beta), len(self)))
        for j, (felt, values) in enumerate(zip(self.columns, self.values, strict=True)):
            narrow, (count, m, _) = beta[:, felt], values.shape
            product = (narrow @ values.transpose(1, 0, 2).reshape(m, count * m)).reshape(len(beta), count, m)
            forms[:, self.joint == j] = np.einsum("wkm,wm->wk", product, narrow)
        return forms

    def scaled(self, weights: Array) -> Hessians:
        """Each of the K parts times its weight (K,)."""
        values = [weights[self.joint == j, None, None] * values for j, values in enumerate(self.values)]
        return Hessians(self.size, self.joint, self.columns, tuple(values))

    def chosen(self, parts: Integers) -> Hessians:
        """Some of the parts, in this order."""
        joint = self.joint[parts]
        values = [values[self.place[parts[joint == j]]] for j, values in enumerate(self.values)]
        return Hessians(self.size, joint, self.columns, tuple(values))

    def joined(self, others: Sequence[Hessians]) -> Hessians:
        """These parts and behind them those of others, of the same coefficients."""
        joint = np.concatenate([self.joint, *(other.joint for other in others)])
        sums, first = HessianSums(self.size, joint), 0
        for each in (self, *others):
            sums.add(each, np.arange(first, first + len(each)))
            first += len(each)
        return sums.done()

    def __add__(self, other: Hessians) -> Hessians:
        """The sums of each part of these and the same part of others."""
        sums, same = HessianSums(self.size, self.joint), np.arange(len(self))
        sums.add(self, same)
        sums.add(other, same)
        return sums.done()

    def summed(self, into: Integers) -> Hessians:
        """Of new parts, each the sum of all parts that go into it; of one joint.

        Args:
            into: (K,) index of the new part, counted from 0 without gaps.
        """
        joint = np.zeros(int(into.max(initial=-1)) + 1, dtype=np.int64)
        joint[into] = self.joint
        sums = HessianSums(self.size, joint)
        sums.add(self, into)
        return sums.done()


class HessianSums:
    """Hessians that grow by what is added to their parts.

    Args:
        size: r.
        joint: (K,) of each part.
    """

    def __init__(self, size: int, joint: Integers) -> None:
        self._size, self._joint, self._place = size, joint, _places(joint)
        counts: Integers = np.bincount(joint)
        self._columns: list[Integers] = [np.empty(0, dtype=np.int64) for _ in counts]
        self._values: list[Array] = [np.zeros((count, 0, 0)) for count in counts]

    def feel(self, joint: int, columns: Integers) -> Integers:
        """Takes note that a joint feels these columns as well; all that it feels."""
        felt = self._columns[joint]
        new = np.union1d(felt, columns)
        if len(new) > len(felt):
            kept = np.searchsorted(new, felt)
            values = np.zeros((len(self._values[joint]), len(new), len(new)))
            values[:, kept[:, None], kept] = self._values[joint]
            self._columns[joint], self._values[joint] = new, values
        return self._columns[joint]

    def add_rows(self, part: int, rows: Array) -> None:
        """Adds rows' rows, rows (N, m) in the columns that the part's joint feels."""
        self._values[self._joint[part]][self._place[part]] += rows.T @ rows

    def add(self, other: Hessians, into: Integers) -> None:
        """Adds to part into[k] the k-th of other ones."""
        for j, (columns, values) in enumerate(zip(other.columns, other.values, strict=True)):
            here = other.joint == j
            if not np.any(here):
                continue
            felt = np.searchsorted(self.feel(j, columns), columns)
            target, source = self._place[into[here]], values  # both in the order of the joint's parts
            if len(np.unique(target)) < len(target):
                order = np.argsort(target, kind="stable")
                target, begins = np.unique(target[order], return_index=True)
                source = np.add.reduceat(source[order], begins, axis=0)
            self._values[j][np.ix_(target, felt, felt)] += source

    def done(self) -> Hessians:
        """What has been added up."""
        return Hessians(self._size, self._joint, tuple(self._columns), tuple(self._values))


def _places(joint: Sequence[int] | Integers) -> Integers:
    """(K,) how many of those before belong to the same joint."""
    joint = np.asarray(joint, dtype=np.int64)
    order = np.argsort(joint, kind="stable")
    begins = np.searchsorted(joint[order], joint[order])
    places = np.empty(len(joint), dtype=np.int64)
    places[order] = np.arange(len(joint)) - begins
    return places
