"""A wrong gain of sensor or drive."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from bayesid.distortions.base import Distortion, Rows
from bayesid.motion import Array, Motion
from bayesid.robot import Robot
from bayesid.terms.base import Scene


@dataclass(frozen=True, kw_only=True)
class GainError(Distortion):
    """Efforts are read `gain` times as large as they are.

    Args:
        gain: (m,) of each actuator.
    """

    gain: tuple[float, ...]

    name: ClassVar[str] = "gain_error"
    physics: ClassVar[str] = "A wrong torque constant, gear ratio or amplifier: all efforts of a joint are scaled."
    reference: ClassVar[str] = "Gautier and Briot, Global identification of joint drive gains, 2014"
    variable: ClassVar[str] = "load"
    told_by: ClassVar[str] = "the same motion with a known payload"
    symbol: ClassVar[str] = "gain"
    unit: ClassVar[str] = "1"
    typical: ClassVar[float] = 0.2

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """Neutral, in each actuator by itself."""
        for j in range(1, scene.robot.n_joints + 1):
            yield cls(joints=(j,), gain=(1.0,))

    def columns(self, rows: Rows, robot: Robot, motion: Motion) -> Array:
        """The joint's rows, scaled."""
        factor = np.ones(robot.n_joints)
        factor[self.own(robot.n_joints)] = self.gain
        return factor[:, None] * rows(robot, motion)

    def change(self, scene: Scene) -> tuple[Array, Array]:
        """Linear in the gain."""
        own = self.own(scene.robot.n_joints)
        columns = np.zeros((*scene.effort.shape, len(own)))
        columns[:, own, np.arange(len(own))] = scene.effort[:, own]
        return columns @ (np.array(self.gain) - 1.0), columns

    def moved(self, step: Array) -> Self:
        """Another gain."""
        return replace(self, gain=tuple((np.array(self.gain) + step).tolist()))

    @property
    def numbers(self) -> Mapping[str, tuple[float, str]]:
        """The gains."""
        joints = self.joints or range(1, len(self.gain) + 1)
        return {f"gain{j}": (gain, "1") for j, gain in zip(joints, self.gain, strict=True)}
