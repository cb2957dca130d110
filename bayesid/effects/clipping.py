"""A sensor or drive that saturates."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects.distortion import Direction, Distortion, largest_effort, no_columns
from bayesid.effects.effect import Phrase, Scene

_TRIED = 16
"""Limits tried, between 0.8 and 1 times the highest readings; a round number, refined about the best of them."""
_NEAR = 0.94
"""Readings above this share of the limit may be clipped: it leaves room for noise of a few percent; not studied."""
_TOP = 99.8
"""Percentile of the readings that counts as the highest: single spikes are none; a round number, not studied."""


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
    shown_by: ClassVar[str] = "reaching well beyond the limit, with a payload or at high acceleration"
    of_effort: ClassVar[bool] = True
    phrase: ClassVar[Phrase] = Phrase("{whose} efforts are cut off at {limit}.", "clipping")
    shape_units: ClassVar[Mapping[str, str]] = {"limit": "N m"}
    of_sensor: ClassVar[bool] = True

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """Over limits that the model exceeds and the readings hardly do."""
        for j in range(scene.robot.n_joints):
            top, needed = np.percentile(scene.measured[:, j], _TOP), np.abs(scene.effort[:, j]).max()
            if needed > top:
                yield from (cls(joints=(j + 1,), limit=(float(x),)) for x in top * np.linspace(0.8, 1.0, _TRIED))

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
        valid[:, acting] = magnitude[:, acting] < _NEAR * np.array(self.limit)
        return magnitude, valid

    def change(self, scene: Scene) -> tuple[Array, Array]:
        """What is cut off."""
        return self.measured(scene.effort) - scene.effort, no_columns(scene.effort)

    def of_magnitude(self, magnitude: float, direction: Direction, scene: Scene) -> Self:
        """By so much, N m, the limit lies below the largest effort."""
        return replace(self, limit=(largest_effort(self, scene) - magnitude,))

    def largest_magnitude(self, scene: Scene) -> float:
        """The largest effort: nothing is then read."""
        return largest_effort(self, scene)
