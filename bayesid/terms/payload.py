"""A body on the last link."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bayesid.inertia import NAMES, UNITS
from bayesid.motion import Array, Motion
from bayesid.robot import Robot
from bayesid.terms.base import Cone, Parameter, WholeRobotTerm


@dataclass(frozen=True)
class Payload(WholeRobotTerm):
    """Ten inertial parameters of a body fixed to the last link, in that link's frame.

    Without an earlier model they cannot be told from the last link's own.
    """

    name: ClassVar[str] = "payload"
    physics: ClassVar[str] = "A body held by the flange: inertia, Coriolis, centrifugal and gravity torques."
    reference: ClassVar[str] = "Atkeson, An, Hollerbach, Inertial parameters of manipulator loads and links, 1986"
    variable: ClassVar[str] = "load"
    told_by: ClassVar[str] = "turning the wrist while the arm is stretched and at rest, then accelerating it"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Jxxp ... mp."""
        return tuple(
            Parameter(f"{name}p{robot.n_joints}", unit, robot.n_joints) for name, unit in zip(NAMES, UNITS, strict=True)
        )

    def cone(self, robot: Robot) -> Cone:
        """A positive semidefinite pseudo-inertia."""
        return Cone.rigid_bodies(1)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(N, n, 10) those of the last link."""
        return robot.regressor(motion)[:, :, -10:]
