"""Robots from files of MuJoCo (MJCF): kinematics only, nested bodies with hinges and slides.

Defaults by class, angles in degrees or radians, and all forms of orientation are read as in MuJoCo's XML reference.
Other structures, such as included files, are refused.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.files.bounded import xml_of
from bayesid.robot.arm import Robot, given_numbers
from bayesid.robot.tuning import TUNING
from bayesid.robot.urdf import robot_from_tree
from bayesid.robot.urdf_tree import UrdfJoint, UrdfTree

_CONVERT = (
    "compile it to a plain file in Python: mujoco.mj_saveLastXML('plain.xml', mujoco.MjModel.from_xml_path(FILE))"
)
_KINDS = {"hinge": "revolute", "slide": "prismatic"}
_Defaults = Mapping[str, Mapping[str, str]]  # of joints, by class; that of all is ""


def is_mjcf(text: str) -> bool:
    """Whether a text is a file of MuJoCo, by its root."""
    return re.match(r"\s*(<\?xml[^>]*>\s*)?(<!--.*?-->\s*)*<mujoco\b", text, re.DOTALL) is not None


def robot_from_mjcf(text: str, where: str, tip: str | None = None, hold: Mapping[str, float] | None = None) -> Robot:
    """A robot from MJCF text; InputError if it is not a plain tree of hinges and slides."""
    try:
        root = xml_of(text, where)
    except ET.ParseError as error:
        raise InputError(f"is not readable as MJCF ({error})", where, "give a well-formed file") from None
    for tag in ("include", "replicate", "frame", "composite", "attach"):
        if next(root.iter(tag), None) is not None:
            raise InputError(f"holds <{tag}>, which is not supported", where, _CONVERT)
    world = root.find("worldbody")
    if world is None:
        raise InputError("holds no <worldbody>", where, "give the file of a robot")
    if sum(1 for _ in root.iter("body")) > TUNING.most_links:
        raise InputError(f"has more than {TUNING.most_links} bodies", where, "give only the robot")
    compiler = {key: value for element in root.findall("compiler") for key, value in element.attrib.items()}
    angle = 1.0 if compiler.get("angle") == "radian" else np.pi / 180.0
    reader = _Reader(where, angle, compiler.get("eulerseq", "xyz"), _defaults(root))
    joints = tuple(reader.joints(world, "world", np.eye(4), ""))
    option = root.find("option")
    gravity = "0 0 -9.81" if option is None else option.get("gravity", "0 0 -9.81")
    down = given_numbers(gravity.split(), (3,), "gravity", where)
    return robot_from_tree(UrdfTree(root.get("model") or "robot", "world", joints), where, tip, hold, down)


def _defaults(root: ET.Element) -> dict[str, dict[str, str]]:
    found: dict[str, dict[str, str]] = {"": {}}

    def add(element: ET.Element, inherited: Mapping[str, str], name: str) -> None:
        joint = element.find("joint")
        found[name] = {**inherited, **({} if joint is None else joint.attrib)}
        for inner in element.findall("default"):
            add(inner, found[name], inner.get("class", ""))

    for element in root.findall("default"):
        add(element, found[""], "")
        found[element.get("class", "main")] = found[""]
    return found


@dataclass(frozen=True)
class _Reader:
    where: str
    angle: float  # rad in one of the file's units
    sequence: str  # of Euler angles; small letters turn with the body
    defaults: _Defaults

    def joints(self, body: ET.Element, link: str, offset: Array, given: str) -> Iterator[UrdfJoint]:
        """Joints beyond a link with its body's frame at `offset` (4, 4), by default of the class `given`."""
        for place, child in enumerate(body.findall("body")):
            name = child.get("name") or f"{link}_{place + 1}"
            here, chosen = offset @ self._frame(child, name), child.get("childclass", given)
            if child.find("freejoint") is not None:
                raise InputError("has a free joint", f"{self.where}, body {name}", "give a robot with a fixed base")
            inner, parent = here, link
            moving = child.findall("joint")
            for k, joint in enumerate(moving):
                attributes = {**self.defaults.get(joint.get("class", chosen), {}), **joint.attrib}
                called = joint.get("name") or f"{name}_joint{k + 1}"
                kind = _KINDS.get(attributes.get("type", "hinge"))
                if kind is None:
                    raise InputError(
                        f"is of type {attributes.get('type')}", f"{self.where}, joint {called}", "give hinges"
                    )
                at, end = (
                    self._numbers(attributes, "pos", "0 0 0", called),
                    name if joint is moving[-1] else f"{name}_{k + 1}",
                )
                axis = self._numbers(attributes, "axis", "0 0 1", called)
                if np.linalg.norm(axis) < 1e-6:
                    raise InputError("key 'axis' is zero", f"{self.where}, joint {called}", "give a direction")
                moved, back = np.eye(4), np.eye(4)
                moved[:3, 3], back[:3, 3] = at, -at
                yield UrdfJoint(called, kind, parent, end, inner @ moved, axis / np.linalg.norm(axis))
                inner, parent = back, end
            if not moving:
                yield UrdfJoint(f"{name}_fixed", "fixed", link, name, here, np.zeros(3))
                inner = np.eye(4)
            for site in child.findall("site"):
                if site.get("name"):
                    label = site.get("name", "")
                    frame = inner @ self._frame(site, label)
                    yield UrdfJoint(f"{label}_fixed", "fixed", name, label, frame, np.zeros(3))
            yield from self.joints(child, name, inner, chosen)

    def _frame(self, element: ET.Element, name: str) -> Array:
        """(4, 4) of a body or a site in its parent's frame."""
        frame, attributes = np.eye(4), element.attrib
        frame[:3, 3] = self._numbers(attributes, "pos", "0 0 0", name)
        if "quat" in attributes:
            w, *xyz = self._numbers(attributes, "quat", "", name, 4)
            turn = Rotation.from_quat([*xyz, w])
        elif "euler" in attributes:
            values = self.angle * self._numbers(attributes, "euler", "", name)
            turn = Rotation.from_euler(self.sequence.swapcase(), values)
        elif "axisangle" in attributes:
            *axis, angle = self._numbers(attributes, "axisangle", "", name, 4)
            turn = Rotation.from_rotvec(np.array(axis) / (np.linalg.norm(axis) or 1.0) * angle * self.angle)
        elif "xyaxes" in attributes:
            x, y = self._numbers(attributes, "xyaxes", "", name, 6).reshape(2, 3)
            x = x / (np.linalg.norm(x) or 1.0)
            y = y - x * (x @ y)
            y = y / (np.linalg.norm(y) or 1.0)
            turn = Rotation.from_matrix(np.column_stack([x, y, np.cross(x, y)]))
        elif "zaxis" in attributes:
            turn, _ = Rotation.align_vectors([self._numbers(attributes, "zaxis", "", name)], [[0.0, 0.0, 1.0]])
        else:
            return frame
        frame[:3, :3] = turn.as_matrix()
        return frame

    def _numbers(self, attributes: Mapping[str, str], key: str, usual: str, name: str, count: int = 3) -> Array:
        return given_numbers(attributes.get(key, usual).split(), (count,), key, f"{self.where}, {name}")
