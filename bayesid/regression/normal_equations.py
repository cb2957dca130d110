"""Normal equations of a log: sums over segments whose size does not depend on the log's length.

For every segment k of constant sign, with Y_k its rows of the regressor and e_k its efforts (absolute values where the
sign is unknown), :eq:`normal_equations`::

    H_k = Y_k' Y_k,   g_k = Y_k' e_k,   c_k = e_k' e_k,

and the cost of coefficients beta under signs s is  f = beta' (sum H_k) beta - 2 beta' (sum s_k g_k) + sum c_k
(:eq:`cost`). Normal equations of different logs, with different segments, can be joined.

The efforts of a robot's last joint depend on few coefficients. `Hessians` stores each H_k in the columns that act on
its joint, which saves most of the memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.model import Model, SparseColumns
from bayesid.log.segments import Segments
from bayesid.motion import Motion

_RELATIVE_FLOOR = 1e-6
"""Least residual over the RMS effort: sums of squares cancel to 1e-14, which is 1e-7 of the RMS."""


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations of S segments for r coefficients, in units of the noise when `scaled`.

    H is stored in K parts. A search needs the H_k of each strong segment. Weak segments of one joint may share a part,
    which saves memory in a long log.

    Attributes:
        joint: (S,) 0-based actuator of each segment.
        known: (S,) known sign, +1 or -1; 0 where it is unknown.
        hessian: K sums of H_k; the segments of a part belong to one joint and are all known or all unknown.
        gradient: (S, r) g_k.
        energy: (S,) c_k.
        count: (S,) samples.
        part: (S,) part of the Hessian of each segment; empty: each segment has its own.
    """

    joint: Integers
    known: Integers
    hessian: Hessians
    gradient: Array
    energy: Array
    count: Integers
    part: Integers = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    def __post_init__(self) -> None:
        if not self.part.size:
            object.__setattr__(self, "part", np.arange(len(self.joint)))

    def __len__(self) -> int:
        return len(self.joint)

    @property
    def individual(self) -> Mask:
        """(S,) whether the segment has its own part of the Hessian."""
        individual: Mask = np.bincount(self.part, minlength=len(self.hessian))[self.part] == 1
        return individual

    def hessian_of(self, segments: Integers) -> Array:
        """(r, r) sum over the parts to which these segments belong."""
        return self.hessian.of(np.unique(self.part[segments]))

    def join(self, *others: NormalEquations) -> NormalEquations:
        """Normal equations of several logs of one model; segments are concatenated."""
        names, every = ("joint", "known", "gradient", "energy", "count"), (self, *others)
        joined = {name: np.concatenate([getattr(each, name) for each in every]) for name in names}
        firsts = np.cumsum([0, *(len(each.hessian) for each in every)])
        part = np.concatenate([first + each.part for first, each in zip(firsts, every, strict=False)])
        return NormalEquations(**joined, hessian=self.hessian.joined([other.hessian for other in others]), part=part)

    def chosen(self, segments: Integers) -> NormalEquations:
        """Normal equations of some segments.

        Raises:
            ValueError: a segment shares its part of the Hessian with one that is not chosen.
        """
        parts, part = np.unique(self.part[segments], return_inverse=True)
        if np.any(np.isin(np.delete(self.part, segments), parts)):
            raise ValueError("segments that share a part of the Hessian cannot be separated")
        values = {name: getattr(self, name)[segments] for name in ("joint", "known", "gradient", "energy", "count")}
        return NormalEquations(**values, hessian=self.hessian.chosen(parts), part=part.astype(np.int64))

    def compact(self, most_individual: int) -> NormalEquations:
        """The same with individual parts for at most this many segments of each joint, those with most energy."""
        part = _parts(self.joint, self.known, np.where(self.individual, self.energy, -np.inf), most_individual)
        if len(np.unique(part)) == len(self.hessian):
            return self
        first = np.unique(self.part, return_index=True)[1]
        return replace(self, part=part, hessian=self.hessian.summed(part[first]))

    def merged(self, into: Integers) -> NormalEquations:
        """Normal equations of merged segments: `into` (S,) holds the new index of each, without gaps.

        Merged segments have one joint and sign. They share a part of the Hessian if their old segments did.
        """
        size = len(np.unique(into))
        links = scipy.sparse.csr_array(
            (np.ones(len(self)), (into, size + self.part)), shape=2 * (size + len(self.hessian),)
        )
        label = scipy.sparse.csgraph.connected_components(links, directed=False)[1]
        hessian = self.hessian.summed(label[size:].astype(np.int64))
        first = np.unique(into, return_index=True)[1]
        gradient, energy = (_summed(values, into, size) for values in (self.gradient, self.energy))
        count = np.bincount(into, self.count, size).astype(np.int64)
        return NormalEquations(self.joint[first], self.known[first], hessian, gradient, energy, count, label[:size])

    def scaled(self, sigma: Array) -> NormalEquations:
        """Rows divided by sigma (n,), the noise of each joint's effort, N m."""
        weight = 1.0 / sigma[self.joint] ** 2
        of_part = np.zeros(len(self.hessian))
        of_part[self.part] = weight
        hessian, gradient = self.hessian.scaled(of_part), weight[:, None] * self.gradient
        return replace(self, hessian=hessian, gradient=gradient, energy=weight * self.energy)

    def rms_effort(self, n: int) -> Array:
        """(n,) RMS effort of each of n joints, N m; 1 where there are no samples."""
        return np.sqrt(self._per_sample(self._joint_sums(self.energy, n)))

    def residual_sd(self, beta: Array, signs: Integers, n: int) -> Array:
        """(n,) RMS residual of each of n joints under coefficients beta (r,) and signs (S,), N m."""
        explained = np.bincount(self.hessian.joint, weights=self.hessian.forms(beta[None])[0], minlength=n)
        cost = explained + self._joint_sums(self.energy - 2.0 * signs * (self.gradient @ beta), n)
        floor = _RELATIVE_FLOOR * self.rms_effort(n)
        return np.maximum(np.sqrt(np.maximum(self._per_sample(cost), 0.0)), floor)

    def _joint_sums(self, values: Array, n: int) -> Array:
        return np.bincount(self.joint, weights=values, minlength=n).astype(np.float64)

    def _per_sample(self, sums: Array) -> Array:
        """(n,) sums divided by the joints' numbers of samples; 1 without samples."""
        count = self._joint_sums(self.count.astype(np.float64), len(sums))
        return np.where(count > 0.0, sums / np.maximum(count, 1.0), 1.0)

    def cost(self, beta: Array, signs: Array) -> float:
        """f(beta, s) for coefficients beta (r,) and signs (S,) (:eq:`cost`)."""
        return float(beta @ self.hessian.total() @ beta - 2 * beta @ (signs @ self.gradient) + self.energy.sum())


def normal_equations(
    model: Model,
    coefficients: BaseCoefficients,
    motion: Motion,
    effort: Array,
    segments: Segments,
    most_individual: int | None = None,
    square: Array | None = None,
    correct: Callable[[slice, Array], Array] | None = None,
) -> NormalEquations:
    """Normal equations of a log, computed in chunks of its samples.

    Args:
        model: the model.
        coefficients: its r base coefficients.
        motion: N samples of motion.
        effort: (N, n) efforts, N m; absolute values for segments of unknown sign.
        segments: stretches of constant sign; samples outside of all segments are not used.
        most_individual: segments of each joint with an individual part, those with most energy; None: all.
        square: (N, n) expected squares of the efforts, if `effort` is itself an expectation; None: its squares.
        correct: changes the columns (N', n, r) of a chunk; None: unchanged.
    """
    size, r = len(segments), len(coefficients)
    ranges = list(zip(segments.joint, segments.start, segments.end, strict=True))
    square = effort**2 if square is None else square
    energy = np.array([np.sum(square[a:b, j]) for j, a, b in ranges])
    part = np.arange(size)
    if most_individual is not None:
        part = _parts(segments.joint, segments.known, energy, most_individual)
    joint = np.zeros(part.max(initial=-1) + 1, dtype=np.int64)
    joint[part] = segments.joint
    hessian, gradient = HessianSums(r, joint), np.zeros((size, r))
    for rows, every in model.sparse_chunks(motion):
        columns = every.chosen(coefficients.selected)
        columns = columns if correct is None else SparseColumns.of(correct(rows, columns.dense))
        here = np.flatnonzero((segments.start < rows.stop) & (segments.end > rows.start))
        sparsity = {j: hessian.feel(j, columns.sparsity[j]) for j in np.unique(segments.joint[here])}
        of_joint = {j: columns.of_joint(j, felt) for j, felt in sparsity.items()}
        for k in here:
            j, a, b = ranges[k]
            inside = slice(max(a, rows.start), min(b, rows.stop))
            y, e = of_joint[j][inside.start - rows.start : inside.stop - rows.start], effort[inside, j]
            hessian.add_rows(part[k], y)
            gradient[k, sparsity[j]] += y.T @ e
    count = segments.end - segments.start
    return NormalEquations(segments.joint, segments.known, hessian.done(), gradient, energy, count, part)


def join_moments(pieces: Iterable[NormalEquations], most_individual: int) -> NormalEquations:
    """Joins the normal equations of logs of one model, or of pieces of a long one, in bounded memory.

    The `most_individual` segments of each joint with most energy keep an individual part.
    """
    waiting: list[NormalEquations] = []
    held, bound = 0, 0
    for piece in pieces:
        waiting.append(piece)
        held += len(piece.hessian)
        if held > bound:  # merging only when the size has doubled saves time
            waiting = [waiting[0].join(*waiting[1:]).compact(most_individual)]
            held = len(waiting[0].hessian)
            bound = 2 * held
    return waiting[0].join(*waiting[1:]).compact(most_individual)


def _summed(values: Array, into: Integers, size: int) -> Array:
    """(size, ...) sums of values (S, ...) with equal indices."""
    total = np.zeros((size, *values.shape[1:]), values.dtype)
    np.add.at(total, into, values)
    return total


def _parts(joint: Integers, known: Integers, energy: Array, most_individual: int) -> Integers:
    """(S,) part of each segment: the strongest unknown ones have their own; a joint's other and known ones share."""
    shared = np.zeros(len(joint), dtype=np.int64)
    for j in np.unique(joint):
        unknown = np.flatnonzero((joint == j) & (known == 0))
        strongest = unknown[np.argsort(-energy[unknown], kind="stable")][:most_individual]
        strongest = strongest[np.isfinite(energy[strongest])]
        shared[unknown] = -2 * j - 1
        shared[(joint == j) & (known != 0)] = -2 * j - 2
        shared[strongest] = strongest
    return np.unique(shared, return_inverse=True)[1].astype(np.int64)


@dataclass(frozen=True)
class Hessians:
    """Symmetric matrices (r, r) of K parts.

    Attributes:
        size: r.
        joint: (K,) 0-based joint of each part.
        columns: of each joint, (m,) the columns that act on it, ascending.
        values: of each joint, (parts, m, m) its matrices in these columns, in the order of its parts.
    """

    size: int
    joint: Integers
    columns: tuple[Integers, ...]
    values: tuple[Array, ...]

    @classmethod
    def make(cls, joint: Integers, dense: Array) -> Hessians:
        """From full matrices (K, r, r) and the joint (K,) of each."""
        joints = int(joint.max(initial=-1)) + 1
        columns = [np.flatnonzero(np.any(dense[joint == j] != 0.0, axis=(0, 1))) for j in range(joints)]
        values = [dense[np.ix_(joint == j, sparsity, sparsity)] for j, sparsity in enumerate(columns)]
        return cls(dense.shape[1], joint, tuple(columns), tuple(values))

    @cached_property
    def place(self) -> Integers:
        """(K,) index of each part among those of its joint."""
        return _places(self.joint)

    def __len__(self) -> int:
        return len(self.joint)

    def __getitem__(self, parts: int | Integers | slice) -> Array:
        """(r, r) full matrix of a part, or (k, r, r) of several."""
        chosen = np.arange(len(self))[parts]
        dense = np.zeros((np.size(chosen), self.size, self.size))
        for row, part in enumerate(np.atleast_1d(chosen)):
            sparsity = self.columns[self.joint[part]]
            dense[row][np.ix_(sparsity, sparsity)] = self.values[self.joint[part]][self.place[part]]
        return dense if np.ndim(chosen) else dense[0]

    def total(self) -> Array:
        """(r, r) sum of all parts."""
        return self.by_joint(len(self.values)).sum(axis=0)

    def by_joint(self, n: int) -> Array:
        """(n, r, r) sums over each of n joints."""
        sums = np.zeros((n, self.size, self.size))
        for j, (sparsity, values) in enumerate(zip(self.columns, self.values, strict=True)):
            sums[j][np.ix_(sparsity, sparsity)] = values.sum(axis=0)
        return sums

    def of(self, parts: Integers) -> Array:
        """(r, r) sum over some parts, each counted once."""
        total = np.zeros((self.size, self.size))
        for j in np.unique(self.joint[parts]):
            here = self.place[parts[self.joint[parts] == j]]
            total[np.ix_(self.columns[j], self.columns[j])] += self.values[j][here].sum(axis=0)
        return total

    def forms(self, beta: Array) -> Array:
        """(W, K) beta' H beta for coefficients (W, r)."""
        forms = np.empty((len(beta), len(self)))
        for j, (sparsity, values) in enumerate(zip(self.columns, self.values, strict=True)):
            narrow, (count, m, _) = beta[:, sparsity], values.shape
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
        """These parts followed by those of others, for the same coefficients."""
        joint = np.concatenate([self.joint, *(other.joint for other in others)])
        sums, first = HessianSums(self.size, joint), 0
        for each in (self, *others):
            sums.add(each, np.arange(first, first + len(each)))
            first += len(each)
        return sums.done()

    def summed(self, into: Integers) -> Hessians:
        """Sums of parts with equal indices (K,), which run from 0 without gaps."""
        joint = np.zeros(int(into.max(initial=-1)) + 1, dtype=np.int64)
        joint[into] = self.joint
        sums = HessianSums(self.size, joint)
        sums.add(self, into)
        return sums.done()


class HessianSums:
    """Hessians of r columns that grow by added rows; joint (K,) of each part."""

    def __init__(self, size: int, joint: Integers) -> None:
        self._size, self._joint, self._place = size, joint, _places(joint)
        counts: Integers = np.bincount(joint)
        self._columns: list[Integers] = [np.empty(0, dtype=np.int64) for _ in counts]
        self._values: list[Array] = [np.zeros((count, 0, 0)) for count in counts]

    def feel(self, joint: int, columns: Integers) -> Integers:
        """Adds columns that act on a joint; returns all of its columns."""
        sparsity = self._columns[joint]
        new = np.union1d(sparsity, columns)
        if len(new) > len(sparsity):
            kept = np.searchsorted(new, sparsity)
            values = np.zeros((len(self._values[joint]), len(new), len(new)))
            values[:, kept[:, None], kept] = self._values[joint]
            self._columns[joint], self._values[joint] = new, values
        return self._columns[joint]

    def add_rows(self, part: int, rows: Array) -> None:
        """Adds rows' rows for rows (N, m) in the columns of the part's joint."""
        self._values[self._joint[part]][self._place[part]] += rows.T @ rows

    def add(self, other: Hessians, into: Integers) -> None:
        """Adds part k of other Hessians to part into[k]."""
        for j, (columns, values) in enumerate(zip(other.columns, other.values, strict=True)):
            here = other.joint == j
            if not np.any(here):
                continue
            sparsity = np.searchsorted(self.feel(j, columns), columns)
            target, source = self._place[into[here]], values  # both in the order of the joint's parts
            if len(np.unique(target)) < len(target):
                order = np.argsort(target, kind="stable")
                target, begins = np.unique(target[order], return_index=True)
                source = np.add.reduceat(source[order], begins, axis=0)
            self._values[j][np.ix_(target, sparsity, sparsity)] += source

    def done(self) -> Hessians:
        """The sums."""
        return Hessians(self._size, self._joint, tuple(self._columns), tuple(self._values))


def _places(joint: Sequence[int] | Integers) -> Integers:
    """(K,) number of earlier entries of the same joint."""
    joint = np.asarray(joint, dtype=np.int64)
    order = np.argsort(joint, kind="stable")
    begins = np.searchsorted(joint[order], joint[order])
    places = np.empty(len(joint), dtype=np.int64)
    places[order] = np.arange(len(joint)) - begins
    return places
