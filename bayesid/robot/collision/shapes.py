"""Shapes of a robot's links: capsules about the lines of its kinematics, or about hulls that the capsules enclose.

Every shape has a capsule: the points within a radius of a line. Where a URDF gives a box, a cylinder or a mesh, the
capsule encloses it, its distances are lower bounds, and coal has the true ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.robot import Joint, Robot

BASE = -1
"""Index of the body that does not move, as a joint's parent."""
_SHORTEST = 1e-9
"""m; a line that is shorter is rounding."""
_WIDEST = 10.0
"""m; a radius that is larger was given in other units: no link is so wide."""


@dataclass(frozen=True, eq=False)
class Shape:
    """One shape of a link, in the frame of the joint that moves it.

    Attributes:
        name: of the link.
        body: index of the joint that moves it; `BASE` for none.
        ends: (2, 3) of the capsule's line, m.
        radius: of the capsule, m.
        solid: what coal has within the capsule; None where the capsule itself is the shape.
        place: (4, 4) frame of the solid.
        rod: whether its line begins at the joint's frame before the joint has moved: what slides out of a link.
    """

    name: str
    body: int
    ends: Array
    radius: float
    solid: Any = None
    place: Any = None
    rod: bool = False


def capsules(robot: Robot, radii: float | Sequence[float], tool: Sequence[float] = (0.0, 0.0, 0.0)) -> list[Shape]:
    """One line a link, from its joint to the next, with a radius.

    The line of a link with an offset along an axis and a length across it has a corner, as a Denavit-Hartenberg step
    has, and two capsules. The last link ends at its own frame, or at a point that is given in it.

    Args:
        robot: the robot.
        radii: m, one for all links or one for each; the base has that of the first.
        tool: (3,) the end of what is mounted, in the last link's frame, m.

    Raises:
        InputError: a radius is not positive, or there is not one for each; or the tool's end is no point.
    """
    widths, end = _widths(robot, radii), _point(tool)
    standard = any(not np.array_equal(joint.link_frame, np.eye(4)) for joint in robot.joints)
    found = []
    for body in range(BASE, robot.n_joints):
        name = "base" if body == BASE else f"link {body + 1}"
        start = _rod(robot.joints[body]) if body != BASE else None
        found += [] if start is None else [Shape(name, body, start, widths[body], rod=True)]
        lines = [line for corners in _lines(robot, body, end, standard) for line in _pieces(corners)]
        if not lines and body != BASE:
            lines = [np.zeros((2, 3))]
        found += [Shape(name, body, line, widths[max(body, 0)]) for line in lines]
    return found


def _widths(robot: Robot, radii: float | Sequence[float]) -> list[float]:
    given = [float(one) for one in np.atleast_1d(np.asarray(radii, dtype=float))]
    given = given * robot.n_joints if len(given) == 1 else given
    remedy = f"give one radius in m, or {robot.n_joints} from base to tip"
    if len(given) != robot.n_joints:
        raise InputError(f"{len(given)} radii, but {robot.n_joints} links", "--capsules", remedy)
    if not all(0.0 < one <= _WIDEST for one in given):
        raise InputError("a radius is not between 0 and 10 m", "--capsules", remedy)
    return given


def _point(tool: Sequence[float]) -> Array:
    """(3,) m."""
    point = np.asarray(tool, dtype=float)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise InputError(f"{point.size} numbers", "--tool", "give x,y,z of its end in the last link's frame, m")
    return point


def _rod(joint: Joint) -> Array | None:
    """(2, 3) the line of a joint that slides, which lengthens as it does; None of one that turns."""
    return np.zeros((2, 3)) if joint.prismatic else None


def _lines(robot: Robot, body: int, tool: Array, standard: bool) -> Iterator[Array]:
    """Corners of a link's lines, in its joint's frame."""
    here = None if body == BASE else robot.joints[body]
    children = [joint for joint in robot.joints if joint.parent == body]
    for child in children:
        far = child.placement[:3, 3]
        if child.name:  # of a URDF, whose frames sit where its author put them
            yield np.stack([np.zeros(3), far])
        elif standard and here is not None:
            yield np.stack([np.zeros(3), here.axis * (here.axis @ far), far])
        else:
            along = child.placement[:3, :3] @ child.axis
            yield np.stack([np.zeros(3), far - along * (along @ far), far])
    if here is not None and not children:
        flange = here.link_frame[:3, 3]
        end = flange + here.link_frame[:3, :3] @ tool
        yield np.stack([np.zeros(3), here.axis * (here.axis @ flange), flange, end])


def _pieces(corners: Array) -> Iterator[Array]:
    """Lines between corners that differ."""
    kept = [corners[0]]
    for corner in corners[1:]:
        if np.linalg.norm(corner - kept[-1]) > _SHORTEST:
            yield np.stack([kept[-1], corner])
            kept.append(corner)


def enclosing_capsule(points: Array) -> tuple[Array, float]:
    """(2, 3) line and radius of a capsule around points, along their longest direction.

    Its line goes through the middle of what is seen along it, and is no longer than the rounded ends need.
    """
    centre = points.mean(axis=0)
    axis = np.linalg.eigh((points - centre).T @ (points - centre))[1].T[::-1]
    seen = (points - centre) @ axis.T
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2.0
    along, across = seen[:, 0], np.linalg.norm(seen[:, 1:] - middle[1:], axis=1)
    radius = float(across.max()) + _SHORTEST
    reach = np.sqrt(radius**2 - across**2)
    low, high = (along + reach).min(), (along - reach).max()
    if low > high:  # one ball holds them all
        low = high = (low + high) / 2.0
    ends = np.array([[low, *middle[1:]], [high, *middle[1:]]])
    return centre + ends @ axis, radius
