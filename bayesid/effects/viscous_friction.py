"""Viscous friction."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Phrase, Scene
from bayesid.effects.term import ActuatorTerm
from bayesid.motion import Motion

_KNEES = (0.1, 0.2, 0.4, 0.7)
"""Speeds tried at which the drag saturates, as shares of the joint's highest speed, each some 2 times the last; refined
in between. A lower one is dry friction, a higher one viscous."""


@dataclass(frozen=True, kw_only=True)
class ViscousFriction(ActuatorTerm):
    """Fv u', Fv >= 0."""

    name: ClassVar[str] = "viscous_friction"
    physics: ClassVar[str] = "Lubricant drag: a torque proportional to the actuator's speed and against it."
    reference: ClassVar[str] = "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 1994"
    variable: ClassVar[str] = "velocity"
    shown_by: ClassVar[str] = "moving at several constant speeds, slow and fast"
    phrase: ClassVar[Phrase] = Phrase("{who} needs viscous friction of {Fv}.", "viscous friction")
    symbols: ClassVar[tuple[str, ...]] = ("Fv",)
    units: ClassVar[tuple[tuple[str, str], ...]] = (("N m s/rad", "N s/m"),)
    nonnegative: ClassVar[bool] = True
    places: ClassVar[Mapping[str, tuple[str, ...]]] = {"urdf": ("damping",), "mjcf": ("damping",)}

    def unit_efforts(self, actuators: Motion) -> Array:
        """The speed."""
        return actuators.dq


@dataclass(frozen=True, kw_only=True)
class SaturatingFriction(ActuatorTerm):
    """Fe tanh(u' / ve), Fe >= 0: with dry and viscous friction beside it, friction that rises ever more slowly.

    Args:
        knee: (m,) ve of each actuator, rad/s.
    """

    knee: tuple[float, ...]

    name: ClassVar[str] = "viscous_friction.saturating"
    physics: ClassVar[str] = "Lubricant drag that saturates with speed: the film shears thin or grows warm."
    reference: ClassVar[str] = "Waiboer, Aarts, Jonker, Velocity dependence of joint friction in manipulators, 2005"
    variable: ClassVar[str] = "velocity"
    shown_by: ClassVar[str] = ViscousFriction.shown_by
    phrase: ClassVar[Phrase] = Phrase(
        "{who} needs viscous friction that saturates: {Fe} beyond {knee}.", "saturating viscous friction"
    )
    refines: ClassVar[bool] = True
    shape_units: ClassVar[Mapping[str, str]] = {"knee": "rad/s"}
    symbols: ClassVar[tuple[str, ...]] = ("Fe",)
    units: ClassVar[tuple[tuple[str, str], ...]] = (("N m", "N"),)
    nonnegative: ClassVar[bool] = True

    @classmethod
    def shapes(cls, scene: Scene, joint: int) -> Iterator[Mapping[str, float]]:
        """Over the speed at which it saturates."""
        top = float(scene.actuators.top_speed[joint])
        yield from ({"knee": share * top} for share in _KNEES)

    def unit_efforts(self, actuators: Motion) -> Array:
        """The direction of motion, smoothed over a wide range of speeds."""
        return np.tanh(actuators.dq / np.array(self.knee))
