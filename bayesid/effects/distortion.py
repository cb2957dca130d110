"""What a distortion is: an effect that adds no columns to the model but changes its rows, or what the sensor reads.

A delay or a tilted base changes the rows Y that a model makes of a motion; a sensor that clips changes what becomes of
its effort. Columns stay linear in the model's parameters, so everything downstream stays as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects.effect import Effect, Scene
from bayesid.motion import Motion
from bayesid.robot import Robot

Rows = Callable[[Robot, Motion], Array]
"""Makes (N, n, P) columns of a motion."""


@dataclass(frozen=True)
class Direction:
    """Which way a simulated distortion of some magnitude goes, drawn at random.

    Attributes:
        sign: 1 or -1.
        angle: between 0 and 2 pi, where there are two numbers.
    """

    sign: float
    angle: float


@dataclass(frozen=True, kw_only=True)
class Distortion(Effect):
    """Base of all distortions."""

    linear: ClassVar[bool] = False

    def columns(self, rows: Rows, robot: Robot, motion: Motion) -> Array:
        """(N, n, P) what becomes of the model's columns."""
        return rows(robot, motion)

    @property
    def lag_of_all(self) -> float:
        """By how much it makes the efforts of all joints lag behind the motion, s."""
        return 0.0

    def built(self, robot: Robot) -> Robot:
        """The robot as it is, where the distortion is one of the robot; made once for the same one."""
        if not self._latest or self._latest[0] is not robot:
            self._latest[:] = robot, self._built(robot)
        return self._latest[1]

    @cached_property
    def _latest(self) -> list[Robot]:
        """The robot that was asked for last, and that as it is."""
        return []

    def _built(self, robot: Robot) -> Robot:
        return robot

    def measured(self, effort: Array) -> Array:
        """(N, n) what the sensor reads of efforts (N, n), N m."""
        return effort

    def restored(self, magnitude: Array) -> tuple[Array, Mask]:
        """(N, n) absolute efforts before the sensor's doing, N m, and (N, n) where the reading shows them."""
        return magnitude, np.ones(magnitude.shape, dtype=bool)

    def of_magnitude(self, magnitude: float, direction: Direction, scene: Scene) -> Self:
        """The form at a magnitude, for simulated logs: it does nothing at 0 and more the larger the magnitude is."""
        raise NotImplementedError

    def largest_magnitude(self, scene: Scene) -> float:
        """How large the magnitude of a simulated distortion may be."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class SensorDistortion(Distortion):
    """Base of what changes readings alone."""

    variable = "load"
    of_effort = True
    of_sensor = True

    def change(self, scene: Scene) -> tuple[Array, Array]:
        """What is read beside what there is; no amplitudes."""
        return self.measured(scene.effort) - scene.effort, np.zeros((*scene.effort.shape, 0))

    def largest_magnitude(self, scene: Scene) -> float:
        """The largest effort of its joint, N m, and somewhat more, rounding or not: nothing is then read."""
        (joint,) = self.acting(scene.robot.n_joints)
        return 1.001 * float(np.abs(scene.effort[:, joint]).max())
