"""Patterns: sign choices of the segments of one or several joints that a bound does not exclude.

The rows of one joint almost determine its own pattern. With any set D of decided segments, and without the cone,
:eq:`dropped-rows`::

    b(s) = min over beta of  sum over k in D of |s_k e_k - Y_k beta|^2 + a share of the Tikhonov term

is a lower bound of the cost of every completion, since further rows and the cone can only raise the cost. So patterns
with a bound above the limit are dropped. Segments are decided in the order of their energy, which keeps the lists short
if the data determine the signs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array, Integers, Mask
from bayesid.regression.normal_equations import NormalEquations
from bayesid.signs.search.bounds import UnconstrainedBound

LOG2 = float(np.log(2.0))

Keep = Callable[[Array], Integers]
"""Selects the indices to keep from the bounds (m,) of the next patterns; may raise to stop the work."""


@dataclass(frozen=True)
class Remainder:
    """Contribution of the undecided segments to a pattern's bound."""

    undecided: float = 0.0  # lower bound of the cost of their rows
    total: float = 0.0  # lower bound of the cost of all rows of the joints, under any signs

    def __add__(self, other: Remainder) -> Remainder:
        """The sum for two sets of joints."""
        return Remainder(self.undecided + other.undecided, self.total + other.total)

    def log_mass(self, bound: Array) -> float:
        """Log of the sum of exp(-b / 2), b the lower bounds of patterns with all segments included."""
        return log_sum(np.maximum(bound + self.undecided, self.total))


@dataclass(frozen=True)
class Patterns:
    """m sign choices of the same decided segments, with their bounds."""

    segments: Integers  # (d,) the decided segments
    signs: Array  # (m, d) +1 or -1
    gradient: Array  # (m, r) sum of s_k g_k over the decided and the known segments
    bound: Array  # (m,) lower bounds of the cost
    remainder: Remainder = Remainder()  # of the undecided segments
    # log of the sum of exp(-b / 2) over all dropped patterns of the same segments
    log_missed: float = -np.inf

    def __len__(self) -> int:
        return len(self.bound)

    @property
    def log_mass(self) -> float:
        """Log of the sum of exp(-b / 2) over all patterns, kept or not."""
        return float(np.logaddexp(self.remainder.log_mass(self.bound), self.log_missed))

    def __getitem__(self, rows: Integers | Mask) -> Patterns:
        """Some of the patterns, without counting the others as dropped."""
        return replace(self, signs=self.signs[rows], gradient=self.gradient[rows], bound=self.bound[rows])

    def beginning_with(self, decided: Integers) -> Patterns:
        """Patterns that agree with decided signs (S,), 0 for undecided."""
        detected = decided[self.segments]
        return self[np.flatnonzero(np.all((self.signs == detected) | (detected == 0), axis=1))]


class Block:
    """The segments of one joint in the order of decision; prepares its bounds once.

    Segments that share a part of the Hessian are never decided. `known` are those of known sign, `segments` the others,
    strongest first; `tikhonov` (r, r) is this block's share of the Tikhonov term.
    """

    def __init__(self, normal_equations: NormalEquations, known: Integers, segments: Integers, tikhonov: Array) -> None:
        self.segments = segments
        self._normal_equations, self._known, self._tikhonov = normal_equations, known, tikhonov
        self._gradient = normal_equations.known[known] @ normal_equations.gradient[known]
        self._energy = float(normal_equations.energy[known].sum()) + np.cumsum(
            np.concatenate([[0.0], normal_equations.energy[self.segments]])
        )
        self._root = tikhonov + normal_equations.hessian_of(known)
        self._last = self._root
        self._bounds: list[UnconstrainedBound] = []
        self.nodes = 0

    def first(self, depth: int) -> Block:
        """The known and the first `depth` unknown segments as another block."""
        if depth == len(self.segments):
            return self
        return Block(self._normal_equations, self._known, self.segments[:depth], self._tikhonov)

    def after(self, depth: int, tikhonov: Array, end: int | None = None) -> Block:
        """The segments from `depth` on, up to `end`, as another block, with another share of rho (r, r)."""
        return Block(self._normal_equations, self.segments[:0], self.segments[depth:end], tikhonov)

    def groups(self, size: int) -> list[Block]:
        """The block in groups of about `size` segments of mixed strength; the sum of their costs is a lower bound.

        Each group has its own coefficients, so the sum is at most the block's cost.
        """
        count = max(1, -(-len(self.segments) // size))
        if count == 1:
            return [self]
        known = [self._known, *(count - 1) * [self._known[:0]]]
        parts = [self.segments[k::count] for k in range(count)]
        return [Block(self._normal_equations, *pair, self._tikhonov / count) for pair in zip(known, parts, strict=True)]

    def strong(self, share: float, most: int) -> int:
        """Number of segments with at least this share of the strongest one's energy; at most `most`."""
        energy = self._normal_equations.energy[self.segments[:most]]
        return int(np.sum(energy >= share * energy.max(initial=0.0)))

    def hessian(self, depth: int) -> Array:
        """(r, r) of the known and the first `depth` unknown segments, the share of the Tikhonov term included."""
        return self._root + self._normal_equations.hessian_of(self.segments[:depth])

    def energy(self, depth: int) -> float:
        """Energy of the known and the first `depth` unknown segments."""
        return float(self._energy[depth])

    def best(self, width: int, depth: int) -> Patterns:
        """The `width` best patterns that a beam finds for the first `depth` segments."""
        return self._grow(depth, None, Remainder(), lambda bound, _: np.argsort(bound, kind="stable")[:width])

    def least(self, width: int, longest: int, check: Callable[[int], None], rounding: float) -> float:
        """Lower bound of the cost of every pattern, from as many segments as a list of `longest` can decide.

        The best of `width` patterns of a beam gives the limit of the list, with an allowance for rounding. The best
        child is kept even above it. `check` is called as in `within`.
        """
        depth = len(self.segments)
        upper = float(self.best(width, depth).bound.min()) + rounding

        def keep(bound: Array, _: int) -> Integers:
            check(len(bound))
            return np.flatnonzero(bound <= max(upper, float(bound.min())))

        return min(upper, float(self._grow(depth, longest, Remainder(), keep).bound.min()))

    def within(
        self, limit: float, depth: int, longest: int, check: Callable[[int], None], remainder: Remainder = Remainder()
    ) -> Patterns:
        """All patterns of the first `depth` segments, or fewer if `longest` requires it, with a bound up to `limit`.

        The limit is higher by 2 log 2 for each later segment, since an excluded pattern counts once for each
        completion. `check` is called at every segment with the number of patterns priced; it may raise to stop the
        work.
        """

        def keep(bound: Array, to_come: int) -> Integers:
            check(len(bound))
            return np.flatnonzero(bound <= limit + 2.0 * LOG2 * to_come)

        return self._grow(depth, longest, remainder, keep)

    def _grow(
        self, depth: int, longest: int | None, remainder: Remainder, keep: Callable[[Array, int], Integers]
    ) -> Patterns:
        root = self._gradient[None]
        bound = self._bound(0, root)
        parents = Patterns(self.segments[:0], np.ones((1, 0), dtype=np.int8), root, bound, remainder)
        for d in range(1, depth + 1):
            step = self._normal_equations.gradient[self.segments[d - 1]]
            children = np.concatenate([parents.gradient + step, parents.gradient - step])
            bound = self._bound(d, children)
            kept = keep(bound, depth - d)
            if longest is not None and len(kept) > longest:
                return parents
            choice = np.where(kept < len(parents), 1, -1).astype(np.int8)
            signs = np.column_stack([parents.signs[kept % len(parents)], choice])
            missed = np.logaddexp(parents.log_missed + LOG2, remainder.log_mass(np.delete(bound, kept)))
            parents = Patterns(self.segments[:d], signs, children[kept], bound[kept], remainder, float(missed))
        return parents

    def _bound(self, depth: int, gradient: Array) -> Array:
        while len(self._bounds) <= depth:
            if self._bounds:
                self._last = self._last + self._normal_equations.hessian_of(self.segments[[len(self._bounds) - 1]])
            self._bounds.append(UnconstrainedBound(self._last, 0.0))
        bound: Array = self._energy[depth] + self._bounds[depth](gradient)
        self.nodes += len(bound)
        return bound


def make_blocks(normal_equations: NormalEquations, tikhonov: Array) -> list[Block]:
    """A block for every joint that has segments, each with the same share of the Tikhonov term (r, r)."""
    joints = np.unique(normal_equations.joint)
    blocks = []
    for joint in joints:
        here = np.flatnonzero(normal_equations.joint == joint)
        known = here[normal_equations.known[here] != 0]
        unknown = here[(normal_equations.known[here] == 0) & normal_equations.individual[here]]
        strongest_first = unknown[np.argsort(-normal_equations.energy[unknown], kind="stable")]
        blocks.append(Block(normal_equations, known, strongest_first, tikhonov / len(joints)))
    return blocks


def join(
    first: Patterns,
    second: Patterns,
    hessian: Array,
    energy: float,
    keep: Keep,
    limit: float = np.inf,
    pairs_at_once: int = 50_000,
) -> Patterns:
    """The kept pairs of patterns of two sets of segments, with the bound of their rows together.

    H (r, r), with shares of the Tikhonov term, and c are those of both. Pairs whose separate bounds add up to more than
    `limit` are skipped. `keep` is called for `pairs_at_once` pairs, which limits the memory.
    """
    unconstrained = UnconstrainedBound(hessian, 0.0)
    at_once = max(1, pairs_at_once // max(1, len(second)))
    # A dropped pattern of one list pairs with all of the other; the cost is at least the sum of their bounds.
    remainder = first.remainder + second.remainder
    log_missed = float(np.logaddexp(first.log_missed + second.log_mass, first.log_mass + second.log_missed))
    pairs, gradients, bounds = [np.empty(0, dtype=np.int64)], [first.gradient[:0]], [first.bound[:0]]
    for start in range(0, len(first), at_once):
        apart = (first.bound[start : start + at_once, None] + second.bound).ravel()
        hopeful = np.flatnonzero(apart <= limit)  # a cheap test
        pair = start * len(second) + hopeful
        gradient = first.gradient[pair // len(second)] + second.gradient[pair % len(second)]
        bound = np.maximum(energy + unconstrained(gradient), apart[hopeful])
        kept = keep(bound)
        excluded = np.concatenate([np.delete(apart, hopeful), np.delete(bound, kept)])
        log_missed = float(np.logaddexp(log_missed, remainder.log_mass(excluded)))
        pairs.append(pair[kept])
        gradients.append(gradient[kept])
        bounds.append(bound[kept])
    pair = np.concatenate(pairs)
    signs = np.hstack([first.signs[pair // len(second)], second.signs[pair % len(second)]])
    segments = np.concatenate([first.segments, second.segments])
    return Patterns(segments, signs, np.concatenate(gradients), np.concatenate(bounds), remainder, log_missed)


def stack(lists: list[Patterns]) -> Patterns:
    """Lists of different patterns of the same segments as one."""
    return replace(
        lists[0],
        signs=np.concatenate([patterns.signs for patterns in lists]),
        gradient=np.concatenate([patterns.gradient for patterns in lists]),
        bound=np.concatenate([patterns.bound for patterns in lists]),
        log_missed=float(np.logaddexp.reduce([patterns.log_missed for patterns in lists])),
    )


def log_sum(bound: Array) -> float:
    """Log of the sum of exp(-b / 2)."""
    least = float(bound.min(initial=np.inf))
    return float(np.log(np.sum(np.exp(0.5 * (least - bound))))) - 0.5 * least if np.isfinite(least) else -least
