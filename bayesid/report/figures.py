"""The figures of a discrepancy, as matplotlib figures without a window or a global state, and as SVG for a page.

All ink is one grey that a page replaces by the colour of its text; the other colours, orange and blue, are seen on
white and on black, and by the colour-blind.
"""

from __future__ import annotations

import io
import re
from html import escape
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesid.discrepancy.compare import variables
from bayesid.discrepancy.evidence import LN10
from bayesid.discrepancy.scores import THRESHOLD
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.motion import Array
from bayesid.report.words import best_first, rounded, score_label, unit_of

INK, BEFORE, AFTER = "#767676", "#cc6a1a", "#2b83c6"
_AS_IT_WAS, _EXTENDED = "model as it was", "extended"
_WIDTH = 5.4
"""in; two fit side by side on a page, one on a telephone."""
_SIZE = 10.0
_POINTS = 1500
_BINS = 24
BARS = 12
_RASTER = 20_000
"""Samples from which on curves are stored as an image."""
_DPI = 160


# ---------------------------------------------------------------------------------------------------------------
# Figures
# ---------------------------------------------------------------------------------------------------------------
def residual_figure(discrepancy: Discrepancy, joint: int) -> Figure:
    """What the model leaves of a joint's (from 1) efforts, before and after, over the variable that shows it best.

    Points are samples of the log, evenly thinned; lines are means over equally many samples with twice their standard
    error, samples taken as independent; the band is the noise floor.
    """
    trial, j = discrepancy.trial, joint - 1
    variable = next(one.variable for one in discrepancy.where if one.joint == joint)
    used = trial.used[:, j]
    value = variables(trial, discrepancy.predicted_before, j)[variable][used]
    figure = _figure(2.6)
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    sides = (discrepancy.predicted_before, BEFORE, _AS_IT_WAS), (discrepancy.predicted_after, AFTER, _EXTENDED)
    for ax, (predicted, colour, title) in zip(axes, sides, strict=True):
        _residual(ax, value, (trial.nearest(predicted) - predicted)[used, j], colour)
        floor = float(discrepancy.floor.rms[j])
        ax.axhspan(-floor, floor, color=INK, alpha=0.25, linewidth=0.0, zorder=0, label="noise floor")
        ax.set_title(title, fontsize=_SIZE, color=colour, fontweight="bold")
        _dress(ax)
    axes[0].set_ylabel(f"residual, {unit_of(discrepancy, joint)}", fontsize=_SIZE, color=INK)
    figure.supxlabel(f"{variable}, {unit_of(discrepancy, joint, variable)}", fontsize=_SIZE, color=INK)
    return figure


def effort_figure(discrepancy: Discrepancy, joint: int) -> Figure:
    """Measured effort of a joint (from 1), where unsigned with the sign of the extended model, and both models'."""
    trial, j = discrepancy.trial, joint - 1
    time = trial.signals.motion.t - trial.signals.motion.origin
    raster = len(time) > _RASTER
    figure = _figure(2.4)
    ax = figure.subplots()
    curves = (
        (trial.nearest(discrepancy.predicted_after), INK, 2.4, "measured"),
        (discrepancy.predicted_before, BEFORE, 1.0, _AS_IT_WAS),
        (discrepancy.predicted_after, AFTER, 1.0, _EXTENDED),
    )
    for effort, colour, width, name in curves:
        ax.plot(time, effort[:, j], color=colour, linewidth=width, label=name, rasterized=raster)
    ax.lines[0].set_alpha(0.55)
    ax.set_xlabel("time, s", fontsize=_SIZE, color=INK)
    ax.set_ylabel(f"effort, {unit_of(discrepancy, joint)}", fontsize=_SIZE, color=INK)
    ax.margins(x=0.01)
    _dress(ax)
    _legend(figure, ax)
    return figure


def gap_figure(discrepancy: Discrepancy) -> Figure:
    """RMS of what the model leaves of each joint's efforts, before and after, in units of the noise floor."""
    floor, n = discrepancy.floor.rms, len(discrepancy.before)
    place = np.arange(n)
    figure = _figure(0.9 + 0.36 * n)
    ax = figure.subplots()
    sides = (discrepancy.before, BEFORE, -0.2, _AS_IT_WAS), (discrepancy.after, AFTER, 0.2, _EXTENDED)
    for gap, colour, shift, name in sides:
        ax.barh(place + shift, gap / floor, height=0.36, color=colour, label=name)
        for j, ratio in enumerate((gap / floor).tolist()):
            told = f"{rounded(float(gap[j]))} {unit_of(discrepancy, j + 1)}"
            _beside(ax, max(ratio, 1.0), j + shift, told)  # clear of the floor's line
    ax.axvline(1.0, color=INK, linewidth=1.2, linestyle="--", label="noise floor")
    ax.set_yticks(place, [f"joint {j + 1}" for j in place])
    ax.invert_yaxis()
    ax.set_xlabel("gap, in units of the noise floor", fontsize=_SIZE, color=INK)
    ax.margins(x=0.22)
    _dress(ax, "x")
    _legend(figure, ax)
    return figure


def candidate_figure(discrepancy: Discrepancy) -> Figure:
    """The best effects by the log10 of their Bayes factors, before anything was added; those that were are blue."""
    best = best_first(discrepancy.scores)[:BARS]
    found = {(one.effect, one.joints) for one in discrepancy.found}
    gains = np.array([score.gain / LN10 for score in best])
    figure = _figure(0.9 + 0.24 * max(len(best), 1))
    ax = figure.subplots()
    colours = [AFTER if score.key in found else INK for score in best]
    ax.barh(np.arange(len(best)), gains, height=0.7, color=colours)
    for i, gain in enumerate(gains.tolist()):
        _beside(ax, max(gain, 0.0), i, rounded(gain))
    ax.axvline(THRESHOLD, color=BEFORE, linewidth=1.2, linestyle="--", label=f"needed to be added: {THRESHOLD:g}")
    ax.axvline(0.0, color=INK, linewidth=0.8)
    ax.set_yticks(np.arange(len(best)), [score_label(score) for score in best])
    ax.invert_yaxis()
    ax.set_xlabel("log10 of the Bayes factor", fontsize=_SIZE, color=INK)
    ax.margins(x=0.16)
    _dress(ax, "x")
    _legend(figure, ax)
    return figure


# ---------------------------------------------------------------------------------------------------------------
# Parts
# ---------------------------------------------------------------------------------------------------------------
def _figure(height: float) -> Figure:
    return Figure(figsize=(_WIDTH, height), layout="constrained", facecolor="none")


def _residual(ax: Axes, value: Array, residual: Array, colour: str) -> None:
    shown = np.unique(np.linspace(0, len(value) - 1, min(len(value), _POINTS)).round().astype(np.int64))
    ax.scatter(value[shown], residual[shown], s=4.0, color=colour, alpha=0.4, linewidths=0.0, rasterized=True)
    centre, mean, error = binned(value, residual)
    ax.errorbar(centre, mean, yerr=2.0 * error, color=INK, linewidth=1.4, marker="o", markersize=3.0, capsize=2.0)


def _beside(ax: Axes, x: float, y: float, told: str) -> None:
    """What a bar says, to the right of it."""
    look: dict[str, Any] = {"fontsize": _SIZE - 1.5, "color": INK, "va": "center_baseline"}
    ax.annotate(told, (x, y), (4.0, 0.0), textcoords="offset points", **look)


def binned(value: Array, residual: Array) -> tuple[Array, Array, Array]:
    """(b,) means of the variable and the residual over equally many samples each, and the latter's standard error."""
    order = np.array_split(np.argsort(value, kind="stable"), min(_BINS, max(1, len(value) // 2)))
    full = [rows for rows in order if len(rows) > 1]
    centre, mean = (np.array([one[rows].mean() for rows in full]) for one in (value, residual))
    error = np.array([residual[rows].std(ddof=1) / np.sqrt(len(rows)) for rows in full])
    return centre, mean, error


def _dress(ax: Axes, grid: Literal["both", "x"] = "both") -> None:
    """One ink for all that is not data."""
    ax.set_facecolor("none")
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color(INK)
    ax.tick_params(color=INK, labelcolor=INK, labelsize=_SIZE - 1.0)
    ax.grid(axis=grid, color=INK, alpha=0.2, linewidth=0.6)
    ax.set_axisbelow(True)
    for axis in (ax.xaxis, ax.yaxis):
        axis.get_offset_text().set(color=INK, fontsize=_SIZE - 1.0)


def _legend(figure: Figure, ax: Axes) -> None:
    """Above the axes, in one row."""
    handles, names = ax.get_legend_handles_labels()
    look: dict[str, Any] = {"frameon": False, "fontsize": _SIZE - 1.0, "labelcolor": INK}
    figure.legend(handles, names, loc="outside upper center", ncols=len(names), **look)


# ---------------------------------------------------------------------------------------------------------------
# For a page
# ---------------------------------------------------------------------------------------------------------------
def inline_svg(figure: Figure, name: str, told: str) -> str:
    """A figure as an element of a page: text in the page's font and colour, nothing but what is in it.

    Args:
        figure: of this file.
        name: begins its identifiers, so that those of several figures do not clash.
        told: what it shows, for those who do not see it.
    """
    text = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "bayesid"}):
        figure.savefig(text, format="svg", dpi=_DPI, transparent=True)
    svg = text.getvalue()[text.getvalue().index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", svg, flags=re.DOTALL)
    head, body = svg.split(">", 1)
    box = re.search(r'viewBox="[^"]*"', head)
    body = re.sub(r'\bid="', f'id="{name}-', body)
    body = re.sub(r'(url\(|href=")#', rf"\g<1>#{name}-", body).replace("xlink:href", "href")
    body = re.sub(r"font-family: [^;\"]*;? ?", "", body).replace(INK, "currentColor")
    body = re.sub(r' d="([^"]*)"', lambda found: f' d="{_shortened(found[1])}"', body)
    return f'<svg role="img" aria-label="{escape(told)}" {box[0] if box else ""}>{body.strip()}'


def _shortened(path: str) -> str:
    """The path to a hundredth of a point."""
    return re.sub(r"-?\d+\.\d+", lambda found: f"{float(found[0]):.2f}".rstrip("0").rstrip("."), " ".join(path.split()))
