"""The figures of a discrepancy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.arrays import Array
from bayesid.discrepancy.compare import variables
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.regression.selection.added_effect import AddedEffect
from bayesid.regression.selection.explanation import LN10
from bayesid.report.plot.ink import BLUE as AFTER
from bayesid.report.plot.ink import INK, SIZE, WIDTH
from bayesid.report.plot.ink import ORANGE as BEFORE
from bayesid.report.plot.style import NewFigure, dress, legend, new_figure
from bayesid.report.thinning import binned, envelope, evenly
from bayesid.report.words import best_first, rounded, score_label, unit_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_AS_IT_WAS, _EXTENDED = "model as it was", "extended"
_POINTS = 1500
"""Samples of a scatter, at most: more would hide each other."""
BARS = 12
"""Candidates that are drawn: as many as a figure on a telephone has room for."""
LEVELS = (AFTER, INK, BEFORE)
"""Colours of curves at values of another variable, from the least one."""
_SURELY = 1.96
"""Standard deviations of a 95 % band."""
_CURVE = 2000
"""Points of a curve, at most about: some five a pixel."""


# ---------------------------------------------------------------------------------------------------------------
# Figures
# ---------------------------------------------------------------------------------------------------------------
def residual_figure(discrepancy: Discrepancy, joint: int, make: NewFigure = new_figure) -> Figure:
    """What the model leaves of a joint's (from 1) efforts, before and after, over the variable that shows it best.

    Points are samples of the log, evenly thinned; lines are means over equally many samples with twice their standard
    error, samples taken as independent; the band is the noise floor.
    """
    trial, j = discrepancy.trial, joint - 1
    variable = next(excess.variable for excess in discrepancy.where if excess.joint == joint)
    used = trial.used[:, j]
    value = variables(trial, discrepancy.predicted_before, j)[variable][used]
    figure = make(2.6, WIDTH)
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    sides = (discrepancy.predicted_before, BEFORE, _AS_IT_WAS), (discrepancy.predicted_after, AFTER, _EXTENDED)
    for ax, (predicted, colour, title) in zip(axes, sides, strict=True):
        _residual(ax, value, (trial.nearest(predicted) - predicted)[used, j], colour)
        floor = float(discrepancy.floor.rms[j])
        ax.axhspan(-floor, floor, color=INK, alpha=0.25, linewidth=0.0, zorder=0, label="noise floor")
        ax.set_title(title, fontsize=SIZE, color=colour, fontweight="bold")
        dress(ax)
    axes[0].set_ylabel(f"residual, {unit_of(discrepancy, joint)}", fontsize=SIZE, color=INK)
    figure.supxlabel(f"{variable}, {unit_of(discrepancy, joint, variable)}", fontsize=SIZE, color=INK)
    return figure


def effort_figure(discrepancy: Discrepancy, joint: int, make: NewFigure = new_figure) -> Figure:
    """Measured effort of a joint (from 1), where unsigned with the sign of the extended model, and both models'."""
    trial, j = discrepancy.trial, joint - 1
    time = trial.signals.motion.t - trial.signals.motion.origin
    figure = make(2.4, WIDTH)
    ax = figure.subplots()
    curves = (
        (trial.nearest(discrepancy.predicted_after), INK, 2.4, 0.55, "measured"),
        (discrepancy.predicted_before, BEFORE, 1.0, 1.0, _AS_IT_WAS),
        (discrepancy.predicted_after, AFTER, 1.0, 1.0, _EXTENDED),
    )
    for effort, colour, width, alpha, name in curves:
        rows = envelope(effort[:, j], _CURVE)
        ax.plot(time[rows], effort[rows, j], color=colour, linewidth=width, alpha=alpha, label=name)
    ax.set_xlabel("time, s", fontsize=SIZE, color=INK)
    ax.set_ylabel(f"effort, {unit_of(discrepancy, joint)}", fontsize=SIZE, color=INK)
    ax.margins(x=0.01)
    dress(ax)
    legend(ax)
    return figure


def gap_figure(discrepancy: Discrepancy, make: NewFigure = new_figure) -> Figure:
    """RMS of what the model leaves of each joint's efforts, before and after, in units of the noise floor."""
    floor, n = discrepancy.floor.rms, len(discrepancy.before)
    place = np.arange(n)
    figure = make(0.9 + 0.36 * n, WIDTH)
    ax = figure.subplots()
    sides = (discrepancy.before, BEFORE, -0.2, _AS_IT_WAS), (discrepancy.after, AFTER, 0.2, _EXTENDED)
    for gap, colour, shift, name in sides:
        ax.barh(place + shift, gap / floor, height=0.36, color=colour, label=name)
        for j, ratio in enumerate((gap / floor).tolist()):
            text = f"{rounded(float(gap[j]))} {unit_of(discrepancy, j + 1)}"
            _beside(ax, max(ratio, 1.0), j + shift, text)  # clear of the floor's line
    ax.axvline(1.0, color=INK, linewidth=1.2, linestyle="--", label="noise floor")
    ax.set_yticks(place, [f"joint {j + 1}" for j in place])
    ax.invert_yaxis()
    ax.set_xlabel("gap, in units of the noise floor", fontsize=SIZE, color=INK)
    ax.margins(x=0.22)
    dress(ax, "x")
    legend(ax)
    return figure


def learned_figure(added: AddedEffect, unit: str, make: NewFigure = new_figure) -> Figure:
    """The functions of an effect without a name over the range seen, each with its 95 % band.

    One of two variables is drawn over the first, at three values of the other.

    Args:
        added: the effect.
        unit: of its effort.
        make: makes the figure.
    """
    curves = added.hypothesis.curves
    figure = make(2.6, WIDTH)
    axes = np.ravel(figure.subplots(1, len(curves), squeeze=False))
    axes[0].set_ylabel(f"effort, {unit}", fontsize=SIZE, color=INK)
    for ax, curve in zip(axes, curves, strict=True):
        for k, level in enumerate(curve.levels):
            colour = LEVELS[k % len(LEVELS)]
            label = f"{curve.other} = {rounded(float(level), 2)}" if curve.other else "learned"
            low, high = (curve.mean[k] + side * _SURELY * curve.sd[k] for side in (-1.0, 1.0))
            ax.fill_between(curve.x, low, high, color=colour, alpha=0.25, linewidth=0.0)
            ax.plot(curve.x, curve.mean[k], color=colour, linewidth=1.2, label=label)
        ax.axhline(0.0, color=INK, linewidth=0.8)
        ax.set_xlabel(curve.variable, fontsize=SIZE, color=INK)
        turning = f", times the sign of {curve.turning}" if curve.turning else ""
        ax.set_title(f"over {curve.variable}{turning}", fontsize=SIZE, color=INK)
        dress(ax)
        legend(ax)
    return figure


def candidate_figure(discrepancy: Discrepancy, make: NewFigure = new_figure) -> Figure:
    """The best effects by the log10 of their Bayes factors, before anything was added; those that were are blue."""
    best = best_first(discrepancy.scores)[:BARS]
    added = {(effect.effect, effect.joints) for effect in discrepancy.added}
    gains = np.array([score.gain / LN10 for score in best])
    figure = make(0.9 + 0.24 * max(len(best), 1), WIDTH)
    ax = figure.subplots()
    colours = [AFTER if score.key in added else INK for score in best]
    ax.barh(np.arange(len(best)), gains, height=0.7, color=colours)
    for i, gain in enumerate(gains.tolist()):
        _beside(ax, max(gain, 0.0), i, rounded(gain))
    needed = discrepancy.thresholds.log10_bayes_factor
    ax.axvline(needed, color=BEFORE, linewidth=1.2, linestyle="--", label=f"needed to be added: {needed:g}")
    ax.axvline(0.0, color=INK, linewidth=0.8)
    ax.set_yticks(np.arange(len(best)), [score_label(score) for score in best])
    ax.invert_yaxis()
    ax.set_xlabel("log10 of the Bayes factor", fontsize=SIZE, color=INK)
    ax.margins(x=0.16)
    dress(ax, "x")
    legend(ax)
    return figure


# ---------------------------------------------------------------------------------------------------------------
# Parts
# ---------------------------------------------------------------------------------------------------------------
def _residual(ax: Axes, value: Array, residual: Array, colour: str) -> None:
    shown = evenly(len(value), _POINTS)
    ax.scatter(value[shown], residual[shown], s=4.0, color=colour, alpha=0.4, linewidths=0.0, rasterized=True)
    centre, mean, error = binned(value, residual)
    ax.errorbar(centre, mean, yerr=2.0 * error, color=INK, linewidth=1.4, marker="o", markersize=3.0, capsize=2.0)


def _beside(ax: Axes, x: float, y: float, text: str) -> None:
    """What a bar says, to the right of it."""
    look: dict[str, Any] = {"fontsize": SIZE - 1.5, "color": INK, "va": "center_baseline"}
    ax.annotate(text, (x, y), (4.0, 0.0), textcoords="offset points", **look)
