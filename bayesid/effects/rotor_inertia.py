"""The motors' own inertia."""

from __future__ import annotations

from dataclasses import dataclass

from bayesid.arrays import Array
from bayesid.effects.effect import Phrase
from bayesid.effects.term import ActuatorTerm
from bayesid.motion import Motion


@dataclass(frozen=True, kw_only=True)
class RotorInertia(ActuatorTerm):
    """Ia u'', Ia >= 0: the rotor's inertia times the gear ratio squared, gyroscopic couples neglected."""

    name = "rotor_inertia"
    physics = "The motor's rotor, geared up: a torque proportional to the actuator's own acceleration."
    reference = "Khalil and Dombre, Modeling, Identification and Control of Robots, 2002"
    variable = "acceleration"
    shown_by = "accelerating one joint hard while the others rest, in several postures"
    phrase = Phrase("{who} needs a rotor inertia of {Ia}.", "rotor inertia")
    symbols = ("Ia",)
    units = (("kg m^2", "kg"),)
    nonnegative = True
    places = {"mjcf": ("armature",)}

    def unit_efforts(self, actuators: Motion) -> Array:
        """The acceleration."""
        return actuators.ddq
