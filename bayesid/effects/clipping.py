"""A sensor or drive that saturates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects.distortion import Direction, SensorDistortion
from bayesid.effects.effect import Phrase, Scene
from bayesid.effects.tuning import TUNING


@dataclass(frozen=True, kw_only=True)
class Clipping(SensorDistortion):
    """Efforts beyond a limit read as the limit.

    Args:
        limit: (m,) of each actuator, N m.
    """

    limit: tuple[float, ...]

    name = "clipping"
    physics = "The sensor or drive saturates: efforts beyond a limit read as the limit."
    reference = "Saturation"
    shown_by = "reaching well beyond the limit, with a payload or at high acceleration"
    phrase = Phrase("{whose} efforts are cut off at {limit}.", "clipping")
    shape_units = {"limit": "N m"}

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """Over limits that the model exceeds and the readings hardly do."""
        for j in range(scene.robot.n_joints):
            top, needed = np.percentile(scene.measured[:, j], TUNING.clipping_top), np.abs(scene.effort[:, j]).max()
            if needed > top:
                limits = top * np.linspace(0.8, 1.0, TUNING.clipping_limits)
                yield from (cls(joints=(j + 1,), limit=(limit,)) for limit in limits.tolist())

    def measured(self, effort: Array) -> Array:
        """Held between the limits."""
        acting, read = self.acting(effort.shape[1]), effort.copy()
        limit = np.array(self.limit)
        read[:, acting] = np.clip(effort[:, acting], -limit, limit)
        return read

    def restored(self, magnitude: Array) -> tuple[Array, Mask]:
        """Readings at the limit show nothing but that it was reached."""
        valid = np.ones(magnitude.shape, dtype=bool)
        acting = self.acting(magnitude.shape[1])
        valid[:, acting] = magnitude[:, acting] < TUNING.near_limit * np.array(self.limit)
        return magnitude, valid

    def of_magnitude(self, magnitude: float, direction: Direction, scene: Scene) -> Self:
        """By so much, N m, the limit lies below the largest effort."""
        return replace(self, limit=(self.largest_magnitude(scene) - magnitude,))
