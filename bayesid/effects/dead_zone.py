"""A sensor that is blind near zero."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects.distortion import Direction, SensorDistortion
from bayesid.effects.effect import Phrase, Scene
from bayesid.effects.tuning import TUNING


def _above_gaps(magnitude: Array, top: float) -> list[float]:
    """The readings right above the widest gaps between the lower ones, and somewhat more: noise may blur the edge."""
    readings = np.sort(magnitude[magnitude < TUNING.gaps_below * top])
    edges = readings[np.argsort(-np.diff(readings))[: TUNING.gaps] + 1]
    return [float(edge * blur) for edge in edges for blur in TUNING.blurs if edge > 0.0]


@dataclass(frozen=True, kw_only=True)
class DeadZone(SensorDistortion):
    """Efforts below a threshold read as zero.

    Args:
        width: (m,) threshold of each actuator, N m.
    """

    width: tuple[float, ...]

    name = "dead_zone"
    physics = "The sensor or drive does not show small efforts: below a threshold it reads zero."
    reference = "Dead zone without offset; Tao and Kokotovic 1996"
    shown_by = "slow changes of the load through zero"
    phrase = Phrase("{whose} efforts below {width} read as zero.", "a dead zone")
    shape_units = {"width": "N m"}

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """Over the threshold: evenly, and where the readings leave gaps, which a hard threshold does."""
        widths = 0.005 * TUNING.dead_zone_growth ** np.arange(18)
        for j in range(scene.robot.n_joints):
            top = float(np.percentile(scene.measured[:, j], TUNING.dead_zone_top))
            for width in sorted({*(top * widths).tolist(), *_above_gaps(scene.measured[:, j], top)}):
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
        valid[:, acting] = magnitude[:, acting] > TUNING.clearly_above * np.array(self.width)
        return magnitude, valid

    def of_magnitude(self, magnitude: float, direction: Direction, scene: Scene) -> Self:
        """With a threshold, N m."""
        return replace(self, width=(magnitude,))


@dataclass(frozen=True, kw_only=True)
class ShrinkingDeadZone(DeadZone):
    """Efforts below a threshold read as zero, larger ones smaller by the threshold."""

    name = "dead_zone.shrinking"
    physics = "The sensor or drive lacks a constant part of every effort, up to the whole of small ones."
    reference = "Dead zone with offset; Tao and Kokotovic 1996"
    phrase = Phrase("{whose} efforts read {width} too small, the smallest as zero.")

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
        valid[:, acting] = magnitude[:, acting] > TUNING.clearly_read * width
        return full, valid
