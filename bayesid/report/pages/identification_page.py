"""An identification as one self-contained page: checks, figures and tables; nothing is fetched."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping

import numpy as np
from markupsafe import Markup

from bayesid.identification.checks import State, convergence
from bayesid.identification.identification import SURE, Identification
from bayesid.identification.tuning import TUNING as IDENTIFICATION
from bayesid.number_text import percent, quantity
from bayesid.parallel import one_at_a_time
from bayesid.progress import SILENT, Progress
from bayesid.report import commands
from bayesid.report.conclusion import conclude
from bayesid.report.pages import rendering as html
from bayesid.report.plot.drawing import draw, svg_of
from bayesid.report.plot.figure import WIDE, Figure, Panel
from bayesid.report.plot.identification import (
    VARIABLES,
    alternatives_figure,
    autocorrelation_panel,
    residual_panel,
    torque_panel,
    validation_panel,
)
from bayesid.report.plot.posterior import forest_figure, pair_figure, rank_figure, trace_figure
from bayesid.report.report_data import Alternatives, ReportData, SegmentTable, report_data
from bayesid.report.summary import shown_rows
from bayesid.report.tables import (
    CONSTRAINT_HEADINGS,
    EFFECT_HEADINGS,
    GAIN_HEADINGS,
    constraint_rows,
    effect_rows,
    gain_rows,
)
from bayesid.report.tuning import TUNING
from bayesid.report.verdicts import check_findings, sure_share
from bayesid.report.words import joints_in_words, listed, upper

_NOTEBOOK: Mapping[State, str] = {"good": "#1f7a3d", "look": "#8a5a00", "bad": "#b3261e", "not done": "#59636e"}
"""Colours as in style.css; a notebook has no style of ours."""
_SHOWS = {
    "run": ("Robot file",),
    "coefficients": ("Excitation", "Intervals", "Data or prior"),
    "doubts": ("Signs of the segments",),
    "torques": ("Low-pass after the rectifier",),
    "proof": ("Proof",),
    "posterior": ("Sampling", "Modes"),
    "residuals": ("Fit", "Whiteness of the residual"),
    "effects": ("Additional effects",),
    "gains": ("Gains",),
    "validation": ("Validation",),
    "warnings": ("Warnings",),
}
"""Sections, and the checks that link to them."""


@one_at_a_time
def identification_page(findings: ReportData, progress: Progress = SILENT) -> str:
    """The report of an identification, in HTML: opens in a browser from anywhere, light or dark, and prints.

    Args:
        findings: what there is to show.
        progress: of the sections.
    """
    checks, summary = check_findings(findings), findings.summary
    sections: list[html.Section] = []
    with progress.stage("report") as steps:
        for done, ((name, title), part) in enumerate(_PARTS.items(), start=1):
            sections += [html.section(name, title, *content)] if (content := part(findings)) else []
            steps(done, len(_PARTS))
    there = {*(section.name for section in sections), *(["warnings"] if summary.warnings else [])}
    places = {check: place for place, names in _SHOWS.items() if place in there for check in names}
    conclusion = conclude(checks)
    return html.page(
        "Identification",
        f"{summary.robot}, {summary.log}",
        (html.COLOURS[conclusion.state], conclusion.sentence),
        _lead(findings),
        _about(findings),
        summary.warnings,
        [html.section("checks", "Checks", html.lights(checks, {}, places)), *sections],
    )


def _lead(findings: ReportData) -> str:
    summary, share = findings.summary, np.array(findings.summary.fit.relative_residual, dtype=float)
    n, hidden = findings.n_joints, summary.hidden_joints
    known = int((findings.coefficients.relative_sd < TUNING.well_known).sum())
    signs = (
        f"The signs were hidden in {'all' if hidden == n else f'{hidden} of {n}'} joints. The sign is now at least "
        f"{percent(SURE, 0)} certain for {percent(sure_share(findings), 1)} of the |effort|. "
        if hidden
        else "All signs were known. "
    )
    return (
        f"{signs}{summary.n_coefficients} dynamic coefficients were identified, {known} of them to "
        f"{percent(TUNING.well_known, 0)} (sd). The relative residual per joint is {percent(share.min(), 1)} to "
        f"{percent(share.max(), 1)}."
    )


def _about(findings: ReportData) -> list[tuple[str, str]]:
    summary = findings.summary
    return [
        ("Robot", summary.robot),
        ("Log", f"{summary.log}, {summary.n_samples} rows, {findings.samples.t[-1]:.4g} s"),
        *[("Payload", f"{part.payload}, carried in {part.source}") for part in summary.logs if part.payload],
        ("Terms", ", ".join([*summary.terms, *summary.distortions])),
        ("Run", summary.provenance.date),
    ]


def _torques(findings: ReportData) -> list[Markup]:
    every = findings.samples.every
    bands = (
        "Blue bands: segments with sign plus; orange: minus; paler bands are less certain. Hatched bands and question "
        "marks: ambiguous. Drag over a figure to zoom into a range, double-click to see all."
    )
    signs = f", with the signs found, and of the model. {bands}"
    curves = signs if findings.summary.hidden_joints else ", and of the model. Blue bands: plus; orange: minus."
    thinned = "" if every == 1 else f" One of {every} samples is shown."
    drawn = _over_time(findings, torque_panel, "torque", "recorded, with signs, and of the model.")
    return [html.paragraph(f"Efforts as recorded{curves}{thinned}", note=True), drawn]


def _over_time(findings: ReportData, panel: Callable[[ReportData, int, int], Panel], group: str, shows: str) -> Markup:
    """A group of figures, one a joint; the legend above the first one is that of all."""
    pictures = []
    for joint in range(1, findings.n_joints + 1):
        figure = Figure([[panel(findings, joint, TUNING.page_curve)]], 2.6, WIDE, key=joint == 1)
        alt = f"Effort of joint {joint} over time: {shows}"
        pictures.append(html.picture(figure, f"{group}{joint}", f"Joint {joint}.", alt, group))
    return html.figures(pictures, linked=True)


def _doubts(findings: ReportData) -> list[Markup]:
    segments, size = findings.segments, findings.segment_size
    doubtful = np.flatnonzero(segments.ambiguous & segments.moving)
    largest = doubtful[np.argsort(-size[doubtful], kind="stable")][: TUNING.doubts]
    rows = [
        (
            str(segments.joint[k] + 1),
            _link(segments, k, f"{segments.start[k]:.2f} to {segments.end[k]:.2f} s"),
            "+" if segments.sign[k] > 0 else Markup("&minus;"),
            html.data(segments.confidence[k], f"{segments.confidence[k]:.2f}"),
            html.share(size[k]),
        )
        for k in largest
    ]
    which = "Segments" if len(rows) == len(doubtful) else f"The {len(rows)} largest of {len(doubtful)} segments"
    caption = f"{which} in motion with an ambiguous sign, by their largest |effort|; the fit averages over both signs."
    headings = "Joint", "Time", "Likelier sign", "Confidence", "Largest |effort| / joint's"
    table = html.table(caption, headings, rows) if rows else html.paragraph("No segment in motion is ambiguous.")
    still = int((segments.ambiguous & ~segments.moving).sum())
    note = f"At standstill {still} of {int((~segments.moving).sum())} segments are ambiguous; they are not fitted."
    return [table, *([html.paragraph(note, note=True)] if still else [])]


def _link(of: SegmentTable | Alternatives, k: int, text: str) -> Markup:
    """A link from a stretch of time to its figure."""
    link = Markup('<a href="#torque{}" data-from="{:.4f}" data-to="{:.4f}">{}</a>')
    return link.format(int(of.joint[k]) + 1, float(of.start[k]), float(of.end[k]), text)


def _effects(findings: ReportData) -> list[Markup]:
    rows = effect_rows(findings.summary)
    caption = "Additional effects, confirmed by Bayes factor and by held-back blocks; each given all the others."
    return [html.table(caption, list(map(upper, EFFECT_HEADINGS)), rows)] if rows else []


def _gains(findings: ReportData) -> list[Markup]:
    rows = gain_rows(findings.summary)
    caption = (
        "Estimated gains. Data decide the ratio of a gain to the others if its variance is at most a tenth of the "
        "stated one. The common factor is in the checks."
    )
    return [html.table(caption, list(map(upper, GAIN_HEADINGS)), rows)] if rows else []


def _constraints(findings: ReportData) -> list[Markup]:
    rows = constraint_rows(findings.summary)
    caption = (
        "Stated constraints. Cost: gain in log-likelihood without this constraint; above "
        f"{IDENTIFICATION.contradicted_constraint:.1f} nats the log contradicts it. A draw is at the edge within a "
        "tenth of the standard deviation of its distance."
    )
    return [html.table(caption, list(map(upper, CONSTRAINT_HEADINGS)), rows)] if rows else []


def _coefficients(findings: ReportData) -> list[Markup]:
    found = findings.coefficients
    nominal = bool(np.isfinite(found.nominal).any())
    rows = []
    for k, mean in enumerate(found.mean):
        low, high = found.low[k], found.high[k]
        known = np.isfinite([low, high]).all()  # else the coefficient is not excited
        interval = Markup('<span class="interval">{} to {}</span>').format(html.number(low), html.number(high))
        rows.append(
            (
                found.name[k],
                html.data(mean, quantity(float(mean), float(found.sd[k]), found.unit[k])),
                html.data(found.relative_sd[k], _percent(found.relative_sd[k])),
                interval if known else html.NONE,
                *([_nominal(found.nominal[k], mean)] if nominal else []),
                "data" if found.by_data[k] else Markup("<strong>prior</strong>"),
                _bar(*(float(values[k]) for values in found.bar)),
                Markup('<span class="expression">{}</span>').format(html.typeset(found.expression[k])),
            )
        )
    caption = (
        "Base coefficients: the identifiable combinations of link parameters. Bar: mean; line: 95 % interval; tick: "
        "nominal value; all scaled by the coefficient's size."
    )
    headings = ["Name", "Mean and sd", "Relative sd", "95 % interval", *(["Nominal"] if nominal else [])]
    headings += ["Decided by", "Scaled", "Expression"]
    names = ", ".join(findings.prior_parameters)
    by_prior = html.paragraph(
        f"Individual parameters that are not identifiable (the prior decides them): {names}.", note=True
    )
    notes = [by_prior] if names else []
    if on_edge := findings.summary.fit.links_on_edge:
        links = f"link{'s' * (len(on_edge) > 1)} {listed([str(link) for link in on_edge])}"
        note = f"Do not use individual parameters of {links}: the fit is at the edge of physical feasibility."
        notes.append(html.paragraph(f"{note} Coefficients and predicted efforts are not affected.", note=True))
    return [html.table(caption, headings, rows), *notes]


def _nominal(value: float, mean: float) -> Markup:
    """A value that is zero but for rounding is written as zero."""
    return html.data(value, "0") if abs(value) < 1e-9 * abs(mean) else html.number(value)


def _percent(share: float) -> str:
    return percent(share, 1) if share < 0.1 else percent(share, 0) if share < 10.0 else "> 1000 %"


def _bar(mean: float, low: float, high: float, nominal: float) -> Markup:
    """A bar from -2 to 2 sizes of the coefficient, with interval and nominal value."""
    zero = 60.0  # of a width of 120; the coefficient's size takes 28

    def place(value: float) -> float:
        return zero + 28.0 * float(np.clip(value, -2.0, 2.0))

    tick = "" if np.isnan(nominal) else f'<path class="tick" d="M{place(nominal):.1f} 1v14"/>'
    return Markup(
        '<svg class="bar" viewBox="0 0 120 16" aria-hidden="true"><path class="zero" d="M60 0v16"/>'
        f'<rect x="{min(place(mean), zero):.1f}" y="4" width="{abs(place(mean) - zero):.1f}" height="8"/>'
        f'<path class="range" d="M{place(low):.1f} 8H{place(high):.1f}"/>{tick}</svg>'
    )


def _posterior(findings: ReportData) -> list[Markup]:
    posterior = findings.summary.posterior
    if findings.draws is None or posterior is None:
        return [html.paragraph("No posterior was sampled.")]
    drawn = [
        (forest_figure, "forest", 12, "95 % intervals of the least determined coefficients, one per ensemble."),
        (pair_figure, "pair", 3, "Draws of the three least determined coefficients."),
        (trace_figure, "trace", 4, "Densities and traces; one colour per ensemble."),
        (rank_figure, "rank", 4, "Rank histograms: flat where the ensembles agree."),
    ]
    if len(findings.coefficients.mean) < 2:
        del drawn[1]
    pictures = [html.picture(figure(findings, count), name, caption) for figure, name, count, caption in drawn]
    note = (
        f"{posterior.draws} draws of {posterior.ensembles} ensembles of {posterior.walkers} walkers; "
        f"{convergence(posterior.max_rhat, posterior.min_ess)}. Shown: the least determined coefficients, "
        "minus their mean, over the prior's standard deviation."
    )
    return [html.paragraph(note, note=True), html.figures(pictures)]


def _residuals(findings: ReportData) -> list[Markup]:
    note = (
        "Recorded effort, with its sign, minus the model's. Blue points: samples, thinned. Orange lines: means with "
        "twice their standard errors; where they differ from zero, the model lacks an effect. Grey band: "
        "autocorrelation of white noise."
    )
    pictures = []
    for joint in range(1, findings.n_joints + 1):
        panels = [residual_panel(findings, joint, variable, TUNING.page_scatter) for variable in VARIABLES]
        figure = Figure([panels[:2], [panels[2], autocorrelation_panel(findings, joint)]], 4.4)
        caption = f"Joint {joint}: residual over time, velocity and position, and its autocorrelation."
        pictures.append(html.picture(figure, f"residual{joint}", caption))
    return [html.paragraph(note, note=True), html.figures(pictures)]


def _proof(findings: ReportData) -> list[Markup]:
    search, count = findings.summary.search, len(findings.alternatives.cost)
    if not findings.summary.hidden_joints:
        return []
    caption = "Search for the signs, and what is proven."
    parts = [html.table(caption, ["What", "Value"], shown_rows(search))]
    if search.lower_bound is not None:
        caption = "Costs of the alternatives that remain."
        parts.append(html.figures([html.picture(alternatives_figure(findings), "alternatives", caption)]))
    if search.certified and count > 1:  # else the list is incomplete
        caption = f"The cheapest of {count - 1} alternatives that remain, and where they differ from the best."
        headings = ["Number", "Cost above the best", "Probability", "Flipped segments", "At"]
        parts.append(html.table(caption, headings, _others(findings)))
    elif search.certified:
        parts.append(html.paragraph("No other assignment of the strong segments remains."))
    return parts


def _others(findings: ReportData) -> Iterator[tuple[str, ...]]:
    """The cheapest other assignments."""
    found = findings.alternatives
    for b in range(1, min(len(found.cost), TUNING.assignments + 1)):
        here = np.flatnonzero(found.branch == b)
        links = [_link(found, k, f"{found.start[k]:.2f} s") for k in here[: TUNING.spans]]
        yield (
            str(b),
            html.number(found.cost[b] - found.cost[0]),
            html.NONE if np.isnan(found.mass[b]) else html.probability(found.mass[b]),
            f"{len(here)} in {joints_in_words((found.joint[here] + 1).tolist())}",
            Markup(", ").join([*links, *(["..."] if len(here) > TUNING.spans else [])]),
        )


def _validation(findings: ReportData) -> list[Markup]:
    prediction = findings.prediction
    if prediction is None:
        return [html.paragraph(f"The model is not validated on another log. Run {commands.validate(findings)}.")]
    seen = Markup("<p><strong>This is no validation: the model was identified from this log.</strong></p>")
    caption = f"{prediction.source}: errors against measured efforts. The band of 95 % accounts for {prediction.band}."
    values = zip(prediction.rms_error, prediction.relative_residual, prediction.coverage, strict=True)
    rows = [
        (str(joint), html.number(error, findings.effort_unit[joint - 1]), html.share(share), html.share(covered))
        for joint, (error, share, covered) in enumerate(values, start=1)
    ]
    shows = "on another log: measured, predicted, and the band of 95 %."
    table = html.table(caption, ["Joint", "RMS error", "Relative residual", "In the 95 % band"], rows)
    drawn = _over_time(findings, validation_panel, "validation", shows)
    return [*([seen] if prediction.seen else []), table, drawn]


def _run(findings: ReportData) -> list[Markup]:
    run = findings.summary.provenance
    options = {name: value if isinstance(value, str) else json.dumps(value) for name, value in run.options.items()}
    named = [
        ("Command", run.command),
        ("In Python", run.call),
        *((f"Option {name}", value) for name, value in options.items()),
        *((f"SHA-256 of {name}", digest) for name, digest in run.files.items()),
        ("SHA-256 of the samples", run.data),
        *((f"Version of {name}", release) for name, release in run.versions.items()),
        ("Machine", run.machine),
        *((f"Seconds: {name}", f"{seconds:.1f}") for name, seconds in findings.summary.timings.items()),
    ]
    caption = "The same options, data and versions give the same result, unless a time limit ended a stage."
    rows = [(name, Markup("<code>{}</code>").format(value)) for name, value in named if value]
    return [html.table(caption, ["What", "Value"], rows)]


_PARTS: Mapping[tuple[str, str], Callable[[ReportData], list[Markup]]] = {
    ("torques", "Efforts and signs"): _torques,
    ("doubts", "Ambiguous segments"): _doubts,
    ("effects", "Additional effects"): _effects,
    ("gains", "Gains"): _gains,
    ("constraints", "Constraints"): _constraints,
    ("coefficients", "Coefficients"): _coefficients,
    ("posterior", "Posterior"): _posterior,
    ("residuals", "Residuals"): _residuals,
    ("proof", "Proof"): _proof,
    ("validation", "Validation on another log"): _validation,
    ("run", "Run details"): _run,
}
"""Names, titles and contents, in their order."""


@one_at_a_time
def identification_view(identification: Identification) -> str:
    """An identification's text, its checks, and the efforts of the joint that fits worst; HTML without a script."""
    findings = report_data(identification)
    joint = int(identification.fit.relative_residual.argmax()) + 1
    (ax,) = draw(Figure([[torque_panel(findings, joint)]], 3.0, WIDE, key=True))
    return html.fragment(
        "notebook.html.jinja",
        text=repr(identification),
        checks=[(check, check.remedy, _NOTEBOOK[check.state]) for check in check_findings(findings)],
        joint=joint,
        figure=Markup(svg_of(ax, f"efforts of joint {joint}, recorded and of the model")),
    )
