"""How efforts change with the robot's geometry: derivatives by the place of every joint."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from bayesid.arrays import Array
from bayesid.model.robot import Joint, Robot
from bayesid.motion import Motion

KINEMATICS: tuple[str, tuple[int, ...]] = ("kinematics", ())
"""Where effects are named: the robot's geometry."""
_STEP = 1e-5
"""m and rad, of the central differences: their error is its square, and rounding 1e-10 of the effort."""


@dataclass(frozen=True, kw_only=True)
class KinematicTolerance:
    """How far a robot's geometry may be from its table, as standard deviations.

    Attributes:
        length: m, of each joint's place.
        angle: rad, of each joint's direction.
    """

    length: float = 1e-3
    angle: float = float(np.deg2rad(0.1))

    def __post_init__(self) -> None:
        if not (np.isfinite(self.length) and np.isfinite(self.angle) and min(self.length, self.angle) >= 0.0):
            raise ValueError(f"a kinematic tolerance of {self.length:g} m, {self.angle:g} rad")


def kinematic_columns(
    robot: Robot, motion: Motion, links: Array, tolerance: KinematicTolerance, first: int = 0
) -> Array:
    """(N, n, 6 (n - first)) efforts of one standard deviation of each joint's place and direction, N m.

    Args:
        robot: as its table has it.
        motion: N samples.
        links: (10 n,) parameters of the links.
        tolerance: the standard deviations.
        first: joint (0-based) whose place may be off, as may those after it.
    """
    columns = []
    for i in range(first, robot.n_joints):
        for k in range(6):
            sd = tolerance.length if k < 3 else tolerance.angle
            if sd == 0.0:
                continue
            there, back = (_displaced(robot, i, k, step).inverse_dynamics(motion, links) for step in (_STEP, -_STEP))
            columns.append(sd * (there - back) / (2.0 * _STEP))
    return np.stack(columns, axis=2) if columns else np.zeros((len(motion), robot.n_joints, 0))


def _displaced(robot: Robot, joint: int, axis: int, step: float) -> Robot:
    """The robot with one joint shifted (axes 0 to 2) or turned (3 to 5) along an axis of its own frame."""
    move, along = np.eye(4), step * np.eye(3)[axis % 3]
    if axis < 3:
        move[:3, 3] = along
    else:
        move[:3, :3] = Rotation.from_rotvec(along).as_matrix()
    joints: list[Joint] = list(robot.joints)
    joints[joint] = replace(joints[joint], placement=joints[joint].placement @ move)
    return replace(robot, joints=tuple(joints))
