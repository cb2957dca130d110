"""A discrepancy as one self-contained page: words, tables and figures; nothing is fetched, nothing runs."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib.metadata import version

import numpy as np

from bayesid.discrepancy.evidence import LN10
from bayesid.discrepancy.hypotheses import kind_of
from bayesid.discrepancy.scores import THRESHOLD, Score
from bayesid.discrepancy.workflow import Discrepancy, Found
from bayesid.report.figures import BARS, candidate_figure, effort_figure, gap_figure, inline_svg, residual_figure
from bayesid.report.page_style import STYLE
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
_NONE = '<span class="none" aria-label="none">&ndash;</span>'


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
    return "\n".join([
        "<!DOCTYPE html>",
        '<html lang="en">',
        "<head>",
        '<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<meta name="color-scheme" content="light dark">',
        f"<title>{title}: {escape(discrepancy.identification.model.robot.name)}</title>",
        f"<style>{STYLE}</style>",
        "</head>",
        "<body>",
        "<main>",
        "<header>",
        f"<h1>{title}</h1>",
        f'<p class="status {discrepancy.status}">{_STATUS[discrepancy.status]}</p>',
        f'<p class="lead">{typeset(paragraph(discrepancy))}</p>',
        _about(discrepancy),
        _warnings(discrepancy),
        "</header>",
        *sections,
        f"<footer><p>bayesid {escape(version('bayesid'))}. Joints count from 1. Numbers after &plusmn; are standard "
        "deviations.</p></footer>",
        "</main>",
        "</body>",
        "</html>",
        "",
    ])  # fmt: skip


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
    rows = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in told)
    return f'<dl class="about">{rows}</dl>'


def _warnings(discrepancy: Discrepancy) -> str:
    if not discrepancy.warnings:
        return ""
    items = "".join(f"<li>{escape(warning)}</li>" for warning in discrepancy.warnings)
    return f'<aside class="warnings" aria-label="Warnings"><h2>Warnings</h2><ul>{items}</ul></aside>'


def _gap(discrepancy: Discrepancy) -> str:
    floor, left = discrepancy.floor, dict(discrepancy.unexplained)
    rows = []
    for j, (before, after) in enumerate(zip(discrepancy.before, discrepancy.after, strict=True)):
        unit = unit_of(discrepancy, j + 1)
        rows.append([
            f"{j + 1}",
            _number(before, unit),
            _number(after, unit),
            _number(floor.rms[j], unit),
            _number(after / floor.rms[j]),
            escape(floor.origin[j]) + ("" if floor.sharp[j] else " (a lower bound)"),
            f"unexplained: on the log {_number(left[j + 1])} times the floor" if j + 1 in left else _NONE,
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
    picture = _figure(svg, "The same in units of each joint's noise floor.")
    return _section("gap", "The gap", _table(told, headings, rows) + _figures([picture]))


def _found(discrepancy: Discrepancy) -> str:
    if not discrepancy.found:
        return _section("found", "What was found", "<p>No effect was added.</p>")
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
            _number(one.verdict.gain / LN10),
            _probability(one.verdict.probability),
            _probability(one.verdict.nothing),
            _probability(one.verdict.something_else),
            escape(", ".join(label(name) for name in one.verdict.equivalent)) or _NONE,
            typeset(told_apart(one)) if one.verdict.equivalent else _NONE,
        ]
        for one in discrepancy.found
    ]
    return _section("found", "What was found", _table(told, headings, rows))


def _parameters(one: Found) -> str:
    if not one.parameters:
        return _NONE
    items = [
        f'<li><span class="name">{escape(name)}</span> {_data(value, quantity(float(value), float(sd), unit))}</li>'
        for name, (value, sd, unit) in one.parameters.items()
    ]
    return '<ul class="numbers">' + "".join(items) + "</ul>"


def _where(discrepancy: Discrepancy) -> str:
    title = "Where the model as it was fails"
    if not discrepancy.where:
        return _section("where", title, "<p>In no joint does it leave more than the noise floor.</p>")
    rows, pictures = [], []
    for one in discrepancy.where:
        unit = unit_of(discrepancy, one.joint, one.variable)
        low, high = one.range
        rows.append([
            f"{one.joint}",
            _number(one.excess, unit_of(discrepancy, one.joint)),
            escape(one.variable),
            f"{_number(low)} to {_number(high, unit)}",
        ])  # fmt: skip
        alt = (
            f"Residual of joint {one.joint} over {one.variable}, of the model as it was and of the extended model. As "
            f"it was, it exceeds the noise floor by {rounded(one.excess)} {unit_of(discrepancy, one.joint)}, most of "
            f"it between {rounded(low)} and {rounded(high)} {unit}."
        )
        svg = inline_svg(residual_figure(discrepancy, one.joint), f"residual{one.joint}", alt)
        pictures.append(_figure(svg, f"Joint {one.joint}: measured minus modelled effort over {one.variable}."))
    told = (
        "Joints in which the model as it was exceeds the noise floor on the log, by how much (root mean square), over "
        "which variable it shows best, and where most of it lies."
    )
    note = (
        '<p class="note">Points are samples of the log, thinned; the lines are means over equally many samples, with '
        "twice their standard error (samples taken as independent); the grey band is the noise floor.</p>"
    )
    table = _table(told, ["Joint", "Excess", "Variable", "Range"], rows)
    return _section("where", title, table + _figures(pictures) + note)


def _efforts(discrepancy: Discrepancy) -> str:
    pictures = []
    for j in range(len(discrepancy.before)):
        alt = f"Effort of joint {j + 1} over time: measured, by the model as it was, and by the extended model."
        svg = inline_svg(effort_figure(discrepancy, j + 1), f"effort{j + 1}", alt)
        pictures.append(_figure(svg, f"Joint {j + 1}."))
    unsigned = np.flatnonzero(~np.asarray(discrepancy.trial.signals.signed)) + 1
    signs = (
        f" The log has no signs in {joints_in_words(unsigned.tolist())}: there measured efforts have those of the "
        "extended model."
        if len(unsigned)
        else ""
    )
    note = f'<p class="note">On the log that was compared.{escape(signs)}</p>'
    return _section("efforts", "Measured and modelled efforts", note + _figures(pictures))


def _candidates(discrepancy: Discrepancy) -> str:
    scores = discrepancy.scores
    if not scores:
        return _section("candidates", "Candidates", "<p>No candidates were scored.</p>")
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
    picture = _figure(
        svg, f"The first {min(BARS, len(scores))}; blue: added. The dashed line is what an effect needs to be added."
    )
    return _section("candidates", "Candidates", _figures([picture]) + _table(told, headings, rows))


def _candidate(score: Score, added: bool) -> list[str]:
    others = f" with {listed([label(one.effect) for one in score.company])}" if score.company else ""
    return [
        _effect(score.hypothesis.effect, score.hypothesis.source.name, bool(score.hypothesis.changes)) + escape(others),
        _joints(score.hypothesis.joints),
        _number(score.gain / LN10),
        "yes" if added else "no",
        _number(score.visible / LN10),
        _number(score.worth),
    ]


def _left_out(discrepancy: Discrepancy) -> str:
    if not discrepancy.vetoed:
        return ""
    items = "".join(f"<li>{escape(label(effect, joints))}</li>" for effect, joints in discrepancy.vetoed)
    said = "They explain the log, but no data that had no say in choosing them, or too little of what was missing."
    return _section("left-out", "Left out", f"<p>{said}</p><ul>{items}</ul>")


def _not_testable(discrepancy: Discrepancy) -> str:
    groups = testable_groups(discrepancy)
    if not groups:
        return ""
    rows = [[escape(label(effect)), _joints(joints), typeset(kind_of(effect).told_by)] for effect, joints in groups]
    told = "Effects that this log could not show even if they were of a usual size, and motions that would show them."
    table = _table(told, ["Effect", "Joints", "Motion that would show it"], rows)
    return _section("not-testable", "What this log cannot tell", table)


# ---------------------------------------------------------------------------------------------------------------
# Elements
# ---------------------------------------------------------------------------------------------------------------
def typeset(text: str) -> str:
    """Escaped, with the signs that plain text lacks."""
    text = escape(text).replace(" +- ", "&nbsp;&plusmn;&nbsp;").replace("^2", "&sup2;").replace("^3", "&sup3;")
    text = re.sub(r"\b(N|kg) (m|s)\b", r"\1&nbsp;\2", text)
    return re.sub(r"(?<![\w)])-(?=\d)", "&minus;", text)


def _section(name: str, title: str, content: str) -> str:
    head = f'<h2 id="{name}-title">{escape(title)}</h2>'
    return f'<section id="{name}" aria-labelledby="{name}-title">{head}{content}</section>'


def _table(told: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Cells are HTML, everything else is text; the first column heads its row."""
    head = "".join(f'<th scope="col">{escape(heading)}</th>' for heading in headings)
    body = "".join(
        f'<tr><th scope="row">{first}</th>' + "".join(f"<td>{cell}</td>" for cell in others) + "</tr>"
        for first, *others in rows
    )
    name = escape(", ".join(headings))
    return (
        f'<div class="table" role="region" tabindex="0" aria-label="{name}"><table><caption>{escape(told)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _figure(svg: str, told: str) -> str:
    return f"<figure>{svg}<figcaption>{escape(told)}</figcaption></figure>"


def _figures(pictures: Iterable[str]) -> str:
    return '<div class="figures">' + "".join(pictures) + "</div>"


def _number(value: float, unit: str = "") -> str:
    """For people to three digits, for machines exactly."""
    if np.isnan(value):
        return _NONE
    return _data(value, f"unlimited {unit}" if np.isposinf(value) else f"{rounded(float(value))} {unit}")


def _probability(value: float) -> str:
    return _data(value, f"{value:.3f}")


def _data(value: float, told: str) -> str:
    return f'<data value="{float(value)!r}">{typeset(told.rstrip())}</data>'


def _joints(joints: Sequence[int]) -> str:
    return escape(joints_in_words(joints).split(" ", 1)[1]) if joints else "whole robot"


def _effect(effect: str, form: str, change: bool) -> str:
    """Its name, which form of it, and whether it is a change of what the model has."""
    told = [form.split(".", 1)[1].replace("_", " ")] if "." in form else []
    told += ["changed"] if change else []
    remarks = ", ".join(told)
    return escape(f"{label(effect)} ({remarks})" if told else label(effect))
