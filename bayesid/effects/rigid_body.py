"""Rigid links: inertia, Coriolis, centrifugal and gravity torques."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

from bayesid.arrays import Array
from bayesid.effects.effect import Scene
from bayesid.effects.parameters import Cone, Parameter
from bayesid.effects.term import WholeRobotTerm
from bayesid.motion import Motion
from bayesid.robot import Robot
from bayesid.robot.inertia import NAMES, UNITS


def _parameter_name(symbol: str, link: int) -> str:
    """Jxx of link 2 is J2xx, mcx is mc2x, m is m2, as in the literature."""
    stem = symbol.rstrip("xyz")
    return f"{stem}{link}{symbol[len(stem) :]}"


@dataclass(frozen=True, kw_only=True)
class RigidBody(WholeRobotTerm):
    """Ten inertial parameters a link (`bayesid.robot.inertia`), linear in the torque (Atkeson, An, Hollerbach 1986)."""

    name = "rigid_body"
    physics = "Rigid links: inertia, Coriolis, centrifugal and gravity torques, ten parameters each."
    reference = "Atkeson, An, Hollerbach, IJRR 1986"
    variable = "load"
    shown_by = "an exciting trajectory"

    can_be_missing = False
    of_links = True

    @classmethod
    def variants(cls, scene: Scene) -> Iterable[Self]:
        """None: it is what the others are missing from."""
        return ()

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

    def effort(self, robot: Robot, motion: Motion, theta: Array) -> Array:
        """(N, n) by recursive Newton-Euler."""
        return robot.inverse_dynamics(motion, theta)

    def link_parameters(self, robot: Robot, theta: Array) -> Array:
        """(n, 10) the parameters themselves."""
        return theta.reshape(-1, 10)
