"""A motion that a robot is to run: known at every instant, at rest at both ends, and slower on demand."""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError, printable
from bayesid.motion import SLOWEST, Motion

MotionAt = Callable[[Array], Motion]
"""Gives a motion at instants t (N,), s, with exact derivatives."""
_ROUNDING = 1e-6
"""Share of a cycle by which a duration may exceed a whole number of cycles and still count as that number: rounding."""
_LINE = 100
"""Characters of a comment, at most: all editors and pendants show it whole."""
ALWAYS_UNCHECKED = ("the way to the start pose", "the controller's own limits")
"""What no plan can check: it knows neither where the robot stands nor how its controller is set up."""


@dataclass(frozen=True)
class PlannedMotion:
    """What a robot is to run.

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

    Raises:
        InputError: a duration or rate that is not positive, names for another number of joints or twice the same, or a
            motion that does not start and end at rest.
    """

    robot: str
    joint_names: tuple[str, ...]
    prismatic: tuple[bool, ...]
    at: MotionAt
    duration: float
    rate: float
    checked: tuple[str, ...] = ()
    not_checked: tuple[str, ...] = ()
    share: float = field(default=1.0)

    def __post_init__(self) -> None:
        for name, value, unit in (("duration", self.duration, "s"), ("rate", self.rate, "Hz")):
            if not 0.0 < value < np.inf:
                raise InputError(f"{value} {unit} is no {name} of a motion", name, "give a positive number")
        ends = self.at(np.array([0.0, self.duration]))
        names = set(self.joint_names)
        if not len(names) == len(self.joint_names) == len(self.prismatic) == ends.n_joints:
            said = f"{len(names)} names and {len(self.prismatic)} kinds of {ends.n_joints} joints"
            raise InputError(said, "joint_names", "give each joint a name of its own, and whether it is prismatic")
        if not np.all(np.abs(ends.dq) <= SLOWEST):
            said = "the motion does not start and end at rest"
            raise InputError(said, self.robot, "plan one whose velocities are zero at both ends")

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return len(self.joint_names)

    def slowed(self, share: float) -> PlannedMotion:
        """The same path at a share of the speed.

        With s the share, q(t) = q(s t), so velocities are s and accelerations s^2 times as large, and the duration is
        1 / s times as long.

        Raises:
            InputError: the share is not above 0 and at most 1.
        """
        if not 0.0 < share <= 1.0:
            raise InputError(f"{share} is no share of the speed", "share", "give one above 0, at most 1")
        full = self.at

        def at(t: Array) -> Motion:
            motion = full(share * t)
            return Motion(t, motion.q, share * motion.dq, share**2 * motion.ddq)

        return replace(self, at=at, duration=self.duration / share, share=share * self.share)

    def sampled(self, cycle: float | None = None) -> Motion:
        """The motion once a cycle, s, 1 / rate by default; the last row, at or after the end, is the end's pose."""
        step = 1.0 / self.rate if cycle is None else cycle
        t = step * np.arange(int(np.ceil(self.duration / step - _ROUNDING)) + 1, dtype=np.float64)
        motion = self.at(np.minimum(t, self.duration))
        return Motion(t, motion.q, motion.dq, motion.ddq)

    def head(self, mark: str, *said: str) -> list[str]:
        """Lines of comment: robot, duration, what was checked and what was not, and what else is said of a file."""
        lines = [
            f"robot: {self.robot}, joints: {', '.join(self.joint_names)}",
            f"duration: {self.duration:.9g} s, at {100.0 * self.share:.3g} % of the planned speed",
            f"checked: {'; '.join(self.checked) or 'nothing'}",
            f"NOT checked: {'; '.join(dict.fromkeys((*self.not_checked, *ALWAYS_UNCHECKED)))}",
            "positions count as in the log and the model that the motion was planned with: compare one pose first",
            *said,
        ]
        return [f"{mark} {part}" for line in lines for part in textwrap.wrap(ascii_text(line), _LINE)]


def ascii_text(text: str) -> str:
    """A text on one line, in ASCII, as all controllers read."""
    return printable(text).encode("ascii", "backslashreplace").decode("ascii")
