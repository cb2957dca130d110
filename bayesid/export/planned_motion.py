"""A planned motion, and the tables of its instants that the modules of controllers write in their languages."""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy

from bayesid.arrays import Array
from bayesid.errors import InputError, printable
from bayesid.export.tuning import TUNING
from bayesid.motion import Motion

MotionAt = Callable[[Array], Motion]
"""Gives a motion at instants t (N,), s, with exact derivatives."""
Between = Callable[[Motion, Array], Array]
"""Gives the positions (N, n) at instants (N,) that a controller makes between points."""
_LINE = 100
"""Characters of a comment, at most: all editors and pendants show it whole."""
ALWAYS_UNCHECKED = ("the way to the start pose", "the controller's own limits")
"""What no plan can check: it knows neither where the robot stands nor how its controller is set up."""


@dataclass(frozen=True)
class PlannedMotion:
    """What a robot is to run: a motion from rest to rest, known at every instant, and slower on demand.

    Attributes:
        robot: its name.
        joint_names: n of them, in the order of the motion's columns.
        prismatic: n of them, whether the joint slides: its positions are m, else rad.
        at: the motion at instants t (N,) from 0 to `duration`, s.
        duration: s.
        rate: of the controller, Hz.
        checked: what was checked, a few words each, as "collisions of links"; for the heads of files.
        not_checked: what was not; `ALWAYS_UNCHECKED` is added in the files.
        share: of the planned speed at which `at` goes; 1 unless `slowed`.
    """

    robot: str
    joint_names: tuple[str, ...]
    prismatic: tuple[bool, ...]
    at: MotionAt
    duration: float
    rate: float
    checked: tuple[str, ...] = ()
    not_checked: tuple[str, ...] = ()
    share: float = 1.0

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return len(self.joint_names)

    def slowed(self, share: float) -> PlannedMotion:
        """The same path at a share of the speed, above 0 and at most 1: q(t) = q(share t)."""
        full = self.at

        def at(t: Array) -> Motion:
            motion = full(share * t)
            return Motion(t, motion.q, share * motion.dq, share**2 * motion.ddq)

        return replace(self, at=at, duration=self.duration / share, share=share * self.share)

    def sampled(self, cycle: float | None = None) -> Motion:
        """The motion once a cycle, s, 1 / rate by default; the last row, at or after the end, is the end's pose."""
        step = 1.0 / self.rate if cycle is None else cycle
        cycles = int(np.ceil(self.duration / step - 1e-6))  # a duration of whole cycles, but for rounding
        t = step * np.arange(cycles + 1, dtype=np.float64)
        motion = self.at(np.minimum(t, self.duration))
        return Motion(t, motion.q, motion.dq, motion.ddq)

    def points(self, most: int, between: Between) -> tuple[Motion, float]:
        """As few instants, equally far apart, as tell the motion, as many at any speed; for controllers that fill in.

        Args:
            most: intervals, at most.
            between: how a controller is thought to fill them in.

        Returns:
            The motion at the points, and how far what `between` makes of them is from it at most, rad (m).

        Raises:
            InputError: even so many points do not tell it.
        """
        intervals = min(TUNING.fewest_intervals, most)
        while True:
            t = np.linspace(0.0, self.duration, intervals + 1)
            looks = np.linspace(0.0, self.duration, TUNING.looks * intervals + 1)
            motion = self.at(t)
            deviation = float(np.abs(between(motion, looks) - self.at(looks).q).max())
            if deviation <= TUNING.fine or intervals == most:
                break
            intervals = min(2 * intervals, most)
        if not deviation <= TUNING.coarse:
            said = f"{intervals} points do not tell the motion: between them it is {deviation:.2g} rad (m) away"
            raise InputError(said, self.robot, "plan a shorter or a slower one")
        return Motion(t, motion.q, motion.dq, motion.ddq), deviation

    def head(self, mark: str, *said: str) -> list[str]:
        """Lines of comment: robot, duration, what was checked and what was not, and what else is said of a file."""
        lines = [
            f"robot: {self.robot}, joints: {', '.join(self.joint_names)}",
            f"duration: {self.duration:.9g} s, at {100.0 * self.share:.3g} % of the planned speed",
            f"checked: {'; '.join(self.checked) or 'nothing'}",
            f"NOT checked: {'; '.join(dict.fromkeys((*self.not_checked, *ALWAYS_UNCHECKED)))}",
            "positions count as in the log and the model that the motion was planned with: compare one pose first",
            "made by bayesid; not run on a controller",
            *said,
        ]
        return [f"{mark} {part}" for line in lines for part in textwrap.wrap(ascii_text(line), _LINE)]


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


def decimals(values: Array) -> list[list[str]]:
    """Rows of numbers (N, n) with six decimals, none of them -0."""
    return [[f"{value:.6f}" for value in row] for row in (np.round(values, 6) + 0.0).tolist()]


def ascii_text(text: str) -> str:
    """A text on one line, in ASCII, as all controllers read."""
    return printable(text).encode("ascii", "backslashreplace").decode("ascii")
