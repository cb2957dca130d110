"""An identified model as a URDF."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping

import numpy as np

from bayesid.arrays import Array, frozen
from bayesid.effects.model import Model
from bayesid.export.content import (
    Body,
    add_comment,
    bodies,
    document,
    head,
    left_out,
    motor_speeds,
    moves_one_joint,
    numbered,
    numbers,
    per_actuator,
)

_LIMITS = {"lower": "-1000", "upper": "1000", "effort": "1000000", "velocity": "1000"}
"""A URDF demands limits; none are identified, so they are set where they never act."""


def urdf(model: Model, theta: Array) -> str:
    """URDF text of the model's robot with the link and friction parameters of theta.

    URDF's link frame is its joint's frame, so links given in another frame (standard Denavit-Hartenberg) are moved
    there. Joints are called joint1..jointn, links link1..linkn, from base to tip. A payload becomes part of the last
    link, and friction of several terms in one joint is added up: damping * q' + friction * sign(q'). Friction of a
    motor that moves several joints stands in the comment alone. URDF has no place for gravity; an element that MuJoCo
    reads and others ignore gives it to MuJoCo.

    Args:
        model: a model with a rigid_body term.
        theta: (P,) its parameters, SI units; every link's mass must be positive.

    Raises:
        ValueError: theta has another shape, the model no rigid bodies, or a link no positive mass.

    Example:
        >>> bayesid.urdf(result.model, result.theta).splitlines()[1]
        '<robot name="arm">'
    """
    theta = frozen(theta, (len(model.parameters),), "theta")
    parts = model.parts(theta)
    links, friction = bodies(model, theta), per_actuator(model, parts, "urdf")
    held = moves_one_joint(model.robot)
    motors = motor_speeds(model.robot)
    root = ET.Element("robot", name=model.robot.name)
    remarks = [
        head(model, "urdf"),
        f"gravity = {numbers(model.robot.gravity)} m/s^2 in the base frame (MuJoCo alone reads it, below)",
        "joint limits (not identified, set wide)",
        *([f"{motors}; the parameters below are the motors'"] if motors else []),
        *left_out(model, parts, "urdf", held),
    ]
    add_comment(root, remarks)
    ET.SubElement(ET.SubElement(root, "mujoco"), "option", gravity=numbers(model.robot.gravity))
    ET.SubElement(root, "link", name="base")
    for i, link in enumerate(links):
        root.append(_link(numbered(model, "link", i), link))
        root.append(_joint(model, i, friction[i] if held[i] else {}))
    return document(root)


def _link(name: str, body: Body) -> ET.Element:
    link = ET.Element("link", name=name)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=numbers(body.centre), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=numbers(body.mass))
    triangle = {f"i{'xyz'[i]}{'xyz'[j]}": numbers(body.inertia[i, j]) for i in range(3) for j in range(i, 3)}
    ET.SubElement(inertial, "inertia", triangle)
    return link


def _joint(model: Model, i: int, dynamics: Mapping[str, float]) -> ET.Element:
    joint = model.robot.joints[i]
    parent = "base" if joint.parent < 0 else numbered(model, "link", joint.parent)
    kind = "prismatic" if joint.prismatic else "revolute"
    element = ET.Element("joint", name=numbered(model, "joint", i), type=kind)
    xyz, rpy = joint.placement[:3, 3], roll_pitch_yaw(joint.placement[:3, :3])
    ET.SubElement(element, "origin", xyz=numbers(xyz), rpy=numbers(rpy))
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=numbered(model, "link", i))
    ET.SubElement(element, "axis", xyz=numbers(joint.axis))
    ET.SubElement(element, "limit", _LIMITS)
    if dynamics:
        values = {key: numbers(max(value, 0.0)) for key, value in dynamics.items()}  # a solver may leave -1e-12
        ET.SubElement(element, "dynamics", values)
    return element


def roll_pitch_yaw(rotation: Array) -> Array:
    """Angles with rotation = Rz(yaw) Ry(pitch) Rx(roll); exact to rounding at pitch = +-90 degrees too.

    There only yaw - roll or yaw + roll counts: whatever yaw comes out first, roll is read with that yaw taken off.
    """
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    pitch = np.arctan2(-rotation[2, 0], c * rotation[0, 0] + s * rotation[1, 0])
    roll = np.arctan2(s * rotation[0, 2] - c * rotation[1, 2], c * rotation[1, 1] - s * rotation[0, 1])
    return np.array([roll, pitch, yaw])
