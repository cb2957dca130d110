"""Friction and offsets that change as a joint warms up."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.coulomb_friction import DryTerm
from bayesid.effects.effect import Phrase, Scene
from bayesid.effects.term import ActuatorTerm
from bayesid.effects.tuning import TUNING
from bayesid.motion import Motion

_SHOWN_BY = "repeating the same motion from cold to warm"
_REFERENCE = "First-order warming; Simoni, Beschi, Legnani, Visioli, Friction modeling with temperature effects, 2015"


def _since_start(actuators: Motion, time: tuple[float, ...]) -> Array:
    """(N, m) 1 - exp(-(t - t0) / T): 0 when the recording begins, 1 when the joint is warm."""
    return 1.0 - np.exp(-(actuators.t[:, None] - actuators.origin) / np.array(time))


def _times(scene: Scene) -> list[float]:
    return [share * float(scene.motion.t[-1] - scene.motion.origin) for share in TUNING.warming_times]


@dataclass(frozen=True, kw_only=True)
class ThermalDrift(DryTerm):
    """(F0 + F1 (1 - exp(-t / T))) tanh(u' / v): dry friction that changes from cold to warm.

    Args:
        time: (m,) T of each actuator, s.
    """

    time: tuple[float, ...]

    name = "thermal_drift"
    physics = "Dry friction that changes as gear and lubricant warm up."
    reference = _REFERENCE
    variable = "time"
    shown_by = _SHOWN_BY
    phrase = Phrase(
        "{who} needs dry friction of {Fcold} that changes by {Fwarm} as it warms up, over {time}.", "thermal drift"
    )
    shape_units = {"time": "s"}
    symbols: ClassVar[tuple[str, ...]] = ("Fcold", "Fwarm")
    adds_to = {"Fcold": "Fc"}
    units: ClassVar[tuple[tuple[str, str], ...]] = (("N m", "N"), ("N m", "N"))

    @classmethod
    def shapes(cls, scene: Scene, joint: int) -> Iterator[Mapping[str, float]]:
        """Over the time constant."""
        smoothing = float(scene.actuators.standstill_speed[joint])
        yield from ({"smoothing": smoothing, "time": time} for time in _times(scene))

    def unit_efforts(self, actuators: Motion) -> Array:
        """Direction of motion, at first and as it warms."""
        direction = self.direction(actuators)
        return np.stack([direction, _since_start(actuators, self.time) * direction], axis=2)


@dataclass(frozen=True, kw_only=True)
class ViscousThermalDrift(ActuatorTerm):
    """(f0 + f1 (1 - exp(-t / T))) u': viscous friction that changes from cold to warm.

    Args:
        time: (m,) T of each actuator, s.
    """

    time: tuple[float, ...]

    name = "thermal_drift.viscous"
    physics = "Viscous friction that changes as the lubricant warms up."
    reference = _REFERENCE
    variable = "time"
    shown_by = _SHOWN_BY
    phrase = Phrase("{who} needs viscous friction of {fcold} that changes by {fwarm} as it warms up, over {time}.")
    shape_units = {"time": "s"}
    symbols = ("fcold", "fwarm")
    adds_to = {"fcold": "Fv"}
    units = (("N m s/rad", "N s/m"),) * 2

    @classmethod
    def shapes(cls, scene: Scene, joint: int) -> Iterator[Mapping[str, float]]:
        """Over the time constant."""
        yield from ({"time": time} for time in _times(scene))

    def unit_efforts(self, actuators: Motion) -> Array:
        """The speed, at first and as it warms."""
        return np.stack([actuators.dq, _since_start(actuators, self.time) * actuators.dq], axis=2)


@dataclass(frozen=True, kw_only=True)
class FrictionThermalDrift(ThermalDrift):
    """Both: dry and viscous friction that change from cold to warm."""

    name = "thermal_drift.both"
    physics = "Dry and viscous friction that change as gear and lubricant warm up."
    phrase = Phrase(
        "{who} needs friction that changes as it warms up, over {time}: dry friction of {Fcold2} by "
        "{Fwarm2}, and viscous friction of {fcold2} by {fwarm2}."
    )
    symbols = ("Fcold2_", "Fwarm2_", "fcold2_", "fwarm2_")
    adds_to = {"Fcold2_": "Fc", "fcold2_": "Fv"}
    units = (("N m", "N"), ("N m", "N"), *ViscousThermalDrift.units)

    def unit_efforts(self, actuators: Motion) -> Array:
        """Direction and speed, at first and as they warm."""
        warm, parts = _since_start(actuators, self.time), (self.direction(actuators), actuators.dq)
        return np.stack([factor * part for part in parts for factor in (np.ones_like(warm), warm)], axis=2)


@dataclass(frozen=True, kw_only=True)
class OffsetThermalDrift(ViscousThermalDrift):
    """o0 + o1 (1 - exp(-t / T)): a sensor's or drive's zero that drifts."""

    name = "thermal_drift.offset"
    physics = "A zero of sensor or drive that drifts as it warms up."
    phrase = Phrase("{who} needs a zero error of {ocold} that drifts by {owarm} as it warms up, over {time}.")
    symbols = ("ocold", "owarm")
    adds_to = {"ocold": "offset"}
    units = (("N m", "N"), ("N m", "N"))

    def unit_efforts(self, actuators: Motion) -> Array:
        """One, at first and as it warms."""
        warm = _since_start(actuators, self.time)
        return np.stack([np.ones_like(warm), warm], axis=2)
