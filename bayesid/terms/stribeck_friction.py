"""Dry friction that falls as the lubricant's film builds up."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from bayesid.motion import Array, Motion
from bayesid.terms.base import Scene
from bayesid.terms.coulomb_friction import DryTerm

_SPEEDS = (0.035, 0.06, 0.1, 0.17, 0.3)
"""Stribeck speeds tried, as shares of the joint's highest speed."""


@dataclass(frozen=True, kw_only=True)
class StribeckFriction(DryTerm):
    """(Fk + Fs exp(-(u' / vs)^2)) tanh(u' / v); Fk, Fs >= 0: Fs is what dry friction loses from rest to speed.

    Args:
        speed: (m,) vs of each actuator, rad/s.
    """

    speed: tuple[float, ...]

    name: ClassVar[str] = "stribeck_friction"
    physics: ClassVar[str] = "Dry friction that is larger at low speed, until the lubricant's film carries."
    reference: ClassVar[str] = "Bo and Pavelescu, Wear 1982; Armstrong-Helouvry et al., Automatica 1994"
    variable: ClassVar[str] = "velocity"
    told_by: ClassVar[str] = "creeping both ways, far below the usual speeds"
    shape_units: ClassVar[Mapping[str, str]] = {"speed": "rad/s"}
    symbols: ClassVar[tuple[str, ...]] = ("Fk", "Fs")
    units: ClassVar[tuple[tuple[str, str], ...]] = (("N m", "N"), ("N m", "N"))
    nonnegative: ClassVar[bool] = True

    @classmethod
    def for_motion(cls, actuators: Motion) -> Self:
        """With a Stribeck speed of a tenth of the highest speed."""
        at_rest = actuators.standstill_speed
        return cls(smoothing=tuple(at_rest.tolist()), speed=tuple((10.0 * at_rest).tolist()))

    @classmethod
    def shapes(cls, scene: Scene, joint: int) -> Iterator[Mapping[str, float]]:
        """Over the Stribeck speed."""
        top = float(np.abs(scene.actuators.dq[:, joint]).max())
        for share in _SPEEDS:
            yield {"smoothing": float(scene.actuators.standstill_speed[joint]), "speed": share * top}

    def effect(self, actuators: Motion) -> Array:
        """Kinetic friction, and what comes on top of it at low speed."""
        direction, slow = self.direction(actuators), np.exp(-((actuators.dq / np.array(self.speed)) ** 2))
        return np.stack([direction, slow * direction], axis=2)
