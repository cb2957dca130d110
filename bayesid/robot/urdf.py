"""Robots from URDF files: kinematics only, with identified joints and joints held at a position.

Bodies on held joints belong to their parents. Joints without a column in a log are detected in the file: <mimic>
joints, joints without a motor (floating, planar), fingers of a gripper and, with `tip`, joints off the chain.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from itertools import combinations

import numpy as np
import scipy

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.robot.arm import Joint, Robot, check_count, given_numbers
from bayesid.robot.tuning import TUNING
from bayesid.robot.urdf_tree import FREE, UrdfJoint, UrdfTree, read_tree

_DOWN = np.array([0.0, 0.0, -9.81])  # m/s^2
_FLANGES = "flange", "tool0", "tip", "tcp", "ee", "attachment_site"
"""Usual names of links at the end of an arm, that of ROS-Industrial first."""
_WORLD = "world"  # base link of a URDF that is bolted to the ground, by the convention of Gazebo and MoveIt


def robot_from_urdf(text: str, where: str, tip: str | None = None, hold: Mapping[str, float] | None = None) -> Robot:
    """A robot from URDF text; `continuous` joints count as revolute, and fixed links belong to their parents.

    Inertias, meshes and limits are ignored, except effort limits. `hold_joints` decides the held joints. InputError if
    the text is not a URDF, a name is not in it, or no joint remains.
    """
    return robot_from_tree(read_tree(text, where), where, tip, hold)


def robot_from_tree(
    tree: UrdfTree, where: str, tip: str | None = None, hold: Mapping[str, float] | None = None, gravity: Array = _DOWN
) -> Robot:
    """The same from a tree of joints."""
    held, notes = hold_joints(tree, tip, hold or {}, where)
    check_count(sum(joint.moves and joint.name not in held for joint in tree.joints), where)
    joints, places = place_links(tree, held)
    if (end := _flange(tree, tip, places, len(joints) - 1)) is not None:
        joints[-1] = replace(joints[-1], tip=end)
    return Robot(tree.name, tuple(joints), gravity=gravity, notes=notes)


def _flange(tree: UrdfTree, tip: str | None, places: Mapping[str, tuple[int, Array]], last: int) -> Array | None:
    """(4, 4) the flange in the last joint's frame: the tip, or the last fixed link; None if it is ambiguous.

    Of several last links, one with a usual name is used.
    """
    if tip is not None and tip in places:
        return places[tip][1] if places[tip][0] == last else None
    carrying = {joint.parent for joint in tree.joints}
    behind = [link for link, (joint, _) in places.items() if joint == last]
    named = [link for word in _FLANGES for link in behind if link.lower().endswith(word)]
    fixed = [link for link in behind if tree.above[link].kind == "fixed"]
    ends = named if named else [link for link in fixed if link not in carrying]
    return places[ends[0]][1] if named or len(ends) == 1 else None


def place_links(tree: UrdfTree, held: Mapping[str, float]) -> tuple[list[Joint], dict[str, tuple[int, Array]]]:
    """The moving joints; and for each link its joint (-1 for the base) and (4, 4) frame in that joint's.

    Held joints have a position, rad or m.
    """
    joints: list[Joint] = []
    places: dict[str, tuple[int, Array]] = {tree.base: (-1, np.eye(4))}
    for joint in tree.joints:
        parent, frame = places[joint.parent]
        frame = frame @ joint.origin
        if joint.moves and joint.name not in held:
            slides, rated = joint.kind == "prismatic", joint.rated_effort
            joints.append(Joint(frame, joint.axis, slides, parent, name=joint.name, rated_effort=rated))
            places[joint.child] = len(joints) - 1, np.eye(4)
        else:
            places[joint.child] = parent, frame @ _displacement(joint, held.get(joint.name, 0.0))
    return joints, places


def _displacement(joint: UrdfJoint, position: float) -> Array:
    """(4, 4) by which a joint at a position moves its child."""
    frame = np.eye(4)
    if joint.kind == "prismatic":
        frame[:3, 3] = joint.axis * position
    elif joint.moves:
        frame[:3, :3] = scipy.spatial.transform.Rotation.from_rotvec(joint.axis * position).as_matrix()
    return frame


def hold_joints(
    tree: UrdfTree, tip: str | None, hold: Mapping[str, float], where: str
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Positions of the held joints, rad or m, by name; and notes with the reasons, and on the base.

    Args:
        tree: the URDF.
        tip: link or joint at the end of the identified chain; None for all chains but grippers.
        hold: positions of further joints.
        where: location for errors.

    Raises:
        InputError: a name is not in the file, a <mimic> joint carries identified joints, or no joint remains.
    """
    positions = {name: _position(tree, name, value, where) for name, value in hold.items()}
    chain = None if tip is None else _chain(tree, tip, where)
    moving = [joint for joint in tree.joints if joint.moves]
    off = [] if chain is None else [joint for joint in moving if joint not in chain]
    fingers = _fingers(tree) if chain is None else []
    mimics = [joint for joint in moving if joint.leader is not None and joint not in (*off, *fingers)]
    still = (*off, *fingers, *mimics)
    positions = {joint.name: 0.0 for joint in still} | positions
    for joint in still:
        if joint.leader is not None and joint.name not in hold:
            positions[joint.name] = joint.multiplier * positions.get(joint.leader, 0.0) + joint.offset
    identified = [joint for joint in moving if joint.name not in positions]
    if not identified and (tip is None or not positions):
        but = f" but {_listed(list(positions))}, held" if positions else ""
        raise InputError(f"has no moving joint{but}", where, "give a URDF of an arm")
    if not identified:
        remedy = f"`tip` takes {_nearest(str(tip), (), _ends(tree))}"
        raise InputError(f"the chain to {tip} has no moving joint", where, remedy)
    notes = [
        _sentence([joint.name for joint in off], f"not on the chain to {tip}"),
        _sentence([joint.name for joint in fingers], "a gripper is not identified"),
        *_mimic_notes(tree, mimics, identified, where),
        _sentence([f"{name} (at {position:g})" for name, position in hold.items()], "by `hold`"),
        *_base_notes(tree, fingers),
    ]
    return positions, tuple(note for note in notes if note)


def _position(tree: UrdfTree, name: str, value: object, where: str) -> float:
    movable = [joint.name for joint in tree.joints if joint.moves]
    if name not in movable:
        raise InputError(f"has no moving joint {name!r}", where, f"`hold` takes {_nearest(name, movable)}")
    return float(given_numbers(value, (), name, "`hold`"))


def _ends(tree: UrdfTree) -> list[str]:
    return [joint.child for joint in tree.joints if joint.moves and not tree.beyond(joint)]


def _chain(tree: UrdfTree, tip: str, where: str) -> list[UrdfJoint]:
    links = [tree.base, *(joint.child for joint in tree.joints)]
    if tip in links:
        return tree.path(tip)
    if tip in tree.named:
        return tree.path(tree.named[tip].child)
    remedy = f"`tip` takes {_nearest(tip, [*links, *tree.named], _ends(tree))}"
    raise InputError(f"has no link or joint {tip!r}", where, remedy)


def _nearest(name: str, known: Sequence[str], usual: Sequence[str] = ()) -> str:
    return _some(get_close_matches(name, known, n=3) or usual or known)


def _some(names: Sequence[str]) -> str:
    most = TUNING.named_joints
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


# ---- Grippers ----
def _fingers(tree: UrdfTree) -> list[UrdfJoint]:
    """Joints of grippers: a joint with its followers, if two or more are last; and two opposed last joints."""
    found = {joint for group in _mimic_groups(tree) for joint in group}
    found |= {joint for pair in _opposed_ends(tree) for joint in pair}
    return [joint for joint in tree.joints if joint in found and joint.moves]


def _mimic_groups(tree: UrdfTree) -> Iterator[list[UrdfJoint]]:
    """Leaders with their followers, if no other joint moves beyond them; a single end may be the arm's."""
    for leader in tree.joints:
        group = [leader, *(joint for joint in tree.joints if joint.leader == leader.name)]
        ends = [joint for joint in group if not tree.beyond(joint)]
        alone = all(other in group for joint in group for other in tree.beyond(joint))
        if leader.moves and alone and len(ends) > 1:
            yield group


def _opposed_ends(tree: UrdfTree) -> Iterator[tuple[UrdfJoint, UrdfJoint]]:
    """Pairs of last joints of one kind on a moving body, with opposite axes."""
    ends: dict[tuple[str, bool], list[tuple[UrdfJoint, Array]]] = {}
    for joint in tree.joints:
        if joint.moves and joint.leader is None and not tree.beyond(joint):
            body, frame = tree.body(joint.parent)
            axis = (frame @ joint.origin)[:3, :3] @ joint.axis
            ends.setdefault((body, joint.kind == "prismatic"), []).append((joint, axis))
    for (body, _), joints in ends.items():
        for (first, along), (second, against) in combinations(joints, 2):
            if body != tree.base and np.allclose(along, -against, atol=TUNING.opposed):
                yield first, second


# ---- Notes ----
def _mimic_notes(
    tree: UrdfTree, mimics: Sequence[UrdfJoint], identified: Collection[UrdfJoint], where: str
) -> list[str]:
    """Notes on <mimic> joints; InputError if one follows an identified joint and carries another."""
    names = [joint.name for joint in identified]
    dragged = [joint for joint in mimics if joint.leader in names]
    for joint in dragged:
        if carried := [other.name for other in tree.beyond(joint) if other in identified]:
            what = f"follows joint {joint.leader} (<mimic>) and carries {_listed(carried)}"
            raise InputError(what, f"{where}, joint {joint.name}", "choose a chain that ends before it with `tip`")
    still = _sentence([joint.name for joint in mimics if joint not in dragged], "mimic joints are not identified")
    detached = (
        f"joint {joint.name} is held: in the model it does not follow joint {joint.leader}" for joint in dragged
    )
    return [still, *detached]


def _base_notes(tree: UrdfTree, fingers: Collection[UrdfJoint]) -> list[str]:
    notes, chains = [], 0
    for joint in tree.joints:
        grounded = tree.body(joint.parent)[0] == tree.base
        chains += grounded and joint.moves and joint not in fingers and joint.leader is None
        if joint.kind in FREE:
            to = "the ground" if grounded else joint.parent
            notes.append(f"joint {joint.name} is {joint.kind}: {joint.child} is assumed to be fixed to {to}")
    if chains > 1 and tree.base != _WORLD:
        notes.append(f"{chains} chains of joints begin at {tree.base}: it is assumed to be fixed to the ground")
    return notes


def _sentence(names: Sequence[str], reason: str) -> str:
    return f"{_listed(names)} {'is' if len(names) == 1 else 'are'} held: {reason}" if names else ""


def _listed(names: Sequence[str]) -> str:
    return f"joint{'s' if len(names) > 1 else ''} {_some(names)}"
