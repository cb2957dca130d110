"""A body on the last link."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayesid.arrays import Array
from bayesid.model.effects import Phrase
from bayesid.model.inertia import NAMES, UNITS, about_centre_of_mass
from bayesid.model.parameters import Cone, Parameter
from bayesid.model.robot import Robot
from bayesid.model.terms.base import WholeRobotTerm
from bayesid.motion import Motion

_INERTIA, _FIRST_MOMENT = 0.03, 0.15
"""kg m^2 and kg m: of 1 kg at 0.15 m from the flange, and 1 kg (0.17 m)^2; round numbers for tools and workpieces."""


@dataclass(frozen=True, kw_only=True)
class Payload(WholeRobotTerm):
    """Ten inertial parameters of a body fixed to the last link, in that link's frame.

    Without an earlier model they cannot be separated from the last link's own.
    """

    name: ClassVar[str] = "payload"
    physics: ClassVar[str] = "A body held by the flange: inertia, Coriolis, centrifugal and gravity torques."
    reference: ClassVar[str] = "Atkeson, An, Hollerbach, Inertial parameters of manipulator loads and links, 1986"
    variable: ClassVar[str] = "load"
    shown_by: ClassVar[str] = "turning the wrist while the arm is stretched and at rest, then accelerating it"
    phrase: ClassVar[Phrase] = Phrase(
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

    of_links: ClassVar[bool] = True
    links_remark: ClassVar[str] = "{last} includes the payload."
    needs_earlier: ClassVar[bool] = True
    typical: ClassVar[tuple[float, ...]] = (*(_INERTIA,) * 6, *(_FIRST_MOMENT,) * 3, 1.0)
    typical_scales: ClassVar[tuple[float, ...]] = (0.1, 0.5, 3.0)  # kg

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Jxxp ... mp."""
        return tuple(
            Parameter(f"{name}p{robot.n_joints}", unit, robot.n_joints) for name, unit in zip(NAMES, UNITS, strict=True)
        )

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

    def link_parameters(self, robot: Robot, theta: Array) -> Array:
        """(n, 10) added to the last link, in whose frame they are."""
        return np.concatenate([np.zeros((robot.n_joints - 1, 10)), theta[None, :]])
