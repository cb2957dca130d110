"""A discrepancy, or what changed over several logs, as one self-contained page: words, tables and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayesid.discrepancy.case import Excess
from bayesid.discrepancy.comparison import ALL_ALONG, CHANGED, GONE, EffectHistory, LogComparison
from bayesid.discrepancy.selection import GROWN, HELD_BACK, ON_LOG
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.effects.catalogue import forms
from bayesid.parallel import one_at_a_time
from bayesid.regression.selection.added_effect import AddedEffect
from bayesid.regression.selection.explanation import LN10
from bayesid.regression.selection.hypotheses import Hypothesis
from bayesid.regression.selection.scores import Score
from bayesid.report.discrepancy_verdicts import (
    discrepancy_checks,
    distinguishing_motions,
    equivalents,
    lead,
    listed_sets,
    nothing_missing,
    set_in_words,
    testable_groups,
    told,
)
from bayesid.report.pages.rendering import Picture, picture, render
from bayesid.report.plot.discrepancy import (
    by_date,
    candidate_figure,
    effort_figure,
    gap_figure,
    learned_figure,
    residual_figure,
    timeline_figure,
)
from bayesid.report.timeline_text import (
    SECTIONS,
    Moved,
    changes_lead,
    columns,
    log_names,
    moved_parameters,
    says,
    timeline_rule,
    tracked_name,
)
from bayesid.report.tuning import TUNING
from bayesid.report.verdicts import State
from bayesid.report.words import best_first, joints_in_words, label, quantity, rounded, score_label, unit_of

_STATUS = {
    "explained": "Explained: what was missing is found",
    "partly_explained": "Partly explained: something was found, something is left",
    "unexplained": "Not explained: something is missing",
}
_SAID = {ON_LOG: "on the log", HELD_BACK: "on what scores", GROWN: "the gap grew"}
"""Which data say that a joint is unexplained, in a cell."""
_STATES: Mapping[State, Mapping[str, str]] = {
    "good": {"colour": "good", "text": "found"},
    "look": {"colour": "look", "text": "look at"},
    "bad": {"colour": "bad", "text": "unexplained"},
    "not done": {"colour": "open", "text": "not shown"},
}
"""Of each state the class on the page and the word."""
_SECTIONS = {
    "findings": "Verdicts",
    "gap": "The gap",
    "found": "What was found",
    "where": "Where the model as it was fails",
    "efforts": "Measured and modelled efforts",
    "candidates": "Candidates",
    "left-out": "Left out",
    "not-testable": "What this log cannot tell",
}
"""Of the page, in their order: name and title."""
_CHANGES = {"changes": "What changed, what was missing all along", "timeline": "Time line"}
"""Of the page of several logs, before those of the last comparison."""
_ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth")


# ---------------------------------------------------------------------------------------------------------------
# One discrepancy
# ---------------------------------------------------------------------------------------------------------------
@one_at_a_time
def discrepancy_page(discrepancy: Discrepancy) -> str:
    """The report of a comparison, in HTML: opens in a browser from anywhere, light or dark, and prints."""
    return render(
        "discrepancy.html.jinja", "What the model lacks", subject(discrepancy), **discrepancy_content(discrepancy)
    )


def subject(discrepancy: Discrepancy) -> str:
    """What the page is about."""
    identification = discrepancy.identification
    return f"{identification.model.robot.name}, {identification.log.source}"


def discrepancy_content(discrepancy: Discrepancy) -> dict[str, Any]:
    """What its template needs."""
    identification = discrepancy.identification
    robot, log = identification.model.robot.name, identification.log.source
    return {
        "status": {"colour": discrepancy.status, "text": _STATUS.get(discrepancy.status, nothing_missing(discrepancy))},
        "lead": lead(discrepancy),
        "checks": [(check, _STATES[check.state]) for check in discrepancy_checks(discrepancy)],
        "about": [("Robot", robot), ("Log", log), ("Scored on", discrepancy.holdout)],
        "contents": _contents(discrepancy),
        "warnings": discrepancy.warnings,
        "holdout": discrepancy.holdout,
        "gaps": [_gap(discrepancy, j) for j in range(len(discrepancy.before))],
        "gap_pictures": [_gap_picture(discrepancy)],
        "added": [_added(discrepancy, effect) for effect in discrepancy.added],
        "known_worth": any(effect.size and effect.cost for effect in discrepancy.added),
        "sets": [(set_in_words(one), one.probability) for one in listed_sets(discrepancy)],
        "learned_pictures": [
            _learned_picture(discrepancy, effect) for effect in discrepancy.added if effect.hypothesis.curves
        ],
        "where": [_where(discrepancy, excess) for excess in discrepancy.where],
        "nowhere": _nowhere(discrepancy),
        "residual_pictures": [_residual_picture(discrepancy, excess) for excess in discrepancy.where],
        "unsigned": _unsigned(discrepancy),
        "effort_pictures": [_effort_picture(discrepancy, j + 1) for j in range(len(discrepancy.before))],
        **_candidates(discrepancy),
        "left_out": [_left_out(effect) for effect in discrepancy.refused],
        "not_testable": [
            (label(effect), _joints(joints), forms()[effect].shown_by)
            for effect, joints in testable_groups(discrepancy)
        ],
    }


def _contents(discrepancy: Discrepancy) -> dict[str, str]:
    """The sections that are there."""
    absent = {
        *([] if discrepancy_checks(discrepancy) else ["findings"]),
        *([] if discrepancy.vetoed else ["left-out"]),
        *([] if discrepancy.not_testable else ["not-testable"]),
    }
    return {name: title for name, title in _SECTIONS.items() if name not in absent}


# ---------------------------------------------------------------------------------------------------------------
# Rows
# ---------------------------------------------------------------------------------------------------------------
def _gap(discrepancy: Discrepancy, j: int) -> dict[str, Any]:
    floor = discrepancy.floor
    return {
        "unit": unit_of(discrepancy, j + 1),
        "before": discrepancy.before[j],
        "after": discrepancy.after[j],
        "floor": floor.rms[j],
        "white": floor.white[j],
        "origin": floor.origin[j] + ("" if floor.sharp[j] else " (a lower bound)") + _whose_error(discrepancy, j),
        "unexplained": dict(discrepancy.unexplained).get(j + 1),
        "says": ", ".join(_SAID[which] for which in discrepancy.unexplained_on.get(j + 1, ())),
    }


def _whose_error(discrepancy: Discrepancy, j: int) -> str:
    return "; most of it lasts: that model's own error, or smoothed noise" if discrepancy.floor.lasting[j] else ""


def _added(discrepancy: Discrepancy, effect: AddedEffect) -> dict[str, Any]:
    return {
        "size": effect.size,
        "size_unit": effect.size and unit_of(discrepancy, effect.size.joint),
        "cost": effect.cost,
        "cost_unit": effect.cost and unit_of(discrepancy, effect.cost.joint),
        "name": _name(effect.hypothesis),
        "joints": _joints(effect.joints),
        "parameters": _parameters(effect),
        "formula": effect.formula,
        "sentence": "" if effect.description is None else effect.description.sentence,
        "gain": effect.log10_bayes_factor,
        "probability": effect.probability,
        "nothing_missing": effect.nothing_missing,
        "something_else": effect.something_else,
        "equivalent": ", ".join(equivalents(effect, label)),
        "shown_by": distinguishing_motions(effect),
    }


def _parameters(effect: AddedEffect) -> list[tuple[str, float, str]]:
    """Name, value and text: what people read in place of parameters, if there is such; of changes before and now.

    None of what has a formula.
    """
    if effect.description is not None:
        return []
    if effect.readable and not effect.hypothesis.changes:
        numbers = effect.readable.items()
        return [(name, value, quantity(value, sd, unit)) for name, (value, sd, unit) in numbers]
    added = {f"{symbol}{j}" for symbol in effect.hypothesis.source.adds_to for j in effect.joints}
    in_total = any(name.startswith("change of ") for name in effect.parameters) and not effect.hypothesis.changes
    return [
        (name, value, told(effect, name))
        for name, (value, _, _) in effect.parameters.items()
        if not name.startswith("change of ") and not (in_total and name in added)
    ]


def _left_out(effect: AddedEffect) -> str:
    """Its name and, of one without a name, what was learned."""
    learned = "" if effect.description is None else f": {effect.formula}, {effect.description.sentence}"
    return f"{label(effect.effect, effect.joints)}{learned}"


def _where(discrepancy: Discrepancy, excess: Excess) -> dict[str, Any]:
    low, high = excess.range
    return {
        "joint": excess.joint,
        "excess": excess.excess,
        "effort_unit": unit_of(discrepancy, excess.joint),
        "variable": excess.variable,
        "low": low,
        "high": high,
        "unit": unit_of(discrepancy, excess.joint, excess.variable),
    }


def _nowhere(discrepancy: Discrepancy) -> str:
    """What it means that the model as it was exceeds the floor in no joint of the log."""
    plain = (
        "In no joint does it leave so much more than the noise floor that chance, or the floor's own error, could not"
    )
    if discrepancy.added:
        return (
            f"{plain}: on the log the gap alone would not show that anything is missing. What was added shows in the "
            "shape of what is left, by its Bayes factor, and on the data that score."
        )
    if discrepancy.unexplained:
        return f"{plain}. It is the data that score that show that something is missing: see the gap."
    return f"{plain}."


def _unsigned(discrepancy: Discrepancy) -> str:
    joints = np.flatnonzero(~np.asarray(discrepancy.trial.signals.signed)) + 1
    return joints_in_words(joints.tolist()) if len(joints) else ""


def _candidates(discrepancy: Discrepancy) -> dict[str, Any]:
    scores = discrepancy.scores
    if not scores:
        return {"candidates": []}
    places = {effect.hypothesis.key: place for place, effect in enumerate(discrepancy.added)}
    ordered = best_first(scores)
    shown = [(rank, s) for rank, s in enumerate(ordered, start=1) if rank <= TUNING.candidates or s.key in places]
    rows = [_candidate(discrepancy, score, rank, places.get(score.key)) for rank, score in shown]
    caption = (
        f"The best {min(TUNING.candidates, len(scores))} of {len(scores)} candidates, and all that were added. The "
        "log10 Bayes factor is of each by itself, added to the model as it was; it says where to begin. To be added an "
        f"effect needs {discrepancy.thresholds.log10_bayes_factor:g} given the others that were added: what these "
        "explain it no longer does, however large its own number is here, and what they hide may show later."
    )
    return {"candidates": rows, "candidates_caption": caption, "candidate_pictures": [_candidate_picture(discrepancy)]}


def _candidate(discrepancy: Discrepancy, score: Score, rank: int, place: int | None) -> dict[str, Any]:
    return {
        "rank": rank,
        "name": _name(score.hypothesis),
        "joints": _joints(score.hypothesis.joints),
        "gain": score.gain / LN10,
        "became": _became(discrepancy, score, place),
    }


def _became(discrepancy: Discrepancy, score: Score, place: int | None) -> str:
    """What became of a candidate."""
    if place is not None:
        return f"added {_ORDINALS[place] if place < len(_ORDINALS) else f'as number {place + 1}'}"
    if score.key in discrepancy.vetoed:
        return "left out: see below"
    if score.gain >= discrepancy.thresholds.log10_bayes_factor * LN10:
        return _outdone(discrepancy, score) if discrepancy.added else "not worth adding"
    return "this log could not show it" if score.key in discrepancy.not_testable else "too weak"


def _outdone(discrepancy: Discrepancy, score: Score) -> str:
    """By which added effect, the others that were added given, and by how much; as far as that is known."""
    said = "not needed, given those that were added"
    pairs = [(rival.gain, added) for added in discrepancy.added for rival in added.rivals if rival.key == score.key]
    gain, added = max(pairs, key=lambda pair: pair[0], default=(np.inf, None))
    if added is None or gain >= added.gain:
        return said
    place, has = label(added.effect, added.joints), rounded(added.log10_bayes_factor)
    return f"{said}: in place of {place}, it has {rounded(gain / LN10)}, that {has}"


def _joints(joints: Sequence[int]) -> str:
    return joints_in_words(joints).split(" ", 1)[1] if joints else "whole robot"


def _name(hypothesis: Hypothesis) -> str:
    """An effect's name, which form of it, and whether it is a change of what the model has."""
    form = hypothesis.source.name
    remarks = [form.split(".", 1)[1].replace("_", " ")] if "." in form else []
    remarks += ["changed"] if hypothesis.changes else []
    return label(hypothesis.effect) + (f" ({', '.join(remarks)})" if remarks else "")


# ---------------------------------------------------------------------------------------------------------------
# Figures
# ---------------------------------------------------------------------------------------------------------------
def _gap_picture(discrepancy: Discrepancy) -> Picture:
    gaps = zip(discrepancy.before, discrepancy.after, discrepancy.floor.rms, strict=True)
    bars = "; ".join(
        f"joint {joint}: {rounded(float(before))} before, {rounded(float(after))} after, floor {rounded(float(floor))}"
        for joint, (before, after, floor) in enumerate(gaps, start=1)
    )
    caption = "The same in units of each joint's noise floor."
    return picture(gap_figure(discrepancy), "gap-figure", caption, f"Bars of the gap of each joint in N m: {bars}")


def _residual_picture(discrepancy: Discrepancy, excess: Excess) -> Picture:
    joint, variable, (low, high) = excess.joint, excess.variable, excess.range
    caption = f"Joint {joint}: measured minus modelled effort over {variable}."
    alt = (
        f"Residual of joint {joint} over {variable}, of the model as it was and of the extended model. As it was, it "
        f"exceeds the noise floor by {rounded(excess.excess)} {unit_of(discrepancy, joint)}, most of it between "
        f"{rounded(low)} and {rounded(high)} {unit_of(discrepancy, joint, variable)}."
    )
    return picture(residual_figure(discrepancy, joint), f"residual{joint}", caption, alt)


def _effort_picture(discrepancy: Discrepancy, joint: int) -> Picture:
    alt = f"Effort of joint {joint} over time: measured, by the model as it was, and by the extended model."
    return picture(effort_figure(discrepancy, joint), f"effort{joint}", f"Joint {joint}.", alt, "effort")


def _learned_picture(discrepancy: Discrepancy, effect: AddedEffect) -> Picture:
    joint, unit = effect.joints[0], unit_of(discrepancy, effect.joints[0])
    caption = f"Joint {joint}: what was learned over the range that the log has seen, with its 95 % band."
    alt = f"The effort learned in joint {joint}: {effect.formula}."
    return picture(learned_figure(effect, unit), f"learned{joint}", caption, alt)


def _candidate_picture(discrepancy: Discrepancy) -> Picture:
    scores = discrepancy.scores
    caption = (
        f"The first {min(TUNING.bars, len(scores))}, each by itself; blue: added. Dashed: what is needed to be added."
    )
    bars = "; ".join(
        f"{score_label(score)}: {rounded(score.gain / LN10)}" for score in best_first(scores)[: TUNING.bars]
    )
    return picture(candidate_figure(discrepancy), "candidates-figure", caption, f"Bars of log10 Bayes factors: {bars}")


# ---------------------------------------------------------------------------------------------------------------
# Several logs
# ---------------------------------------------------------------------------------------------------------------
@one_at_a_time
def comparison_page(comparison: LogComparison) -> str:
    """The report of several logs, in HTML: opens in a browser from anywhere, light or dark, and prints."""
    last = discrepancy_content(comparison.found[-1])
    said = columns(comparison)
    logs = log_names(comparison)
    both = CHANGED, ALL_ALONG
    content = last | {
        "lead": changes_lead(comparison),
        "about": [("Robot", comparison.earlier.model.robot.name), ("Logs", "; ".join(logs)), *_order(comparison)],
        "contents": _CHANGES | last["contents"],
        "status": {"colour": "", "text": _status(comparison)},
        "warnings": comparison.warnings,
        "columns": [(SECTIONS[which], said[which]) for which in both],
        "more": [(SECTIONS[which], lines) for which, lines in said.items() if lines and which not in both],
        "first": logs[0],
        "logs": logs,
        "histories": [_history(one) for one in comparison.effects if one.by_log],
        "rule": timeline_rule(comparison),
        "moved": [_moved(row) for row in moved_parameters(comparison)],
        "stayed": _stayed(comparison),
        "timeline_pictures": [_timeline_picture(comparison)],
        "last": logs[-1],
        "last_lead": last["lead"],
    }
    return render("comparison.html.jinja", "What changed since the first log", subject(comparison.found[-1]), **content)


def _status(comparison: LogComparison) -> str:
    """In a few words."""
    moved = bool(comparison.of(CHANGED) or comparison.timeline.moved.any() or comparison.of(GONE))
    along = "something was missing all along" if comparison.of(ALL_ALONG) else "nothing is known to be missing"
    return f"Something has changed, {along}" if moved else f"Nothing has surely changed, {along}"


def _order(comparison: LogComparison) -> list[tuple[str, str]]:
    return [("Order", comparison.dates.basis), ("Last one scored on", comparison.found[-1].holdout)]


def _history(history: EffectHistory) -> dict[str, Any]:
    return {
        "name": label(history.name),
        "joints": joints_in_words(history.joints).split(" ", 1)[1] if history.joints else "whole robot",
        "became": SECTIONS[history.became],
        "says": [says(what) for what in history.by_log],
    }


def _moved(row: Moved) -> dict[str, Any]:
    return {
        "name": row.name,
        "values": [
            (value, quantity(value, sd, row.unit)) if np.isfinite(sd) and np.isfinite(value) else None
            for value, sd in zip(row.value, row.sd, strict=True)
        ],
        "change": row.change,
        "z": [z for z in row.z if np.isfinite(z)][-1],
    }


def _stayed(comparison: LogComparison) -> dict[str, Any]:
    """Names of what did not move, and of what too few logs show."""
    line = comparison.timeline
    tested, moved = np.isfinite(line.p).any(axis=0), line.moved.any(axis=0)
    flat, unseen = np.flatnonzero(tested & ~moved).tolist(), np.flatnonzero(~tested).tolist()
    return {
        "flat": [tracked_name(line.tracked[c]) for c in flat],
        "unseen": [tracked_name(line.tracked[c]) for c in unseen],
    }


def _timeline_picture(comparison: LogComparison) -> Picture:
    rows = moved_parameters(comparison)
    over = "days since the first log" if by_date(comparison) else "the logs in their order"
    more = (
        f" The {len(rows) - TUNING.moved} that moved least are in the table alone." if len(rows) > TUNING.moved else ""
    )
    caption = (
        f"Parameters that moved, with 95 % intervals, over {over}.{more} Last: the changes of all others, in their "
        "standard deviations."
    )
    alt = "; ".join(row.text for row in rows) or "No parameter moved."
    return picture(timeline_figure(comparison), "timeline-figure", caption, f"Time line. {alt}")
