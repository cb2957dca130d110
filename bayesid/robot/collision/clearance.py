"""A robot's distance from itself and from the floor, in poses and on whole paths; which pairs of shapes count."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.errors import InputError
from bayesid.robot import Robot
from bayesid.robot.collision.distances import FLOOR, Floor, Pair, PairDistances, Reach
from bayesid.robot.collision.shapes import BASE, Shape, capsules, urdf_shapes

FINEST = 1e-3
"""m; how far distances may change in the shortest part of a path that is looked at. A path that keeps so little more
than what is asked for counts as not clear; a tenth of the margin of a centimetre that robots are given."""
ACCURACY = 1e-5
"""m that a computed distance may be too long: ten times the tolerance of coal's iterations, and what the closed form
loses between lines that are almost parallel."""


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
        """Pairs of which parts do not count, and why, in sentences."""
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
        """
        return self._distances.least(np.asarray(q, dtype=float))[0]

    def nearest(self, q: Array) -> tuple[float, tuple[str, str]]:
        """The least distance of a pose, m, and its pair.

        Args:
            q: (n,) positions of the joints, rad or m.
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
        travel = np.where(self._slides, 0.125 * np.ceil(travel / 0.125), 0.0)  # rounded up: few tables are made
        key = travel.tobytes()
        if key not in self._rates:
            self._rates[key] = self._reach.rates(self._shapes, travel)
        return self._rates[key]


def _split(middle: Array, half: Array, change: Array, unsure: Mask) -> list[tuple[Array, Array, Array, Mask]]:
    """Intervals in parts that are looked at together, the first of them last; few enough for the memory."""
    parts = [slice(k, k + 256) for k in range(0, len(middle), 256)]
    return [(middle[part], half[part], change[part], unsure[part]) for part in parts[::-1]]


def names_of(pair: Pair) -> tuple[str, str]:
    """The links of a pair of shapes."""
    one, other = pair
    return one.name, FLOOR if other is None else other.name


@dataclass(frozen=True)
class NoShapes:
    """Why a robot has no collision model.

    Attributes:
        reason: in a few words.
        too_near: whether there are links that could meet, but nearer to each other than the margin anyway.
    """

    reason: str
    too_near: bool = False


@dataclass(frozen=True)
class Capsules:
    """Capsules in place of a robot's own shapes.

    Attributes:
        radii: m, one for all links or one for each, from base to tip; the base has that of the first.
        tool: (3,) the end of what is mounted on the flange, in the last link's frame, m.

    Example:
        >>> bayesid.Capsules(0.05).tool
        (0.0, 0.0, 0.0)
    """

    radii: float | Sequence[float]
    tool: Sequence[float] = (0.0, 0.0, 0.0)


def collision_model(
    robot: Robot,
    rest: Array,
    capsules: Capsules | None = None,
    floor: float | None = 0.0,
    margin: float = 0.01,
    folders: Sequence[str | Path] = (),
) -> CollisionModel | NoShapes:
    """The collision model of a robot: of capsules if they are given, else of its URDF.

    Args:
        robot: as `load_robot` gives it.
        rest: (n,) or (M, n) poses where the robot has been, rad or m: what is too near there does not count.
        capsules: radii of the links; without them a robot needs a URDF that has shapes.
        floor: height of the floor over the base's origin, against gravity, m; None for no floor.
        margin: m that the motion shall keep from all that counts; links that never keep it, or did not where the robot
            has been, do not count.
        folders: where packages of meshes are looked for first; then in ROS_PACKAGE_PATH and above the URDF.

    Returns:
        The model, or why there is none: no shapes are known, or there is nothing that could meet.

    Raises:
        InputError: radii or meshes cannot be used; or a link was below the floor, or nearer to it than the margin,
            where the robot has been; or all that could meet is nearer than the margin anyway, so that capsules tell
            nothing.

    Example:
        >>> shapes = bayesid.collision_model(robot, motion.q[::20], bayesid.Capsules(0.03), floor=None)
        >>> run = bayesid.RunSettings(clearance=shapes)
    """
    if capsules is not None:
        shapes, source = _capsules(robot, capsules)
    elif robot.origin is None or robot.origin.urdf is None:
        return NoShapes(f"robot {robot.name} is no URDF: the shapes of its links are not known")
    else:
        shapes, source = _from_urdf(robot, folders)
    if not shapes:
        return NoShapes(f"the URDF of robot {robot.name} has no collision shapes")
    found = _Making(robot, shapes, np.atleast_2d(rest), floor, margin).model(source)
    if isinstance(found, NoShapes) and found.too_near and capsules is not None:
        raise InputError(
            found.reason, field="capsules", remedy="give narrower ones or a smaller `margin`, or leave it out"
        )
    return found


def _capsules(robot: Robot, given: Capsules) -> tuple[list[Shape], str]:
    radii = np.unique(np.asarray(given.radii, dtype=float))
    shapes = capsules(robot, given.radii, given.tool)
    between = f"{radii[0]:g}" if len(radii) == 1 else f"{radii[0]:g} to {radii[-1]:g}"
    return shapes, f"capsules of {between} m about the lines between the joints"


def _from_urdf(robot: Robot, folders: Sequence[str | Path]) -> tuple[list[Shape], str]:
    assert robot.origin is not None
    assert robot.origin.urdf is not None
    shapes = urdf_shapes(robot.origin, robot.n_joints, folders)
    bodies = {shape.body for shape in shapes}
    bare = [joint.name for k, joint in enumerate(robot.joints) if k not in bodies]
    more = f" and {len(bare) - 4} more" if len(bare) > 4 else ""
    without = f"; none on joint{'s' * (len(bare) > 1)} {', '.join(bare[:4])}{more}" if bare else ""
    return shapes, f"collision shapes of {robot.origin.urdf.name} (of meshes the convex hulls){without}"


class _Making:
    """Which pairs of shapes count, where a robot has been in poses `rest` (M, n)."""

    def __init__(self, robot: Robot, shapes: list[Shape], rest: Array, height: float | None, margin: float) -> None:
        self._robot, self._rest, self._margin = robot, rest, margin
        self._floor = None if height is None else Floor(_up(robot), height)
        self._reach = Reach(robot, _up(robot))
        pairs: list[Pair] = [pair for pair in combinations(shapes, 2) if not _adjacent(robot, *pair)]
        pairs += [] if height is None else [(shape, None) for shape in shapes if shape.body != BASE]
        self._together = [pair for pair in pairs if self._never_part(*pair)]
        self._apart = [pair for pair in pairs if pair not in self._together]

    def model(self, source: str) -> CollisionModel | NoShapes:
        """The model."""
        distances = PairDistances(self._robot, self._apart, self._floor)
        least, frames = distances.bounds(self._rest)
        distances.refine(least, frames, least < self._margin)
        nearest = least.min(axis=0, initial=np.inf)
        wide = [pair for pair, distance in zip(self._apart, nearest, strict=True) if distance < self._margin]
        self._check_floor(nearest)
        moves: Mask = np.any(self._reach.rates(self._apart, np.ones(self._robot.n_joints)), axis=1)
        kept = [pair for pair, one_moves in zip(self._apart, moves, strict=True) if one_moves and pair not in wide]
        if not kept and (wide or self._together):
            near = f"all distances are less than {self._margin:g} m, in every pose or where the robot has been"
            return NoShapes(near, too_near=True)
        if not kept:
            return NoShapes("the robot has no two links, nor one and the floor, whose distance could tell anything")
        return CollisionModel(
            source + _of_floor(self._floor),
            self._margin,
            _named(kept),
            _named(wide),
            _named(self._together),
            tuple(kept),
            PairDistances(self._robot, kept, self._floor),
            self._reach,
            np.array([joint.prismatic for joint in self._robot.joints]),
        )

    def _never_part(self, one: Shape, other: Shape | None) -> bool:
        """Whether no pose takes two capsules as far apart as the margin."""
        if one.solid is not None or (other is not None and other.solid is not None):
            return False
        height = 0.0 if self._floor is None else self._floor.height
        return self._reach.ceiling(one, other, height) <= self._margin + 1e-9  # rounding

    def _check_floor(self, nearest: Array) -> None:
        """Refuses a floor that does not fit to where the robot has been: only what the base carries may stand on it.

        Raises:
            InputError: another link was below it, or nearer to it than the margin.
        """
        on_others = (pair[1] is None and self._robot.joints[pair[0].body].parent != BASE for pair in self._apart)
        carried: Mask = np.array([*on_others], dtype=bool)
        distance = float(nearest.min(where=carried, initial=np.inf))
        if self._floor is None or distance >= self._margin:
            return
        lowest = int(np.argmin(np.where(carried, nearest, np.inf)))
        height, lower = self._floor.height, np.floor(100.0 * (self._floor.height + distance - self._margin)) / 100.0
        side = "below" if distance < 0.0 else "above"
        said = f"{self._apart[lowest][0].name} is {abs(distance):.3f} m {side} the floor where the robot has been"
        remedy = f"give the floor's height over the base's origin, {lower:g} or less, or none, or narrower capsules"
        raise InputError(said, f"{height:g}", remedy, field="floor")


def _up(robot: Robot) -> Array:
    """(3,) unit vector against gravity in the base's frame; its z where there is no gravity."""
    size = float(np.linalg.norm(robot.gravity))
    return -robot.gravity / size if size > 0.0 else np.array([0.0, 0.0, 1.0])


def _of_floor(floor: Floor | None) -> str:
    if floor is None:
        return ", no floor"
    if np.allclose(floor.up, [0.0, 0.0, 1.0]):
        return f", floor at z = {floor.height:g} m"
    return f", floor {floor.height:g} m above the base's origin, against gravity"


def _adjacent(robot: Robot, one: Shape, other: Shape) -> bool:
    """Whether two shapes are of one body, or of two that share a joint."""
    a, b = one.body, other.body
    return a == b or (a != BASE and robot.joints[a].parent == b) or (b != BASE and robot.joints[b].parent == a)


def _named(pairs: Iterable[Pair]) -> tuple[tuple[str, str], ...]:
    """The links of pairs of shapes, each pair once."""
    return tuple(dict.fromkeys(names_of(pair) for pair in pairs))
