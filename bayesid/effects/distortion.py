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
    """Which way a simulated distortion goes: its sign, and an angle (rad) where there are two numbers."""

    sign: float
    angle: float


class Distortion(Effect):
    """Base of all distortions: of rows, unless it is a `SensorDistortion`."""

    linear = False
    of_effort: ClassVar[bool] = True
    """Whether what it does depends on the whole effort, with that of the terms beside it."""
    neutral: ClassVar[float] = 0.0
    """The number with which it does nothing."""
    largest: ClassVar[float] = np.inf
    """Of the magnitudes that are simulated."""

    @classmethod
    def variants(cls, scene: Scene) -> Iterable[Self]:
        neutral: Any = dict.fromkeys(cls.number_fields(), (cls.neutral,))
        return (cls(joints=(j,), **neutral) for j in range(1, scene.robot.n_joints + 1))

    def columns(self, rows: Rows, robot: Robot, motion: Motion) -> Array:
        """(N, n, P) what becomes of the model's columns."""
        return rows(robot, motion)

    @property
    def late(self) -> float | None:
        """By how much efforts are read later, s; None of what does something else."""
        return None

    def measured(self, effort: Array) -> Array:
        """(N, n) what the sensor reads of efforts (N, n), N m."""
        return effort

    def restored(self, magnitude: Array) -> tuple[Array, Mask]:
        """(N, n) absolute efforts before the sensor's doing, N m, and (N, n) where the reading shows them."""
        return magnitude, np.ones(magnitude.shape, dtype=bool)

    def of_magnitude(self, magnitude: float, direction: Direction, scene: Scene) -> Self:
        """The form at a magnitude, for simulated logs: it does nothing at 0 and more the larger the magnitude is."""
        return self.moved(np.array([direction.sign * magnitude]))

    def largest_magnitude(self, scene: Scene) -> float:
        """Largest magnitude of a simulated distortion."""
        return self.largest


class RobotDistortion(Distortion):
    """Base of errors of the robot: its geometry (`built`) or its motion differs from the model's."""

    of_effort = False
    step: ClassVar[float] = 1e-5
    """Of the differences: their error is of this size, relative to the effort, and rounding 1e-16 over it."""

    def built(self, robot: Robot) -> Robot:
        """The robot as it is; made once for the same one."""
        if not self._latest or self._latest[0] is not robot:
            self._latest[:] = robot, self.building(robot)
        return self._latest[1]

    @cached_property
    def _latest(self) -> list[Robot]:
        """The robot that was asked for last, and that as it is."""
        return []

    def building(self, robot: Robot) -> Robot:
        """Makes the robot as it is."""
        return robot

    def moving(self, robot: Robot, motion: Motion) -> Motion:
        """The motion as it is."""
        return motion

    def columns(self, rows: Rows, robot: Robot, motion: Motion) -> Array:
        return rows(self.built(robot), self.moving(robot, motion))

    def effort(self, scene: Scene) -> Array:
        """(N, n) the model's effort, N m, of the robot and the motion as they are."""
        neutral = not any(x for key in self.number_fields() for x in getattr(self, key))
        if neutral:
            return scene.effort_as_told
        return scene.effort_with(self.building(scene.robot), self.moving(scene.robot, scene.motion))

    def change(self, scene: Scene) -> tuple[Array, Array]:
        """The derivatives by differences."""
        here = self.effort(scene)
        ((key, _),) = self.number_fields().items()
        steps = self.step * np.eye(len(getattr(self, key)))
        columns = np.stack([self.moved(step).effort(scene) - here for step in steps], axis=2) / self.step
        return here - scene.effort_as_told, columns


class SensorDistortion(Distortion):
    """Base of what changes readings alone: each actuator's by a number of its own."""

    def reading(self, effort: Array) -> Array:
        """(N, m) what is read of the efforts (N, m) of its own actuators, N m."""
        raise NotImplementedError

    def restoring(self, reading: Array) -> tuple[Array, Mask]:
        """(N, m) their absolute efforts, N m, of their absolute readings (N, m), and where these show them."""
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
        """The largest effort of its joint, N m, and somewhat more, rounding or not: nothing is then read."""
        (joint,) = self.acting(scene.robot.n_joints)
        return 1.001 * float(np.abs(scene.effort[:, joint]).max())
