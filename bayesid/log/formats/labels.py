"""What the labels of columns say: the names `t,q1..qn,dq1..,tau1..,i1..` of a log, and the usual other ones.

`q1[deg]`, `q1 (deg)` and `q1_deg` are q1 in degrees.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import NamedTuple

from bayesid.files.bounded import MOST_DIGITS, whole_number
from bayesid.log.formats.table import DEGREE
from bayesid.log.tuning import TUNING

_ANGLES = {"rad": 1.0, "deg": DEGREE, "°": DEGREE, "Grad": DEGREE, "degree": DEGREE, "degrees": DEGREE, "mrad": 1e-3}
_ANGLES |= dict.fromkeys(("rev", "turn", "turns", "U", "Umdr"), 2.0 * pi)
_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_NEWTON_METRES = {"Nm": 1.0, "N m": 1.0, "N*m": 1.0, "N·m": 1.0, "N.m": 1.0}
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
    "tau": _NEWTON_METRES
    | {f"m{unit}": 1e-3 for unit in _NEWTON_METRES}
    | {"kNm": 1e3, "Ncm": 1e-2, "Nmm": 1e-3, "N mm": 1e-3, "N": 1.0},
    "i": {"A": 1.0, "mA": 1e-3},
}
"""SI units in one of the units that a column of a kind may be in; capitals do not matter."""
_FACTORS = {kind: {unit.casefold(): factor for unit, factor in units.items()} for kind, units in UNITS.items()}
_BRACKETED = re.compile(r"(?P<name>.*?)\s*(?:\[(?P<square>[^][]+)\]|\((?P<round>[^()]+)\))")
_NUMBER = re.compile(r"[0-9]+|\{[^}]*\}")
_COUNT = re.compile(rf"(?P<count>[0-9]{{1,{MOST_DIGITS}}}(?:\.[0-9]+)?)\s*(?P<unit>[^0-9]+)")


_POSITIONS = "q", "actual q", "joint", "axis", "position", "pos", "angle", "joint position", "joint pos", "joint angle"
_VELOCITIES = "dq", "qd", "actual qd", "velocity", "vel", "speed", "joint velocity", "joint vel", "joint speed"
_TORQUES = "tau", "tau j", "torque", "effort", "moment", "joint torque", "joint effort", "actual torque", "drehmoment"
_CURRENTS = "i", "current", "actual current", "joint current", "motor current", "strom", "motorstrom"
_SIMULATED = {
    "t": ("sim time",),
    "q": ("joint positions", "dof pos", "dof position", "qpos"),
    "dq": ("joint velocities", "dof vel", "dof velocity", "qvel"),
    "tau": ("applied torque", "joint torques", "joint efforts", "measured joint efforts", "dof torque", "dof force"),
}
"""What simulators write: Isaac Lab (`joint_pos`, `applied_torque`, which is behind its actuator model's limits), Isaac
Sim, Isaac Gym, MuJoCo."""
_GERMAN = {
    "t": ("zeit", "zeitstempel"),
    "q": ("achse", "achswinkel", "gelenk", "gelenkwinkel", "winkel", "istposition", "ist position"),
    "dq": ("geschwindigkeit", "istgeschwindigkeit"),
    "tau": ("drehmoment", "istmoment"),
    "i": ("strom", "motorstrom", "iststrom"),
}
"""Those of KUKA's trace are among them (`Istposition`, `Istmoment`, `Iststrom`)."""
_USUAL = {
    "t": ("t", "time", "timestamp", "stamp"),
    "q": (*_POSITIONS, "actual position"),
    "dq": (*_VELOCITIES, "actual velocity"),
    "tau": (*_TORQUES, "actual current as torque"),
    "i": (*_CURRENTS, "torque ref"),
}
"""`torque ref` is ABB's TestSignal: the motor's torque, which a gear ratio for gain turns into the joint's."""
WORDS = {kind: (*words, *_SIMULATED.get(kind, ()), *_GERMAN[kind]) for kind, words in _USUAL.items()}
"""What columns of a kind are called in logs of UR (RTDE's `actual_q_0`), Franka (libfranka's `tau_J`), ROS, MATLAB,
simulators, and in German, beside a joint's number; of currents and torques only what is measured. Spaces stand for any
separator. What whole recorders write, units and all, is in `bayesid.log.formats.conventions`."""
_KIND_OF = {word.replace(" ", ""): kind for kind, words in WORDS.items() for word in words}
_OWN = re.compile(r"t|(?:q|dq|tau|i)[1-9][0-9]*")
_JOINT_ZERO = re.compile(r"(?:q|dq|tau|i)0")
OTHER = 3
"""Rank of what is not called as in a CSV log."""
_AXIS_LETTER = re.compile(r"(?<=[\W_])[AJaj](?=[0-9]+\W*$)")
"""A letter before a joint's number that says no more, as in `Torque_A1` or `pos.j1`."""
_LAST_NUMBER = re.compile(rf"[0-9]{{1,{MOST_DIGITS}}}(?=[^0-9]*$)")


class Label(NamedTuple):
    """A name and what is said of its unit, if anything is."""

    name: str
    unit: str | None


def factor_of(kind: str, unit: str) -> float | None:
    """SI units in one of a unit of a kind; None where it is none of it. A time may be in "8 ms", which counts rows."""
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
    match = None if len(label) > TUNING.longest_label else _BRACKETED.fullmatch(label)
    unit = None if match is None else match["square"] or match["round"]
    if match is None or unit is None or not match["name"] or _NUMBER.fullmatch(unit.strip()):
        return Label(label, None)
    return Label(match["name"], unit.strip())


@dataclass(frozen=True)
class Reading:
    """What a column's label says.

    Attributes:
        place: of the column, from 0.
        label: of the column.
        kind: "t", "q", "dq", "tau" or "i".
        word: by which the kind is known, in small letters and without separators.
        number: of the joint, as the label has it; -1 of a time.
        rank: 0 for a name of a CSV log, 1 for one with a unit, 2 for a joint 0, `OTHER` for all others.
        factor: SI units in one of the unit, if one is stated.
    """

    place: int
    label: str
    kind: str
    word: str
    number: int
    rank: int
    factor: float | None


def read_labels(header: Sequence[str]) -> list[Reading]:
    """What the labels say that are of a log."""
    readings = (_reading(place, label) for place, label in enumerate(header) if len(label) <= TUNING.longest_label)
    return [reading for reading in readings if reading is not None]


def has_positions(header: Sequence[str]) -> bool:
    """Whether a file holds joint positions by the names of a CSV log."""
    return any(reading.kind == "q" and reading.rank <= 1 for reading in read_labels(header))


def has_any_positions(labels: Sequence[str]) -> bool:
    """Whether labels, or names of variables that hold all joints, are those of joint positions by any usual name."""
    return any(reading.kind == "q" for reading in read_labels(labels)) or "q" in map(kind_of, labels)


def time_among(labels: Sequence[str]) -> str | None:
    """The label of the time, by its own name or else by another one; None where there is none, or more than one."""
    times = [reading for reading in read_labels(labels) if reading.kind == "t"]
    best = [reading for reading in times if reading.rank == min(one.rank for one in times)]
    return best[0].label if len(best) == 1 else None


def kind_of(label: str) -> str | None:
    """What a variable holds, of all joints, by its name without a number; None if it is none of a log's."""
    return _KIND_OF.get(_plain(split_brackets(label).name))


def kind_at_end(label: str) -> str | None:
    """What a column holds by its last word, before which the joint's own name may stand: `elbow/position`."""
    return _KIND_OF.get(_plain(last_word(label)))


def last_word(label: str) -> str:
    """The last word of a label, without its unit."""
    return re.split(r"[/._ ]", split_brackets(label).name)[-1]


def unknown_unit(label: str) -> tuple[str, str] | None:
    """The kind of a column and its unit, where only the unit is not known; None of all others."""
    name, unit = split_brackets(label)
    reading = None if unit is None else _with_unit(0, label, name, None)
    return (
        None if unit is None or reading is None or factor_of(reading.kind, unit) is not None else (reading.kind, unit)
    )


def pattern_of(label: str) -> str:
    """A label with {} in place of its last number, as for `--columns`."""
    number = _LAST_NUMBER.search(split_brackets(label).name)
    return label if number is None else f"{label[: number.start()]}{{}}{label[number.end() :]}"


def raised(label: str, number: int) -> str:
    """A label with its last number raised by another one; the same where it has none."""
    found = _LAST_NUMBER.search(split_brackets(label).name)
    return label if found is None else f"{label[: found.start()]}{int(found[0]) + number}{label[found.end() :]}"


def kind_part(name: str) -> str:
    """The kind in the name of a log's column: q of q1."""
    return name.rstrip("0123456789")


def _reading(place: int, label: str) -> Reading | None:
    """What a label says, its unit in brackets, or behind a "_"; None if it is none of a log's, or its unit unknown."""
    name, unit = split_brackets(label)
    paths = [name[match.end() :] for match in re.finditer("[/.]", name)]  # of topics: the shortest end that says it
    if unit is not None:
        stated = (_with_unit(place, label, one, unit, any_current=True) for one in (name, *reversed(paths)))
        return next((reading for reading in stated if reading is not None), None)
    ends = [match.start() for match in re.finditer("_", label)]
    tailed = (_with_unit(place, label, label[:end], label[end + 1 :]) for end in ends)
    whole = (_with_unit(place, label, name, None) for name in (label, *reversed(paths)))
    return next((reading for reading in (*whole, *tailed) if reading is not None), None)


def _with_unit(place: int, label: str, name: str, unit: str | None, any_current: bool = False) -> Reading | None:
    numbers = [whole_number(digits) for digits in re.findall("[0-9]+", name)]
    word = _plain(re.sub("[0-9]+", "", _AXIS_LETTER.sub("", name)))
    kind = _KIND_OF.get(word)
    if kind is None or len(numbers) != (kind != "t") or name == "T":  # which is a temperature
        return None
    number = numbers[0] if numbers else -1
    if number is None or number > TUNING.most_joints:
        return None
    factor = None if unit is None else factor_of(kind, unit)
    if unit is not None and factor is None:
        if kind != "i" or not any_current:
            return None
        factor = 1.0  # gains turn any unit of currents into N m
    rank = (1 if unit is not None else 0) if _OWN.fullmatch(name) else 2 if _JOINT_ZERO.fullmatch(name) else OTHER
    rank = rank if label.startswith(name) else OTHER  # the end of a topic is no name of a CSV log
    return Reading(place, label, kind, word, number, rank, factor)


def _plain(name: str) -> str:
    return re.sub(r"[\W_]+", "", name).casefold()
