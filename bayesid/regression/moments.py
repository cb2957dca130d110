"""Moments: all that the data say about a model, in a size that does not depend on the log's length.

For every segment k of constant sign, with Y_k its rows of the regressor and e_k its efforts (absolute values where the
sign is unknown), :eq:`moments`::

    H_k = Y_k' Y_k,   g_k = Y_k' e_k,   c_k = e_k' e_k,

and the cost of coefficients beta under signs s is  f = beta' (sum H_k) beta - 2 beta' (sum s_k g_k) + sum c_k
(:eq:`cost`).
Moments of chunks of one log add; those of different logs, with different segments, join.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.felt import FeltColumns
from bayesid.effects.model import Model
from bayesid.log.segments import Segments
from bayesid.motion import Motion
from bayesid.regression.hessians import Hessians, HessianSums

_RELATIVE_FLOOR = 1e-6
"""Least residual, as a share of the RMS effort: sums of squares cancel to some 1e-14 of themselves, 1e-7 of the RMS."""


@dataclass(frozen=True)
class Moments:
    """Moments of S segments for r coefficients, in units of the noise when `scaled`.

    H is held in K parts. A search wants the H_k of each strong segment; weak segments of one joint may share a part,
    which keeps the memory of a long log small.

    Attributes:
        joint: (S,) 0-based actuator of each segment.
        known: (S,) sign known beforehand, +1 or -1; 0 where it is unknown.
        hessian: of K parts, the sums of H_k over their segments; all of one joint, and all known or none.
        gradient: (S, r) g_k.
        energy: (S,) c_k.
        count: (S,) samples.
        part: (S,) which part of the Hessian the segment belongs to; one each if empty.
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
        """(S,) whether the segment shares its part of the Hessian with no other."""
        individual: Mask = np.bincount(self.part, minlength=len(self.hessian))[self.part] == 1
        return individual

    def hessian_of(self, segments: Integers) -> Array:
        """(r, r) sum over the parts to which these segments belong."""
        return self.hessian.of(np.unique(self.part[segments]))

    def __add__(self, other: Moments) -> Moments:
        """Moments of the same segments from more of their samples."""
        if not all(np.array_equal(getattr(self, name), getattr(other, name)) for name in ("joint", "known", "part")):
            raise ValueError("only moments of the same segments add; join those of different logs")
        sums = {name: getattr(self, name) + getattr(other, name) for name in ("hessian", "gradient", "energy", "count")}
        return replace(self, **sums)

    def join(self, *others: Moments) -> Moments:
        """Moments of several logs of the same model: the segments of one after those of the other."""
        names, every = ("joint", "known", "gradient", "energy", "count"), (self, *others)
        joined = {name: np.concatenate([getattr(each, name) for each in every]) for name in names}
        firsts = np.cumsum([0, *(len(each.hessian) for each in every)])
        part = np.concatenate([first + each.part for first, each in zip(firsts, every, strict=False)])
        return Moments(**joined, hessian=self.hessian.joined([other.hessian for other in others]), part=part)

    def chosen(self, segments: Integers) -> Moments:
        """Moments of some segments.

        Raises:
            ValueError: one of them shares a part of the Hessian with others that are not chosen.
        """
        parts, part = np.unique(self.part[segments], return_inverse=True)
        if np.any(np.isin(np.delete(self.part, segments), parts)):
            raise ValueError("segments that share a part of the Hessian cannot be parted")
        values = {name: getattr(self, name)[segments] for name in ("joint", "known", "gradient", "energy", "count")}
        return Moments(**values, hessian=self.hessian.chosen(parts), part=part.astype(np.int64))

    def compact(self, most_individual: int) -> Moments:
        """The same moments with individual parts for at most so many segments of each joint, those with most energy."""
        part = _parts(self.joint, self.known, np.where(self.individual, self.energy, -np.inf), most_individual)
        if len(np.unique(part)) == len(self.hessian):
            return self
        first = np.unique(self.part, return_index=True)[1]
        return replace(self, part=part, hessian=self.hessian.summed(part[first]))

    def merged(self, into: Integers) -> Moments:
        """Moments of segments that these are parts of, each of one joint and one sign.

        Args:
            into: (S,) index, counted from 0 without gaps, of the segment that each becomes a part of. Segments whose
                parts share a part of the Hessian share one too.
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
        return Moments(self.joint[first], self.known[first], hessian, gradient, energy, count, label[:size])

    def scaled(self, sigma: Array) -> Moments:
        """Rows weighted by 1 / sigma (n,), the noise of each joint's effort, N m."""
        weight = 1.0 / sigma[self.joint] ** 2
        of_part = np.zeros(len(self.hessian))
        of_part[self.part] = weight
        hessian, gradient = self.hessian.scaled(of_part), weight[:, None] * self.gradient
        return replace(self, hessian=hessian, gradient=gradient, energy=weight * self.energy)

    def rms_effort(self, n: int) -> Array:
        """(n,) RMS effort of each of n joints, N m; 1 where there are no samples."""
        return np.sqrt(self._per_sample(self._joint_sums(self.energy, n), 1.0))

    def residual_sd(self, beta: Array, signs: Integers, n: int) -> Array:
        """(n,) RMS residual of each of n joints under coefficients beta (r,) and signs (S,), N m."""
        explained = np.bincount(self.hessian.joint, weights=self.hessian.forms(beta[None])[0], minlength=n)
        cost = explained + self._joint_sums(self.energy - 2.0 * signs * (self.gradient @ beta), n)
        floor = _RELATIVE_FLOOR * self.rms_effort(n)
        return np.maximum(np.sqrt(np.maximum(self._per_sample(cost, 1.0), 0.0)), floor)

    def _joint_sums(self, values: Array, n: int) -> Array:
        return np.bincount(self.joint, weights=values, minlength=n).astype(np.float64)

    def _per_sample(self, sums: Array, otherwise: float) -> Array:
        """(n,) sums over the joints' numbers of samples, and another value where there are none."""
        count = self._joint_sums(self.count.astype(np.float64), len(sums))
        return np.where(count > 0.0, sums / np.maximum(count, 1.0), otherwise)

    def cost(self, beta: Array, signs: Array) -> float:
        """f(beta, s) for coefficients beta (r,) and signs (S,) (:eq:`cost`)."""
        return float(beta @ self.hessian.total() @ beta - 2 * beta @ (signs @ self.gradient) + self.energy.sum())


def moments(
    model: Model,
    coefficients: BaseCoefficients,
    motion: Motion,
    effort: Array,
    segments: Segments,
    most_individual: int | None = None,
    square: Array | None = None,
    correct: Callable[[slice, Array], Array] | None = None,
) -> Moments:
    """Moments of a log, streamed over chunks of its samples.

    Args:
        model: the model.
        coefficients: its r base coefficients.
        motion: N samples of motion.
        effort: (N, n) efforts, N m; absolute values for segments of unknown sign.
        segments: where the sign is constant; samples outside of every segment do not count.
        most_individual: segments of each joint with an individual part, those with most energy; all by default.
        square: (N, n) expected squares of the efforts where `effort` is an expectation itself; its squares by default.
        correct: what becomes of the columns (N', n, r) of a chunk; nothing by default.
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
    for rows, every in model.felt_chunks(motion):
        columns = every.chosen(coefficients.kept)
        columns = columns if correct is None else FeltColumns.of(correct(rows, columns.dense))
        here = np.flatnonzero((segments.start < rows.stop) & (segments.end > rows.start))
        felt = {j: hessian.feel(j, columns.felt[j]) for j in np.unique(segments.joint[here])}
        of_joint = {j: columns.of_joint(j, those) for j, those in felt.items()}
        for k in here:
            j, a, b = ranges[k]
            inside = slice(max(a, rows.start), min(b, rows.stop))
            y, e = of_joint[j][inside.start - rows.start : inside.stop - rows.start], effort[inside, j]
            hessian.add_rows(part[k], y)
            gradient[k, felt[j]] += y.T @ e
    count = segments.end - segments.start
    return Moments(segments.joint, segments.known, hessian.done(), gradient, energy, count, part)


def join_moments(pieces: Iterable[Moments], most_individual: int) -> Moments:
    """Moments of many logs, or of the pieces of a long one, joined one after the other in bounded memory.

    Args:
        pieces: moments of the same model; at least one.
        most_individual: segments of each joint that keep an individual part, those with most energy.
    """
    waiting: list[Moments] = []
    held, bound = 0, 0
    for piece in pieces:
        waiting.append(piece)
        held += len(piece.hessian)
        if held > bound:  # merging now and then costs less than every time
            waiting = [waiting[0].join(*waiting[1:]).compact(most_individual)]
            held = len(waiting[0].hessian)
            bound = 2 * held
    return waiting[0].join(*waiting[1:]).compact(most_individual)


def _summed(values: Array, into: Integers, size: int) -> Array:
    """(size, ...) sums of values (S, ...) by where each goes."""
    total = np.zeros((size, *values.shape[1:]), values.dtype)
    np.add.at(total, into, values)
    return total


def _parts(joint: Integers, known: Integers, energy: Array, most_individual: int) -> Integers:
    """(S,) a part each for the strongest unknown segments of a joint, one for the rest of them, one for its known."""
    shared = np.zeros(len(joint), dtype=np.int64)
    for j in np.unique(joint):
        unknown = np.flatnonzero((joint == j) & (known == 0))
        strongest = unknown[np.argsort(-energy[unknown], kind="stable")][:most_individual]
        strongest = strongest[np.isfinite(energy[strongest])]
        shared[unknown] = -2 * j - 1
        shared[(joint == j) & (known != 0)] = -2 * j - 2
        shared[strongest] = strongest
    return np.unique(shared, return_inverse=True)[1].astype(np.int64)
