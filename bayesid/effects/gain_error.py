"""A wrong gain of sensor or drive."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.distortion import Direction, Distortion, Rows
from bayesid.effects.effect import Phrase, ReadableUnit, Scene
from bayesid.effects.tuning import TUNING
from bayesid.motion import Motion
from bayesid.robot import Robot


@dataclass(frozen=True, kw_only=True)
class GainError(Distortion):
    """Efforts are read `gain` times as large as they are.

    Args:
        gain: (m,) of each actuator.
    """

    gain: tuple[float, ...]

    name = "gain_error"
    physics = "A wrong torque constant, gear ratio or amplifier: all efforts of a joint are scaled."
    reference = "Gautier and Briot, Global identification of joint drive gains, 2014"
    variable = "load"
    shown_by = "the same motion with a known payload"
    of_effort = True
    phrase = Phrase(
        "{whose} efforts read {gain} too large.",
        "a gain error",
        size="gain",
        opposite="{whose} efforts read {gain} too small.",
        units={"gain": ReadableUnit("%", 100.0, neutral=1.0)},
    )
    shape_units = {"gain": "1"}
    needs_earlier = True
    typical = (0.2,)
    amplitudes = "gain"

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """Neutral, in each actuator by itself."""
        for j in range(1, scene.robot.n_joints + 1):
            yield cls(joints=(j,), gain=(1.0,))

    def columns(self, rows: Rows, robot: Robot, motion: Motion) -> Array:
        """The joint's rows, scaled."""
        factor = np.ones(robot.n_joints)
        factor[self.acting(robot.n_joints)] = self.gain
        return factor[:, None] * rows(robot, motion)

    def change(self, scene: Scene) -> tuple[Array, Array]:
        """Linear in the gain."""
        acting = self.acting(scene.robot.n_joints)
        columns = np.zeros((*scene.effort.shape, len(acting)))
        columns[:, acting, np.arange(len(acting))] = scene.effort[:, acting]
        return columns @ (np.array(self.gain) - 1.0), columns

    def of_magnitude(self, magnitude: float, direction: Direction, scene: Scene) -> Self:
        """Too large or too small by a share of the effort."""
        return self.moved(np.array([direction.sign * magnitude]))

    def largest_magnitude(self, scene: Scene) -> float:
        """Twice as large as any effect that is simulated."""
        return TUNING.largest_gain
