"""A tilted base, and errors of single numbers in a robot's Denavit-Hartenberg table."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import product
from typing import ClassVar, Self

import numpy as np
import scipy

from bayesid.arrays import Array
from bayesid.effects.distortion import Direction, RobotDistortion
from bayesid.effects.effect import Numbers, Phrase, ReadableUnit, Scene, number
from bayesid.effects.tuning import TUNING
from bayesid.robot import Robot
from bayesid.robot.kinematics import nearest_points

_SAME = 1e-9
"""m and rad; frames nearer than this are equal up to rounding."""
_X, _ORIGIN = np.array([1.0, 0.0, 0.0]), np.zeros(3)
_MILLIMETRES, _DEGREES = ReadableUnit("mm", 1e3), ReadableUnit("degrees", 180.0 / math.pi)


class BaseTilt(RobotDistortion):
    """The base is tilted: gravity is rotated about two axes perpendicular to its nominal direction.

    The first is the base's axis furthest from gravity, made perpendicular to it; the second is perpendicular to both.
    For an upright base they are x and y. Newton-Euler with the base accelerated against gravity (Luh, Walker, Paul
    1980).

    Args:
        angle: (2,) rad, about the first and the second of these axes.
    """

    angle: Numbers = number("rad", name="tilt", tuned=True, count=2)

    name = "base_tilt"
    shown_by = "turning the first joint through its whole range with the arm stretched"
    phrase = Phrase(
        "The base is tilted by {tilt1} and {tilt2}, about two axes perpendicular to the model's gravity.",
        "a base tilt",
        units={"tilt1": _DEGREES, "tilt2": _DEGREES},
    )
    acts_on = "robot"
    typical = (0.1, 0.1, 0.5, 0.5)
    step = 1e-4
    largest = 1.0
    """rad, largest simulated tilt."""

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        yield cls(angle=(0.0, 0.0))

    @classmethod
    def guesses(cls, robot: Robot) -> Iterator[Self]:
        """Tilts by some angles about evenly spaced axes."""
        for size, turn in product(TUNING.tilts, np.linspace(0.0, 2.0 * math.pi, TUNING.tilt_axes, endpoint=False)):
            yield cls(angle=(size * math.cos(turn), size * math.sin(turn)))

    def building(self, robot: Robot) -> Robot:
        turned = scipy.spatial.transform.Rotation.from_rotvec(np.array(self.angle) @ _horizontal_axes(robot.gravity))
        return replace(robot, gravity=turned.as_matrix() @ robot.gravity)

    def change(self, scene: Scene) -> tuple[Array, Array]:
        shift, columns = super().change(scene)
        return shift, np.concatenate([columns, _weight_of_link_1(scene)], axis=2)

    def of_magnitude(self, magnitude: float, direction: Direction, scene: Scene) -> Self:
        return self.moved(magnitude * np.array([np.cos(direction.angle), np.sin(direction.angle)]))


def _weight_of_link_1(scene: Scene) -> Array:
    """(N, n, 2) sine and cosine of the first joint.

    If gravity is parallel to its axis, the weight of link 1 acts only with a tilt, so no earlier log determines it.
    Zero for other first joints.
    """
    joint, columns = scene.robot.joints[0], np.zeros((*scene.effort.shape, 2))
    along = joint.placement[:3, :3] @ joint.axis
    if not joint.prismatic and np.linalg.norm(np.cross(along, scene.robot.gravity)) < TUNING.parallel:
        columns[:, 0] = np.stack([np.sin(scene.motion.q[:, 0]), np.cos(scene.motion.q[:, 0])], axis=1)
    return columns


def _horizontal_axes(gravity: Array) -> Array:
    """(2, 3) unit axes across gravity."""
    down = gravity / (float(np.linalg.norm(gravity)) or 1.0)
    first = np.eye(3)[np.argmin(np.abs(down))]
    first = first - first @ down * down
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(first, down)])


class Displacement(RobotDistortion):
    """Base of errors of one number of a table's rows (Denavit and Hartenberg 1955).

    Args:
        error: (m,) true number minus the table's, m or rad.
    """

    error: Numbers = number(tuned=True)

    symbol: ClassVar[str]  # of the number
    of_angle: ClassVar[bool]
    of_normal: ClassVar[bool]
    """Whether it moves along or about the common normal of two axes (a, alpha), not a joint's axis (d, theta)."""
    needs_earlier = True
    of_table = True

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """One per joint, without error, except where another effect covers the number.

        `base_tilt` covers the first row of a modified table; `link_offset` the zero of a prismatic joint, its d.
        """
        for j, joint in enumerate(scene.robot.joints):
            of_base = cls.of_normal and j == 0 and not is_distal(scene.robot)
            of_offset = cls.of_angle and not cls.of_normal and joint.prismatic
            if not (of_base or of_offset):
                yield cls(joints=(j + 1,), error=(0.0,))

    def displaced(self, robot: Robot, joint: int, step: float) -> Robot:
        """The robot with the number of a (0-based) joint larger by a step, m or rad.

        d and theta move the joint along or about its axis. In the standard convention a and alpha move the end of the
        link, with its body, along or about the x axis there. In the modified convention, and without a table, they move
        the joint along or about the common normal of its axis and the previous one.
        """
        move = turn if self.of_angle else shift
        if not self.of_normal:
            return with_joint(robot, joint, move(robot.joints[joint].axis, step))
        if is_distal(robot):
            return with_link(robot, joint, move(_X, step), first=False)
        point, direction = _normal(robot, joint)
        return with_joint(robot, joint, move(direction, step, point), in_own_frame=False)

    def building(self, robot: Robot) -> Robot:
        for j, step in zip(self.acting(robot.n_joints), self.error, strict=True):
            robot = self.displaced(robot, j, step) if step else robot
        return robot

    def change(self, scene: Scene) -> tuple[Array, Array]:
        """Change of the whole effort; slopes by finite differences of the links' effort, zero if they are rounding."""
        built = self.building(scene.robot)
        here = built.inverse_dynamics(scene.motion, scene.links) if any(self.error) else scene.link_effort
        slopes = []
        for j in self.acting(scene.robot.n_joints):
            moved = self.displaced(built, j, self.step).inverse_dynamics(scene.motion, scene.links)
            slope = (moved - here) / self.step
            slope[:, np.abs(slope).max(axis=0) < 1e-8 * np.abs(scene.effort).max()] = 0.0
            slopes.append(slope)
        return self.effort(scene) - scene.nominal_effort, np.stack(slopes, axis=2)

    def numbers(self, robot: Robot) -> Mapping[str, tuple[float, str]]:
        pairs = zip(self.acting(robot.n_joints), self.error, strict=True)
        return {f"{self.symbol}{j + 1}": (float(error), "rad" if self.of_angle else "m") for j, error in pairs}

    def largest_magnitude(self, scene: Scene) -> float:
        """Largest simulated error, rad or m."""
        return 0.5 if self.of_angle else 0.1


class JointZero(Displacement):
    """Error of the table's theta: the joint was mastered in another position, or its encoder has slipped.

    Mooring, Roth, Driels, Fundamentals of Manipulator Calibration, 1991.
    """

    name = "joint_zero"
    shown_by = "moving the joints behind it slowly through their ranges, the arm stretched"
    phrase = Phrase(
        "{whose} zero is off: its true position is {zero} more than its reading.",
        "an error of the joint's zero",
        size="zero",
        opposite="{whose} zero is off: its true position is {zero} less than its reading.",
        units={"zero": _DEGREES},
    )
    typical = (math.radians(1.0),)
    symbol, of_angle, of_normal = "zero", True, False


class LinkLength(Displacement):
    """Error of the table's a: the link is longer or shorter."""

    name = "link_length"
    shown_by = "moving the joints behind the link through their ranges, fast, in several postures"
    phrase = Phrase(
        "{whose} link is {a} longer than in the robot file, if the model's masses are right.",
        "an error of a link length",
        size="a",
        opposite="{whose} link is {a} shorter than in the robot file, if the model's masses are right.",
        units={"a": _MILLIMETRES},
    )
    typical = (0.01,)
    symbol, of_angle, of_normal = "a", False, True


class LinkOffset(Displacement):
    """Error of the table's d: the link sits further along its axis."""

    name = "link_offset"
    shown_by = "moving the joints before the link through their ranges, fast, in several postures"
    phrase = Phrase(
        "{whose} link offset is {d} more than in the robot file, if the model's masses are right.",
        "an error of a link offset",
        size="d",
        opposite="{whose} link offset is {d} less than in the robot file, if the model's masses are right.",
        units={"d": _MILLIMETRES},
    )
    typical = (0.01,)
    symbol, of_angle, of_normal = "d", False, False


class LinkTwist(Displacement):
    """Error of the table's alpha: the angle between two axes differs."""

    name = "link_twist"
    shown_by = "moving the joints on both sides of the link slowly through their ranges"
    phrase = Phrase(
        "{whose} link twist is {alpha} more than in the robot file, if the model's masses are right.",
        "an error of a link twist",
        size="alpha",
        opposite="{whose} link twist is {alpha} less than in the robot file, if the model's masses are right.",
        units={"alpha": _DEGREES},
    )
    typical = (math.radians(1.0),)
    symbol, of_angle, of_normal = "alpha", True, True


# A robot with a part moved
def shift(along: Array, step: float, point: Array = _ORIGIN) -> Array:
    """(4, 4) translation by a step along a direction (3,); the point is not used."""
    move = np.eye(4)
    move[:3, 3] = step * along
    return move


def turn(about: Array, step: float, point: Array = _ORIGIN) -> Array:
    """(4, 4) rotation by a step, rad, about a unit axis (3,) through a point (3,)."""
    move = np.eye(4)
    move[:3, :3] = scipy.spatial.transform.Rotation.from_rotvec(step * about).as_matrix()
    move[:3, 3] = point - move[:3, :3] @ point
    return move


def is_distal(robot: Robot) -> bool:
    """Whether each link's frame is at the next joint: the standard Denavit-Hartenberg convention."""
    for link, joint in enumerate(robot.joints):
        following = [joint.placement for joint in robot.joints if joint.parent == link]
        at_next = all(np.allclose(joint.link_frame, placement, atol=_SAME) for placement in following)
        if at_next and not np.array_equal(joint.link_frame, np.eye(4)):
            return True
    return False


def with_joint(robot: Robot, joint: int, move: Array, *, in_own_frame: bool = True) -> Robot:
    """The robot with one joint, and all links after it, moved in its own frame or its parent's frame."""
    joints, placement = list(robot.joints), robot.joints[joint].placement
    joints[joint] = replace(joints[joint], placement=placement @ move if in_own_frame else move @ placement)
    return replace(robot, joints=tuple(joints))


def with_link(robot: Robot, link: int, move: Array, *, first: bool) -> Robot:
    """The robot with a link's frame, and the joints on it, moved in its joint's frame (first) or its own."""
    frame = robot.joints[link].link_frame
    moved = move @ frame if first else frame @ move
    joints = [
        replace(joint, placement=moved @ np.linalg.solve(frame, joint.placement)) if joint.parent == link else joint
        for joint in robot.joints
    ]
    joints[link] = replace(joints[link], link_frame=moved)
    return replace(robot, joints=tuple(joints))


def _normal(robot: Robot, joint: int) -> tuple[Array, Array]:
    """A point and the direction (3,) of the common normal of a joint's axis and its parent's, in the parent's frame.

    It points from the parent's axis to the joint's own, or along the frame's x axis if that is parallel to it.
    """
    current = robot.joints[joint]
    before = np.array([0.0, 0.0, 1.0]) if current.parent < 0 else robot.joints[current.parent].axis
    axis = current.placement[:3, :3] @ current.axis
    start, end = nearest_points(np.zeros(3), before, current.placement[:3, 3], axis)
    for direction in (end - start, np.cross(before, axis), _X - before * before[0], np.roll(before, 1)):
        if (length := float(np.linalg.norm(direction))) > _SAME:
            break
    direction = direction / length
    return start, _X if np.linalg.norm(np.cross(direction, _X)) < _SAME else direction
