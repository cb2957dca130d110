"""Patterns: the sign choices of one joint's segments, or of several joints', that a bound does not exclude.

The rows of one joint almost decide its own pattern. With any set D of decided segments, and without the cone,

    b(s) = min over beta of  sum over k in D of |s_k e_k - Y_k beta|^2 + a share of the pull

bounds the cost of every completion from below: the rows left out could only add to it, and so could the cone. So
patterns whose bound exceeds what can still matter are never looked at again. Segments are decided in the order of
their energy, which keeps the lists short as long as the data say anything about a sign.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from bayesid.moments import Moments
from bayesid.motion import Array, Integers
from bayesid.search.result import UnconstrainedBound

_AT_ONCE = 50_000
"""Pairs of patterns that are priced at once when two lists are joined: bounds the memory."""
_LOG2 = float(np.log(2.0))

Keep = Callable[[Array], Integers]
"""Chooses, from the bounds (m,) of the next patterns, the indices of those to keep; may raise to stop the work."""


@dataclass(frozen=True)
class Patterns:
    """m sign choices of the same decided segments, with their bounds.

    Attributes:
        segments: (d,) the decided segments.
        signs: (m, d) +1 or -1.
        gradient: (m, r) sum of s_k g_k over the decided segments and those known beforehand.
        bound: (m,) lower bounds of the cost.
        least: lower bound of what the rows of these joints cost under any signs, weaker segments included.
        left_out: log of the sum of exp(-b / 2) over all patterns of the same segments that were not kept, with b their
            bounds, or `least` where that is higher.
    """

    segments: Integers
    signs: Array
    gradient: Array
    bound: Array
    least: float = 0.0
    left_out: float = -np.inf

    def __len__(self) -> int:
        return len(self.bound)

    @property
    def log_mass(self) -> float:
        """Log of the sum of exp(-b / 2) over all patterns, kept or not."""
        return float(np.logaddexp(log_sum(np.maximum(self.bound, self.least)), self.left_out))


class Block:
    """The segments of one joint in the order in which they are decided; prepares its bounds once.

    Segments that share a part of the Hessian are never decided.

    Args:
        moments: scaled moments of all segments.
        joint: 0-based actuator.
        pull: (r, r) this block's share of the pull.
    """

    def __init__(self, moments: Moments, joint: int, pull: Array) -> None:
        here = np.flatnonzero(moments.joint == joint)
        known, unknown = here[moments.known[here] != 0], here[moments.known[here] == 0]
        self.known = known
        unknown = unknown[moments.alone[unknown]]
        self.segments: Integers = unknown[np.argsort(-moments.energy[unknown], kind="stable")]
        self._moments = moments
        self._gradient = moments.known[known] @ moments.gradient[known]
        self._energy = float(moments.energy[known].sum()) + np.cumsum(
            np.concatenate([[0.0], moments.energy[self.segments]])
        )
        self._root = pull + moments.hessian_of(known)
        self._last = self._root
        self._bounds: list[UnconstrainedBound] = []
        self.nodes = 0

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
        return self._grow(depth, None, 0.0, lambda bound: np.argsort(bound, kind="stable")[:width])

    def within(self, limit: float, depth: int, longest: int, check: Callable[[], None], least: float = 0.0) -> Patterns:
        """All patterns of the first `depth` segments with a bound up to `limit`, or of as many as `longest` can hold.

        `check` is called at every segment and may raise to stop the work.
        """

        def keep(bound: Array) -> Integers:
            check()
            return np.flatnonzero(bound <= limit)

        return self._grow(depth, longest, least, keep)

    def _grow(self, depth: int, longest: int | None, least: float, keep: Keep) -> Patterns:
        root = self._gradient[None]
        found = Patterns(self.segments[:0], np.ones((1, 0), dtype=np.int8), root, self._bound(0, root), least)
        for d in range(1, depth + 1):
            step = self._moments.gradient[self.segments[d - 1]]
            children = np.concatenate([found.gradient + step, found.gradient - step])
            bound = self._bound(d, children)
            kept = keep(bound)
            if longest is not None and len(kept) > longest:
                return found
            parents = kept % len(found)
            choice = np.where(kept < len(found), 1, -1).astype(np.int8)
            found = Patterns(
                self.segments[:d], np.column_stack([found.signs[parents], choice]), children[kept], bound[kept],
                least, float(np.logaddexp(found.left_out + _LOG2, log_sum(np.maximum(np.delete(bound, kept), least)))),
            )  # fmt: skip
        return found

    def _bound(self, depth: int, gradient: Array) -> Array:
        while len(self._bounds) <= depth:
            if self._bounds:
                self._last = self._last + self._moments.hessian_of(self.segments[[len(self._bounds) - 1]])
            self._bounds.append(UnconstrainedBound(self._last, ridge=0.0))
        bound: Array = self._energy[depth] + self._bounds[depth](gradient)
        self.nodes += len(bound)
        return bound


def join(left: Patterns, right: Patterns, hessian: Array, energy: float, keep: Keep) -> Patterns:
    """All pairs of patterns of two sets of segments that are kept, with the bound of their rows together.

    Args:
        left: patterns of one set of segments.
        right: patterns of another one.
        hessian: (r, r) H of both, with their shares of the pull.
        energy: c of both.
        keep: called for some pairs at a time.
    """
    unconstrained = UnconstrainedBound(hessian, ridge=0.0)
    at_once = max(1, _AT_ONCE // len(right))
    # Whatever one list has left out is paired with all of the other: its cost is at least the sum of their bounds.
    least = left.least + right.least
    left_out = float(np.logaddexp(left.left_out + right.log_mass, left.log_mass + right.left_out))
    pairs, gradients, bounds = [], [], []
    for start in range(0, len(left), at_once):
        gradient = (left.gradient[start : start + at_once, None] + right.gradient).reshape(-1, left.gradient.shape[1])
        bound = energy + unconstrained(gradient)
        kept = keep(bound)
        left_out = float(np.logaddexp(left_out, log_sum(np.maximum(np.delete(bound, kept), least))))
        pairs.append(start * len(right) + kept)
        gradients.append(gradient[kept])
        bounds.append(bound[kept])
    pair = np.concatenate(pairs)
    return Patterns(
        np.concatenate([left.segments, right.segments]),
        np.hstack([left.signs[pair // len(right)], right.signs[pair % len(right)]]),
        np.concatenate(gradients), np.concatenate(bounds), least, left_out,
    )  # fmt: skip


def log_sum(bound: Array) -> float:
    """Log of the sum of exp(-b / 2)."""
    return float(logsumexp(-0.5 * bound)) if bound.size else -np.inf
