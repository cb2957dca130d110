"""Viscous friction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from bayesid.arrays import Array
from bayesid.model.effects import Phrase
from bayesid.model.terms.base import ActuatorTerm
from bayesid.motion import Motion


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
