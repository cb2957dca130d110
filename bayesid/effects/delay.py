"""Efforts that lag behind the motion."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import scipy

from bayesid.arrays import Array
from bayesid.effects.distortion import Direction, Distortion, Rows
from bayesid.effects.effect import Phrase, ReadableUnit, Scene
from bayesid.effects.tuning import TUNING
from bayesid.motion import Motion
from bayesid.robot import Robot

FASTEST_HARMONIC = 5
"""Of a simulated motion, its length being the period: `bayesid.simulation.trajectories.HARMONICS`."""


@dataclass(frozen=True, kw_only=True)
class Delay(Distortion):
    """Efforts are those of the motion `lag` seconds ago, in all actuators alike or in one.

    Args:
        lag: (1,) s.
    """

    lag: tuple[float, ...]

    name = "delay"
    physics = "Efforts are logged later than positions: another bus cycle, a filter in the drive."
    reference = "Swevers, Verdonck, De Schutter, Dynamic model identification for robots, 2007"
    variable = "time"
    shown_by = "fast changes of acceleration"
    of_effort = True
    of_clock = True
    phrase = Phrase(
        "{whose} efforts lag {lag} behind the motion.",
        "a delay",
        size="lag",
        opposite="{whose} efforts come {lag} ahead of the motion.",
        units={"lag": ReadableUnit("ms", 1e3)},
    )
    memory = True
    whole_robot = True
    typical = (0.02,)
    counts = {"lag": 1}
    amplitudes = "lag"

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """About several lags, in all actuators and in each by itself."""
        for joints in ((), *((j,) for j in range(1, scene.robot.n_joints + 1))):
            yield from (cls(joints=joints, lag=(lag,)) for lag in TUNING.lags)

    @property
    def lag_of_all(self) -> float:
        """The lag, unless it is that of some joints."""
        return 0.0 if self.joints else self.lag[0]

    def columns(self, rows: Rows, robot: Robot, motion: Motion) -> Array:
        """Rows of the motion some time ago."""
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
        """With a lag, s."""
        return replace(self, lag=(magnitude,))

    def largest_magnitude(self, scene: Scene) -> float:
        """At most a radian of the motion's fastest wave, as the motion is not known before it begins."""
        return float(scene.motion.t[-1] - scene.motion.t[0]) / (2.0 * np.pi * FASTEST_HARMONIC)

    def numbers(self, robot: Robot) -> Mapping[str, tuple[float, str]]:
        """The lag."""
        return {f"lag{self.joints[0] if self.joints else ''}": (self.lag[0], "s")}
