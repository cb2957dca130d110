"""Parts of a robot moved along or about a line: what a wrong number of its Denavit-Hartenberg table does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from bayesid.arrays import Array
from bayesid.robot import Joint, Robot
from bayesid.robot.kinematics import nearest_points

_SAME = 1e-9
"""m and rad up to which two frames are one: rounding."""


def shift(along: Array, step: float) -> Array:
    """(4, 4) a step along a direction (3,)."""
    move = np.eye(4)
    move[:3, 3] = step * along
    return move


def turn(about: Array, step: float, point: Array | None = None) -> Array:
    """(4, 4) a turn about a unit axis (3,) through a point (3,), the origin by default."""
    move = np.eye(4)
    move[:3, :3] = scipy.spatial.transform.Rotation.from_rotvec(step * about).as_matrix()
    if point is not None:
        move[:3, 3] = point - move[:3, :3] @ point
    return move


def ends_at_next(robot: Robot, link: int) -> bool:
    """Whether a link's frame is not its joint's, but where the next joint stands, if there is one."""
    frame = robot.joints[link].link_frame
    following = [joint.placement for joint in robot.joints if joint.parent == link]
    return not np.array_equal(frame, np.eye(4)) and all(np.allclose(frame, p, atol=_SAME) for p in following)


def is_distal(robot: Robot) -> bool:
    """Whether links have their frames where the next joint stands: the standard Denavit-Hartenberg convention."""
    return any(ends_at_next(robot, i) for i in range(robot.n_joints))


def with_joint(robot: Robot, joint: int, move: Array, *, own: bool = True) -> Robot:
    """The robot with one joint, and what it carries, moved in its own frame or the frame that it stands in."""
    joints: list[Joint] = list(robot.joints)
    placement = joints[joint].placement
    joints[joint] = replace(joints[joint], placement=placement @ move if own else move @ placement)
    return replace(robot, joints=tuple(joints))


def with_link(robot: Robot, link: int, move: Array, *, first: bool) -> Robot:
    """The robot with a link's frame moved, in its joint's frame (first) or its own; and with it what stands there."""
    frame = robot.joints[link].link_frame
    moved = move @ frame if first else frame @ move
    joints = [
        replace(joint, placement=moved @ np.linalg.solve(frame, joint.placement)) if joint.parent == link else joint
        for joint in robot.joints
    ]
    joints[link] = replace(joints[link], link_frame=moved)
    return replace(robot, joints=tuple(joints))


def along_axis(robot: Robot, joint: int, step: float, *, turning: bool) -> Robot:
    """The robot with a (0-based) joint's d (m) or theta (rad) larger by a step: its link moved along or about its axis.

    In the row of a joint that slides, d is its position.
    """
    axis = robot.joints[joint].axis
    return with_joint(robot, joint, turn(axis, step) if turning else shift(axis, step))


def along_normal(robot: Robot, joint: int, step: float, *, turning: bool) -> Robot:
    """The robot with the a (m) or alpha (rad) of a (0-based) joint's row larger by a step.

    In the standard convention what stands at the end of its link moves along or about the x axis there, the link's
    body with it. In the modified one, and where a robot has no table, the joint itself moves, along or about the common
    normal of its axis and that of the joint before.
    """
    if is_distal(robot):
        x = np.array([1.0, 0.0, 0.0])
        return with_link(robot, joint, turn(x, step) if turning else shift(x, step), first=False)
    point, direction = _normal(robot, joint)
    move = turn(direction, step, point) if turning else shift(direction, step)
    return with_joint(robot, joint, move, own=False)


def _normal(robot: Robot, joint: int) -> tuple[Array, Array]:
    """A point (3,) and the direction (3,) of the common normal of a joint's axis and that before, in that one's frame.

    It leads from the axis before to the joint's own; or along that frame's x axis, as in a table, where x lies on it.
    """
    one, x = robot.joints[joint], np.array([1.0, 0.0, 0.0])
    before = np.array([0.0, 0.0, 1.0]) if one.parent < 0 else robot.joints[one.parent].axis
    axis = one.placement[:3, :3] @ one.axis
    start, end = nearest_points(np.zeros(3), before, one.placement[:3, 3], axis)
    for direction in (end - start, np.cross(before, axis), x - before * before[0], np.roll(before, 1)):
        if (length := float(np.linalg.norm(direction))) > _SAME:
            break
    direction = direction / length
    return start, x if np.linalg.norm(np.cross(direction, x)) < _SAME else direction
