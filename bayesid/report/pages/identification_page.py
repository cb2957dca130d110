"""An identification as one self-contained page: words, traffic lights, figures and tables; nothing is fetched."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from markupsafe import Markup

from bayesid.identification.identification import SURE, Identification
from bayesid.identification.warnings import convergence
from bayesid.parallel import one_at_a_time
from bayesid.progress import SILENT, Progress
from bayesid.report import commands
from bayesid.report.findings import Findings, find_findings
from bayesid.report.findings.summary import SearchSummary
from bayesid.report.pages.rendering import Picture, data, fragment, number, picture, render
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
from bayesid.report.tables import EFFECT_HEADINGS, GAIN_HEADINGS, effect_rows, gain_rows
from bayesid.report.tuning import TUNING
from bayesid.report.verdicts import State, at_standstill, check_findings, sure_share, worst
from bayesid.report.words import listed, quantity, upper

_STATES: Mapping[State, Mapping[str, str]] = {
    "good": {"colour": "good", "text": "good"},
    "look": {"colour": "look", "text": "look at"},
    "bad": {"colour": "bad", "text": "bad"},
    "not done": {"colour": "open", "text": "not done"},
}
"""Of each state the class on the page and the word."""
_NOTEBOOK: Mapping[State, str] = {"good": "#1f7a3d", "look": "#8a5a00", "bad": "#b3261e", "not done": "#59636e"}
"""Colours as in style.css; a notebook has no style of ours."""
_VERDICT: Mapping[State, str] = {
    "good": "Nothing speaks against this result",
    "look": "Usable; look at what is marked",
    "bad": "Do not rely on this result yet",
}
_SECTIONS = {
    "checks": "Checks",
    "torques": "Efforts and signs",
    "doubts": "Ambiguous segments",
    "effects": "Beyond the terms asked for",
    "gains": "Gains",
    "coefficients": "Coefficients",
    "posterior": "Posterior",
    "residuals": "Residuals",
    "proof": "The proof",
    "validation": "Validation on another log",
    "run": "What was run",
}
"""Of the page, in their order: name and title."""
_SECTION_OF = {
    "Robot file": "run",
    "Excitation": "coefficients",
    "Signs of the segments": "doubts",
    "Low-pass after the rectifier": "torques",
    "Proof": "proof",
    "Sampling": "posterior",
    "Modes": "posterior",
    "Fit": "residuals",
    "Beyond the terms": "effects",
    "Gains": "gains",
    "Intervals": "coefficients",
    "Whiteness of the residual": "residuals",
    "Data or prior": "coefficients",
    "Validation": "validation",
    "Warnings": "warnings",
}
"""Where the page shows more of a check."""


@one_at_a_time
def identification_page(findings: Findings, progress: Progress = SILENT) -> str:
    """The report of an identification, in HTML: opens in a browser from anywhere, light or dark, and prints.

    Args:
        findings: what there is to show.
        progress: called as progress("report", done, total).
    """
    checks, summary = check_findings(findings), findings.summary
    state, effects = worst(checks), effect_rows(summary)
    absent = {
        *([] if effects else ["effects"]),
        *([] if summary.gains else ["gains"]),
        *([] if summary.hidden_joints else ["proof"]),
        *([] if summary.warnings else ["warnings"]),
    }
    content: dict[str, Any] = {
        "status": {"colour": _STATES[state]["colour"], "text": _VERDICT[state]},
        "lead": _lead(findings),
        "about": _about(findings),
        "contents": {name: title for name, title in _SECTIONS.items() if name not in absent},
        "warnings": summary.warnings,
        "checks": [(check, _STATES[check.state]) for check in checks],
        "sections": {check: name for check, name in _SECTION_OF.items() if name not in absent},
        "hidden": summary.hidden_joints > 0,
        "effects": effects,
        "effect_headings": list(map(upper, EFFECT_HEADINGS)),
        "gains": gain_rows(summary),
        "gain_headings": list(map(upper, GAIN_HEADINGS)),
    }
    parts = (_torques, _doubts, _coefficients, _posterior, _residuals, _proof, _validation, _run)
    for done, part in enumerate(parts, start=1):
        content |= part(findings)
        progress("report", done, len(parts))
    subject = f"{summary.robot}, {summary.log}"
    return render("identification.html.jinja", "Identification", subject, **content)


def _lead(findings: Findings) -> str:
    summary, share = findings.summary, np.array(findings.summary.fit.relative_residual, dtype=float)
    n, hidden = findings.n_joints, summary.hidden_joints
    known = int((findings.coefficients.relative_sd < TUNING.well_known).sum())
    signs = (
        f"The signs were hidden in {'all' if hidden == n else f'{hidden} of {n}'} joints. Of the |effort|, "
        f"{sure_share(findings):.1%} now has a sign that is sure to {SURE:.0%}. "
        if hidden
        else "All signs were known. "
    )
    return (
        f"{signs}{summary.n_coefficients} dynamic coefficients were found, {known} of them known to "
        f"{TUNING.well_known:.0%}. "
        f"The model leaves {share.min():.1%} to {share.max():.1%} of a joint's effort unexplained."
    )


def _about(findings: Findings) -> list[tuple[str, str]]:
    summary = findings.summary
    return [
        ("Robot", summary.robot),
        ("Log", f"{summary.log}, {summary.n_samples} rows, {findings.samples.t[-1]:.4g} s"),
        *[("Payload", f"{one.payload}, carried in {one.source}") for one in summary.logs if one.payload],
        ("Terms", ", ".join([*summary.terms, *summary.distortions])),
        ("Run", summary.provenance.date),
    ]


# ---------------------------------------------------------------------------------------------------------------
# Sections
# ---------------------------------------------------------------------------------------------------------------
def _torques(findings: Findings) -> dict[str, Any]:
    every = findings.samples.every
    return {
        "thinned": "" if every == 1 else f" One of {every} samples is shown.",
        "torques": [
            _over_time(
                torque_panel(findings, joint, TUNING.page_curve),
                "torque",
                joint,
                f"Effort of joint {joint} over time: recorded, signed, and by the model. {_signs(findings, joint - 1)}",
            )
            for joint in range(1, findings.n_joints + 1)
        ],
    }


def _over_time(panel: Panel, group: str, joint: int, alt: str) -> Picture:
    """One joint's panel of a group; the legend above the first one is that of all."""
    figure = Figure([[panel]], 2.6, WIDE, key=joint == 1)
    return picture(figure, f"{group}{joint}", f"Joint {joint}.", alt, group)


def _signs(findings: Findings, j: int) -> str:
    """A joint's segments in words."""
    table = findings.segments
    here = table.joint == j
    plus = int((table.sign[here] > 0).sum())
    return f"{plus} segments are plus, {int(here.sum()) - plus} minus, {int(table.ambiguous[here].sum())} ambiguous."


def _doubts(findings: Findings) -> dict[str, Any]:
    table, size = findings.segments, findings.segment_size
    doubtful = np.flatnonzero(table.ambiguous & table.moving)
    largest = doubtful[np.argsort(-size[doubtful], kind="stable")][: TUNING.doubts]
    rows = [
        {
            "joint": int(table.joint[k]),
            "start": table.start[k],
            "end": table.end[k],
            "sign": table.sign[k],
            "confidence": table.confidence[k],
            "size": size[k],
        }
        for k in largest
    ]
    which = "Segments" if len(rows) == len(doubtful) else f"The {len(rows)} largest of {len(doubtful)} segments"
    caption = (
        f"{which} in motion whose sign is not sure, by their largest |effort|. The sign of a small effort matters "
        "little to the coefficients: its likelihood is averaged over both."
    )
    return {"doubts": rows, "doubts_caption": caption, "still": upper(at_standstill(findings))}


def _coefficients(findings: Findings) -> dict[str, Any]:
    table, bar = findings.coefficients, findings.coefficients.bar
    rows = [
        {
            "name": table.name[k],
            "mean": mean,
            "quantity": quantity(float(mean), float(table.sd[k]), table.unit[k]),
            "relative_sd": table.relative_sd[k],
            "relative_text": _percent(table.relative_sd[k]),
            "bounded": np.isfinite([table.low[k], table.high[k]]).all(),  # else the log does not show a coefficient
            "low": table.low[k],
            "high": table.high[k],
            "nominal": _nominal(table.nominal[k], mean),
            "by_data": table.by_data[k],
            "bar": _bar(bar.mean[k], bar.low[k], bar.high[k], bar.nominal[k]),
            "expression": table.expression[k],
        }
        for k, mean in enumerate(table.mean)
    ]
    nominal = bool(np.isfinite(table.nominal).any())
    return {"coefficients": rows, "nominal": nominal, "prior_parameters": findings.prior_parameters}


def _nominal(value: float, mean: float) -> Markup:
    """A sum of link parameters that is zero but for rounding is written as zero."""
    return data(value, "0") if abs(value) < 1e-9 * abs(mean) else number(value)


def _percent(share: float) -> str:
    return f"{share:.1%}" if share < 0.1 else f"{share:.0%}" if share < 10.0 else "> 1000 %"


def _bar(mean: float, low: float, high: float, nominal: float) -> Markup:
    """A small picture of numbers that stand beside it."""
    zero = 60.0  # of 120, with 28 for the coefficient's own size

    def place(value: float) -> float:
        return zero + 28.0 * float(np.clip(value, -2.0, 2.0))

    tick = "" if np.isnan(nominal) else f'<path class="tick" d="M{place(nominal):.1f} 1v14"/>'
    return Markup(
        '<svg class="bar" viewBox="0 0 120 16" aria-hidden="true"><path class="zero" d="M60 0v16"/>'
        f'<rect x="{min(place(mean), zero):.1f}" y="4" width="{abs(place(mean) - zero):.1f}" height="8"/>'
        f'<path class="range" d="M{place(low):.1f} 8H{place(high):.1f}"/>{tick}</svg>'
    )


def _posterior(findings: Findings) -> dict[str, Any]:
    posterior = findings.summary.posterior
    if findings.draws is None or posterior is None:
        return {"posterior": None}
    few = len(findings.coefficients.mean) < 2
    drawn = [
        (forest_figure, "forest", 12, "Intervals of 95 % of the worst-decided coefficients, one an ensemble."),
        (pair_figure, "pair", 3, "Draws of the three worst-decided against each other."),
        (trace_figure, "trace", 4, "Densities and draws, sweep after sweep; one colour an ensemble."),
        (rank_figure, "rank", 4, "Ranks of each ensemble's draws: flat where the ensembles agree."),
    ]
    pictures = [
        picture(figure(findings, count), name, caption)
        for figure, name, count, caption in drawn
        if not (few and name == "pair")
    ]
    return {
        "posterior": posterior,
        "convergence": convergence(posterior.max_rhat, posterior.min_ess),
        "draws": pictures,
    }


def _residuals(findings: Findings) -> dict[str, Any]:
    return {"residuals": [_residual(findings, joint) for joint in range(1, findings.n_joints + 1)]}


def _residual(findings: Findings, joint: int) -> Picture:
    panels = [residual_panel(findings, joint, variable, TUNING.page_scatter) for variable in VARIABLES]
    figure = Figure([panels[:2], [panels[2], autocorrelation_panel(findings, joint)]], 4.4)
    caption = f"Joint {joint}: residual over time, velocity and position, and its autocorrelation."
    return picture(figure, f"residual{joint}", caption)


def _proof(findings: Findings) -> dict[str, Any]:
    search, count = findings.summary.search, len(findings.alternatives.cost)
    if not findings.summary.hidden_joints:
        return {}
    proven = search.lower_bound is not None
    others = list(_others(findings)) if search.certified else []  # else the list says nothing about the others
    caption = "Costs of the assignments that remain."
    pictures = [picture(alternatives_figure(findings), "alternatives", caption)] if proven else []
    return {
        "search_text": _search_text(search),
        "proven": proven,
        "alternatives": pictures,
        "others": others,
        "others_caption": f"The cheapest of {count - 1} other assignments that remain; where they differ from the "
        "best.",
        "alone": search.certified and count == 1,
    }


def _search_text(search: SearchSummary) -> str:
    text = (
        f"Search: {search.method}. It weighed {search.nodes} partial assignments by lower bounds of their cost, "
        f"solved {search.sdp_solves} least-squares problems over the feasible parameters, and took "
        f"{search.seconds:.1f} s in {search.rounds} round{'s' * (search.rounds != 1)}. The best assignment costs "
        f"{search.cost:.6g}."
    )
    if search.beam_nodes is not None:
        nodes = search.beam_nodes
        text += (
            f" The beam grew {nodes['grown']} nodes; {nodes['by_bound']} were pruned by the bound, {nodes['by_cone']} "
            f"by their cost in the cone, and {nodes['leaves']} survived the last step."
        )
        if undecided := nodes.get("undecided", 0):
            text += (
                f" Its time was up before it came to {undecided} segments: it predicted their signs from the others."
            )
    if search.unseen:
        starts = [f" ({way['starts']} starts)" if way["starts"] else "" for way in search.ways]
        tried = ", ".join(f"{way['name']}{count}" for way, count in zip(search.ways, starts, strict=True))
        text += (
            f" Ways of the last search: {tried}. One more start would lead to a better assignment with probability "
            f"{search.unseen:.1%}; confidences allow for it."
        )
    if search.lower_bound is None:
        return f"{text} Nothing is proven about assignments that the beam has dropped."
    text += (
        " No assignment costs less: every one was either weighed or ruled out by a bound."
        if search.certified
        else f" Every assignment costs at least {search.lower_bound:.6g}; what lies between is not ruled out."
    )
    if search.settled_share is not None and search.within is not None:
        text += (
            f" {search.settled_share:.1%} of the samples have the same sign in all assignments that cost at most "
            f"{search.within:.1f} more, which is {np.exp(-search.within / 2.0):.1g} of the best one's probability."
        )
    return text


def _others(findings: Findings) -> Iterator[dict[str, Any]]:
    """The cheapest other assignments."""
    table = findings.alternatives
    for b in range(1, min(len(table.cost), TUNING.assignments + 1)):
        here = np.flatnonzero(table.branch == b)
        joints = sorted({int(j) + 1 for j in table.joint[here]})
        yield {
            "above": table.cost[b] - table.cost[0],
            "mass": table.mass[b],
            "difference": f"{len(here)} in joint{'s' * (len(joints) > 1)} {listed([str(j) for j in joints])}",
            "spans": [
                {"joint": int(table.joint[k]), "start": table.start[k], "end": table.end[k]}
                for k in here[: TUNING.spans]
            ],
            "more": len(here) > TUNING.spans,
        }


def _validation(findings: Findings) -> dict[str, Any]:
    prediction = findings.prediction
    if prediction is None:
        return {"prediction": None, "validate": commands.validate(findings)}
    pictures = [
        _over_time(
            validation_panel(findings, joint, TUNING.page_curve),
            "validation",
            joint,
            f"Effort of joint {joint} over time on another log: measured, predicted, and the band of 95 %.",
        )
        for joint in range(1, findings.n_joints + 1)
    ]
    return {"prediction": prediction, "effort_unit": findings.effort_unit, "validations": pictures}


def _run(findings: Findings) -> dict[str, Any]:
    run = findings.summary.provenance
    rows = [
        *([("Command", run.command)] if run.command else []),
        *([("In Python", run.call)] if run.call else []),
        *((f"Option {name}", _option(value)) for name, value in run.options.items()),
        *((f"SHA-256 of {name}", digest) for name, digest in run.files.items()),
        ("SHA-256 of the samples", run.data),
        *((f"Version of {name}", number) for name, number in run.versions.items()),
        ("Machine", run.machine),
        *((f"Seconds: {name}", f"{seconds:.1f}") for name, seconds in findings.summary.timings.items()),
    ]
    return {"run": rows}


def _option(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value)


# ---------------------------------------------------------------------------------------------------------------
# In a notebook
# ---------------------------------------------------------------------------------------------------------------
@one_at_a_time
def identification_view(identification: Identification) -> str:
    """What its text says, the checks, and the efforts of the joint that fits worst; HTML without a script."""
    findings = find_findings(identification)
    joint = int(identification.fit.relative_residual.argmax()) + 1
    (ax,) = draw(Figure([[torque_panel(findings, joint)]], 3.0, WIDE, key=True))
    return fragment(
        "notebook.html.jinja",
        text=repr(identification),
        checks=[(check, check.remedy, _NOTEBOOK[check.state]) for check in check_findings(findings)],
        joint=joint,
        figure=Markup(svg_of(ax, f"efforts of joint {joint}, recorded and by the model")),
    )
