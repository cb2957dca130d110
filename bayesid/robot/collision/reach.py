"""How fast two shapes of a robot can come nearer to each other, whatever the pose: bounds that samples are joined by.

Where one joint alone moves, one of two bodies turns about its axis as seen from the other. No point moves faster than
its distance from the axis times the joint's speed, and neither does the distance between the bodies change; it makes no
difference which of them is held to move, so that the nearer one's reach counts. A joint that slides has 1. The sum over
the joints between the bodies bounds what all of them do together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesid.arrays import Array
from bayesid.robot import Robot
from bayesid.robot.collision.frames import LinkFrames
from bayesid.robot.collision.shapes import BASE, Shape

_LEVEL = 1e-9
"""Sine of an angle that is rounding."""


class Reach:
    """Bounds of how fast distances change.

    Args:
        robot: the robot.
        up: (3,) unit normal of the floor in the base's frame.
    """

    def __init__(self, robot: Robot, up: Array) -> None:
        at_zero = LinkFrames(robot)(np.zeros((1, robot.n_joints)))[0]
        self._robot = robot
        self._slides = np.array([joint.prismatic for joint in robot.joints])
        self._origins = at_zero[:-1, :3, 3]
        self._axes = np.array([at_zero[k, :3, :3] @ joint.axis for k, joint in enumerate(robot.joints)])
        self._raised, self._up = self._raising(up), up
        self._at_zero = at_zero

    def _raising(self, up: Array) -> Array:
        """(n,) share of a joint's motion that is along the floor's normal at most.

        It is less than 1 where no pose tilts the joint's axis: all joints before it slide, or turn about the normal.
        """
        turning = np.linalg.norm(np.cross(self._axes, up), axis=1)
        tilts = ~self._slides & (turning > _LEVEL)
        share = np.where(self._slides, np.abs(self._axes @ up), turning)
        tilted = np.array([any(tilts[j] for j in self._to_base(joint.parent)) for joint in self._robot.joints])
        return np.where(tilted, 1.0, np.where(share > _LEVEL, share, 0.0))

    def between(self, one: int, other: int) -> list[int]:
        """Joints between two bodies, from the one to the other."""
        up, down = self._to_base(one), self._to_base(other)
        return [k for k in up if k not in down] + [k for k in down[::-1] if k not in up]

    def _to_base(self, body: int) -> list[int]:
        path = []
        while body != BASE:
            path.append(body)
            body = self._robot.joints[body].parent
        return path

    def ceiling(self, one: Shape, other: Shape | None, height: float) -> float:
        """What no pose makes two capsules' distance larger than, m; infinite where a joint slides.

        It is the way from line to line by the origins of the joints between them, less the radii.

        Args:
            one: a capsule.
            other: a capsule; None for the floor.
            height: of the floor, m.
        """
        path = self.between(one.body, BASE if other is None else other.body)
        if any(self._slides[k] for k in path) or one.rod or (other is not None and other.rod):
            return np.inf
        hops = float(np.linalg.norm(np.diff(self._origins[path], axis=0), axis=1).sum())
        way = self._from_line(one, path[0]) + hops - one.radius
        if other is None:
            return way + float(self._origins[path[-1]] @ self._up) - height
        return way + self._from_line(other, path[-1]) - other.radius

    def _from_line(self, shape: Shape, joint: int) -> float:
        """Distance from a joint's origin to the nearest point of a shape's line on one of its bodies, m."""
        start, end = self._line(shape)
        way, to = end - start, self._origins[joint] - start
        share = np.clip(way @ to / max(way @ way, np.finfo(float).tiny), 0.0, 1.0)
        return float(np.linalg.norm(to - share * way))

    def _line(self, shape: Shape) -> Array:
        """(2, 3) a shape's line in the base's frame at q = 0."""
        frame = self._at_zero[shape.body]
        return shape.ends @ frame[:3, :3].T + frame[:3, 3]

    def rates(self, pairs: Sequence[tuple[Shape, Shape | None]], travel: Array) -> Array:
        """(P, n) m by which the distances of pairs change at most, per unit of each joint's motion.

        Args:
            pairs: of shapes, or a shape and None for the floor.
            travel: (n,) how far from zero each sliding joint goes, m; of others any number.
        """
        travel = np.where(self._slides, np.abs(travel), 0.0)
        return np.array([self._rate(*pair, travel) for pair in pairs]).reshape(-1, len(travel))

    def _rate(self, one: Shape, other: Shape | None, travel: Array) -> Array:
        rate = np.zeros(len(travel))
        path = self.between(one.body, BASE if other is None else other.body)
        rate[path] = self._reaches(one, path, travel)
        if other is None:
            rate *= self._raised
        else:
            rate[path] = np.minimum(rate[path], self._reaches(other, path[::-1], travel)[::-1])
        for shape in (one, other):
            if shape is not None and shape.rod:
                rate[shape.body] = 1.0
        return rate

    def _reaches(self, shape: Shape, path: Sequence[int], travel: Array) -> Array:
        """How far a shape is from the axes of joints on the way from it at most, m; 1 of a joint that slides."""
        wide = shape.radius + (travel[shape.body] if shape.rod else 0.0)
        points, reaches, so_far = self._line(shape), [], 0.0
        for k in path:
            to = points - self._origins[k]
            if self._slides[k]:
                reaches.append(1.0)
            else:
                reaches.append(so_far + wide + float(np.linalg.norm(np.cross(to, self._axes[k]), axis=1).max()))
            so_far += float(np.linalg.norm(to, axis=1).max()) + travel[k]
            points = self._origins[k][None]
        return np.array(reaches)
