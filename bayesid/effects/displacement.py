"""What errors of a robot's table have in common: one number of a joint's row is off."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.distortion import Direction, Distortion, Rows
from bayesid.effects.effect import Scene
from bayesid.motion import Motion
from bayesid.robot import Robot

_STEP = 1e-5
"""m and rad, of the differences: their error is of this size, relative to the effort, and rounding 1e-11 of it."""
_ROUNDING = 1e-8
"""Share of the robot's largest effort per m or rad, up to which a slope is rounding."""
_LONGEST, _WIDEST = 0.1, 0.5
"""m and rad, the largest errors that are simulated; round numbers, far beyond any table's."""


@dataclass(frozen=True, kw_only=True)
class Displacement(Distortion):
    """Base of errors of one number of a table's rows.

    Args:
        error: (m,) by how much the number is larger than the table has it, m or rad.
    """

    error: tuple[float, ...]

    symbol: ClassVar[str]
    """Of the number."""
    of_angle: ClassVar[bool]
    """Whether it is an angle."""
    reference: ClassVar[str] = "Denavit and Hartenberg, A kinematic notation for lower-pair mechanisms, 1955"
    variable: ClassVar[str] = "position"
    needs_earlier: ClassVar[bool] = True
    of_table: ClassVar[bool] = True

    def displaced(self, robot: Robot, joint: int, step: float) -> Robot:
        """The robot with the number of a (0-based) joint larger by a step, m or rad."""
        raise NotImplementedError

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """Neutral, of each joint."""
        joints = (j for j in range(scene.robot.n_joints) if cls.stands_alone(scene.robot, j))
        yield from (cls(joints=(j + 1,), error=(0.0,)) for j in joints)

    @classmethod
    def stands_alone(cls, robot: Robot, joint: int) -> bool:
        """Whether the number of a (0-based) joint is not another effect's business."""
        return True

    def columns(self, rows: Rows, robot: Robot, motion: Motion) -> Array:
        """Rows of the robot as it is built."""
        return rows(self.built(robot), motion)

    def change(self, scene: Scene) -> tuple[Array, Array]:
        """Of the whole model's effort; slopes by differences of the links' alone."""
        built, moved = self._built(scene.robot), np.zeros_like(scene.effort)
        if any(self.error):
            moved = scene.effort_with(built, scene.motion) - scene.effort_as_told
        here = built.inverse_dynamics(scene.motion, scene.links) if any(self.error) else scene.link_effort
        slopes = [self._slope(scene, built, here, j) for j in self.acting(scene.robot.n_joints)]
        return moved, np.stack(slopes, axis=2)

    def moved(self, step: Array) -> Self:
        """Other errors."""
        return replace(self, error=tuple((np.array(self.error) + step[: len(self.error)]).tolist()))

    def numbers(self, robot: Robot) -> Mapping[str, tuple[float, str]]:
        """The errors."""
        pairs = zip(self.acting(robot.n_joints), self.error, strict=True)
        return {f"{self.symbol}{j + 1}": (float(error), "rad" if self.of_angle else "m") for j, error in pairs}

    def of_magnitude(self, magnitude: float, direction: Direction, scene: Scene) -> Self:
        """Off by a length or an angle, m or rad."""
        return replace(self, error=(direction.sign * magnitude,))

    def largest_magnitude(self, scene: Scene) -> float:
        """No table is further off."""
        return _WIDEST if self.of_angle else _LONGEST

    def _built(self, robot: Robot) -> Robot:
        for j, step in zip(self.acting(robot.n_joints), self.error, strict=True):
            robot = self.displaced(robot, j, step) if step else robot
        return robot

    def _slope(self, scene: Scene, built: Robot, here: Array, joint: int) -> Array:
        """(N, n) by the number of one joint, N m per m or rad; zero where it is rounding."""
        slope = (self.displaced(built, joint, _STEP).inverse_dynamics(scene.motion, scene.links) - here) / _STEP
        slope[:, np.abs(slope).max(axis=0) < _ROUNDING * np.abs(scene.effort).max()] = 0.0
        return slope
