"""A URDF as a checked tree of joints."""

from __future__ import annotations

import re
import shlex
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.files.bounded import LARGEST, xml_of
from bayesid.robot.arm import given_numbers
from bayesid.robot.tuning import TUNING

MOVING = ("revolute", "continuous", "prismatic")
FREE = ("floating", "planar")  # joints of several degrees of freedom, without a motor
_KINDS = (*MOVING, *FREE, "fixed")


@dataclass(frozen=True, eq=False)
class UrdfJoint:
    """A joint of a URDF between two links; its kind is the file's type."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Array  #: (4, 4) its frame at rest in the parent link's
    axis: Array  #: (3,) unit axis in its frame; zero for a joint that is fixed and names none
    #: name of the joint that it follows by <mimic>, fixed or not: multiplier * position + offset
    leader: str | None = None
    multiplier: float = 1.0
    offset: float = 0.0
    rated_effort: float | None = None  #: N m, or N; None if the file has no plausible one
    #: lowest and highest position, and highest speed, rad and rad/s (m); zero if the file has none
    range: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def moves(self) -> bool:
        """Whether it has one degree of freedom."""
        return self.kind in MOVING


@dataclass(frozen=True)
class UrdfTree:
    """Links and joints of a robot."""

    name: str
    base: str  #: the link without a parent
    #: branch by branch from the base, each before those beyond it; branches in alphabetical order of joints
    joints: tuple[UrdfJoint, ...]

    @cached_property
    def above(self) -> dict[str, UrdfJoint]:
        """Link to the joint that it hangs from."""
        return {joint.child: joint for joint in self.joints}

    @cached_property
    def named(self) -> dict[str, UrdfJoint]:
        """Name to joint."""
        return {joint.name: joint for joint in self.joints}

    def path(self, link: str) -> list[UrdfJoint]:
        """Joints from a link back to the base."""
        joints = []
        while link in self.above:
            joints.append(self.above[link])
            link = joints[-1].parent
        return joints

    def beyond(self, joint: UrdfJoint) -> list[UrdfJoint]:
        """Moving joints that descend from a joint."""
        others = (other for other in self.joints if other.moves and other is not joint)
        return [other for other in others if joint.name in self._carriers[other.child]]

    @cached_property
    def _carriers(self) -> dict[str, set[str]]:
        return {link: {joint.name for joint in self.path(link)} for link in self.above}

    def body(self, link: str) -> tuple[str, Array]:
        """The first of the links fixed to this one, from the base, and (4, 4) the link's frame in it."""
        frame = np.eye(4)
        while link in self.above and self.above[link].kind == "fixed":
            frame = self.above[link].origin @ frame
            link = self.above[link].parent
        return link, frame


def read_tree(text: str, where: str) -> UrdfTree:
    """The tree of URDF text; InputError if it is not a URDF, or its links and joints are not a tree."""
    root = _root(text, where)
    check_links(root, where)
    links = [element.get("name", "") for element in root.findall("link")]
    joints = [_joint(element, links, where) for element in root.findall("joint")]
    children, names = [joint.child for joint in joints], [joint.name for joint in joints]
    for link in links:
        if links.count(link) > 1:
            raise InputError("appears twice", f"{where}, link {link}", "give every link a unique name")
        if children.count(link) > 1:
            raise InputError("is the child of two joints", f"{where}, link {link}", "give a URDF without loops")
    for name in names:
        if names.count(name) > 1:
            raise InputError("appears twice", f"{where}, joint {name}", "give every joint a unique name")
    loose = [link for link in links if link not in children]
    if len(loose) != 1:
        what = f"has {len(loose)} links without a parent joint{': ' + ', '.join(loose) if loose else ''}"
        raise InputError(what, where, "give a URDF with one base link")
    tree = UrdfTree(root.get("name") or "robot", loose[0], tuple(_in_order(joints, loose[0])))
    if len(tree.joints) < len(joints):
        first = next(joint.name for joint in joints if joint.name not in tree.named)
        raise InputError("is part of a loop", f"{where}, joint {first}", "give a URDF without loops")
    return tree


def check_links(root: ET.Element, where: str) -> None:
    """InputError for a file with more links or joints than any robot has."""
    for kind in ("link", "joint"):
        if (count := len(root.findall(kind))) > TUNING.most_links:
            raise InputError(f"has {count} {kind}s", where, f"give a URDF with at most {TUNING.most_links}")


def _root(text: str, where: str) -> ET.Element:
    run = f"run `xacro {shlex.quote(where)} > robot.urdf` and give robot.urdf"
    try:
        root = xml_of(text, where)
    except ET.ParseError as error:
        if "<xacro:" in text:
            raise InputError("is a xacro file, not a URDF", where, run) from None
        raise InputError(f"is not valid XML ({error})", where, "give a well-formed URDF file") from None
    if root.tag != "robot":
        raise InputError(f"is not a URDF: its root is <{root.tag}>, not <robot>", where, "give a URDF file")
    macros = (element for element in root.iter() if re.match(r"\{[^}]*xacro[^}]*\}", str(element.tag)))
    if next(macros, None) is not None:
        raise InputError("is a xacro file, not a URDF", where, run)
    return root


def _in_order(joints: list[UrdfJoint], base: str) -> Iterator[UrdfJoint]:
    """Joints from the base on: Pinocchio's order, which other tools share."""
    beneath: dict[str, list[UrdfJoint]] = {}
    for joint in sorted(joints, key=lambda joint: joint.name, reverse=True):
        beneath.setdefault(joint.parent, []).append(joint)
    waiting = list(beneath.get(base, []))
    while waiting:
        joint = waiting.pop()
        yield joint
        waiting += beneath.get(joint.child, [])


# ---- One joint ----
def _joint(element: ET.Element, links: list[str], where: str) -> UrdfJoint:
    kind, name = element.get("type"), element.get("name", "")
    here = f"{where}, joint {name}"
    if kind not in _KINDS:
        raise InputError(f"is of type {kind!r}", here, f"give one of {', '.join(_KINDS)}")
    parent, child = (_link(element, end, links, here) for end in ("parent", "child"))
    axis = _vector(element, "axis", "xyz", "1 0 0", here)
    if kind in MOVING and np.linalg.norm(axis) < 1e-6:
        raise InputError("key 'axis xyz' cannot be used", here, "give a direction that is not zero")
    mimic, follows = element.find("mimic"), {}
    if mimic is not None:
        for key, usual in (("multiplier", 1.0), ("offset", 0.0)):
            follows[key] = float(given_numbers(mimic.get(key, usual), (), f"mimic {key}", here))
    leader, direction = None if mimic is None else mimic.get("joint", ""), axis / (np.linalg.norm(axis) or 1.0)
    origin, rated, span = origin_of(element, here), _rated_effort(element), _range(element)
    return UrdfJoint(name, kind, parent, child, origin, direction, leader, **follows, rated_effort=rated, range=span)


def origin_of(element: ET.Element, where: str) -> Array:
    """(4, 4) the frame of an <origin>; InputError if it is not valid."""
    frame = np.eye(4)
    frame[:3, 3] = _vector(element, "origin", "xyz", "0 0 0", where, TUNING.longest)
    angles = _vector(element, "origin", "rpy", "0 0 0", where)
    frame[:3, :3] = scipy.spatial.transform.Rotation.from_euler("xyz", angles).as_matrix()
    return frame


def _rated_effort(element: ET.Element) -> float | None:
    effort = _limit(element, "effort")
    return effort if 0.0 < effort < TUNING.unlimited_effort else None


def _range(element: ET.Element) -> tuple[float, float, float]:
    return _limit(element, "lower"), _limit(element, "upper"), _limit(element, "velocity")


def _limit(element: ET.Element, key: str) -> float:
    """A number of a joint's <limit>; zero if missing or implausible, as a robot needs none."""
    limit = element.find("limit")
    try:
        return float(0.0 if limit is None else limit.get(key, 0.0))
    except ValueError:
        return 0.0


def _link(element: ET.Element, end: str, links: list[str], where: str) -> str:
    found = element.find(end)
    if found is None or found.get("link") not in links:
        raise InputError(f"its <{end}> is not a link of the file", where, "give the name of a link")
    return found.get("link", "")


def _vector(element: ET.Element, tag: str, key: str, usual: str, where: str, most: float = LARGEST) -> Array:
    found = element.find(tag)
    text = usual if found is None else found.get(key, usual)
    return given_numbers(text.split(), (3,), f"{tag} {key}", where, most)
