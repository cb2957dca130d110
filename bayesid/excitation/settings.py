"""What is chosen of a motion to be designed."""

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
    """Length, limits and effort of the design of a motion.

    Attributes:
        duration: of the whole motion, s.
        rate: of its samples, Hz; before a result also of the controller's file.
        limits: of the joints: a mapping or a TOML file with lower, upper, velocity, acceleration, jerk and effort, one
            number or one a joint, rad (m), or a URDF file. By default those that suit most small arms, after a result
            widened to where the robot has been.
        changes: changes of the motion that are tried; by default 6000 in each of two searches, which takes about
            ten seconds for six joints, and after a result as many as take some half a minute.
        harmonics: how many times a joint may swing to and fro in a period, about, 2 to 20. For a robot alone.
        periods: how many times the motion is played in the duration. For a robot alone.
        noise: of the efforts, relative to each joint's RMS effort, at which the design is judged. For a robot alone.
        start: (n,) pose at both ends, rad (m): where the robot is; by default where the log began. After a result.
        effort_limits: (n,) largest |effort| of the actuators, N m, in place of those of `limits`. After a result.
        clearance: what tells collisions (`Robot.collision_model`), with the distance to be kept; None where nothing
            does, which the design says. After a result.
        payload: label of what the flange carries, one that the result knows; empty where it carries nothing.

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
        fewest = 4.0 * self.harmonics * self.periods  # twice as many as Nyquist asks for
        check_between(self.duration, 0.5, 3600.0, "MotionSettings.duration", "s")
        check_between(self.harmonics, 2, 20, "MotionSettings.harmonics", "harmonics")
        check_between(self.periods, 1, 1000, "MotionSettings.periods", "periods")
        check_between(self.rate * self.duration, fewest, 1e6, "MotionSettings.rate", "samples")
        check_noise(self.noise)
        if self.changes is not None and self.changes < 1:
            said, remedy = f"{self.changes} changes cannot be tried", "give 1 or more, as 1000"
            raise InputError(said, field="MotionSettings.changes", remedy=remedy)
        if isinstance(self.clearance, CollisionModel) and not self.clearance.margin >= 0.0:
            said = f"{self.clearance.margin:g} m would let the robot touch itself"
            raise InputError(said, field="margin", remedy="give a distance of 0 m or more")


def instants_of(settings: MotionSettings) -> Array:
    """(N,) of the samples, s."""
    return np.linspace(0.0, settings.duration, round(settings.duration * settings.rate) + 1)
