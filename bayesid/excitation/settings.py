"""Settings of a motion to be designed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.excitation.limits import check_between
from bayesid.excitation.resolvability import check_noise
from bayesid.robot.collision import CollisionModel, NoShapes
from bayesid.simulation.trajectories import HARMONICS, MotionLimits


@dataclass(frozen=True, kw_only=True)
class MotionSettings:
    """Duration, limits and search time of a designed motion.

    Attributes:
        duration: of the whole motion, s.
        rate: of its samples, Hz.
        limits: of the joints: a mapping or a TOML file with lower, upper, velocity, acceleration, jerk and effort, one
            number or one per joint, rad (m), or a URDF file. The defaults suit most small arms. After a result, they
            include the positions of its log.
        changes: of the motion that are tried. Default: 6000 in each of two searches, about 10 s for six joints; after
            a result, about 30 s.
        harmonics: highest harmonic of a joint's motion, 2 to 20. Robot without a result only.
        periods: number of periods in the duration. Robot without a result only.
        noise: of the efforts, relative to each joint's RMS effort, for which the design is assessed. Robot without a
            result only.
        start: (n,) pose at both ends, rad (m); by default the log's first. After a result only.
        effort_limits: (n,) largest |effort| of the actuators, N m, in place of those of `limits`. After a result only.
        clearance: collision model (`Robot.collision_model`) with its least distance. With None, collisions are not
            checked, and the design states it. After a result only.
        payload: label of the payload on the flange, one of the result's; empty for none.

    Raises:
        InputError: a number cannot be used.

    Example:
        >>> settings = bayesid.MotionSettings(duration=5.0, harmonics=2, limits="limits.toml", changes=50)
        >>> bayesid.design_excitation(robot, terms, settings=settings).motion.q.shape
        (501, 3)
    """

    duration: float = 20.0
    rate: float = 100.0
    limits: MotionLimits | Mapping[str, Any] | str | Path | None = None
    changes: int | None = None
    harmonics: int = HARMONICS
    periods: int = 1
    noise: float = 0.05
    start: tuple[float, ...] | None = None
    effort_limits: tuple[float, ...] | None = None
    clearance: CollisionModel | NoShapes | None = None
    payload: str = ""

    def __post_init__(self) -> None:
        fewest = 4.0 * self.harmonics * self.periods  # twice the Nyquist rate
        check_between(self.duration, 0.5, 3600.0, "MotionSettings.duration", "s")
        check_between(self.harmonics, 2, 20, "MotionSettings.harmonics", "harmonics")
        check_between(self.periods, 1, 1000, "MotionSettings.periods", "periods")
        check_between(self.rate * self.duration, fewest, 1e6, "MotionSettings.rate", "samples")
        check_noise(self.noise)
        if self.changes is not None and self.changes < 1:
            raise InputError(f"is {self.changes}", field="MotionSettings.changes", remedy="give 1 or more, as 1000")
        if isinstance(self.clearance, CollisionModel) and not self.clearance.margin >= 0.0:
            problem = f"{self.clearance.margin:g} m would let the robot touch itself"
            raise InputError(problem, field="margin", remedy="give a distance of 0 m or more")


def sample_times(settings: MotionSettings) -> Array:
    """(N,) sample times, s."""
    return np.linspace(0.0, settings.duration, round(settings.duration * settings.rate) + 1)
