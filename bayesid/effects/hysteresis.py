"""Dry friction that builds up over a way."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import accumulate, islice
from typing import ClassVar

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Phrase, Scene
from bayesid.effects.term import ActuatorTerm
from bayesid.effects.tuning import TUNING
from bayesid.motion import Motion


@dataclass(frozen=True, kw_only=True)
class Hysteresis(ActuatorTerm):
    """Fh z, Fh >= 0, with z' = u' / w held between -1 and 1: an elastic element that slips (Maxwell, Prandtl).

    Args:
        width: (m,) w of each actuator: the way from rest to slipping, rad.
    """

    width: tuple[float, ...]

    name = "hysteresis"
    physics = "Presliding: teeth and seals give way elastically before they slip, so friction lags."
    reference = "Al-Bender, Lampaert, Swevers, The generalized Maxwell-slip model, IEEE TAC 2005"
    variable = "position"
    shown_by = "small strokes back and forth, of a few hundredths of a radian"
    phrase = Phrase("{who} needs presliding friction of {Fh} that builds up over {width}.", "presliding hysteresis")
    shape_units = {"width": "rad"}
    symbols: ClassVar[tuple[str, ...]] = ("Fh",)
    units: ClassVar[tuple[tuple[str, str], ...]] = (("N m", "N"),)
    nonnegative = True
    memory = True

    @classmethod
    def shapes(cls, scene: Scene, joint: int) -> Iterator[Mapping[str, float]]:
        """Over the way."""
        largest = 0.5 * float(np.ptp(scene.actuators.q[:, joint]))
        yield from ({"width": width} for width in TUNING.hysteresis_widths if width < largest)

    def resolved(self, scene: Scene) -> bool:
        """Whether the way takes a few samples at the usual speed: a shorter one is but a step, or a small delay."""
        period = float(np.median(np.diff(scene.motion.t)))
        usual = np.percentile(np.abs(scene.actuators.dq), TUNING.usual_speed, axis=0)[self.acting(scene.robot.n_joints)]
        return bool(np.all(np.array(self.width) > TUNING.fewest_samples_of_way * period * usual))

    def unit_efforts(self, actuators: Motion) -> Array:
        """(N, m) the state z, from rest: how an element was strained before the log begins, nobody knows."""
        return _by_joint(self, actuators, 1.0, _slipping)


@dataclass(frozen=True, kw_only=True)
class LayeredHysteresis(Hysteresis):
    """Three such elements that slip after w / 4, w / 2 and w: the generalised Maxwell-slip model."""

    name = "hysteresis.layers"
    physics = "Presliding in several layers, each of which slips after a way of its own."
    phrase = Phrase(
        "{who} needs presliding friction of {Fha}, {Fhb} and {Fhc}, built up over a quarter, half and all of {width}."
    )
    symbols = ("Fha", "Fhb", "Fhc")
    units = (("N m", "N"),) * 3

    def unit_efforts(self, actuators: Motion) -> Array:
        """(N, m, 3) the states."""
        shares = (0.25, 0.5, 1.0)
        states = [_by_joint(self, actuators, share, _slipping) for share in shares]
        return np.stack(states, axis=2)


@dataclass(frozen=True, kw_only=True)
class SmoothHysteresis(Hysteresis):
    """Fh z, Fh >= 0, with dz = du / w (1 - z sign(du)): Dahl's model."""

    name = "hysteresis.smooth"
    physics = "Presliding with a gradual onset of slipping."
    reference = "Dahl, A solid friction model, Aerospace Corporation 1968"
    phrase = Phrase("{who} needs presliding friction of {Fhs} that builds up gradually over {width}.")
    symbols = ("Fhs",)

    def unit_efforts(self, actuators: Motion) -> Array:
        """(N, m) the state z, exact between the samples."""
        return _by_joint(self, actuators, 1.0, _gradual)


@dataclass(frozen=True, kw_only=True)
class ElasticHysteresis(Hysteresis):
    """Fh z, Fh >= 0, with dz = du / w where the element is relieved, and dz = du / w (1 - |z|) where it is strained.

    Bouc and Wen's model with beta = gamma = 1/2 and n = 1.
    """

    name = "hysteresis.elastic"
    physics = "Presliding with a gradual onset of slipping and an elastic return."
    reference = "Bouc 1967; Wen, Method for random vibration of hysteretic systems, 1976"
    phrase = Phrase("{who} needs presliding friction of {Fhe} with an elastic return, over {width}.")
    symbols = ("Fhe",)

    def unit_efforts(self, actuators: Motion) -> Array:
        """(N, m) the state z."""
        return _by_joint(self, actuators, 1.0, _elastic)


def _by_joint(
    effect: Hysteresis, actuators: Motion, share: float, states: Callable[[list[float], float], Iterator[float]]
) -> Array:
    """(N, m) states, one step of the way after another; plain numbers are faster than arrays of one.

    From rest, or from what was kept of the instant before.
    """
    width, key = share * np.array(effect.width), (effect.name, effect.joints, share)
    before = actuators.earlier(key)
    first, start = (actuators.q[0], np.zeros(len(width))) if before is None else before
    ways = np.diff(actuators.q, axis=0, prepend=first[None]) / width
    columns = [list(states(way.tolist(), z)) for way, z in zip(ways.T, start.tolist(), strict=True)]
    state = np.array(columns).T
    actuators.keep(key, actuators.q[-1], state[-1])
    return state


def _slipping(ways: list[float], z: float) -> Iterator[float]:
    for way in ways:
        z += way
        if z > 1.0:
            z = 1.0
        elif z < -1.0:
            z = -1.0
        yield z


def _gradual(ways: list[float], z: float) -> Iterator[float]:
    return islice(accumulate(ways, _strained, initial=z), 1, None)


def _elastic(ways: list[float], z: float) -> Iterator[float]:
    return islice(accumulate(ways, _relieved, initial=z), 1, None)


def _strained(z: float, way: float) -> float:
    side = math.copysign(1.0, way)
    return side + (z - side) * math.exp(-abs(way))


def _relieved(z: float, way: float) -> float:
    if z * way < 0.0:  # relieved first, strained with what is left of the way
        relief = min(abs(way), abs(z))
        z, way = z + math.copysign(relief, way), math.copysign(abs(way) - relief, way)
    return _strained(z, way) if way else z
