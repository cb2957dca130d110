"""Several logs one after the other in plain words: two columns of what changed and what lacked, and what moved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.discrepancy.comparison import ALL_ALONG, CHANGED, GONE, UNDECIDED, EffectHistory, LogComparison, names_of
from bayesid.discrepancy.timeline import ABSENT, OPEN, PAYLOAD, SHOWN, Standing, TrackedParameter
from bayesid.discrepancy.tuning import TUNING as DISCREPANCY
from bayesid.effects import RigidBody
from bayesid.effects.catalogue import forms
from bayesid.effects.effect import Effect, ReadableUnit
from bayesid.identification.identification import KNOWN
from bayesid.report.discrepancy_verdicts import discrepancy_checks
from bayesid.report.tuning import TUNING
from bayesid.report.words import counted, joints_in_words, label, listed, quantity, rounded, upper

SECTIONS: Mapping[str, str] = {
    CHANGED: "Changed since the first log",
    ALL_ALONG: "Missing all along",
    GONE: "Gone since the first log",
    UNDECIDED: "These logs cannot tell",
}
"""Headings, in the order in which they are said."""
_SAYS: Mapping[str, str] = {SHOWN: "shown", ABSENT: "not there", OPEN: "cannot tell"}


# ---------------------------------------------------------------------------------------------------------------
# Parameters
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Moved:
    """A parameter that moved, as people read it."""

    place: int  # among all that are tracked
    name: str  # in words, with its joint
    of_links: bool  # whether it is a coefficient of links
    symbol: str  # the sum of parameters that it is
    unit: str  # in which people read it
    value: tuple[float, ...]  # (K,) in that unit, without a payload
    sd: tuple[float, ...]  # (K,)
    z: tuple[float, ...]  # (K,) change since the first log over its sd
    since: int  # first log (from 1) in which it is another one
    last: int  # last one
    change: str  # what it changed by until the last of them, in words
    text: str  # all in one line


def moved_parameters(comparison: LogComparison) -> list[Moved]:
    """Those that moved in any log, by joint; coefficients of links last."""
    line = comparison.timeline
    rows = [_moved(comparison, place) for place in np.flatnonzero(line.moved.any(axis=0)).tolist()]
    return sorted(rows, key=lambda row: (row.of_links, line.tracked[row.place].joint))


def _moved(comparison: LogComparison, place: int) -> Moved:
    line = comparison.timeline
    one = line.tracked[place]
    people = _people(one)
    value = people.factor * (line.value[:, place] - line.of_payload[:, place] - people.neutral)
    sd, change = people.factor * line.sd[:, place], people.factor * line.change[:, place]
    moved = np.flatnonzero(line.moved[:, place])
    last, name = int(moved[-1]), tracked_name(one)
    by = _change(change[last], value[0], sd[0], people.unit)
    where = "" if last + 1 == len(value) else f" in {names_of(comparison.logs)[last]}"
    return Moved(
        place=place,
        name=name,
        of_links=one.effect == RigidBody.name,
        symbol=one.expression,
        unit=people.unit,
        value=tuple(value.tolist()),
        sd=tuple(sd.tolist()),
        z=tuple(line.z[:, place].tolist()),
        since=int(moved[0]) + 1,
        last=last + 1,
        change=by,
        text=f"{name} {_together(value[0], value[last])} {people.unit} ({by}){where}",
    )


def tracked_name(one: TrackedParameter) -> str:
    """As in joint 2: Coulomb friction; links: mc2x + a2 M2; payload mass."""
    if one.name == PAYLOAD:
        return PAYLOAD
    if one.effect == RigidBody.name:
        return f"links: {one.expression}"
    effect, _, form = one.effect.partition(".")
    kind = forms()[one.effect]
    details = [form.replace("_", " ")] if form else []
    details += [one.name.rstrip("0123456789")] if len(getattr(kind, "coefficients", ())) > 1 else []
    where = f"joint {one.joint}: " if kind.acts_on != "robot" else ""
    return f"{where}{label(effect)}{f' ({listed(details)})' if details else ''}"


def _people(one: TrackedParameter) -> ReadableUnit:
    plain = ReadableUnit("" if one.unit == "1" else one.unit)
    if one.name == PAYLOAD:
        return plain
    return forms()[one.effect].phrase.units.get(one.name.rstrip("0123456789").rstrip("_"), plain)


def _together(first: float, last: float) -> str:
    """As in 12.1 -> 15.7: to the digits that the larger one has."""
    digits = len(rounded(max(abs(first), abs(last))).partition(".")[2])
    return f"{first:.{digits}f} -> {last:.{digits}f}"


def _change(change: float, first: float, sd: float, unit: str) -> str:
    """As in +30 %, of what the first log knows to a tenth; else how much."""
    if sd < KNOWN * abs(first):
        return f"{100.0 * change / first:+.0f} %"
    return f"{'+' if change >= 0.0 else '-'}{rounded(abs(change))} {unit}".rstrip()


# ---------------------------------------------------------------------------------------------------------------
# Two columns
# ---------------------------------------------------------------------------------------------------------------
def columns(comparison: LogComparison) -> dict[str, list[str]]:
    """What to say under `CHANGED`, `ALL_ALONG`, `GONE` and `UNDECIDED`, a line each."""
    rows = _other_changes(comparison)
    changed = [_came(comparison, one) for one in _new(comparison)]
    changed += [upper(row.text) for row in rows if not row.of_links]
    links = [row.symbol for row in rows if row.of_links]
    if links:
        why = "Links do not wear: a body came elsewhere, or the model lacks something"
        changed.append(f"{counted(len(links), 'link coefficient')}: {listed(links)}. {why}")
    undecided: dict[str, list[str]] = {}
    for one in comparison.of(UNDECIDED):
        undecided.setdefault(_why_open(comparison, one), []).append(effect_name(one.effect))
    return {
        CHANGED: changed,
        ALL_ALONG: [f"{upper(effect_name(one.effect))}{_sizes(comparison, one)}" for one in comparison.of(ALL_ALONG)],
        GONE: [f"{upper(effect_name(one.effect))}: {_by_log(comparison, one, ABSENT)}" for one in comparison.of(GONE)],
        UNDECIDED: [f"{upper('; '.join(names))}: {reason}" for reason, names in undecided.items()],
    }


def changes_lead(comparison: LogComparison) -> str:
    """The same in short: as many as a sentence holds."""
    rows = _other_changes(comparison)
    links = sum(row.of_links for row in rows)
    changed = [effect_name(one.effect) for one in _new(comparison)]
    changed += [row.text for row in rows if not row.of_links]
    changed += [counted(links, "link coefficient")] if links else []
    others = {which: [effect_name(one.effect) for one in comparison.of(which)] for which in (ALL_ALONG, GONE)}
    named = {CHANGED: changed} | others
    parts = [f"{SECTIONS[which]}: {_first_few(texts)}" for which, texts in named.items() if texts]
    nothing = "Nothing has changed since the first log, and nothing was missing, as far as these logs show"
    return f"{'. '.join(parts) or nothing}."


def _first_few(texts: Sequence[str]) -> str:
    more = len(texts) - TUNING.most_listed
    return "; ".join([*texts[: TUNING.most_listed], *([f"{more} more"] if more > 0 else [])])


def _new(comparison: LogComparison) -> list[EffectHistory]:
    return [one for one in comparison.of(CHANGED) if not any(e.hypothesis.changes for e in one.found.values())]


def _other_changes(comparison: LogComparison) -> list[Moved]:
    """Parameters that moved, but those of what came or went, which are told with that."""
    tracked = comparison.timeline.tracked
    told = [one.effect for one in (*_new(comparison), *comparison.of(GONE))]

    def belongs(effect: Effect, one: TrackedParameter) -> bool:
        same = effect.effect == one.effect.partition(".")[0]
        return same and (not effect.joints or one.joint in effect.joints)

    rows = moved_parameters(comparison)
    return [row for row in rows if not any(belongs(effect, tracked[row.place]) for effect in told)]


def effect_name(effect: Effect) -> str:
    """As in load-dependent friction, joint 2; cable drag (stiffening), joint 3."""
    form = effect.name.partition(".")[2].replace("_", " ")
    where = f", {joints_in_words(effect.joints)}" if effect.joints else ""
    return f"{label(effect.effect)}{f' ({form})' if form else ''}{where}"


def _came(comparison: LogComparison, history: EffectHistory) -> str:
    """An effect that came, with its size, and the logs that have it."""
    k = max(history.found)
    found = comparison.found[k - 1]
    checks = dict(zip((effect.hypothesis for effect in found.added), discrepancy_checks(found), strict=False))
    check = checks.get(history.found[k].hypothesis)
    told = upper(effect_name(history.effect)) if check is None else check.message.partition(". ")[0]
    return told if len(comparison.logs) == 2 else f"{told.rstrip('.')} ({_in_logs(comparison, history)})"


def _in_logs(comparison: LogComparison, history: EffectHistory) -> str:
    names = names_of(comparison.logs)
    return f"in {listed([names[k] for k in sorted(history.found)])}"


def _by_log(comparison: LogComparison, history: EffectHistory, other: str) -> str:
    """As in a.csv: shown; b.csv and c.csv: not there. Of logs that show it and of the others."""
    names = names_of(comparison.logs)
    parts = []
    for said in (SHOWN, other):
        logs = [name for name, what in zip(names, history.by_log, strict=True) if what.says == said]
        parts += [f"{_SAYS[said]} in {listed(logs)}"] if logs else []
    return ", ".join(parts)


def _why_open(comparison: LogComparison, history: EffectHistory) -> str:
    if any(what.says == SHOWN for what in history.by_log):
        return _by_log(comparison, history, OPEN)
    held = not history.by_log and any(effect.hypothesis.changes for effect in history.found.values())
    what = "of another size" if held else "new"
    return f"{what} by comparison {_in_logs(comparison, history)}, which no log by itself bears out"


def _sizes(comparison: LogComparison, history: EffectHistory) -> str:
    """(5.9 -> 6.3 %), of an effect's own parameters in the first and the last log; nothing where none is followed."""
    line = comparison.timeline
    texts = []
    for place, one in enumerate(line.tracked):
        if one.effect != history.effect.name or (history.joints and one.joint not in history.joints):
            continue
        people = _people(one)
        value, sd = people.factor * (line.value[:, place] - people.neutral), people.factor * line.sd[:, place]
        shown = np.flatnonzero(np.isfinite(sd))
        if len(shown) > 1:
            each = [quantity(value[k], sd[k], people.unit) for k in (shown[0], shown[-1])]
            texts.append(f"{one.name} = {each[0]}, then {each[1]}")
    return f": {'; '.join(texts)}" if texts else ""


def says(what: Standing) -> str:
    """As in shown (12.3), not there, cannot tell."""
    factor = f" ({rounded(what.log10_bayes_factor)})" if np.isfinite(what.log10_bayes_factor) else ""
    return f"{_SAYS[what.says]}{factor}"


def timeline_rule(comparison: LogComparison) -> str:
    """By which rule a parameter has moved."""
    line = comparison.timeline
    return (
        f"A parameter has moved if its change since the first log, in standard deviations of both, is too large for "
        f"chance at {DISCREPANCY.level:.0%} over all {line.n_tested} changes that were tested (Holm's correction)."
    )


def log_names(comparison: LogComparison) -> list[str]:
    """Short names of the logs, with their dates where these are known."""
    names, dates = names_of(comparison.logs), comparison.dates
    told = [
        f", {text}" if dates.known and text not in name else "" for name, text in zip(names, dates.texts, strict=True)
    ]
    return [f"{name}{date}" for name, date in zip(names, told, strict=True)]
