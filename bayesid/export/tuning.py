"""Constants of this package."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Constants; `TUNING` holds those in use. They are chosen, not measured."""

    fewest_intervals: int = 25
    """Fewest intervals of an exported motion; doubled until `fine` is met, so it only sets the file's length."""
    fine: float = 1e-5
    """rad (m), deviation below which no more points are added: 0.0006 degrees."""
    coarse: float = 1e-2
    """rad (m), largest accepted deviation: 1 cm at the tip of an arm of 1 m."""
    samples_per_interval: int = 8
    """Samples per interval at which the interpolation is compared with the motion."""
    krl_intervals: int = 500
    """Most segments of a spline block. KRL plans the whole block before it starts, so more segments delay the start."""
    krl_approach: int = 10
    """% of the axes' highest speed and acceleration, for the move to the start pose; low for safety."""
    ros_lead: float = 10.0
    """s, duration of the move to the start pose. Half a turn, as a quintic from rest to rest, peaks at 0.6 rad/s."""
    ros_bytes: int = 120_000
    """Most bytes of the file. `"$(cat FILE)"` is one argument, which Linux limits to 128 KiB (MAX_ARG_STRLEN)."""
    urscript_approach: str = "a=0.3, v=0.2"
    """rad/s^2 and rad/s, acceleration and speed of movej to the start pose; low for safety."""


TUNING = Tuning()
