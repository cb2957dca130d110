"""What to tell about a header that makes no log: the columns that are there, and the option that names them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bayesid.log.formats.labels import kind_at_end, kind_part, pattern_of
from bayesid.log.formats.stated import OPTION
from bayesid.log.formats.table import SourceColumn
from bayesid.log.formats.units import factor_of, split_brackets

_SEVERAL = 2
"""Columns that differ by a number only, and may so be those of the joints, from this many on."""
_SHOWN = 20
"""Names of a header that a message shows, those that differ by their numbers as one."""


def described(header: Sequence[str], found: Mapping[str, SourceColumn] | None = None) -> str:
    """The columns of a header, those that differ by a number as one, and what each is taken for where that is known."""
    kinds = {} if found is None else {source.label: kind_part(source.name) for source in found.values()}
    patterns = {pattern_of(label): kinds.get(label, "not used") for label in reversed(header) if label}
    shown = [pattern if found is None else f"{pattern} ({kind})" for pattern, kind in patterns.items()][::-1]
    return f" among {', '.join(shown[:_SHOWN])}{' and others' if len(shown) > _SHOWN else ''}"


def suggestion(header: Sequence[str], found: Mapping[str, SourceColumn]) -> str:
    """The option that names the columns of a log: those found and, for those missing, what might be meant."""
    members: dict[str, list[str]] = {}
    for label in header:
        members.setdefault(pattern_of(label) if label else "", []).append(label)
    used = {pattern_of(source.label): kind_part(source.name) for source in found.values()}
    open_ones = [pattern for pattern in members if pattern and pattern not in used]
    effort = next((kind for kind in ("tau", "i") if kind in used.values()), None)
    parts: list[str] = []
    for kinds in (("t",), ("q",), ("tau", "i") if effort is None else (effort,)):
        known = [(kind, pattern) for pattern, kind in used.items() if kind in kinds]
        alone = kinds == ("t",)
        fitting = [one for one in open_ones if (len(members[one]) < _SEVERAL) == alone]
        kind, pattern = (known or _likely(kinds, fitting) or [(kinds[0], "NAME" if alone else "NAME{}")])[0]
        named = [] if alone or known else [label for label in header if kind_at_end(label) in kinds]
        if len(named) > len(members.get(pattern, ())):  # each joint has a name of its own
            kind, pattern = str(kind_at_end(named[0])), ""
            parts += [f'{kind}{joint}="{label}"' for joint, label in enumerate(named, start=1)]
        else:
            parts.append(f'{kind}="{pattern}"')
        open_ones = [one for one in open_ones if one != pattern]
    return f"{OPTION} {','.join(parts)}"


def _likely(kinds: Sequence[str], patterns: Sequence[str]) -> list[tuple[str, str]]:
    """Which pattern may be of which kind: those with a unit of it first, then those without any."""
    units = {pattern: split_brackets(pattern).unit for pattern in patterns}
    stated = [(kind, one) for kind in kinds for one, unit in units.items() if unit and factor_of(kind, unit)]
    return stated + [(kinds[0], one) for one, unit in units.items() if unit is None]
