"""Drive effects: rotor inertia, torque offset and ripple; errors of gain and gear ratio; delays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Self

import numpy as np
import scipy

from bayesid.arrays import Array
from bayesid.effects.distortion import Direction, Distortion, RobotDistortion, Rows
from bayesid.effects.effect import Numbers, Phrase, ReadableUnit, Scene, number
from bayesid.effects.parameters import Coefficient
from bayesid.effects.term import ActuatorTerm
from bayesid.effects.tuning import TUNING
from bayesid.motion import Motion
from bayesid.robot import Robot

FASTEST_HARMONIC = 5
"""Highest harmonic of a simulated motion (`bayesid.simulation.trajectories.HARMONICS`)."""


class RotorInertia(ActuatorTerm):
    """Ia u'', Ia >= 0: the rotor's inertia times the gear ratio squared, gyroscopic couples neglected.

    Khalil and Dombre, Modeling, Identification and Control of Robots, 2002.
    """

    name = "rotor_inertia"
    shown_by = "accelerating one joint hard while the others rest, in several postures"
    phrase = Phrase("{who} needs a rotor inertia of {Ia}.", "rotor inertia")
    coefficients = (Coefficient("Ia", "kg m^2", nonnegative=True, mjcf="armature"),)

    def unit_efforts(self, actuators: Motion) -> Array:
        return actuators.ddq


class TorqueOffset(ActuatorTerm):
    """A constant, of either sign: a zero error of sensor or drive, or friction that prefers a direction.

    Gautier, Dynamic identification of robots with power model, IEEE ICRA 1997.
    """

    name = "torque_offset"
    shown_by = "moving both ways through many positions"
    phrase = Phrase("{who} needs a torque offset of {offset}.", "a torque offset")
    coefficients = (Coefficient("offset", "N m"),)

    def unit_efforts(self, actuators: Motion) -> Array:
        return np.ones(actuators.q.shape)


def _harmonics(actuator: Motion) -> Array:
    """Harmonics that a log can resolve, 1/rad."""
    speed, rate = np.abs(actuator.dq), 1.0 / float(np.median(np.diff(actuator.t)))
    highest = TUNING.ripple_fastest * np.pi * rate / max(float(np.percentile(speed, TUNING.usual_speed)), 1e-6)
    lowest, step = TUNING.ripple_lowest, TUNING.ripple_step * np.pi / max(float(np.ptp(actuator.q)), 1e-6)
    return np.arange(lowest, highest, max(step, (highest - lowest) / TUNING.most_harmonics))


class TorqueRipple(ActuatorTerm):
    """rs sin(h u) + rc cos(h u): cogging of the motor, teeth of the gear, the wave generator of a strain wave gear.

    Ghorbel, Gandhi, Alpeter, On the kinematic error in harmonic drive gears, 2001.

    Args:
        harmonic: (m,) h of each actuator, 1/rad: waves per turn.
    """

    harmonic: Numbers = number("1/rad", tried=_harmonics)

    name = "torque_ripple"
    shown_by = "moving slowly over a large range, at several speeds"
    phrase = Phrase(
        "{who} needs torque ripple of {harmonic} waves per turn: {rs} in the sine and {rc} in the cosine.",
        "torque ripple",
        units={"harmonic": ReadableUnit("")},
    )
    coefficients = (Coefficient("rs", "N m"), Coefficient("rc", "N m"))

    def unit_efforts(self, actuators: Motion) -> Sequence[Array]:
        phase = np.array(self.harmonic) * actuators.q
        return np.sin(phase), np.cos(phase)


class GainError(Distortion):
    """Efforts are read `gain` times as large as they are: a wrong torque constant, gear ratio or amplifier.

    Gautier and Briot, Global identification of joint drive gains, 2014.

    Args:
        gain: (m,) of each actuator.
    """

    gain: Numbers = number("1", tuned=True)

    name = "gain_error"
    shown_by = "the same motion with a known payload"
    phrase = Phrase(
        "{whose} efforts read {gain} too large.",
        "a gain error",
        size="gain",
        opposite="{whose} efforts read {gain} too small.",
        units={"gain": ReadableUnit("%", 100.0, neutral=1.0)},
    )
    needs_earlier = True
    typical = (0.2,)
    neutral = 1.0
    largest = 2e3
    """Twice the highest level of `bayesid.simulation.logs`: a gain changes efforts in proportion."""

    def columns(self, rows: Rows, robot: Robot, motion: Motion) -> Array:
        factor = np.ones(robot.n_joints)
        factor[self.acting(robot.n_joints)] = self.gain
        return factor[:, None] * rows(robot, motion)

    def change(self, scene: Scene) -> tuple[Array, Array]:
        acting = self.acting(scene.robot.n_joints)
        columns = np.zeros((*scene.effort.shape, len(acting)))
        columns[:, acting, np.arange(len(acting))] = scene.effort[:, acting]
        return columns @ (np.array(self.gain) - 1.0), columns


class GearRatio(RobotDistortion):
    """The joint's true position is 1 + error times its reading: its gear ratio is not as stated.

    Mooring, Roth, Driels, Fundamentals of Manipulator Calibration, 1991.

    Args:
        error: (m,) of each actuator.
    """

    error: Numbers = number("1", name="ratio", tuned=True)

    name = "gear_ratio"
    shown_by = "moving the joint far from its zero, both ways, slowly and fast"
    phrase = Phrase(
        "{whose} gear ratio is off: it moves {ratio} more than its readings.",
        "a wrong gear ratio",
        size="ratio",
        opposite="{whose} gear ratio is off: it moves {ratio} less than its readings.",
        units={"ratio": ReadableUnit("%", 100.0)},
    )
    needs_earlier = True
    typical = (0.03,)
    largest = 1.0
    """The joint moves twice as far, or not at all."""

    def moving(self, robot: Robot, motion: Motion) -> Motion:
        if not any(self.error):
            return motion
        factor = np.ones(robot.n_joints)
        factor[self.acting(robot.n_joints)] += self.error
        to_joints = (np.linalg.inv(robot.coupling) @ (factor[:, None] * robot.coupling)).T
        return replace(motion, q=motion.q @ to_joints, dq=motion.dq @ to_joints, ddq=motion.ddq @ to_joints)


class Delay(Distortion):
    """Efforts are those of the motion `lag` seconds ago, in all actuators alike or in one: a bus cycle, a filter.

    Swevers, Verdonck, De Schutter, Dynamic model identification for robots, 2007.

    Args:
        lag: (1,) s.
    """

    lag: Numbers = number(tuned=True, count=1)

    name = "delay"
    shown_by = "fast changes of acceleration"
    phrase = Phrase(
        "{whose} efforts lag {lag} behind the motion.",
        "a delay",
        size="lag",
        opposite="{whose} efforts come {lag} ahead of the motion.",
        units={"lag": ReadableUnit("ms", 1e3)},
    )
    acts_on = "either"
    memory = True
    typical = (0.02,)

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        for joints in ((), *((j,) for j in range(1, scene.robot.n_joints + 1))):
            yield from (cls(joints=joints, lag=(lag,)) for lag in TUNING.lags)

    @property
    def late(self) -> float:
        return self.lag[0]

    def columns(self, rows: Rows, robot: Robot, motion: Motion) -> Array:
        late = rows(robot, motion.ago(self.lag[0]))
        if not self.joints:
            return late
        columns, acting = rows(robot, motion).copy(), self.acting(robot.n_joints)
        columns[:, acting] = late[:, acting]
        return columns

    def change(self, scene: Scene) -> tuple[Array, Array]:
        """To first order: minus the effort's derivative."""
        acting = self.acting(scene.robot.n_joints)
        spline = scipy.interpolate.CubicSpline(scene.motion.t, scene.effort[:, acting])
        shift, columns = np.zeros(scene.effort.shape), np.zeros((*scene.effort.shape, 1))
        shift[:, acting] = spline(scene.motion.t - self.lag[0]) - scene.effort[:, acting]
        columns[:, acting, 0] = -spline(scene.motion.t - self.lag[0], 1)
        return shift, columns

    def of_magnitude(self, magnitude: float, direction: Direction, scene: Scene) -> Self:
        return replace(self, lag=(magnitude,))

    def largest_magnitude(self, scene: Scene) -> float:
        """At most one radian of the motion's fastest harmonic: the motion before the log is unknown."""
        return float(scene.motion.t[-1] - scene.motion.t[0]) / (2.0 * np.pi * FASTEST_HARMONIC)

    def numbers(self, robot: Robot) -> Mapping[str, tuple[float, str]]:
        return {f"lag{self.joints[0] if self.joints else ''}": (self.lag[0], "s")}
