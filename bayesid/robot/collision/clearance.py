"""A robot's distance from itself and from the floor, in poses and on whole paths."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.robot.collision.distances import FLOOR, Pair, PairDistances
from bayesid.robot.collision.reach import Reach

FINEST = 1e-3
"""m; how far distances may change in the shortest part of a path that is looked at. A path that keeps so little more
than what is asked for counts as not clear; a tenth of the margin of a centimetre that robots are given."""
ACCURACY = 1e-5
"""m that a computed distance may be too long: ten times the tolerance of coal's iterations, and what the closed form
loses between lines that are almost parallel."""
_TRAVEL = 0.125
"""m; travels of sliding joints are rounded up to it, so that few tables of rates are made. Any length serves."""

_AT_ONCE = 256
"""Intervals that are looked at together: many enough for numpy, and few for the memory of a robot of many shapes."""


@dataclass(frozen=True, eq=False)
class CollisionModel:
    """The shapes of a robot's links and of the floor.

    Attributes:
        source: what the shapes are, in a sentence.
        margin: m that all distances shall keep.
        pairs: links whose distances count, and links with the floor, which is called `floor`.
        left_out: pairs nearer than the margin in a pose where the robot has been, so that their shapes are wider than
            the links: the parts that are do not count.
        inseparable: pairs of links which do not share a joint, but parts of whose capsules are nearer than the margin
            in every pose; these parts do not count.

    Example:
        >>> shapes = bayesid.collision_model(robot, motion.q[::20], bayesid.Capsules(0.03), floor=None)
        >>> shapes.source
        'capsules of 0.03 m about the lines between the joints, no floor'
    """

    source: str
    margin: float
    pairs: tuple[tuple[str, str], ...]
    left_out: tuple[tuple[str, str], ...]
    inseparable: tuple[tuple[str, str], ...]
    _shapes: tuple[Pair, ...] = field(repr=False)
    _distances: PairDistances = field(repr=False)
    _reach: Reach = field(repr=False)
    _slides: Mask = field(repr=False)
    _rates: dict[bytes, Array] = field(init=False, repr=False, default_factory=dict)

    @property
    def not_watched(self) -> tuple[str, ...]:
        """Pairs of which parts do not count, and why, in sentences.

        Example:
            >>> shapes = bayesid.collision_model(robot, motion.q[::20], bayesid.Capsules(0.03), floor=None)
            >>> shapes.not_watched
            ()
        """
        near = f"nearer than {self.margin:g} m"
        reasons = (
            (self.left_out, f"{near} where the robot has been: their shapes are wider than the links"),
            (self.inseparable, f"{near} in every pose"),
        )
        named = [(", ".join(" and ".join(pair) for pair in pairs), reason) for pairs, reason in reasons if pairs]
        return tuple(f"parts of {pairs} ({reason})" for pairs, reason in named)

    def distance(self, q: Array) -> Array:
        """(N,) the least distance of all pairs, m; below zero where they overlap.

        Args:
            q: (N, n) positions of the joints, rad or m.

        Example:
            >>> shapes = bayesid.collision_model(robot, motion.q[::20], bayesid.Capsules(0.03), floor=None)
            >>> shapes.distance(motion.q).shape  # m
            (201,)
        """
        return self._distances.least(np.asarray(q, dtype=float))[0]

    def nearest(self, q: Array) -> tuple[float, tuple[str, str]]:
        """The least distance of a pose, m, and its pair.

        Args:
            q: (n,) positions of the joints, rad or m.

        Example:
            >>> shapes = bayesid.collision_model(robot, motion.q[::20], bayesid.Capsules(0.03), floor=None)
            >>> shapes.nearest(motion.q[0])[1] in shapes.pairs
            True
        """
        distance, pair = self._distances.least(np.asarray(q, dtype=float)[None])
        return float(distance[0]), names_of(self._shapes[pair[0]])

    def stays_clear(self, path: Callable[[Array], Array], t: Array, speed: Array) -> bool:
        """Whether all distances are certainly no less than the margin, between the samples too.

        In an interval no distance changes by more than the joints' speeds times what each can move the pair; where
        the distance in its middle does not allow for that, its halves are looked at, until they move `FINEST`.

        Args:
            path: positions (M, n) of the joints at instants (M,).
            t: (K + 1,) increasing instants that bound K intervals, s.
            speed: (n,) or (K, n) bounds of the joints' speeds in the intervals, rad/s or m/s.

        Returns:
            False also where it is neither shown that they are nor that they are not.

        Example:
            >>> shapes = bayesid.collision_model(robot, motion.q[::20], bayesid.Capsules(0.03), floor=None)
            >>> shapes.stays_clear(lambda t: np.tile(motion.q[0], (len(t), 1)), np.array([0.0, 1.0]), np.zeros(3))
            True
        """
        t = np.asarray(t, dtype=float)
        middle, half = (t[1:] + t[:-1]) / 2.0, (t[1:] - t[:-1]) / 2.0
        speed = np.broadcast_to(np.abs(speed), (len(half), len(self._slides)))
        most = half[:, None] * speed
        rates = self._table((np.abs(path(middle)) + most).max(axis=0, initial=0.0))
        change, unsure = most @ rates.T, np.ones((len(half), len(rates)), dtype=bool)
        waiting = _split(middle, half, change, unsure)
        while waiting:
            middle, half, change, unsure = waiting.pop()
            distances, frames = self._distances.bounds(np.asarray(path(middle), dtype=float))
            unsure &= distances < self.margin + ACCURACY + change
            self._distances.refine(distances, frames, unsure)
            unsure &= distances < self.margin + ACCURACY + change
            if (unsure & ((distances < self.margin + ACCURACY) | (change < FINEST))).any():
                return False
            left = unsure.any(axis=1)
            half = np.repeat(half[left] / 2.0, 2)
            middle = np.repeat(middle[left], 2) + half * np.tile([-1.0, 1.0], left.sum())
            waiting += _split(
                middle, half, np.repeat(change[left] / 2.0, 2, axis=0), np.repeat(unsure[left], 2, axis=0)
            )
        return True

    def _table(self, travel: Array) -> Array:
        """(P, n) m that each joint can bring a pair nearer by, per unit of its motion."""
        travel = np.where(self._slides, _TRAVEL * np.ceil(travel / _TRAVEL), 0.0)
        key = travel.tobytes()
        if key not in self._rates:
            self._rates[key] = self._reach.rates(self._shapes, travel)
        return self._rates[key]


def _split(middle: Array, half: Array, change: Array, unsure: Mask) -> list[tuple[Array, Array, Array, Mask]]:
    """Intervals in parts that are looked at together, the first of them last."""
    parts = [slice(k, k + _AT_ONCE) for k in range(0, len(middle), _AT_ONCE)]
    return [(middle[part], half[part], change[part], unsure[part]) for part in parts[::-1]]


def names_of(pair: Pair) -> tuple[str, str]:
    """The links of a pair of shapes."""
    one, other = pair
    return one.name, FLOOR if other is None else other.name
