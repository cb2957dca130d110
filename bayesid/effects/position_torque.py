"""Torque that depends on the angle of its own joint and that no rigid body explains: an error of its sensor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Phrase
from bayesid.effects.parameters import Coefficient
from bayesid.effects.term import ActuatorTerm
from bayesid.motion import Motion

_HARMONICS = (1, 2, 3)


class PositionTorque(ActuatorTerm):
    """Sum over h = 1, 2, 3 of a_h sin(h u) + b_h cos(h u): a periodic error of a joint torque sensor.

    Strain gauges on the flexspline of a harmonic drive err with its angle: Hashimoto, Kiyosawa, Paul, IEEE Transactions
    on Robotics and Automation, 1993.
    """

    name = "position_torque"
    shown_by = "moving slowly over the whole range of the joint, both ways"
    phrase = Phrase(
        "{who} needs a torque of its own position: sine and cosine of {ps1} and {pc1}, of twice the angle {ps2} and "
        "{pc2}, of three times {ps3} and {pc3}.",
        "a torque of the joint's own position",
    )
    coefficients = tuple(Coefficient(f"p{wave}{h}_", "N m") for h in _HARMONICS for wave in "sc")

    def unit_efforts(self, actuators: Motion) -> Sequence[Array]:
        return [wave(h * actuators.q) for h in _HARMONICS for wave in (np.sin, np.cos)]
