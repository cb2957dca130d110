"""Distances of many pairs of shapes in many poses, and how fast they can change.

Capsules have distances in closed form; what lies within them is asked of coal, as seldom as an answer needs.

Where one joint alone moves, one of two bodies turns about its axis as seen from the other. No point moves faster than
its distance from the axis times the joint's speed, and neither does the distance between the bodies change; it makes no
difference which of them is held to move, so that the nearer one's reach counts. A joint that slides has 1. The sum over
the joints between the bodies bounds what all of them do together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np

from bayesid.arrays import TINY, Array, Mask
from bayesid.robot import Robot
from bayesid.robot.collision.shapes import BASE, Shape

Pair = tuple[Shape, Shape | None]
"""Two shapes, or a shape and the floor."""
FLOOR = "floor"
"""Its name in a pair."""
_PARALLEL = 1e-12
"""Squared sine of an angle below which two lines count as parallel. The nearest of their ends are then off by the angle
times a length, a micrometre a metre; of lines at a larger angle, rounding leaves the crossing good to a part in 10^4,
which enters the distance squared."""


class LinkFrames:
    """Frames of a robot's links in the base's; that of the joint, not of a Denavit-Hartenberg table."""

    def __init__(self, robot: Robot) -> None:
        n = robot.n_joints
        self._parents = [joint.parent for joint in robot.joints]
        self._fixed, self._linear, self._cosine = np.zeros((3, n, 4, 4))
        for k, joint in enumerate(robot.joints):
            x, y, z = joint.axis
            cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            self._fixed[k] = joint.placement
            if joint.prismatic:
                self._linear[k, :3, 3] = joint.placement[:3, :3] @ joint.axis
            else:  # Rodrigues: 1 + sin q K + (1 - cos q) K^2
                self._fixed[k, :3, :3] = joint.placement[:3, :3] @ (np.eye(3) + cross @ cross)
                self._linear[k, :3, :3] = joint.placement[:3, :3] @ cross
                self._cosine[k, :3, :3] = -joint.placement[:3, :3] @ cross @ cross
        self._slides = np.array([joint.prismatic for joint in robot.joints])

    def __call__(self, q: Array) -> Array:
        """(N, n + 1, 4, 4) of the links, that of the base last, so that its index is -1.

        Args:
            q: (N, n) positions of the joints, rad or m.
        """
        linear = np.where(self._slides, q, np.sin(q))[:, :, None, None]
        steps = self._fixed + linear * self._linear + np.cos(q)[:, :, None, None] * self._cosine
        frames = np.empty((len(q), q.shape[1] + 1, 4, 4))
        frames[:, -1] = np.eye(4)
        for k, parent in enumerate(self._parents):
            np.matmul(frames[:, parent], steps[:, k], out=frames[:, k])
        return frames


def line_distances(starts: Array, ends: Array, one: Array, other: Array) -> Array:
    """(N, P) distances between pairs of lines, m.

    The least squared distance of two lines s and t from 0 to 1 is that where they cross, or one at an end of one of
    them (Ericson, Real-Time Collision Detection, 2005, section 5.1.9).

    Args:
        starts: (N, S, 3) of lines.
        ends: (N, S, 3) of lines.
        one: (P,) indices of lines.
        other: (P,) indices of lines.
    """
    way = ends - starts
    u, v, w = way[:, one], way[:, other], starts[:, one] - starts[:, other]
    squares = np.einsum("nsi,nsi->ns", way, way)
    uu, vv = squares[:, one], squares[:, other]
    uv, uw, vw, ww = (np.einsum("npi,npi->np", a, b) for a, b in ((u, v), (u, w), (v, w), (w, w)))
    over_u, over_v = 1.0 / np.maximum(uu, TINY), 1.0 / np.maximum(vv, TINY)

    def squared(s: Array, t: Array) -> Array:
        return ww + s * (s * uu + 2.0 * uw) + t * (t * vv - 2.0 * vw) - 2.0 * s * t * uv

    s0, s1 = np.clip(-uw * over_u, 0.0, 1.0), np.clip((uv - uw) * over_u, 0.0, 1.0)
    t0, t1 = np.clip(vw * over_v, 0.0, 1.0), np.clip((uv + vw) * over_v, 0.0, 1.0)
    least = ww + s0 * (s0 * uu + 2.0 * uw)
    np.minimum(least, squared(s1, np.ones_like(s1)), out=least)
    np.minimum(least, ww + t0 * (t0 * vv - 2.0 * vw), out=least)
    np.minimum(least, squared(np.ones_like(t1), t1), out=least)
    cross = uu * vv - uv**2
    crosses = cross > _PARALLEL * uu * vv
    over = 1.0 / np.where(crosses, cross, 1.0)
    s, t = (uv * vw - uw * vv) * over, (uu * vw - uv * uw) * over
    crosses &= (s > 0.0) & (s < 1.0) & (t > 0.0) & (t < 1.0)
    np.minimum(least, np.where(crosses, squared(s, t), least), out=least)
    return np.sqrt(np.maximum(least, 0.0))


@dataclass(frozen=True, eq=False)
class Floor:
    """What lies below a level plane: its unit normal (3,) in the base's frame, and its height along it, m."""

    up: Array
    height: float


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
    """Distances by coal."""

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
        tilts = ~self._slides & (turning > 1e-9)  # beyond rounding
        share = np.where(self._slides, np.abs(self._axes @ up), turning)
        tilted = np.array([any(tilts[j] for j in self._to_base(joint.parent)) for joint in self._robot.joints])
        return np.where(tilted, 1.0, np.where(share > 1e-9, share, 0.0))

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
