"""The names of a log's columns: `t,q1..qn[,dq1..dqn],tau1..taun`, or `i1..in`, each perhaps with its unit.

`q1[deg]`, `q1 (deg)` and `q1_deg` are q1 in degrees, where no column is called q1 and nothing more. Where these names
make no whole log, the usual other ones count too (`WORDS`), and joints may be numbered from 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import replace

from bayesid.errors import InputError
from bayesid.log.formats.base import Options
from bayesid.log.formats.conventions import convention_of, note_of
from bayesid.log.formats.labels import (
    OTHER,
    UNITS,
    WORDS,
    Reading,
    factor_of,
    kind_of,
    kind_part,
    pattern_of,
    raised,
    read_labels,
    split_brackets,
    unknown_unit,
)
from bayesid.log.formats.stated import OPTION, UNNAMED, described, fits, stated_columns, suggestion
from bayesid.log.formats.table import Chosen, SourceColumn

_EFFORT = "column tau1 (or i1 with gains)"
_Family = Mapping[int, Reading]
"""Columns of one kind that are called alike, by the numbers in their labels."""


def choose(header: Sequence[str], where: str, options: Options) -> Chosen:
    """The columns that make a log: the time; for every joint its position, effort and, if measured, velocity.

    Args:
        header: the names of a file's columns; those that are not of a log are left out.
        where: the header's place, for messages.
        options: the columns that a user has named (the others go by their own names); whether efforts are left out;
            whether currents count where there are torques too; whether the columns need not be a whole log.

    Raises:
        InputError: a column is missing or appears twice, or which is meant stays open.
    """
    columns = options.columns or {}
    if options.part:
        columns = {key: pattern for key, pattern in columns.items() if fits(kind_part(key), pattern, header)}
    convention = None if _is_whole(header) else convention_of(header)
    if convention is not None:
        columns = convention.stated(header, columns, currents=options.currents)
        left_out = ("tau", "i") if options.motion else ()
        columns = {key: pattern for key, pattern in columns.items() if kind_part(key) not in left_out}
    stated = stated_columns(header, columns, where, described(header)) if columns else []
    kinds, named = _settled(columns, stated, motion=options.motion)
    taken, names = {source.place for source in stated}, {source.name for source in stated}
    readings = [reading for reading in read_labels(header) if reading.place not in taken and reading.kind not in kinds]
    families = _families(readings, kinds, named, where, currents=options.currents)
    _check_start(families, where)
    sources = (_source(one, family) for family in families for one in family.values())
    found = [*stated, *(source for source in sources if source.name not in names)]
    if options.part:
        return _part(found, header, where)
    lacking = "" if convention is None else convention.lacking
    asked = replace(options, columns=columns)
    chosen = _complete({source.name: source for source in found}, header, where, asked, lacking)
    if convention is not None and convention.part is not None and convention.part in header:
        chosen += (SourceColumn("part", header.index(convention.part), convention.part, 1.0),)
    foreign = convention is not None or any(one.rank == OTHER for family in families for one in family.values())
    note = note_of(header, chosen, convention) if foreign else None
    return Chosen(chosen, () if note is None else (f"{where}: {note}",))


# ---------------------------------------------------------------------------------------------------------------
# Which columns
# ---------------------------------------------------------------------------------------------------------------
def _is_whole(header: Sequence[str]) -> bool:
    """Whether the names of a CSV log make a whole one: then no others are looked at."""
    kinds = {reading.kind for reading in read_labels(header) if reading.rank < OTHER}
    return {"t", "q"} <= kinds and bool(kinds & {"tau", "i"})


def _part(found: Sequence[SourceColumn], header: Sequence[str], where: str) -> Chosen:
    """What a header holds of a log: the time, and whatever else; columns without a number are those of one joint."""
    if not any(source.name == "t" for source in found):
        raise InputError(f"column t is missing{described(header)}", where, f'say which it is with {OPTION} t="NAME"')
    known = {kind_part(source.name) for source in found}
    alone = {kind: [label for label in header if kind_of(label) == kind] for kind in WORDS.keys() - known}
    single = [
        SourceColumn(kind, header.index(labels[0]), labels[0], _unit_of(kind, labels[0]))
        for kind, labels in alone.items()
        if len(labels) == 1
    ]
    chosen = [*found, *single]
    kinds = {kind_part(source.name) for source in chosen}
    return Chosen(tuple(one for one in chosen if not (one.name.startswith("i") and "tau" in kinds)))


def _unit_of(kind: str, label: str) -> float | None:
    unit = split_brackets(label).unit
    return None if unit is None else factor_of(kind, unit)


def _settled(
    columns: Mapping[str, str], stated: Sequence[SourceColumn], *, motion: bool
) -> tuple[set[str], dict[str, set[int]]]:
    """Kinds of which no more columns are looked for, and of others the joints whose columns a user has named."""
    kinds = {kind_part(source.name) for source in stated}
    named: dict[str, set[int]] = {kind: set() for kind in kinds - columns.keys()}
    for source in stated:
        if source.name != "t" and kind_part(source.name) in named:
            named[kind_part(source.name)].add(_joint(source.name))
    efforts = {"tau", "i"} if motion or kinds & {"tau", "i"} else set()
    return (kinds | efforts) - named.keys(), named


def _families(
    readings: Sequence[Reading], stated: Set[str], named: Mapping[str, Set[int]], where: str, *, currents: bool
) -> list[_Family]:
    """Of each kind that a log needs, and that nobody has stated, the columns to be used.

    Those with a log's own names come first; where these and the stated ones make a whole log, no others are looked at
    but for kinds of which some joints' columns are named.
    """
    own = {kind: _own_family(readings, kind, where) for kind in WORDS}
    own |= {kind: own[kind] or _others_beside(readings, kind, joints) for kind, joints in named.items()}
    first, second = ("i", "tau") if currents else ("tau", "i")
    effort = next((kind for kind in (first, second) if own[kind] or kind in named), None)
    known = {*stated, *named, *(kind for kind in WORDS if own[kind])}
    if {"t", "q"} <= known and known & {"tau", "i"}:
        return [own[kind] for kind in ("t", "q", effort, "dq") if kind is not None and own[kind]]
    needed = [kind for kind in ("t", "q", "dq") if kind not in stated and (own[kind] or kind not in named)]
    found = [own[kind] or _other_family(readings, kind, where) for kind in needed]
    if effort is not None:
        found.append(own[effort])
    elif "tau" not in stated:
        found.append(_other_family(readings, first, where) or _other_family(readings, second, where))
    return [family for family in found if family]


def _own_family(readings: Sequence[Reading], kind: str, where: str) -> _Family:
    """The columns named as in a CSV log; those with a unit after their name count where no other has the name."""
    own = [one for one in readings if one.kind == kind and one.rank < OTHER]
    plain = {one.number for one in own if one.rank == 0}
    family: dict[int, Reading] = {}
    for one in sorted(own, key=lambda one: one.rank):
        if one.rank == 1 and one.number in plain:
            continue
        if one.number in family:
            said = f"column {kind if kind == 't' else f'{kind}{one.number}'} appears twice"
            raise InputError(said, where, "give every column its own name")
        family[one.number] = one
    return family


def _other_family(readings: Sequence[Reading], kind: str, where: str) -> _Family:
    """The columns of a kind that go by one other word; empty if there are none."""
    families: dict[str, dict[int, Reading]] = {}
    for one in readings:
        if one.kind == kind and one.rank == OTHER:
            family = families.setdefault(one.word, {})
            if one.number in family:
                raise _either(family[one.number], one, where)
            family[one.number] = one
    if len(families) > 1:
        first, second, *_ = families.values()
        raise _either(next(iter(first.values())), next(iter(second.values())), where)
    return next(iter(families.values()), {})


def _others_beside(readings: Sequence[Reading], kind: str, joints: Set[int]) -> _Family:
    """The columns of a kind that go by one other word, beside those of joints that are named; empty where it is open.

    Joints 1, 2, .. named one by one may be all that are meant; and without the first joint's column nobody knows
    whether the others count from 0 or from 1.
    """
    if len(joints) > 1 and max(joints) == len(joints):
        return {}
    those = [one for one in readings if one.kind == kind and one.rank == OTHER]
    family = {one.number: one for one in those}
    if len({one.word for one in those}) != 1 or len(family) < len(those) or (1 in joints and 0 not in family):
        return {}
    return family


def _either(first: Reading, second: Reading, where: str) -> InputError:
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
    return f"{family[min(family)].label}..{family[max(family)].label}"


def _ranged(family: _Family, last: int) -> str:
    return pattern_of(family[max(family)].label).replace("{}", f"{{1-{last}}}")


def _source(one: Reading, family: _Family) -> SourceColumn:
    joint = "" if one.kind == "t" else str(one.number + (0 in family))
    return SourceColumn(f"{one.kind}{joint}", one.place, one.label, one.factor)


# ---------------------------------------------------------------------------------------------------------------
# What is missing
# ---------------------------------------------------------------------------------------------------------------
def _complete(
    found: Mapping[str, SourceColumn], header: Sequence[str], where: str, options: Options, lacking: str
) -> tuple[SourceColumn, ...]:
    """The columns of a log, or of its motion alone, in order, if none is missing."""
    n, effort = _highest("q", found), "tau" if _highest("tau", found) else "i"
    absent = {"column t": "t" not in found, "column q1": n == 0}
    absent[_EFFORT] = not options.motion and not _highest(effort, found)
    for said in (said for said, is_absent in absent.items() if is_absent):
        _check_units(header, where, {"column t": ("t",), "column q1": ("q",)}.get(said, ("tau",)))
        remedy = lacking if said == _EFFORT else ""
        said = f"{said} is missing{described(header, found)}"
        raise InputError(said, where, remedy or _missing_remedy(header, found, options.columns or {}))
    chosen = [found["t"]]
    for kind in ["q", *([] if options.motion else [effort]), *(["dq"] if _highest("dq", found) else [])]:
        for j in range(1, n + 1):
            if f"{kind}{j}" not in found:
                there = f"{_label(found, 'q', 1)}..{_label(found, 'q', n)}"
                label = _label(found, kind, j)
                label = f"tau{j} (or {label} with gains)" if label == f"i{j}" else label
                raise InputError(
                    f"column {label} is missing",
                    where,
                    f"add it; {there} are there (or say which are meant with {OPTION})",
                )
            chosen.append(found[f"{kind}{j}"])
        if _highest(kind, found) > n:
            extra = next(source for name, source in found.items() if kind_part(name) == kind and _joint(name) > n)
            remedy = "give q and effort columns for the same joints"
            raise InputError(f"column {extra.label} has no q beside it", where, remedy)
    return tuple(chosen)


def _missing_remedy(header: Sequence[str], found: Mapping[str, SourceColumn], given: Mapping[str, str]) -> str:
    """The option that names what is there or, where nothing there may be meant, the way to name another file."""
    suggested = suggestion(header, found, given)
    elsewhere = "; if another file of the run holds them, give both as FILE+OTHER" if UNNAMED in suggested else ""
    return f"say which columns are meant with {suggested}{elsewhere}"


def _check_units(header: Sequence[str], where: str, kinds: Sequence[str]) -> None:
    for label in header:
        found = unknown_unit(label)
        if found is not None and found[0] in kinds:
            kind, unit = found
            remedy = f"give it in {', '.join(list(UNITS[kind])[:7])}"
            if kind == "tau":
                remedy += f', or give gains that turn it into N m: `gains` with {OPTION} i="{pattern_of(label)}"'
            raise InputError(f"column {label} is in {unit}, which is no known unit of {kind}", where, remedy)


def _highest(kind: str, names: Mapping[str, SourceColumn]) -> int:
    return max((_joint(name) for name in names if name != "t" and kind_part(name) == kind), default=0)


def _joint(name: str) -> int:
    return int(name.removeprefix(kind_part(name)))


def _label(found: Mapping[str, SourceColumn], kind: str, joint: int) -> str:
    """What the file calls a joint's column, or would call it, by the columns beside it."""
    if f"{kind}{joint}" in found:
        return found[f"{kind}{joint}"].label
    beside = next(name for name in found if kind_part(name) == kind)
    label = raised(found[beside].label, joint - _joint(beside))
    return f"{kind}{joint}" if label == found[beside].label else label
