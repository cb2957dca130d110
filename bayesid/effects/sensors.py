"""Sensors and drives that saturate or have a dead zone."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Self

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects.distortion import Direction, SensorDistortion
from bayesid.effects.effect import Numbers, Phrase, Scene, number
from bayesid.effects.tuning import TUNING


class Clipping(SensorDistortion):
    """The sensor or drive saturates: efforts beyond a limit read as the limit.

    Args:
        limit: (m,) of each actuator, N m.
    """

    limit: Numbers = number("N m")

    name = "clipping"
    shown_by = "reaching well beyond the limit, with a payload or at high acceleration"
    phrase = Phrase("{whose} efforts are clipped at {limit}.", "clipping")

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """Limits near the highest reading, if the model exceeds it."""
        for j in range(scene.robot.n_joints):
            top, needed = np.percentile(scene.measured[:, j], TUNING.clipping_top), np.abs(scene.effort[:, j]).max()
            if needed > top:
                limits = top * np.linspace(0.8, 1.0, TUNING.clipping_limits)
                yield from (cls(joints=(j + 1,), limit=(limit,)) for limit in limits.tolist())

    def reading(self, effort: Array) -> Array:
        limit = np.array(self.limit)
        return np.clip(effort, -limit, limit)

    def restoring(self, reading: Array) -> tuple[Array, Mask]:
        """A reading at the limit is only a lower bound."""
        return reading, reading < TUNING.near_limit * np.array(self.limit)

    def of_magnitude(self, magnitude: float, direction: Direction, scene: Scene) -> Self:
        """The magnitude is the largest effort minus the limit, N m."""
        return super().of_magnitude(self.largest_magnitude(scene) - magnitude, direction, scene)


class DeadZone(SensorDistortion):
    """The sensor or drive does not show small efforts: below a threshold they read as zero.

    Dead zone without offset; Tao and Kokotovic 1996.

    Args:
        width: (m,) threshold of each actuator, N m.
    """

    width: Numbers = number("N m")

    name = "dead_zone"
    shown_by = "slow changes of the load through zero"
    phrase = Phrase("{whose} efforts below {width} read as zero.", "a dead zone")

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """Thresholds on a grid, and above gaps between readings, as a hard threshold leaves."""
        widths = 0.005 * TUNING.dead_zone_growth ** np.arange(18)
        for j in range(scene.robot.n_joints):
            top = float(np.percentile(scene.measured[:, j], TUNING.dead_zone_top))
            for width in sorted({*(top * widths).tolist(), *_above_gaps(scene.measured[:, j], top)}):
                yield cls(joints=(j + 1,), width=(width,))

    def reading(self, effort: Array) -> Array:
        return np.where(np.abs(effort) < np.array(self.width), 0.0, effort)

    def restoring(self, reading: Array) -> tuple[Array, Mask]:
        """A reading clearly below the threshold is only an upper bound."""
        return reading, reading > TUNING.clearly_above * np.array(self.width)


class ShrinkingDeadZone(DeadZone):
    """Readings are smaller than efforts by a constant; those of small efforts are zero.

    Dead zone with offset; Tao and Kokotovic 1996.
    """

    name = "dead_zone.shrinking"
    phrase = Phrase("{whose} efforts read {width} too small, the smallest as zero.")

    def reading(self, effort: Array) -> Array:
        return np.sign(effort) * np.maximum(np.abs(effort) - np.array(self.width), 0.0)

    def restoring(self, reading: Array) -> tuple[Array, Mask]:
        width = np.array(self.width)
        return reading + width, reading > TUNING.clearly_read * width


def _above_gaps(magnitude: Array, top: float) -> list[float]:
    """The readings just above the widest gaps between low readings, and multiples, as noise blurs the edge."""
    readings = np.sort(magnitude[magnitude < TUNING.gaps_below * top])
    edges = readings[np.argsort(-np.diff(readings))[: TUNING.gaps] + 1]
    return [float(edge * blur) for edge in edges for blur in TUNING.blurs if edge > 0.0]
