"""A base that does not stand upright."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from scipy.spatial.transform import Rotation

from bayesid.distortions.base import Distortion, Rows
from bayesid.motion import Array, Motion
from bayesid.robot import Robot
from bayesid.terms.base import Scene

_PARALLEL = 0.1
"""m/s^2 of gravity across the first axis, below which the first link's weight is taken to have left no trace."""
_STEP = 1e-4
"""rad, of the differences."""


@dataclass(frozen=True, kw_only=True)
class BaseTilt(Distortion):
    """Gravity turned, as the base sees it, about two axes across its nominal direction.

    The first is the base's axis that is furthest from gravity, made perpendicular to it; the second is perpendicular to
    both: x and y of a base that stands upright.

    Args:
        angle: (2,) rad, about the first and the second of these axes.
    """

    angle: tuple[float, ...]

    name: ClassVar[str] = "base_tilt"
    physics: ClassVar[str] = "The base is not mounted as stated: gravity points elsewhere in its frame."
    reference: ClassVar[str] = "Newton-Euler with the base accelerated against gravity (Luh, Walker, Paul 1980)"
    variable: ClassVar[str] = "position"
    told_by: ClassVar[str] = "turning the first joint through its whole range with the arm stretched"
    symbol: ClassVar[str] = "tilt"
    unit: ClassVar[str] = "rad"
    typical: ClassVar[tuple[float, ...]] = (0.1, 0.1, 0.5, 0.5)
    reveals: ClassVar[bool] = True
    count: ClassVar[int] = 2

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """Neutral."""
        yield cls(angle=(0.0, 0.0))

    def check(self, n_joints: int) -> None:
        """Two angles; it acts on all actuators."""
        super().check(n_joints)
        if self.joints:
            raise ValueError("the base carries all joints")

    def columns(self, rows: Rows, robot: Robot, motion: Motion) -> Array:
        """Rows under the gravity that the base sees."""
        return rows(self._tilted(robot), motion)

    def change(self, scene: Scene) -> tuple[Array, Array]:
        """By differences."""
        here = scene.effort_with(self._tilted(scene.robot))
        sides = [self.moved(_STEP * side)._tilted(scene.robot) for side in np.eye(2)]
        columns = np.stack([scene.effort_with(s) - here for s in sides], axis=2) / _STEP
        return here - scene.effort, np.concatenate([columns, _first_link(scene)], axis=2)

    def moved(self, step: Array) -> Self:
        """Another tilt."""
        return replace(self, angle=(self.angle[0] + float(step[0]), self.angle[1] + float(step[1])))

    @property
    def numbers(self) -> Mapping[str, tuple[float, str]]:
        """The two angles."""
        return {"tilt1": (self.angle[0], "rad"), "tilt2": (self.angle[1], "rad")}

    def _tilted(self, robot: Robot) -> Robot:
        turn = Rotation.from_rotvec(np.array(self.angle) @ _across(robot.gravity))
        return replace(robot, gravity=turn.as_matrix() @ robot.gravity)


def _first_link(scene: Scene) -> Array:
    """(N, n, 2) sine and cosine of the first joint.

    Where gravity lies along its axis, only a tilt shows the weight of link 1; how large it is, no log has told.
    Zero where the first joint is mounted otherwise.
    """
    joint, columns = scene.robot.joints[0], np.zeros((*scene.effort.shape, 2))
    along = joint.placement[:3, :3] @ joint.axis
    if not joint.prismatic and np.linalg.norm(np.cross(along, scene.robot.gravity)) < _PARALLEL:
        columns[:, 0] = np.stack([np.sin(scene.motion.q[:, 0]), np.cos(scene.motion.q[:, 0])], axis=1)
    return columns


def _across(gravity: Array) -> Array:
    """(2, 3) unit axes across gravity."""
    down = gravity / (float(np.linalg.norm(gravity)) or 1.0)
    first = np.eye(3)[np.argmin(np.abs(down))]
    first = first - first @ down * down
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(first, down)])
