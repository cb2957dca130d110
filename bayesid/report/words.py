"""Units, names and lists in text."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import TYPE_CHECKING

from bayesid.effects.catalogue import forms, noun, owner
from bayesid.effects.effect import Phrase, ReadableUnit

if TYPE_CHECKING:
    from bayesid.discrepancy.workflow import Discrepancy
    from bayesid.regression.selection.scores import Score

_UNITS = {"velocity": "rad/s", "position": "rad", "acceleration": "rad/s^2", "load": "N m", "time": "s"}
_SLIDING = {"velocity": "m/s", "position": "m", "acceleration": "m/s^2", "load": "N", "time": "s"}


def unit_of(discrepancy: Discrepancy, joint: int, variable: str = "load") -> str:
    """Unit of a joint's (from 1) effort, or of another variable of it."""
    sliding = discrepancy.identification.model.robot.joints[joint - 1].prismatic
    return (_SLIDING if sliding else _UNITS)[variable]


def label(effect: str, joints: Sequence[int] = ()) -> str:
    """An effect without an article, and the joints (from 1) in which it acts."""
    plain = noun(effect).removeprefix("an ").removeprefix("a ")
    return f"{plain}, {joints_in_words(joints)}" if joints else plain


def form_label(name: str, *remarks: str) -> str:
    """A form of an effect by its name, and remarks on it: cable drag (stiffening, changed)."""
    effect, _, form = name.partition(".")
    kind = "dry and viscous" if name == "thermal_drift.both" else form.replace("_", " ")
    details = [*([kind] if kind else []), *remarks]
    return label(effect) + (f" ({', '.join(details)})" if details else "")


_OF_LINK = re.compile(r"(?P<kind>J|mc|m)(?P<link>\d+)(?P<axes>[xyz]*)")
_OF_KIND = {"J": "inertia", "mc": "first moment", "m": "mass"}


def meaning(parameter: str) -> str:
    """Inertia xy of link 2; Coulomb friction, joint 1; empty if unknown."""
    if found := _OF_LINK.fullmatch(parameter):
        return f"{_OF_KIND[found['kind']]} {found['axes']}".rstrip() + f" of link {found['link']}"
    symbol = parameter.rstrip("0123456789")
    try:
        return label(owner(symbol)[0].name, (int(parameter[len(symbol) :]),))
    except (StopIteration, ValueError):
        return ""


def sizes_in_words(form: str) -> str:
    """What the numbers of an effect are, by its sentence: viscous friction that saturates: [Fe] beyond [knee]."""
    sentence = forms()[form].phrase.sentence if form in forms() else ""
    text = re.sub(r"\{(\w+)\}", lambda found: "" if found[1] in ("who", "whose") else f"[{found[1]}]", sentence)
    return text.strip().removeprefix("needs ").rstrip(".")


def readable_unit(phrase: Phrase, name: str, unit: str) -> ReadableUnit:
    """The readable unit of a parameter, by its name with or without a joint, and its unit."""
    symbol = name.rstrip("0123456789").rstrip("_")
    return phrase.units.get(name, phrase.units.get(symbol, ReadableUnit("" if unit == "1" else unit)))


def score_label(score: Score) -> str:
    """A candidate and its joints."""
    return label(score.hypothesis.effect, score.hypothesis.joints)


def best_first(scores: Iterable[Score]) -> list[Score]:
    """Candidates by their Bayes factors."""
    return sorted(scores, key=lambda score: -score.gain)


def joints_in_words(joints: Iterable[int]) -> str:
    """Joint 3; joints 1 to 3 and 5."""
    ordered = sorted(set(joints))
    runs = [[joint for _, joint in run] for _, run in groupby(enumerate(ordered), key=lambda pair: pair[1] - pair[0])]
    parts = [text for run in runs for text in ([f"{run[0]} to {run[-1]}"] if len(run) > 2 else map(str, run))]
    return f"joint{'s' if len(ordered) > 1 else ''} {listed(parts)}"


def listed(parts: Sequence[str], last: str = "and") -> str:
    """One, two and three."""
    return f"{', '.join(parts[:-1])} {last} {parts[-1]}" if len(parts) > 1 else "".join(parts)


def counted(number: int, what: str) -> str:
    """As in 1 period, 3 periods."""
    return f"{number} {what}{'s' * (number != 1)}"


def upper(text: str) -> str:
    """With a capital at its beginning."""
    return text[:1].upper() + text[1:]


def table(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Columns of text, right-aligned, below their headings."""
    widths = [max(map(len, column)) for column in zip(heading, *rows, strict=True)]
    lines = [[cell.rjust(width) for cell, width in zip(row, widths, strict=True)] for row in (heading, *rows)]
    return "\n".join("  ".join(line) for line in lines)
