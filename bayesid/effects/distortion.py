"""Distortions: effects that add no columns to the model but change its rows or the sensor's reading.

A delay or a tilted base changes the regressor Y; a clipping sensor changes the reading of the effort. The model stays
linear in its parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects.effect import Effect, Scene
from bayesid.motion import Motion
from bayesid.robot import Robot

Rows = Callable[[Robot, Motion], Array]
"""Makes (N, n, P) columns of a motion."""


class Direction(NamedTuple):
    """Direction of a simulated distortion: its sign, and an angle (rad) for one with two numbers."""

    sign: float
    angle: float


class Distortion(Effect):
    """Base of all distortions: of rows, unless it is a `SensorDistortion`."""

    linear = False
    of_effort: ClassVar[bool] = True
    """Whether its change depends on the total effort of all terms."""
    neutral: ClassVar[float] = 0.0
    """Value of its numbers without an effect."""
    largest: ClassVar[float] = np.inf
    """Largest simulated magnitude."""

    @classmethod
    def variants(cls, scene: Scene) -> Iterable[Self]:
        neutral: Any = dict.fromkeys(cls.number_fields(), (cls.neutral,))
        return (cls(joints=(j,), **neutral) for j in range(1, scene.robot.n_joints + 1))

    def columns(self, rows: Rows, robot: Robot, motion: Motion) -> Array:
        """(N, n, P) the model's columns with the distortion."""
        return rows(robot, motion)

    @property
    def late(self) -> float | None:
        """Delay of the efforts, s; None for other distortions."""
        return None

    def measured(self, effort: Array) -> Array:
        """(N, n) readings of efforts (N, n), N m."""
        return effort

    def restored(self, magnitude: Array) -> tuple[Array, Mask]:
        """(N, n) absolute efforts before the sensor's error, N m, and (N, n) where readings determine them."""
        return magnitude, np.ones(magnitude.shape, dtype=bool)

    def of_magnitude(self, magnitude: float, direction: Direction, scene: Scene) -> Self:
        """The distortion with a magnitude, for simulated logs; at 0 it has no effect."""
        return self.moved(np.array([direction.sign * magnitude]))

    def largest_magnitude(self, scene: Scene) -> float:
        """Largest magnitude of a simulated distortion."""
        return self.largest


class RobotDistortion(Distortion):
    """Base of errors of the robot: its geometry (`built`) or its motion differs from the model's."""

    of_effort = False
    step: ClassVar[float] = 1e-5
    """Step of the finite differences: relative errors are about the step (truncation) and 1e-16 / step (rounding)."""

    def built(self, robot: Robot) -> Robot:
        """The robot with its error; cached for the last robot."""
        if not self._latest or self._latest[0] is not robot:
            self._latest[:] = robot, self.building(robot)
        return self._latest[1]

    @cached_property
    def _latest(self) -> list[Robot]:
        """The last robot without and with the error."""
        return []

    def building(self, robot: Robot) -> Robot:
        """The robot with its error."""
        return robot

    def moving(self, robot: Robot, motion: Motion) -> Motion:
        """The motion with its error."""
        return motion

    def columns(self, rows: Rows, robot: Robot, motion: Motion) -> Array:
        return rows(self.built(robot), self.moving(robot, motion))

    def effort(self, scene: Scene) -> Array:
        """(N, n) the model's effort, N m, for the robot and the motion with their errors."""
        neutral = not any(x for key in self.number_fields() for x in getattr(self, key))
        if neutral:
            return scene.nominal_effort
        return scene.effort_with(self.building(scene.robot), self.moving(scene.robot, scene.motion))

    def change(self, scene: Scene) -> tuple[Array, Array]:
        """Derivatives by finite differences."""
        here = self.effort(scene)
        ((key, _),) = self.number_fields().items()
        steps = self.step * np.eye(len(getattr(self, key)))
        columns = np.stack([self.moved(step).effort(scene) - here for step in steps], axis=2) / self.step
        return here - scene.nominal_effort, columns


class SensorDistortion(Distortion):
    """Base of sensor errors, which change readings only; one number per actuator."""

    def reading(self, effort: Array) -> Array:
        """(N, m) readings, N m, of the efforts (N, m) of its own actuators."""
        raise NotImplementedError

    def restoring(self, reading: Array) -> tuple[Array, Mask]:
        """(N, m) absolute efforts, N m, from absolute readings (N, m), and where these determine them."""
        raise NotImplementedError

    def measured(self, effort: Array) -> Array:
        read, acting = effort.copy(), self.acting(effort.shape[1])
        read[:, acting] = self.reading(effort[:, acting])
        return read

    def restored(self, magnitude: Array) -> tuple[Array, Mask]:
        full, valid = magnitude.copy(), np.ones(magnitude.shape, dtype=bool)
        acting = self.acting(magnitude.shape[1])
        full[:, acting], valid[:, acting] = self.restoring(magnitude[:, acting])
        return full, valid

    def change(self, scene: Scene) -> tuple[Array, Array]:
        return self.measured(scene.effort) - scene.effort, np.zeros((*scene.effort.shape, 0))

    def of_magnitude(self, magnitude: float, direction: Direction, scene: Scene) -> Self:
        chosen: Any = dict.fromkeys(self.number_fields(), (magnitude,))
        return replace(self, **chosen)

    def largest_magnitude(self, scene: Scene) -> float:
        """Slightly more than the joint's largest effort, N m: all readings are then zero."""
        (joint,) = self.acting(scene.robot.n_joints)
        return 1.001 * float(np.abs(scene.effort[:, joint]).max())
