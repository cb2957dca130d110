"""Dry friction that falls as the lubricant's film builds up."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.coulomb_friction import DryTerm
from bayesid.effects.effect import Phrase, Scene
from bayesid.effects.tuning import TUNING
from bayesid.motion import Motion


@dataclass(frozen=True, kw_only=True)
class StribeckFriction(DryTerm):
    """(Fk + Fs exp(-(u' / vs)^2)) tanh(u' / v); Fk, Fs >= 0: Fs is what dry friction loses from rest to speed.

    Args:
        speed: (m,) vs of each actuator, rad/s.
    """

    speed: tuple[float, ...]

    name = "stribeck_friction"
    physics = "Dry friction that is larger at low speed, until the lubricant's film carries."
    reference = "Bo and Pavelescu, Wear 1982; Armstrong-Helouvry et al., Automatica 1994"
    variable = "velocity"
    shown_by = "creeping both ways, far below the usual speeds"
    phrase = Phrase(
        "{who} needs dry friction that falls with speed: {Fk}, and near standstill {Fs} more, fading over {speed}.",
        "Stribeck friction",
    )
    shape_units = {"speed": "rad/s"}
    symbols = ("Fk", "Fs")
    adds_to = {"Fk": "Fc"}
    units = (("N m", "N"), ("N m", "N"))
    nonnegative = True

    @classmethod
    def shape_of_motion(cls, actuators: Motion) -> Mapping[str, tuple[float, ...]]:
        """With a Stribeck speed of a tenth of the highest speed."""
        speed = tuple((TUNING.stribeck_slow * actuators.standstill_speed).tolist())
        return {**super().shape_of_motion(actuators), "speed": speed}

    @classmethod
    def shapes(cls, scene: Scene, joint: int) -> Iterator[Mapping[str, float]]:
        """Over the Stribeck speed."""
        top = float(scene.actuators.top_speed[joint])
        for share in TUNING.stribeck_speeds:
            yield {"smoothing": float(scene.actuators.standstill_speed[joint]), "speed": share * top}

    def unit_efforts(self, actuators: Motion) -> Array:
        """Kinetic friction, and what comes on top of it at low speed."""
        direction, slow = self.direction(actuators), np.exp(-((actuators.dq / np.array(self.speed)) ** 2))
        return np.stack([direction, slow * direction], axis=2)
