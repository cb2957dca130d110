"""KUKA: a program in KRL (KUKA Robot Language), and a table of axis corrections for RSI (Robot Sensor Interface).

KRL's names of axes, units (degrees, mm), `PTP_SPLINE` with `SPTP` segments and `TIME_BLOCK`: KUKA System Software 8.3,
Operating and Programming Instructions for System Integrators, KUKA Roboter GmbH 2015.
"""

from __future__ import annotations

import re

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.export.controllers.planned import PlannedMotion, cubic, decimals
from bayesid.export.tuning import TUNING

_AXIS = re.compile(r"(?:.*_)?([AE][1-6])", re.IGNORECASE)
"""A joint's name that says which axis it is: A1, e1, joint_a1."""
_ROBOT_AXES = 6
"""A1 to A6 of a robot in KRL; E1 to E6 are external axes."""
_CYCLES = 0.004, 0.012
"""s, interpolation cycles of RSI: IPO_FAST and IPO."""


def krl_program(planned: PlannedMotion) -> str:
    """motion.src: to the start pose, slowly, and the motion as one spline block of SPTP segments, timed by TIME_BLOCK.

    Raises:
        InputError: KRL has no names for the joints (`krl_axes`), or too few points for the motion.
    """
    axes = krl_axes(planned)
    points, deviation = planned.points(TUNING.krl_intervals, cubic)
    units = krl_units(planned)
    poses = [f"{{{_named(axes, row)}}}" for row in decimals(points.q * units)]
    head = planned.head(
        ";",
        "KRL program of the motion, axes in degrees (mm of prismatic ones)",
        f"between its points a cubic spline is {(deviation * units).max():.2g} degrees (mm) from the motion at most; "
        "the controller fills them in in its own way, and takes longer than TIME_BLOCK END says where an axis cannot "
        "follow",
        "set the load data of what the flange carries before; run it in T1 first",
    )
    part = 100.0 / (len(poses) - 1)
    lines = [
        "&ACCESS RVP",
        "DEF motion( )",
        *head,
        "BAS(#INITMOV,0)",
        f"BAS(#VEL_PTP,{TUNING.krl_approach})",
        f"BAS(#ACC_PTP,{TUNING.krl_approach})",
        f"PTP {poses[0]}",
        "WAIT SEC 1.0",
        "BAS(#VEL_PTP,100)",
        "BAS(#ACC_PTP,100)",
        "PTP_SPLINE",
        f"  SPTP {poses[0]}",
        "  TIME_BLOCK START",
        *(f"  SPTP {pose}\n  TIME_BLOCK PART = {part:.6f}" for pose in poses[1:]),
        f"  TIME_BLOCK END = {planned.duration:.4f}",
        "ENDSPLINE",
        "END",
    ]
    return "\n".join(lines) + "\n"


def rsi_table(planned: PlannedMotion) -> str:
    """rsi.csv: axis corrections from the start pose, a row a cycle of RSI, the one that is nearest to the rate's.

    Raises:
        InputError: KRL has no names for the joints (`krl_axes`).
    """
    axes = krl_axes(planned)
    cycle = min(_CYCLES, key=lambda one: abs(one - 1.0 / planned.rate))
    q = planned.sampled(cycle).q
    start = decimals(q[:1] * krl_units(planned))[0]
    head = planned.head(
        "#",
        f"table of axis corrections for RSI: a row each {1e3 * cycle:g} ms, degrees (mm of prismatic axes)",
        "corrections count from the start pose (absolute mode), not from the row before; move there first:",
        _named(axes, start),
    )
    rows = [",".join(row) for row in decimals((q - q[0]) * krl_units(planned))]
    return "\n".join([*head, ",".join(axes), *rows]) + "\n"


def krl_axes(planned: PlannedMotion) -> list[str]:
    """KRL's names of the joints: those that the joints' own names end with (A1, joint_e1), or A1 to A6 in order.

    Raises:
        InputError: there are more than six joints, and their names do not say which axes they are.
    """
    found = [match and match[1].upper() for match in map(_AXIS.fullmatch, planned.joint_names)]
    named = [axis for axis in found if axis]
    if len(set(named)) == planned.n_joints:
        return named
    if planned.n_joints > _ROBOT_AXES:
        said = f"{planned.n_joints} joints have no names in KRL, which has A1 to A6 and E1 to E6"
        raise InputError(said, planned.robot, "name the joints so in the robot's file, as joint_a1 and joint_e1")
    return [f"A{j}" for j in range(1, planned.n_joints + 1)]


def krl_units(planned: PlannedMotion) -> Array:
    """(n,) degrees a rad, or mm a m of prismatic joints."""
    return np.where(planned.prismatic, 1e3, np.degrees(1.0))


def _named(axes: list[str], row: list[str]) -> str:
    return ", ".join(f"{axis} {value}" for axis, value in zip(axes, row, strict=True))
