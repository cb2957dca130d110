"""The names of a log's columns: `t,q1..qn[,dq1..dqn],tau1..taun`, or `i1..in`, each perhaps with its unit.

`q1[deg]`, `q1 (deg)` and `q1_deg` are q1 in degrees, where no column is called q1 and nothing more. Where these names
make no whole log, the usual other ones count too (`WORDS`), and joints may be numbered from 0.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass

from bayesid.errors import InputError
from bayesid.log.formats.stated import OPTION, stated_columns
from bayesid.log.formats.table import SourceColumn
from bayesid.log.formats.units import factor_of, split_brackets

_POSITIONS = "q", "actual q", "joint", "axis", "position", "pos", "angle", "joint position", "joint pos", "joint angle"
_VELOCITIES = "dq", "qd", "actual qd", "velocity", "vel", "speed", "joint velocity", "joint vel", "joint speed"
_TORQUES = "tau", "tau j", "torque", "effort", "moment", "joint torque", "joint effort", "actual torque", "drehmoment"
_CURRENTS = "i", "current", "actual current", "joint current", "motor current", "strom", "motorstrom"
WORDS = {
    "t": ("t", "time", "timestamp", "zeit", "zeitstempel"),
    "q": (*_POSITIONS, "actual position", "achse", "achswinkel", "gelenk", "gelenkwinkel", "winkel"),
    "dq": (*_VELOCITIES, "actual velocity", "geschwindigkeit"),
    "tau": _TORQUES,
    "i": _CURRENTS,
}
"""What columns of a kind are called in logs of UR (RTDE's `actual_q_0`), Franka (libfranka's `tau_J`), ROS, MATLAB, and
in German, beside a joint's number; of currents and torques only what is measured. Spaces stand for any separator."""
_KIND_OF = {word.replace(" ", ""): kind for kind, words in WORDS.items() for word in words}
_OWN = re.compile(r"t|(?:q|dq|tau|i)[1-9]\d*")
_FROM_ZERO = re.compile(r"(?:q|dq|tau|i)(?:0|[1-9]\d*)")
_OTHER = 3
"""Rank of what is not called as in a CSV log."""
_LAST_NUMBER = re.compile(r"\d+(?=\D*$)")
_SEVERAL = 2
"""Columns that differ by a number only, and may so be those of the joints, from this many on."""
_SHOWN = 20
"""Names of a header that a message shows, those that differ by their numbers as one."""


@dataclass(frozen=True)
class _Reading:
    """What a column's label says.

    Attributes:
        place: of the column, from 0.
        label: of the column.
        kind: "t", "q", "dq", "tau" or "i".
        word: by which the kind is known, in small letters and without separators.
        number: of the joint, as the label has it; -1 of a time.
        rank: 0 for a name of a CSV log, 1 for one with a unit, 2 for a joint 0, `_OTHER` for all others.
        factor: SI units in one of the unit, if one is stated.
    """

    place: int
    label: str
    kind: str
    word: str
    number: int
    rank: int
    factor: float | None


def choose(header: Sequence[str], where: str, columns: Mapping[str, str] | None = None) -> tuple[SourceColumn, ...]:
    """The columns that make a log: the time; for every joint its position, effort and, if measured, velocity.

    Args:
        header: the names of a file's columns; those that are not of a log are left out.
        where: the header's place, for messages.
        columns: those that a user has named, see `bayesid.log.formats.stated`; the others go by their own names.

    Raises:
        InputError: a column is missing or appears twice, or which is meant stays open.
    """
    stated = stated_columns(header, columns, where, described(header)) if columns else []
    kinds, taken = {_kind(source.name) for source in stated}, {source.place for source in stated}
    kinds |= {"tau", "i"} if kinds & {"tau", "i"} else set()
    readings = [reading for reading in _read(header) if reading.place not in taken and reading.kind not in kinds]
    families = _families(readings, kinds, where)
    _check_start(families, where)
    chosen = [*stated, *(_source(one, family) for family in families for one in family.values())]
    return _complete({source.name: source for source in chosen}, header, where)


def has_positions(header: Sequence[str]) -> bool:
    """Whether a file holds joint positions by the names of a CSV log."""
    return any(reading.kind == "q" and reading.rank <= 1 for reading in _read(header))


def has_any_positions(labels: Sequence[str]) -> bool:
    """Whether labels, or names of variables that hold all joints, are those of joint positions by any usual name."""
    return any(reading.kind == "q" for reading in _read(labels)) or "q" in map(kind_of, labels)


def time_among(labels: Sequence[str]) -> str | None:
    """The label of the time, by its own name or else by another one; None where there is none, or more than one."""
    times = [reading for reading in _read(labels) if reading.kind == "t"]
    best = [reading for reading in times if reading.rank == min(one.rank for one in times)]
    return best[0].label if len(best) == 1 else None


def kind_of(label: str) -> str | None:
    """What a variable holds, of all joints, by its name without a number; None if it is none of a log's."""
    return _KIND_OF.get(_plain(split_brackets(label).name))


# ---------------------------------------------------------------------------------------------------------------
# What labels say
# ---------------------------------------------------------------------------------------------------------------
def _read(header: Sequence[str]) -> list[_Reading]:
    return [reading for place, label in enumerate(header) if (reading := _reading(place, label)) is not None]


def _reading(place: int, label: str) -> _Reading | None:
    """What a label says, its unit in brackets, or behind a "_"; None if it is none of a log's, or its unit unknown."""
    name, unit = split_brackets(label)
    if unit is not None:
        return _with_unit(place, label, name, unit, any_current=True)
    ends = [match.start() for match in re.finditer("_", label)]
    tailed = (_with_unit(place, label, label[:end], label[end + 1 :]) for end in ends)
    return _with_unit(place, label, label, None) or next((reading for reading in tailed if reading is not None), None)


def _with_unit(place: int, label: str, name: str, unit: str | None, any_current: bool = False) -> _Reading | None:
    numbers = re.findall(r"\d+", name)
    word = _plain(re.sub(r"\d+", "", name))
    kind = _KIND_OF.get(word)
    if kind is None or len(numbers) != (kind != "t") or name == "T":  # which is a temperature
        return None
    factor = None if unit is None else factor_of(kind, unit)
    if unit is not None and factor is None:
        if kind != "i" or not any_current:
            return None
        factor = 1.0  # gains turn any unit of currents into N m
    own = 1 if unit is not None else 0
    rank = own if _OWN.fullmatch(name) else 2 if _FROM_ZERO.fullmatch(name) else _OTHER
    return _Reading(place, label, kind, word, int(numbers[0]) if numbers else -1, rank, factor)


def _plain(name: str) -> str:
    """A name in small letters, without what separates its words."""
    return re.sub(r"[\W_]+", "", name).casefold()


def _kind(name: str) -> str:
    return name.rstrip("0123456789")


# ---------------------------------------------------------------------------------------------------------------
# Which columns
# ---------------------------------------------------------------------------------------------------------------
_Family = Mapping[int, _Reading]
"""Columns of one kind that are called alike, by the numbers in their labels."""


def _families(readings: Sequence[_Reading], stated: Set[str], where: str) -> list[_Family]:
    """Of each kind that a log needs, and that nobody has stated, the columns to be used.

    Those with a log's own names come first, and where these make a whole log no others are looked at.
    """
    own = {kind: _own_family(readings, kind, where) for kind in WORDS}
    effort = next((kind for kind in ("tau", "i") if own[kind]), None)
    if not stated and own["t"] and own["q"] and effort is not None:
        return [own[kind] for kind in ("t", "q", effort, "dq") if own[kind]]
    needed = [kind for kind in ("t", "q", "dq") if kind not in stated]
    found = [own[kind] or _other_family(readings, kind, where) for kind in needed]
    if effort is not None:
        found.append(own[effort])
    elif "tau" not in stated:
        found.append(_other_family(readings, "tau", where) or _other_family(readings, "i", where))
    return [family for family in found if family]


def _own_family(readings: Sequence[_Reading], kind: str, where: str) -> _Family:
    """The columns named as in a CSV log; those with a unit after their name count where no other has the name."""
    own = [one for one in readings if one.kind == kind and one.rank < _OTHER]
    plain = {one.number for one in own if one.rank == 0}
    family: dict[int, _Reading] = {}
    for one in sorted(own, key=lambda one: one.rank):
        if one.rank == 1 and one.number in plain:
            continue
        if one.number in family:
            said = f"column {kind if kind == 't' else f'{kind}{one.number}'} appears twice"
            raise InputError(said, where, "give every column its own name")
        family[one.number] = one
    return family


def _other_family(readings: Sequence[_Reading], kind: str, where: str) -> _Family:
    """The columns of a kind that go by one other word; empty if there are none."""
    families: dict[str, dict[int, _Reading]] = {}
    for one in readings:
        if one.kind == kind and one.rank == _OTHER:
            family = families.setdefault(one.word, {})
            if one.number in family:
                raise _either(family[one.number], one, where)
            family[one.number] = one
    if len(families) > 1:
        first, second, *_ = families.values()
        raise _either(next(iter(first.values())), next(iter(second.values())), where)
    return next(iter(families.values()), {})


def _either(first: _Reading, second: _Reading, where: str) -> InputError:
    said = f"columns {first.label} and {second.label} may both be {'the time' if first.kind == 't' else first.kind}"
    return InputError(said, where, f'say which with {OPTION} {first.kind}="{pattern_of(first.label)}"')


def _check_start(families: Sequence[_Family], where: str) -> None:
    """Joints are numbered from 0 or from 1, alike in positions, velocities and efforts."""
    numbered = [family for family in families if -1 not in family]
    from_zero = [family for family in numbered if 0 in family]
    if not from_zero or len(from_zero) == len(numbered):
        return
    from_one = [family for family in numbered if 0 not in family]
    n = min(max(family) for family in from_one)
    ranges = ",".join(f'{_kind_of(family)}="{_ranged(family, n)}"' for family in numbered)
    said = f"{_span(from_zero[0])} count from 0, {_span(from_one[0])} from 1"
    raise InputError(said, where, f"say which belong together with {OPTION}, as in {ranges}")


def _kind_of(family: _Family) -> str:
    return next(iter(family.values())).kind


def _span(family: _Family) -> str:
    """The first and the last label."""
    return f"{family[min(family)].label}..{family[max(family)].label}"


def _ranged(family: _Family, last: int) -> str:
    """A pattern of the columns from 1 to the last."""
    return pattern_of(family[max(family)].label).replace("{}", f"{{1-{last}}}")


def _source(one: _Reading, family: _Family) -> SourceColumn:
    """A column under its log's name, joints counted from 1."""
    joint = "" if one.kind == "t" else str(one.number + (0 in family))
    return SourceColumn(f"{one.kind}{joint}", one.place, one.label, one.factor)


# ---------------------------------------------------------------------------------------------------------------
# What is missing
# ---------------------------------------------------------------------------------------------------------------
def _complete(found: Mapping[str, SourceColumn], header: Sequence[str], where: str) -> tuple[SourceColumn, ...]:
    """The columns of a log, in order, if none is missing."""
    n, effort = _highest("q", found), "tau" if _highest("tau", found) else "i"
    absent = {"column t": "t" not in found, "column q1": n == 0}
    absent["column tau1 (or i1 with gains)"] = not _highest(effort, found)
    for said in (said for said, is_absent in absent.items() if is_absent):
        said = f"{said} is missing{described(header, found)}"
        raise InputError(said, where, f"say which columns are meant with {suggestion(header, found)}")
    chosen = [found["t"]]
    for kind in ["q", effort, *(["dq"] if _highest("dq", found) else [])]:
        for j in range(1, n + 1):
            if f"{kind}{j}" not in found:
                there = f"{_label(found, 'q', 1)}..{_label(found, 'q', n)}"
                label = _label(found, kind, j)
                label = f"tau{j} (or {label} with gains)" if label == f"i{j}" else label
                raise InputError(f"column {label} is missing", where, f"add it; {there} are there")
            chosen.append(found[f"{kind}{j}"])
        if _highest(kind, found) > n:
            extra = next(source for name, source in found.items() if _kind(name) == kind and _joint(name) > n)
            remedy = "give q and effort columns for the same joints"
            raise InputError(f"column {extra.label} has no q beside it", where, remedy)
    return tuple(chosen)


def _highest(kind: str, names: Mapping[str, SourceColumn]) -> int:
    """The highest joint of which there is a column of a kind."""
    return max((_joint(name) for name in names if name != "t" and _kind(name) == kind), default=0)


def _joint(name: str) -> int:
    return int(name.removeprefix(_kind(name)))


def _label(found: Mapping[str, SourceColumn], kind: str, joint: int) -> str:
    """What the file calls a joint's column, or would call it, by the columns beside it."""
    if f"{kind}{joint}" in found:
        return found[f"{kind}{joint}"].label
    beside = next(name for name in found if _kind(name) == kind)
    label = found[beside].label
    number = _LAST_NUMBER.search(split_brackets(label).name)
    if number is None:
        return f"{kind}{joint}"
    return f"{label[: number.start()]}{int(number[0]) + joint - _joint(beside)}{label[number.end() :]}"


def pattern_of(label: str) -> str:
    """A label with {} in place of its last number, as for `--columns`."""
    number = _LAST_NUMBER.search(split_brackets(label).name)
    return label if number is None else f"{label[: number.start()]}{{}}{label[number.end() :]}"


def described(header: Sequence[str], found: Mapping[str, SourceColumn] | None = None) -> str:
    """The columns of a header, those that differ by a number as one, and what each is taken for where that is known."""
    kinds = {} if found is None else {source.label: _kind(source.name) for source in found.values()}
    patterns = {pattern_of(label): kinds.get(label, "not used") for label in reversed(header) if label}
    shown = [pattern if found is None else f"{pattern} ({kind})" for pattern, kind in patterns.items()][::-1]
    return f" among {', '.join(shown[:_SHOWN])}{' and others' if len(shown) > _SHOWN else ''}"


def suggestion(header: Sequence[str], found: Mapping[str, SourceColumn]) -> str:
    """The option that names the columns of a log: those found and, for those missing, what might be meant."""
    members: dict[str, list[str]] = {}
    for label in header:
        members.setdefault(pattern_of(label) if label else "", []).append(label)
    used = {pattern_of(source.label): _kind(source.name) for source in found.values()}
    open_ones = [pattern for pattern in members if pattern and pattern not in used]
    effort = next((kind for kind in ("tau", "i") if _highest(kind, found)), None)
    parts = []
    for kinds in (("t",), ("q",), ("tau", "i") if effort is None else (effort,)):
        known = [(kind, pattern) for pattern, kind in used.items() if kind in kinds]
        alone = kinds == ("t",)
        fitting = [one for one in open_ones if (len(members[one]) < _SEVERAL) == alone]
        kind, pattern = (known or _likely(kinds, fitting) or [(kinds[0], "NAME" if alone else "NAME{}")])[0]
        open_ones = [one for one in open_ones if one != pattern]
        parts.append(f'{kind}="{pattern}"')
    return f"{OPTION} {','.join(parts)}"


def _likely(kinds: Sequence[str], patterns: Sequence[str]) -> list[tuple[str, str]]:
    """Which pattern may be of which kind: those with a unit of it first, then those without any."""
    units = {pattern: split_brackets(pattern).unit for pattern in patterns}
    stated = [(kind, one) for kind in kinds for one, unit in units.items() if unit and factor_of(kind, unit)]
    return stated + [(kinds[0], one) for one, unit in units.items() if unit is None]
