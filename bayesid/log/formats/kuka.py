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
from pathlib import Path
from typing import NamedTuple

from bayesid.errors import InputError
from bayesid.log.formats.base import Format, Options
from bayesid.log.formats.labels import UNITS, factor_of, has_positions
from bayesid.log.formats.names import choose
from bayesid.log.formats.stated import described, stated_columns
from bayesid.log.formats.table import DEGREE, Chosen, SourceColumn, Table
from bayesid.log.formats.text import look, read_text
from bayesid.log.tuning import TUNING

_TIME = re.compile(r"(?P<prefix>.*[._ ])?ipoc|(?P<plain>t|time|zeit)", re.IGNORECASE)
_TORQUES = "Torque", "GearTorque", "AxisTorque"
_QUANTITIES = "AIPos", "ASPos", "AxisVel", *_TORQUES, "MACur"
_AXIS = re.compile(
    rf"(?:(?P<prefix>.*[._ ])?(?P<quantity>{'|'.join(_QUANTITIES)})[._ ]?A?|(?P<plain>A|I))(?P<axis>[1-9])",
    re.IGNORECASE,
)
_UNIT = re.compile(r"(?P<name>.*?)\s*[\[(](?P<unit>[^])]+)[\])]")
_NEEDED = "needed are IPOC or Time, AIPos.A1.. and MACur.A1.. or Torque.A1.., or `columns`"


class KukaTable(Format):
    """A table whose header names the axes of a controller, or its clock."""

    name = "a KUKA table"
    options = frozenset({"columns"})

    def recognises(self, path: Path, head: bytes) -> bool:
        """Whether the header is a controller's, and not that of a CSV log."""
        try:
            return _is_kuka(look(head).header)
        except (UnicodeDecodeError, csv.Error):
            return False

    def read(self, path: Path, options: Options) -> Table:
        """The columns of a log; a user may name the time of one, or all."""
        return _noted(read_text(path, lambda header, where: _chosen(header, where, options)))


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
        """The only kind of the first of some quantities that is there, of several prefixes the given one."""
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
            unit = factor_of(name, bracketed["unit"])
            if unit is None:
                said = f"column {label} is in a unit that is not known"
                raise InputError(said, self.where, f"give it in {', '.join(UNITS[name])}")
        return SourceColumn(f"{name}{axis}" if axis else name, place, label, unit)


def _is_kuka(header: Sequence[str]) -> bool:
    """Whether a header names the axes of a KUKA controller, or its clock, and not the joints of a CSV log."""
    kinds = {kind.quantity for kind, _ in filter(None, map(_parse, header))}
    return bool(kinds & {"aipos", "aspos", "a", "ipoc"}) and not has_positions(header)


def _chosen(header: Sequence[str], where: str, options: Options) -> Chosen:
    """The columns that make a log, by the controller's names but for a time that a user has named, or by the user's."""
    columns = options.columns or {}
    if set(columns) - {"t"} or options.part:
        return choose(header, where, options)
    stated = {source.name: source for source in stated_columns(header, columns, where, described(header))}
    by_names = _choose(header, where, motion=options.motion)
    return Chosen(tuple(stated.get(source.name, source) for source in by_names))


def _choose(header: Sequence[str], where: str, *, motion: bool = False) -> tuple[SourceColumn, ...]:
    """The columns that make a log; InputError where one is missing, or several hold the same."""
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


def _noted(table: Table) -> Table:
    """The table itself, with a note if its positions are commanded ones."""
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
    if len(label) > TUNING.longest_label:
        return None
    bracketed = _UNIT.fullmatch(label)
    name = label if bracketed is None else bracketed["name"]
    if match := _TIME.fullmatch(name):
        return _Kind((match["plain"] or "ipoc").lower(), match["prefix"] or ""), 0
    if match := _AXIS.fullmatch(name):
        return _Kind((match["plain"] or match["quantity"]).lower(), match["prefix"] or ""), int(match["axis"])
    return None


def _missing(said: str, columns: _Columns) -> InputError:
    names = [name for name in columns.header if name]
    shown = ", ".join(names[:30]) + (" and others" if len(names) > 30 else "")
    return InputError(f"{said} among {shown}", columns.where, _NEEDED)
