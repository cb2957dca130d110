"""Robot files from Denavit-Hartenberg tables of data sheets, and a template."""

from __future__ import annotations

import csv
import io
import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import tomli_w

from bayesid.errors import InputError
from bayesid.log.formats.labels import factor_of, split_brackets
from bayesid.log.formats.text import Layout, layout_of
from bayesid.robot import robot_from_table

_ALPHA, _THETA, _MINUS = "\N{GREEK SMALL LETTER ALPHA}", "\N{GREEK SMALL LETTER THETA}", "\N{MINUS SIGN}"
_NAMES = {"a": "a", "r": "a", "alpha": "alpha", _ALPHA: "alpha", "d": "d", "theta": "theta", _THETA: "theta"}
_NAMES |= {"offset": "theta", "thetaoffset": "theta", f"{_THETA}offset": "theta", "type": "type"}
"""Column names in tables, in lower case, without spaces, underscores and subscripts."""
_NAME = re.compile(rf"(?P<name>{'|'.join(_NAMES)})(?:i-1|i|j)?")
_BRACKETED_SUBSCRIPT = re.compile(r"[({\[]\s*[ij]\s*(?:-\s*1)?\s*[)}\]]")
_LENGTHS = "a", "d"
_JOINT = re.compile(rf"(?:q|{_THETA}|theta|d)_?\d*\*?", re.IGNORECASE)
"""The joint's position, which some tables write into the column of its offset."""
_PI = re.compile(r"(?P<sign>[+-]?)(?P<times>\d*\.?\d*)\*?(?:pi|π)(?:/(?P<over>\d+\.?\d*))?", re.IGNORECASE)
_TYPES = {"r": "revolute", "revolute": "revolute", "p": "prismatic", "prismatic": "prismatic"}

_TEMPLATE = """\
# A robot by its Denavit-Hartenberg table: replace every nan by a number; a and d in m, alpha and theta in rad
# (90 degrees are 1.5707963267948966). Then look at it: bayesid robot show {path}
{name}

# "standard" (distal): Rz(q + theta) Tz(d) Tx(a) Rx(alpha), row i leads from joint i to joint i + 1 or the flange
# "modified" (proximal, Craig): Rx(alpha) Tx(a) Rz(q + theta) Tz(d), row i leads from joint i - 1 to joint i
convention = "{convention}"

# acceleration of gravity in the base frame, m/s^2: [0.0, 0.0, 9.81] for a robot that hangs from the ceiling
gravity = [0.0, 0.0, -9.81]

# coupled motors, as in many wrists: motor speeds = transmission @ joint speeds
# transmission = [[100,0,0,0,0,0],[0,100,0,0,0,0],[0,0,100,0,0,0],[0,0,0,80,0,0],[0,0,0,0,80,0],[0,0,0,0,50,50]]

# one row per joint, from base to tip; theta is added to the controller's position; a prismatic joint has
# type = "prismatic"
joints = [
{rows}
]
"""
_ROBOT = """\
# Denavit-Hartenberg table; a, d in m; alpha, theta in rad
{name}
convention = "{convention}"
gravity = [0.0, 0.0, -9.81]  # m/s^2, base frame
joints = [
{rows}
]
"""


def robot_template(name: str, path: str, convention: str = "standard") -> str:
    """A robot file to fill in; `load_robot` refuses it until every nan is replaced. Its comment names `path`."""
    rows = [_row({"a": math.nan, "alpha": math.nan, "d": math.nan, "theta": 0.0})] * 6
    return _TEMPLATE.format(name=_name_line(name), path=path, convention=convention, rows="\n".join(rows))


def robot_file(table: str, name: str, convention: str, where: str) -> str:
    r"""A robot file from a Denavit-Hartenberg table as text.

    The header names the columns a, alpha, d, theta (r, α, θ, offset; with or without subscripts), with units in
    brackets: mm, cm, m, deg, rad; by default m and rad. A column `type` may hold `revolute` or `prismatic`. Other
    columns are left out. Cells may hold pi/2, 90° and q2 - 90.

    Args:
        table: the text: CSV, or columns separated by semicolons, tabs or spaces; one row per joint.
        name: of the robot.
        convention: "standard" or "modified".
        where: source of the table, for errors.

    Raises:
        InputError: the text is not such a table.

    >>> text = robot_file("a[mm],alpha[deg],d[mm],theta[deg]\n25,-90,400,0", "arm", "standard", "here")
    >>> print(text.splitlines()[-2])
      { a = 0.025, alpha = -1.5707963267948966, d = 0.4, theta = 0.0 },
    """
    lines = [line for line in re.sub(r" +(?=[\[(])", "", table).splitlines() if line.strip()]
    try:
        layout = layout_of("\n".join(lines).encode())
    except csv.Error:
        raise InputError("is not text", where, "give a table as text, CSV for example") from None
    columns = _columns(layout.header, where)
    rows = [
        _joint(cells, columns, f"{where}, joint {i}")
        for i, cells in enumerate(_cells("\n".join(lines), layout, where), start=1)
    ]
    if not rows:
        raise InputError("holds no joint", where, "give one row per joint below the header")
    text = _ROBOT.format(name=_name_line(name), convention=convention, rows="\n".join(map(_row, rows)))
    robot_from_table(tomllib.loads(text), where)
    return text


@dataclass(frozen=True)
class _Column:
    place: int  # index
    label: str
    factor: float | None  # rad or m per unit; None without a unit


def _columns(header: Sequence[str], where: str) -> dict[str, _Column]:
    found: dict[str, _Column] = {}
    for place, label in enumerate(header):
        plain, unit = split_brackets(_BRACKETED_SUBSCRIPT.sub("", label))
        match = _NAME.fullmatch(re.sub(r"[\s_]", "", plain.casefold()))
        if match is None:
            continue
        name = _NAMES[match["name"]]
        if name in found:
            problem = f"has two columns for {name}: {found[name].label} and {label}"
            raise InputError(problem, where, "remove one of them")
        factor, length = None if unit is None else factor_of("q", unit), name in _LENGTHS
        if unit is not None and (factor is None or (unit.strip().casefold() in ("m", "cm", "mm")) != length):
            units = "mm, cm or m" if length else "deg or rad"
            raise InputError(f"column {label} is in {unit!r}", where, f"give it in {units}")
        found[name] = _Column(place, label, factor)
    for name in ("a", "alpha", "d", "theta"):
        if name not in found:
            problem = f"column {name} is missing ({', '.join(header) or 'no header'})"
            remedy = "give the columns a, alpha, d, theta with their units: a[mm],alpha[deg],d[mm],theta[deg]"
            raise InputError(problem, where, remedy)
    return found


def _cells(text: str, layout: Layout, where: str) -> Iterator[list[str]]:
    below = list(layout.lines(io.StringIO(text)))[layout.rows :]
    for number, line in enumerate(below, start=1):
        spaced = layout.separator == " "
        reader = csv.reader([line.strip() if spaced else line], delimiter=layout.separator, skipinitialspace=spaced)
        cells = [cell.strip() for cell in next(reader)]
        if len(cells) != len(layout.header):
            problem = f"holds {len(cells)} values, but the header has {len(layout.header)} names"
            remedy = "give every column a value, with commas or semicolons between them"
            raise InputError(problem, f"{where}, joint {number}", remedy)
        yield cells


def _joint(cells: Sequence[str], columns: Mapping[str, _Column], where: str) -> dict[str, Any]:
    row: dict[str, Any] = {}
    for name, column in columns.items():
        cell = cells[column.place]
        row[name] = _TYPES.get(cell.casefold()) if name == "type" else _value(cell, column, name, where)
        if row[name] is None:
            raise InputError(f"unknown joint type {cell!r}", where, 'give "revolute" or "prismatic"')
    return row


def _value(cell: str, column: _Column, name: str, where: str) -> float:
    """A cell in m or rad. With `pi` it is in rad, with a degree sign in degrees, for any unit of the column."""
    text = cell.replace(" ", "").replace(_MINUS, "-")
    if name in ("d", "theta"):  # one of them is the joint's position, to which an offset may be added
        text = _JOINT.sub("", text, count=1).removesuffix("+") or "0"
    try:
        if name not in _LENGTHS and (found := _PI.fullmatch(text)):
            size = float(found["times"] or 1.0) * math.pi / float(found["over"] or 1.0)
            value = -size if found["sign"] == "-" else size
        elif name not in _LENGTHS and text.endswith("°"):
            value = math.radians(float(text[:-1]))
        else:
            value = float(text) * (1.0 if column.factor is None else column.factor)
    except (ValueError, ZeroDivisionError):
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"column {column.label} holds {cell!r}, not a number", where, "correct the value")
    # no link is 20 m long, but many are 20 mm; twists and offsets are at most one turn
    largest, unit, wrong = (20.0, "m", "mm") if name in _LENGTHS else (2.0 * math.pi + 1e-6, "rad", "deg")
    if column.factor is None and abs(value) >= largest:
        problem = f"column {column.label} holds {value:g}, too much for {unit}"
        raise InputError(problem, where, f"name the column with its unit: {name}[{wrong}]")
    return value


def _row(row: Mapping[str, Any]) -> str:
    numbers = {
        name: float(f"{row[name]:.12g}") if name in _LENGTHS else row[name] for name in ("a", "alpha", "d", "theta")
    }
    kind = ['type = "prismatic"'] if row.get("type") == "prismatic" else []
    return f"  {{ {', '.join([*kind, *(f'{name} = {value + 0.0!r}' for name, value in numbers.items())])} }},"


def _name_line(name: str) -> str:
    return tomli_w.dumps({"name": name}).strip()
