"""A sensor that is blind near zero."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects.distortion import Direction, Distortion, largest_effort, no_columns
from bayesid.effects.effect import Phrase, Scene

_TOP = 99
"""Percentile of the readings that counts as the highest; a round number, not studied."""
_WIDTHS = 0.005 * 1.3 ** np.arange(18)
"""Thresholds tried, as shares of the highest readings: up to 0.43 of them, near enough to be refined in between."""
_BLURS = (1.0, 1.05, 1.1, 1.2)
"""Thresholds tried above a gap between readings, relative to it: noise may blur the edge; not studied."""
_GAPS = 3
"""Gaps between readings that are tried, the widest; not studied."""
_LOWER = 0.6
"""Share of the highest readings below which gaps are looked for; above, readings are sparse by themselves."""
_CLEARLY_ABOVE = 0.5
"""Readings above this share of the threshold are no zeros: midway between these and it."""
_CLEARLY_READ = 0.3
"""The same where efforts are read smaller by the threshold, and only noise makes zeros larger; not studied."""


def _above_gaps(magnitude: Array, top: float) -> list[float]:
    """The readings right above the widest gaps between the lower ones, and somewhat more: noise may blur the edge."""
    readings = np.sort(magnitude[magnitude < _LOWER * top])
    edges = readings[np.argsort(-np.diff(readings))[:_GAPS] + 1]
    return [float(edge * blur) for edge in edges for blur in _BLURS if edge > 0.0]


@dataclass(frozen=True, kw_only=True)
class DeadZone(Distortion):
    """Efforts below a threshold read as zero.

    Args:
        width: (m,) threshold of each actuator, N m.
    """

    width: tuple[float, ...]

    name: ClassVar[str] = "dead_zone"
    physics: ClassVar[str] = "The sensor or drive does not show small efforts: below a threshold it reads zero."
    reference: ClassVar[str] = "Dead zone without offset; Tao and Kokotovic 1996"
    variable: ClassVar[str] = "load"
    shown_by: ClassVar[str] = "slow changes of the load through zero"
    of_effort: ClassVar[bool] = True
    phrase: ClassVar[Phrase] = Phrase("{whose} efforts below {width} read as zero.", "a dead zone")
    shape_units: ClassVar[Mapping[str, str]] = {"width": "N m"}
    of_sensor: ClassVar[bool] = True

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """Over the threshold: evenly, and where the readings leave gaps, which a hard threshold does."""
        for j in range(scene.robot.n_joints):
            top = float(np.percentile(scene.measured[:, j], _TOP))
            for width in sorted({*(top * _WIDTHS).tolist(), *_above_gaps(scene.measured[:, j], top)}):
                yield cls(joints=(j + 1,), width=(width,))

    def measured(self, effort: Array) -> Array:
        """Nothing below the threshold."""
        acting, read = self.acting(effort.shape[1]), effort.copy()
        read[:, acting] = np.where(np.abs(effort[:, acting]) < np.array(self.width), 0.0, effort[:, acting])
        return read

    def restored(self, magnitude: Array) -> tuple[Array, Mask]:
        """Readings clearly below the threshold show nothing but that."""
        valid = np.ones(magnitude.shape, dtype=bool)
        acting = self.acting(magnitude.shape[1])
        valid[:, acting] = magnitude[:, acting] > _CLEARLY_ABOVE * np.array(self.width)
        return magnitude, valid

    def change(self, scene: Scene) -> tuple[Array, Array]:
        """What is missing below the threshold."""
        return self.measured(scene.effort) - scene.effort, no_columns(scene.effort)

    def of_magnitude(self, magnitude: float, direction: Direction, scene: Scene) -> Self:
        """With a threshold, N m."""
        return replace(self, width=(magnitude,))

    def largest_magnitude(self, scene: Scene) -> float:
        """The largest effort: nothing is then read."""
        return largest_effort(self, scene)


@dataclass(frozen=True, kw_only=True)
class ShrinkingDeadZone(DeadZone):
    """Efforts below a threshold read as zero, larger ones smaller by the threshold."""

    name: ClassVar[str] = "dead_zone.shrinking"
    physics: ClassVar[str] = "The sensor or drive lacks a constant part of every effort, up to the whole of small ones."
    reference: ClassVar[str] = "Dead zone with offset; Tao and Kokotovic 1996"
    phrase: ClassVar[Phrase] = Phrase("{whose} efforts read {width} too small, the smallest as zero.")

    def measured(self, effort: Array) -> Array:
        """Smaller by the threshold."""
        acting, read = self.acting(effort.shape[1]), effort.copy()
        size = np.abs(effort[:, acting]) - np.array(self.width)
        read[:, acting] = np.sign(effort[:, acting]) * np.maximum(size, 0.0)
        return read

    def restored(self, magnitude: Array) -> tuple[Array, Mask]:
        """Larger by the threshold, where anything is read."""
        acting, full = self.acting(magnitude.shape[1]), magnitude.copy()
        width, valid = np.array(self.width), np.ones(magnitude.shape, dtype=bool)
        full[:, acting] = magnitude[:, acting] + width
        valid[:, acting] = magnitude[:, acting] > _CLEARLY_READ * width
        return full, valid
