"""An identified model as a URDF, and as an MJCF, MuJoCo's own format."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle

import numpy as np
import scipy
from numpy.typing import ArrayLike

from bayesid.arrays import Array, Mask, frozen
from bayesid.effects import RigidBody, Term
from bayesid.effects.effect import Effect
from bayesid.effects.model import Model
from bayesid.robot import Joint, Robot, inertia

# ---- URDF ----
_LIMITS = {"lower": "-1000", "upper": "1000", "effort": "1000000", "velocity": "1000"}
"""A URDF needs limits. None are identified, so they are set wide."""


def urdf(model: Model, theta: Array) -> str:
    """URDF text of the model's robot with the link and friction parameters of theta.

    Links are transformed to URDF's link frame, which is the joint's frame. Joints are called joint1..jointn, links
    link1..linkn, from base to tip. A payload becomes part of the last link. Friction of several terms in one joint is
    added: damping * q' + friction * sign(q'). Friction of a motor that moves several joints is only in the comment.
    URDF does not hold gravity; a `mujoco` element, which others ignore, gives it to MuJoCo.

    Args:
        model: a model with a rigid_body term.
        theta: (P,) its parameters, SI units; every link's mass must be positive.

    Raises:
        ValueError: theta has another shape, the model no rigid bodies, or a link no positive mass.
    """
    theta = frozen(theta, (len(model.parameters),), "theta")
    parts, links, on_joint = model.parts(theta), _bodies(model, theta), _moves_one_joint(model.robot)
    friction, motors = _per_actuator(model, parts, "urdf"), _motor_speeds(model.robot)
    root = ET.Element("robot", name=model.robot.name)
    remarks = [
        _head(model, "urdf"),
        f"gravity = {numbers(model.robot.gravity)} m/s^2 in the base frame (only MuJoCo reads it, below)",
        "joint limits (not identified, set wide)",
        *([f"{motors}; the parameters below are the motors'"] if motors else []),
        *_left_out(model, parts, "urdf", on_joint),
    ]
    _add_comment(root, remarks)
    ET.SubElement(ET.SubElement(root, "mujoco"), "option", gravity=numbers(model.robot.gravity))
    ET.SubElement(root, "link", name="base")
    for i, body in enumerate(links):
        root.append(_urdf_link(_numbered(model, "link", i), body))
        root.append(_urdf_joint(model, i, friction[i] if on_joint[i] else {}))
    return _document(root)


def _urdf_link(name: str, body: Body) -> ET.Element:
    link = ET.Element("link", name=name)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=numbers(body.centre), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=numbers(body.mass))
    triangle = {f"i{'xyz'[i]}{'xyz'[j]}": numbers(body.inertia[i, j]) for i in range(3) for j in range(i, 3)}
    ET.SubElement(inertial, "inertia", triangle)
    return link


def _urdf_joint(model: Model, i: int, dynamics: Mapping[str, float]) -> ET.Element:
    joint = model.robot.joints[i]
    parent = "base" if joint.parent < 0 else _numbered(model, "link", joint.parent)
    kind = "prismatic" if joint.prismatic else "revolute"
    element = ET.Element("joint", name=_numbered(model, "joint", i), type=kind)
    xyz, rpy = joint.placement[:3, 3], roll_pitch_yaw(joint.placement[:3, :3])
    ET.SubElement(element, "origin", xyz=numbers(xyz), rpy=numbers(rpy))
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=_numbered(model, "link", i))
    ET.SubElement(element, "axis", xyz=numbers(joint.axis))
    ET.SubElement(element, "limit", _LIMITS)
    if dynamics:
        values = {key: numbers(max(value, 0.0)) for key, value in dynamics.items()}  # a solver may leave -1e-12
        ET.SubElement(element, "dynamics", values)
    return element


def roll_pitch_yaw(rotation: Array) -> Array:
    """Angles with rotation = Rz(yaw) Ry(pitch) Rx(roll), exact to rounding at pitch = +-90 degrees too.

    There only yaw - roll or yaw + roll is determined: roll is computed for the yaw that was chosen.
    """
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    pitch = np.arctan2(-rotation[2, 0], c * rotation[0, 0] + s * rotation[1, 0])
    roll = np.arctan2(s * rotation[0, 2] - c * rotation[1, 2], c * rotation[1, 1] - s * rotation[0, 1])
    return np.array([roll, pitch, yaw])


# ---- MJCF ----
_TIMESTEP = 0.001
"""s, usual cycle of a robot controller."""
_DRY_FRICTION = {"solreffriction": f"{2 * _TIMESTEP} 1", "solimpfriction": "0.999 0.999 0.001"}
_ABOUT_DRY_FRICTION = (
    "MuJoCo's dry friction is a force that would stop the motion with q'' = -b q', up to frictionloss. It has its full",
    "size, as in the model, where |q''| < b |q'|. With solreffriction = two timesteps, b = 1 / timestep: the motion",
    "would stop in one step; a larger b would overshoot. With solimpfriction near 1 a sticking joint hardly creeps.",
    "MuJoCo lowers b for a larger timestep.",
)


def mjcf(model: Model, theta: Array) -> str:
    """MJCF text of the model's robot: bodies, friction, rotor inertia, springs, gravity and motors.

    Bodies are called link1..linkn, joints joint1..jointn, motors motor1..motorn, from base to tip. MuJoCo orders joints
    depth first, which differs for a robot with branches. A motor's control is its effort as in `Model.effort`: N m,
    motor torque times gear ratio. A motor that moves several joints acts through a tendon with its friction and rotor
    inertia. MuJoCo reads a tendon's armature from version 3.3.1 on, and includes it in inverse dynamics from 3.4 on.
    Pinocchio reads the file without gravity, springs and tendons.

    Args:
        model: a model with a rigid_body term.
        theta: (P,) its parameters, SI units; every link's mass must be positive.

    Raises:
        ValueError: theta has another shape, the model no rigid bodies, or a link no positive mass.
    """
    theta = frozen(theta, (len(model.parameters),), "theta")
    parts, links, on_joint = model.parts(theta), _bodies(model, theta), _moves_one_joint(model.robot)
    effects, motors = _per_actuator(model, parts, "mjcf"), _motor_speeds(model.robot)
    root = ET.Element("mujoco", model=model.robot.name)
    remarks = [
        _head(model, "mjcf"),
        "joint limits (not identified)",
        *_left_out(model, parts, "mjcf", np.ones(model.robot.n_joints, dtype=bool)),
        "Controls are efforts as in the log: N m (N for a prismatic joint), motor torque times gear ratio.",
        *([f"{motors}; a tendon's length is that of its motor divided by its gear ratio"] if motors else []),
    ]
    _add_comment(root, remarks)
    ET.SubElement(root, "compiler", angle="radian")
    option = {"timestep": numbers(_TIMESTEP), "integrator": "implicitfast"}  # implicit damping, of tendons too
    ET.SubElement(root, "option", {"gravity": numbers(model.robot.gravity), **option})
    default = ET.SubElement(root, "default")
    _add_comment(default, _ABOUT_DRY_FRICTION, depth=2)
    ET.SubElement(default, "joint", _DRY_FRICTION)
    ET.SubElement(default, "tendon", _DRY_FRICTION)
    elements = [ET.SubElement(root, "worldbody")]
    for i, joint in enumerate(model.robot.joints):
        parent = elements[joint.parent + 1]
        elements.append(_mjcf_body(model, i, links[i], effects[i] if on_joint[i] else {}))
        parent.append(elements[-1])
    if not on_joint.all():
        tendons = ET.SubElement(root, "tendon")
        tendons.extend([_tendon(model, i, effects[i]) for i in np.flatnonzero(~on_joint).tolist()])
    actuators = ET.SubElement(root, "actuator")
    for i in range(model.robot.n_joints):
        name, gear = _numbered(model, "motor", i), numbers(model.robot.coupling[i, i])
        acts_on = {"joint": _numbered(model, "joint", i), "gear": gear} if on_joint[i] else {"tendon": name}
        ET.SubElement(actuators, "motor", {"name": name, **acts_on})
    return _document(root)


def _mjcf_body(model: Model, i: int, body: Body, effects: Mapping[str, float]) -> ET.Element:
    joint = model.robot.joints[i]
    place = {"pos": numbers(joint.placement[:3, 3]), "quat": _quaternion(joint.placement[:3, :3])}
    element = ET.Element("body", {"name": _numbered(model, "link", i), **place})
    # principal axes, not a full matrix: MuJoCo before version 4 decomposes it to seven digits only
    frame = {"pos": numbers(body.centre), "quat": _quaternion(body.axes)}
    ET.SubElement(element, "inertial", {**frame, "mass": numbers(body.mass), "diaginertia": numbers(body.moments)})
    moves = {"type": "slide" if joint.prismatic else "hinge", "axis": numbers(joint.axis)}
    attributes = _attributes(effects, "springref", direction=float(model.robot.coupling[i, i]))
    ET.SubElement(element, "joint", {"name": _numbered(model, "joint", i), **moves, **attributes})
    return element


def _tendon(model: Model, i: int, effects: Mapping[str, float]) -> ET.Element:
    """Tendon whose length is the position of actuator i: its sum of joint positions."""
    attributes = _attributes(effects, "springlength", direction=1.0)
    element = ET.Element("fixed", {"name": _numbered(model, "motor", i), **attributes})
    for j in np.flatnonzero(model.robot.coupling[i]).tolist():
        ET.SubElement(element, "joint", joint=_numbered(model, "joint", j), coef=numbers(model.robot.coupling[i, j]))
    return element


def _attributes(effects: Mapping[str, float], rest_key: str, direction: float) -> dict[str, str]:
    """XML attributes of a joint or tendon from a motor's effects, numbers under the keys of `Term.places`.

    `rest_key` is the attribute of a spring's rest position; the sign of `direction` is that of motor over joint speed.
    """
    values = {key: max(value, 0.0) for key, value in effects.items() if key != "preload"}  # a solver may leave -1e-12
    if "preload" in effects:
        values["stiffness"] = max(values["stiffness"], 1e-9)  # N m/rad; a preload needs a stiffness
        rest = -direction * effects["preload"] / values["stiffness"]
        values[rest_key] = float(np.nextafter(rest, 0.0)) if rest == -1.0 else rest  # a springlength of -1 means none
    return {key: numbers(value) for key, value in values.items()}


def _quaternion(rotation: Array) -> str:
    return numbers(np.roll(scipy.spatial.transform.Rotation.from_matrix(rotation).as_quat(canonical=True), 1))


# ---- Common parts: bodies, effects in the actuators, and what a format leaves out ----
Part = tuple[Term, Array]
"""A term and its part of theta."""


@dataclass(frozen=True)
class Body:
    """A link in its joint's frame."""

    mass: float  # kg
    centre: Array  # (3,) centre of mass, m
    axes: Array  # (3, 3) principal axes of inertia, the columns of a rotation
    moments: Array  # (3,) about these axes and the centre of mass, kg m^2

    @property
    def inertia(self) -> Array:
        """(3, 3) about the centre of mass, kg m^2."""
        return self.axes * self.moments @ self.axes.T


def _bodies(model: Model, theta: Array) -> list[Body]:
    if all(term.name != RigidBody.name for term in model.terms):
        raise ValueError("an export needs link parameters: the model has no rigid_body term")
    joints = model.robot.joints
    return [_body(_numbered(model, "link", i), joints[i], link) for i, link in enumerate(model.links(theta))]


def _body(name: str, joint: Joint, parameters: Array) -> Body:
    """The body of (10,) parameters, given in the link's frame.

    Identified bodies are often at the edge of the feasible set: flat, thin, or a point. Rounding then makes them
    infeasible, and MuJoCo refuses them, so every body gets a minimal thickness.
    """
    moved = inertia.change_of_frame(joint.link_frame[:3, :3], joint.link_frame[:3, 3]) @ parameters
    mass = float(moved[9])
    if not mass > 1e-15:  # kg, MuJoCo's least mass
        raise ValueError(f"{name} has mass {mass:g} kg; an export needs positive masses")
    centre = moved[6:9] / mass
    about_joint = inertia.pseudo_inertia(moved)[:3, :3]
    spread, axes = np.linalg.eigh(about_joint - mass * np.outer(centre, centre))
    # above rounding, below what a log can show, and ten times MuJoCo's least inertia, kg m^2
    spread = np.maximum(spread, 1e-9 * np.trace(about_joint) + 1e-14)
    return Body(mass, centre, axes * np.sign(np.linalg.det(axes)), spread.sum() - spread)


def _moves_one_joint(robot: Robot) -> Mask:
    """(n,) whether a motor moves only its own joint, so that its friction is the joint's."""
    return np.count_nonzero(robot.coupling, axis=1) == 1


def _per_actuator(model: Model, parts: Sequence[Part], form: str) -> list[dict[str, float]]:
    """Numbers of each actuator under the keys of a format, summed over its terms."""
    sums: list[dict[str, float]] = [{} for _ in model.robot.joints]
    for term, values in parts:
        keys = cycle(term.places.get(form, ()))
        for key, parameter, value in zip(keys, term.parameters(model.robot), values.tolist(), strict=False):
            of_joint = sums[parameter.joint - 1]
            of_joint[key] = of_joint.get(key, 0.0) + value
    return sums


def _head(model: Model, form: str) -> str:
    last = _numbered(model, "link", model.robot.n_joints - 1)
    remarks = dict.fromkeys(f" {remark}" for term in model.terms if (remark := term.export_remark(last)))
    return f"Identified by bayesid.{''.join(remarks)} Not in this {form.upper()}:"


def _left_out(model: Model, parts: Sequence[Part], form: str, placed: Mask) -> list[str]:
    """A line for each number that the file lacks: neither of a link nor of an actuator in `placed`.

    No format has friction that is smoothed about standstill, so smoothing speeds are always listed.
    """
    lines = []
    for term, values in parts:
        if not term.of_links:
            for parameter, value in zip(term.parameters(model.robot), values, strict=True):
                if form not in term.places or not placed[parameter.joint - 1]:
                    lines.append(_remark(term, parameter.name, value, parameter.unit))
            lines += _numbers_of(term, model.robot)
            if (words := term.description(model.robot, values)) is not None:
                lines += [f"{term.name} of joint {term.joints[0]}: {words.formula}", words.sentence]
    return lines + [line for distortion in model.distortions for line in _numbers_of(distortion, model.robot)]


def _numbers_of(effect: Effect, robot: Robot) -> list[str]:
    """Lines of the effect's nonlinear parameters, which the linear ones depend on."""
    return [_remark(effect, name, value, unit) for name, (value, unit) in effect.numbers(robot).items()]


def _remark(effect: Effect, name: str, value: float, unit: str) -> str:
    return f"{effect.name}: {name} = {numbers(value)} {unit}"


def _motor_speeds(robot: Robot) -> str:
    """Motor speeds from joint speeds, as text; empty without a transmission."""
    if robot.transmission is None:
        return ""
    return f"motor speeds = [{'; '.join(numbers(row) for row in robot.transmission)}] * joint speeds"


def _numbered(model: Model, stem: str, i: int) -> str:
    """joint1, or joint01 of ten and more, so that readers that sort by name keep the order."""
    return f"{stem}{i + 1:0{len(str(model.robot.n_joints))}d}"


def numbers(values: ArrayLike) -> str:
    """Numbers with all digits (up to 17) that are needed to read back the same values."""
    return " ".join(repr(value) for value in (np.atleast_1d(values) + 0.0).tolist())


def _add_comment(parent: ET.Element, lines: Sequence[str], depth: int = 1) -> None:
    """Adds a comment of several lines to an element; its children are indented by `depth`."""
    margin = "  " * depth
    parent.append(ET.Comment("\n".join(["", *(f"{margin}  {line}" for line in lines), margin])))


def _document(root: ET.Element) -> str:
    ET.indent(root)
    return f'<?xml version="1.0"?>\n{ET.tostring(root, encoding="unicode")}\n'
