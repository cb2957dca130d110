"""A base that does not stand upright."""

from __future__ import annotations

import math
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

_STEP = 1e-4
"""rad, of the differences: their error is of this size, relative to the effort, and rounding 1e-12 of it."""
_DEGREES = ReadableUnit("degrees", 180.0 / math.pi)


@dataclass(frozen=True, kw_only=True)
class BaseTilt(Distortion):
    """Gravity turned, as the base sees it, about two axes across its nominal direction.

    The first is the base's axis that is furthest from gravity, made perpendicular to it; the second is perpendicular to
    both: x and y of a base that stands upright.

    Args:
        angle: (2,) rad, about the first and the second of these axes.
    """

    angle: tuple[float, ...]

    name = "base_tilt"
    physics = "The base is not mounted as stated: gravity points elsewhere in its frame."
    reference = "Newton-Euler with the base accelerated against gravity (Luh, Walker, Paul 1980)"
    variable = "position"
    shown_by = "turning the first joint through its whole range with the arm stretched"
    phrase = Phrase(
        "The base is tilted by {tilt1} and {tilt2}, about two axes across gravity as the model has it.",
        "a base tilt",
        units={"tilt1": _DEGREES, "tilt2": _DEGREES},
    )
    typical = (0.1, 0.1, 0.5, 0.5)
    reveals = True
    by_joint = False
    whole_robot = True
    counts = {"angle": 2}
    amplitudes = "angle"

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """Neutral."""
        yield cls(angle=(0.0, 0.0))

    def columns(self, rows: Rows, robot: Robot, motion: Motion) -> Array:
        """Rows under the gravity that the base sees."""
        return rows(self.built(robot), motion)

    def change(self, scene: Scene) -> tuple[Array, Array]:
        """By differences."""
        here = scene.effort_with(self._built(scene.robot), scene.motion)
        tilted = [self.moved(_STEP * axis)._built(scene.robot) for axis in np.eye(2)]
        columns = np.stack([scene.effort_with(robot, scene.motion) - here for robot in tilted], axis=2) / _STEP
        return here - scene.effort_as_told, np.concatenate([columns, _first_link(scene)], axis=2)

    def numbers(self, robot: Robot) -> Mapping[str, tuple[float, str]]:
        """The two angles."""
        return {"tilt1": (self.angle[0], "rad"), "tilt2": (self.angle[1], "rad")}

    def of_magnitude(self, magnitude: float, direction: Direction, scene: Scene) -> Self:
        """Turned by an angle, rad."""
        return self.moved(magnitude * np.array([np.cos(direction.angle), np.sin(direction.angle)]))

    def largest_magnitude(self, scene: Scene) -> float:
        """No base is mounted further off."""
        return TUNING.steepest_tilt

    def _built(self, robot: Robot) -> Robot:
        turn = scipy.spatial.transform.Rotation.from_rotvec(np.array(self.angle) @ _across(robot.gravity))
        return replace(robot, gravity=turn.as_matrix() @ robot.gravity)


def _first_link(scene: Scene) -> Array:
    """(N, n, 2) sine and cosine of the first joint.

    Where gravity lies along its axis, only a tilt shows the weight of link 1; how large it is, no earlier log shows.
    Zero where the first joint is mounted otherwise.
    """
    joint, columns = scene.robot.joints[0], np.zeros((*scene.effort.shape, 2))
    along = joint.placement[:3, :3] @ joint.axis
    if not joint.prismatic and np.linalg.norm(np.cross(along, scene.robot.gravity)) < TUNING.parallel:
        columns[:, 0] = np.stack([np.sin(scene.motion.q[:, 0]), np.cos(scene.motion.q[:, 0])], axis=1)
    return columns


def _across(gravity: Array) -> Array:
    """(2, 3) unit axes across gravity."""
    down = gravity / (float(np.linalg.norm(gravity)) or 1.0)
    first = np.eye(3)[np.argmin(np.abs(down))]
    first = first - first @ down * down
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(first, down)])
