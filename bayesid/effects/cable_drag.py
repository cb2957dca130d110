"""Cables and hoses along the arm."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.coulomb_friction import DryTerm
from bayesid.effects.effect import Phrase, Scene
from bayesid.effects.parameters import Cone
from bayesid.effects.term import ActuatorTerm
from bayesid.effects.tuning import TUNING
from bayesid.motion import Motion
from bayesid.robot import Robot

_SHOWN_BY = "moving slowly over the whole range of the joint, both ways"


def _places(scene: Scene, joint: int, count: int) -> list[float]:
    """Positions over the middle of a joint's range."""
    return [float(x) for x in np.percentile(scene.actuators.q[:, joint], np.linspace(*TUNING.cable_middle, count))]


@dataclass(frozen=True, kw_only=True)
class CableDrag(ActuatorTerm):
    """k max(0, u - u0) beyond a position, or k min(0, u - u0) below it, k >= 0.

    Args:
        start: (m,) u0 of each actuator, rad.
        side: (m,) 1 for beyond, -1 for below.
    """

    start: tuple[float, ...]
    side: tuple[float, ...]

    name = "cable_drag"
    physics = "A cable or hose that is slack up to a position and pulls like a spring beyond it."
    reference = "Hooke's law for a body that carries no compression"
    variable = "position"
    shown_by = _SHOWN_BY
    phrase = Phrase(
        "{who} needs a cable that pulls with {kd} beyond {start}.",
        "cable drag",
        size="side",
        opposite="{who} needs a cable that pulls with {kd} below {start}.",
    )
    shape_units = {"start": "rad"}
    symbols = ("kd",)
    units = (("N m/rad", "N/m"),)
    nonnegative = True

    @classmethod
    def shapes(cls, scene: Scene, joint: int) -> Iterator[Mapping[str, float]]:
        """Over the position at which the cable begins to pull."""
        for start in _places(scene, joint, TUNING.cable_starts):
            yield from ({"start": start, "side": side} for side in (1.0, -1.0))

    def unit_efforts(self, actuators: Motion) -> Array:
        """How far the cable is stretched."""
        side = np.array(self.side)
        return side * np.maximum(side * (actuators.q - np.array(self.start)), 0.0)


@dataclass(frozen=True, kw_only=True)
class CableFriction(DryTerm):
    """Fd |u - u0| tanh(u' / v), Fd >= 0: a dress pack that rubs the more, the more it is bent.

    Args:
        start: (m,) u0 of each actuator, rad.
    """

    start: tuple[float, ...]

    name = "cable_drag.friction"
    physics = "A dress pack that rubs the more, the more it is bent."
    reference = "Coulomb friction under a normal force that grows with the bending"
    variable = "position"
    shown_by = _SHOWN_BY
    phrase = Phrase("{who} needs a dress pack that rubs with {Fd} of bending, straight at {start}.")
    shape_units = {"start": "rad"}
    symbols = ("Fd",)
    units = (("N m/rad", "N/m"),)
    nonnegative = True

    @classmethod
    def shapes(cls, scene: Scene, joint: int) -> Iterator[Mapping[str, float]]:
        """Over the position at which the pack is straight."""
        for start in _places(scene, joint, TUNING.cable_centres):
            yield {"smoothing": float(scene.actuators.standstill_speed[joint]), "start": start}

    def unit_efforts(self, actuators: Motion) -> Array:
        """How far the pack is bent, times the direction of motion."""
        return np.abs(actuators.q - np.array(self.start)) * self.direction(actuators)


@dataclass(frozen=True, kw_only=True)
class CableStiffening(ActuatorTerm):
    """k1 (u - u0) + k3 (u - u0)^3 with k3 >= 0: a cable that stiffens as it is bent.

    Args:
        start: (m,) u0 of each actuator, rad.
    """

    start: tuple[float, ...]

    name = "cable_drag.stiffening"
    physics = "A cable that stiffens as it is bent, so that its torque grows with the cube."
    reference = "Duffing's spring"
    variable = "position"
    shown_by = _SHOWN_BY
    phrase = Phrase("{who} needs a cable that stiffens when bent, {kd1} and {kd3}, relaxed at {start}.")
    shape_units = {"start": "rad"}
    symbols = ("kd3_", "kd1_")
    units = (("N m/rad^3", "N/m^3"), ("N m/rad", "N/m"))

    @classmethod
    def shapes(cls, scene: Scene, joint: int) -> Iterator[Mapping[str, float]]:
        """Over the position at which the cable is relaxed."""
        yield from ({"start": start} for start in _places(scene, joint, TUNING.cable_centres))

    def cone(self, robot: Robot) -> Cone:
        """Only the cube's factor must not be negative."""
        size = 2 * len(self.acting(robot.n_joints))
        return Cone(size, np.arange(0, size, 2), np.empty((0, 10), dtype=np.int64))

    def unit_efforts(self, actuators: Motion) -> Array:
        """The cube of the bending, and the bending."""
        bent = actuators.q - np.array(self.start)
        return np.stack([bent**3, bent], axis=2)
