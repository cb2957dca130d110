"""Constant torques."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Phrase
from bayesid.effects.term import ActuatorTerm
from bayesid.motion import Motion


@dataclass(frozen=True, kw_only=True)
class TorqueOffset(ActuatorTerm):
    """A constant, of either sign: a sensor's or drive's zero error, or friction that differs by direction."""

    name = "torque_offset"
    physics = "A constant torque: a zero error of sensor or drive, or friction that prefers a direction."
    reference = "Gautier, Dynamic identification of robots with power model, IEEE ICRA 1997"
    variable = "time"
    shown_by = "moving both ways through many positions"
    phrase = Phrase("{who} needs a torque offset of {offset}.", "a torque offset")
    symbols = ("offset",)
    units = (("N m", "N"),)

    def unit_efforts(self, actuators: Motion) -> Array:
        """One."""
        return np.ones(actuators.q.shape)
