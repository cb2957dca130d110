"""A sensor or drive that saturates."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from bayesid.distortions.base import Distortion, no_columns
from bayesid.motion import Array, Mask
from bayesid.terms.base import Scene

_TRIED = 16
_NEAR = 0.94
"""Readings above this share of the limit may be clipped."""


@dataclass(frozen=True, kw_only=True)
class Clipping(Distortion):
    """Efforts beyond a limit read as the limit.

    Args:
        limit: (m,) of each actuator, N m.
    """

    limit: tuple[float, ...]

    name: ClassVar[str] = "clipping"
    physics: ClassVar[str] = "The sensor or drive saturates: efforts beyond a limit read as the limit."
    reference: ClassVar[str] = "Saturation"
    variable: ClassVar[str] = "load"
    told_by: ClassVar[str] = "reaching well beyond the limit, with a payload or at high acceleration"
    symbol: ClassVar[str] = "limit"
    unit: ClassVar[str] = "N m"
    of_sensor: ClassVar[bool] = True

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """Over limits that the model exceeds and the readings hardly do."""
        for j in range(scene.robot.n_joints):
            top, asked = np.percentile(scene.measured[:, j], 99.8), np.abs(scene.effort[:, j]).max()
            if asked > top:
                yield from (cls(joints=(j + 1,), limit=(float(x),)) for x in top * np.linspace(0.8, 1.0, _TRIED))

    def measured(self, effort: Array) -> Array:
        """Held between the limits."""
        own, read = self.own(effort.shape[1]), effort.copy()
        limit = np.array(self.limit)
        read[:, own] = np.clip(effort[:, own], -limit, limit)
        return read

    def restored(self, magnitude: Array) -> tuple[Array, Mask]:
        """Readings at the limit tell nothing but that it was reached."""
        told = np.ones(magnitude.shape, dtype=bool)
        own = self.own(magnitude.shape[1])
        told[:, own] = magnitude[:, own] < _NEAR * np.array(self.limit)
        return magnitude, told

    def change(self, scene: Scene) -> tuple[Array, Array]:
        """What is cut off."""
        return self.measured(scene.effort) - scene.effort, no_columns(scene.effort)

    @property
    def numbers(self) -> Mapping[str, tuple[float, str]]:
        """The limits."""
        joints = self.joints or range(1, len(self.limit) + 1)
        return {f"limit{j}": (limit, "N m") for j, limit in zip(joints, self.limit, strict=True)}
