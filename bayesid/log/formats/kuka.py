"""Logs of KUKA controllers: the names of RSI's XML in a table of text, separated by commas, semicolons or tabs.

| name | holds |
|---|---|
| `IPOC`; else `t`, `Time` or `Zeit` | ms; s, or the unit in brackets |
| `AIPos.A1`.., or `A1`..; else `ASPos.A1`.. | axis positions, actual or commanded, degrees |
| `AxisVel.A1`.. | axis velocities, degrees/s; optional |
| `Torque.A1`.., `GearTorque.A1`.. or `AxisTorque.A1`.. | N m |
| `MACur.A1`.., or `I1`.. | motor currents, where there are no torques |

Capitals do not matter, `AIPos_A1`, `AIPosA1`, `AIPos A1` and `AIPos1` are the same, and a prefix that the recorder put
before a name does not matter either (`Receive.AIPos.A1`). External axes (`E1`) and all else are left out.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bayesid.errors import InputError
from bayesid.log.formats.base import Format, Options
from bayesid.log.formats.names import UNITS, SourceColumn, has_positions
from bayesid.log.formats.table import DEGREE, Table
from bayesid.log.formats.text import Dialect, first_line, read_text

_TIME = re.compile(r"(?P<prefix>.*[._ ])?ipoc|(?P<plain>t|time|zeit)", re.IGNORECASE)
_TORQUES = "Torque", "GearTorque", "AxisTorque"
_QUANTITIES = "AIPos", "ASPos", "AxisVel", *_TORQUES, "MACur"
_AXIS = re.compile(
    rf"(?:(?P<prefix>.*[._ ])?(?P<quantity>{'|'.join(_QUANTITIES)})[._ ]?A?|(?P<plain>A|I))(?P<axis>[1-9])",
    re.IGNORECASE,
)
_UNIT = re.compile(r"(?P<name>.*?)\s*[\[(](?P<unit>[^])]+)[\])]")
_SLOWEST = 1.0
"""s; a controller's clock ticks every few ms, so what ticks no faster counts ms. Anything between the two would do."""
_NEEDED = "needed are IPOC or Time, AIPos.A1.. and MACur.A1.. or Torque.A1.."
_SHOWN = 30
"""Names of a header that a message shows."""


_DIALECTS = Dialect(";", decimal_comma=True), Dialect("\t", decimal_comma=True), Dialect()
"""With semicolons and tabs it stays open what a comma is, so both are decimal points."""


class KukaTable(Format):
    """A table whose header names the axes of a controller, or its clock."""

    name = "a KUKA table"

    def recognises(self, path: Path, head: bytes) -> bool:
        """Whether the header is a controller's, and not that of a CSV log."""
        return _dialect(first_line(head)) is not None

    def read(self, path: Path, options: Options) -> Table:
        """The columns of a log."""
        with path.open("rb") as file:
            dialect = _dialect(first_line(file.readline()))
        return _check(read_text(path, dialect or Dialect(), partial(_choose, motion=options.motion)))


def _dialect(line: str) -> Dialect | None:
    """How a file with this header writes a table; None if it is none of a controller's."""
    for dialect in _DIALECTS:
        try:
            if _is_kuka(dialect.header(line)):
                return dialect
        except csv.Error:
            continue
    return None


class _Kind(NamedTuple):
    """A column of an axis, or of time: what it holds and what the recorder put before that name."""

    quantity: str
    prefix: str


@dataclass(frozen=True)
class _Columns:
    """A file's columns that are of KUKA's: for each kind, its axes and their places in the header."""

    header: Sequence[str]
    places: dict[_Kind, dict[int, int]]
    where: str

    def pick(self, quantities: Sequence[str], prefix: str | None = None) -> _Kind | None:
        """The only kind of the first of some quantities that is there.

        Args:
            quantities: in the order of preference.
            prefix: what to prefer where several recorders' prefixes stand before the same name.
        """
        for quantity in quantities:
            kinds = [kind for kind in self.places if kind.quantity == quantity]
            if len(kinds) > 1:
                kinds = [kind for kind in kinds if kind.prefix == prefix] or kinds
            if len(kinds) > 1:
                first = [self.header[min(self.places[kind].values())] for kind in kinds]
                raise InputError(f"{' and '.join(first)} hold the same", self.where, "leave all but one out")
            if kinds:
                return kinds[0]
        return None

    def choices(self, name: str, kind: _Kind, n: int, unit: float | None) -> list[SourceColumn]:
        """The columns of axes 1 to n."""
        places = self.places[kind]
        for axis in range(1, n + 1):
            if axis not in places:
                beside = self.header[min(places.values())]
                said = f"column {beside} has none beside it for axis {axis}"
                raise InputError(said, self.where, f"add it: there are positions of {n} axes")
        return [self.choice(name, axis, places[axis], unit) for axis in range(1, n + 1)]

    def choice(self, name: str, axis: int, place: int, unit: float | None) -> SourceColumn:
        """A column of an axis, or of time (axis 0), in the unit of its brackets or else in the given one."""
        label = self.header[place]
        bracketed = _UNIT.fullmatch(label)
        if bracketed is not None and name != "i":  # gains turn any unit of currents into N m
            if bracketed["unit"] not in UNITS[name]:
                said = f"column {label} is in a unit that is not known"
                raise InputError(said, self.where, f"give it in {', '.join(UNITS[name])}")
            unit = UNITS[name][bracketed["unit"]]
        return SourceColumn(f"{name}{axis}" if axis else name, place, label, unit)


def _is_kuka(header: Sequence[str]) -> bool:
    """Whether a header names the axes of a KUKA controller, or its clock, and not the joints of a CSV log."""
    kinds = {kind.quantity for kind, _ in filter(None, map(_parse, header))}
    return bool(kinds & {"aipos", "aspos", "a", "ipoc"}) and not has_positions(header)


def _choose(header: Sequence[str], where: str, motion: bool = False) -> tuple[SourceColumn, ...]:
    """The columns that make a log, see `bayesid.log.formats.names.choose`.

    Raises:
        InputError: one is missing, or several hold the same.
    """
    columns = _find(header, where)
    position = columns.pick(["aipos", "a", "aspos"])
    if position is None:
        raise _missing("there are no axis positions", columns)
    prefix, n = position.prefix, max(columns.places[position])
    clock = columns.pick(["ipoc", "t", "time", "zeit"], prefix)
    sought = () if motion else _TORQUES
    efforts = [kind for quantity in sought if (kind := columns.pick([quantity.lower()], prefix)) is not None]
    if len(efforts) > 1:
        first = [header[min(columns.places[kind].values())] for kind in efforts]
        raise InputError(f"{' and '.join(first)} are torques", where, "leave all but one kind out")
    effort = efforts[0] if efforts else None
    current = columns.pick(["macur", "i"], prefix) if effort is None and not motion else None
    velocity = columns.pick(["axisvel"], prefix)
    if clock is None:
        raise _missing("there is no time", columns)
    chosen = [columns.choice("t", 0, columns.places[clock][0], 1e-3 if clock.quantity == "ipoc" else None)]
    chosen += columns.choices("q", position, n, DEGREE)
    if velocity is not None:
        chosen += columns.choices("dq", velocity, n, DEGREE)
    if effort is not None:
        chosen += columns.choices("tau", effort, n, None)
    elif current is not None:
        chosen += columns.choices("i", current, n, None)
    elif not motion:
        raise _missing("there are neither motor currents nor torques of the axes", columns)
    return tuple(chosen)


def _check(table: Table) -> Table:
    """The table itself, if its time is in s; with a note if its positions are commanded ones.

    Raises:
        InputError: it looks as if it counted ms.
    """
    t = table.columns["t"]
    steps = np.diff(t.values)
    if t.unit is None and np.any(steps > 0.0) and np.median(steps[steps > 0.0]) >= _SLOWEST:
        said = f"column {t.label} grows by {np.median(steps[steps > 0.0]):g} a row: does it count ms?"
        raise InputError(said, table.source, f"call it {t.label}[ms], or {t.label}[s] if it does not")
    if "aspos" in table.columns["q1"].label.lower():
        said = f"{table.source}: positions are commanded ones (ASPos); the axes lag behind them"
        return replace(table, notes=(*table.notes, said))
    return table


def _find(header: Sequence[str], where: str) -> _Columns:
    places: dict[_Kind, dict[int, int]] = {}
    for place, label in enumerate(header):
        if (parsed := _parse(label)) is None:
            continue
        kind, axis = parsed
        axes = places.setdefault(kind, {})
        if axis in axes:
            said = f"columns {header[axes[axis]]} and {label} hold the same"
            raise InputError(said, where, "give every column its own name")
        axes[axis] = place
    return _Columns(header, places, where)


def _parse(label: str) -> tuple[_Kind, int] | None:
    """What a column holds, and of which axis, 0 for time; None if it is none of a controller's."""
    bracketed = _UNIT.fullmatch(label)
    name = label if bracketed is None else bracketed["name"]
    if match := _TIME.fullmatch(name):
        return _Kind((match["plain"] or "ipoc").lower(), match["prefix"] or ""), 0
    if match := _AXIS.fullmatch(name):
        return _Kind((match["plain"] or match["quantity"]).lower(), match["prefix"] or ""), int(match["axis"])
    return None


def _missing(said: str, columns: _Columns) -> InputError:
    names = [name for name in columns.header if name]
    shown = ", ".join(names[:_SHOWN]) + (" and others" if len(names) > _SHOWN else "")
    return InputError(f"{said} among {shown}", columns.where, _NEEDED)
