"""A spring that balances gravity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Phrase
from bayesid.effects.term import ActuatorTerm
from bayesid.motion import Motion


@dataclass(frozen=True, kw_only=True)
class GravitySpring(ActuatorTerm):
    """ks sin(u) + kc cos(u), free: a spring between two points off the axis, of zero free length."""

    name = "gravity_spring"
    physics = "A balancing spring between two points off the axis: a sine of the actuator's position."
    reference = "Balancing with springs of zero free length: Herder, Energy-Free Systems, 2001"
    variable = "position"
    shown_by = "moving the joint slowly over a large range in several postures of the joints before it"
    phrase = Phrase(
        "{who} needs a balancing spring: {ks} times the sine of its position and {kc} times the cosine.",
        "a balancing spring",
    )
    symbols = ("ks", "kc")
    units = (("N m", "N"), ("N m", "N"))

    def unit_efforts(self, actuators: Motion) -> Array:
        """Sine and cosine of the position."""
        return np.stack([np.sin(actuators.q), np.cos(actuators.q)], axis=2)


@dataclass(frozen=True, kw_only=True)
class StiffGravitySpring(ActuatorTerm):
    """The same with a free length: its torque (1 - l0 / l(u)) sin(u - u0) to the second harmonic."""

    name = "gravity_spring.free_length"
    physics = "A balancing spring with a free length: two harmonics of the actuator's position."
    reference = "Law of cosines for the spring's length, expanded to the second harmonic"
    variable = "position"
    shown_by = GravitySpring.shown_by
    phrase = Phrase(
        "{who} needs a balancing spring with a free length: {ks1} and {kc1} times the sine and cosine of its "
        "position, {ks2} and {kc2} times those of twice the position."
    )
    symbols = ("ks1_", "kc1_", "ks2_", "kc2_")
    units = (("N m", "N"),) * 4

    def unit_efforts(self, actuators: Motion) -> Array:
        """Sines and cosines of the position and of its double."""
        return np.stack([wave(h * actuators.q) for h in (1.0, 2.0) for wave in (np.sin, np.cos)], axis=2)
