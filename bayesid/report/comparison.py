"""Report of several logs of one robot: changes, effects missing in all logs, and the content of the files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesid.discrepancy.comparison import CHANGED, GONE, PREEXISTING, UNDECIDED, ChangeReport, EffectHistory, names_of
from bayesid.discrepancy.timeline import ABSENT, OPEN, PAYLOAD, SHOWN, LogEvidence, TrackedParameter
from bayesid.discrepancy.tuning import TUNING as DISCREPANCY
from bayesid.effects import RigidBody
from bayesid.effects.catalogue import forms
from bayesid.effects.effect import Effect, Phrase, ReadableUnit
from bayesid.identification.checks import Check, State
from bayesid.identification.identification import KNOWN
from bayesid.number_text import percent, quantity, rounded
from bayesid.report.brief import in_brief as last_in_brief
from bayesid.report.conclusion import Conclusion, sentence
from bayesid.report.discrepancy import added_summary, discrepancy_checks, discrepancy_summary
from bayesid.report.summary import as_json, as_object, taken
from bayesid.report.tuning import TUNING
from bayesid.report.words import counted, form_label, joints_in_words, listed, readable_unit, upper

SECTIONS: Mapping[str, str] = {
    CHANGED: "Changed since the first log",
    PREEXISTING: "Missing in all logs",
    GONE: "No longer present",
    UNDECIDED: "Undetermined by these logs",
}
"""Headings, in order."""
_EVIDENCE: Mapping[str, str] = {SHOWN: "present", ABSENT: "absent", OPEN: "undetermined"}


@dataclass(frozen=True)
class Moved:
    """A parameter that changed, in readable units."""

    place: int  # index among the tracked parameters
    name: str  # in words, with its joint
    of_links: bool  # whether it is a coefficient of links
    symbol: str  # sum of parameters
    unit: str  # readable unit
    value: tuple[float, ...]  # (K,) in that unit, without a payload
    sd: tuple[float, ...]  # (K,)
    z: tuple[float, ...]  # (K,) change since the first log over its sd
    since: int  # first log (from 1) with a significant change
    change: str  # up to the last log with a significant change, in words
    text: str  # in one line


def moved_parameters(comparison: ChangeReport) -> list[Moved]:
    """Parameters that changed in any log, by joint; coefficients of links last."""
    line = comparison.timeline
    rows = [_moved(comparison, place) for place in np.flatnonzero(line.moved.any(axis=0)).tolist()]
    return sorted(rows, key=lambda row: (row.of_links, line.tracked[row.place].joint))


def _moved(comparison: ChangeReport, place: int) -> Moved:
    line = comparison.timeline
    parameter = line.tracked[place]
    readable, name = _unit_of(parameter), tracked_name(parameter)
    value = readable.factor * (line.value[:, place] - line.of_payload[:, place] - readable.neutral)
    sd, change = readable.factor * line.sd[:, place], readable.factor * line.change[:, place]
    moved = np.flatnonzero(line.moved[:, place]).tolist()
    last = moved[-1]
    digits = len(rounded(max(abs(value[0]), abs(value[last]))).partition(".")[2])
    by = f"{'+' if change[last] >= 0.0 else '-'}{rounded(abs(change[last]))} {readable.unit}".rstrip()
    if sd[0] < KNOWN * abs(value[0]):
        by = f"{100.0 * change[last] / value[0]:+.0f} %"
    where = "" if last + 1 == len(value) else f" in {names_of(comparison.logs)[last]}"
    return Moved(
        place=place,
        name=name,
        of_links=parameter.effect == RigidBody.name,
        symbol=parameter.expression,
        unit=readable.unit,
        value=tuple(value.tolist()),
        sd=tuple(sd.tolist()),
        z=tuple(line.z[:, place].tolist()),
        since=moved[0] + 1,
        change=by,
        text=f"{name} {value[0]:.{digits}f} -> {value[last]:.{digits}f} {readable.unit} ({by}){where}",
    )


def tracked_name(parameter: TrackedParameter) -> str:
    """Such as joint 2: Coulomb friction; links: mc2x + a2 M2; payload mass."""
    if parameter.name == PAYLOAD:
        return PAYLOAD
    if parameter.effect == RigidBody.name:
        return f"links: {parameter.expression}"
    kind = forms()[parameter.effect]
    details = [parameter.name.rstrip("0123456789")] if len(getattr(kind, "coefficients", ())) > 1 else []
    where = f"joint {parameter.joint}: " if kind.acts_on != "robot" else ""
    return f"{where}{form_label(parameter.effect, *details)}"


def _unit_of(parameter: TrackedParameter) -> ReadableUnit:
    phrase = Phrase() if parameter.name == PAYLOAD else forms()[parameter.effect].phrase
    return readable_unit(phrase, parameter.name, parameter.unit)


def timeline_rule(comparison: ChangeReport) -> str:
    """The test by which a parameter has changed."""
    tests = comparison.timeline.n_tested
    return (
        "A parameter has changed if its change since the first log is significant at "
        f"{percent(DISCREPANCY.level, 0)} (Holm's correction over {tests} tests)."
    )


def columns(comparison: ChangeReport) -> dict[str, list[str]]:
    """Lines under the headings `CHANGED`, `PREEXISTING`, `GONE` and `UNDECIDED`."""
    rows = _other_changes(comparison)
    changed = [_came(comparison, history) for history in _new(comparison)]
    changed += [upper(row.text) for row in rows if not row.of_links]
    if links := [row.symbol for row in rows if row.of_links]:
        why = "Links do not wear: a load was added or moved, or the model lacks an effect"
        changed.append(f"{counted(len(links), 'link coefficient')}: {listed(links)}. {why}")
    undecided: dict[str, list[str]] = {}
    for history in comparison.of(UNDECIDED):
        undecided.setdefault(_why_open(comparison, history), []).append(effect_name(history.effect))
    return {
        CHANGED: changed,
        PREEXISTING: [upper(effect_name(one.effect)) + _sizes(comparison, one) for one in comparison.of(PREEXISTING)],
        GONE: [f"{upper(effect_name(one.effect))}: {_by_log(comparison, one, ABSENT)}" for one in comparison.of(GONE)],
        UNDECIDED: [f"{upper('; '.join(names))}: {reason}" for reason, names in undecided.items()],
    }


def in_brief(comparison: ChangeReport) -> tuple[Check, ...]:
    """Changes, additional effects in all logs; gap, remaining residual and next step of the last log."""
    changed = [effect_name(history.effect) for history in _new(comparison)]
    changed += [f"{effect_name(history.effect)} is gone" for history in comparison.of(GONE)]
    rows = _other_changes(comparison)
    changed += [row.text for row in rows if not row.of_links]
    if links := [row for row in rows if row.of_links]:
        changed.append(counted(len(links), "link coefficient"))
    in_all = [effect_name(history.effect) for history in comparison.of(PREEXISTING)]
    return (
        Check("Changed", "look" if changed else "good", _few(changed) or "no change detected"),
        Check("In all logs", "good", _few(in_all) or "no additional effects"),
        *(check for check in last_in_brief(comparison.found[-1]) if check.name in ("Gap", "Remaining", "Next")),
    )


def _few(texts: list[str]) -> str:
    more = len(texts) - TUNING.most_listed
    return "; ".join([*texts[: TUNING.most_listed], *([f"{more} more"] if more > 0 else [])])


def comparison_conclusion(comparison: ChangeReport) -> Conclusion:
    """The verdict: whether something has changed, or is missing."""
    moved = bool(comparison.of(CHANGED) or comparison.timeline.moved.any() or comparison.of(GONE))
    missing = bool(comparison.of(PREEXISTING))
    in_all = "effects are missing in all logs" if missing else "no effect is missing in all logs"
    text = f"{'The robot has changed' if moved else 'No significant change'}; {in_all}"
    state: State = "look" if moved or missing else "good"
    return Conclusion(state, sentence(state, text))


def _new(comparison: ChangeReport) -> list[EffectHistory]:
    def is_new(history: EffectHistory) -> bool:
        return not any(effect.hypothesis.changes for effect in history.found.values())

    return list(filter(is_new, comparison.of(CHANGED)))


def _other_changes(comparison: ChangeReport) -> list[Moved]:
    """Parameters that changed, without those of effects that are new or gone."""
    effects = [history.effect for history in (*_new(comparison), *comparison.of(GONE))]

    def of_effect(parameter: TrackedParameter) -> bool:
        name = parameter.effect.partition(".")[0]
        of_name = [effect for effect in effects if effect.effect == name]
        return any(not effect.joints or parameter.joint in effect.joints for effect in of_name)

    return [row for row in moved_parameters(comparison) if not of_effect(comparison.timeline.tracked[row.place])]


def effect_name(effect: Effect) -> str:
    """Such as load-dependent friction, joint 2; cable drag (stiffening), joint 3."""
    return f"{form_label(effect.name)}{f', {joints_in_words(effect.joints)}' if effect.joints else ''}"


def _came(comparison: ChangeReport, history: EffectHistory) -> str:
    """A new effect, its size, and the logs that show it."""
    k = max(history.found)
    found = comparison.found[k - 1]
    checks = dict(zip((effect.hypothesis for effect in found.added), discrepancy_checks(found), strict=False))
    check = checks.get(history.found[k].hypothesis)
    text = upper(effect_name(history.effect)) if check is None else check.message.partition(". ")[0]
    return text if len(comparison.logs) == 2 else f"{text.rstrip('.')} ({_in_logs(comparison, history)})"


def _in_logs(comparison: ChangeReport, history: EffectHistory) -> str:
    names = names_of(comparison.logs)
    return f"in {listed([names[k] for k in sorted(history.found)])}"


def _by_log(comparison: ChangeReport, history: EffectHistory, other: str) -> str:
    """Such as present in a.csv, absent in b.csv and c.csv."""
    pairs, parts = list(zip(names_of(comparison.logs), history.by_log, strict=True)), []
    for answer in (SHOWN, other):
        logs = [name for name, evidence in pairs if evidence.says == answer]
        parts += [f"{_EVIDENCE[answer]} in {listed(logs)}"] if logs else []
    return ", ".join(parts)


def _why_open(comparison: ChangeReport, history: EffectHistory) -> str:
    if any(evidence.says == SHOWN for evidence in history.by_log):
        return _by_log(comparison, history, OPEN)
    changed = not history.by_log and any(effect.hypothesis.changes for effect in history.found.values())
    status = "another size" if changed else "new"
    return f"{status} by comparison {_in_logs(comparison, history)}; no single log confirms it"


def _sizes(comparison: ChangeReport, history: EffectHistory) -> str:
    """An effect's parameters in the first and the last log that show them."""
    line, texts = comparison.timeline, []
    for place, parameter in enumerate(line.tracked):
        if parameter.effect == history.effect.name and (not history.joints or parameter.joint in history.joints):
            readable = _unit_of(parameter)
            value, sd = readable.factor * (line.value[:, place] - readable.neutral), readable.factor * line.sd[:, place]
            shown = np.flatnonzero(np.isfinite(sd))
            if len(shown) > 1:
                first, last = (quantity(value[k], sd[k], readable.unit) for k in (shown[0], shown[-1]))
                texts.append(f"{parameter.name} = {first}, then {last}")
    return f": {'; '.join(texts)}" if texts else ""


def evidence_in_words(evidence: LogEvidence) -> str:
    """Such as present (12.3), absent, or undetermined."""
    factor = f" ({rounded(evidence.log10_bayes_factor)})" if np.isfinite(evidence.log10_bayes_factor) else ""
    return f"{_EVIDENCE[evidence.says]}{factor}"


def log_names(comparison: ChangeReport) -> list[str]:
    """Short names of the logs, with their dates if known."""
    names, dates = names_of(comparison.logs), comparison.dates
    pairs = zip(names, dates.texts, strict=True)
    return [f"{name}, {text}" if dates.known and text not in name else name for name, text in pairs]


def comparison_summary(comparison: ChangeReport) -> dict[str, Any]:
    """discrepancy.json of several logs: that of the last one, each effect's history, and the time line."""
    in_words, dates = columns(comparison), comparison.dates
    texts = dates.texts if dates.known else [None] * len(comparison.logs)
    more = as_object(
        {
            "logs": [{"log": log.source, "date": text} for log, text in zip(comparison.logs, texts, strict=True)],
            "dates_from": dates.basis,
            "in_words": in_words,
            **{status: [_history(comparison, history) for history in comparison.of(status)] for status in in_words},
            "moved": [_moved_summary(comparison, row) for row in moved_parameters(comparison)],
            "moved_rule": timeline_rule(comparison),
            **taken(comparison, "warnings", "seconds"),
        }
    )
    return discrepancy_summary(comparison.found[-1]) | more


def _history(comparison: ChangeReport, history: EffectHistory) -> dict[str, Any]:
    sources = [log.source for log in comparison.logs]
    by_log = zip(sources, history.by_log, strict=False)
    return {
        "effect": history.name,
        "form": history.effect.name,
        "joints": history.joints,
        "by_log": [{"log": source} | as_json(evidence) for source, evidence in by_log],
        "found": [{"log": sources[k], **added_summary(effect)} for k, effect in sorted(history.found.items())],
    }


def _moved_summary(comparison: ChangeReport, row: Moved) -> dict[str, Any]:
    line = comparison.timeline
    tracked = line.tracked[row.place]
    return {
        "parameter": tracked.name,
        "expression": row.symbol,
        "in_words": row.text,
        "unit": tracked.unit,
        "values": line.value[:, row.place],
        "sds": line.sd[:, row.place],
        "z": row.z,
        "p": line.p[:, row.place],
        "since": comparison.logs[row.since - 1].source,
        "change_in_words": row.change,
    }


def timeline_rows(comparison: ChangeReport) -> Iterator[dict[str, object]]:
    """timeline.csv: one row per log and parameter, in the parameter's unit; unknown numbers are empty."""
    line, dates = comparison.timeline, comparison.dates
    for k, log in enumerate(comparison.logs):
        for c, parameter in enumerate(line.tracked):
            values = {name: getattr(line, name)[k, c] for name in ("value", "sd", "change", "change_sd", "of_payload")}
            values |= {"z": line.z[k, c], "p": line.p[k, c]}
            numbers = {name: float(value) if np.isfinite(value) else "" for name, value in values.items()}
            yield {
                "log": log.source,
                "date": dates.texts[k] if dates.known else "",
                "parameter": parameter.name,
                "value": numbers.pop("value"),
                "sd": numbers.pop("sd"),
                "unit": parameter.unit,
                "moved": bool(line.moved[k, c]),
                "expression": parameter.expression,
                **numbers,
            }
