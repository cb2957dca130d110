"""An identification as one self-contained page: checks, figures and tables; nothing is fetched."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping

import numpy as np
from markupsafe import Markup

from bayesid.identification.checks import State, convergence
from bayesid.identification.identification import SURE, Identification
from bayesid.identification.options import COMPLETENESS, Preprocessing, plain_options
from bayesid.identification.tuning import TUNING as IDENTIFICATION
from bayesid.number_text import percent
from bayesid.parallel import one_at_a_time
from bayesid.posterior.sampler import Sampling
from bayesid.posterior.tuning import TUNING as POSTERIOR
from bayesid.progress import SILENT, Progress
from bayesid.regression.knowledge import ParameterPrior
from bayesid.report import commands
from bayesid.report.conclusion import conclude
from bayesid.report.pages import rendering as html
from bayesid.report.pages.coefficient_table import coefficient_parts
from bayesid.report.plot.drawing import draw, svg_of
from bayesid.report.plot.figure import WIDE, Figure, Panel
from bayesid.report.plot.identification import (
    alternatives_figure,
    autocorrelation_panel,
    residual_panel,
    torque_panel,
    validation_panel,
)
from bayesid.report.plot.posterior import forest_figure, pair_figure, rank_figure, trace_figure
from bayesid.report.report_data import VARIABLES, Alternatives, ReportData, SegmentTable, report_data
from bayesid.report.summary import PosteriorSummary, Summary, shown_rows
from bayesid.report.tables import (
    CONSTRAINT_HEADINGS,
    EFFECT_HEADINGS,
    GAIN_HEADINGS,
    constraint_rows,
    effect_rows,
    effect_symbols,
    gain_rows,
)
from bayesid.report.tuning import TUNING
from bayesid.report.verdicts import check_findings, sure_share
from bayesid.report.words import counted, joints_in_words, label, upper
from bayesid.signs.search.certified import Certified

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
    known = int((findings.sd_apart < TUNING.well_known * np.abs(findings.coefficients.mean)).sum())
    apart = " (apart from the common factor of the gains)" if summary.gains is not None else ""
    signs = (
        f"The signs were hidden in {'all' if hidden == n else f'{hidden} of {n}'} joints. The sign is now at least "
        f"{percent(SURE, 0)} certain for {percent(sure_share(findings), 1)} of the |effort|. "
        if hidden
        else "All signs were known. "
    )
    return (
        f"{signs}{summary.n_coefficients} dynamic coefficients were identified, {known} of them with a standard "
        f"deviation below {percent(TUNING.well_known, 0)}{apart}. The relative residual (RMS residual over RMS effort) "
        f"is {percent(share.min(), 1)} to {percent(share.max(), 1)} per joint."
    )


def _about(findings: ReportData) -> list[tuple[str, str]]:
    summary = findings.summary
    return [
        ("Robot", summary.robot),
        ("Log", f"{summary.log}, {summary.n_samples} rows, {findings.samples.t[-1]:.4g} s"),
        *[("Payload", f"{part.payload}, carried in {part.source}") for part in summary.logs if part.payload],
        ("Model", "; ".join(_model(summary))),
        ("Run", f"{summary.provenance.date[:16].replace('T', ' ')} UTC"),
    ]


def _model(summary: Summary) -> list[str]:
    """The requested effects, and the added ones with their joints."""
    added = () if summary.complete is None else summary.complete.effects
    forms = {effect.form for effect in added}
    requested = [label(name) for name in (*summary.terms, *summary.distortions) if name not in forms]
    return [*requested, *(label(effect.form, effect.joints) for effect in added)]


def _torques(findings: ReportData) -> list[Markup]:
    every = findings.samples.every
    bands = (
        "Blue bands: segments with sign plus; orange: minus; paler bands are less certain. Hatched bands and question "
        "marks: ambiguous. The number above a band is its confidence. Drag over a figure to zoom into a range, "
        "double-click to see all."
    )
    signs = f", with the signs found, and of the model. {bands}"
    known = ", and of the model. Blue bands: plus; orange: minus; above: share of the squared effort with this sign."
    curves = signs if findings.summary.hidden_joints else known
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
    if not findings.summary.hidden_joints:
        return []
    segments, size = findings.segments, findings.segment_size
    doubtful = np.flatnonzero(segments.ambiguous & segments.moving)
    largest = doubtful[np.argsort(-size[doubtful], kind="stable")][: TUNING.doubts]
    rows = [
        (
            str(segments.joint[k] + 1),
            _link(segments, k, f"{segments.start[k]:.2f} to {segments.end[k]:.2f} s"),
            "+" if segments.sign[k] > 0 else Markup("&minus;"),
            html.data(segments.confidence[k], f"{np.floor(100.0 * segments.confidence[k]) / 100.0:.2f}"),
            html.share(size[k]),
        )
        for k in largest
    ]
    which = "Segments" if len(rows) == len(doubtful) else f"The {len(rows)} largest of {len(doubtful)} segments"
    averaged = "" if findings.summary.posterior is None else "; the posterior averages over both signs"
    caption = (
        f"{which} in motion with an ambiguous sign, by their largest |effort|{averaged}. "
        "A sign is determined if the search proves it, certain if the posterior gives it at least "
        f"{percent(SURE, 0)}, ambiguous if the confidence of its segment is below {TUNING.ambiguous:g}."
    )
    headings = "Joint", "Time", "Likelier sign", "Confidence", "Largest |effort|, of the joint's maximum"
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
    if not rows:
        return []
    caption = (
        "Additional effects. Each is confirmed by its Bayes factor, given all others (log10 of 2: the log is 100 times "
        "likelier with the effect), and by a smaller error on held-back blocks. Fits equally well: an effect that this "
        "log cannot distinguish from it."
    )
    symbols = f"{upper(effect_symbols(findings.summary))}. The number is that of the joint: Fe2 is [Fe] of joint 2."
    return [html.table(caption, list(map(upper, EFFECT_HEADINGS)), rows), html.paragraph(symbols, note=True)]


def _gains(findings: ReportData) -> list[Markup]:
    rows = gain_rows(findings.summary)
    caption = (
        "Estimated gains, with their common factor (check Gains). Decided by data: the log reduces the variance of "
        "this gain's ratio to the others to at most a tenth of the stated one. To a factor: one standard deviation of "
        "the logarithm."
    )
    return [html.table(caption, list(map(upper, GAIN_HEADINGS)), rows)] if rows else []


def _constraints(findings: ReportData) -> list[Markup]:
    rows = constraint_rows(findings.summary)
    caption = (
        "Stated constraints. Cost: decrease of the best fit's cost without the constraint; above "
        f"{2.0 * IDENTIFICATION.contradicted_constraint:.1f} (1000 times less likely) the log contradicts it. A draw "
        "is at the edge within a tenth of the standard deviation of its distance. Limits the draws: above "
        f"{percent(POSTERIOR.active_constraint, 0)} of the draws are there."
    )
    return [html.table(caption, list(map(upper, CONSTRAINT_HEADINGS)), rows)] if rows else []


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
    kept = findings.draws.shape[0] * findings.draws.shape[1]
    thinned = "" if kept == posterior.draws else f" ({kept} are shown)"
    note = (
        f"{posterior.draws} draws{thinned} by {posterior.ensembles} independent ensembles of {posterior.walkers} "
        "walkers (parallel chains); "
        f"{convergence(posterior.max_rhat, posterior.min_ess)} over all coefficients and noise scales"
        f"{_limits(posterior)}. Shown: the least determined coefficients, each minus its mean and divided by the "
        "prior's standard deviation (1 on an axis)."
    )
    return [html.paragraph(note, note=True), html.figures(pictures)]


def _limits(posterior: PosteriorSummary) -> str:
    if posterior.wanted_rhat is None or posterior.wanted_ess is None:  # a result of an earlier version
        return ""
    return f" (good: R-hat up to {posterior.wanted_rhat:g}, size from {posterior.wanted_ess:.0f})"


def _residuals(findings: ReportData) -> list[Markup]:
    note = (
        "Recorded effort, with its sign, minus the model's. Blue points: samples, thinned. Orange lines: local means "
        "with twice their standard errors; where they differ from zero, the model has a systematic error. Tolerance: "
        f"a relative residual of {percent(IDENTIFICATION.suspicious, 0)} per joint (check Fit); the intervals account "
        "for the error. Grey band: 95 % of the autocorrelations of white noise lie in it; outside, neighbouring "
        "residuals are correlated."
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
    caption = (
        "Search for the signs, and what is proven. An assignment is one choice of all signs; its cost is the squared "
        "residual in units of the noise. A cost of 13.8 more means 1000 times less likely."
    )
    parts = [html.table(caption, ["What", "Value"], shown_rows(search))]
    if search.lower_bound is not None and (count > 1 or not search.certified):
        caption = "Costs of the assignments that the proof does not exclude."
        parts.append(html.figures([html.picture(alternatives_figure(findings), "alternatives", caption)]))
    if search.certified and count > 1:  # else the list is incomplete
        shown = min(count - 1, TUNING.assignments)
        cheapest = "" if shown == count - 1 else f" (the {shown} cheapest are listed)"
        caption = (
            f"{counted(count - 1, 'alternative')} that the proof does not exclude{cheapest}, and the strong segments "
            f"in which they differ from the best assignment.{_sums(findings)} Weaker segments without a determined "
            "sign are not in this table; the check Proof counts all of them."
        )
        headings = ["Number", "Cost above the best", "Probability", "Flipped segments", "At"]
        parts.append(html.table(caption, headings, _others(findings)))
    elif search.certified:
        parts.append(html.paragraph("No other assignment of the strong segments (those with much energy) remains."))
    return parts


def _sums(findings: ReportData) -> str:
    """What the probabilities of assignments and of modes add up to."""
    posterior, mass = findings.summary.posterior, findings.alternatives.mass
    if posterior is None or posterior.assignments_elsewhere is None or np.isnan(mass).any():
        return ""
    return (
        f" The probabilities of the best assignment ({mass[0]:.3f}), of all alternatives and of assignments outside of "
        f"the list ({posterior.assignments_elsewhere:.3f}) sum to 1. Those of the modes (check Modes) also sum to 1: a "
        "mode is a group of assignments between which the sampler moves."
    )


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
    caption = (
        f"{prediction.source}: errors of the predicted efforts. Efforts logged without sign get the likelier one under "
        f"the model. The 95 % band accounts for {prediction.band}. Only samples in motion are counted."
    )
    values = zip(prediction.rms_error, prediction.relative_residual, prediction.coverage, strict=True)
    rows = [
        (str(joint), html.number(error, findings.effort_unit[joint - 1]), html.share(share), html.share(covered))
        for joint, (error, share, covered) in enumerate(values, start=1)
    ]
    shows = "on another log: measured, predicted, and the band of 95 %."
    table = html.table(caption, ["Joint", "RMS error", "Relative residual", "In the 95 % band"], rows)
    drawn = _over_time(findings, validation_panel, "validation", shows)
    return [*([seen] if prediction.seen else []), table, drawn]


_STAGES = {
    "prepare": "preparation of the log",
    "other readings": "input diagnosis",
    "search": "search for the signs, and fit",
    "second opinion": "signs under a richer model",
    "complete": "additional effects",
    "posterior": "sampling",
    "smooth": "signs of samples",
}
"""Names of the stages that `timings` holds."""


def _run(findings: ReportData) -> list[Markup]:
    run, posterior, search = findings.summary.provenance, findings.summary.posterior, findings.summary.search
    times = [f"{_STAGES.get(name, name)} {seconds:.1f} s" for name, seconds in findings.summary.timings.items()]
    named = [
        ("Command", run.command),
        ("In Python", run.call),
        ("Version", f"bayesid {run.versions.get('bayesid', '')}".rstrip()),
        ("Random seed", "" if posterior is None else str(posterior.seed)),
        ("Time", ", ".join(times)),
    ]
    options = {name: value if isinstance(value, str) else json.dumps(value) for name, value in _changed(run.options)}
    details = [
        *((f"Option {name}", value) for name, value in options.items()),
        *((f"SHA-256 of {name}", digest) for name, digest in run.files.items()),
        ("SHA-256 of the samples", run.data),
        *((f"Version of {name}", release) for name, release in run.versions.items() if name != "bayesid"),
        ("Machine", run.machine),
        *(shown_rows(search, detail=True) if findings.summary.hidden_joints else []),
    ]
    caption = "The same options, data and versions give the same result, unless a time limit ended a stage."
    folded = html.table(
        "Options that differ from the defaults (summary.json has all), checksums, versions.",
        ["What", "Value"],
        _in_code(details),
    )
    return [html.table(caption, ["What", "Value"], _in_code(named)), html.fold("Details", folded)]


def _changed(options: Mapping[str, object]) -> list[tuple[str, object]]:
    objects = {"search": Certified(), "posterior": Sampling(), "prior": ParameterPrior()}
    defaults = plain_options({**objects, "preprocessing": Preprocessing(), "complete": COMPLETENESS[0]})
    return [(name, value) for name, value in options.items() if name not in defaults or defaults[name] != value]


def _in_code(named: Iterable[tuple[str, str | None]]) -> list[tuple[str, Markup]]:
    return [(name, Markup("<code>{}</code>").format(value)) for name, value in named if value]


_PARTS: Mapping[tuple[str, str], Callable[[ReportData], list[Markup]]] = {
    ("torques", "Efforts and signs"): _torques,
    ("doubts", "Ambiguous segments"): _doubts,
    ("effects", "Additional effects"): _effects,
    ("gains", "Gains"): _gains,
    ("constraints", "Constraints"): _constraints,
    ("coefficients", "Coefficients"): coefficient_parts,
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
