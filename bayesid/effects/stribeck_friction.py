"""Dry friction that falls as the lubricant's film builds up."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.coulomb_friction import DryTerm
from bayesid.effects.effect import Phrase, Scene
from bayesid.motion import Motion

_SLOW = 10.0
"""Stribeck speed over the speed of standstill, which is a hundredth of the highest, where no log is asked for it."""
_SPEEDS = (0.035, 0.06, 0.1, 0.17, 0.3)
"""Stribeck speeds tried, as shares of the joint's highest speed, each 1.7 times the last; refined in between."""


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
    shown_by: ClassVar[str] = "creeping both ways, far below the usual speeds"
    phrase: ClassVar[Phrase] = Phrase(
        "{who} needs dry friction that falls with speed: {Fk}, and near standstill {Fs} more, fading over {speed}.",
        "Stribeck friction",
    )
    shape_units: ClassVar[Mapping[str, str]] = {"speed": "rad/s"}
    symbols: ClassVar[tuple[str, ...]] = ("Fk", "Fs")
    adds_to: ClassVar[Mapping[str, str]] = {"Fk": "Fc"}
    units: ClassVar[tuple[tuple[str, str], ...]] = (("N m", "N"), ("N m", "N"))
    nonnegative: ClassVar[bool] = True

    @classmethod
    def shape_of_motion(cls, actuators: Motion) -> Mapping[str, tuple[float, ...]]:
        """With a Stribeck speed of a tenth of the highest speed."""
        speed = tuple((_SLOW * actuators.standstill_speed).tolist())
        return {**super().shape_of_motion(actuators), "speed": speed}

    @classmethod
    def shapes(cls, scene: Scene, joint: int) -> Iterator[Mapping[str, float]]:
        """Over the Stribeck speed."""
        top = float(scene.actuators.top_speed[joint])
        for share in _SPEEDS:
            yield {"smoothing": float(scene.actuators.standstill_speed[joint]), "speed": share * top}

    def unit_efforts(self, actuators: Motion) -> Array:
        """Kinetic friction, and what comes on top of it at low speed."""
        direction, slow = self.direction(actuators), np.exp(-((actuators.dq / np.array(self.speed)) ** 2))
        return np.stack([direction, slow * direction], axis=2)
