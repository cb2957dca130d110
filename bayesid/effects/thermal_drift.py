"""Friction and offsets that change as a joint warms up, by 1 - exp(-t / T) since the recording began.

T is a number of each actuator, s. Simoni, Beschi, Legnani, Visioli, Friction modeling with temperature effects, 2015.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Numbers, Phrase, number
from bayesid.effects.friction import DryTerm
from bayesid.effects.parameters import Coefficient
from bayesid.effects.term import ActuatorTerm
from bayesid.effects.tuning import TUNING
from bayesid.motion import Motion

_WARMING = "repeating the same motion from cold to warm"


def _times(actuator: Motion) -> list[float]:
    return [share * float(actuator.t[-1] - actuator.origin) for share in TUNING.warming_times]


def _cold_and_warm(time: Numbers, actuators: Motion, *parts: Array) -> Sequence[Array]:
    """Each of some efforts (N, m), as it is when the recording begins, and in proportion to how warm the joint is."""
    warm = 1.0 - np.exp(-(actuators.t[:, None] - actuators.origin) / np.array(time))
    return [factor * part for part in parts for factor in (np.ones_like(warm), warm)]


class ThermalDrift(DryTerm):
    """(F0 + F1 (1 - exp(-t / T))) tanh(u' / v): dry friction that changes from cold to warm."""

    time: Numbers = number("s", tried=_times)

    name = "thermal_drift"
    shown_by = _WARMING
    phrase = Phrase(
        "{who} needs dry friction of {Fcold} that changes by {Fwarm} as it warms up, over {time}.", "thermal drift"
    )
    coefficients = (Coefficient("Fcold", "N m", adds_to="Fc"), Coefficient("Fwarm", "N m"))

    def unit_efforts(self, actuators: Motion) -> Sequence[Array]:
        return _cold_and_warm(self.time, actuators, self.direction(actuators))


class ViscousThermalDrift(ActuatorTerm):
    """(f0 + f1 (1 - exp(-t / T))) u': viscous friction that changes from cold to warm."""

    time: Numbers = number("s", tried=_times)

    name = "thermal_drift.viscous"
    shown_by = _WARMING
    phrase = Phrase("{who} needs viscous friction of {fcold} that changes by {fwarm} as it warms up, over {time}.")
    coefficients = (Coefficient("fcold", "N m s/rad", adds_to="Fv"), Coefficient("fwarm", "N m s/rad"))

    def unit_efforts(self, actuators: Motion) -> Sequence[Array]:
        return _cold_and_warm(self.time, actuators, actuators.dq)


class FrictionThermalDrift(DryTerm):
    """Both: dry and viscous friction that change from cold to warm."""

    time: Numbers = number("s", tried=_times)

    name = "thermal_drift.both"
    shown_by = _WARMING
    phrase = Phrase(
        "{who} needs friction that changes as it warms up, over {time}: dry friction of {Fcold2} by "
        "{Fwarm2}, and viscous friction of {fcold2} by {fwarm2}."
    )
    coefficients = (
        Coefficient("Fcold2_", "N m", adds_to="Fc"),
        Coefficient("Fwarm2_", "N m"),
        Coefficient("fcold2_", "N m s/rad", adds_to="Fv"),
        Coefficient("fwarm2_", "N m s/rad"),
    )

    def unit_efforts(self, actuators: Motion) -> Sequence[Array]:
        return _cold_and_warm(self.time, actuators, self.direction(actuators), actuators.dq)


class OffsetThermalDrift(ActuatorTerm):
    """o0 + o1 (1 - exp(-t / T)): a zero of sensor or drive that drifts."""

    time: Numbers = number("s", tried=_times)

    name = "thermal_drift.offset"
    shown_by = _WARMING
    phrase = Phrase("{who} needs a zero error of {ocold} that drifts by {owarm} as it warms up, over {time}.")
    coefficients = (Coefficient("ocold", "N m", adds_to="offset"), Coefficient("owarm", "N m"))

    def unit_efforts(self, actuators: Motion) -> Sequence[Array]:
        return _cold_and_warm(self.time, actuators, np.ones_like(actuators.dq))
