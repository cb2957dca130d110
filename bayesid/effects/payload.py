"""A body on the last link: one that a model lacks, and one of which logs say that they carry it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Phrase, Scene
from bayesid.effects.parameters import Cone, Parameter
from bayesid.effects.term import WholeRobotTerm
from bayesid.effects.tuning import TUNING
from bayesid.errors import InputError
from bayesid.motion import Motion, check_label
from bayesid.robot import Robot
from bayesid.robot.inertia import NAMES, UNITS, about_centre_of_mass


@dataclass(frozen=True, kw_only=True)
class BodyOnFlange(WholeRobotTerm):
    """Ten inertial parameters of a body fixed to the last link, in that link's frame."""

    reference = "Atkeson, An, Hollerbach, Inertial parameters of manipulator loads and links, 1986"
    variable = "load"
    shown_by = "turning the wrist while the arm is stretched and at rest, then accelerating it"

    def readable(self, values: Array) -> Mapping[str, tuple[Array, str]]:
        """Mass, centre of mass, and inertia about it, in the last link's frame."""
        centre, inertia = about_centre_of_mass(values)
        return {
            "mass": (values[..., 9], "kg"),
            **{f"centre of mass {axis}": (centre[..., k], "m") for k, axis in enumerate("xyz")},
            **{
                f"inertia {'xyz'[i]}{'xyz'[j]}": (inertia[..., i, j], "kg m^2")
                for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
            },
        }

    def cone(self, robot: Robot) -> Cone:
        """A positive semidefinite pseudo-inertia."""
        return Cone.rigid_bodies(1)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(N, n, 10) those of the last link."""
        return robot.regressor(motion)[:, :, -10:]


@dataclass(frozen=True, kw_only=True)
class Payload(BodyOnFlange):
    """A body that the model lacks.

    Without an earlier model they cannot be separated from the last link's own.
    """

    name = "payload"
    physics = "A body held by the flange: inertia, Coriolis, centrifugal and gravity torques."
    phrase = Phrase(
        "The robot carries a payload of {mp} that the model lacks.",
        "a payload",
        size="mp",
        detail="Its centre of mass lies at ({centre of mass x}, {centre of mass y}, {centre of mass z}) in the last "
        "link's frame. Its inertia about that, along this frame's axes, is xx {inertia xx}, yy {inertia yy}, zz "
        "{inertia zz}, xy {inertia xy}, xz {inertia xz}, yz {inertia yz}. Mass and inertia are in the scale of the "
        "efforts: where gains are 10 % off, so are they.",
        brief="a payload of {mass} kg at ({centre of mass x}, {centre of mass y}, {centre of mass z}) m in the last "
        "link's frame",
    )

    of_links = True
    links_remark = "{last} includes the payload."
    needs_earlier = True
    typical = (*(TUNING.payload_inertia,) * 6, *(TUNING.payload_moment,) * 3, 1.0)
    typical_scales = (0.1, 0.5, 3.0)  # kg

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Jxxp ... mp."""
        return tuple(
            Parameter(f"{name}p{robot.n_joints}", unit, robot.n_joints) for name, unit in zip(NAMES, UNITS, strict=True)
        )

    def link_parameters(self, robot: Robot, theta: Array) -> Array:
        """(n, 10) added to the last link, in whose frame they are."""
        return np.concatenate([np.zeros((robot.n_joints - 1, 10)), theta[None, :]])


def carried_payloads(motion: Motion) -> tuple[CarriedPayload, ...]:
    """A term for each of the labels in a motion, in alphabetical order."""
    return tuple(CarriedPayload(label=(label,)) for label in np.unique(motion.payload).tolist() if label)


@dataclass(frozen=True, kw_only=True)
class CarriedPayload(BodyOnFlange):
    """A body that the flange carries in the rows of its label alone, beside rows without it.

    It is no part of the robot: links and exported files leave it out.

    Args:
        label: (1,) of the rows, as in `bayesid.Log.carrying`.
    """

    label: tuple[str, ...]

    name = "payload.carried"
    physics = "A body that the flange holds while some of the logs are recorded."
    phrase = Phrase("Some logs are of a flange that carries {m}.", "a payload of some logs", size="m")
    can_be_missing = False
    words = ("label",)
    counts = {"label": 1}

    @classmethod
    def for_motion(cls, actuators: Motion) -> Self:
        """None for all of a motion: logs say what they carry."""
        remedy = "leave it out, and say which log carries something by `Log.carrying`"
        raise InputError(f"{cls.name} is no term of every log", field="terms", remedy=remedy)

    @classmethod
    def variants(cls, scene: Scene) -> Iterable[Self]:
        """None: what a log carries is said, not sought."""
        return ()

    @property
    def payloads(self) -> tuple[str, ...]:
        """Its label."""
        return self.label

    def check(self, n_joints: int) -> None:
        """One label."""
        super().check(n_joints)
        try:
            check_label(*self.label)
        except InputError as error:
            raise ValueError(error.what) from None

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Jxx_tool1 ... m_tool1."""
        (label,) = self.label
        return tuple(
            Parameter(f"{name}_{label}", unit, robot.n_joints) for name, unit in zip(NAMES, UNITS, strict=True)
        )

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(N, n, 10) those of the last link in the rows of the label, zero in all others."""
        rows = np.flatnonzero(motion.payload == self.label[0])
        columns = np.zeros((len(motion), robot.n_joints, len(NAMES)))
        if len(rows):
            columns[rows] = super().columns(robot, motion[rows])
        return columns
