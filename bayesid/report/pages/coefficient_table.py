"""The table of coefficients of a page."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np
from markupsafe import Markup

from bayesid.arrays import TINY
from bayesid.number_text import percent, quantity
from bayesid.posterior.tuning import TUNING as POSTERIOR
from bayesid.report.pages import rendering as html
from bayesid.report.report_data import CoefficientTable, ReportData
from bayesid.report.words import joints_in_words, meaning


def coefficient_parts(findings: ReportData) -> list[Markup]:
    """The table, and notes on individual parameters."""
    found = findings.coefficients
    nominal, sd = bool(np.isfinite(found.nominal).any()), findings.sd_apart
    relative_sd = np.abs(sd / np.where(found.mean == 0.0, TINY, found.mean))
    rows = []
    for k, mean in enumerate(found.mean):
        low, high = found.low[k], found.high[k]
        known = np.isfinite([low, high]).all()  # else the coefficient is not excited
        interval = Markup('<span class="interval">{} to {}</span>').format(html.number(low), html.number(high))
        rows.append(
            (
                found.name[k],
                html.data(mean, quantity(float(mean), float(sd[k]), found.unit[k])),
                html.data(relative_sd[k], _percent(relative_sd[k])),
                interval if known else html.NONE,
                *([_nominal(found.nominal[k], mean)] if nominal else []),
                "no" if found.by_data[k] else Markup("<strong>yes</strong>"),
                _bar(*(float(values[k]) for values in found.bar)),
                Markup('<span class="expression">{}</span>').format(html.typeset(_meaning(found, k))),
            )
        )
    fixed = ", common factor fixed" if findings.summary.gains is not None else ""
    headings = ["Name", f"Value and sd{fixed}", f"Relative sd{fixed}", "95 % interval"]
    headings += [*(["Nominal"] if nominal else []), "Prior matters", "Scaled", "Meaning"]
    names = ", ".join(findings.prior_parameters)
    by_prior = html.paragraph(
        f"Individual parameters that are not identifiable (the prior decides them): {names}.", note=True
    )
    notes = [by_prior] if names else []
    if on_edge := findings.summary.fit.links_on_edge:
        links = joints_in_words(on_edge).replace("joint", "link", 1)
        note = (
            f"Do not use individual parameters of {links}. The fit places such a link's mass in a plane, a line or a "
            "point: this is the edge of physical feasibility. Coefficients and predicted efforts are not affected."
        )
        notes.append(html.paragraph(note, note=True))
    return [html.table(_caption(nominal, bool(fixed), found.expression), headings, rows), *notes]


def _caption(nominal: bool, gains: bool, expressions: Iterable[str]) -> str:
    tick = "; tick, nominal value" if nominal else ""
    named = any(re.search(r"\b[ad]\d", expression) for expression in expressions)
    lengths = "; a2 and d2 are lengths of the robot file" if named else ""
    text = (
        "Base coefficients: the combinations of parameters that act on the efforts. Of link 2, J2xx is an inertia "
        "about the origin of its frame, mc2x a first moment (mass times centre of mass), m2 the mass. M2 is the mass "
        f"of links 2 to the last{lengths}. Prior matters: it gives more than "
        f"{percent(POSTERIOR.of_prior, 0)} of the precision. Scaled by the coefficient's size: "
        f"bar, mean; line, 95 % interval{tick}."
    )
    common = " The intervals include the common factor of the gains, the standard deviations do not."
    return text + common if gains else text


def _meaning(found: CoefficientTable, k: int) -> str:
    """The expression of a combination; what a single parameter is."""
    return (meaning(found.name[k]) if found.expression[k] == found.name[k] else "") or found.expression[k]


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
