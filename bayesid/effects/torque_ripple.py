"""Torque that repeats with the position."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Phrase, ReadableUnit, Scene
from bayesid.effects.term import ActuatorTerm
from bayesid.effects.tuning import TUNING
from bayesid.motion import Motion


@dataclass(frozen=True, kw_only=True)
class TorqueRipple(ActuatorTerm):
    """rs sin(h u) + rc cos(h u), free: cogging of the motor, teeth of the gear, the wave generator of a strain gear.

    Args:
        harmonic: (m,) waves h in a radian times 2 pi, of each actuator; 1/rad.
    """

    harmonic: tuple[float, ...]

    name = "torque_ripple"
    physics = "Ripple of motor or gear: a torque that repeats many times in a turn of the joint."
    reference = "Ghorbel, Gandhi, Alpeter, On the kinematic error in harmonic drive gears, 2001"
    variable = "position"
    shown_by = "moving slowly over a large range, at several speeds"
    phrase = Phrase(
        "{who} needs torque ripple of {harmonic} waves a turn: {rs} in the sine and {rc} in the cosine.",
        "torque ripple",
        units={"harmonic": ReadableUnit("")},
    )
    shape_units = {"harmonic": "1/rad"}
    symbols = ("rs", "rc")
    units = (("N m", "N"), ("N m", "N"))

    @classmethod
    def shapes(cls, scene: Scene, joint: int) -> Iterator[Mapping[str, float]]:
        """Over the harmonics that the log can resolve."""
        u, speed = scene.actuators.q[:, joint], np.abs(scene.actuators.dq[:, joint])
        rate = 1.0 / float(np.median(np.diff(scene.motion.t)))
        highest = TUNING.ripple_fastest * np.pi * rate / max(float(np.percentile(speed, TUNING.usual_speed)), 1e-6)
        lowest, step = TUNING.ripple_lowest, TUNING.ripple_step * np.pi / max(float(np.ptp(u)), 1e-6)
        for harmonic in np.arange(lowest, highest, max(step, (highest - lowest) / TUNING.most_harmonics)):
            yield {"harmonic": float(harmonic)}

    def unit_efforts(self, actuators: Motion) -> Array:
        """Sine and cosine of the harmonic."""
        phase = np.array(self.harmonic) * actuators.q
        return np.stack([np.sin(phase), np.cos(phase)], axis=2)
