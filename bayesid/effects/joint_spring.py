"""A spring across a joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Phrase
from bayesid.effects.parameters import Cone
from bayesid.effects.term import ActuatorTerm
from bayesid.motion import Motion
from bayesid.robot import Robot


@dataclass(frozen=True, kw_only=True)
class JointSpring(ActuatorTerm):
    """k u + k0, k >= 0: a spring that is relaxed at u = -k0 / k."""

    name = "joint_spring"
    physics = "A spring across the joint: a torque proportional to the actuator's position."
    reference = "Hooke's law"
    variable = "position"
    shown_by = "holding still, or moving slowly, over the whole range of the joint"
    phrase = Phrase("{who} needs a spring of {k}, with {k0} at position zero.", "a joint spring")
    symbols = ("k", "k0_")
    units = (("N m/rad", "N/m"), ("N m", "N"))
    places = {"mjcf": ("stiffness", "preload")}

    def cone(self, robot: Robot) -> Cone:
        """Only the stiffness must not be negative."""
        size = 2 * len(self.acting(robot.n_joints))
        return Cone(size, np.arange(0, size, 2), np.empty((0, 10), dtype=np.int64))

    def unit_efforts(self, actuators: Motion) -> Array:
        """The position, and one."""
        return np.stack([actuators.q, np.ones_like(actuators.q)], axis=2)
