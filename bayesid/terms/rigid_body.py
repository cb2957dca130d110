"""Rigid links: inertia, Coriolis, centrifugal and gravity torques."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Self

from bayesid.inertia import NAMES, UNITS
from bayesid.motion import Array, Motion
from bayesid.robot import Robot
from bayesid.terms.base import Cone, Parameter, Scene, WholeRobotTerm


def _parameter_name(symbol: str, link: int) -> str:
    """Jxx of link 2 is J2xx, mcx is mc2x, m is m2, as in the literature."""
    stem = symbol.rstrip("xyz")
    return f"{stem}{link}{symbol[len(stem):]}"


@dataclass(frozen=True)
class RigidBody(WholeRobotTerm):
    """Ten inertial parameters a link (`bayesid.inertia`), linear in the torque (Atkeson, An, Hollerbach 1986)."""

    name: ClassVar[str] = "rigid_body"
    physics: ClassVar[str] = "Rigid links: inertia, Coriolis, centrifugal and gravity torques, ten parameters each."
    reference: ClassVar[str] = "Atkeson, An, Hollerbach, IJRR 1986"
    variable: ClassVar[str] = "load"
    told_by: ClassVar[str] = "an exciting trajectory"

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """None: it is what the others are missing from."""
        yield from ()

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Ten a link, from base to tip."""
        links = range(1, robot.n_joints + 1)
        pairs = list(zip(NAMES, UNITS, strict=True))
        return tuple(Parameter(_parameter_name(name, i), unit, i) for i in links for name, unit in pairs)

    def cone(self, robot: Robot) -> Cone:
        """One positive semidefinite pseudo-inertia a link."""
        return Cone.rigid_bodies(robot.n_joints)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(N, n, 10 n) Newton-Euler regressor."""
        return robot.regressor(motion)
