"""A gear whose ratio is not as stated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.distortion import Direction, Distortion, Rows
from bayesid.effects.effect import Phrase, ReadableUnit, Scene
from bayesid.effects.tuning import TUNING
from bayesid.motion import Motion
from bayesid.robot import Robot

_STEP = 1e-5
"""Of the differences: their error is of this size, relative to the effort, and rounding 1e-11 of it."""


@dataclass(frozen=True, kw_only=True)
class GearRatio(Distortion):
    """The joint moves 1 + error times as far as its positions say, from its zero.

    Args:
        error: (m,) of each actuator.
    """

    error: tuple[float, ...]

    name = "gear_ratio"
    physics = "A wrong gear ratio between encoder and joint: the joint moves further than is logged."
    reference = "Mooring, Roth, Driels, Fundamentals of Manipulator Calibration, 1991"
    variable = "position"
    shown_by = "moving the joint far from its zero, both ways, slowly and fast"
    phrase = Phrase(
        "{whose} gear ratio is off: it moves {ratio} further than its positions say.",
        "a wrong gear ratio",
        size="ratio",
        opposite="{whose} gear ratio is off: it moves {ratio} less far than its positions say.",
        units={"ratio": ReadableUnit("%", 100.0)},
    )
    needs_earlier = True
    typical = (0.03,)
    amplitudes = "error"

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """Neutral, in each actuator by itself."""
        yield from (cls(joints=(j,), error=(0.0,)) for j in range(1, scene.robot.n_joints + 1))

    def columns(self, rows: Rows, robot: Robot, motion: Motion) -> Array:
        """Rows of the motion as it is."""
        return rows(robot, self._moving(robot, motion))

    def change(self, scene: Scene) -> tuple[Array, Array]:
        """By differences."""
        here = self._effort(scene) if any(self.error) else scene.effort_as_told
        steps = _STEP * np.eye(len(self.error))
        columns = np.stack([self.moved(step)._effort(scene) - here for step in steps], axis=2) / _STEP
        return here - scene.effort_as_told, columns

    def numbers(self, robot: Robot) -> Mapping[str, tuple[float, str]]:
        """The errors."""
        pairs = zip(self.acting(robot.n_joints), self.error, strict=True)
        return {f"ratio{j + 1}": (float(error), "1") for j, error in pairs}

    def of_magnitude(self, magnitude: float, direction: Direction, scene: Scene) -> Self:
        """Too far or too little by a share of the motion."""
        return self.moved(np.array([direction.sign * magnitude]))

    def largest_magnitude(self, scene: Scene) -> float:
        """Twice as far, or not at all."""
        return TUNING.largest_ratio

    def _effort(self, scene: Scene) -> Array:
        return scene.effort_with(scene.robot, self._moving(scene.robot, scene.motion))

    def _moving(self, robot: Robot, motion: Motion) -> Motion:
        if not any(self.error):
            return motion
        factor = np.ones(robot.n_joints)
        factor[self.acting(robot.n_joints)] += self.error
        to_joints = (np.linalg.inv(robot.coupling) @ (factor[:, None] * robot.coupling)).T
        return replace(motion, q=motion.q @ to_joints, dq=motion.dq @ to_joints, ddq=motion.ddq @ to_joints)
