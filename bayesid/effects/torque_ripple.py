"""Torque that repeats with the position."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Phrase, ReadableUnit, Scene
from bayesid.effects.term import ActuatorTerm
from bayesid.motion import Motion

_LOWEST = 3.0
"""1/rad; slower waves of the position, of 2 rad and more, are springs and gravity."""
_STEP = 0.35
"""Of the harmonic, in units of pi over the joint's range: two neighbours differ by less than half a wave."""
_FASTEST = 0.7
"""Share of the log's Nyquist frequency that the ripple may reach at the usual speed: filters cut what is faster."""
_USUAL_SPEED = 80
"""Percentile of the speeds; a round number, not studied."""
_MOST = 400
"""Harmonics tried at most: bounds the time of a comparison."""
_TINY = 1e-6
"""rad and rad/s, in denominators of joints that do not move."""


@dataclass(frozen=True, kw_only=True)
class TorqueRipple(ActuatorTerm):
    """rs sin(h u) + rc cos(h u), free: cogging of the motor, teeth of the gear, the wave generator of a strain gear.

    Args:
        harmonic: (m,) waves h in a radian times 2 pi, of each actuator; 1/rad.
    """

    harmonic: tuple[float, ...]

    name: ClassVar[str] = "torque_ripple"
    physics: ClassVar[str] = "Ripple of motor or gear: a torque that repeats many times in a turn of the joint."
    reference: ClassVar[str] = "Ghorbel, Gandhi, Alpeter, On the kinematic error in harmonic drive gears, 2001"
    variable: ClassVar[str] = "position"
    shown_by: ClassVar[str] = "moving slowly over a large range, at several speeds"
    phrase: ClassVar[Phrase] = Phrase(
        "{who} needs torque ripple of {harmonic} waves a turn: {rs} in the sine and {rc} in the cosine.",
        "torque ripple",
        units={"harmonic": ReadableUnit("")},
    )
    shape_units: ClassVar[Mapping[str, str]] = {"harmonic": "1/rad"}
    symbols: ClassVar[tuple[str, ...]] = ("rs", "rc")
    units: ClassVar[tuple[tuple[str, str], ...]] = (("N m", "N"), ("N m", "N"))

    @classmethod
    def shapes(cls, scene: Scene, joint: int) -> Iterator[Mapping[str, float]]:
        """Over the harmonics that the log can resolve."""
        u, speed = scene.actuators.q[:, joint], np.abs(scene.actuators.dq[:, joint])
        rate = 1.0 / float(np.median(np.diff(scene.motion.t)))
        highest = _FASTEST * np.pi * rate / max(float(np.percentile(speed, _USUAL_SPEED)), _TINY)
        step = max(_STEP * np.pi / max(float(np.ptp(u)), _TINY), (highest - _LOWEST) / _MOST)
        for harmonic in np.arange(_LOWEST, highest, step):
            yield {"harmonic": float(harmonic)}

    def unit_efforts(self, actuators: Motion) -> Array:
        """Sine and cosine of the harmonic."""
        phase = np.array(self.harmonic) * actuators.q
        return np.stack([np.sin(phase), np.cos(phase)], axis=2)
