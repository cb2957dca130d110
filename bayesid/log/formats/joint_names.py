"""Columns named after joints, as PlotJuggler writes them: `/joint_states/elbow_joint/position`.

The names of the robot, or those given by the user, order the joints. Without such names joints are in the order of
their columns.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bayesid.errors import InputError
from bayesid.files.bounded import MOST_DIGITS
from bayesid.log.formats.labels import factor_of, is_desired, kind_of, split_brackets
from bayesid.log.formats.table import Column, Options, SourceColumn

_NAMES = re.compile(r"(?<![a-z])(?:joint_?)?names?[\W_]*[0-9]+\W*$", re.IGNORECASE)
_SEPARATORS = re.compile(r"[/.\[\]]+")


class _Named(NamedTuple):
    """A column with its kind, joint and topic."""

    place: int
    label: str
    kind: str
    name: str
    topic: str
    factor: float | None


class ByName(NamedTuple):
    """Columns of named joints from base to tip, the names, and whether the order is assumed."""

    columns: tuple[SourceColumn, ...] = ()
    names: tuple[str, ...] = ()
    assumed: bool = False


def shared_names(joints: Sequence[str], present: Sequence[str]) -> tuple[str, ...]:
    """The present names that match all joints, each perhaps with a prefix; empty if one is missing."""
    found = [_matching_name(name, present) for name in joints]
    return tuple(map(str, found)) if None not in found and len(set(found)) == len(found) else ()


def names_of_robot(robot_joints: Sequence[str], present: Sequence[str], where: str) -> tuple[str, ...]:
    """The same for a robot's joints; InputError if only some are present."""
    found, chosen = {name: _matching_name(name, present) for name in robot_joints}, shared_names(robot_joints, present)
    if chosen or not any(found.values()):
        return chosen
    missing = [name for name, match in found.items() if match is None]
    others = [name for name in present if name not in found.values()]
    shared = ", ".join(name for name, match in found.items() if match is not None)
    absent, verb = missing or robot_joints, "is" if len(missing or robot_joints) == 1 else "are"
    what = f"joints {shared} match the robot's, but {', '.join(absent)} {verb} not among {', '.join(present)}"
    remedy = "give `joints`, the log's names from base to tip"
    if len(missing) == len(others) == 1:
        names = ",".join(match or others[0] for match in found.values())
        remedy = f"if {others[0]} is {missing[0]}, give `joints` {names}; otherwise the log's names from base to tip"
    raise InputError(what, where, remedy)


def _matching_name(name: str, present: Sequence[str]) -> str | None:
    """The only name that is equal or has this ending."""
    found = [candidate for candidate in present if candidate == name] or [
        candidate for candidate in present if name and re.search(rf"(?:^|[/_.]){re.escape(name)}$", candidate)
    ]
    return found[0] if len(found) == 1 else None


def are_numbered(names: Sequence[str]) -> bool:
    """Whether names differ only by numbers, which then give the order."""
    return len({re.sub("[0-9]+", "#", name) for name in names}) == 1


def in_order(names: Sequence[str]) -> tuple[str, ...]:
    """The names in order of their numbers, if they differ only by these; else unchanged."""
    digits = re.compile(rf"[0-9]{{1,{MOST_DIGITS}}}")
    numbered = are_numbered(names)
    return tuple(sorted(names, key=lambda name: [*map(int, digits.findall(name))])) if numbered else tuple(names)


def columns_by_name(header: Sequence[str], where: str, options: Options, *, alone: bool) -> ByName:
    """Columns of joints by name; empty if the header does not name joints.

    Args:
        header: labels of all columns.
        where: location for errors.
        options: with joint names from base to tip, given by the user or from the robot.
        alone: whether no other column can be a position, so that any names are accepted.

    Raises:
        InputError: a given name does not exist, or several topics hold all of them.
    """
    expected = options.joints or options.robot_joints
    found = (_read(place, label, expected or ()) for place, label in enumerate(header))
    known = [column for column in found if column is not None]
    names = list(dict.fromkeys(column.name for column in known if column.kind == "q"))
    chosen, assumed = shared_names(expected or (), names), False
    if not chosen and options.joints is not None and expected:
        missing = next((name for name in expected if name not in names), expected[0])
        raise InputError(f"no position column names joint {missing}", where, f"give `joints` of {', '.join(names)}")
    if not chosen:
        if alone and options.joints is None:
            names_of_robot(options.robot_joints, names, where)
        if not alone or len(names) < 2:
            return ByName()
        chosen, assumed = in_order(names), not are_numbered(names)
    effort = _effort(known, chosen, options)
    columns: list[SourceColumn] = []
    topic = None
    for kind in ("q", *([] if options.motion or effort is None else [effort]), "dq"):
        topics = _topics(known, kind, chosen)
        if topic is None and len(topics) > 1:
            what = f"topics {' and '.join(sorted(topics))} hold positions of all joints"
            raise InputError(what, where, "remove the columns of one of them")
        topic = topic if topic in topics else next(iter(topics), topic)
        if topics:
            of_name = topics[topic if topic in topics else next(iter(topics))]
            columns += [
                SourceColumn(f"{kind}{j}", of_name[name].place, of_name[name].label, of_name[name].factor)
                for j, name in enumerate(chosen, start=1)
            ]
    return ByName(tuple(columns), chosen, assumed) if columns else ByName()


def _effort(known: Sequence[_Named], names: Sequence[str], options: Options) -> str | None:
    kinds = ("i", "tau") if options.currents else ("tau", "i")
    return next((kind for kind in kinds if _topics(known, kind, names)), None)


def _topics(known: Sequence[_Named], kind: str, names: Sequence[str]) -> dict[str, Mapping[str, _Named]]:
    """Topics with a kind for all names, and their columns by name; a later column of the same name is ignored."""
    found: dict[str, dict[str, _Named]] = {}
    for column in known:
        if column.kind == kind and column.name in names:
            found.setdefault(column.topic, {}).setdefault(column.name, column)
    return {topic: columns for topic, columns in found.items() if len(columns) == len(names)}


def _read(place: int, label: str, expected: Sequence[str]) -> _Named | None:
    """Kind and joint of a label: by an expected name, or as TOPIC/NAME/KIND or TOPIC/KIND/NAME."""
    if is_desired(label):
        return None
    plain, unit = split_brackets(label)
    for name in sorted(expected, key=len, reverse=True):
        found = re.search(rf"(?<![A-Za-z0-9]){re.escape(name)}(?![A-Za-z0-9])", plain) if name else None
        if found is not None:
            before, after = plain[: found.start()], plain[found.end() :]
            parts = [part for part in _SEPARATORS.split(f"{before}/{after}") if part.strip("_ ")]
            kind = kind_of(parts[-1]) if parts else None
            if kind not in (None, "t"):
                return _named(place, label, str(kind), name, "/".join(parts[:-1]), unit)
    parts = [part for part in _SEPARATORS.split(plain) if part]
    if len(parts) < 2:
        return None
    if (kind := kind_of(parts[-1])) not in (None, "t"):
        return _named(place, label, str(kind), parts[-2], "/".join(parts[:-2]), unit)
    if (kind := kind_of(parts[-2])) not in (None, "t"):
        return _named(place, label, str(kind), parts[-1], "/".join(parts[:-2]), unit)
    return None


def _named(place: int, label: str, kind: str, name: str, topic: str, unit: str | None) -> _Named | None:
    factor = None if unit is None else factor_of(kind, unit)
    if not re.search("[A-Za-z]", name) or (unit is not None and factor is None and kind != "i"):
        return None
    return _Named(place, label, kind, name, topic, 1.0 if unit is not None and factor is None else factor)


# ---- Names in cells ----
def name_places(header: Sequence[str], columns: Sequence[SourceColumn]) -> list[int]:
    """Places of the columns with joint names, as `name_0` beside `position_0`; empty if some are missing."""
    numbers = [_last_number(column.label) for column in columns if re.fullmatch("q[0-9]+", column.name)]
    found = {_last_number(label): place for place, label in enumerate(header) if _NAMES.search(label)}
    places = [found.get(number, -1) for number in numbers]
    return places if places and None not in numbers and -1 not in places else []


def by_cells(
    columns: Mapping[str, Column], cells: Sequence[Sequence[str]], where: str, options: Options
) -> tuple[dict[str, Column], ByName]:
    """Columns of joints in one order, by each row's names: the robot's, the user's, or the first row's."""
    first = list(cells[0])
    if len(set(first)) < len(first):  # these are not joint names
        return dict(columns), ByName()
    chosen = (
        shared_names(options.joints, first) if options.joints else names_of_robot(options.robot_joints, first, where)
    )
    if options.joints is not None and not chosen:
        raise InputError("has other joint names", where, f"give `joints` of {', '.join(first)}")
    names = chosen or in_order(first)
    try:
        order = np.array([[row.index(name) for name in names] for row in map(list, cells)])
    except ValueError:
        what = f"not all rows name the joints {', '.join(names)}"
        raise InputError(what, where, "remove the rows of other publishers") from None
    made = {name: column for name, column in columns.items() if not re.fullmatch("(q|dq|tau|i)[0-9]+", name)}
    for kind in ("q", "dq", "tau", "i"):
        if f"{kind}1" not in columns:
            continue
        block = np.column_stack([columns[f"{kind}{j + 1}"].values for j in range(len(first))])
        for k, column in enumerate(np.take_along_axis(block, order, axis=1).T):
            made[f"{kind}{k + 1}"] = replace(columns[f"{kind}{order[0, k] + 1}"], values=column)
    return made, ByName((), names, assumed=not chosen and not are_numbered(first))


def order_note(where: str, names: Sequence[str]) -> str:
    """Message about an assumed order of joints."""
    return f"{where}: assumed joint order from base to tip: {', '.join(names)}; if it is another, give `joints`"


def _last_number(label: str) -> int | None:
    digits = re.findall("[0-9]{1,9}", label)
    return int(digits[-1]) if digits else None
