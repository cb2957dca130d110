"""Robots as tables: Denavit-Hartenberg files, and the placements of joints that model.toml keeps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.files.bounded import LARGEST
from bayesid.robot.arm import Joint, Robot
from bayesid.robot.numbers import check_count, given_numbers
from bayesid.robot.tuning import TUNING

_AS_WRITTEN = "use the table as bayesid wrote it"
"""Remedy for a damaged model.toml."""


def robot_from_table(table: Mapping[str, Any], where: str) -> Robot:
    """A robot from the keys of a DH file.

    Args:
        table: `name`, `convention` ("standard" or "modified"), `joints` (each with a, alpha, d, theta; m and rad;
            optional `type` "revolute" or "prismatic" and `rated_effort`, N m or N), optional `gravity` (m/s^2) and
            `transmission`.
        where: what to name in an error.

    Raises:
        InputError: a key is missing or its value cannot be used.

    Example:
        >>> joints = [{"a": a, "alpha": 0.0, "d": 0.1, "theta": 0.0} for a in (0.35, 0.3)]
        >>> bayesid.robot_from_table({"name": "scara", "convention": "standard", "joints": joints}, "scara").n_joints
        2
    """
    convention = table.get("convention")
    if convention == "chain":
        return _robot_from_chain(table, where)
    if convention not in ("standard", "modified"):
        said = "key 'convention' is missing" if convention is None else f"unknown convention {convention!r}"
        raise InputError(said, where, 'give convention = "standard" or "modified"')
    rows = table.get("joints")
    if not isinstance(rows, list) or not rows:
        raise InputError("key 'joints' is missing", where, "give one [[joints]] table a joint with a, alpha, d, theta")
    check_count(len(rows), where)
    dh = [_dh_row(row, f"{where}, joint {i}") for i, row in enumerate(rows, start=1)]
    joints = _standard_joints(dh) if convention == "standard" else _modified_joints(dh)
    lengths = {f"{symbol}{i}": row[symbol] for i, row in enumerate(dh, start=1) for symbol in ("a", "d")}
    return Robot(
        name=str(table.get("name", "robot")),
        joints=joints,
        gravity=given_numbers(table.get("gravity", [0.0, 0.0, -9.81]), (3,), "gravity", where),
        transmission=_transmission(table.get("transmission"), len(joints), where),
        lengths={symbol: value for symbol, value in lengths.items() if value != 0.0},
    )


def robot_table(robot: Robot) -> dict[str, Any]:
    """A robot as plain tables that `robot_from_table` reads back to the last digit: joint placements, no DH angles."""
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
    rows, lengths = table.get("joints"), table.get("lengths", {})
    if not isinstance(rows, list) or not rows or not isinstance(lengths, Mapping):
        raise InputError("key 'joints' or 'lengths' cannot be used", where, _AS_WRITTEN)
    check_count(len(rows), where)
    return Robot(
        name=str(table.get("name", "robot")),
        joints=tuple(_chain_joint(row, i, f"{where}, joint {i + 1}") for i, row in enumerate(rows)),
        gravity=given_numbers(table.get("gravity", [0.0, 0.0, -9.81]), (3,), "gravity", where),
        transmission=_transmission(table.get("transmission"), len(rows), where),
        lengths={str(key): float(given_numbers(value, (), str(key), where)) for key, value in lengths.items()},
        notes=tuple(map(str, _listed(table.get("notes", []), f"{where}, notes"))),
    )


def _listed(value: object, where: str) -> list[Any]:
    if not isinstance(value, list):
        raise InputError("is no list", where, _AS_WRITTEN)
    return value


def _chain_joint(row: object, index: int, where: str) -> Joint:
    if not isinstance(row, Mapping):
        raise InputError("is not a table", where, _AS_WRITTEN)
    for key in ("placement", "axis", "type", "parent", "link_frame"):
        if key not in row:
            raise InputError(f"key '{key}' is missing", where, _AS_WRITTEN)
    placement, link_frame = (_frame(row[key], key, where) for key in ("placement", "link_frame"))
    axis = given_numbers(row["axis"], (3,), "axis", where)
    if not np.isclose(np.linalg.norm(axis), 1.0):
        raise InputError("key 'axis' is no unit vector", where, _AS_WRITTEN)
    if not isinstance(row["parent"], int) or not -1 <= row["parent"] < index:
        raise InputError("key 'parent' names no earlier joint", where, _AS_WRITTEN)
    slides, name, rated = row["type"] == "prismatic", str(row.get("name", "")), _rated_effort(row, where)
    return Joint(placement, axis, slides, row["parent"], link_frame, name, rated)


def _rated_effort(row: Mapping[str, Any], where: str) -> float | None:
    """Of a joint's row, N m or N; None where it tells none."""
    if "rated_effort" not in row:
        return None
    effort = float(given_numbers(row["rated_effort"], (), "rated_effort", where))
    if effort <= 0.0:
        raise InputError("key 'rated_effort' is not positive", where, "give the joint's rated effort, in N m or N")
    return effort


def _frame(value: object, key: str, where: str) -> Array:
    """(4, 4) a place of a rigid body."""
    frame = given_numbers(value, (4, 4), key, where)
    turn = frame[:3, :3]
    rigid = np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) and np.linalg.det(turn) > 0.0
    if not rigid or frame[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        raise InputError(f"key '{key}' is no place of a rigid body", where, _AS_WRITTEN)
    return frame


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


def _rotation(axis: str, angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    matrix = np.eye(4)
    i, j = (1, 2) if axis == "x" else (0, 1)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def _translation(x: float, z: float) -> Array:
    matrix = np.eye(4)
    matrix[0, 3], matrix[2, 3] = x, z
    return matrix


def _standard_joints(dh: list[dict[str, Any]]) -> tuple[Joint, ...]:
    """Distal convention: joint i acts at the end of link i - 1, and link i's frame sits at its own far end."""
    joints, placement = [], np.eye(4)
    for i, row in enumerate(dh):
        to_link = _rotation("z", row["theta"]) @ _translation(row["a"], row["d"]) @ _rotation("x", row["alpha"])
        axis, rated = np.array([0.0, 0.0, 1.0]), row["rated_effort"]
        joints.append(Joint(placement, axis, row["prismatic"], i - 1, to_link, rated_effort=rated))
        placement = to_link
    return tuple(joints)


def _modified_joints(dh: list[dict[str, Any]]) -> tuple[Joint, ...]:
    """Proximal convention (Craig): link i's frame is joint i's own."""
    joints = []
    for i, row in enumerate(dh):
        before = _rotation("x", row["alpha"]) @ _translation(row["a"], 0.0)
        placement = before @ _rotation("z", row["theta"]) @ _translation(0.0, row["d"])
        axis, rated = np.array([0.0, 0.0, 1.0]), row["rated_effort"]
        joints.append(Joint(placement, axis, row["prismatic"], i - 1, rated_effort=rated))
    return tuple(joints)
