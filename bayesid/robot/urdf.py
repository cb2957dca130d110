"""Robots from URDF files: the kinematics alone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy

from bayesid.arrays import Array
from bayesid.robot.arm import Joint, Robot
from bayesid.robot.held_joints import HeldJoints, hold_joints
from bayesid.robot.numbers import check_count
from bayesid.robot.urdf_tree import UrdfJoint, UrdfTree, read_tree


def robot_from_urdf(text: str, where: str, tip: str | None = None, hold: Mapping[str, float] | None = None) -> Robot:
    """A robot from URDF text; `continuous` joints count as revolute, and fixed links belong to their parents.

    Args:
        text: the URDF; inertias and meshes do not matter, nor limits but those of efforts.
        where: what to name in an error.
        tip: link or joint at the end of the chain that is identified; by default all chains are, but not grippers.
        hold: positions at which more joints are held, rad or m, by name.

    Raises:
        InputError: the text is not a URDF, a name is not in it, or no joint is left to identify.
    """
    tree = read_tree(text, where)
    held = hold_joints(tree, tip, hold or {}, where)
    check_count(sum(one.moves and one.name not in held.positions for one in tree.joints), where)
    joints, _ = place_links(tree, held)
    return Robot(tree.name, tuple(joints), gravity=np.array([0.0, 0.0, -9.81]), notes=held.notes)


def place_links(tree: UrdfTree, held: HeldJoints) -> tuple[list[Joint], dict[str, tuple[int, Array]]]:
    """The joints that move, and where the links are.

    Returns:
        The joints; and for each link the index of the joint that carries it, -1 for none, and its (4, 4) frame in that
        joint's.
    """
    joints: list[Joint] = []
    places: dict[str, tuple[int, Array]] = {tree.base: (-1, np.eye(4))}
    for one in tree.joints:
        parent, frame = places[one.parent]
        frame = frame @ one.origin
        if one.moves and one.name not in held.positions:
            slides, rated = one.kind == "prismatic", one.rated_effort
            joints.append(Joint(frame, one.axis, slides, parent, name=one.name, rated_effort=rated))
            places[one.child] = len(joints) - 1, np.eye(4)
        else:
            places[one.child] = parent, frame @ _displacement(one, held.positions.get(one.name, 0.0))
    return joints, places


def _displacement(joint: UrdfJoint, position: float) -> Array:
    """(4, 4) by which a joint at a position moves its child."""
    frame = np.eye(4)
    if joint.kind == "prismatic":
        frame[:3, 3] = joint.axis * position
    elif joint.moves:
        frame[:3, :3] = scipy.spatial.transform.Rotation.from_rotvec(joint.axis * position).as_matrix()
    return frame
