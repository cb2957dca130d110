"""Labels of columns: the names `t,q1..qn,dq1..,tau1..,i1..` of a log, and other usual names.

`q1[deg]`, `q1 (deg)` and `q1_deg` are q1 in degrees.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
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
    "t": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "sec": 1.0, "msec": 1e-3, "usec": 1e-6}
    | {"\N{MICRO SIGN}s": 1e-6, "\N{GREEK SMALL LETTER MU}s": 1e-6, "min": 60.0},
    "q": _ANGLES | _LENGTHS,
    "dq": {f"{angle}{per}": factor for per in ("/s", "_s", "", "/sec") for angle, factor in _ANGLES.items()}
    | {"rpm": 6.0 * DEGREE, "1/min": 6.0 * DEGREE, "U/min": 6.0 * DEGREE}
    | {f"{length}/s": factor for length, factor in _LENGTHS.items()},
    "tau": _NEWTON_METRES
    | {f"m{unit}": 1e-3 for unit in _NEWTON_METRES}
    | {"kNm": 1e3, "Ncm": 1e-2, "Nmm": 1e-3, "N mm": 1e-3, "N": 1.0},
    "i": {"A": 1.0, "mA": 1e-3},
}  # SI value of each accepted unit of a kind; case is ignored
_FACTORS = {kind: {unit.casefold(): factor for unit, factor in units.items()} for kind, units in UNITS.items()}
_BRACKETED = re.compile(r"(?P<name>.*?)\s*(?:\[(?P<square>[^][]+)\]|\((?P<round>[^()]+)\))")
_NUMBER = re.compile(r"[0-9]+|\{[^}]*\}")
_COUNT = re.compile(rf"(?P<count>[0-9]{{1,{MOST_DIGITS}}}(?:\.[0-9]+)?)\s*(?P<unit>[^0-9]+)")
WORDS = {
    "t": "t time timestamp stamp sim_time zeit zeitstempel ipoc",
    "q": "q actual_q joint axis position pos angle joint_position joint_pos joint_angle actual_position "
    "joint_positions dof_pos dof_position qpos achse achswinkel gelenk gelenkwinkel winkel istposition "
    "ist_position aipos aspos axispos achspos theta",
    "dq": "dq qd actual_qd velocity vel speed joint_velocity joint_vel joint_speed axisvel actual_velocity "
    "joint_velocities dof_vel dof_velocity qvel geschwindigkeit istgeschwindigkeit",
    "tau": "tau tau_j torque effort moment joint_torque joint_effort actual_torque drehmoment actual_current_as_torque "
    "applied_torque joint_torques joint_efforts measured_joint_efforts dof_torque dof_force istmoment gear_torque "
    "axis_torque",
    "i": "i current actual_current joint_current presentload motor_current strom motorstrom iststrom torque_ref macur",
}
"""Usual names of columns, beside a joint number, in logs of UR (RTDE's `actual_q_0`), Franka (libfranka's `tau_J`),
ROS, MATLAB, simulators (Isaac Lab's `applied_torque` includes actuator limits), ABB's TestSignal (`torque_ref` of the
motor; the gear ratio is its gain), KUKA's trace (`Istposition`) and RSI (`AIPos.A1`, `IPOC`), and in German. Only
measured currents and torques are listed. A _ stands for any separator. `bayesid.log.formats.stated` lists whole
recorders with their units."""
_MEASURED = r"(?:ist(?:wert)?|actual|act|meas|measured|present|feedback|fbk|real|mess(?:wert)?|sensed)"
_QUALIFIED = re.compile(rf"(?:{_MEASURED})?(?P<of>[a-z]+?)(?:{_MEASURED})?")
"""A usual name may begin or end with a word for measured, as `PosIst`, `present_position` or `q_meas`."""
_DESIRED = re.compile(
    r"(?<![^\W_])(target|cmd|commands?|commanded|desired?|des|setpoints?|soll(wert)?|ref(erences?)?|goals?|demand(ed)?|"
    r"planned|plan|dmd|(d{0,2}(q|theta)|tau|tau_?j|[vai])_d)(?![^\W_])",
    re.IGNORECASE,
)
"""Desired values, not measured ones: words of many makers, and `_d` after a symbol, as libfranka's `tau_J_d`."""
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_KIND_OF = {word.replace("_", ""): kind for kind, words in WORDS.items() for word in words.split()}
_OWN_UNITS = {"ipoc": 1e-3, "axisvel": DEGREE} | dict.fromkeys(("aipos", "aspos", "a", "axispos", "posist"), DEGREE)
"""SI value of the unit of RSI's columns, used if the label states none."""
_OWN = re.compile(r"t|(?:q|dq|tau|i)[1-9][0-9]*")
_JOINT_ZERO = re.compile(r"(?:q|dq|tau|i)0")
OTHER = 3  # lowest rank of names other than those of a CSV log
_USUAL, _QUALIFIED_RANK, _RANKS = 4, 5, {"ipoc": OTHER, "aipos": OTHER, "a": 5, "aspos": 6}
"""Ranks of other words: RSI's come before the usual ones; plain axes and commanded positions come after them."""
BY_HEADING = 7
"""Rank of a heading that states quantity, joint and unit, as "Drehmoment Achse 1 [Nm]"; it comes last."""
_JOINT_WORDS = re.compile(
    r"\b(?:(?:of|at|in|der|an|von)\s+)?(?:(?:axis|joint|achse|gelenk)(?:\s+|(?=[0-9])))", re.IGNORECASE
)
"""A word for a joint, perhaps after a preposition, and before other words or the joint's number."""
_AXIS = re.compile("A[1-9]", re.IGNORECASE)  # a position of RSI
_AXIS_LETTER = re.compile(r"(?<=[\W_])[AJaj](?=[0-9]+\W*$)|(?i:((?<=pos)|(?<=vel)|(?<=torque)|(?<=macur))A(?=[0-9]+$))")
"""A letter before a joint's number without meaning, as in `Torque_A1`, `pos.j1` or `AIPosA1`."""
_PREFIX = re.compile("[/.]|[_ ](?=(?:AIPos|ASPos|AxisVel|GearTorque|AxisTorque|MACur|IPOC))", re.IGNORECASE)
"""End of a prefix before a name."""
_LAST_NUMBER = re.compile(rf"[0-9]{{1,{MOST_DIGITS}}}(?=[^0-9]*$)")


def factor_of(kind: str, unit: str) -> float | None:
    """SI value of a unit of a kind; None if it is not one. A time may be in "8 ms", which counts rows."""
    count = _COUNT.fullmatch(unit.strip()) if kind == "t" else None
    factor = _FACTORS[kind].get((unit if count is None else count["unit"]).strip().casefold())
    return factor if factor is None or count is None else float(count["count"]) * factor


def is_desired(label: str) -> bool:
    """Whether a column holds desired values, as `q_d[0]` or `target_q_0`, instead of measured ones."""
    spaced = re.sub("[0-9]+", "", _CAMEL.sub("_", label))
    return _DESIRED.search(spaced) is not None and "torqueref" not in _plain(spaced)  # ABB's name for a measured torque


def is_measured(label: str) -> bool:
    """Whether a label has a word for measured, as `actual_q_1`."""
    words = re.split(r"[\W_]+", _CAMEL.sub("_", split_brackets(label).name).casefold())
    return any(re.fullmatch(_MEASURED, word) for word in words)


def _kind_of_word(word: str) -> str | None:
    """The kind of a word without separators, perhaps with a word for measured."""
    if word in _KIND_OF:
        return _KIND_OF[word]
    found = _QUALIFIED.fullmatch(word)
    return None if found is None else _KIND_OF.get(found["of"])


def _quantity(name: str) -> str:
    """A heading without its word for a joint: "Drehmoment 1" of "Drehmoment Achse 1"; unchanged if there is not one."""
    shorter, count = _JOINT_WORDS.subn("", re.sub(r"[\s_]+", " ", name))
    return shorter if count == 1 else name


def is_unit(text: str) -> bool:
    """Whether a text is the unit of a log column."""
    return any(text.strip().casefold() in units for units in _FACTORS.values())


class Label(NamedTuple):
    """A name and its unit, if stated."""

    name: str
    unit: str | None


def split_brackets(label: str) -> Label:
    """A label without its unit in brackets: "q1 [deg]" is q1 in "deg", but "q[1]" and "q[{}]" have none."""
    match = None if len(label) > TUNING.longest_label else _BRACKETED.fullmatch(label)
    unit = None if match is None else match["square"] or match["round"]
    if match is None or unit is None or not match["name"] or _NUMBER.fullmatch(unit.strip()):
        return Label(label, None)
    return Label(match["name"], unit.strip())


def slides(label: str) -> bool:
    """Whether a position has a unit of length: its joint is prismatic."""
    unit = split_brackets(label).unit
    return unit is not None and unit.strip().casefold() in map(str.casefold, _LENGTHS)


class Reading(NamedTuple):
    """The meaning of a column's label."""

    place: int  #: index of the column, from 0
    label: str  #: of the column
    kind: str  #: "t", "q", "dq", "tau" or "i"
    word: str  #: that determines the kind, in lower case and without separators
    prefix: str  #: text before the word, such as a topic
    number: int  #: number of the joint in the label; -1 for a time
    #: 0 for a name of a CSV log, 1 for one with a unit, 2 for a joint 0, `OTHER` and more for others; the lowest rank
    #: is used
    rank: int
    factor: float | None  #: SI value of the unit, if stated


def read_labels(header: Sequence[str]) -> list[Reading]:
    """The labels that name a log's columns."""
    readings = (_reading(place, label) for place, label in enumerate(header) if len(label) <= TUNING.longest_label)
    return [reading for reading in readings if reading is not None]


def time_among(labels: Sequence[str]) -> str | None:
    """The label of the time, by its own name or by another one; None if there is none, or more than one."""
    times = [reading for reading in read_labels(labels) if reading.kind == "t"]
    best = [reading for reading in times if reading.rank == min(time.rank for time in times)]
    return best[0].label if len(best) == 1 else None


def kind_of(label: str) -> str | None:
    """The kind of a variable of all joints, by its name without a number; None if unknown."""
    return None if is_desired(label) else _kind_of_word(_plain(split_brackets(label).name))


def kind_at_end(label: str) -> str | None:
    """The kind of a column by its last word, perhaps after a joint's name: `elbow/position`."""
    return None if is_desired(label) else _kind_of_word(_plain(last_word(label)))


def last_word(label: str) -> str:
    """The last word of a label, without its unit."""
    return re.split(r"[/._ ]", split_brackets(label).name)[-1]


def unknown_unit(label: str, kind: str) -> str | None:
    """The unit of a column of a kind if only the unit is unknown, else None."""
    name, unit = split_brackets(label)
    reading = None if unit is None else _with_unit(0, label, name, None)
    return None if reading is None or reading.kind != kind or factor_of(kind, unit or "") is not None else unit


def pattern_of(label: str) -> str:
    """A label with {} instead of its last number, as for `--columns`."""
    number = _LAST_NUMBER.search(split_brackets(label).name)
    return label if number is None else f"{label[: number.start()]}{{}}{label[number.end() :]}"


def kind_part(name: str) -> str:
    """The kind in a column's name: q for q1."""
    return name.rstrip("0123456789")


def _reading(place: int, label: str) -> Reading | None:
    """Meaning of a label, with its unit in brackets or after a "_"; None if unknown."""
    if is_desired(label):
        return None
    name, unit = split_brackets(label)
    paths = [
        name[match.end() :] for match in _PREFIX.finditer(name)
    ]  # of topics: the shortest ending that has a meaning
    names = [(path, unit) for path in (name, *reversed(paths))]
    if unit is None:
        names += [(label[: match.start()], label[match.end() :]) for match in re.finditer("_", label)]
    readings = (_with_unit(place, label, *pair, any_current=unit is not None) for pair in names)
    found = next((reading for reading in readings if reading is not None), None)
    return _by_heading(place, label) if found is None else found


def _by_heading(place: int, label: str) -> Reading | None:
    """Meaning of a label with a quantity, a word for a joint, its number and a unit of the quantity, else None."""
    name, unit = split_brackets(label)
    shorter = _quantity(name)
    if unit is None or shorter == name:
        return None
    found = _with_unit(place, shorter, shorter, unit)
    return None if found is None or found.kind == "t" else found._replace(label=label, prefix="", rank=BY_HEADING)


def _with_unit(place: int, label: str, name: str, unit: str | None, any_current: bool = False) -> Reading | None:
    numbers = [whole_number(digits) for digits in re.findall("[0-9]+", name)]
    word = _plain(re.sub("[0-9]+", "", _AXIS_LETTER.sub("", name)))
    whole = label.startswith(name)  # the end of a topic is not a name of a CSV log
    kind = "q" if whole and _AXIS.fullmatch(name) else _kind_of_word(word)
    if kind is None or len(numbers) != (kind != "t") or name == "T":  # T is a temperature
        return None
    number = numbers[0] if numbers else -1
    if number is None:
        return None
    factor = _OWN_UNITS.get(word) if unit is None else factor_of(kind, unit)
    if unit is not None and factor is None:
        if kind != "i" or not any_current:
            return None
        factor = 1.0  # gains turn any unit of currents into N m
    rank = _RANKS.get(word, _USUAL if word in _KIND_OF else _QUALIFIED_RANK)
    if whole and _OWN.fullmatch(name):
        rank = 0 if unit is None else 1
    elif whole and _JOINT_ZERO.fullmatch(name):
        rank = 2
    prefix = label[: label.rindex(name)]
    return Reading(place, label, kind, word, prefix, number, rank, factor)


def _plain(name: str) -> str:
    return re.sub(r"[\W_]+", "", name).casefold()
