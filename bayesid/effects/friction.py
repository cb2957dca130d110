"""Friction of gears and bearings: a function of each actuator's speed, of its load, and of how warm it is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Self

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Numbers, Phrase, ReadableUnit, Scene, number
from bayesid.effects.parameters import Coefficient
from bayesid.effects.term import ActuatorTerm, Term
from bayesid.effects.tuning import TUNING
from bayesid.motion import Motion
from bayesid.robot import Robot

_STEADY = "moving at several constant speeds, slow and fast"


class ViscousFriction(ActuatorTerm):
    """Fv u', Fv >= 0: lubricant drag in proportion to the speed.

    Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 1994.
    """

    name = "viscous_friction"
    shown_by = _STEADY
    phrase = Phrase("{who} needs viscous friction of {Fv}.", "viscous friction")
    coefficients = (Coefficient("Fv", "N m s/rad", nonnegative=True, urdf="damping", mjcf="damping"),)

    def unit_efforts(self, actuators: Motion) -> Array:
        return actuators.dq


class OvercompensatedFriction(Term):
    """Fv < 0: the drive's friction compensation exceeds the viscous friction.

    It has no parameter: it removes the bound Fv >= 0 of viscous friction. Olsson, Astrom, Canudas de Wit, Gafvert,
    Lischinsky, Friction models and friction compensation, European Journal of Control 1998.
    """

    name = "overcompensated_friction"
    shown_by = _STEADY
    frees = ("Fv",)
    phrase = Phrase(
        "{whose} drive over-compensates viscous friction: reduce its friction feedforward.",
        "over-compensated viscous friction",
    )

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        return (cls(joints=(j,)) for j in range(1, scene.robot.n_joints + 1))

    def columns(self, robot: Robot, motion: Motion) -> Array:
        return np.zeros((len(motion), robot.n_joints, 0))


class SaturatingFriction(ActuatorTerm):
    """Fe tanh(u' / ve), Fe >= 0: lubricant drag that saturates, as the film shears thin or grows warm.

    Waiboer, Aarts, Jonker, Velocity dependence of joint friction in manipulators, 2005.
    """

    knee: Numbers = number("rad/s", tried=lambda actuator: np.multiply(TUNING.knees, actuator.top_speed))

    name = "viscous_friction.saturating"
    shown_by = _STEADY
    phrase = Phrase("{who} needs viscous friction that saturates: {Fe} beyond {knee}.", "saturating viscous friction")
    coefficients = (Coefficient("Fe", "N m", nonnegative=True),)

    def unit_efforts(self, actuators: Motion) -> Array:
        return np.tanh(actuators.dq / np.array(self.knee))


class DryTerm(ActuatorTerm):
    """Base of the effects in which the direction of motion enters, smoothed as tanh(u' / v).

    Args:
        smoothing: (m,) v of each actuator, rad/s: its standstill speed, below which friction's direction is unknown.
    """

    smoothing: Numbers = number(of_motion=lambda actuators: actuators.standstill_speed)

    def direction(self, actuators: Motion) -> Array:
        """(N, m) the smoothed direction of motion, between -1 and 1."""
        direction: Array = np.tanh(actuators.dq / self._speeds)
        return direction

    @cached_property
    def _speeds(self) -> Array:
        return np.array(self.smoothing)


class CoulombFriction(DryTerm):
    """Fc tanh(u' / v), Fc >= 0: dry friction of constant size.

    Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 1994.
    """

    name = "coulomb_friction"
    shown_by = "moving both ways at several speeds, with many reversals"
    phrase = Phrase("{who} needs Coulomb friction of {Fc}.", "Coulomb friction")
    coefficients = (Coefficient("Fc", "N m", nonnegative=True, urdf="friction", mjcf="frictionloss"),)

    def unit_efforts(self, actuators: Motion) -> Array:
        return self.direction(actuators)


class AsymmetricCoulomb(DryTerm):
    """Fp where u' > 0, -Fm where u' < 0; Fp, Fm >= 0: a worm gear, a preloaded seal.

    Armstrong-Helouvry, Control of Machines with Friction, 1991.
    """

    name = "asymmetric_coulomb"
    shown_by = "moving both ways at equal speeds through the same positions"
    phrase = Phrase(
        "{who} needs dry friction that depends on the direction: {Fp} forwards and {Fm} backwards.",
        "asymmetric Coulomb friction",
    )
    coefficients = (Coefficient("Fp", "N m", nonnegative=True), Coefficient("Fm", "N m", nonnegative=True))

    def unit_efforts(self, actuators: Motion) -> Sequence[Array]:
        direction = self.direction(actuators)
        return np.maximum(direction, 0.0), np.minimum(direction, 0.0)


class StribeckFriction(DryTerm):
    """(Fk + Fs exp(-(u' / vs)^2)) tanh(u' / v); Fk, Fs >= 0: Fs vanishes as the lubricant's film builds up.

    Bo and Pavelescu, Wear 1982; Armstrong-Helouvry et al., Automatica 1994.

    Args:
        speed: (m,) vs of each actuator, rad/s.
    """

    speed: Numbers = number(
        "rad/s",
        of_motion=lambda actuators: TUNING.stribeck_slow * actuators.standstill_speed,
        tried=lambda actuator: np.multiply(TUNING.stribeck_speeds, actuator.top_speed),
    )

    name = "stribeck_friction"
    shown_by = "creeping both ways, far below the usual speeds"
    phrase = Phrase(
        "{who} needs dry friction that falls with speed: {Fk}, and near standstill {Fs} more, fading over {speed}.",
        "Stribeck friction",
    )
    coefficients = (
        Coefficient("Fk", "N m", nonnegative=True, adds_to="Fc"),
        Coefficient("Fs", "N m", nonnegative=True),
    )

    def unit_efforts(self, actuators: Motion) -> Sequence[Array]:
        direction, slow = self.direction(actuators), np.exp(-((actuators.dq / np.array(self.speed)) ** 2))
        return direction, slow * direction


class LoadDependentFriction(DryTerm):
    """Fl |load| tanh(u' / v), Fl >= 0: dry friction that grows with the torque that gears and bearings carry.

    The load is the rigid bodies' effort. Hamon, Gautier, Garrec, Dry friction depending on load and velocity, IROS
    2010.

    Args:
        links: (10 n,) parameters of the rigid bodies that make the load, as identified earlier.
    """

    links: Numbers = number(given=True)

    name = "load_dependent_friction"
    shown_by = "moving both ways, loaded and unloaded, at equal speeds"
    phrase = Phrase(
        "{who} needs dry friction that grows with the load, by {Fl} of it.",
        "load-dependent friction",
        units={"Fl": ReadableUnit("%", 100.0)},
    )
    coefficients = (Coefficient("Fl", "1", nonnegative=True),)

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        links = tuple(scene.links.tolist())
        for j, speed in enumerate(scene.actuators.standstill_speed.tolist(), start=1):
            yield cls(joints=(j,), smoothing=(speed,), links=links)

    def own_columns(self, robot: Robot, motion: Motion, actuators: Motion | None = None) -> Array:
        """The size of the load, which comes from all joints, times the direction of motion."""
        load = np.abs(robot.inverse_dynamics(motion, self._links)[:, self.acting(robot.n_joints)])
        return load[:, :, None] * super().own_columns(robot, motion, actuators)

    def unit_efforts(self, actuators: Motion) -> Array:
        return self.direction(actuators)

    def check(self, n_joints: int) -> None:
        super().check(n_joints)
        self._expect("links", 10 * n_joints)

    @cached_property
    def _links(self) -> Array:
        return np.array(self.links)


# What changes as a joint warms up, by 1 - exp(-t / T) since the recording began; T is a number of each actuator, s.
# Simoni, Beschi, Legnani, Visioli, Friction modeling with temperature effects, 2015.
_WARMING = "repeating the same motion from cold to warm"


def _times(actuator: Motion) -> list[float]:
    return [share * float(actuator.t[-1] - actuator.origin) for share in TUNING.warming_times]


def _cold_and_warm(time: Numbers, actuators: Motion, *parts: Array) -> Sequence[Array]:
    """For each effort (N, m): itself (cold), and itself times the warming 1 - exp(-t / T)."""
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
    """Dry and viscous friction that both change from cold to warm."""

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
