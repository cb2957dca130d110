"""A robot's distance from itself and from the floor, in poses and on whole paths; the checked pairs of shapes.

Pinocchio moves the shapes and coal measures the distances. The rate of a distance is bounded: if one revolute joint
moves, a body turns about its axis relative to the other, and no point is faster than its distance from the axis times
the joint's speed. Either body may count as the moving one, so the nearer one gives the bound. A prismatic joint has the
bound 1. The sum over the joints between two bodies bounds the rate of all of them together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

import numpy as np
import pinocchio as pin

from bayesid.arrays import Array, Mask
from bayesid.errors import InputError
from bayesid.robot import Robot
from bayesid.robot.shapes import BASE, Shape, capsule_shapes, floor_shape, upright, urdf_shapes

Pair = tuple[Shape, Shape]
FINEST = 1e-3
"""m; change of distance below which a part of a path is not halved again: a tenth of the default margin."""
ACCURACY = 1e-5  # m that a computed distance may be too long: ten times the tolerance of coal's iterations


@dataclass(frozen=True, eq=False)
class CollisionModel:
    """The shapes of a robot's links and of the floor.

    Attributes:
        source: description of the shapes, one sentence.
        margin: minimum distance, m.
        pairs: names of the checked pairs of links, or of a link and `floor`.
        left_out: pairs with shapes closer than the margin in a pose of the log, so wider than the links; these shapes
            are not checked.
        inseparable: pairs of links without a common joint, with capsules closer than the margin in every pose; these
            capsules are not checked.
    """

    source: str
    margin: float
    pairs: tuple[tuple[str, str], ...]
    left_out: tuple[tuple[str, str], ...]
    inseparable: tuple[tuple[str, str], ...]
    _distances: PairDistances = field(repr=False)
    _bounds: RateBounds = field(repr=False)
    _rates: dict[bytes, Array] = field(init=False, repr=False, default_factory=dict)

    @property
    def not_checked(self) -> tuple[str, ...]:
        """Pairs that are not fully checked, with the reason, as sentences."""
        near = f"nearer than {self.margin:g} m"
        reasons = (
            (self.left_out, f"{near} in the log: their shapes are wider than the links"),
            (self.inseparable, f"{near} in every pose"),
        )
        named = [(", ".join(" and ".join(pair) for pair in pairs), reason) for pairs, reason in reasons if pairs]
        return tuple(f"parts of {pairs} ({reason})" for pairs, reason in named)

    def distance(self, q: Array) -> Array:
        """(N,) least distance of all pairs in poses (N, n), m; negative if they overlap."""
        return self._distances(q).min(axis=1)

    def nearest(self, q: Array) -> tuple[float, tuple[str, str]]:
        """Least distance in a pose (n,), m, and its pair."""
        (distances,) = self._distances(np.asarray(q)[None])
        least = int(distances.argmin())
        first, second = self._distances.pairs[least]
        return float(distances[least]), (first.name, second.name)

    def stays_clear(self, path: Callable[[Array], Array], t: Array, speed: Array) -> bool:
        """Whether all distances provably keep the margin, also between the samples.

        In an interval a distance changes by at most the joints' speeds times their rates. If the distance in its middle
        does not prove the margin, its halves are tried, down to changes of `FINEST`.

        Args:
            path: positions (M, n) of the joints at instants (M,).
            t: (K + 1,) increasing instants that bound K intervals, s.
            speed: (n,) or (K, n) bounds of the joints' speeds in the intervals, rad/s or m/s.

        Returns:
            False also if neither is proven.
        """
        t = np.asarray(t, dtype=float)
        middle, half = (t[1:] + t[:-1]) / 2.0, (t[1:] - t[:-1]) / 2.0
        most = half[:, None] * np.abs(speed)
        change = most @ self._highest_rates((np.abs(path(middle)) + most).max(axis=0, initial=0.0)).T
        while len(middle):
            distances = self._distances(path(middle))
            unsure = distances < self.margin + ACCURACY + change
            if (unsure & ((distances < self.margin + ACCURACY) | (change < FINEST))).any():
                return False
            undecided = unsure.any(axis=1)
            half = np.repeat(half[undecided] / 2.0, 2)
            middle = np.repeat(middle[undecided], 2) + half * np.tile([-1.0, 1.0], undecided.sum())
            change = np.repeat(change[undecided] / 2.0, 2, axis=0)
        return True

    def _highest_rates(self, travel: Array) -> Array:
        """(P, n) highest rate of each pair's distance, m per unit of each joint's motion."""
        travel = np.where(self._bounds.slides, 0.125 * np.ceil(travel / 0.125), 0.0)  # rounded up: few are computed
        key = travel.tobytes()
        if key not in self._rates:
            self._rates[key] = self._bounds.rates(self._distances.pairs, travel)
        return self._rates[key]


@dataclass(frozen=True)
class NoShapes:
    """Why a robot has no collision model; `too_near` if all pairs are closer than the margin."""

    reason: str
    too_near: bool = False


@dataclass(frozen=True)
class Capsules:
    """Capsules in place of a robot's own shapes.

    Attributes:
        radii: m, one for all links or one per link, from base to tip; the base has that of the first.
        tool: (3,) end of the tool, in the last link's frame, m.
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
        rest: (n,) or (M, n) poses of the robot in the log, rad or m; pairs too close there are not checked.
        capsules: radii of the links; needed unless a URDF has shapes.
        floor: height of the floor above the base's origin, against gravity, m; None for no floor.
        margin: minimum distance, m; pairs that never keep it, or did not in the log, are not checked.
        folders: folders searched first for mesh packages; then ROS_PACKAGE_PATH and above the URDF.

    Returns:
        The model, or the reason for none: no shapes are known, or nothing can collide.

    Raises:
        InputError: radii or meshes cannot be used; or a link was below the floor, or nearer to it than the margin, in
            the log; or all pairs are nearer than the margin, so the capsules are too wide.
    """
    if capsules is not None:
        shapes, radii = capsule_shapes(robot, capsules.radii, capsules.tool), np.unique(capsules.radii)
        between = f"{radii[0]:g}" if len(radii) == 1 else f"{radii[0]:g} to {radii[-1]:g}"
        source = f"capsules of {between} m about the lines between the joints"
    elif robot.origin is None or robot.origin.urdf is None:
        return NoShapes(f"robot {robot.name} is not from a URDF: the shapes of its links are not known")
    else:
        shapes = urdf_shapes(robot.origin, robot.n_joints, folders)
        bare = _links_without_shapes(robot, shapes)
        source = f"collision shapes of {robot.origin.urdf.name} (convex hulls of meshes){bare}"
    if not shapes:
        return NoShapes(f"the URDF of robot {robot.name} has no collision shapes")
    size = float(np.linalg.norm(robot.gravity))
    up = -robot.gravity / size if size > 0.0 else np.array([0.0, 0.0, 1.0])
    if floor is None:
        source += ", no floor"
    elif np.allclose(up, [0.0, 0.0, 1.0]):
        source += f", floor at z = {floor:g} m"
    else:
        source += f", floor {floor:g} m above the base's origin, against gravity"
    found = _of_pairs(robot, shapes, np.atleast_2d(rest), up, floor, margin, source)
    if isinstance(found, NoShapes) and found.too_near and capsules is not None:
        remedy = "give narrower capsules or a smaller `margin`, or leave it out"
        raise InputError(found.reason, field="capsules", remedy=remedy)
    return found


def _of_pairs(
    robot: Robot, shapes: Sequence[Shape], poses: Array, up: Array, floor: float | None, margin: float, source: str
) -> CollisionModel | NoShapes:
    """The model with the pairs to check, given poses (M, n) of the log."""
    pairs = [pair for pair in combinations(shapes, 2) if not _adjacent(robot, *pair)]
    if floor is not None:
        ground = floor_shape(up, floor)
        pairs += [(shape, ground) for shape in shapes if shape.body != BASE]
    together = _never_apart(robot, pairs, margin)
    apart = [pair for pair in pairs if pair not in together]
    nearest = PairDistances(robot, apart)(poses).min(axis=0, initial=np.inf)
    wide = [pair for pair, distance in zip(apart, nearest, strict=True) if distance < margin]
    if floor is not None:
        _check_floor(robot, floor, apart, nearest, margin)
    bounds = RateBounds(robot, up)
    moves: Mask = np.any(bounds.rates(apart, np.ones(robot.n_joints)), axis=1)
    kept = [pair for pair, can_move in zip(apart, moves, strict=True) if can_move and pair not in wide]
    if not kept and (wide or together):
        near = f"all distances are less than {margin:g} m, in every pose or in the log"
        return NoShapes(near, too_near=True)
    if not kept:
        return NoShapes("the robot has no pair of links, or of a link and the floor, with a variable distance")
    distances = PairDistances(robot, kept)
    return CollisionModel(source, margin, _named(kept), _named(wide), _named(together), distances, bounds)


def _never_apart(robot: Robot, pairs: Sequence[Pair], margin: float) -> list[Pair]:
    """Pairs of capsules that keep the margin in none of many random poses."""
    round_pairs = [pair for pair in pairs if all(shape.round or shape.floor for shape in pair)]
    drawn = np.random.default_rng(0).uniform(-np.pi, np.pi, (1000, robot.n_joints))
    farthest = PairDistances(robot, round_pairs)(drawn).max(axis=0, initial=-np.inf)
    return [pair for pair, distance in zip(round_pairs, farthest, strict=True) if distance <= margin + 1e-9]


def _check_floor(robot: Robot, height: float, pairs: Sequence[Pair], nearest: Array, margin: float) -> None:
    """InputError if a link was below the floor or closer to it than the margin, except links on the base."""
    carried: Mask = np.array(
        [partner.floor and robot.joints[shape.body].parent != BASE for shape, partner in pairs], bool
    )
    distance = float(nearest.min(where=carried, initial=np.inf))
    if distance >= margin:
        return
    lowest = int(np.argmin(np.where(carried, nearest, np.inf)))
    lower = np.floor(100.0 * (height + distance - margin)) / 100.0
    side = "below" if distance < 0.0 else "above"
    what = f"{pairs[lowest][0].name} is {abs(distance):.3f} m {side} the floor in the log"
    remedy = f"give the floor's height above the base's origin, {lower:g} or less, or none, or narrower capsules"
    raise InputError(what, f"{height:g}", remedy, field="floor")


def _adjacent(robot: Robot, first: Shape, second: Shape) -> bool:
    a, b = first.body, second.body
    return a == b or (a != BASE and robot.joints[a].parent == b) or (b != BASE and robot.joints[b].parent == a)


def _named(pairs: Iterable[Pair]) -> tuple[tuple[str, str], ...]:
    return tuple(dict.fromkeys((first.name, second.name) for first, second in pairs))


def _links_without_shapes(robot: Robot, shapes: Sequence[Shape]) -> str:
    bodies = {shape.body for shape in shapes}
    bare = [joint.name for k, joint in enumerate(robot.joints) if k not in bodies]
    more = f" and {len(bare) - 4} more" if len(bare) > 4 else ""
    return f"; none on joint{'s' * (len(bare) > 1)} {', '.join(bare[:4])}{more}" if bare else ""


# ---- Distances and how fast they change ----
class PairDistances:
    """Distances of P pairs of shapes, m; negative if they overlap."""

    def __init__(self, robot: Robot, pairs: Sequence[Pair]) -> None:
        self.pairs, self._robot = tuple(pairs), robot
        self._geometry, place = pin.GeometryModel(), dict[Shape, int]()
        for shape in dict.fromkeys(shape for pair in pairs for shape in pair):
            made = pin.GeometryObject(str(len(place)), shape.body + 1, pin.SE3(shape.place), shape.solid)
            place[shape] = self._geometry.addGeometryObject(made)
        for first, second in pairs:
            self._geometry.addCollisionPair(pin.CollisionPair(place[first], place[second]))
        rods = [shape for shape in place if shape.rod]
        self._rods = [(shape.body, self._geometry.geometryObjects[place[shape]]) for shape in rods]
        self._data, self._measured = robot.pinocchio.createData(), pin.GeometryData(self._geometry)

    def __call__(self, q: Array) -> Array:
        """(N, P) in poses (N, n)."""
        found = np.empty((len(q), len(self.pairs)))
        for row, pose in zip(found, np.asarray(q, dtype=float), strict=True):
            for body, rod in self._rods:  # from the joint's zero to its position
                axis = self._robot.joints[body].axis
                rod.geometry.halfLength = 0.5 * abs(pose[body])
                rod.placement = pin.SE3(upright(axis), -0.5 * pose[body] * axis)
            pin.computeDistances(self._robot.pinocchio, self._data, self._geometry, self._measured, pose)
            row[:] = [result.min_distance for result in self._measured.distanceResults]
        return found


class RateBounds:
    """Bounds of the rates of distances; `up` (3,) is the unit normal of the floor in the base's frame."""

    def __init__(self, robot: Robot, up: Array) -> None:
        frames = robot.joint_frames(np.zeros(robot.n_joints))
        self.slides: Mask = np.array([joint.prismatic for joint in robot.joints])
        self._robot, self._at_zero = robot, np.concatenate([frames, np.eye(4)[None]])
        self._origins = frames[:, :3, 3]
        self._axes = np.array([frame[:3, :3] @ joint.axis for frame, joint in zip(frames, robot.joints, strict=True)])
        self._vertical = self._vertical_share(up)

    def _vertical_share(self, up: Array) -> Array:
        """(n,) highest share of a joint's motion along the floor's normal.

        It is below 1 if no pose tilts the joint's axis: all joints before it slide, or turn about the normal.
        """
        turning = np.linalg.norm(np.cross(self._axes, up), axis=1)
        tilts = ~self.slides & (turning > 1e-9)  # beyond rounding
        share = np.where(self.slides, np.abs(self._axes @ up), turning)
        tilted = np.array([any(tilts[j] for j in self._robot.to_base(joint.parent)) for joint in self._robot.joints])
        return np.where(tilted, 1.0, np.where(share > 1e-9, share, 0.0))

    def rates(self, pairs: Sequence[Pair], travel: Array) -> Array:
        """(P, n) highest rates of distances, m per unit of each joint's motion; `travel` (n,) bounds |q|, m."""
        travel = np.where(self.slides, np.abs(travel), 0.0)
        return np.array([self._rate(*pair, travel) for pair in pairs]).reshape(-1, len(travel))

    def _rate(self, first: Shape, second: Shape, travel: Array) -> Array:
        rate = np.zeros(len(travel))
        up, down = (self._robot.to_base(shape.body) for shape in (first, second))
        path = [k for k in up if k not in down] + [k for k in down[::-1] if k not in up]
        rate[path] = self._distances_to_axes(first, path, travel)
        if second.floor:
            rate *= self._vertical
        else:
            rate[path] = np.minimum(rate[path], self._distances_to_axes(second, path[::-1], travel)[::-1])
        for shape in (first, second):
            if shape.rod:
                rate[shape.body] = 1.0
        return rate

    def _distances_to_axes(self, shape: Shape, path: Sequence[int], travel: Array) -> Array:
        """Largest distance of a shape from the axes of the joints on a path, m; 1 for a prismatic joint."""
        frame, reaches, so_far = self._at_zero[shape.body], [], travel[shape.body] if shape.rod else 0.0
        points = shape.corners @ frame[:3, :3].T + frame[:3, 3]
        for k in path:
            to = points - self._origins[k]
            away = float(np.linalg.norm(np.cross(to, self._axes[k]), axis=1).max())
            reaches.append(1.0 if self.slides[k] else so_far + away)
            so_far += float(np.linalg.norm(to, axis=1).max()) + travel[k]
            points = self._origins[k][None]
        return np.array(reaches)
