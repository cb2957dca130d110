"""Joint limits from a file: a TOML table of limits, or a URDF.

    lower = [-2.9, -1.9, -2.0]     # rad (m for a prismatic joint); one number for all joints, or one per joint
    upper = [2.9, 1.9, 2.0]
    velocity = 2.5                 # rad/s
    acceleration = [8, 8, 12]      # rad/s^2
    jerk = 200                     # rad/s^3
    effort = [80, 80, 40]          # N m (N for a prismatic joint), of the actuators

Missing keys have the defaults of `MotionLimits`: jerk and effort are unlimited. A URDF holds no limits of acceleration
or jerk; they have the defaults too.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.errors import InputError
from bayesid.files.bounded import LARGEST, read_source, toml_of
from bayesid.robot import Robot
from bayesid.robot.urdf_tree import UrdfJoint, read_tree
from bayesid.simulation.trajectories import INDUSTRIAL_ARM, MotionLimits

_KEYS = tuple(field.name for field in fields(MotionLimits))
_REMEDY = f"give {', '.join(_KEYS)}: a number, or a list with one number per joint"


def read_limits(path: str | Path, robot: Robot | None = None, urdf: Path | None = None) -> MotionLimits:
    """Limits from a TOML file with the keys lower, upper, velocity, acceleration, jerk and effort, or from a URDF file.

    Args:
        path: ends in .urdf or .xml for a URDF.
        robot: its joints are found in a URDF by their names. Without a robot, or without names, the URDF must be one
            chain.
        urdf: gives the limits that a TOML file lacks.

    Raises:
        InputError: the file cannot be read, or its limits cannot be used.
    """
    path, stated = Path(path), dict[str, Any]()
    if path.suffix in (".urdf", ".xml"):
        urdf = path
    else:
        stated = _checked(toml_of(read_source(path, _REMEDY), str(path), _REMEDY), str(path))
    of_urdf = {} if urdf is None else _urdf_limits(read_source(urdf, _REMEDY), robot, str(urdf), stated.keys())
    return _made(of_urdf | stated, str(path))


def _checked(table: Mapping[str, Any], where: str) -> dict[str, Any]:
    unknown = sorted(set(table) - set(_KEYS))
    if unknown:
        raise InputError(f"unknown key {unknown[0]!r}", where, _REMEDY)
    return {key: _numbers(value, f"{where}, {key}") for key, value in table.items()}


def check_limits(limits: MotionLimits | Mapping[str, Any] | str | Path | None, robot: Robot) -> MotionLimits:
    """The limits, by default `INDUSTRIAL_ARM`, with one number per joint of the robot.

    Raises:
        InputError: the limits are for another number of joints, or a prismatic joint has none.
    """
    n = robot.n_joints
    sliding = [j for j, joint in enumerate(robot.joints, start=1) if joint.prismatic]
    if limits is None and sliding:
        problem = f"prismatic joint {sliding[0]} has no limits"
        raise InputError(problem, field="limits", remedy="give a file with the limits of the joints")
    if isinstance(limits, str | Path):
        limits = read_limits(limits, robot)
    elif isinstance(limits, Mapping):
        limits = _made(_checked(limits, "limits"), "limits")
    limits = INDUSTRIAL_ARM if limits is None else limits
    each = {}
    for key in _KEYS:
        if getattr(limits, key) is None:
            continue
        values = np.atleast_1d(getattr(limits, key))
        if len(values) not in (1, n):
            problem = f"{len(values)} numbers for '{key}', robot {robot.name} has {n} joints"
            raise InputError(problem, field="limits", remedy="give one number, or one per joint")
        each[key] = tuple(np.broadcast_to(values, n).tolist())
    return MotionLimits(**each)


def check_between(value: float, least: float, most: float, field: str, unit: str) -> None:
    """Raises InputError if a field's value is out of range."""
    if not least <= value <= most:
        raise InputError(f"{value:g} {unit} cannot be used", field=field, remedy=f"give {least:g} to {most:g} {unit}")


def _made(table: dict[str, Any], where: str) -> MotionLimits:
    sizes = sorted({len(value) for value in table.values() if isinstance(value, tuple)})
    if len(sizes) > 1:
        raise InputError(f"lists of {sizes[0]} and of {sizes[-1]} numbers", where, "give one number per joint")
    try:
        return MotionLimits(**table)
    except ValueError as error:
        raise InputError(str(error), where, _REMEDY) from None


def _numbers(value: object, where: str) -> float | tuple[float, ...]:
    listed: list[Any] = list(value) if isinstance(value, list | tuple) else [value]
    usable = listed and all(type(number) in (int, float) and abs(number) <= LARGEST for number in listed)
    if not usable:
        raise InputError(f"{value!r:.60} cannot be used", where, _REMEDY)
    numbers = tuple(float(number) for number in listed)
    return numbers if isinstance(value, list | tuple) else numbers[0]


# ---- URDF ----
def _urdf_limits(text: str, robot: Robot | None, where: str, stated: Collection[str]) -> dict[str, Any]:
    tree = read_tree(text, where)
    names = [] if robot is None else [joint.name for joint in robot.joints if joint.name]
    missing = [name for name in names if name not in tree.named]
    if missing:
        raise InputError(f"has no joint {missing[0]!r}", where, "give the robot's own URDF, or a TOML file")
    joints = [tree.named[name] for name in names] or [joint for joint in tree.joints if joint.moves]
    if not joints:
        raise InputError("has no moving joint", where, "give a URDF of an arm")
    if not names and any(joint not in tree.path(joints[-1].child) for joint in joints):
        raise InputError("has branches", where, "give the limits in a TOML file")
    needed = not {"lower", "upper"} <= set(stated)
    lower, upper, velocity, effort = zip(*(_joint_limits(joint, where, needed=needed) for joint in joints), strict=True)
    limited = {} if not np.isfinite(effort).any() else {"effort": effort}
    return {"lower": lower, "upper": upper, "velocity": velocity, **limited}


def _joint_limits(joint: UrdfJoint, where: str, *, needed: bool) -> tuple[float, float, float, float]:
    """Lower, upper, velocity and effort; defaults if the file lacks them or the joint is continuous."""
    lower, upper, velocity = joint.range
    default = np.asarray([INDUSTRIAL_ARM.lower, INDUSTRIAL_ARM.upper, INDUSTRIAL_ARM.velocity]).tolist()
    if joint.kind == "continuous" or not 0.0 < upper - lower <= 4.0 * np.pi:
        if joint.kind == "prismatic" and needed:
            raise InputError("is prismatic without limits", f"{where}, joint {joint.name}", "give them in a TOML file")
        lower, upper = default[:2]
    velocity = velocity if 0.0 < velocity < LARGEST else default[2]
    return lower, upper, velocity, np.inf if joint.rated_effort is None else joint.rated_effort
