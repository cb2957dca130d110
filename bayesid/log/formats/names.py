"""Columns that make a log: `t,q1..qn[,dq1..dqn],tau1..taun`, or `i1..in`, each perhaps with its unit.

Names given by the user or known from a recorder come first, then these names, then other usual ones (`WORDS`), with
joints from 0 or from 1. If bayesid's own names make a whole log, no others are used.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import replace

from bayesid.errors import InputError
from bayesid.log.formats.joint_names import ByName, columns_by_name, order_note
from bayesid.log.formats.labels import (
    BY_HEADING,
    OTHER,
    UNITS,
    WORDS,
    Reading,
    factor_of,
    is_measured,
    kind_of,
    kind_part,
    last_word,
    pattern_of,
    read_labels,
    split_brackets,
    time_among,
    unknown_unit,
)
from bayesid.log.formats.stated import (
    EFFORTS,
    OPTION,
    Convention,
    convention_of,
    described,
    fits,
    stated_columns,
    suggestion,
)
from bayesid.log.formats.table import DIRECTION, FRACTION, Chosen, Options, ReadingNote, SourceColumn

_EFFORT = "column tau1 (or i1 with gains)"
_QUANTITY = re.compile(
    r"(?<![a-z])(q|qd|dq|pos|position|angle|vel|velocity|speed|tau|torque|moment|effort|current|state|action)s?(?![a-z])",
    re.IGNORECASE,
)
_FRACTIONS = {"nanosec": 1e-9, "nsec": 1e-9, "nsecs": 1e-9, "nanosecs": 1e-9, "nanoseconds": 1e-9} | dict.fromkeys(
    ("usec", "usecs", "microsec", "microseconds"), 1e-6
)
"""SI value of a column that complements one of whole seconds."""
_DIRECTION = re.compile(
    r"(?<![^\W_0-9])(dir|direction|sign|sgn|signum|richtung|drehrichtung|vorzeichen|polarity)(?![^\W_0-9])",
    re.IGNORECASE,
)
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_Family = Mapping[int, Reading]  # columns of one kind with equal names, by the numbers in their labels


def choose(header: Sequence[str], where: str, options: Options) -> Chosen:
    """Columns of a header that make a log: time, positions, efforts and, if measured, velocities of all joints.

    Columns that the options do not name are found by their own names. InputError if a column is missing, appears twice
    or is ambiguous.
    """
    columns = options.named
    if options.part:
        columns = {key: pattern for key, pattern in columns.items() if fits(kind_part(key), pattern, header)}
    plain_kinds = {reading.kind for reading in read_labels(header) if reading.rank < OTHER}
    convention = None if {"t", "q"} <= plain_kinds and plain_kinds & set(EFFORTS) else convention_of(header)
    if convention is not None:
        columns = convention.stated(header, columns, currents=options.currents, motion=options.motion)
    stated = stated_columns(header, columns, where, described(header)) if columns else []
    found = {column.name: column for column in stated}
    named = _by_name(header, columns, found, where, options)
    found |= {column.name: column for column in named.columns}
    families = [] if named.columns and options.part else _families(header, columns, found, where, options)
    families = [family for family in families if options.velocities or next(iter(family.values())).kind != "dq"]
    found = {name: column for name, column in found.items() if options.velocities or kind_part(name) != "dq"}
    _check_start(families, where)
    _check_measured(families, header, where)
    for reading, zero in ((reading, 0 in family) for family in families for reading in family.values()):
        name = reading.kind if reading.kind == "t" else f"{reading.kind}{reading.number + zero}"
        found.setdefault(name, SourceColumn(name, reading.place, reading.label, reading.factor))
    if named.columns and "t" not in found:
        found |= {column.name: column for column in _time(header)}
    if FRACTION not in found and "t" not in columns:
        found |= {column.name: column for column in _split_time(header, found)}
    notes = (order_note(where, named.names),) if named.assumed else ()
    if options.part:
        part = _part(found, header, where)
        return part._replace(notes=(*part.notes, *notes), joints=named.names)
    chosen = _complete(found, header, where, options, columns, "" if convention is None else convention.lacking)
    if convention is not None and convention.part is not None and convention.part in header:
        chosen += (SourceColumn("part", header.index(convention.part), convention.part, 1.0),)
    chosen += tuple(column for column in found.values() if column.name == FRACTION)
    chosen += _directions(header, chosen)
    words = {reading.word for family in families for reading in family.values() if reading.rank >= OTHER}
    note = _note(header, chosen, convention) if words or convention is not None else ""
    if not note and any(reading.rank == BY_HEADING for family in families for reading in family.values()):
        warnings.warn(f"columns by their headings: {_meanings(chosen)}", ReadingNote, stacklevel=2)
    if "aspos" in words:  # of RSI
        note += f"{'; ' if note else ''}positions are commanded ones (ASPos), which the axes follow with a lag"
    notes = (*((f"{where}: {note}",) if note and not named.columns else ()), *notes)
    return Chosen(chosen, notes, () if named.assumed else named.names)


def _by_name(
    header: Sequence[str], columns: Mapping[str, str], found: Mapping[str, SourceColumn], where: str, options: Options
) -> ByName:
    """Columns named after joints, if neither a log's names nor the user define them."""
    if {"q", *EFFORTS} & {*map(kind_part, found), *map(kind_part, columns)}:
        return ByName()
    positions = [reading for reading in read_labels(header) if reading.kind == "q"]
    if any(reading.rank < OTHER for reading in positions):
        return ByName()
    return columns_by_name(header, where, options, alone=not positions)


def _time(header: Sequence[str]) -> list[SourceColumn]:
    label = time_among(header)
    times = (reading for reading in read_labels(header) if reading.label == label)
    return [SourceColumn("t", time.place, time.label, time.factor) for time in times]


def _split_time(header: Sequence[str], found: Mapping[str, SourceColumn]) -> list[SourceColumn]:
    """Columns of whole seconds and of fractions, if the header has both and no other time."""
    words = {place: last_word(label.replace("_", ".")).casefold() for place, label in enumerate(header)}
    whole = [place for place, word in words.items() if word in ("sec", "secs", "seconds")]
    fractions = [(place, _FRACTIONS[word]) for place, word in words.items() if word in _FRACTIONS]
    if ("t" in found and found["t"].place not in whole) or not whole or not fractions:
        return []
    return [
        SourceColumn("t", whole[0], header[whole[0]], 1.0),
        SourceColumn(FRACTION, fractions[0][0], header[fractions[0][0]], fractions[0][1]),
    ]


def _directions(header: Sequence[str], chosen: Sequence[SourceColumn]) -> tuple[SourceColumn, ...]:
    """Columns with the directions of all joints' efforts, by number; empty if one is missing."""
    efforts = [effort for effort in chosen if kind_part(effort.name) in EFFORTS]
    numbers = [_last_number(effort.label) for effort in efforts]
    found: dict[int, SourceColumn] = {}
    for place, label in enumerate(header):
        if _DIRECTION.search(_CAMEL.sub("_", label)) and (number := _last_number(label)) is not None:
            found.setdefault(number, SourceColumn("", place, label, 1.0))
    if not efforts or None in numbers or not set(numbers) <= set(found):
        return ()
    return tuple(
        replace(found[number], name=f"{DIRECTION}{effort.name.removeprefix(kind_part(effort.name))}")
        for effort, number in zip(efforts, numbers, strict=True)
        if number is not None
    )


def _last_number(label: str) -> int | None:
    digits = re.findall("[0-9]{1,9}", split_brackets(label).name)
    return int(digits[-1]) if digits else None


def _part(found: Mapping[str, SourceColumn], header: Sequence[str], where: str) -> Chosen:
    """Columns of a part of a run: time and anything else; columns without a number belong to one joint."""
    if "t" not in found:
        raise InputError(f"column t is missing{described(header)}", where, f'name it with {OPTION} t="NAME"')
    chosen = list(found.values())
    for kind in WORDS.keys() - set(map(kind_part, found)):
        labels = [label for label in header if kind_of(label) == kind]
        if len(labels) == 1:
            unit = split_brackets(labels[0]).unit
            factor = None if unit is None else factor_of(kind, unit)
            chosen.append(SourceColumn(kind, header.index(labels[0]), labels[0], factor))
    torques = any(kind_part(column.name) == "tau" for column in chosen)
    return Chosen(tuple(column for column in chosen if not (torques and kind_part(column.name) == "i")))


def _note(header: Sequence[str], chosen: Sequence[SourceColumn], convention: Convention | None) -> str:
    """Message about chosen columns; empty if their names are unambiguous."""
    taken = {source.label for source in chosen}
    others = (label for label in header if label not in taken and _QUANTITY.search(label.replace("_", " ")))
    unused = [pattern for pattern, count in Counter(map(pattern_of, others)).items() if count >= 2]
    if convention is None and not unused:
        return ""
    beside = f", not {', '.join(unused[:6])}{' and others' if len(unused) > 6 else ''}" if unused else ""
    by = "" if convention is None else f"as in {convention.name}, "
    remark = f"; {convention.remark}" if convention is not None and convention.remark else ""
    return f"{by}{_meanings(chosen)}{beside}{remark}"


def _meanings(chosen: Sequence[SourceColumn]) -> str:
    """As in "t is Zeit [ms], q is Achse{}"."""
    pairs = ((kind_part(column.name), pattern_of(column.label)) for column in chosen if column.name != "part")
    return ", ".join(f"{kind} is {label}" for kind, label in dict.fromkeys(pairs))


def _families(
    header: Sequence[str], columns: Mapping[str, str], stated: Mapping[str, SourceColumn], where: str, options: Options
) -> list[_Family]:
    """For each needed kind that is not stated as a whole, the columns to use.

    A log's own names come first. If these and the stated ones make a whole log, others are used only for kinds with
    single named joints.
    """
    kinds = set(map(kind_part, stated))
    named = {kind: {_joint(name) for name in stated if kind_part(name) == kind} for kind in kinds - columns.keys()}
    closed = (kinds | (set(EFFORTS) if options.motion or kinds & set(EFFORTS) else set())) - named.keys()
    taken = {source.place for source in stated.values()}
    readings = [reading for reading in read_labels(header) if reading.place not in taken and reading.kind not in closed]
    by_kind = {kind: _plain_family(readings, kind, where) for kind in WORDS}
    by_kind |= {kind: by_kind[kind] or _other_joints(readings, kind, joints) for kind, joints in named.items()}
    first, second = ("i", "tau") if options.currents else ("tau", "i")
    effort = next((kind for kind in (first, second) if by_kind[kind] or kind in named), None)
    known = {*closed, *named, *(kind for kind in WORDS if by_kind[kind])}
    if {"t", "q"} <= known and known & set(EFFORTS):
        return [by_kind[kind] for kind in ("t", "q", effort, "dq") if kind is not None and by_kind[kind]]
    found: dict[str, _Family] = {kind: by_kind[kind] for kind in ("q", "t", "dq", effort) if kind is not None}
    for kind in ("q", "t", "dq", *((first, second) if effort is None else ())):
        if kind in closed or kind in named or found.get(kind) or (kind == second and found.get(first)):
            continue
        prefix = next((reading.prefix for reading in found["q"].values()), "")
        found[kind] = _other_family(readings, kind, where, prefix)
    return [family for family in found.values() if family]


def _plain_family(readings: Sequence[Reading], kind: str, where: str) -> _Family:
    """Columns named as in a CSV log; those with a unit in the name count if no other has the name."""
    candidates = [reading for reading in readings if reading.kind == kind and reading.rank < OTHER]
    plain = {reading.number for reading in candidates if reading.rank == 0}
    family: dict[int, Reading] = {}
    for reading in sorted(candidates, key=lambda reading: reading.rank):
        if reading.rank == 1 and reading.number in plain:
            continue
        if reading.number in family:
            what = f"column {kind if kind == 't' else f'{kind}{reading.number}'} appears twice"
            raise InputError(what, where, "give every column its own name")
        family[reading.number] = reading
    return family


def _other_family(readings: Sequence[Reading], kind: str, where: str, prefix: str) -> _Family:
    """Columns of a kind with one other word, of the lowest rank, after a prefix."""
    others = [reading for reading in readings if reading.kind == kind and reading.rank >= OTHER]
    others = [reading for reading in others if reading.rank == min(other.rank for other in others)]
    words, numbers = ({getattr(reading, key) for reading in others} for key in ("word", "number"))
    if prefix and len(words) == 1 and len(numbers) < len(others):
        others = [reading for reading in others if reading.prefix == prefix] or others
    family: dict[int, Reading] = {}
    for reading in others:
        beside = family.get(reading.number) or next((other for other in others if other.word != reading.word), None)
        if beside is not None:
            first, second = sorted((reading, beside))
            meant = "the time" if kind == "t" else kind
            what = f"columns {first.label} and {second.label} could both be {meant}"
            raise InputError(what, where, f'choose one with {OPTION} {kind}="{pattern_of(first.label)}"')
        family[reading.number] = reading
    return family


def _other_joints(readings: Sequence[Reading], kind: str, joints: Set[int]) -> _Family:
    """Columns of a kind with one other word, beside those of named joints; empty if ambiguous.

    Single named joints 1, 2, .. may be all joints. Without the first joint's column it is open whether the others count
    from 0 or from 1.
    """
    if len(joints) > 1 and max(joints) == len(joints):
        return {}
    candidates = [reading for reading in readings if reading.kind == kind and reading.rank >= OTHER]
    family = {reading.number: reading for reading in candidates}
    words = {reading.word for reading in candidates}
    ambiguous = len(words) != 1 or len(family) < len(candidates) or (1 in joints and 0 not in family)
    return {} if ambiguous else family


def _check_measured(families: Sequence[_Family], header: Sequence[str], where: str) -> None:
    """InputError if plain names occur beside names with a word for measured."""
    readings = read_labels(header)
    for family in families:
        plain = next(iter(family.values()))
        measured = [reading for reading in readings if reading.kind == plain.kind and is_measured(reading.label)]
        if plain.rank >= OTHER or plain.kind == "t" or len({reading.number for reading in measured}) < len(family):
            continue
        first = next((reading for reading in measured if reading.number == plain.number), measured[0])
        what = f"columns {plain.label} and {first.label} could both be {plain.kind}"
        raise InputError(what, where, f'choose one with {OPTION} {plain.kind}="{pattern_of(first.label)}"')


def _check_start(families: Sequence[_Family], where: str) -> None:
    numbered = [family for family in families if -1 not in family]
    from_zero, from_one = ([family for family in numbered if (0 in family) == zero] for zero in (True, False))
    if not from_zero or not from_one:
        return
    n = min(max(family) for family in from_one)
    patterns = {family[max(family)].kind: pattern_of(family[max(family)].label) for family in numbered}
    ranges = ",".join(f'{kind}="{pattern}"'.replace("{}", f"{{1-{n}}}") for kind, pattern in patterns.items())
    spans = [f"{family[min(family)].label}..{family[max(family)].label}" for family in (from_zero[0], from_one[0])]
    what = f"{spans[0]} count from 0, {spans[1]} from 1"
    raise InputError(what, where, f"state which belong together with {OPTION}, as in {ranges}")


def _complete(
    found: Mapping[str, SourceColumn],
    header: Sequence[str],
    where: str,
    options: Options,
    given: Mapping[str, str],
    lacking: str,
) -> tuple[SourceColumn, ...]:
    n, effort = _highest("q", found), "tau" if _highest("tau", found) else "i"
    needed = {"column t": ("t", "t" in found), "column q1": ("q", n > 0)}
    needed[_EFFORT] = "tau", options.motion or _highest(effort, found) > 0
    for column, (kind, is_there) in needed.items():
        if not is_there:
            _check_units(header, where, kind)
            remedy = (
                lacking
                if lacking and column == _EFFORT
                else suggestion(header, found, given, currents=options.currents)
            )
            raise InputError(f"{column} is missing{described(header, found)}", where, remedy)
    chosen = [found["t"]]
    for kind in ["q", *([] if options.motion else [effort]), *(["dq"] if _highest("dq", found) else [])]:
        for j in range(1, n + 1):
            if f"{kind}{j}" not in found:
                label, there = _label(found, kind, j), f"{_label(found, 'q', 1)}..{_label(found, 'q', n)}"
                label = f"tau{j} (or {label} with gains)" if label == f"i{j}" else label
                remedy = f"add it; the file has {there} (or name the columns with {OPTION})"
                raise InputError(f"column {label} is missing", where, remedy)
            chosen.append(found[f"{kind}{j}"])
        if _highest(kind, found) > n:
            extra = next(source for name, source in found.items() if kind_part(name) == kind and _joint(name) > n)
            remedy = "give q and effort columns for the same joints"
            raise InputError(f"column {extra.label} has no matching q", where, remedy)
    return tuple(chosen)


def _check_units(header: Sequence[str], where: str, kind: str) -> None:
    for label in header:
        unit = unknown_unit(label, kind)
        if unit is not None:
            remedy = f"give it in {', '.join(list(UNITS[kind])[:7])}"
            if kind == "tau":
                remedy += f', or give gains that turn it into N m: `gains` with {OPTION} i="{pattern_of(label)}"'
            raise InputError(f"column {label} is in {unit}, an unknown unit of {kind}", where, remedy)


def _highest(kind: str, names: Mapping[str, SourceColumn]) -> int:
    return max((_joint(name) for name in names if name != "t" and kind_part(name) == kind), default=0)


def _joint(name: str) -> int:
    return int(name.removeprefix(kind_part(name)))


def _label(found: Mapping[str, SourceColumn], kind: str, joint: int) -> str:
    """The file's name of a joint's column, or the expected one by those of other joints."""
    if f"{kind}{joint}" in found:
        return found[f"{kind}{joint}"].label
    beside = next(name for name in found if kind_part(name) == kind)
    label = found[beside].label
    pattern = pattern_of(label)
    if pattern == label:
        return f"{kind}{joint}"
    first = pattern.index("{}")
    number = int(label[first : len(label) - len(pattern) + first + 2])
    return pattern.replace("{}", str(number + joint - _joint(beside)))
