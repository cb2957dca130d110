"""Forward kinematics: joint frames, the flange, the skeleton to draw, the reach."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import ArrayLike

from bayesid.arrays import Array, frozen
from bayesid.errors import InputError
from bayesid.robot import Robot
from bayesid.robot.tuning import TUNING


@dataclass(frozen=True)
class Pose:
    """A robot at joint positions q (n,), rad (m); lengths in m, frames in the base frame."""

    robot: Robot
    q: Array

    @cached_property
    def joint_frames(self) -> Array:
        """(n, 4, 4) frames of the joints at q."""
        return self.robot.joint_frames(self.q)

    @cached_property
    def axes(self) -> Array:
        """(n, 3) unit axes of the joints."""
        local_axes = np.stack([joint.axis for joint in self.robot.joints])
        return np.einsum("nij,nj->ni", self.joint_frames[:, :3, :3], local_axes)

    @property
    def flange(self) -> Array:
        """(4, 4) frame of the last link: the flange, if the robot's table or file ends there."""
        last = self.robot.joints[-1]
        frame: Array = self.joint_frames[-1] @ last.link_frame
        return frame if last.tip is None else frame @ last.tip

    @cached_property
    def lines(self) -> tuple[Array, ...]:
        """(4, 3) points from the parent to each joint, and (3, 3) from the last joint to the flange, as in DH tables.

        The points are the parent's origin (the base's for the first joint), the nearest points of the parent's and the
        joint's axes, and the joint's origin. To the flange: the last origin, the nearest point of its axis, the flange.
        """
        origins, lines = self.joint_frames[:, :3, 3], []
        for i, joint in enumerate(self.robot.joints):
            start = np.zeros(3) if joint.parent < 0 else origins[joint.parent]
            along = self.axes[i if joint.parent < 0 else joint.parent]
            lines.append(np.stack([start, *nearest_points(start, along, origins[i], self.axes[i]), origins[i]]))
        end, flange = origins[-1], self.flange[:3, 3]
        return (*lines, np.stack([end, end + self.axes[-1] * (self.axes[-1] @ (flange - end)), flange]))

    @property
    def joint_points(self) -> Array:
        """(n, 3) the third points of `lines`: on each joint's axis, nearest to the previous axis."""
        return np.stack([line[2] for line in self.lines[:-1]])


def nearest_points(start: Array, along: Array, end: Array, axis: Array) -> tuple[Array, Array]:
    """Nearest points of two lines; for parallel lines the first is its given point."""
    normal = np.cross(along, axis)
    size, between = float(normal @ normal), end - start
    if size < TUNING.parallel_axes**2:
        return start, end - axis * (axis @ between)
    first, second = np.cross(between, axis) @ normal / size, np.cross(between, along) @ normal / size
    return start + along * first, end + axis * second


def pose(robot: Robot, q: ArrayLike | None = None) -> Pose:
    """The robot at joint positions (n,), rad (m), by default at zero; InputError if these are not n finite numbers."""
    try:
        positions = frozen(np.zeros(robot.n_joints) if q is None else q, (robot.n_joints,), "q")
    except (TypeError, ValueError):
        remedy = f"give {robot.n_joints} finite numbers, one per joint"
        raise InputError(f"are not joint positions of {robot.name}", field="q", remedy=remedy) from None
    return Pose(robot, positions)


def reach(robot: Robot, joint: int | None = None) -> float:
    """Largest distance of the flange from the first joint's axis, m, without joint limits; prismatic joints stay at 0.

    With `joint`, from 1, that joint's origin replaces the flange. Data sheets usually give joint 5 of 6, the wrist.

    >>> from bayesid.robot import load_robot
    >>> round(reach(load_robot("kr6r900"), joint=5), 4)
    0.9015
    """
    free = np.array([not each.prismatic for each in robot.joints])
    free[0] = False
    rng = np.random.default_rng(0)
    starts = rng.uniform(-np.pi, np.pi, (TUNING.reach_starts, int(free.sum())))

    def shortfall(values: Array) -> tuple[float, Array]:
        """Minus half the squared distance, and its slope: a joint moves the point along axis x arm."""
        q = np.zeros(robot.n_joints)
        q[free] = values
        here = Pose(robot, q)
        point = here.flange[:3, 3] if joint is None else here.joint_frames[joint - 1, :3, 3]
        arm = point - here.joint_frames[0, :3, 3]
        away = arm - here.axes[0] * (here.axes[0] @ arm)
        moved_by = np.isin(np.arange(robot.n_joints), robot.to_base((joint or robot.n_joints) - 1))
        slopes = np.cross(here.axes, point - here.joint_frames[:, :3, 3]) @ away
        return -0.5 * float(away @ away), -(slopes * moved_by)[free]

    if not free.any():
        return float(np.sqrt(-2.0 * shortfall(starts[0])[0]))
    return float(np.sqrt(-2.0 * min(scipy.optimize.minimize(shortfall, start, jac=True).fun for start in starts)))
