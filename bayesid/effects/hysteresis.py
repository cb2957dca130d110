"""Presliding friction: dry friction that builds up over a displacement, before teeth and seals slip."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import accumulate, islice
from typing import ClassVar

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Numbers, Phrase, Scene, number
from bayesid.effects.parameters import Coefficient
from bayesid.effects.term import ActuatorTerm
from bayesid.effects.tuning import TUNING
from bayesid.motion import Motion


def _widths(actuator: Motion) -> list[float]:
    return [width for width in TUNING.hysteresis_widths if width < 0.5 * float(np.ptp(actuator.q))]


def _loaded(z: float, step: float) -> float:
    side = math.copysign(1.0, step)
    return side + (z - side) * math.exp(-abs(step))


def _unloaded_and_loaded(z: float, step: float) -> float:
    if z * step < 0.0:  # unload first, then load over the rest of the step
        unloading = min(abs(step), abs(z))
        z, step = z + math.copysign(unloading, step), math.copysign(abs(step) - unloading, step)
    return _loaded(z, step) if step else z


class Hysteresis(ActuatorTerm):
    """Fh z, Fh >= 0, with z' = u' / w held between -1 and 1: an elastic element that slips (Maxwell, Prandtl).

    Al-Bender, Lampaert, Swevers, The generalized Maxwell-slip model, IEEE TAC 2005.

    Args:
        width: (m,) w of each actuator: displacement from rest to slipping, rad.
    """

    width: Numbers = number("rad", tried=_widths)

    name = "hysteresis"
    shown_by = "small strokes back and forth, of a few hundredths of a radian"
    phrase = Phrase("{who} needs presliding friction of {Fh} that builds up over {width}.", "presliding hysteresis")
    coefficients: ClassVar[tuple[Coefficient, ...]] = (Coefficient("Fh", "N m", nonnegative=True),)
    memory = True

    @staticmethod
    def states(steps: list[float], z: float) -> Iterator[float]:
        """States of one element after each displacement, in units of its width, from state z."""
        for step in steps:
            z += step
            if z > 1.0:
                z = 1.0
            elif z < -1.0:
                z = -1.0
            yield z

    def resolved(self, scene: Scene) -> bool:
        """Whether the width takes a few samples at the usual speed; otherwise it looks like a step or a small delay."""
        period = float(np.median(np.diff(scene.motion.t)))
        usual = np.percentile(np.abs(scene.actuators.dq), TUNING.usual_speed, axis=0)[self.acting(scene.robot.n_joints)]
        return bool(np.all(np.array(self.width) > TUNING.fewest_samples_of_width * period * usual))

    def unit_efforts(self, actuators: Motion) -> Array | Sequence[Array]:
        """(N, m) the state z, zero at the start of the log: its true initial value is unknown."""
        return self.state(actuators, 1.0)

    def state(self, actuators: Motion, share: float) -> Array:
        """(N, m) states of an element with a share of the width, from rest or from the previous instant's state."""
        width, key = share * np.array(self.width), (self.name, self.joints, share)
        before = actuators.earlier(key)
        first, start = (actuators.q[0], np.zeros(len(width))) if before is None else before
        steps = np.diff(actuators.q, axis=0, prepend=first[None]) / width
        # plain numbers: faster than arrays of one
        columns = [list(self.states(own.tolist(), z)) for own, z in zip(steps.T, start.tolist(), strict=True)]
        state = np.array(columns).T
        actuators.keep(key, actuators.q[-1], state[-1])
        return state


class LayeredHysteresis(Hysteresis):
    """Three such elements that slip after w / 4, w / 2 and w: the generalised Maxwell-slip model."""

    name = "hysteresis.layers"
    phrase = Phrase(
        "{who} needs presliding friction of {Fha}, {Fhb} and {Fhc}, built up over a quarter, half and all of {width}."
    )
    coefficients = tuple(Coefficient(symbol, "N m", nonnegative=True) for symbol in ("Fha", "Fhb", "Fhc"))

    def unit_efforts(self, actuators: Motion) -> Sequence[Array]:
        return [self.state(actuators, share) for share in (0.25, 0.5, 1.0)]


class SmoothHysteresis(Hysteresis):
    """Fh z, Fh >= 0, with dz = du / w (1 - z sign(du)), exact between the samples: Dahl's model of gradual slipping.

    Dahl, A solid friction model, Aerospace Corporation 1968.
    """

    name = "hysteresis.smooth"
    phrase = Phrase("{who} needs presliding friction of {Fhs} that builds up gradually over {width}.")
    coefficients = (Coefficient("Fhs", "N m", nonnegative=True),)

    @staticmethod
    def states(steps: list[float], z: float) -> Iterator[float]:
        return islice(accumulate(steps, _loaded, initial=z), 1, None)


class ElasticHysteresis(Hysteresis):
    """Fh z, Fh >= 0: the element unloads with dz = du / w and loads with dz = du / w (1 - |z|).

    Bouc 1967 and Wen, Method for random vibration of hysteretic systems, 1976, with beta = gamma = 1/2 and n = 1.
    """

    name = "hysteresis.elastic"
    phrase = Phrase("{who} needs presliding friction of {Fhe} with an elastic return, over {width}.")
    coefficients = (Coefficient("Fhe", "N m", nonnegative=True),)

    @staticmethod
    def states(steps: list[float], z: float) -> Iterator[float]:
        return islice(accumulate(steps, _unloaded_and_loaded, initial=z), 1, None)
