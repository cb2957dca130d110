"""A discrepancy as one self-contained page: words, tables and figures; nothing is fetched, nothing runs."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from bayesid.discrepancy.evidence import LN10
from bayesid.discrepancy.hypotheses import kind_of
from bayesid.discrepancy.scores import THRESHOLD, Score
from bayesid.discrepancy.workflow import Discrepancy, Found
from bayesid.plot.discrepancy import BARS, candidate_figure, effort_figure, gap_figure, residual_figure
from bayesid.plot.svg import inline_svg
from bayesid.report import html
from bayesid.report.html import NONE, typeset
from bayesid.report.words import (
    best_first,
    joints_in_words,
    label,
    listed,
    paragraph,
    quantity,
    rounded,
    score_label,
    testable_groups,
    told_apart,
    unit_of,
)

_STATUS = {
    "no_discrepancy": "Nothing is missing",
    "explained": "Explained: what was missing is found",
    "unexplained": "Not explained: something is still missing",
}
_CANDIDATES = 25


def discrepancy_page(discrepancy: Discrepancy) -> str:
    """The report of a comparison, in HTML: opens in a browser from anywhere, light or dark, and prints."""
    title = "What the model lacks"
    sections = [
        _gap(discrepancy),
        _found(discrepancy),
        _where(discrepancy),
        _efforts(discrepancy),
        _candidates(discrepancy),
        _left_out(discrepancy),
        _not_testable(discrepancy),
    ]
    return html.page(
        title,
        discrepancy.identification.model.robot.name,
        [
            f'<p class="status {discrepancy.status}">{_STATUS[discrepancy.status]}</p>',
            f'<p class="lead">{typeset(paragraph(discrepancy))}</p>',
            _about(discrepancy),
            html.warnings(discrepancy.warnings),
        ],
        sections,
    )


# ---------------------------------------------------------------------------------------------------------------
# Sections
# ---------------------------------------------------------------------------------------------------------------
def _about(discrepancy: Discrepancy) -> str:
    log = discrepancy.identification.log
    told = [
        ("Robot", discrepancy.identification.model.robot.name),
        ("Log", log.source),
        ("Scored on", discrepancy.holdout),
    ]
    return html.about(told)


def _gap(discrepancy: Discrepancy) -> str:
    floor, left = discrepancy.floor, dict(discrepancy.unexplained)
    rows = []
    for j, (before, after) in enumerate(zip(discrepancy.before, discrepancy.after, strict=True)):
        unit = unit_of(discrepancy, j + 1)
        rows.append([
            f"{j + 1}",
            html.number(before, unit),
            html.number(after, unit),
            html.number(floor.rms[j], unit),
            html.number(after / floor.rms[j]),
            escape(floor.origin[j]) + ("" if floor.sharp[j] else " (a lower bound)"),
            f"unexplained: on the log {html.number(left[j + 1])} times the floor" if j + 1 in left else NONE,
        ])  # fmt: skip
    told = (
        f"Gap on {discrepancy.holdout}: root mean square of what the model leaves of the efforts, as it was and "
        "extended, and the noise floor, which no model can fall below for long."
    )
    headings = ["Joint", "As it was", "Extended", "Noise floor", "Extended / floor", "Floor taken from", "Remark"]
    alt = "; ".join(
        f"joint {j + 1}: {rounded(float(b))} before, {rounded(float(a))} after, floor {rounded(float(f))}"
        for j, (b, a, f) in enumerate(zip(discrepancy.before, discrepancy.after, floor.rms, strict=True))
    )
    svg = inline_svg(gap_figure(discrepancy), "gap", f"Bars of the gap of each joint in N m: {alt}")
    picture = html.figure(svg, "The same in units of each joint's noise floor.")
    return html.section("gap", "The gap", html.table(told, headings, rows) + html.figures([picture]))


def _found(discrepancy: Discrepancy) -> str:
    if not discrepancy.found:
        return html.section("found", "What was found", "<p>No effect was added.</p>")
    headings = [
        "Effect", "Joints", "Parameters", "log10 Bayes factor", "Probability", "Nothing missing", "Something else",
        "Not told from", "What would tell",
    ]  # fmt: skip
    told = (
        "Effects that were added, in this order. The Bayes factor is for the effect against its absence, the others "
        "given; the probabilities are of this effect, of nothing missing in its place, and of an effect outside of the "
        "catalogue."
    )
    rows = [
        [
            _effect(one.effect, one.verdict.hypothesis.source.name, bool(one.verdict.hypothesis.changes)),
            _joints(one.joints),
            _parameters(one),
            html.number(one.verdict.gain / LN10),
            html.probability(one.verdict.probability),
            html.probability(one.verdict.nothing),
            html.probability(one.verdict.something_else),
            escape(", ".join(label(name) for name in one.verdict.equivalent)) or NONE,
            typeset(told_apart(one)) if one.verdict.equivalent else NONE,
        ]
        for one in discrepancy.found
    ]
    return html.section("found", "What was found", html.table(told, headings, rows))


def _parameters(one: Found) -> str:
    if not one.parameters:
        return NONE
    items = [
        f'<li><span class="name">{escape(name)}</span> {html.data(value, quantity(float(value), float(sd), unit))}</li>'
        for name, (value, sd, unit) in one.parameters.items()
    ]
    return '<ul class="numbers">' + "".join(items) + "</ul>"


def _where(discrepancy: Discrepancy) -> str:
    title = "Where the model as it was fails"
    if not discrepancy.where:
        return html.section("where", title, "<p>In no joint does it leave more than the noise floor.</p>")
    rows, pictures = [], []
    for one in discrepancy.where:
        unit = unit_of(discrepancy, one.joint, one.variable)
        low, high = one.range
        rows.append([
            f"{one.joint}",
            html.number(one.excess, unit_of(discrepancy, one.joint)),
            escape(one.variable),
            f"{html.number(low)} to {html.number(high, unit)}",
        ])  # fmt: skip
        alt = (
            f"Residual of joint {one.joint} over {one.variable}, of the model as it was and of the extended model. As "
            f"it was, it exceeds the noise floor by {rounded(one.excess)} {unit_of(discrepancy, one.joint)}, most of "
            f"it between {rounded(low)} and {rounded(high)} {unit}."
        )
        svg = inline_svg(residual_figure(discrepancy, one.joint), f"residual{one.joint}", alt)
        pictures.append(html.figure(svg, f"Joint {one.joint}: measured minus modelled effort over {one.variable}."))
    told = (
        "Joints in which the model as it was exceeds the noise floor on the log, by how much (root mean square), over "
        "which variable it shows best, and where most of it lies."
    )
    note = (
        '<p class="note">Points are samples of the log, thinned; the lines are means over equally many samples, with '
        "twice their standard error (samples taken as independent); the grey band is the noise floor.</p>"
    )
    table = html.table(told, ["Joint", "Excess", "Variable", "Range"], rows)
    return html.section("where", title, table + html.figures(pictures) + note)


def _efforts(discrepancy: Discrepancy) -> str:
    pictures = []
    for j in range(len(discrepancy.before)):
        alt = f"Effort of joint {j + 1} over time: measured, by the model as it was, and by the extended model."
        svg = inline_svg(effort_figure(discrepancy, j + 1), f"effort{j + 1}", alt)
        pictures.append(html.figure(svg, f"Joint {j + 1}."))
    unsigned = np.flatnonzero(~np.asarray(discrepancy.trial.signals.signed)) + 1
    signs = (
        f" The log has no signs in {joints_in_words(unsigned.tolist())}: there measured efforts have those of the "
        "extended model."
        if len(unsigned)
        else ""
    )
    note = f'<p class="note">On the log that was compared.{escape(signs)}</p>'
    return html.section("efforts", "Measured and modelled efforts", note + html.figures(pictures))


def _candidates(discrepancy: Discrepancy) -> str:
    scores = discrepancy.scores
    if not scores:
        return html.section("candidates", "Candidates", "<p>No candidates were scored.</p>")
    found = {(one.effect, one.joints) for one in discrepancy.found}
    rows = [
        [f"{i}", *_candidate(score, score.key in found)]
        for i, score in enumerate(best_first(scores)[:_CANDIDATES], start=1)
    ]
    told = (
        f"The best {len(rows)} of {len(scores)} candidates, each added by itself to the model as it was. To be added, "
        f"an effect needs a log10 Bayes factor of {THRESHOLD:g} and must be worth it; what explains the same as a "
        "better one no longer does once that is added. The last columns hold what an effect of a usual size would have "
        "reached, and the effect's worth: by how much it lowers a joint's mean squared residual, in units of the noise "
        "floor's or, where much more is left, of a part of that."
    )
    headings = ["Rank", "Effect", "Joints", "log10 Bayes factor", "Added", "Of a usual size", "Worth"]
    alt = "; ".join(f"{score_label(score)}: {rounded(score.gain / LN10)}" for score in best_first(scores)[:BARS])
    svg = inline_svg(candidate_figure(discrepancy), "candidates", f"Bars of log10 Bayes factors: {alt}")
    picture = html.figure(
        svg, f"The first {min(BARS, len(scores))}; blue: added. The dashed line is what an effect needs to be added."
    )
    return html.section("candidates", "Candidates", html.figures([picture]) + html.table(told, headings, rows))


def _candidate(score: Score, added: bool) -> list[str]:
    others = f" with {listed([label(one.effect) for one in score.company])}" if score.company else ""
    return [
        _effect(score.hypothesis.effect, score.hypothesis.source.name, bool(score.hypothesis.changes)) + escape(others),
        _joints(score.hypothesis.joints),
        html.number(score.gain / LN10),
        "yes" if added else "no",
        html.number(score.visible / LN10),
        html.number(score.worth),
    ]


def _left_out(discrepancy: Discrepancy) -> str:
    if not discrepancy.vetoed:
        return ""
    items = "".join(f"<li>{escape(label(effect, joints))}</li>" for effect, joints in discrepancy.vetoed)
    said = "They explain the log, but no data that had no say in choosing them, or too little of what was missing."
    return html.section("left-out", "Left out", f"<p>{said}</p><ul>{items}</ul>")


def _not_testable(discrepancy: Discrepancy) -> str:
    groups = testable_groups(discrepancy)
    if not groups:
        return ""
    rows = [[escape(label(effect)), _joints(joints), typeset(kind_of(effect).told_by)] for effect, joints in groups]
    told = "Effects that this log could not show even if they were of a usual size, and motions that would show them."
    table = html.table(told, ["Effect", "Joints", "Motion that would show it"], rows)
    return html.section("not-testable", "What this log cannot tell", table)


def _joints(joints: Sequence[int]) -> str:
    return escape(joints_in_words(joints).split(" ", 1)[1]) if joints else "whole robot"


def _effect(effect: str, form: str, change: bool) -> str:
    """Its name, which form of it, and whether it is a change of what the model has."""
    told = [form.split(".", 1)[1].replace("_", " ")] if "." in form else []
    told += ["changed"] if change else []
    remarks = ", ".join(told)
    return escape(f"{label(effect)} ({remarks})" if told else label(effect))
