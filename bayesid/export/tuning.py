"""Numbers of this package that are choices."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Choices; `TUNING` holds those in use."""

    fewest_intervals: int = 25
    """Fewest intervals of an exported motion; doubled until `fine` is met, so that it sets only the file's length."""
    fine: float = 1e-5
    """rad (m), deviation at which no more points are added: 0.0006 degrees."""
    coarse: float = 1e-2
    """rad (m), largest deviation accepted: 1 cm at the tip of an arm of 1 m. A larger one is an error."""
    looks: int = 8
    """Instants at which each interval is compared with the motion."""
    krl_intervals: int = 500
    """Most segments of a spline block. KRL plans the whole block before it starts, so more segments delay the start."""
    krl_approach: int = 10
    """% of the axes' highest speed and acceleration, for the move to the start pose. A low value, chosen for safety."""
    ros_lead: float = 10.0
    """s, duration of the move to the start pose. Half a turn, as a quintic from rest to rest, peaks at 0.6 rad/s."""
    ros_bytes: int = 120_000
    """Most bytes of the file. `"$(cat FILE)"` is one argument, and Linux limits that to 128 KiB (MAX_ARG_STRLEN)."""
    urscript_approach: str = "a=0.3, v=0.2"
    """rad/s^2 and rad/s, acceleration and speed of movej to the start pose. Low values, chosen for safety."""


TUNING = Tuning()
