"""Position-dependent torques: springs, balancing springs, cables and hoses along the arm."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Numbers, Phrase, number
from bayesid.effects.friction import DryTerm
from bayesid.effects.parameters import Coefficient
from bayesid.effects.term import ActuatorTerm
from bayesid.effects.tuning import TUNING
from bayesid.motion import Motion

_WHOLE_RANGE = "moving slowly over the whole range of the joint, both ways"
_LARGE_RANGE = "moving the joint slowly over a large range in several postures of the joints before it"


class JointSpring(ActuatorTerm):
    """k u + k0, k >= 0: a spring across the joint, relaxed at u = -k0 / k."""

    name = "joint_spring"
    shown_by = "holding still, or moving slowly, over the whole range of the joint"
    phrase = Phrase("{who} needs a spring of {k}, with {k0} at position zero.", "a joint spring")
    coefficients = (
        Coefficient("k", "N m/rad", nonnegative=True, mjcf="stiffness"),
        Coefficient("k0_", "N m", mjcf="preload"),
    )

    def unit_efforts(self, actuators: Motion) -> Sequence[Array]:
        return actuators.q, np.ones_like(actuators.q)


class GravitySpring(ActuatorTerm):
    """ks sin(u) + kc cos(u): a balancing spring between two points off the axis, of zero free length.

    Herder, Energy-Free Systems, 2001.
    """

    name = "gravity_spring"
    shown_by = _LARGE_RANGE
    phrase = Phrase(
        "{who} needs a balancing spring: {ks} times the sine of its position and {kc} times the cosine.",
        "a balancing spring",
    )
    coefficients = (Coefficient("ks", "N m"), Coefficient("kc", "N m"))

    def unit_efforts(self, actuators: Motion) -> Sequence[Array]:
        return np.sin(actuators.q), np.cos(actuators.q)


class StiffGravitySpring(ActuatorTerm):
    """The same with a free length: its torque (1 - l0 / l(u)) sin(u - u0) to the second harmonic.

    The law of cosines gives the spring's length l.
    """

    name = "gravity_spring.free_length"
    shown_by = _LARGE_RANGE
    phrase = Phrase(
        "{who} needs a balancing spring with a free length: {ks1} and {kc1} times the sine and cosine of its "
        "position, {ks2} and {kc2} times those of twice the position."
    )
    coefficients = tuple(Coefficient(symbol, "N m") for symbol in ("ks1_", "kc1_", "ks2_", "kc2_"))

    def unit_efforts(self, actuators: Motion) -> Sequence[Array]:
        return [wave(h * actuators.q) for h in (1.0, 2.0) for wave in (np.sin, np.cos)]


def _places(count: int) -> Callable[[Motion], Array]:
    """Positions over the middle of an actuator's range."""
    return lambda actuator: np.percentile(actuator.q, np.linspace(*TUNING.cable_middle, count))


class CableDrag(ActuatorTerm):
    """k max(0, u - u0) beyond a position, or k min(0, u - u0) below it, k >= 0: a cable that is slack up to there.

    Args:
        start: (m,) u0 of each actuator, rad.
        side: (m,) 1 for beyond, -1 for below.
    """

    start: Numbers = number("rad", tried=_places(TUNING.cable_starts))
    side: Numbers = number(tried=lambda actuator: (1.0, -1.0))

    name = "cable_drag"
    shown_by = _WHOLE_RANGE
    phrase = Phrase(
        "{who} needs a cable that pulls with {kd} beyond {start}.",
        "cable drag",
        size="side",
        opposite="{who} needs a cable that pulls with {kd} below {start}.",
    )
    coefficients = (Coefficient("kd", "N m/rad", nonnegative=True),)

    def unit_efforts(self, actuators: Motion) -> Array:
        side = np.array(self.side)
        return side * np.maximum(side * (actuators.q - np.array(self.start)), 0.0)


class CableFriction(DryTerm):
    """Fd |u - u0| tanh(u' / v), Fd >= 0: a dress pack that rubs the more, the more it is bent.

    Args:
        start: (m,) u0 of each actuator, rad.
    """

    start: Numbers = number("rad", tried=_places(TUNING.cable_centres))

    name = "cable_drag.friction"
    shown_by = _WHOLE_RANGE
    phrase = Phrase("{whose} friction grows by {Fd} with the distance from {start}, like that of a cable.")
    coefficients = (Coefficient("Fd", "N m/rad", nonnegative=True),)

    def unit_efforts(self, actuators: Motion) -> Array:
        return np.abs(actuators.q - np.array(self.start)) * self.direction(actuators)


class CableStiffening(ActuatorTerm):
    """k1 (u - u0) + k3 (u - u0)^3 with k3 >= 0: a cable that stiffens as it is bent (Duffing's spring).

    Args:
        start: (m,) u0 of each actuator, rad.
    """

    start: Numbers = number("rad", tried=_places(TUNING.cable_centres))

    name = "cable_drag.stiffening"
    shown_by = _WHOLE_RANGE
    phrase = Phrase("{who} needs a cable that stiffens when bent, {kd1} and {kd3}, relaxed at {start}.")
    coefficients = (Coefficient("kd3_", "N m/rad^3", nonnegative=True), Coefficient("kd1_", "N m/rad"))

    def unit_efforts(self, actuators: Motion) -> Sequence[Array]:
        bent = actuators.q - np.array(self.start)
        return bent**3, bent
