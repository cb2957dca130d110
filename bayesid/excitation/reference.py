"""Motions that stand for any motion of a robot."""

from __future__ import annotations

import numpy as np

from bayesid.motion import Motion
from bayesid.robot import Robot
from bayesid.simulation.trajectories import INDUSTRIAL_ARM, MotionLimits, random_trajectory

_DURATION, _RATE = 20.0, 20.0
"""s and Hz; round numbers."""


def usual_motion(robot: Robot, limits: MotionLimits = INDUSTRIAL_ARM, duration: float = _DURATION) -> Motion:
    """A random motion that uses the limits, over a duration, s."""
    t = np.linspace(0.0, duration, round(duration * _RATE) + 1)
    return random_trajectory(robot.n_joints, duration, limits=limits).motion(t)
