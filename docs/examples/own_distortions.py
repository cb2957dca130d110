"""Effects of your own that are no terms: one of the sensor, one of the motion."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Self

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects import Numbers, Phrase, ReadableUnit, RobotDistortion, Scene, SensorDistortion, number
from bayesid.motion import Motion
from bayesid.robot import Robot


class Crossover(SensorDistortion):
    """Efforts e are read as e |e| / (|e| + w): crossover distortion of push-pull amplifiers, its curve made smooth.

    Args:
        width: (m,) w of each actuator, N m.
    """

    width: Numbers = number("N m")

    name = "crossover"
    shown_by = "slow changes of the load through zero, at loads of several sizes"
    phrase = Phrase("{whose} efforts read too small, those of {width} by half.", "crossover")

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """Over the width."""
        for j, top in enumerate(scene.measured.max(axis=0).tolist(), start=1):
            yield from (cls(joints=(j,), width=(share * top,)) for share in (0.02, 0.05, 0.1, 0.2))

    def reading(self, effort: Array) -> Array:
        """Smaller, small efforts much smaller."""
        size = np.abs(effort)
        return effort * size / (size + np.array(self.width))

    def restoring(self, reading: Array) -> tuple[Array, Mask]:
        """The root of a quadratic equation; what noise hides is left out."""
        width = np.array(self.width)
        return 0.5 * (reading + np.sqrt(reading**2 + 4.0 * reading * width)), reading > 0.3 * width


class LatePositions(RobotDistortion):
    """A joint's positions are those of some time ago: q is q + lag q' to first order.

    Args:
        lag: (m,) of each joint, s.
    """

    lag: Numbers = number("s", tuned=True)

    name = "late_positions"
    shown_by = "fast changes of speed"
    phrase = Phrase("{whose} positions are read {lag} late.", "late positions", units={"lag": ReadableUnit("ms", 1e3)})
    typical = (0.01,)
    largest = 1.0  # s, of simulated ones

    def moving(self, robot: Robot, motion: Motion) -> Motion:
        """Further by the lag."""
        q = motion.q.copy()
        acting = self.acting(robot.n_joints)
        q[:, acting] += np.array(self.lag) * motion.dq[:, acting]
        return replace(motion, q=q)
