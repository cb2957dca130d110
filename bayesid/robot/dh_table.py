"""Robots from tables: Denavit-Hartenberg files, and joint placements in model.toml."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError, printable
from bayesid.files.bounded import LARGEST
from bayesid.robot.arm import Joint, Robot, check_count, given_numbers
from bayesid.robot.tuning import TUNING


def robot_from_table(table: Mapping[str, Any], where: str) -> Robot:
    """A robot from the keys of a DH file, as `load_robot` lists them. An error names `where`.

    Raises:
        InputError: a key is missing or its value is not valid.
    """
    convention = table.get("convention")
    if convention == "chain":
        return _robot_from_chain(table, where)
    if convention not in ("standard", "modified"):
        what = "key 'convention' is missing" if convention is None else f"unknown convention {convention!r}"
        raise InputError(what, where, 'give convention = "standard" or "modified"')
    rows = table.get("joints")
    if not isinstance(rows, list) or not rows:
        raise InputError(
            "key 'joints' is missing", where, "give one [[joints]] table per joint with a, alpha, d, theta"
        )
    check_count(len(rows), where)
    _check_filled_in(rows, where)
    dh = [_dh_row(row, f"{where}, joint {i}") for i, row in enumerate(rows, start=1)]
    lengths = {f"{symbol}{i}": row[symbol] for i, row in enumerate(dh, start=1) for symbol in ("a", "d")}
    lengths = {symbol: value for symbol, value in lengths.items() if value != 0.0}
    return _robot(table, where, joints=_joints(dh, convention), lengths=lengths)


def _check_filled_in(rows: Sequence[object], where: str) -> None:
    """InputError that names all unfilled numbers of a template."""
    blank: dict[str, list[int]] = {}
    for i, row in enumerate(rows, start=1):
        numbers = row.items() if isinstance(row, Mapping) else ()
        keys = ", ".join(str(key) for key, value in numbers if isinstance(value, float) and np.isnan(value))
        if keys:
            blank.setdefault(keys, []).append(i)
    if blank:
        parts = (f"{keys} of joint{'s' * (len(of) > 1)} {', '.join(map(str, of))}" for keys, of in blank.items())
        remedy = "give finite numbers in place of nan: a and d in m, alpha and theta in rad"
        raise InputError(f"not filled in yet: {'; '.join(parts)}", where, remedy)


def _robot(table: Mapping[str, Any], where: str, joints: tuple[Joint, ...], **more: Any) -> Robot:
    gravity = given_numbers(table.get("gravity", [0.0, 0.0, -9.81]), (3,), "gravity", where)
    transmission = _transmission(table.get("transmission"), len(joints), where)
    return Robot(str(table.get("name", "robot")), joints, gravity, transmission, **more)


def robot_table(robot: Robot) -> dict[str, Any]:
    """A robot as plain tables that `robot_from_table` reads back exactly: joint placements, no DH angles."""
    table: dict[str, Any] = {
        "name": robot.name,
        "convention": "chain",
        "gravity": robot.gravity.tolist(),
        "lengths": dict(robot.lengths),
        "joints": [
            {
                "placement": joint.placement.tolist(),
                "axis": joint.axis.tolist(),
                "type": "prismatic" if joint.prismatic else "revolute",
                "parent": int(joint.parent),
                "link_frame": joint.link_frame.tolist(),
                **({"name": joint.name} if joint.name else {}),
                **({} if joint.rated_effort is None else {"rated_effort": joint.rated_effort}),
                **({} if joint.tip is None else {"tip": joint.tip.tolist()}),
            }
            for joint in robot.joints
        ],
    }
    if robot.notes:
        table["notes"] = list(robot.notes)
    if robot.transmission is not None:
        table["transmission"] = robot.transmission.tolist()
    return table


def _robot_from_chain(table: Mapping[str, Any], where: str) -> Robot:
    """A robot from `robot_table`; any damage gives one message."""
    try:
        rows, lengths = table["joints"], table.get("lengths", {}).items()
        check_count(len(rows), where)
        joints = tuple(_chain_joint(row, f"{where}, joint {k}") for k, row in enumerate(rows, start=1))
        if not all(-1 <= joint.parent < k for k, joint in enumerate(joints)):
            raise ValueError("a joint precedes its parent")
        numbers = {key: float(given_numbers(value, (), key, where)) for key, value in lengths}
        return _robot(table, where, joints, lengths=numbers, notes=tuple(map(str, table.get("notes", []))))
    except InputError:
        raise
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        what = f"is not a robot written by bayesid ({printable(str(error))})"
        raise InputError(what, where, "restore the table as bayesid wrote it") from None


def _chain_joint(row: Mapping[str, Any], where: str) -> Joint:
    placement, link_frame = (given_numbers(row[key], (4, 4), key, where) for key in ("placement", "link_frame"))
    axis, slides = given_numbers(row["axis"], (3,), "axis", where), row["type"] == "prismatic"
    name, rated = str(row.get("name", "")), _rated_effort(row, where)
    tip = given_numbers(row["tip"], (4, 4), "tip", where) if "tip" in row else None
    return Joint(placement, axis, slides, int(row["parent"]), link_frame, name, rated, tip)


def _rated_effort(row: Mapping[str, Any], where: str) -> float | None:
    if "rated_effort" not in row:
        return None
    effort = float(given_numbers(row["rated_effort"], (), "rated_effort", where))
    if effort <= 0.0:
        raise InputError("key 'rated_effort' is not positive", where, "give the joint's rated effort, in N m or N")
    return effort


def _dh_row(row: object, where: str) -> dict[str, Any]:
    if not isinstance(row, Mapping):
        raise InputError("is not a table", where, "write it as [[joints]] with a, alpha, d, theta")
    kind = row.get("type", "revolute")
    if kind not in ("revolute", "prismatic"):
        raise InputError(f"unknown joint type {kind!r}", where, 'give "revolute" or "prismatic"')
    values: dict[str, Any] = {"prismatic": kind == "prismatic"}
    for key in ("a", "alpha", "d", "theta"):
        if key not in row:
            raise InputError(f"key '{key}' is missing", where, "give a and d in m, alpha and theta in rad")
        values[key] = float(given_numbers(row[key], (), key, where, TUNING.longest if key in ("a", "d") else LARGEST))
    return {**values, "rated_effort": _rated_effort(row, where)}


def _transmission(value: object, n: int, where: str) -> Array | None:
    if value is None:
        return None
    matrix = given_numbers(value, (n, n), "transmission", where)
    if np.any(np.abs(np.diag(matrix)) < 1.0 / LARGEST) or np.linalg.matrix_rank(matrix) < n:
        remedy = "motor speeds = transmission @ joint speeds needs an invertible matrix with a non-zero diagonal"
        raise InputError("key 'transmission' cannot be used", where, remedy)
    return matrix


def _screw(along: str, angle: float, length: float) -> Array:
    """(4, 4) rotation about x or z, and translation along it."""
    matrix, (i, j, axis) = np.eye(4), (1, 2, 0) if along == "x" else (0, 1, 2)
    matrix[i, i] = matrix[j, j] = np.cos(angle)
    matrix[j, i] = np.sin(angle)
    matrix[i, j], matrix[axis, 3] = -matrix[j, i], length
    return matrix


def _joints(dh: list[dict[str, Any]], convention: str) -> tuple[Joint, ...]:
    """Standard: joint i acts at the end of link i - 1, and link i's frame sits at its own far end.

    Modified (Craig): link i's frame is joint i's own.
    """
    joints, before = [], np.eye(4)
    for i, row in enumerate(dh):
        across, along = _screw("x", row["alpha"], row["a"]), _screw("z", row["theta"], row["d"])
        standard = convention == "standard"
        placement, link_frame = (before, along @ across) if standard else (across @ along, np.eye(4))
        axis, slides = np.array([0.0, 0.0, 1.0]), row["prismatic"]
        joints.append(Joint(placement, axis, slides, i - 1, link_frame, rated_effort=row["rated_effort"]))
        before = link_frame
    return tuple(joints)
