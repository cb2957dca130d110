"""Few points of a motion, for controllers that fill in between them by themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.export.controllers.planned import PlannedMotion
from bayesid.motion import Motion

Between = Callable[[Motion, Array], Array]
"""Gives the positions (N, n) at instants (N,) that a controller makes between points."""
FEWEST = 25
"""Intervals between points with which the search begins. A round number."""
_FINE = 1e-5
"""rad (m); deviation at which no more points are added: some 0.0006 degrees, below what a robot follows by far."""
_COARSE = 1e-2
"""rad (m); deviation above which points do not tell the motion any more: 0.6 degrees, some 1 cm at the end of a reach
of 1 m. A round number."""
_LOOKS = 8
"""Instants at which each interval is compared with the motion: its largest deviation is met to a few percent."""


@dataclass(frozen=True)
class ViaPoints:
    """Points of a motion, equally far apart in time.

    Attributes:
        motion: at the points; the first and the last are its ends.
        deviation: what `between` makes of them is so far from the motion at most, rad (m).
    """

    motion: Motion
    deviation: float


def via_points(planned: PlannedMotion, most: int, between: Between) -> ViaPoints:
    """As few points as tell the motion, as many at any speed.

    Args:
        planned: the motion.
        most: intervals, at most.
        between: how a controller is thought to fill them in.

    Raises:
        InputError: even so many points do not tell it.
    """
    intervals = min(FEWEST, most)
    while True:
        t = np.linspace(0.0, planned.duration, intervals + 1)
        looks = np.linspace(0.0, planned.duration, _LOOKS * intervals + 1)
        motion = planned.at(t)
        deviation = float(np.abs(between(motion, looks) - planned.at(looks).q).max())
        if deviation <= _FINE or intervals == most:
            break
        intervals = min(2 * intervals, most)
    if not deviation <= _COARSE:
        said = f"{intervals} points do not tell the motion: between them it is {deviation:.2g} rad (m) away"
        raise InputError(said, planned.robot, "plan a shorter or a slower one")
    return ViaPoints(Motion(t, motion.q, motion.dq, motion.ddq), deviation)


def cubic(points: Motion, t: Array) -> Array:
    """Positions of the cubic spline through points, at rest at both ends.

    It stands in for a controller's own spline, which is not published.
    """
    values: Array = scipy.interpolate.CubicSpline(points.t, points.q, bc_type="clamped")(t)
    return values


def quintic(points: Motion, t: Array) -> Array:
    """Positions of the quintics that meet positions, velocities and accelerations at both ends of each interval."""
    table = np.stack([points.q, points.dq, points.ddq], axis=1)
    values: Array = scipy.interpolate.BPoly.from_derivatives(points.t, table)(t)
    return values
