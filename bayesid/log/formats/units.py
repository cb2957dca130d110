"""Units of a log's columns, as headers state them."""

from __future__ import annotations

import re
from math import pi
from typing import NamedTuple

from bayesid.files.bounded import MOST_DIGITS
from bayesid.log.formats.table import DEGREE

_ANGLES = {"rad": 1.0, "deg": DEGREE, "°": DEGREE, "Grad": DEGREE, "degree": DEGREE, "degrees": DEGREE, "mrad": 1e-3}
_ANGLES |= dict.fromkeys(("rev", "turn", "turns", "U", "Umdr"), 2.0 * pi)
_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_TORQUES = {"Nm": 1.0, "N m": 1.0, "N*m": 1.0, "N·m": 1.0, "N.m": 1.0}
UNITS: dict[str, dict[str, float]] = {
    "t": {
        "s": 1.0,
        "ms": 1e-3,
        "us": 1e-6,
        "ns": 1e-9,
        "sec": 1.0,
        "msec": 1e-3,
        "usec": 1e-6,
        "µs": 1e-6,  # noqa: RUF001  the micro sign, beside the Greek letter
        "μs": 1e-6,
        "min": 60.0,
    },
    "q": _ANGLES | _LENGTHS,
    "dq": {f"{angle}{per}": factor for per in ("/s", "_s", "", "/sec") for angle, factor in _ANGLES.items()}
    | {"rpm": 6.0 * DEGREE, "1/min": 6.0 * DEGREE, "U/min": 6.0 * DEGREE}
    | {f"{length}/s": factor for length, factor in _LENGTHS.items()},
    "tau": _TORQUES
    | {f"m{unit}": 1e-3 for unit in _TORQUES}
    | {"kNm": 1e3, "Ncm": 1e-2, "Nmm": 1e-3, "N mm": 1e-3, "N": 1.0},
    "i": {"A": 1.0, "mA": 1e-3},
}
"""SI units in one of the units that a column of a kind may be in; capitals do not matter."""
_FACTORS = {kind: {unit.casefold(): factor for unit, factor in units.items()} for kind, units in UNITS.items()}
_BRACKETED = re.compile(r"(?P<name>.*?)\s*(?:\[(?P<square>[^][]+)\]|\((?P<round>[^()]+)\))")
_NUMBER = re.compile(r"[0-9]+|\{[^}]*\}")
_COUNT = re.compile(rf"(?P<count>[0-9]{{1,{MOST_DIGITS}}}(?:\.[0-9]+)?)\s*(?P<unit>[^0-9]+)")


LONGEST_LABEL = 500
"""Letters of a label that is looked into: no column of a log is called so."""


class Label(NamedTuple):
    """A name and what is said of its unit, if anything is."""

    name: str
    unit: str | None


def factor_of(kind: str, unit: str) -> float | None:
    """SI units in one of a unit; None where it is not one of such a column. A time may be in "8 ms", which counts rows.

    Args:
        kind: of the column: "t", "q", "dq", "tau" or "i".
        unit: as a header has it.
    """
    count = _COUNT.fullmatch(unit.strip()) if kind == "t" else None
    factor = _FACTORS[kind].get((unit if count is None else count["unit"]).strip().casefold())
    return factor if factor is None or count is None else float(count["count"]) * factor


def is_unit(text: str) -> bool:
    """Whether a text is the unit of any column of a log."""
    return any(text.strip().casefold() in units for units in _FACTORS.values())


def split_brackets(label: str) -> Label:
    """A label without the unit in brackets behind it: "q1 [deg]" is q1 in "deg", but "q[1]" has a number, no unit.

    In a pattern of a user `{}` stands for the number.
    """
    match = None if len(label) > LONGEST_LABEL else _BRACKETED.fullmatch(label)
    unit = None if match is None else match["square"] or match["round"]
    if match is None or unit is None or not match["name"] or _NUMBER.fullmatch(unit.strip()):
        return Label(label, None)
    return Label(match["name"], unit.strip())
