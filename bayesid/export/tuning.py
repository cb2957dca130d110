"""Numbers of this package that are choices."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Choices; `TUNING` holds those in use."""

    fewest_intervals: int = 25
    """Between points of a motion, with which the search for as few as tell it begins. A round number."""
    fine: float = 1e-5
    """rad (m); deviation at which no more points are added: 0.0006 degrees, far below what a robot follows."""
    coarse: float = 1e-2
    """rad (m); deviation above which points do not tell the motion: some 1 cm at a reach of 1 m. A round number."""
    looks: int = 8
    """Instants at which each interval is compared with the motion: its deviation is met to a few percent."""
    krl_intervals: int = 500
    """Of a spline block, at most: KRL plans it as a whole before it begins, some seconds for a hundred segments."""
    krl_approach: int = 10
    """% of the axes' speed on the way to the start pose: slow. A round number."""
    ros_lead: float = 10.0
    """s to the start pose from wherever the robot is: half a turn peaks at 0.6 rad/s then. A round number."""
    ros_bytes: int = 120_000
    """Of the file, about: Linux passes 128 KiB (MAX_ARG_STRLEN) as one argument, which "$(cat FILE)" is."""
    urscript_approach: str = "a=0.3, v=0.2"
    """rad/s^2 and rad/s of movej on the way to the start pose: slow. Round numbers."""


TUNING = Tuning()
