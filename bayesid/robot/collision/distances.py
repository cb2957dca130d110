"""Distances of many pairs of shapes in many poses, as few of them by coal as an answer needs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import coal
import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.robot import Robot
from bayesid.robot.collision.frames import LinkFrames, line_distances
from bayesid.robot.collision.shapes import Shape

Pair = tuple[Shape, Shape | None]
"""Two shapes, or a shape and the floor."""
FLOOR = "floor"
"""Its name in a pair."""


class Floor:
    """What lies below a level plane.

    Args:
        up: (3,) unit normal in the base's frame.
        height: of the plane over the base's origin along it, m.
    """

    def __init__(self, up: Array, height: float) -> None:
        self.up, self.height = up, height


class PairDistances:
    """Distances of pairs of shapes: of capsules in closed form, of what lies within capsules by coal.

    Args:
        robot: the robot.
        pairs: those with the floor last.
        floor: None where no pair is with it.
    """

    def __init__(self, robot: Robot, pairs: Sequence[Pair], floor: Floor | None) -> None:
        self._frames = LinkFrames(robot)
        self._pairs, self._floor = list(pairs), floor
        shapes = list(dict.fromkeys(shape for pair in pairs for shape in pair if shape is not None))
        index = {shape: k for k, shape in enumerate(shapes)}
        links = [(index[one], index[other]) for one, other in pairs if other is not None]
        self._one, self._other = np.array(links, dtype=int).reshape(-1, 2).T
        self._on_floor = np.array([index[one] for one, other in pairs if other is None], dtype=int)
        # the line of what slides out of a link begins in the frame of that link, before the joint
        parents = [robot.joints[shape.body].parent if shape.rod else shape.body for shape in shapes]
        self._bodies = np.array([*parents, *(shape.body for shape in shapes)], dtype=int)
        starts = [robot.joints[shape.body].placement[:3, 3] if shape.rod else shape.ends[0] for shape in shapes]
        ends = np.array([*starts, *(shape.ends[1] for shape in shapes)]).reshape(-1, 3)
        self._points = np.concatenate([ends, np.ones((len(ends), 1))], axis=1)[:, :, None]
        radii = np.array([shape.radius for shape in shapes])
        self._wide = radii[self._one] + radii[self._other]
        self._wide_on_floor = radii[self._on_floor]
        self.plain: Mask = np.array([all(x is None or x.solid is None for x in pair) for pair in pairs], dtype=bool)
        self._coal = _Coal(floor)

    def bounds(self, q: Array) -> tuple[Array, Array]:
        """(N, P) distances of the capsules, m, and the (N, n + 1, 4, 4) frames of the links."""
        frames = self._frames(q)
        starts, ends = self.lines(frames)
        between = line_distances(starts, ends, self._one, self._other) - self._wide
        if self._floor is None or not len(self._on_floor):
            return between, frames
        heights = np.minimum(starts @ self._floor.up, ends @ self._floor.up)[:, self._on_floor]
        return np.concatenate([between, heights - self._floor.height - self._wide_on_floor], axis=1), frames

    def lines(self, frames: Array) -> tuple[Array, Array]:
        """(N, S, 3) starts and ends of the shapes' lines in the base's frame, in the order of their first pairs.

        Args:
            frames: (N, n + 1, 4, 4) of the links.
        """
        starts, ends = np.split((frames[:, self._bodies, :3] @ self._points)[..., 0], 2, axis=1)
        return starts, ends

    def refine(self, distances: Array, frames: Array, which: Mask) -> None:
        """Puts the true distances in place of the capsules' where these are lower bounds and a mask (N, P) asks.

        Args:
            distances: (N, P), changed.
            frames: (N, n + 1, 4, 4) of the links.
            which: (N, P) of those that matter.
        """
        for row, k in np.argwhere(which & ~self.plain):
            distances[row, k] = self._coal.distance(self._pairs[k], frames[row])

    def least(self, q: Array) -> tuple[Array, Array]:
        """(N,) the least true distance of each pose, m, and (N,) the index of its pair."""
        distances, frames = self.bounds(q)
        if self.plain.all():
            nearest = distances.argmin(axis=1)
            return np.take_along_axis(distances, nearest[:, None], axis=1)[:, 0], nearest
        nearest = np.array([self._nearest(row, frame) for row, frame in zip(distances, frames, strict=True)], dtype=int)
        return np.take_along_axis(distances, nearest[:, None], axis=1)[:, 0], nearest

    def _nearest(self, distances: Array, frames: Array) -> int:
        """The pair of the least distance in a pose; the bounds of those that may be it become true distances."""
        best, least = 0, np.inf
        for k in np.argsort(distances):
            if distances[k] >= least:
                break
            if not self.plain[k]:
                distances[k] = self._coal.distance(self._pairs[k], frames)
            if distances[k] < least:
                best, least = int(k), distances[k]
        return best


class _Coal:
    """Distances by coal.

    Args:
        floor: None for none.
    """

    def __init__(self, floor: Floor | None) -> None:
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()
        self._half = None if floor is None else coal.Halfspace(floor.up, floor.height)
        self._solids: dict[Shape, tuple[Any, Array]] = {}

    def distance(self, pair: Pair, frames: Array) -> float:
        """Of a pair, with (n + 1, 4, 4) frames of the links, m."""
        (one, at), (other, there) = (self._placed(shape, frames) for shape in pair)
        self._result.clear()
        return float(coal.distance(one, at, other, there, self._request, self._result))

    def _placed(self, shape: Shape | None, frames: Array) -> tuple[Any, Any]:
        if shape is None:
            return self._half, coal.Transform3s()
        if shape not in self._solids:
            self._solids[shape] = solid_of(shape)
        solid, place = self._solids[shape]
        frame = frames[shape.body] @ place
        return solid, coal.Transform3s(frame[:3, :3], frame[:3, 3])


def solid_of(shape: Shape) -> tuple[Any, Array]:
    """A shape as coal has it, and its (4, 4) frame in that of its joint; not of a line that lengthens."""
    if shape.solid is not None:
        return shape.solid, shape.place
    way = shape.ends[1] - shape.ends[0]
    long = float(np.linalg.norm(way))
    place = np.eye(4)
    place[:3, 3] = shape.ends.mean(axis=0)
    if long == 0.0:
        return coal.Sphere(shape.radius), place
    z = way / long
    x = np.cross(np.eye(3)[np.abs(z).argmin()], z)
    x /= np.linalg.norm(x)
    place[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    return coal.Capsule(shape.radius, long), place
