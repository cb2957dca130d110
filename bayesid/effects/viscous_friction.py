"""Viscous friction."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Phrase, Scene
from bayesid.effects.term import ActuatorTerm
from bayesid.effects.tuning import TUNING
from bayesid.motion import Motion


@dataclass(frozen=True, kw_only=True)
class ViscousFriction(ActuatorTerm):
    """Fv u', Fv >= 0."""

    name = "viscous_friction"
    physics = "Lubricant drag: a torque proportional to the actuator's speed and against it."
    reference = "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 1994"
    variable = "velocity"
    shown_by = "moving at several constant speeds, slow and fast"
    phrase = Phrase("{who} needs viscous friction of {Fv}.", "viscous friction")
    symbols = ("Fv",)
    units = (("N m s/rad", "N s/m"),)
    nonnegative = True
    places = {"urdf": ("damping",), "mjcf": ("damping",)}

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

    name = "viscous_friction.saturating"
    physics = "Lubricant drag that saturates with speed: the film shears thin or grows warm."
    reference = "Waiboer, Aarts, Jonker, Velocity dependence of joint friction in manipulators, 2005"
    variable = "velocity"
    shown_by = ViscousFriction.shown_by
    phrase = Phrase("{who} needs viscous friction that saturates: {Fe} beyond {knee}.", "saturating viscous friction")
    refines = True
    shape_units = {"knee": "rad/s"}
    symbols = ("Fe",)
    units = (("N m", "N"),)
    nonnegative = True

    @classmethod
    def shapes(cls, scene: Scene, joint: int) -> Iterator[Mapping[str, float]]:
        """Over the speed at which it saturates."""
        top = float(scene.actuators.top_speed[joint])
        yield from ({"knee": share * top} for share in TUNING.knees)

    def unit_efforts(self, actuators: Motion) -> Array:
        """The direction of motion, smoothed over a wide range of speeds."""
        return np.tanh(actuators.dq / np.array(self.knee))
