"""What every format says of a model: its bodies, the effects in its actuators, and what the format leaves out."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle

import numpy as np
from numpy.typing import ArrayLike

from bayesid.arrays import Array, Mask
from bayesid.effects import RigidBody, Term
from bayesid.effects.effect import Effect
from bayesid.effects.model import Model
from bayesid.robot import Joint, Robot, inertia

Part = tuple[Term, Array]
"""A term and its own part of theta."""

_LEAST_MASS = 1e-15
"""kg; MuJoCo takes less for none."""
_THINNEST = 1e-9
"""Least second moment about a centre of mass, as a share of the body's own about its joint: above rounding, below what
any log shows."""
_LEAST_SECOND_MOMENT = 1e-14
"""kg m^2; ten times what MuJoCo takes for none."""


@dataclass(frozen=True)
class Body:
    """A link as other tools want it, in its joint's frame."""

    mass: float  # kg
    centre: Array  # (3,) centre of mass, m
    axes: Array  # (3, 3) principal axes of inertia, the columns of a rotation
    moments: Array  # (3,) about these axes and the centre of mass, kg m^2

    @property
    def inertia(self) -> Array:
        """(3, 3) about the centre of mass, kg m^2."""
        return self.axes * self.moments @ self.axes.T


def bodies(model: Model, theta: Array) -> list[Body]:
    """The links with what they carry."""
    if all(term.name != RigidBody.name for term in model.terms):
        raise ValueError("an export needs link parameters: the model has no rigid_body term")
    joints = model.robot.joints
    return [_body(numbered(model, "link", i), joints[i], link) for i, link in enumerate(model.links(theta))]


def _body(name: str, joint: Joint, parameters: Array) -> Body:
    """The body of (10,) parameters, given in the link's frame.

    Identified bodies often lie on the edge of the feasible ones: flat, thin, or a point. Rounding then puts them just
    outside, and MuJoCo refuses them, so every body is made at least a trace thick.
    """
    moved = inertia.change_of_frame(joint.link_frame[:3, :3], joint.link_frame[:3, 3]) @ parameters
    mass = float(moved[9])
    if not mass > _LEAST_MASS:
        raise ValueError(f"{name} has mass {mass:g} kg; an export needs positive masses")
    centre = moved[6:9] / mass
    about_joint = inertia.pseudo_inertia(moved)[:3, :3]
    spread, axes = np.linalg.eigh(about_joint - mass * np.outer(centre, centre))
    spread = np.maximum(spread, _THINNEST * np.trace(about_joint) + _LEAST_SECOND_MOMENT)
    return Body(mass, centre, axes * np.sign(np.linalg.det(axes)), spread.sum() - spread)


def moves_one_joint(robot: Robot) -> Mask:
    """(n,) whether a motor moves its own joint alone: its friction is then the joint's."""
    return np.count_nonzero(robot.coupling, axis=1) == 1


def per_actuator(model: Model, parts: Sequence[Part], form: str) -> list[dict[str, float]]:
    """For each actuator its numbers under the keys of a format, summed over the terms that act in it."""
    sums: list[dict[str, float]] = [{} for _ in model.robot.joints]
    for term, values in parts:
        keys = cycle(term.places.get(form, ()))
        for key, parameter, value in zip(keys, term.parameters(model.robot), values.tolist(), strict=False):
            of_joint = sums[parameter.joint - 1]
            of_joint[key] = of_joint.get(key, 0.0) + value
    return sums


def head(model: Model, form: str) -> str:
    """First line of the comment at a file's head."""
    last = numbered(model, "link", model.robot.n_joints - 1)
    remarks = {f" {term.links_remark.format(last=last)}": None for term in model.terms if term.links_remark}
    return f"Identified by bayesid.{''.join(remarks)} Not in this {form.upper()}:"


def left_out(model: Model, parts: Sequence[Part], form: str, placed: Mask) -> list[str]:
    """A line for each number that is not in the file: all but links, and what has a place in the actuators `placed`.

    No format knows a friction that is smoothed about standstill, so the speeds of smoothing are left out of all.
    """
    lines = []
    for term, values in parts:
        if not term.of_links:
            for parameter, value in zip(term.parameters(model.robot), values, strict=True):
                if form not in term.places or not placed[parameter.joint - 1]:
                    lines.append(_remark(term, parameter.name, value, parameter.unit))
            lines += _remarks(term, model.robot)
            words = term.description(model.robot, values)
            lines += (
                [] if words is None else [f"{term.name} of joint {term.joints[0]}: {words.formula}", words.sentence]
            )
    return lines + [line for distortion in model.distortions for line in _remarks(distortion, model.robot)]


def _remarks(effect: Effect, robot: Robot) -> list[str]:
    """The nonlinear numbers that people want to know: the parameters mean nothing without them."""
    return [_remark(effect, name, value, unit) for name, (value, unit) in effect.numbers(robot).items()]


def _remark(effect: Effect, name: str, value: float, unit: str) -> str:
    return f"{effect.name}: {name} = {numbers(value)} {unit}"


def motor_speeds(robot: Robot) -> str:
    """How the motors turn with the joints; empty for motors on their joints."""
    if robot.transmission is None:
        return ""
    return f"motor speeds = [{'; '.join(numbers(row) for row in robot.transmission)}] * joint speeds"


def numbered(model: Model, stem: str, i: int) -> str:
    """joint1, or joint01 of ten and more: readers that sort siblings by name then keep their order."""
    return f"{stem}{i + 1:0{len(str(model.robot.n_joints))}d}"


def numbers(values: ArrayLike) -> str:
    """Numbers with as many digits as it takes (up to 17) to read back the very same."""
    return " ".join(repr(value) for value in (np.atleast_1d(values) + 0.0).tolist())


def add_comment(parent: ET.Element, lines: Sequence[str], depth: int = 1) -> None:
    """Adds a comment of several lines to an element; its children are indented by `depth`."""
    margin = "  " * depth
    parent.append(ET.Comment("\n".join(["", *(f"{margin}  {line}" for line in lines), margin])))


def document(root: ET.Element) -> str:
    """The text of a file."""
    ET.indent(root)
    return f'<?xml version="1.0"?>\n{ET.tostring(root, encoding="unicode")}\n'
