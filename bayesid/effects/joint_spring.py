"""A spring across a joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

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

    name: ClassVar[str] = "joint_spring"
    physics: ClassVar[str] = "A spring across the joint: a torque proportional to the actuator's position."
    reference: ClassVar[str] = "Hooke's law"
    variable: ClassVar[str] = "position"
    shown_by: ClassVar[str] = "holding still, or moving slowly, over the whole range of the joint"
    phrase: ClassVar[Phrase] = Phrase("{who} needs a spring of {k}, with {k0} at position zero.", "a joint spring")
    symbols: ClassVar[tuple[str, ...]] = ("k", "k0_")
    units: ClassVar[tuple[tuple[str, str], ...]] = (("N m/rad", "N/m"), ("N m", "N"))
    places: ClassVar[Mapping[str, tuple[str, ...]]] = {"mjcf": ("stiffness", "preload")}

    def cone(self, robot: Robot) -> Cone:
        """Only the stiffness must not be negative."""
        size = 2 * len(self.acting(robot.n_joints))
        return Cone(size, np.arange(0, size, 2), np.empty((0, 10), dtype=np.int64))

    def unit_efforts(self, actuators: Motion) -> Array:
        """The position, and one."""
        return np.stack([actuators.q, np.ones_like(actuators.q)], axis=2)
