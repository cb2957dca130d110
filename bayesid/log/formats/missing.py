"""What to tell about a header that makes no log: the columns that are there, and the option that names them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence

from bayesid.log.formats.labels import kind_at_end, kind_part, last_word, pattern_of
from bayesid.log.formats.stated import OPTION
from bayesid.log.formats.table import SourceColumn
from bayesid.log.formats.units import factor_of, split_brackets

_SEVERAL = 2
"""Columns that differ by a number only, and may so be those of the joints, from this many on."""
UNNAMED = "NAME{}"
"""What stands for columns of which there are none."""
_EFFORT = re.compile(r"tau|torque|moment|eff|force|curr|amp|strom|kraft|last|load|\bN ?m\b", re.IGNORECASE)
"""What names of efforts hold in many languages."""
_VELOCITY = re.compile(r"vel|speed|geschw|drehzahl|vitesse|rpm|(rad|deg|°)/s", re.IGNORECASE)
"""What names of velocities hold, which are no efforts."""
_TIME = re.compile("time|zeit|temps|tiempo|stamp|clock", re.IGNORECASE)
"""What names of times hold."""
_CURRENT = re.compile("curr|strom|amp", re.IGNORECASE)
"""What names of currents hold."""
_SHOWN = 20
"""Names of a header that a message shows, those that differ by their numbers as one."""


def described(header: Sequence[str], found: Mapping[str, SourceColumn] | None = None) -> str:
    """The columns of a header, those that differ by a number as one, and what each is taken for where that is known."""
    kinds = {} if found is None else {source.label: kind_part(source.name) for source in found.values()}
    patterns = {pattern_of(label): kinds.get(label, "not used") for label in reversed(header) if label}
    shown = [pattern if found is None else f"{pattern} ({kind})" for pattern, kind in patterns.items()][::-1]
    return f" among {', '.join(shown[:_SHOWN])}{' and others' if len(shown) > _SHOWN else ''}"


def option(columns: Mapping[str, str]) -> str:
    """The option that names columns."""
    return f"{OPTION} " + ",".join(f'{key}="{pattern}"' for key, pattern in columns.items())


def suggestion(header: Sequence[str], found: Mapping[str, SourceColumn], given: Mapping[str, str] | None = None) -> str:
    """The option that names the columns of a log: those found and, for those missing, what might be meant.

    Args:
        header: the labels that are there.
        found: columns that are known.
        given: what a user has named: it stays.
    """
    given = given or {}
    left = [label for label in header if label and label not in {source.label for source in found.values()}]
    effort = next((kind for kind in ("tau", "i") if f"{kind}1" in found), None)
    parts: list[tuple[str, str]] = []
    n_joints = None
    for kinds in (("t",), ("q",), ("tau", "i") if effort is None else (effort,)):
        known = [source for source in found.values() if kind_part(source.name) in kinds]
        said = [(key, pattern) for key, pattern in given.items() if kind_part(key) in kinds]
        part = said if said and known else _as_found(known, header) if known else _guessed(kinds, left, n_joints)
        n_joints = len(part) if kinds == ("q",) and len(part) > 1 else n_joints
        left = [label for label in left if not {label, pattern_of(label)} & {pattern for _, pattern in part}]
        parts += part
    return option(dict(parts))


def _as_found(known: Sequence[SourceColumn], header: Sequence[str]) -> list[tuple[str, str]]:
    """What reads the columns of a kind that are known: one pattern if it fits them and no others."""
    pattern = pattern_of(known[0].label)
    if [pattern_of(label) for label in header].count(pattern) == len(known):
        return [(kind_part(known[0].name), pattern)]
    return [(source.name, source.label) for source in known]


def _guessed(kinds: Sequence[str], labels: Sequence[str], n_joints: int | None) -> list[tuple[str, str]]:
    """What may be of one of some kinds: a single column for the time, else columns of several joints."""
    counts = Counter(map(pattern_of, labels))
    alone = "t" in kinds
    fitting = [pattern for pattern, count in counts.items() if (count < _SEVERAL) == alone]
    kind, pattern = next(iter(_likely(kinds, fitting)), (kinds[0], "NAME" if alone else UNNAMED))
    for by_end, named in () if alone else _by_end(kinds, labels, n_joints):
        if len(named) > counts[pattern]:  # each joint has a name of its own
            return [(f"{by_end}{joint}", label) for joint, label in enumerate(named, start=1)]
    return [(kind, pattern)]


def _by_end(kinds: Sequence[str], labels: Sequence[str], n_joints: int | None) -> list[tuple[str, list[str]]]:
    """Labels that end in the same word: in one of some kinds, or in any, if there are as many as joints."""
    known = [(kind, [label for label in labels if kind_at_end(label) == kind]) for kind in kinds]
    ends: dict[str, list[str]] = {}
    for label in labels:
        ends.setdefault(last_word(label), []).append(label)
    fitting = [(_kind_of(kinds, end), alike) for end, alike in ends.items() if len(alike) == n_joints]
    return known + sorted(fitting, key=lambda one: _EFFORT.search(one[1][0]) is None)


def _kind_of(kinds: Sequence[str], name: str) -> str:
    """Which of some kinds a name says: currents by their own words, else the first."""
    return "i" if "i" in kinds and _CURRENT.search(name) else kinds[0]


def _likely(kinds: Sequence[str], patterns: Sequence[str]) -> list[tuple[str, str]]:
    """Which pattern may be of which kind: those with a unit of it first, then those without any, efforts by a word."""
    units = {pattern: split_brackets(pattern).unit for pattern in patterns}
    stated = [(kind, one) for kind in kinds for one, unit in units.items() if unit and factor_of(kind, unit)]
    open_ones = [one for one, unit in units.items() if unit is None]
    if "tau" in kinds or "i" in kinds:
        open_ones = [one for one in open_ones if not _VELOCITY.search(one)]
        open_ones.sort(key=lambda one: _EFFORT.search(one) is None)
    elif "t" in kinds:
        open_ones.sort(key=lambda one: _TIME.search(one) is None)
    return stated + [(_kind_of(kinds, one), one) for one in open_ones]
