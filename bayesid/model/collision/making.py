"""A robot's collision model: which shapes it has, and which pairs of them count."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.errors import InputError
from bayesid.model.collision.clearance import CollisionModel, names_of
from bayesid.model.collision.distances import Floor, Pair, PairDistances
from bayesid.model.collision.reach import Reach
from bayesid.model.collision.shapes import BASE, Shape, capsules
from bayesid.model.collision.urdf_shapes import urdf_shapes
from bayesid.model.robot import Robot

_TOUCHES = 1e-9
"""m; what touches by construction overlaps by rounding or not."""
_NAMED = 4
"""Links that a sentence names; a round number."""


@dataclass(frozen=True)
class NoShapes:
    """Why a robot has no collision model.

    Attributes:
        reason: in a few words.
    """

    reason: str


@dataclass(frozen=True)
class Capsules:
    """Capsules in place of a robot's own shapes.

    Attributes:
        radii: m, one for all links or one for each, from base to tip; the base has that of the first.
        tool: (3,) the end of what is mounted on the flange, in the last link's frame, m.
    """

    radii: float | Sequence[float]
    tool: Sequence[float] = (0.0, 0.0, 0.0)


def collision_model(
    robot: Robot,
    rest: Array,
    capsules: Capsules | None = None,
    floor: float | None = 0.0,
    folders: Sequence[str | Path] = (),
) -> CollisionModel | NoShapes:
    """The collision model of a robot: of capsules if they are given, else of its URDF.

    Args:
        robot: as `load_robot` gives it.
        rest: (n,) or (M, n) poses where the robot has been, rad or m: what overlaps there does not count.
        capsules: radii of the links; without them a robot needs a URDF that has shapes.
        floor: height of the floor over the base's origin, against gravity, m; None for no floor.
        folders: where packages of meshes are looked for first; then in ROS_PACKAGE_PATH and above the URDF.

    Returns:
        The model, or why there is none: no shapes are known, or there is nothing that could meet.

    Raises:
        InputError: radii or meshes cannot be used, or a link is below the floor where the robot has been.
    """
    if capsules is not None:
        shapes, source = _capsules(robot, capsules)
    elif robot.origin is None or robot.origin.urdf is None:
        return NoShapes(f"robot {robot.name} is no URDF: the shapes of its links are not known")
    else:
        shapes, source = _from_urdf(robot, folders)
    if not shapes:
        return NoShapes(f"the URDF of robot {robot.name} has no collision shapes")
    return _model(robot, shapes, source, np.atleast_2d(rest), floor)


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


def _model(
    robot: Robot, shapes: list[Shape], source: str, rest: Array, height: float | None
) -> CollisionModel | NoShapes:
    floor = None if height is None else Floor(_up(robot), height)
    reach = Reach(robot, _up(robot))
    apart = [pair for pair in combinations(shapes, 2) if not _adjacent(robot, *pair)]
    touching: Mask = np.array([_always_touch(reach, *pair) for pair in apart], dtype=bool)
    pairs: list[Pair] = [pair for pair, touches in zip(apart, touching, strict=True) if not touches]
    n_links = len(pairs)
    pairs += [] if floor is None else [(shape, None) for shape in shapes if shape.body != BASE]
    overlap = _overlaps(PairDistances(robot, pairs, floor), rest)
    if floor is not None:
        _check_floor(robot, pairs[n_links:], overlap[n_links:], floor.height)
    kept = [pair for pair, depth in zip(pairs, overlap, strict=True) if depth <= 0.0]
    if not kept:
        return NoShapes("no two of the robot's links, nor one and the floor, can meet that are not always together")
    return CollisionModel(
        source + _of_floor(robot, floor),
        _named(kept),
        _named(pair for pair, depth in zip(pairs, overlap, strict=True) if depth > 0.0),
        _named(pair for pair, touches in zip(apart, touching, strict=True) if touches),
        tuple(kept),
        PairDistances(robot, kept, floor),
        reach,
        np.array([joint.prismatic for joint in robot.joints]),
    )


def _up(robot: Robot) -> Array:
    """(3,) unit vector against gravity in the base's frame; its z where there is no gravity."""
    size = float(np.linalg.norm(robot.gravity))
    return -robot.gravity / size if size > 0.0 else np.array([0.0, 0.0, 1.0])


def _of_floor(robot: Robot, floor: Floor | None) -> str:
    if floor is None:
        return ", no floor"
    if np.allclose(floor.up, [0.0, 0.0, 1.0]):
        return f", floor at z = {floor.height:g} m"
    return f", floor {floor.height:g} m above the base's origin, against gravity"


def _adjacent(robot: Robot, one: Shape, other: Shape) -> bool:
    """Whether two shapes are of one body, or of two that share a joint."""
    a, b = one.body, other.body
    return a == b or (a != BASE and robot.joints[a].parent == b) or (b != BASE and robot.joints[b].parent == a)


def _always_touch(reach: Reach, one: Shape, other: Shape) -> bool:
    """Whether two capsules touch in every pose: no pose makes the way from line to line by the joints between them
    longer, and the radii reach over it."""
    plain = one.solid is None and other.solid is None
    return plain and reach.way(one, other) <= one.radius + other.radius + _TOUCHES


def _overlaps(distances: PairDistances, rest: Array) -> Array:
    """(P,) m by which pairs overlap in a pose at most; not above zero of those that never do."""
    found, frames = distances.bounds(rest)
    distances.refine(found, frames, found < _TOUCHES)
    deepest: Array = -found.min(axis=0, initial=np.inf)
    return np.where(deepest > -_TOUCHES, np.maximum(deepest, _TOUCHES), deepest)


def _check_floor(robot: Robot, pairs: Sequence[Pair], overlap: Array, height: float) -> None:
    """Refuses a floor above which not all links have been that do not stand on it.

    Raises:
        InputError: a link was below it that another link carries.
    """
    for (shape, _), depth in zip(pairs, overlap, strict=True):
        if depth > _TOUCHES and robot.joints[shape.body].parent != BASE:
            said = f"{shape.name} is {depth:.3f} m below the floor in a pose where the robot has been"
            remedy = f"give the floor's height over the base's origin, at most {height - depth:.2f}, or none"
            raise InputError(said, f"--floor {height:g}", remedy + ", or narrower capsules")


def _named(pairs: Iterable[Pair]) -> tuple[tuple[str, str], ...]:
    """The links of pairs of shapes, each pair once."""
    return tuple(dict.fromkeys(names_of(pair) for pair in pairs))
