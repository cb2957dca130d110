"""The motors' own inertia."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from bayesid.arrays import Array
from bayesid.effects.effect import Phrase
from bayesid.effects.term import ActuatorTerm
from bayesid.motion import Motion


@dataclass(frozen=True, kw_only=True)
class RotorInertia(ActuatorTerm):
    """Ia u'', Ia >= 0: the rotor's inertia times the gear ratio squared, gyroscopic couples neglected."""

    name: ClassVar[str] = "rotor_inertia"
    physics: ClassVar[str] = "The motor's rotor, geared up: a torque proportional to the actuator's own acceleration."
    reference: ClassVar[str] = "Khalil and Dombre, Modeling, Identification and Control of Robots, 2002"
    variable: ClassVar[str] = "acceleration"
    shown_by: ClassVar[str] = "accelerating one joint hard while the others rest, in several postures"
    phrase: ClassVar[Phrase] = Phrase("{who} needs a rotor inertia of {Ia}.", "rotor inertia")
    symbols: ClassVar[tuple[str, ...]] = ("Ia",)
    units: ClassVar[tuple[tuple[str, str], ...]] = (("kg m^2", "kg"),)
    nonnegative: ClassVar[bool] = True
    places: ClassVar[Mapping[str, tuple[str, ...]]] = {"mjcf": ("armature",)}

    def unit_efforts(self, actuators: Motion) -> Array:
        """The acceleration."""
        return actuators.ddq
