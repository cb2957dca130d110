"""The names of a log's columns: `t,q1..qn[,dq1..dqn],tau1..taun`, or `i1..in`, each perhaps with its unit.

`q1[deg]`, `q1 (deg)` and `q1_deg` are q1 in degrees, where no column is called q1 and nothing more.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from bayesid.errors import InputError
from bayesid.log.formats.table import DEGREE

_ANGLES = {"rad": 1.0, "deg": DEGREE, "°": DEGREE}
UNITS: dict[str, dict[str, float]] = {
    "t": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "q": {**_ANGLES, "m": 1.0, "mm": 1e-3},
    "dq": {f"{angle}{per}": factor for per in ("/s", "_s", "") for angle, factor in _ANGLES.items()}
    | {"rpm": 6.0 * DEGREE, "m/s": 1.0, "mm/s": 1e-3},
    "tau": {"Nm": 1.0, "N m": 1.0, "N": 1.0},
    "i": {"A": 1.0, "mA": 1e-3},
}
"""SI units in one of the units that a column may be in."""
_UNIT = re.compile(r"(?P<name>.+?)\s*(?:\[(?P<square>[^]]+)\]|\((?P<round>[^)]+)\)|_(?P<tail>.+))")
_NAME = re.compile(r"t|(?:q|dq|tau|i)[1-9]\d*")


@dataclass(frozen=True)
class SourceColumn:
    """A column of a file that a log needs.

    Attributes:
        name: of the log's column: t, q1, ...
        place: of the file's column, from 0.
        label: what the file calls it.
        unit: how many SI units one of the file's is; None where the name does not say.
    """

    name: str
    place: int
    label: str
    unit: float | None = None


def split_unit(label: str) -> tuple[str, str | None]:
    """A name and the unit that follows it, if one does: "q1[deg]" is q1 in "deg"."""
    match = _UNIT.fullmatch(label)
    return (label, None) if match is None else (match["name"], match["square"] or match["round"] or match["tail"])


def choose(header: Sequence[str], where: str, motion: bool = False) -> tuple[SourceColumn, ...]:
    """The columns that make a log: the time; for every joint its position, effort and, if measured, velocity.

    Args:
        header: the names of a file's columns; those that are not of a log are left out.
        where: the header's place, for messages.
        motion: whether efforts are left out, and need not be there.

    Raises:
        InputError: a column is missing or appears twice.
    """
    recognised = _recognised(header, where)
    if "t" not in recognised:
        raise InputError("column t is missing", where, _remedy(header))
    n = _highest("q", recognised)
    if n == 0:
        raise InputError("column q1 is missing", where, "add the joint positions q1..qn in rad")
    chosen = [recognised["t"]]
    effort = "tau" if _highest("tau", recognised) else "i"
    for kind in ["q", *([] if motion else [effort]), *(["dq"] if _highest("dq", recognised) else [])]:
        for j in range(1, n + 1):
            if f"{kind}{j}" not in recognised:
                absent = f"tau{j} (or i{j} with gains)" if kind == "i" else f"{kind}{j}"
                raise InputError(f"column {absent} is missing", where, f"add it; q1..q{n} are there")
            chosen.append(recognised[f"{kind}{j}"])
        if _highest(kind, recognised) > n:
            extra = next(name for name in recognised if name.startswith(kind) and int(name.removeprefix(kind)) > n)
            remedy = "give q and effort columns for the same joints"
            raise InputError(f"column {extra} has no q beside it", where, remedy)
    return tuple(chosen)


def has_positions(header: Sequence[str]) -> bool:
    """Whether a file holds joint positions by these names."""
    plain = any(re.fullmatch(r"q[1-9]\d*", label) for label in header)
    return plain or any(source.name.startswith("q") for source in _with_units(header))


def _recognised(header: Sequence[str], where: str) -> dict[str, SourceColumn]:
    """The columns of a log among a file's; those with a unit after their name count where no other has the name."""
    plain = [SourceColumn(label, place, label) for place, label in enumerate(header) if _NAME.fullmatch(label)]
    names = {source.name for source in plain}
    recognised: dict[str, SourceColumn] = {}
    for source in [*plain, *(source for source in _with_units(header) if source.name not in names)]:
        if source.name in recognised:
            raise InputError(f"column {source.name} appears twice", where, "give every column its own name")
        recognised[source.name] = source
    return recognised


def _with_units(header: Sequence[str]) -> list[SourceColumn]:
    columns = []
    for place, label in enumerate(header):
        name, unit = split_unit(label)
        factor = UNITS[name.rstrip("0123456789")].get(unit or "") if _NAME.fullmatch(name) else None
        if factor is not None:
            columns.append(SourceColumn(name, place, label, factor))
    return columns


def _highest(kind: str, names: dict[str, SourceColumn]) -> int:
    """The highest joint of which there is a column of a kind."""
    return max((int(match[1]) for name in names if (match := re.fullmatch(rf"{kind}(\d+)", name))), default=0)


def _remedy(header: Sequence[str]) -> str:
    """What to do about a header without a time."""
    for separator, word in {";": "semicolons", "\t": "tabs"}.items():
        if any(separator in name for name in header):
            return f"separate the columns by commas, not by {word}"
    return "add the time in s"
