"""A discrepancy, or what changed over several logs, as one self-contained page: words, tables and figures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from markupsafe import Markup

from bayesid.discrepancy.comparison import CHANGED, PREEXISTING, ChangeReport
from bayesid.discrepancy.numbers import CHANGE_OF
from bayesid.discrepancy.selection import GROWN, HELD_BACK, ON_LOG
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.effects.catalogue import forms
from bayesid.number_text import percent, quantity
from bayesid.parallel import one_at_a_time
from bayesid.regression.selection.added_effect import AddedEffect
from bayesid.regression.selection.fitted_effects import LN10
from bayesid.regression.selection.hypotheses import Hypothesis
from bayesid.regression.selection.scores import Score
from bayesid.report.brief import in_brief
from bayesid.report.comparison import (
    SECTIONS,
    comparison_conclusion,
    evidence_in_words,
    log_names,
    moved_parameters,
    timeline_rule,
    tracked_name,
)
from bayesid.report.comparison import columns as change_columns
from bayesid.report.comparison import in_brief as changes_in_brief
from bayesid.report.discrepancy import (
    HOLDOUT,
    data_in_words,
    discrepancy_checks,
    discrepancy_conclusion,
    equivalents,
    listed_sets,
    new_model,
    over_the_floor,
    parameter_text,
    set_in_words,
    testable_groups,
)
from bayesid.report.pages import rendering as html
from bayesid.report.plot.discrepancy import (
    by_date,
    candidate_figure,
    effort_figure,
    gap_figure,
    learned_figure,
    residual_figure,
    timeline_figure,
)
from bayesid.report.tuning import TUNING
from bayesid.report.words import best_first, form_label, joints_in_words, label, score_label, unit_of, upper

_WORDS = {"not done": "not testable"}
"""Words for states of checks, if others than the states."""
_PLACES = {"Unexplained": "where", "Learned function": "left-out", "Noise floor": "gap", "Not testable": "not-testable"}
"""Sections with more on a check."""


@one_at_a_time
def discrepancy_page(discrepancy: Discrepancy) -> str:
    """The report of a comparison, in HTML: self-contained, light or dark, printable."""
    robot, log = discrepancy.identification.model.robot.name, discrepancy.identification.log.source
    conclusion = discrepancy_conclusion(discrepancy)
    return html.page(
        "What the model lacks",
        f"{robot}, {log}",
        (conclusion.state, conclusion.sentence),
        html.lines(in_brief(discrepancy)),
        [("Robot", robot), ("Log", log), ("Errors on", discrepancy.holdout)],
        discrepancy.warnings,
        _sections(discrepancy),
    )


def _sections(discrepancy: Discrepancy) -> list[html.Section]:
    made = [(name, title, part(discrepancy)) for (name, title), part in _PARTS.items()]
    return [html.section(name, title, *content) for name, title, content in made if content]


def _verdicts(discrepancy: Discrepancy) -> list[Markup]:
    checks = discrepancy_checks(discrepancy)
    return [html.lights(checks, _WORDS, _PLACES)] if checks else []


def _gaps(discrepancy: Discrepancy) -> list[Markup]:
    floor, before, after = discrepancy.floor, discrepancy.before, discrepancy.after
    unexplained, data = dict(discrepancy.unexplained), data_in_words(discrepancy)
    shown_on = {ON_LOG: "on the log", HELD_BACK: f"on {data}", GROWN: f"gap grew on {data}"}
    rows = []
    for j, joint in enumerate(range(1, len(before) + 1)):
        lasts = "; mostly correlated: model error or filtered noise" if floor.mostly_coloured[j] else ""
        origin = f"{floor.origin[j]}{'' if floor.reliable[j] else ' (a lower bound)'}{lasts}"
        remark = html.NONE
        if joint in unexplained:
            which = ", ".join(shown_on[kind] for kind in discrepancy.unexplained_on.get(joint, ()))
            ratio, where = over_the_floor(discrepancy, joint)
            on_log = Markup(" ({} times the floor)").format(html.number(ratio)) if where == "the log" else ""
            remark = Markup("unexplained {}{}").format(which, on_log)
        unit = unit_of(discrepancy, joint)
        efforts = [html.number(value[j], unit) for value in (before, after, floor.rms, floor.white)]
        rows.append((str(joint), *efforts, html.number(after[j] / floor.rms[j]), origin, remark))
    new = new_model(discrepancy)
    of_new = "extended by the effects found" if discrepancy.added else "refitted to both logs, without an added effect"
    caption = (
        f"Gap on {discrepancy.holdout}: RMS residual of the earlier model, and of that model {of_new}. Noise floor: "
        "the part that no model can explain. White noise: the part of the floor without correlation in time."
    )
    headings = ["Joint", "Earlier model", upper(new), "Noise floor", "White noise", f"{upper(new)} over floor"]
    headings += ["Floor estimated from", "Remark"]
    alt = "Bars of the gap of each joint, as in the table, in units of its noise floor."
    drawn = html.picture(gap_figure(discrepancy), "gap-figure", "The same in units of each joint's noise floor.", alt)
    return [html.table(caption, headings, rows), html.figures([drawn])]


def _found(discrepancy: Discrepancy) -> list[Markup]:
    if not discrepancy.added:
        return [html.paragraph("No effect was added.")]
    caption = (
        "Effects that were added, in this order, each given all others. A log10 Bayes factor of 2: the log is 100 "
        "times likelier with the effect. Fits equally well: effects that this log cannot distinguish from it; the "
        "first probability is of it or of one of these."
    )
    headings = [
        "Effect",
        "Joints",
        "Parameters",
        "log10 Bayes factor",
        "Probability of it or its equals",
        "Of no effect",
    ]
    headings += ["Of another effect", "Fits equally well", "Motion that distinguishes"]
    parts = [html.table(caption, headings, map(_added, discrepancy.added))]
    pictures = []
    for effect in discrepancy.added:
        if effect.hypothesis.curves:
            joint = effect.joints[0]
            below = f"Joint {joint}: learned function over the range of the log, with its 95 % band."
            figure = learned_figure(effect, unit_of(discrepancy, joint))
            pictures.append(html.picture(figure, f"learned{joint}", below))
    parts += [html.figures(pictures)] if pictures else []
    if sizes := [row for effect in discrepancy.added for row in _sizes(discrepancy, effect)]:
        caption = f"Effort of each effect on {discrepancy.holdout}, in the joint where it is largest."
        headings = ["Effect", "In joint", "Largest effort", "Share", "RMS effort"]
        parts.append(html.table(caption, headings, sizes))
    if costs := [row for effect in discrepancy.added for row in _costs(discrepancy, effect)]:
        caption = (
            f"RMS error on {discrepancy.holdout} without each effect (the others fitted again) and with it, in the "
            "joint where it rises most relative to the joint's RMS effort. Shares are of this effort."
        )
        headings = ["Effect", "In joint", "Error without it", "Share", "Error with it", "Share"]
        parts.append(html.table(caption, headings, costs))
    sets = [(set_in_words(each), html.probability(each.probability)) for each in listed_sets(discrepancy)]
    if len(sets) > 1:
        data = data_in_words(discrepancy)
        caption = f"Sets of effects that predict {data} equally well, and their probabilities given the log."
        parts.append(html.table(caption, ["Set", "Probability"], sets))
    return parts


def _added(effect: AddedEffect) -> tuple[str, ...]:
    alike = ", ".join(equivalents(effect, label))
    return (
        _name(effect.hypothesis),
        _joints(effect.joints),
        _parameters(effect),
        html.number(effect.log10_bayes_factor),
        *map(html.probability, (effect.probability, effect.nothing_missing, effect.something_else)),
        alike,
        effect.hypothesis.source.shown_by if alike else "",
    )


def _parameters(effect: AddedEffect) -> str:
    """A formula, readable quantities if the effect has some, or parameters; changes before and now."""
    if effect.description is not None:
        return f"{effect.formula}: {effect.description.sentence}"
    changes, parameters = bool(effect.hypothesis.changes), effect.parameters
    if effect.readable and not changes:
        named = [(name, value, quantity(value, sd, unit)) for name, (value, sd, unit) in effect.readable.items()]
    else:
        of_total = {f"{symbol}{j}" for symbol in effect.hypothesis.source.adds_to for j in effect.joints}
        in_total = any(name.startswith(CHANGE_OF) for name in parameters) and not changes
        shown = [name for name in parameters if not name.startswith(CHANGE_OF) and not (in_total and name in of_total)]
        named = [(name, parameters[name][0], parameter_text(effect, name)) for name in shown]
    line = Markup('<li><span class="name">{}</span> {}</li>')
    lines = [line.format(name, html.data(value, text)) for name, value, text in named]
    return Markup('<ul class="numbers">{}</ul>').format(Markup("").join(lines)) if lines else ""


def _sizes(discrepancy: Discrepancy, effect: AddedEffect) -> Iterator[tuple[str, ...]]:
    if (size := effect.size) is not None:
        unit = unit_of(discrepancy, size.joint)
        share = Markup("{} of its {}").format(html.share(size.share), size.of)
        yield (_of_joints(effect), str(size.joint), html.number(size.largest, unit), share, html.number(size.rms, unit))


def _costs(discrepancy: Discrepancy, effect: AddedEffect) -> Iterator[tuple[str, ...]]:
    if (cost := effect.cost) is not None:
        unit, shares = unit_of(discrepancy, cost.joint), (cost.share_before, cost.share_after)
        without, with_it = (html.number(error, unit) for error in (cost.before, cost.after))
        of_effort = [html.share(share) for share in shares]
        yield (_of_joints(effect), str(cost.joint), without, of_effort[0], with_it, of_effort[1])


def _where(discrepancy: Discrepancy) -> list[Markup]:
    data = data_in_words(discrepancy)
    if not discrepancy.where:
        plain = "In no joint is the residual significantly above the noise floor."
        if discrepancy.added:
            plain += f" The added effects are visible in the shape of the residual and on {data}."
        elif discrepancy.unexplained:
            plain += f" The residual on {data} shows that an effect is missing."
        return [html.paragraph(plain)]
    rows, drawn = [], []
    without = "" if data == HOLDOUT else f" without {data}"
    for excess in discrepancy.where:
        (low, high), unit = excess.range, unit_of(discrepancy, excess.joint, excess.variable)
        size = html.number(excess.excess, unit_of(discrepancy, excess.joint))
        span = Markup("{} to {}").format(html.number(low), html.number(high, unit))
        rows.append((str(excess.joint), size, excess.variable, span))
        below = f"Joint {excess.joint}: measured minus modelled effort over {excess.variable}."
        alt = f"{below} Earlier model and {new_model(discrepancy)}."
        drawn.append(html.picture(residual_figure(discrepancy, excess.joint), f"residual{excess.joint}", below, alt))
    caption = (
        f"Joints in which the earlier model exceeds the noise floor on the log{without}, its parameters adapted within "
        "their uncertainty. Excess: root of the mean square residual less that of the floor. Variable: that over which "
        "the residual varies most. Load: the model's effort in the joint."
    )
    note = "Points: samples, thinned. Lines: means with twice their standard error. Grey: noise floor."
    table = html.table(caption, ["Joint", "Excess", "Variable", "Range"], rows)
    return [table, html.figures(drawn), html.paragraph(note, note=True)]


def _efforts(discrepancy: Discrepancy) -> list[Markup]:
    unsigned = (np.flatnonzero(~np.asarray(discrepancy.trial.signals.signed)) + 1).tolist()
    note = "On the log that was compared."
    if unsigned:
        signs = f"measured efforts have the {new_model(discrepancy)}'s signs"
        note += f" The log has no signs in {joints_in_words(unsigned)}: {signs}."
    pictures = []
    for joint in range(1, len(discrepancy.before) + 1):
        alt = f"Effort of joint {joint} over time: measured, earlier model and {new_model(discrepancy)}."
        figure = effort_figure(discrepancy, joint)
        pictures.append(html.picture(figure, f"effort{joint}", f"Joint {joint}.", alt, "effort"))
    return [html.paragraph(note, note=True), html.figures(pictures)]


def _candidates(discrepancy: Discrepancy) -> list[Markup]:
    scores, needed = best_first(discrepancy.scores), discrepancy.thresholds.log10_bayes_factor
    if not scores:
        return [html.paragraph("No candidates were scored.")]
    weighed = (*discrepancy.refused, *discrepancy.added)
    given = {effect.hypothesis.key: effect.log10_bayes_factor for effect in weighed}
    places = {effect.hypothesis.key: place for place, effect in enumerate(discrepancy.added, start=1)}
    rows = [
        (
            *(str(rank), _without_form(score.hypothesis), _joints(score.hypothesis.joints)),
            *(html.number(score.gain / LN10), html.number(given.get(score.key, np.nan))),
            f"added as number {places[score.key]}" if score.key in places else _outcome(discrepancy, score),
        )
        for rank, score in enumerate(scores, start=1)
        if rank <= TUNING.candidates or score.key in places
    ]
    caption = (
        f"The best {min(TUNING.candidates, len(scores))} of {len(scores)} candidates, and all that were added. The "
        "log10 Bayes factor is that of each effect alone in its best form, added to the earlier model, and that given "
        f"the other added effects. An effect is added if the latter is at least {needed:g}, it lowers the squared "
        f"residual of a joint by at least {percent(discrepancy.thresholds.improvement, 0)} of the noise floor's, and "
        f"cross-validation on {data_in_words(discrepancy)} confirms it."
    )
    if not discrepancy.added:
        caption += (
            " Not selected: beside other tested effects it did not meet these conditions, or the search ended before it"
            " was tested."
        )
    headings = ["Rank", "Effect", "Joints", "log10 Bayes factor alone", "Given the others", "Outcome"]
    below = f"The first {len(scores[: TUNING.bars])}, each alone; blue: added. Dashed: threshold."
    alt = f"Bars of log10 Bayes factors, as in the table; the largest: {score_label(scores[0])}."
    drawn = html.picture(candidate_figure(discrepancy), "candidates-figure", below, alt)
    return [html.figures([drawn]), html.table(caption, headings, rows)]


def _outcome(discrepancy: Discrepancy, score: Score) -> str:
    if score.key in discrepancy.vetoed:
        return "not added: see below"
    if score.gain >= discrepancy.thresholds.log10_bayes_factor * LN10:
        if score.improvement <= discrepancy.thresholds.improvement:
            return "explains too little of the residual"
        return "not needed with the added effects" if discrepancy.added else "not selected"
    return "not testable with this log" if score.key in discrepancy.not_testable else "too weak"


def _left_out(discrepancy: Discrepancy) -> list[Markup]:
    names = []
    for effect in discrepancy.refused:
        learned = effect.description
        formula = "" if learned is None else f": {effect.formula}, {learned.sentence}"
        names.append(f"{label(effect.effect, effect.joints)}{formula}")
    why = (
        f"The log supports each of them, but cross-validation on {data_in_words(discrepancy)} does not confirm it, it "
        "explains too little of the residual, or another set of effects does as well."
    )
    return [html.paragraph(why), html.items(names)] if names else []


def _not_testable(discrepancy: Discrepancy) -> list[Markup]:
    groups = testable_groups(discrepancy)
    rows = [(label(effect), _joints(joints), forms()[effect].shown_by) for effect, joints in groups]
    caption = "Effects that this log could not show if they had a usual size, and motions that would show them."
    return [html.table(caption, ["Effect", "Joints", "Motion that would show it"], rows)] if rows else []


_PARTS: Mapping[tuple[str, str], Callable[[Discrepancy], list[Markup]]] = {
    ("findings", "Checks"): _verdicts,
    ("gap", "The gap"): _gaps,
    ("found", "Effects found"): _found,
    ("where", "Where the earlier model fails"): _where,
    ("efforts", "Measured and modelled efforts"): _efforts,
    ("candidates", "Candidates"): _candidates,
    ("left-out", "Not added"): _left_out,
    ("not-testable", "Not testable with this log"): _not_testable,
}
"""Names, titles and contents of the sections, in their order; those without content are left out."""


def _joints(joints: Sequence[int]) -> str:
    return joints_in_words(joints).split(" ", 1)[1] if joints else "whole robot"


def _name(hypothesis: Hypothesis) -> str:
    return form_label(hypothesis.source.name, *(["changed"] if hypothesis.changes else []))


def _of_joints(effect: AddedEffect) -> str:
    return f"{_name(effect.hypothesis)}{f', {joints_in_words(effect.joints)}' if effect.joints else ''}"


def _without_form(hypothesis: Hypothesis) -> str:
    return form_label(hypothesis.effect, *(["changed"] if hypothesis.changes else []))


@one_at_a_time
def comparison_page(comparison: ChangeReport) -> str:
    """The report of several logs, in HTML: self-contained, light or dark, printable."""
    last, logs, conclusion = comparison.found[-1], log_names(comparison), comparison_conclusion(comparison)
    robot = comparison.earlier.model.robot.name
    basis = [("Order", comparison.dates.basis), ("Errors of the last on", last.holdout)]
    first = html.section("last", f"{logs[-1]} against the first log's model", html.lines(in_brief(last)))
    return html.page(
        "What changed since the first log",
        f"{robot}, {last.identification.log.source}",
        (conclusion.state, conclusion.sentence),
        html.lines(changes_in_brief(comparison)),
        [("Robot", robot), ("Logs", "; ".join(logs)), *basis],
        comparison.warnings,
        [_changes(comparison), _timeline(comparison), first, *_sections(last)],
    )


def _changes(comparison: ChangeReport) -> html.Section:
    lists = [
        (SECTIONS[status], lines)
        for status, lines in change_columns(comparison).items()
        if lines or status in (CHANGED, PREEXISTING)
    ]
    rows = [
        (label(effect.name), _joints(effect.joints), *map(evidence_in_words, effect.by_log), SECTIONS[effect.status])
        for effect in comparison.effects
        if effect.by_log
    ]
    caption = (
        "Additional effects in each log alone: present (log10 Bayes factor given all others), absent, or undetermined."
    )
    headings = ["Effect", "Joints", *log_names(comparison), "Result"]
    more = [html.table(caption, headings, rows)] if rows else []
    return html.section("changes", "What changed, and what is missing in all logs", html.columns(lists, "None."), *more)


def _timeline(comparison: ChangeReport) -> html.Section:
    moved, rule, line = moved_parameters(comparison), timeline_rule(comparison), comparison.timeline
    rows = [
        (
            row.name,
            *(
                html.data(value, quantity(value, sd, row.unit)) if np.isfinite(sd) and np.isfinite(value) else html.NONE
                for value, sd in zip(row.value, row.sd, strict=True)
            ),
            row.change,
            html.number([z for z in row.z if np.isfinite(z)][-1]),
        )
        for row in moved
    ]
    caption = f"Parameters that changed; each log is identified alone, with one model. {rule}"
    headings = ["Parameter", *log_names(comparison), "Change", "Change / its sd"]
    tested = np.isfinite(line.p).any(axis=0)
    flat, unseen = (
        [tracked_name(line.tracked[c]) for c in np.flatnonzero(which)]
        for which in (tested & ~line.moved.any(axis=0), ~tested)
    )
    stayed = Markup(
        '<details><summary>{} parameters without a significant change</summary><p class="note">{}.</p></details>'
    )
    return html.section(
        "timeline",
        "Time line",
        html.table(caption, headings, rows) if rows else html.paragraph(f"No parameter changed. {rule}"),
        html.figures([_timeline_picture(comparison, [row.text for row in moved])]),
        stayed.format(len(flat), html.typeset("; ".join(flat))),
        *([html.paragraph(f"Shown by too few logs: {'; '.join(unseen)}.", note=True)] if unseen else []),
    )


def _timeline_picture(comparison: ChangeReport, texts: Sequence[str]) -> html.Picture:
    over = "days since the first log" if by_date(comparison) else "the logs in their order"
    few = len(texts) - TUNING.moved
    caption = (
        f"Parameters that changed, with 95 % intervals, over {over}."
        f"{f' The {few} that changed least are only in the table.' if few > 0 else ''} Last panel: changes of all "
        "others, in standard deviations."
    )
    alt = "; ".join(texts) or "No parameter changed."
    return html.picture(timeline_figure(comparison), "timeline-figure", caption, f"Time line. {alt}")
