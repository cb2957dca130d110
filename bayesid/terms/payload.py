"""A body on the last link."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

from bayesid.inertia import NAMES, UNITS
from bayesid.motion import Array, Motion
from bayesid.robot import Robot
from bayesid.terms.base import Cone, Parameter, Scene


@dataclass(frozen=True)
class Payload:
    """Ten inertial parameters of a body fixed to the last link, in that link's frame.

    Without an earlier model they cannot be told from the last link's own.
    """

    name: ClassVar[str] = "payload"
    physics: ClassVar[str] = "A body held by the flange: inertia, Coriolis, centrifugal and gravity torques."
    reference: ClassVar[str] = "Atkeson, An, Hollerbach, Inertial parameters of manipulator loads and links, 1986"
    variable: ClassVar[str] = "load"
    told_by: ClassVar[str] = "turning the wrist while the arm is stretched and at rest, then accelerating it"
    memory: ClassVar[bool] = False

    @classmethod
    def for_motion(cls, actuators: Motion) -> Self:
        """The same for every log."""
        return cls()

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """One."""
        yield cls()

    @property
    def joints(self) -> tuple[int, ...]:
        """It acts on all of them."""
        return ()

    @property
    def shape(self) -> Mapping[str, list[float]]:
        """No nonlinear numbers."""
        return {}

    def check(self, n_joints: int) -> None:
        """Suits every robot."""

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
