"""Friction in the actuators."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from bayesid.motion import Array, Motion
from bayesid.terms.base import ActuatorTerm


@dataclass(frozen=True)
class ViscousFriction(ActuatorTerm):
    """Fv u', Fv >= 0."""

    name: ClassVar[str] = "viscous_friction"
    physics: ClassVar[str] = "Lubricant drag: a torque proportional to the actuator's speed and against it."
    symbol: ClassVar[str] = "Fv"
    units: ClassVar[tuple[str, str]] = ("N m s/rad", "N s/m")
    nonnegative: ClassVar[bool] = True

    def effect(self, actuators: Motion) -> Array:
        """The speed."""
        return actuators.dq


@dataclass(frozen=True)
class CoulombFriction(ActuatorTerm):
    """Fc tanh(u' / v), Fc >= 0: dry friction, its step smoothed over the speed v below which a log cannot tell.

    Args:
        smoothing: (n,) v of each actuator, rad/s.
    """

    smoothing: tuple[float, ...]

    name: ClassVar[str] = "coulomb_friction"
    physics: ClassVar[str] = "Dry friction: a torque of constant size against the direction of motion."
    symbol: ClassVar[str] = "Fc"
    units: ClassVar[tuple[str, str]] = ("N m", "N")
    nonnegative: ClassVar[bool] = True

    @classmethod
    def for_motion(cls, actuators: Motion) -> Self:
        """Smoothed over what counts as standstill in this log."""
        return cls(tuple(actuators.standstill_speed.tolist()))

    @property
    def shape(self) -> Mapping[str, list[float]]:
        """The smoothing speeds, rad/s."""
        return {"smoothing": list(self.smoothing)}

    def effect(self, actuators: Motion) -> Array:
        """The smoothed direction of motion, between -1 and 1."""
        return np.tanh(actuators.dq / np.array(self.smoothing))
