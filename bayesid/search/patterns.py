"""Patterns: the sign choices of one joint's segments, or of several joints', that a bound does not exclude.

The rows of one joint almost decide its own pattern. With any set D of decided segments, and without the cone,
:eq:`dropped-rows`::

    b(s) = min over beta of  sum over k in D of |s_k e_k - Y_k beta|^2 + a share of the pull

bounds the cost of every completion from below: the rows left out could only add to it, and so could the cone. So
patterns whose bound exceeds what can still matter are never looked at again. Segments are decided in the order of
their energy, which keeps the lists short as long as the data say anything about a sign.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import logsumexp

from bayesid.moments import Moments
from bayesid.motion import Array, Integers, Mask
from bayesid.search.result import UnconstrainedBound

_AT_ONCE = 50_000
"""Pairs of patterns that are priced at once when two lists are joined: bounds the memory."""
_LOG2 = float(np.log(2.0))

Keep = Callable[[Array], Integers]
"""Chooses, from the bounds (m,) of the next patterns, the indices of those to keep; may raise to stop the work."""


@dataclass(frozen=True)
class Floor:
    """What the segments that are not decided cost at least.

    Attributes:
        rest: lower bound of what their rows cost by themselves.
        least: lower bound of what all rows of the joints cost, under any signs.
    """

    rest: float = 0.0
    least: float = 0.0

    def __add__(self, other: Floor) -> Floor:
        """Of the joints of both."""
        return Floor(self.rest + other.rest, self.least + other.least)

    def log_mass(self, bound: Array) -> float:
        """Log of the sum of exp(-b / 2), b what patterns with these bounds cost at least, all segments included."""
        return log_sum(np.maximum(bound + self.rest, self.least))


@dataclass(frozen=True)
class Patterns:
    """m sign choices of the same decided segments, with their bounds.

    Attributes:
        segments: (d,) the decided segments.
        signs: (m, d) +1 or -1.
        gradient: (m, r) sum of s_k g_k over the decided segments and those known beforehand.
        bound: (m,) lower bounds of the cost.
        floor: of the segments that are not decided.
        left_out: log of the sum of exp(-b / 2) over all patterns of the same segments that were not kept.
    """

    segments: Integers
    signs: Array
    gradient: Array
    bound: Array
    floor: Floor = field(default_factory=Floor)
    left_out: float = -np.inf

    def __len__(self) -> int:
        return len(self.bound)

    @property
    def log_mass(self) -> float:
        """Log of the sum of exp(-b / 2) over all patterns, kept or not."""
        return float(np.logaddexp(self.floor.log_mass(self.bound), self.left_out))

    def __getitem__(self, rows: Integers | Mask) -> Patterns:
        """Some of the patterns, as if they were all that had been kept."""
        return replace(self, signs=self.signs[rows], gradient=self.gradient[rows], bound=self.bound[rows])

    def beginning_with(self, decided: Integers) -> Patterns:
        """Those that agree with the signs that are decided (S,), 0 for all others."""
        wanted = decided[self.segments]
        return self[np.flatnonzero(np.all((self.signs == wanted) | (wanted == 0), axis=1))]


class Block:
    """The segments of one joint in the order in which they are decided; prepares its bounds once.

    Segments that share a part of the Hessian are never decided.

    Args:
        moments: scaled moments of all segments.
        known: those of the joint's segments whose sign is known beforehand.
        segments: the others, strongest first.
        pull: (r, r) this block's share of the pull.
    """

    def __init__(self, moments: Moments, known: Integers, segments: Integers, pull: Array) -> None:
        self.segments = segments
        self._moments = moments
        self._gradient = moments.known[known] @ moments.gradient[known]
        self._energy = float(moments.energy[known].sum()) + np.cumsum(
            np.concatenate([[0.0], moments.energy[self.segments]])
        )
        self._root = pull + moments.hessian_of(known)
        self._last = self._root
        self._bounds: list[UnconstrainedBound] = []
        self.nodes = 0

    def after(self, depth: int, pull: Array) -> Block:
        """The segments beyond `depth` as a block of their own, with another share of the pull (r, r)."""
        return Block(self._moments, self.segments[:0], self.segments[depth:], pull)

    def strong(self, share: float) -> int:
        """How many segments have at least this share of the strongest one's energy."""
        energy = self._moments.energy[self.segments]
        return int(np.sum(energy >= share * energy.max(initial=0.0)))

    def hessian(self, depth: int) -> Array:
        """(r, r) of the known and the first `depth` unknown segments, the share of the pull included."""
        return self._root + self._moments.hessian_of(self.segments[:depth])

    def energy(self, depth: int) -> float:
        """Energy of the known and the first `depth` unknown segments."""
        return float(self._energy[depth])

    def best(self, width: int, depth: int) -> Patterns:
        """The `width` best patterns that a beam finds for the first `depth` segments."""
        return self._grow(depth, None, Floor(), lambda bound, _: np.argsort(bound, kind="stable")[:width])

    def within(
        self, limit: float, depth: int, longest: int, check: Callable[[int], None], floor: Floor | None = None
    ) -> Patterns:
        """All patterns of the first `depth` segments with a bound up to `limit`, or of as many as `longest` can hold.

        The limit is higher while segments are still to come, by 2 log 2 for each: what is excluded then counts as often
        as it has completions. `check` is told at every segment how many patterns were priced; it may raise to stop the
        work.
        """

        def keep(bound: Array, to_come: int) -> Integers:
            check(len(bound))
            return np.flatnonzero(bound <= limit + 2.0 * _LOG2 * to_come)

        return self._grow(depth, longest, floor or Floor(), keep)

    def _grow(self, depth: int, longest: int | None, floor: Floor, keep: Callable[[Array, int], Integers]) -> Patterns:
        root = self._gradient[None]
        found = Patterns(self.segments[:0], np.ones((1, 0), dtype=np.int8), root, self._bound(0, root), floor)
        for d in range(1, depth + 1):
            step = self._moments.gradient[self.segments[d - 1]]
            children = np.concatenate([found.gradient + step, found.gradient - step])
            bound = self._bound(d, children)
            kept = keep(bound, depth - d)
            if longest is not None and len(kept) > longest:
                return found
            parents = kept % len(found)
            choice = np.where(kept < len(found), 1, -1).astype(np.int8)
            found = Patterns(
                self.segments[:d], np.column_stack([found.signs[parents], choice]), children[kept], bound[kept],
                floor, float(np.logaddexp(found.left_out + _LOG2, floor.log_mass(np.delete(bound, kept)))),
            )  # fmt: skip
        return found

    def _bound(self, depth: int, gradient: Array) -> Array:
        while len(self._bounds) <= depth:
            if self._bounds:
                self._last = self._last + self._moments.hessian_of(self.segments[[len(self._bounds) - 1]])
            self._bounds.append(UnconstrainedBound(self._last, 0.0))
        bound: Array = self._energy[depth] + self._bounds[depth](gradient)
        self.nodes += len(bound)
        return bound


def make_blocks(moments: Moments, pull: Array) -> list[Block]:
    """A block for every joint that has segments, each with the same share of the pull (r, r)."""
    joints = np.unique(moments.joint)
    blocks = []
    for joint in joints:
        here = np.flatnonzero(moments.joint == joint)
        known = here[moments.known[here] != 0]
        unknown = here[(moments.known[here] == 0) & moments.alone[here]]
        strongest_first = unknown[np.argsort(-moments.energy[unknown], kind="stable")]
        blocks.append(Block(moments, known, strongest_first, pull / len(joints)))
    return blocks


def join(left: Patterns, right: Patterns, hessian: Array, energy: float, keep: Keep, limit: float = np.inf) -> Patterns:
    """All pairs of patterns of two sets of segments that are kept, with the bound of their rows together.

    Args:
        left: patterns of one set of segments.
        right: patterns of another one.
        hessian: (r, r) H of both, with their shares of the pull.
        energy: c of both.
        keep: called for some pairs at a time.
        limit: pairs whose own bounds add up to more are not looked at.
    """
    unconstrained = UnconstrainedBound(hessian, 0.0)
    at_once = max(1, _AT_ONCE // max(1, len(right)))
    # Whatever one list has left out is paired with all of the other: its cost is at least the sum of their bounds.
    floor = left.floor + right.floor
    left_out = float(np.logaddexp(left.left_out + right.log_mass, left.log_mass + right.left_out))
    pairs, gradients, bounds = [np.empty(0, dtype=np.int64)], [left.gradient[:0]], [left.bound[:0]]
    for start in range(0, len(left), at_once):
        apart = (left.bound[start : start + at_once, None] + right.bound).ravel()
        hopeful = np.flatnonzero(apart <= limit)  # costs nothing
        pair = start * len(right) + hopeful
        gradient = left.gradient[pair // len(right)] + right.gradient[pair % len(right)]
        bound = np.maximum(energy + unconstrained(gradient), apart[hopeful])
        kept = keep(bound)
        gone = np.concatenate([np.delete(apart, hopeful), np.delete(bound, kept)])
        left_out = float(np.logaddexp(left_out, floor.log_mass(gone)))
        pairs.append(pair[kept])
        gradients.append(gradient[kept])
        bounds.append(bound[kept])
    pair = np.concatenate(pairs)
    return Patterns(
        np.concatenate([left.segments, right.segments]),
        np.hstack([left.signs[pair // len(right)], right.signs[pair % len(right)]]),
        np.concatenate(gradients), np.concatenate(bounds), floor, left_out,
    )  # fmt: skip


def stack(lists: list[Patterns]) -> Patterns:
    """Lists of different patterns of the same segments as one."""
    return replace(
        lists[0],
        signs=np.concatenate([one.signs for one in lists]),
        gradient=np.concatenate([one.gradient for one in lists]),
        bound=np.concatenate([one.bound for one in lists]),
        left_out=float(np.logaddexp.reduce([one.left_out for one in lists])),
    )


def log_sum(bound: Array) -> float:
    """Log of the sum of exp(-b / 2)."""
    return float(logsumexp(-0.5 * bound)) if bound.size else -np.inf
