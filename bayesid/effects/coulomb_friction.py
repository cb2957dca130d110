"""Coulomb friction."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Phrase, Scene
from bayesid.effects.term import ActuatorTerm
from bayesid.motion import Motion


@dataclass(frozen=True, kw_only=True)
class DryTerm(ActuatorTerm):
    """Base of the effects in which the direction of motion enters, smoothed as tanh(u' / v).

    Args:
        smoothing: (m,) v of each actuator, rad/s: the speed below which a log does not show friction's direction.
    """

    smoothing: tuple[float, ...]

    given: ClassVar[tuple[str, ...]] = ("smoothing",)

    @classmethod
    def shape_of_motion(cls, actuators: Motion) -> Mapping[str, tuple[float, ...]]:
        """Smoothed over what counts as standstill in this log."""
        return {"smoothing": tuple(actuators.standstill_speed.tolist())}

    @classmethod
    def shapes(cls, scene: Scene, joint: int) -> Iterator[Mapping[str, float]]:
        """Smoothed over what counts as standstill in this log."""
        yield {"smoothing": float(scene.actuators.standstill_speed[joint])}

    def direction(self, actuators: Motion) -> Array:
        """(N, m) the smoothed direction of motion, between -1 and 1."""
        direction: Array = np.tanh(actuators.dq / self._speeds)
        return direction

    @cached_property
    def _speeds(self) -> Array:
        return np.array(self.smoothing)


@dataclass(frozen=True, kw_only=True)
class CoulombFriction(DryTerm):
    """Fc tanh(u' / v), Fc >= 0."""

    name = "coulomb_friction"
    physics = "Dry friction: a torque of constant size against the direction of motion."
    reference = "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 1994"
    variable = "velocity"
    shown_by = "moving both ways at several speeds, with many reversals"
    phrase = Phrase("{who} needs Coulomb friction of {Fc}.", "Coulomb friction")
    symbols = ("Fc",)
    units = (("N m", "N"),)
    nonnegative = True
    places = {"urdf": ("friction",), "mjcf": ("frictionloss",)}

    def unit_efforts(self, actuators: Motion) -> Array:
        """The direction of motion."""
        return self.direction(actuators)
