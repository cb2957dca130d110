"""The motors' own inertia."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bayesid.motion import Array, Motion
from bayesid.terms.base import ActuatorTerm


@dataclass(frozen=True, kw_only=True)
class RotorInertia(ActuatorTerm):
    """Ia u'', Ia >= 0: the rotor's inertia times the gear ratio squared, gyroscopic couples neglected."""

    name: ClassVar[str] = "rotor_inertia"
    physics: ClassVar[str] = "The motor's rotor, geared up: a torque proportional to the actuator's own acceleration."
    reference: ClassVar[str] = "Khalil and Dombre, Modeling, Identification and Control of Robots, 2002"
    variable: ClassVar[str] = "acceleration"
    told_by: ClassVar[str] = "accelerating one joint hard while the others rest, in several postures"
    symbols: ClassVar[tuple[str, ...]] = ("Ia",)
    units: ClassVar[tuple[tuple[str, str], ...]] = (("kg m^2", "kg"),)
    nonnegative: ClassVar[bool] = True

    def effect(self, actuators: Motion) -> Array:
        """The acceleration."""
        return actuators.ddq
