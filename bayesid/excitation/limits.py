"""What the joints may do, from a file: a TOML table of limits, or a URDF.

    lower = [-2.9, -1.9, -2.0]     # rad (m for a joint that slides); one number for all joints, or one each
    upper = [2.9, 1.9, 2.0]
    velocity = 2.5                 # rad/s
    acceleration = [8, 8, 12]      # rad/s^2
    jerk = 200                     # rad/s^3
    effort = [80, 80, 40]          # N m (N for a joint that slides), of the actuators

A key that is missing has the default of `MotionLimits`: of jerk and effort none. A URDF knows no accelerations and no
jerks: they have the defaults too.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.errors import InputError
from bayesid.files.bounded import LARGEST, read_source, toml_of, xml_of
from bayesid.robot import Robot
from bayesid.robot.urdf_tree import check_links
from bayesid.simulation.trajectories import INDUSTRIAL_ARM, MotionLimits

_KEYS = tuple(field.name for field in fields(MotionLimits))
_REMEDY = f"give {', '.join(_KEYS)}: a number, or a list with one number a joint"


def read_limits(path: str | Path, robot: Robot | None = None) -> MotionLimits:
    """Limits from a TOML file with the keys lower, upper, velocity, acceleration, jerk and effort, or from a URDF file.

    Args:
        path: ends in .urdf or .xml for a URDF.
        robot: whose joints are looked up in a URDF by their names; without it, or if they have none, the URDF must be
            one chain.

    Raises:
        InputError: the file cannot be read, or its limits cannot be used.

    Example:
        >>> limits = bayesid.read_limits("limits.toml")
        >>> limits.velocity
        2.0
    """
    path = Path(path)
    text = read_source(path, _REMEDY)
    if path.suffix in (".urdf", ".xml"):
        try:
            root = xml_of(text, str(path))
        except ET.ParseError as error:
            raise InputError(f"cannot be read ({error})", str(path), _REMEDY) from None
        check_links(root, str(path))
        return _urdf_limits(root, robot, str(path))
    table = toml_of(text, str(path), _REMEDY)
    unknown = sorted(set(table) - set(_KEYS))
    if unknown:
        raise InputError(f"unknown key {unknown[0]!r}", str(path), _REMEDY)
    return _made({key: _numbers(value, f"{path}, {key}") for key, value in table.items()}, str(path))


def check_limits(limits: MotionLimits | None, robot: Robot) -> MotionLimits:
    """The limits, or the usual ones where none are given, as one number for each of the robot's joints.

    Raises:
        InputError: there are limits for another number of joints, or none for a joint that slides.
    """
    n = robot.n_joints
    sliding = [j for j, joint in enumerate(robot.joints, start=1) if joint.prismatic]
    if limits is None and sliding:
        problem = f"joint {sliding[0]} slides, and there are no limits for it"
        raise InputError(problem, field="limits", remedy="give a file with the limits of the joints")
    limits = INDUSTRIAL_ARM if limits is None else limits
    each = {}
    for key in _KEYS:
        if getattr(limits, key) is None:
            continue
        values = np.atleast_1d(getattr(limits, key))
        if len(values) not in (1, n):
            problem = f"{len(values)} numbers for '{key}', robot {robot.name} has {n} joints"
            raise InputError(problem, field="limits", remedy="give one number, or one a joint")
        each[key] = tuple(np.broadcast_to(values, n).tolist())
    return MotionLimits(**each)


def check_between(value: float, least: float, most: float, field: str, unit: str) -> None:
    """Raises InputError about a field whose value is not between two others."""
    if not least <= value <= most:
        raise InputError(f"{value:g} {unit} cannot be used", field=field, remedy=f"give {least:g} to {most:g} {unit}")


def _made(table: dict[str, Any], where: str) -> MotionLimits:
    sizes = sorted({len(value) for value in table.values() if isinstance(value, tuple)})
    if len(sizes) > 1:
        raise InputError(f"lists of {sizes[0]} and of {sizes[-1]} numbers", where, "give one number a joint")
    try:
        return MotionLimits(**table)
    except ValueError as error:
        raise InputError(str(error), where, _REMEDY) from None


def _numbers(value: object, where: str) -> float | tuple[float, ...]:
    listed: list[Any] = value if isinstance(value, list) else [value]
    usable = listed and all(type(number) in (int, float) and abs(number) <= LARGEST for number in listed)
    if not usable:
        raise InputError(f"{value!r:.60} cannot be used", where, _REMEDY)
    numbers = tuple(float(number) for number in listed)
    return numbers if isinstance(value, list) else numbers[0]


# ---------------------------------------------------------------------------------------------------------------
# URDF
# ---------------------------------------------------------------------------------------------------------------
def _urdf_limits(root: ET.Element, robot: Robot | None, where: str) -> MotionLimits:
    names = [] if robot is None else [joint.name for joint in robot.joints]
    joints = _named(root, names, where) if any(names) else _chain(root, where)
    rows = [_joint_limits(joint, f"{where}, joint {joint.get('name')}") for joint in joints]
    if not rows:
        raise InputError("has no moving joint", where, "give a URDF of an arm")
    lower, upper, velocity, effort = (tuple(column) for column in zip(*rows, strict=True))
    limited = {} if not np.isfinite(effort).any() else {"effort": effort}
    return _made({"lower": lower, "upper": upper, "velocity": velocity, **limited}, where)


def _named(root: ET.Element, names: Sequence[str], where: str) -> list[ET.Element]:
    known = {joint.get("name"): joint for joint in root.findall("joint")}
    for name in names:
        if name not in known:
            raise InputError(f"has no joint {name!r}", where, "give the robot's own URDF, or a TOML file")
    return [known[name] for name in names]


def _chain(root: ET.Element, where: str) -> list[ET.Element]:
    """The moving joints from base to tip."""
    after: dict[str, list[tuple[ET.Element, str]]] = {}
    for joint in root.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is None or child is None:
            raise InputError("lacks a parent or a child", f"{where}, joint {joint.get('name')}", "correct the file")
        after.setdefault(parent.get("link", ""), []).append((joint, child.get("link", "")))
    children = [child for joints in after.values() for _, child in joints]
    for link in children:
        if children.count(link) > 1:
            raise InputError("is the child of two joints", f"{where}, link {link}", "give a URDF without loops")
    chain: list[ET.Element] = []
    for base in (link for link in after if link not in children):
        own: list[ET.Element] = []
        waiting = [(base, 0)]
        while waiting:
            link, depth = waiting.pop()
            for joint, beyond in after.get(link, []):
                moves = joint.get("type") != "fixed"
                if moves and depth < len(own):
                    raise InputError("is of a robot that branches", where, "give the limits in a TOML file")
                own += [joint] * moves
                waiting.append((beyond, depth + moves))
        chain += own
    return chain


def _joint_limits(joint: ET.Element, where: str) -> tuple[float, float, float, float]:
    """Lower, upper, velocity and effort; the usual ones where the file does not say, or a joint turns without end."""
    limit = joint.find("limit")
    try:
        lower, upper, velocity, effort = (
            float(limit.get(key, 0.0)) if limit is not None else 0.0 for key in ("lower", "upper", "velocity", "effort")
        )
    except ValueError as error:
        raise InputError(f"its limits are no numbers ({error})", where, "correct the file") from None
    endless = joint.get("type") == "continuous" or not 0.0 < upper - lower <= 4.0 * np.pi
    if endless and joint.get("type") == "prismatic":
        raise InputError("slides, and has no limits", where, "give the limits in a TOML file")
    usual = np.asarray([INDUSTRIAL_ARM.lower, INDUSTRIAL_ARM.upper, INDUSTRIAL_ARM.velocity])
    lower, upper = (float(usual[0]), float(usual[1])) if endless else (lower, upper)
    velocity = velocity if 0.0 < velocity < LARGEST else float(usual[2])
    return lower, upper, velocity, effort if 0.0 < effort < LARGEST else np.inf
