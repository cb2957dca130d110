"""An identified model as a URDF, for simulators, planners and controllers.

A URDF holds the kinematics, the links' inertias, and viscous and Coulomb friction. What it has no place for (gravity,
rotor inertia, offsets, springs, delays, motor couplings) is written into a comment at its head.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from bayesid import inertia
from bayesid.model import Model
from bayesid.motion import Array, frozen
from bayesid.robot import Joint, Robot
from bayesid.terms import ActuatorTerm, Parameter, RigidBody, Term
from bayesid.terms.payload import Payload

_JOINT_ATTRIBUTES = {"viscous_friction": "damping", "coulomb_friction": "friction"}
"""Terms that a URDF joint can hold, and their attributes in its <dynamics>."""
_LIMITS = {"lower": "-1000", "upper": "1000", "effort": "1000000", "velocity": "1000"}
"""A URDF demands limits; none are identified, so they are set where they never act."""
_Part = tuple[Term, Array]
"""A term and its own part of theta."""


def urdf(model: Model, theta: Array) -> str:
    """URDF text of the model's robot with the link and friction parameters of theta.

    URDF's link frame is its joint's frame, so links given in another frame (standard Denavit-Hartenberg) are moved
    there. Joints are called joint1..jointn, links link1..linkn, from base to tip. A payload becomes part of the last
    link, and friction of several terms in one joint is added up.

    Args:
        model: a model with a rigid_body term.
        theta: (P,) its parameters, SI units; every link's mass must be positive.

    Raises:
        ValueError: theta has another shape, the model no rigid bodies, or a link no positive mass.
    """
    parts = _parts(model, frozen(theta, (len(model.parameters),), "theta"))
    links, friction = _links(model.robot, parts), _friction(model, parts)
    root = ET.Element("robot", name=model.robot.name)
    root.append(ET.Comment("\n    ".join(["", *_remarks(model, parts)]) + "\n  "))
    ET.SubElement(root, "link", name="base")
    for i, joint in enumerate(model.robot.joints):
        root.append(_link(_name(model, "link", i), joint, links[i]))
        root.append(_joint(model, i, friction[i]))
    ET.indent(root)
    return f'<?xml version="1.0"?>\n{ET.tostring(root, encoding="unicode")}\n'


def _parts(model: Model, theta: Array) -> list[_Part]:
    """The terms, each with its own part of theta."""
    sizes = [len(term.parameters(model.robot)) for term in model.terms]
    return list(zip(model.terms, np.split(theta, np.cumsum(sizes)[:-1]), strict=True))


def _links(robot: Robot, parts: Sequence[_Part]) -> Array:
    """(n, 10) parameters of the links, a payload's added to the last link's: both are given in its frame."""
    if all(term.name != RigidBody.name for term, _ in parts):
        raise ValueError("a URDF needs link parameters: the model has no rigid_body term")
    links = np.zeros((robot.n_joints, 10))
    for term, values in parts:
        if term.name == RigidBody.name:
            links += values.reshape(-1, 10)
        elif term.name == Payload.name:
            links[-1] += values
    return links


def _friction(model: Model, parts: Sequence[_Part]) -> list[dict[str, float]]:
    """For each joint the attributes of its <dynamics>, summed over the terms that act in it."""
    friction: list[dict[str, float]] = [{} for _ in model.robot.joints]
    held = _held(model)
    for term, values in parts:
        if term.name in held:
            for parameter, value in zip(term.parameters(model.robot), values.tolist(), strict=True):
                own, attribute = friction[parameter.joint - 1], held[term.name]
                own[attribute] = own.get(attribute, 0.0) + value
    return friction


def _held(model: Model) -> Mapping[str, str]:
    """Terms that become joint attributes; none with a transmission, whose friction is the motors', not the joints'."""
    return _JOINT_ATTRIBUTES if model.robot.transmission is None else {}


def _remarks(model: Model, parts: Sequence[_Part]) -> list[str]:
    """Lines on what the URDF leaves out."""
    loaded = any(term.name == Payload.name for term, _ in parts)
    payload = f" {_name(model, 'link', model.robot.n_joints - 1)} includes the payload." if loaded else ""
    lines = [
        f"Identified by bayesid.{payload} Not in this URDF:",
        f"gravity = {_numbers(model.robot.gravity)} m/s^2 in the base frame",
        "joint limits (not identified, set wide)",
    ]
    if model.robot.transmission is not None:
        rows = "; ".join(_numbers(row) for row in model.robot.transmission)
        lines.append(f"motor speeds = [{rows}] * joint speeds; the parameters below are the motors'")
    shown = {RigidBody.name, Payload.name, *_held(model)}
    for term, values in parts:
        if term.name not in shown:
            pairs = zip(term.parameters(model.robot), values, strict=True)
            lines += [_remark(term.name, each.name, value, each.unit) for each, value in pairs]
            lines += [_remark(term.name, each.name, value, each.unit) for each, value in _shape(term, model.robot)]
    for distortion in model.distortions:
        lines += [_remark(distortion.name, key, value, unit) for key, (value, unit) in distortion.numbers.items()]
    return lines


def _remark(effect: str, name: str, value: float, unit: str) -> str:
    return f"{effect}: {name} = {_numbers(value)} {unit}"


def _shape(term: Term, robot: Robot) -> Iterator[tuple[Parameter, float]]:
    """The nonlinear numbers that people want to know, joint by joint: the parameters mean nothing without them."""
    if isinstance(term, ActuatorTerm):
        for key, unit in term.shape_units.items():
            for j, value in zip(term.own(robot.n_joints), getattr(term, key), strict=True):
                own = unit.replace("rad", "m") if robot.joints[j].prismatic else unit
                yield Parameter(f"{key}{j + 1}", own, j + 1), value


def _link(name: str, joint: Joint, parameters: Array) -> ET.Element:
    """Link element with its mass, centre of mass, and inertia about that centre, in the joint's frame."""
    moved = inertia.change_of_frame(joint.link_frame[:3, :3], joint.link_frame[:3, 3]) @ parameters
    mass = moved[9]
    if not mass > 0.0:
        raise ValueError(f"{name} has mass {mass:g} kg; a URDF needs positive masses")
    com = moved[6:9] / mass
    about_com = inertia.inertia_matrix(moved) - mass * (com @ com * np.eye(3) - np.outer(com, com))
    link = ET.Element("link", name=name)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=_numbers(com), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=_numbers(mass))
    triangle = {f"i{'xyz'[i]}{'xyz'[j]}": _numbers(about_com[i, j]) for i in range(3) for j in range(i, 3)}
    ET.SubElement(inertial, "inertia", triangle)
    return link


def _joint(model: Model, i: int, dynamics: Mapping[str, float]) -> ET.Element:
    """Element of the joint that moves link i."""
    joint = model.robot.joints[i]
    parent = "base" if joint.parent < 0 else _name(model, "link", joint.parent)
    element = ET.Element("joint", name=_name(model, "joint", i), type="prismatic" if joint.prismatic else "revolute")
    xyz, rpy = joint.placement[:3, 3], _roll_pitch_yaw(joint.placement[:3, :3])
    ET.SubElement(element, "origin", xyz=_numbers(xyz), rpy=_numbers(rpy))
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=_name(model, "link", i))
    ET.SubElement(element, "axis", xyz=_numbers(joint.axis))
    ET.SubElement(element, "limit", _LIMITS)
    if dynamics:
        values = {key: _numbers(max(value, 0.0)) for key, value in dynamics.items()}  # a solver may leave -1e-12
        ET.SubElement(element, "dynamics", values)
    return element


def _name(model: Model, stem: str, i: int) -> str:
    """joint1, or joint01 of ten and more: readers that sort siblings by name then keep their order."""
    return f"{stem}{i + 1:0{len(str(model.robot.n_joints))}d}"


def _roll_pitch_yaw(rotation: Array) -> Array:
    """Angles with rotation = Rz(yaw) Ry(pitch) Rx(roll); exact to rounding at pitch = +-90 degrees too.

    There only yaw - roll or yaw + roll counts: whatever yaw comes out first, roll is read with that yaw taken off.
    """
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    pitch = np.arctan2(-rotation[2, 0], c * rotation[0, 0] + s * rotation[1, 0])
    roll = np.arctan2(s * rotation[0, 2] - c * rotation[1, 2], c * rotation[1, 1] - s * rotation[0, 1])
    return np.array([roll, pitch, yaw])


def _numbers(values: ArrayLike) -> str:
    """Numbers with as many digits as it takes (up to 17) to read back the very same."""
    return " ".join(repr(value) for value in (np.atleast_1d(values) + 0.0).tolist())
