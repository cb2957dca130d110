"""Exciting motions: trajectories that show every coefficient of a model, and the signs of its efforts.

This page of names is the lower floor, which simulation stands on: trajectories, limits, and the design by condition
number alone. On top of simulation stand, and are imported from their own modules, `bayesid.excitation.design` (a motion
that makes signs resolvable), `bayesid.excitation.judgement` (what a log's motion leaves undecided) and what they need.
"""

from bayesid.excitation.condition import EVALUATIONS, condition_number, exciting_trajectory
from bayesid.excitation.trajectory import (
    HARMONICS,
    INDUSTRIAL_ARM,
    FourierTrajectory,
    MotionLimits,
    random_trajectory,
)

__all__ = [
    "EVALUATIONS", "HARMONICS", "INDUSTRIAL_ARM", "FourierTrajectory", "MotionLimits", "condition_number",
    "exciting_trajectory", "random_trajectory",
]  # fmt: skip
