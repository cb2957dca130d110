"""A robot's collision model: which shapes it has, and which pairs of them count."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.errors import InputError
from bayesid.robot import Robot
from bayesid.robot.collision.clearance import CollisionModel, names_of
from bayesid.robot.collision.distances import Floor, Pair, PairDistances
from bayesid.robot.collision.reach import Reach
from bayesid.robot.collision.shapes import BASE, Shape, capsules
from bayesid.robot.collision.urdf_shapes import urdf_shapes

_ROUNDING = 1e-9
"""m, of lengths that are equal by construction."""
_NAMED = 4
"""Links that a sentence names; a round number."""


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
        raise InputError(found.reason, "--capsules", "give narrower ones or a smaller --margin, or leave it out")
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
    more = f" and {len(bare) - _NAMED} more" if len(bare) > _NAMED else ""
    without = f"; none on joint{'s' * (len(bare) > 1)} {', '.join(bare[:_NAMED])}{more}" if bare else ""
    return shapes, f"collision shapes of {robot.origin.urdf.name} (of meshes the convex hulls){without}"


class _Making:
    """Which pairs of shapes count.

    Args:
        robot: the robot.
        shapes: all of them.
        rest: (M, n) poses where the robot has been.
        height: of the floor; None for none.
        margin: m.
    """

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
        return self._reach.ceiling(one, other, height) <= self._margin + _ROUNDING

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
        raise InputError(said, f"--floor {height:g}", remedy)


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
