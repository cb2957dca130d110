"""A sensor that is blind near zero."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from bayesid.distortions.base import Distortion, no_columns
from bayesid.motion import Array, Mask
from bayesid.terms.base import Scene

_BLURS = (1.0, 1.05, 1.1, 1.2)
_GAPS, _LOWER = 3, 0.6
"""Gaps between readings that are tried, and the share of the 99th percentile below which they are looked for."""
_WIDTHS = 0.005 * 1.3 ** np.arange(18)
"""Half-widths tried, as shares of the 99th percentile of the readings."""


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
    told_by: ClassVar[str] = "slow changes of the load through zero"
    symbol: ClassVar[str] = "width"
    unit: ClassVar[str] = "N m"
    of_sensor: ClassVar[bool] = True

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """Over the threshold: evenly, and where the readings leave gaps, which a hard threshold does."""
        for j in range(scene.robot.n_joints):
            top = float(np.percentile(scene.measured[:, j], 99))
            for width in sorted({*(top * _WIDTHS).tolist(), *_above_gaps(scene.measured[:, j], top)}):
                yield cls(joints=(j + 1,), width=(width,))

    def measured(self, effort: Array) -> Array:
        """Nothing below the threshold."""
        own, read = self.own(effort.shape[1]), effort.copy()
        read[:, own] = np.where(np.abs(effort[:, own]) < np.array(self.width), 0.0, effort[:, own])
        return read

    def restored(self, magnitude: Array) -> tuple[Array, Mask]:
        """Readings clearly below the threshold tell nothing but that."""
        told = np.ones(magnitude.shape, dtype=bool)
        own = self.own(magnitude.shape[1])
        told[:, own] = magnitude[:, own] > 0.5 * np.array(self.width)
        return magnitude, told

    def change(self, scene: Scene) -> tuple[Array, Array]:
        """What is missing below the threshold."""
        return self.measured(scene.effort) - scene.effort, no_columns(scene.effort)

    @property
    def numbers(self) -> Mapping[str, tuple[float, str]]:
        """The thresholds."""
        joints = self.joints or range(1, len(self.width) + 1)
        return {f"width{j}": (width, "N m") for j, width in zip(joints, self.width, strict=True)}


@dataclass(frozen=True, kw_only=True)
class ShrinkingDeadZone(DeadZone):
    """Efforts below a threshold read as zero, larger ones smaller by the threshold."""

    name: ClassVar[str] = "dead_zone.shrinking"
    physics: ClassVar[str] = "The sensor or drive lacks a constant part of every effort, up to the whole of small ones."
    reference: ClassVar[str] = "Dead zone with offset; Tao and Kokotovic 1996"

    def measured(self, effort: Array) -> Array:
        """Smaller by the threshold."""
        own, read = self.own(effort.shape[1]), effort.copy()
        size = np.abs(effort[:, own]) - np.array(self.width)
        read[:, own] = np.sign(effort[:, own]) * np.maximum(size, 0.0)
        return read

    def restored(self, magnitude: Array) -> tuple[Array, Mask]:
        """Larger by the threshold, where anything is read."""
        own, full = self.own(magnitude.shape[1]), magnitude.copy()
        width, told = np.array(self.width), np.ones(magnitude.shape, dtype=bool)
        full[:, own] = magnitude[:, own] + width
        told[:, own] = magnitude[:, own] > 0.3 * width
        return full, told
