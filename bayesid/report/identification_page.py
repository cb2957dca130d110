"""An identification as one self-contained page: words, traffic lights, figures and tables; nothing is fetched."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from importlib import resources
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from bayesid import plot
from bayesid.checks import Check, State, check, number_told, sure_share, worst
from bayesid.findings import Findings
from bayesid.plot.remainder import VARIABLES
from bayesid.plot.style import new_figure
from bayesid.plot.svg import inline_svg
from bayesid.report import html
from bayesid.report.html import NONE, typeset
from bayesid.report.words import listed, quantity
from bayesid.signs import Progress

_STATES: dict[State, tuple[str, str]] = {
    "good": ("good", "good"), "look": ("look", "look at"), "bad": ("bad", "bad"), "not done": ("open", "not done"),
}  # fmt: skip
"""Of each state the class on the page and the word."""
_VERDICT: dict[State, str] = {
    "good": "Nothing speaks against this result",
    "look": "Usable; look at what is marked",
    "bad": "Do not rely on this result yet",
    "not done": "",
}
_DOUBTS = 20
"""Ambiguous segments that are listed."""
_ALTERNATIVES = 10
_PANEL = (5.4, 4.4)
"""in"""
_ROUNDING = 1e-9
"""Of a coefficient: what is left of link parameters that cancel."""
_SLIM_HEIGHT = 2.3
"""in, of a figure over time on a narrow screen."""


def identification_page(findings: Findings, progress: Progress | None = None) -> str:
    """The report of an identification, in HTML: opens in a browser from anywhere, light or dark, and prints.

    Args:
        findings: what there is to show.
        progress: called as progress("report", done, total).
    """
    checks = check(findings)
    state = worst(checks)
    parts = (_torques, _doubts, _coefficients, _posterior, _residuals, _proof, _validation, _run)
    sections = []
    for done, part in enumerate(parts, start=1):
        sections += [part(findings)]
        if progress is not None:
            progress("report", done, len(parts))
    return html.page(
        "Identification",
        findings.summary["robot"],
        [
            f'<p class="status {_STATES[state][0]}">{_VERDICT[state]}</p>',
            f'<p class="lead">{typeset(_lead(findings))}</p>',
            html.about(_about(findings)),
            html.warnings(findings.summary["warnings"]),
            _lights(checks),
        ],
        [one for one in sections if one],
        resources.files("bayesid.report").joinpath("zoom.js").read_text(encoding="utf-8"),
    )


# ---------------------------------------------------------------------------------------------------------------
# The head
# ---------------------------------------------------------------------------------------------------------------
def _lead(findings: Findings) -> str:
    told, fit = findings.summary, findings.summary["fit"]
    n, hidden = findings.n_joints, findings.n_joints - len(findings.summary["signed_joints"])
    known = int((findings.coefficients.relative_sd < 0.1).sum())
    whose = "all" if hidden == n else f"{hidden} of {n}"
    signs = (
        f"The signs were hidden in {whose} joints. Of the |effort|, {sure_share(findings):.1%} now has a sign that is "
        "sure to 99 %. "
        if hidden
        else "All signs were known. "
    )
    return (
        f"{signs}{told['n_coefficients']} dynamic coefficients were found, {known} of them known to 10 %. The model "
        f"leaves {min(fit['relative_residual']):.1%} to {max(fit['relative_residual']):.1%} of a joint's effort "
        "unexplained."
    )


def _about(findings: Findings) -> list[tuple[str, str]]:
    told = findings.summary
    return [
        ("Robot", told["robot"]),
        ("Log", f"{told['log']}, {told['n_samples']} rows, {findings.samples.t[-1]:.4g} s"),
        ("Terms", ", ".join([*told["terms"], *told["distortions"]])),
        ("Run", told["provenance"]["date"]),
    ]


def _lights(checks: tuple[Check, ...]) -> str:
    rows = []
    for one in checks:
        colour, word = _STATES[one.state]
        remedy = f'<span class="remedy">What to do: {_code(one.remedy)}.</span>' if one.remedy else ""
        rows.append(
            f'<li class="{colour}"><span class="light">{word}</span><div><strong>{escape(one.name)}:</strong> '
            f"{_code(one.told)}.{remedy}</div></li>"
        )
    return html.section("checks", "Checks", f'<ul class="checks">{"".join(rows)}</ul>')


def _code(text: str) -> str:
    """Typeset, with commands between backquotes as code."""
    parts = text.split("`")
    return "".join(f"<code>{escape(part)}</code>" if k % 2 else typeset(part) for k, part in enumerate(parts))


# ---------------------------------------------------------------------------------------------------------------
# Sections
# ---------------------------------------------------------------------------------------------------------------
def _torques(findings: Findings) -> str:
    hidden = len(findings.summary["signed_joints"]) < findings.n_joints
    note = (
        "The efforts as they were recorded, with the signs that were found, and by the model. A blue band is a segment "
        "whose sign is plus, an orange one minus; the paler, the less sure. Hatched bands and question marks are "
        "ambiguous."
        if hidden
        else "The efforts as they were recorded, and by the model. A blue band is plus, an orange one minus."
    )
    pictures = []
    for j in range(findings.n_joints):
        alt = f"Effort of joint {j + 1} over time: recorded, signed, and by the model. {_signs_in_words(findings, j)}"
        draw = partial(plot.torques, findings, [j + 1], key=False)
        pictures.append(_zoomable(draw, f"torque{j + 1}", alt, f"Joint {j + 1}.", _bands(findings, j)))
    thinned = "" if findings.samples.every == 1 else f" One of {findings.samples.every} samples is shown."
    head = f'<p class="note">{note}{thinned}</p>{_KEY_TORQUES if hidden else _KEY_SIGNED}'
    return html.section("torques", "Efforts and signs", head + "".join(pictures))


def _signs_in_words(findings: Findings, j: int) -> str:
    told = findings.segments
    here = told.joint == j
    plus = int((told.sign[here] > 0).sum())
    return f"{plus} segments are plus, {int(here.sum()) - plus} minus, {int(told.ambiguous[here].sum())} ambiguous."


def _bands(findings: Findings, j: int) -> list[list[float]]:
    """Start, end, sign, confidence, and 1 if ambiguous, of a joint's segments, for the page's script."""
    told = findings.segments
    here = np.flatnonzero(told.joint == j)
    times = np.round([told.start[here], told.end[here]], 4).tolist()
    confidence = np.round(told.confidence[here], 3).tolist()
    return [
        [start, end, int(told.sign[k]), sure, int(told.ambiguous[k])]
        for k, start, end, sure in zip(here, *times, confidence, strict=True)
    ]


def _doubts(findings: Findings) -> str:
    told, weight = findings.segments, findings.segment_size
    doubtful = np.flatnonzero(told.ambiguous & told.moving)
    if not doubtful.size:
        return html.section("doubts", "Ambiguous segments", "<p>No segment in motion is ambiguous.</p>")
    order = doubtful[np.argsort(-weight[doubtful], kind="stable")]
    rows = [
        [
            f"{told.joint[k] + 1}",
            f'<a href="#torque{told.joint[k] + 1}" data-from="{told.start[k]:.4f}" data-to="{told.end[k]:.4f}">'
            f"{told.start[k]:.2f} to {told.end[k]:.2f} s</a>",
            "+" if told.sign[k] > 0 else "&minus;",
            html.data(told.confidence[k], f"{told.confidence[k]:.2f}"),
            html.data(weight[k], f"{weight[k]:.1%}"),
        ]
        for k in order[:_DOUBTS]
    ]  # fmt: skip
    largest = "Segments" if len(rows) == len(doubtful) else f"The {len(rows)} largest of {len(doubtful)} segments"
    caption = (
        f"{largest} in motion whose sign is not sure, by their largest |effort|. The sign of a small effort matters "
        "little to the coefficients: its likelihood is averaged over both."
    )
    headings = ["Joint", "Time", "Likelier sign", "Confidence", "Largest |effort|, of the joint's"]
    return html.section("doubts", "Ambiguous segments", html.table(caption, headings, rows))


def _coefficients(findings: Findings) -> str:
    told, bar = findings.coefficients, findings.coefficients.bar
    nominal = bool(np.isfinite(told.nominal).any())
    rows = []
    for k in range(len(told.mean)):
        unit = told.unit[k]
        rows.append([
            escape(told.name[k]),
            html.data(told.mean[k], quantity(float(told.mean[k]), float(told.sd[k]), unit)),
            html.data(told.relative_sd[k], _percent(told.relative_sd[k])),
            _interval(told.low[k], told.high[k]),
            *([_nominal(told.nominal[k], told.mean[k])] if nominal else []),
            "data" if told.by_data[k] else "<strong>prior</strong>",
            _bar(bar.mean[k], bar.low[k], bar.high[k], bar.nominal[k]),
            f'<span class="expression">{typeset(told.expression[k])}</span>',
        ])  # fmt: skip
    caption = (
        "Base coefficients: the combinations of link parameters that efforts can show. The bar is the mean, the line "
        "the 95 % interval, and the tick the nominal value, each over the coefficient's own size."
    )
    headings = [
        "Built on", "Mean and sd", "Relative sd", "95 % interval", *(["Nominal"] if nominal else []), "Decided by",
        "From -1 to 1", "Expression",
    ]  # fmt: skip
    prior = findings.prior_parameters
    note = (
        f'<p class="note">Single parameters that the prior decides, not the data: {escape(", ".join(prior))}. '
        "They are physically feasible, but only their combinations above are measured.</p>"
        if prior
        else ""
    )
    return html.section("coefficients", "Coefficients", html.table(caption, headings, rows) + note)


def _interval(low: float, high: float) -> str:
    """Nothing where the log does not show a coefficient."""
    if not np.isfinite([low, high]).all():
        return NONE
    return f'<span class="interval">{html.number(low)} to {html.number(high)}</span>'


def _nominal(value: float, mean: float) -> str:
    """A sum of link parameters that is zero but for rounding is written as zero."""
    return html.data(value, "0") if abs(value) < _ROUNDING * abs(mean) else html.number(value)


def _percent(share: float) -> str:
    return f"{share:.1%}" if share < 0.1 else f"{share:.0%}" if share < 10.0 else "> 1000 %"


def _bar(mean: float, low: float, high: float, nominal: float) -> str:
    """A small picture of numbers that stand beside it."""
    x = [60.0 + 28.0 * float(np.clip(value, -2.0, 2.0)) for value in (mean, low, high)]
    tick = "" if np.isnan(nominal) else f'<path class="tick" d="M{60 + 28 * float(np.clip(nominal, -2, 2)):.1f} 1v14"/>'
    return (
        '<svg class="bar" viewBox="0 0 120 16" aria-hidden="true"><path class="zero" d="M60 0v16"/>'
        f'<rect x="{min(x[0], 60.0):.1f}" y="4" width="{abs(x[0] - 60.0):.1f}" height="8"/>'
        f'<path class="range" d="M{x[1]:.1f} 8H{x[2]:.1f}"/>{tick}</svg>'
    )


def _posterior(findings: Findings) -> str:
    if findings.draws is None:
        return html.section("posterior", "Posterior", "<p>No posterior was sampled.</p>")
    few = len(findings.coefficients.mean) < 2
    made = [
        ("forest", plot.forest(findings), "Intervals of 94 % of the worst-decided coefficients, one an ensemble."),
        *([] if few else [("pair", plot.pair(findings)[0], "Draws of the three worst-decided against each other.")]),
        ("trace", plot.trace(findings)[0], "Densities and draws, sweep after sweep; one colour an ensemble."),
        ("rank", plot.rank(findings)[0], "Ranks of each ensemble's draws: flat where the ensembles agree."),
    ]
    told = findings.summary["posterior"]
    rhat, size = number_told(told["max_rhat"], 3), number_told(told["min_ess"])
    note = (
        f'<p class="note">{told["draws"]} draws of {told["ensembles"]} ensembles of {told["walkers"]} walkers; R-hat '
        f"{rhat}, effective sample size {size}, at worst. Shown are the coefficients that the log decides worst, less "
        "their mean, over the prior's standard deviation.</p>"
    )
    return html.section("posterior", "Posterior", note + html.figures(_picture(*one) for one in made))


def _residuals(findings: Findings) -> str:
    pictures = []
    for joint in range(1, findings.n_joints + 1):
        panels = new_figure(_PANEL[1], _PANEL[0]).subplots(2, 2).ravel().tolist()
        for variable, ax in zip(VARIABLES, panels, strict=False):
            plot.residuals(findings, variable, [joint], [ax])
        plot.autocorrelation(findings, [joint], [panels[-1]])
        told = f"Joint {joint}: residual over time, velocity and position, and its autocorrelation."
        pictures.append(_picture(f"residual{joint}", panels[0], told))
    note = (
        '<p class="note">What the model leaves of the efforts in motion, signs as found. Blue points are samples, '
        "thinned; orange lines are means over equally many samples with twice their standard errors: where they leave "
        "zero, the model lacks something. The autocorrelation of white noise would lie in the grey band.</p>"
    )
    return html.section("residuals", "Residuals", note + html.figures(pictures))


def _proof(findings: Findings) -> str:
    title, told = "The proof", findings.summary["search"]
    if len(findings.summary["signed_joints"]) == findings.n_joints:
        return ""
    said = (
        f"Search: {told['method']}. It weighed {told['nodes']} partial assignments by lower bounds of their cost, "
        f"solved {told['sdp_solves']} least-squares problems over the feasible parameters, and took "
        f"{told['seconds']:.1f} s in {told['rounds']} round{'s' * (told['rounds'] != 1)}. The best assignment costs "
        f"{told['cost']:.6g}."
    )
    if told["lower_bound"] is None:
        return html.section("proof", title, f"<p>{typeset(said)} Nothing is proven about the others.</p>")
    proven = (
        " No assignment costs less: every one was either weighed or ruled out by a bound."
        if told["certified"]
        else f" Every assignment costs at least {told['lower_bound']:.6g}; what lies between is not ruled out."
    )
    if told["settled_share"] is not None:
        proven += (
            f" {told['settled_share']:.1%} of the samples have the same sign in all assignments that cost at most "
            f"{told['within']:.1f} more, which is {np.exp(-told['within'] / 2.0):.1g} of the best one's probability."
        )
    picture = _picture("alternatives", plot.alternatives(findings), "Costs of the assignments that remain.")
    content = f"<p>{typeset(said + proven)}</p>" + html.figures([picture]) + _remaining(findings)
    return html.section("proof", title, content)


def _remaining(findings: Findings) -> str:
    told = findings.alternatives
    if not findings.summary["search"]["certified"]:  # then the list says nothing about the others
        return ""
    if len(told.cost) == 1:
        return "<p>No other assignment of the strong segments remains.</p>"
    rows = []
    for b in range(1, min(len(told.cost), _ALTERNATIVES + 1)):
        here = np.flatnonzero(told.branch == b)
        joints = sorted({int(j) + 1 for j in told.joint[here]})
        spans = [
            f'<a href="#torque{told.joint[k] + 1}" data-from="{told.start[k]:.4f}" data-to="{told.end[k]:.4f}">'
            f"{told.start[k]:.2f} s</a>"
            for k in here[:5]
        ]
        rows.append([
            f"{b}",
            html.number(told.cost[b] - told.cost[0]),
            html.probability(told.mass[b]) if np.isfinite(told.mass[b]) else NONE,
            f"{len(here)} in joint{'s' * (len(joints) > 1)} {escape(listed([str(j) for j in joints]))}",
            ", ".join(spans) + (", ..." if len(here) > 5 else ""),
        ])  # fmt: skip
    caption = f"The cheapest of {len(told.cost) - 1} other assignments that remain; where they differ from the best."
    return html.table(caption, ["Number", "Cost above", "Probability", "Other signs", "At"], rows)


def _validation(findings: Findings) -> str:
    title, seen = "Validation on another log", findings.prediction
    if seen is None:
        said = "This model has not been tried on a log that it has not seen: "
        return html.section(
            "validation", title, f"<p>{said}<code>bayesid report RESULT --validation ANOTHER_LOG.csv</code></p>"
        )
    rows = [
        [
            f"{j + 1}", html.number(seen.rms_error[j], findings.effort_unit[j]),
            html.data(seen.relative_residual[j], f"{seen.relative_residual[j]:.1%}"),
            html.data(seen.coverage[j], f"{seen.coverage[j]:.1%}"),
        ]
        for j in range(findings.n_joints)
    ]  # fmt: skip
    caption = f"{seen.source}. The band accounts for {seen.band}; it should hold 95 % of the efforts."
    table = html.table(caption, ["Joint", "RMS error", "Over the RMS effort", "In the 95 % band"], rows)
    pictures = []
    for j in range(findings.n_joints):
        alt = f"Effort of joint {j + 1} over time on another log: measured, predicted, and the band of 95 %."
        draw = partial(plot.validation, findings, [j + 1], key=False)
        pictures.append(_zoomable(draw, f"validation{j + 1}", alt, f"Joint {j + 1}.", []))
    return html.section("validation", title, table + _KEY_VALIDATION + "".join(pictures))


def _run(findings: Findings) -> str:
    told = findings.summary["provenance"]
    rows = [
        *([("Command", told["command"])] if told["command"] else []),
        *((f"Option {name}", _option(value)) for name, value in told["options"].items()),
        *((f"SHA-256 of {name}", digest) for name, digest in told["files"].items()),
        ("SHA-256 of the samples", told["data"]),
        *((f"Version of {name}", number) for name, number in told["versions"].items()),
        ("Machine", told["machine"]),
        *((f"Seconds: {name}", f"{seconds:.1f}") for name, seconds in findings.summary["timings"].items()),
    ]
    caption = "Same options, data and versions, same result; but budgets in seconds depend on the machine."
    cells = [[escape(name), f"<code>{escape(str(value))}</code>"] for name, value in rows]
    return html.section("run", "What was run", html.table(caption, ["What", "Value"], cells))


def _option(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value)


# ---------------------------------------------------------------------------------------------------------------
# Figures
# ---------------------------------------------------------------------------------------------------------------
def _picture(name: str, ax: Axes, told: str) -> str:
    """The figure that an Axes belongs to, with its caption."""
    return html.figure(inline_svg(_figure_of(ax), name, told), told)


def _zoomable(
    draw: Callable[..., list[Axes]], name: str, alt: str, told: str, bands: Sequence[Sequence[float]]
) -> str:
    """A figure over time that the page's script can zoom, once for wide screens and paper and once for narrow ones."""
    images, left, right = [], 0.0, 1.0
    for kind, axes in (("broad", None), ("slim", [new_figure(_SLIM_HEIGHT).subplots()])):
        (ax,) = draw(axes=axes)
        ax.patch.set_gid("area")
        ax.xaxis.set_gid("xaxis")
        left, right = (float(end) for end in ax.get_xlim())
        images.append(f'<div class="{kind}">{inline_svg(_figure_of(ax), f"{name}{kind}", alt)}</div>')
    data = f'data-left="{left!r}" data-right="{right!r}" data-bands="{escape(json.dumps(bands))}"'
    caption = f"<figcaption>{escape(told)}</figcaption>"
    return f'<figure class="wide" id="{name}" {data}>{"".join(images)}{caption}</figure>'


def _key(*entries: tuple[str, str]) -> str:
    """What colours and lines mean: classes and words."""
    items = "".join(f'<li><span class="{kind}"></span>{told}</li>' for kind, told in entries)
    return f'<ul class="key" aria-label="Colours and lines">{items}</ul>'


_BANDS_KEY = (("plus", "sign +"), ("minus", "sign &minus;"), ("doubt", "ambiguous"))
_KEY_TORQUES = _key(
    *_BANDS_KEY, ("line dotted", "recorded, without sign"), ("line", "with signs"), ("line model", "model")
)
_KEY_SIGNED = _key(*_BANDS_KEY[:2], ("line", "recorded"), ("line model", "model"))
_KEY_VALIDATION = _key(("plus", "95 % band"), ("line", "measured"), ("line model", "predicted"))


def _figure_of(ax: Axes) -> Any:
    return ax.get_figure(root=True)
