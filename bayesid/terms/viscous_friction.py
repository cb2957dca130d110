"""Viscous friction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bayesid.motion import Array, Motion
from bayesid.terms.base import ActuatorTerm


@dataclass(frozen=True, kw_only=True)
class ViscousFriction(ActuatorTerm):
    """Fv u', Fv >= 0."""

    name: ClassVar[str] = "viscous_friction"
    physics: ClassVar[str] = "Lubricant drag: a torque proportional to the actuator's speed and against it."
    reference: ClassVar[str] = "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 1994"
    variable: ClassVar[str] = "velocity"
    told_by: ClassVar[str] = "moving at several constant speeds, slow and fast"
    symbols: ClassVar[tuple[str, ...]] = ("Fv",)
    units: ClassVar[tuple[tuple[str, str], ...]] = (("N m s/rad", "N s/m"),)
    nonnegative: ClassVar[bool] = True

    def effect(self, actuators: Motion) -> Array:
        """The speed."""
        return actuators.dq
