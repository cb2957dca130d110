"""Robots from URDF files: the kinematics alone."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.model.robot.arm import Joint, Robot
from bayesid.model.robot.numbers import given_numbers


def robot_from_urdf(text: str, where: str) -> Robot:
    """A robot from URDF text; fixed joints merge into their parents, `continuous` ones count as revolute.

    Raises:
        InputError: the text is not a URDF, or a joint is neither revolute, continuous, prismatic nor fixed.
    """
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise InputError(f"is not readable as URDF ({error})", where, "give a well-formed URDF file") from None
    if root.tag != "robot":
        raise InputError(f"is not a URDF: its root is <{root.tag}>, not <robot>", where, "give a URDF file")
    root = _urdf_skeleton(root, where)
    try:
        model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
    except Exception as error:  # pinocchio raises several C++ exception types here
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise InputError(f"is not readable as URDF ({reason})", where, "correct the file") from None
    if model.nv == 0:
        raise InputError("has no moving joint", where, "give a URDF of an arm")
    axes = {e.get("name"): _urdf_axis(e) for e in root.findall("joint")}
    kinds = {e.get("name"): e.get("type") for e in root.findall("joint")}
    joints = tuple(
        Joint(
            placement=np.array(model.jointPlacements[i].homogeneous),
            axis=axes[model.names[i]],
            prismatic=kinds[model.names[i]] == "prismatic",
            parent=model.parents[i] - 1,
        )
        for i in range(1, model.njoints)
    )
    return Robot(name=model.name or "robot", joints=joints, gravity=np.array([0.0, 0.0, -9.81]))


def _urdf_skeleton(root: ET.Element, where: str) -> ET.Element:
    """The URDF's kinematics alone, checked here: urdfdom prints its complaints, and refuses files for other parts."""
    names = [element.get("name", "") for element in root.findall("link")]
    children = [child.get("link", "") for child in root.findall("joint/child")]
    for name in names:
        if names.count(name) > 1:
            raise InputError("appears twice", f"{where}, link {name}", "give every link its own name")
        if children.count(name) > 1:
            raise InputError("is the child of two joints", f"{where}, link {name}", "give a URDF without loops")
    loose = [name for name in names if name not in children]
    if len(loose) != 1:
        said = f"has {len(loose)} links without a parent joint{': ' + ', '.join(loose) if loose else ''}"
        raise InputError(said, where, "give a URDF with one base link")
    skeleton = ET.Element("robot", name=root.get("name") or "robot")
    for name in names:
        ET.SubElement(skeleton, "link", name=name)
    skeleton.extend([_urdf_joint(element, names, where) for element in root.findall("joint")])
    joints = [element.get("name") for element in skeleton.findall("joint")]
    for joint in joints:
        if joints.count(joint) > 1:
            raise InputError("appears twice", f"{where}, joint {joint}", "give every joint its own name")
    return skeleton


def _urdf_joint(element: ET.Element, links: list[str], where: str) -> ET.Element:
    kind, name = element.get("type"), element.get("name", "")
    here = f"{where}, joint {name}"
    if kind not in ("revolute", "continuous", "prismatic", "fixed") or element.find("mimic") is not None:
        said = "a mimic joint" if element.find("mimic") is not None else f"of type {kind!r}"
        raise InputError(f"is {said}", here, "bayesid identifies revolute, continuous, prismatic and fixed joints")
    # pinocchio would use (cos, sin) for a continuous joint; a log holds the angle
    joint = ET.Element("joint", name=name, type="revolute" if kind == "continuous" else kind)
    for tag in ("parent", "child"):
        end = element.find(tag)
        if end is None or end.get("link") not in links:
            raise InputError(f"its <{tag}> names no link of the file", here, "name one")
        joint.append(end)
    for tag, key in (("origin", "xyz"), ("origin", "rpy"), ("axis", "xyz")):
        vector = element.find(tag)
        if vector is not None and key in vector.attrib:
            given_numbers(vector.attrib[key].split(), (3,), f"{tag} {key}", here)
    joint.extend([child for tag in ("origin", "axis") if (child := element.find(tag)) is not None])
    if kind != "fixed":
        ET.SubElement(joint, "limit", lower="-1e9", upper="1e9", effort="1e9", velocity="1e9")
        if not _urdf_axis(joint).any():
            raise InputError("key 'axis xyz' cannot be used", here, "give a direction that is not zero")
    return joint


def _urdf_axis(element: ET.Element) -> Array:
    axis = element.find("axis")
    value = np.array([float(x) for x in axis.get("xyz", "1 0 0").split()]) if axis is not None else np.eye(3)[0]
    return value / (np.linalg.norm(value) or 1.0)
