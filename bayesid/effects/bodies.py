"""Rigid bodies (links and payloads) and forces on the tool."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Self

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Phrase, number
from bayesid.effects.parameters import Cone, Parameter
from bayesid.effects.term import WholeRobotTerm
from bayesid.effects.tuning import TUNING
from bayesid.errors import InputError
from bayesid.motion import Motion, check_label
from bayesid.robot import Robot
from bayesid.robot.inertia import NAMES, UNITS, about_centre_of_mass


class RigidBody(WholeRobotTerm):
    """Rigid links: inertia, Coriolis, centrifugal and gravity torques, linear in ten parameters per link.

    The parameters are those of `bayesid.robot.inertia`. Atkeson, An, Hollerbach, IJRR 1986.
    """

    name = "rigid_body"
    shown_by = "an exciting trajectory"
    can_be_missing = False
    of_links = True

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Ten per link, from base to tip: Jxx of link 2 is J2xx, mcx is mc2x, m is m2, as in the literature."""
        stems = [name.rstrip("xyz") for name in NAMES]
        parts = [(stem, name[len(stem) :], unit) for stem, name, unit in zip(stems, NAMES, UNITS, strict=True)]
        links = range(1, robot.n_joints + 1)
        return tuple(Parameter(f"{stem}{i}{axes}", unit, i) for i in links for stem, axes, unit in parts)

    def cone(self, robot: Robot) -> Cone:
        return Cone.rigid_bodies(robot.n_joints)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        return robot.regressor(motion)

    def effort(self, robot: Robot, motion: Motion, theta: Array) -> Array:
        return robot.inverse_dynamics(motion, theta)

    def link_parameters(self, robot: Robot, theta: Array) -> Array:
        return theta.reshape(-1, 10)


class BodyOnFlange(WholeRobotTerm):
    """Ten inertial parameters of a body fixed to the last link, in that link's frame.

    Atkeson, An, Hollerbach, Inertial parameters of manipulator loads and links, 1986.
    """

    shown_by = "turning the wrist while the arm is stretched and at rest, then accelerating it"

    def readable(self, values: Array) -> Mapping[str, tuple[Array, str]]:
        """Mass, centre of mass, and inertia about it, in the last link's frame."""
        centre, inertia = about_centre_of_mass(values)
        return {
            "mass": (values[..., 9], "kg"),
            **{f"centre of mass {axis}": (centre[..., k], "m") for k, axis in enumerate("xyz")},
            **{
                f"inertia {'xyz'[i]}{'xyz'[j]}": (inertia[..., i, j], "kg m^2")
                for i, j in zip(*np.triu_indices(3), strict=True)
            },
        }

    def suffixed(self, suffix: str, robot: Robot) -> tuple[Parameter, ...]:
        """Jxx ... m, each with the suffix."""
        return tuple(Parameter(name + suffix, unit, robot.n_joints) for name, unit in zip(NAMES, UNITS, strict=True))

    def cone(self, robot: Robot) -> Cone:
        return Cone.rigid_bodies(1)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        return robot.regressor(motion)[:, :, -10:]


class Payload(BodyOnFlange):
    """A body that the model lacks; without an earlier model it cannot be separated from the last link."""

    name = "payload"
    phrase = Phrase(
        "The robot carries a payload of {mp} that the model lacks.",
        "a payload",
        size="mp",
        detail="Its centre of mass lies at ({centre of mass x}, {centre of mass y}, {centre of mass z}) in the last "
        "link's frame. Its inertia about that, along this frame's axes, is xx {inertia xx}, yy {inertia yy}, zz "
        "{inertia zz}, xy {inertia xy}, xz {inertia xz}, yz {inertia yz}. Mass and inertia scale with the efforts: "
        "an error common to all gains changes them alike. `bayesid payload` reports the same values.",
        brief="a payload of {mass}",
    )
    of_links = True
    needs_earlier = True
    typical = tuple(
        (*(mass * TUNING.payload_inertia,) * 6, *(mass * TUNING.payload_moment,) * 3, mass) for mass in (0.1, 0.5, 3.0)
    )

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return self.suffixed(f"p{robot.n_joints}", robot)

    def link_parameters(self, robot: Robot, theta: Array) -> Array:
        return np.concatenate([np.zeros((robot.n_joints - 1, 10)), theta[None, :]])

    def export_remark(self, last_link: str) -> str:
        return f"{last_link} includes the payload."


def carried_payloads(motion: Motion) -> tuple[CarriedPayload, ...]:
    """A term for each of the labels in a motion, in alphabetical order."""
    return tuple(CarriedPayload(label=(label,)) for label in np.unique(motion.payload).tolist() if label)


class CarriedPayload(BodyOnFlange):
    """A body on the flange, only in the rows with its label. Links and exported files leave it out.

    Args:
        label: (1,) of the rows, as in `bayesid.Log.carrying`.
    """

    label: tuple[str, ...] = number(given=True)

    name = "payload.carried"
    phrase = Phrase("In some logs the flange carries {m}.", "a payload of some logs", size="m")
    can_be_missing = False

    @classmethod
    def for_motion(cls, actuators: Motion) -> Self:
        """Always an InputError: payloads come from the labels of logs."""
        remedy = "remove it, and label the logs with a payload by `Log.carrying`"
        raise InputError(f"{cls.name} acts only in logs with a payload", field="terms", remedy=remedy)

    @property
    def payloads(self) -> tuple[str, ...]:
        return self.label

    def check(self, n_joints: int) -> None:
        super().check(n_joints)
        self._expect("label", 1)
        try:
            check_label(*self.label)
        except InputError as error:
            raise ValueError(error.what) from None

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return self.suffixed(f"_{self.label[0]}", robot)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        rows = np.flatnonzero(motion.payload == self.label[0])
        columns = np.zeros((len(motion), robot.n_joints, len(NAMES)))
        if len(rows):
            columns[rows] = super().columns(robot, motion[rows])
        return columns


_FORCE = (("x", "N"), ("y", "N"), ("z", "N"))
_COUPLE = (("rx", "N m"), ("ry", "N m"), ("rz", "N m"))


class ToolWrench(WholeRobotTerm):
    """A force from outside on the last link's frame, such as a hose that pulls, constant along the base's axes.

    The actuators supply -J' F against it (virtual work).
    """

    name = "tool_wrench"
    shown_by = "moving the tool slowly through space, and turning it in place"
    phrase = Phrase("A force of {wbx}, {wby} and {wbz} along the base's axes acts on the tool.", "a force on the tool")
    in_base: ClassVar[bool] = True
    parts: ClassVar[tuple[tuple[str, str], ...]] = _FORCE
    symbol: ClassVar[str] = "wb"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        n = robot.n_joints
        return tuple(Parameter(f"{self.symbol}{axis}{n}", unit, n) for axis, unit in self.parts)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        return -robot.tool_jacobian(motion, self.in_base).swapaxes(1, 2)[:, :, : len(self.parts)]


class BaseWrench(ToolWrench):
    """A force and a couple along the base's axes."""

    name = "tool_wrench.couple"
    phrase = Phrase(
        "A force of {wcx}, {wcy} and {wcz} and a couple of {wcrx}, {wcry} and {wcrz} along the base's axes "
        "act on the tool."
    )
    parts = (*_FORCE, *_COUPLE)
    symbol = "wc"


class FollowingForce(ToolWrench):
    """A force that turns with the tool, such as a jet or a preloaded contact."""

    name = "tool_wrench.following"
    phrase = Phrase("A force of {wtx}, {wty} and {wtz} acts on the tool and turns with it.")
    in_base = False
    symbol = "wt"


class FollowingWrench(FollowingForce):
    """A force and a couple that turn with the tool."""

    name = "tool_wrench.following_couple"
    phrase = Phrase(
        "A force of {wfx}, {wfy} and {wfz} and a couple of {wfrx}, {wfry} and {wfrz} act on the tool and turn with it."
    )
    parts = (*_FORCE, *_COUPLE)
    symbol = "wf"
