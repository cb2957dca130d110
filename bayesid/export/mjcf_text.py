"""An identified model as an MJCF, MuJoCo's own format."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence

import numpy as np
import scipy

from bayesid.arrays import Array, frozen
from bayesid.effects.model import Model
from bayesid.export.content import (
    Body,
    Part,
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

_TIMESTEP = 0.001
"""s; the rate of a robot's controller."""
_DRY_FRICTION = {"solreffriction": f"{2 * _TIMESTEP} 1", "solimpfriction": "0.999 0.999 0.001"}
_ABOUT_DRY_FRICTION = (
    "MuJoCo's dry friction is a force that would stop the motion with q'' = -b q', up to the loss given. It acts in",
    "full, as in the model, where |q''| < b |q'|. With solreffriction = two timesteps, b = 1 / timestep: the motion",
    "would stop in one step, and a larger b would overshoot. With solimpfriction near 1 a joint that sticks hardly",
    "creeps. With a larger timestep MuJoCo lowers b by itself.",
)
_SOFTEST = 1e-9
"""N m/rad; a spring that is softer becomes this one, with the same torque at q = 0: without, it would have no place."""


def mjcf(model: Model, theta: Array) -> str:
    """MJCF text of the model's robot: bodies, friction, rotor inertia, springs, gravity and motors.

    Bodies are called link1..linkn, joints joint1..jointn, motors motor1..motorn, from base to tip; MuJoCo counts joints
    depth first, which on a robot with branches may be another order. A motor's control is its effort as in
    `Model.effort`: in N m, motor torque times gear ratio. A motor that moves several joints acts through a tendon,
    which holds its friction and rotor inertia; MuJoCo reads a tendon's armature from version 3.3.1 on, and counts it in
    inverse dynamics from 3.4 on. Pinocchio reads the file too, but for gravity, springs and tendons.

    Args:
        model: a model with a rigid_body term.
        theta: (P,) its parameters, SI units; every link's mass must be positive.

    Raises:
        ValueError: theta has another shape, the model no rigid bodies, or a link no positive mass.

    Example:
        >>> bayesid.mjcf(result.model, result.theta).splitlines()[1]
        '<mujoco model="arm">'
    """
    theta = frozen(theta, (len(model.parameters),), "theta")
    parts = model.parts(theta)
    links, effects = bodies(model, theta), per_actuator(model, parts, "mjcf")
    on_joint = moves_one_joint(model.robot)
    root = ET.Element("mujoco", model=model.robot.name)
    add_comment(root, _remarks(model, parts))
    ET.SubElement(root, "compiler", angle="radian")
    option = {"timestep": numbers(_TIMESTEP), "integrator": "implicitfast"}  # damping of tendons is implicit too
    ET.SubElement(root, "option", {"gravity": numbers(model.robot.gravity), **option})
    default = ET.SubElement(root, "default")
    add_comment(default, _ABOUT_DRY_FRICTION, depth=2)
    ET.SubElement(default, "joint", _DRY_FRICTION)
    ET.SubElement(default, "tendon", _DRY_FRICTION)
    elements = [ET.SubElement(root, "worldbody")]
    for i, joint in enumerate(model.robot.joints):
        parent = elements[joint.parent + 1]
        elements.append(_body(model, i, links[i], effects[i] if on_joint[i] else {}))
        parent.append(elements[-1])
    if not on_joint.all():
        tendons = ET.SubElement(root, "tendon")
        tendons.extend([_tendon(model, i, effects[i]) for i in np.flatnonzero(~on_joint).tolist()])
    actuators = ET.SubElement(root, "actuator")
    for i in range(model.robot.n_joints):
        name, gear = numbered(model, "motor", i), numbers(model.robot.coupling[i, i])
        acts_on = {"joint": numbered(model, "joint", i), "gear": gear} if on_joint[i] else {"tendon": name}
        ET.SubElement(actuators, "motor", {"name": name, **acts_on})
    return document(root)


def _remarks(model: Model, parts: Sequence[Part]) -> list[str]:
    motors = motor_speeds(model.robot)
    every = np.ones(model.robot.n_joints, dtype=bool)
    return [
        head(model, "mjcf"),
        "joint limits (not identified)",
        *left_out(model, parts, "mjcf", every),
        "Controls are efforts as in the log: N m (N of a joint that slides), motor torque times gear ratio.",
        *([f"{motors}; a tendon's length is that of its motor divided by its gear ratio"] if motors else []),
    ]


def _body(model: Model, i: int, body: Body, effects: Mapping[str, float]) -> ET.Element:
    """Body element of link i, with its joint; the bodies that it carries go inside."""
    joint = model.robot.joints[i]
    place = {"pos": numbers(joint.placement[:3, 3]), "quat": _quaternion(joint.placement[:3, :3])}
    element = ET.Element("body", {"name": numbered(model, "link", i), **place})
    # principal axes, not a full matrix: MuJoCo before version 4 takes it apart to seven digits only
    frame = {"pos": numbers(body.centre), "quat": _quaternion(body.axes)}
    ET.SubElement(element, "inertial", {**frame, "mass": numbers(body.mass), "diaginertia": numbers(body.moments)})
    moves = {"type": "slide" if joint.prismatic else "hinge", "axis": numbers(joint.axis)}
    held = _attributes(effects, "springref", direction=float(model.robot.coupling[i, i]))
    ET.SubElement(element, "joint", {"name": numbered(model, "joint", i), **moves, **held})
    return element


def _tendon(model: Model, i: int, effects: Mapping[str, float]) -> ET.Element:
    """Tendon element as long as actuator i's position: the sum of joint positions that turns the motor."""
    held = _attributes(effects, "springlength", direction=1.0)
    element = ET.Element("fixed", {"name": numbered(model, "motor", i), **held})
    for j in np.flatnonzero(model.robot.coupling[i]).tolist():
        ET.SubElement(element, "joint", joint=numbered(model, "joint", j), coef=numbers(model.robot.coupling[i, j]))
    return element


def _attributes(effects: Mapping[str, float], rest_key: str, direction: float) -> dict[str, str]:
    """XML attributes of a joint's or a tendon's effects.

    Args:
        effects: numbers under the keys of `Term.places`, of the motor.
        rest_key: attribute of a spring's rest position.
        direction: 1 or -1, which way the motor turns with the joint; of a spring alone does it change the sign.
    """
    values = {key: max(value, 0.0) for key, value in effects.items() if key != "preload"}  # a solver may leave -1e-12
    if "preload" in effects:
        values["stiffness"] = max(values["stiffness"], _SOFTEST)
        rest = -direction * effects["preload"] / values["stiffness"]
        values[rest_key] = float(np.nextafter(rest, 0.0)) if rest == -1.0 else rest  # a springlength of -1 means none
    return {key: numbers(value) for key, value in values.items()}


def _quaternion(rotation: Array) -> str:
    return numbers(np.roll(scipy.spatial.transform.Rotation.from_matrix(rotation).as_quat(canonical=True), 1))
