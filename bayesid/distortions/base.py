"""What a distortion is: an effect that adds no columns to the model but changes its rows, or what the sensor reads.

A delay or a tilted base changes the rows Y that a model makes of a motion; a sensor that clips changes what becomes of
its effort. Columns stay linear in the model's parameters, so everything downstream stays as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from typing import ClassVar, Self

import numpy as np

from bayesid.motion import Array, Mask, Motion
from bayesid.robot import Robot
from bayesid.terms.base import Scene

Rows = Callable[[Robot, Motion], Array]
"""Makes (N, n, P) columns of a motion."""


@dataclass(frozen=True, kw_only=True)
class Distortion:
    """Base of all distortions; a subclass is a frozen dataclass whose fields are its numbers, one an actuator.

    Args:
        joints: the actuators (from 1) on which it acts; all of them if empty.
    """

    joints: tuple[int, ...] = ()

    name: ClassVar[str]
    physics: ClassVar[str]
    reference: ClassVar[str]
    variable: ClassVar[str]
    told_by: ClassVar[str]
    symbol: ClassVar[str]
    unit: ClassVar[str]
    memory: ClassVar[bool] = False
    of_sensor: ClassVar[bool] = False
    """Whether it changes what is read of the efforts, not the model's rows."""
    typical: ClassVar[float | tuple[float, ...]] = 0.0
    """Prior standard deviations of the amplitudes of `change`, about neutral; 0 where there are none."""
    reveals: ClassVar[bool] = False
    """Whether its rows show parameters that no log without it could show."""
    count: ClassVar[int] = 0
    """How many numbers it has; one an actuator if 0."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", tuple(int(j) for j in self.joints))

    @classmethod
    def variants(cls, scene: Scene) -> Iterable[Self]:
        """The forms in which it may be hidden in a log."""
        raise NotImplementedError

    @property
    def shape(self) -> Mapping[str, list[float]]:
        """Its numbers, what model.toml keeps."""
        values = {one.name: list(getattr(self, one.name)) for one in fields(self)}
        return {key: value for key, value in values.items() if key != "joints" or value}

    def check(self, n_joints: int) -> None:
        """Raises ValueError if the numbers do not suit a robot of n joints."""
        own = self.own(n_joints)
        if len(set(own)) < len(own) or not all(0 <= j < n_joints for j in own):
            raise ValueError(f"joints {list(self.joints)} are not joints of the robot")
        for key, values in self.shape.items():
            if key != "joints" and len(values) != (self.count or len(own)):
                raise ValueError(f"{key} has {len(values)} numbers, expected {self.count or len(own)}")

    def own(self, n_joints: int) -> list[int]:
        """The (0-based) actuators on which it acts."""
        return [j - 1 for j in self.joints] or list(range(n_joints))

    def columns(self, rows: Rows, robot: Robot, motion: Motion) -> Array:
        """(N, n, P) what becomes of the model's columns."""
        return rows(robot, motion)

    def measured(self, effort: Array) -> Array:
        """(N, n) what the sensor reads of efforts (N, n), N m."""
        return effort

    def restored(self, magnitude: Array) -> tuple[Array, Mask]:
        """(N, n) absolute efforts before the sensor's doing, N m, and (N, n) where the reading tells them."""
        return magnitude, np.ones(magnitude.shape, dtype=bool)

    def change(self, scene: Scene) -> tuple[Array, Array]:
        """(N, n) change of the scene's effort, N m, and its derivatives (N, n, p) by the p free numbers."""
        raise NotImplementedError

    def moved(self, step: Array) -> Self:
        """The distortion with its free numbers changed by the first entries of step (p,)."""
        return self

    @property
    def numbers(self) -> Mapping[str, tuple[float, str]]:
        """Name to value and unit, for people."""
        raise NotImplementedError


def no_columns(effort: Array) -> Array:
    """(N, n, 0)."""
    return np.zeros((*effort.shape, 0))
