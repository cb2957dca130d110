"""The figures of a discrepancy, and the time line of several logs."""

from __future__ import annotations

import textwrap

import numpy as np

from bayesid.arrays import Array
from bayesid.discrepancy.case import variables
from bayesid.discrepancy.comparison import ChangeReport
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.identification.prediction import NORMAL_95
from bayesid.number_text import rounded
from bayesid.regression.selection.added_effect import AddedEffect
from bayesid.regression.selection.fitted_effects import LN10
from bayesid.report.comparison import moved_parameters
from bayesid.report.discrepancy import new_model
from bayesid.report.plot import figure as fig
from bayesid.report.report_data import binned, evenly
from bayesid.report.tuning import TUNING
from bayesid.report.words import best_first, score_label, unit_of

_EARLIER = "earlier model"
_BEFORE, _AFTER = fig.ORANGE, fig.BLUE


# ---- One discrepancy ----
def residual_figure(discrepancy: Discrepancy, joint: int) -> fig.Figure:
    """Residual of a joint (from 1), before and after, over the variable that explains most of it.

    Points are samples of the log, evenly thinned; lines are means over equally many samples with twice their standard
    error for independent samples; the band is the noise floor.
    """
    trial, j = discrepancy.trial, joint - 1
    variable = next(excess.variable for excess in discrepancy.where if excess.joint == joint)
    used = trial.used[:, j]
    value = variables(trial, discrepancy.predicted_before, j)[variable][used]
    floor = float(discrepancy.floor.rms[j])
    panels, new = list[fig.Panel](), new_model(discrepancy)
    sides = (discrepancy.predicted_before, _BEFORE, _EARLIER), (discrepancy.predicted_after, _AFTER, new)
    for predicted, colour, title in sides:
        residual = (trial.nearest(predicted) - predicted)[used, j]
        shown = evenly(len(value), TUNING.scatter)
        centre, mean, error = binned(value, residual)
        marks: list[fig.Mark] = [
            fig.Boxes(None, ([-floor], [floor]), fig.INK, "noise floor", 0.25),
            fig.Dots(value[shown], residual[shown], colour, size=2.0, alpha=0.4),
            *fig.means(centre, mean, 2.0 * error, fig.INK),
        ]
        y_name = f"residual, {unit_of(discrepancy, joint)}"
        panels.append(fig.Panel(marks, title=title, title_colour=colour, y_name=y_name))
    x_name = f"{variable}, {unit_of(discrepancy, joint, variable)}"
    return fig.Figure([fig.with_common_limits(panels)], 2.6, x_name=x_name)


def effort_figure(discrepancy: Discrepancy, joint: int) -> fig.Figure:
    """Measured effort of a joint (from 1), with the new model's sign where unsigned, and both models' efforts."""
    trial, j = discrepancy.trial, joint - 1
    time = trial.signals.motion.t - trial.signals.motion.origin
    curves = (
        fig.Line(time, trial.nearest(discrepancy.predicted_after)[:, j], fig.INK, "measured", 2.4, 0.55),
        fig.Line(time, discrepancy.predicted_before[:, j], _BEFORE, _EARLIER, 1.0),
        fig.Line(time, discrepancy.predicted_after[:, j], _AFTER, new_model(discrepancy), 1.0),
    )
    marks = fig.thinned(curves, TUNING.page_curve)
    panel = fig.Panel(marks, "time, s", f"effort, {unit_of(discrepancy, joint)}", margins=(0.01, 0.05))
    return fig.Figure([[panel]], 2.4, key=True)


def gap_figure(discrepancy: Discrepancy) -> fig.Figure:
    """Gap of each joint, before and after, in units of the noise floor."""
    floor, n = discrepancy.floor.rms, len(discrepancy.before)
    place = np.arange(n)
    marks: list[fig.Mark] = []
    sides = (discrepancy.before, _BEFORE, -0.2, _EARLIER), (discrepancy.after, _AFTER, 0.2, new_model(discrepancy))
    for gap, colour, shift, name in sides:
        ratio, row = gap / floor, place + shift
        texts = [f"{rounded(float(of_joint))} {unit_of(discrepancy, j)}" for j, of_joint in enumerate(gap, start=1)]
        marks.append(fig.Boxes((np.zeros(n), ratio), (row - 0.18, row + 0.18), colour, name))
        marks.append(fig.Words(np.maximum(ratio, 1.0), row, texts))  # clear of the floor's line
    marks.append(fig.upright(1.0, fig.INK, 1.2, "dashed", "noise floor"))
    names = [f"joint {j + 1}" for j in place]
    return fig.listing(marks, names, "gap, in units of the noise floor", 0.9 + 0.36 * n, margin=0.22)


def candidate_figure(discrepancy: Discrepancy) -> fig.Figure:
    """The best effects by log10 Bayes factor, each added alone; blue: added to the model."""
    best = best_first(discrepancy.scores)[: TUNING.bars]
    added = {(effect.effect, effect.joints) for effect in discrepancy.added}
    gains, row = np.array([score.gain / LN10 for score in best]), np.arange(len(best))
    needed = discrepancy.thresholds.log10_bayes_factor
    ends = np.minimum(gains, 0.0), np.maximum(gains, 0.0)
    colours = [_AFTER if score.key in added else fig.INK for score in best]
    marks: list[fig.Mark] = [
        *([fig.Boxes(ends, (row - 0.35, row + 0.35), colours)] if best else []),
        fig.Words(np.maximum(gains, 0.0), row, [rounded(float(gain)) for gain in gains]),
        fig.upright(needed, _BEFORE, 1.2, "dashed", f"threshold: {needed:g}"),
        fig.upright(0.0),
    ]
    names = [score_label(score) for score in best]
    return fig.listing(marks, names, "log10 of the Bayes factor", 0.9 + 0.24 * max(len(best), 1), margin=0.16)


def learned_figure(added: AddedEffect, unit: str) -> fig.Figure:
    """The functions of a learned effect over the range of the log, each with its 95 % band.

    A function of two variables is drawn over the first, at three values of the second.
    """
    panels = []
    for curve in added.hypothesis.curves:
        marks: list[fig.Mark] = [fig.level(0.0)]
        for k, value in enumerate(curve.levels):
            colour = (_AFTER, fig.INK, _BEFORE)[k % 3]
            label = f"{curve.other} = {rounded(float(value), 2)}" if curve.other else "learned"
            half = NORMAL_95 * curve.sd[k]
            marks.append(fig.Band(curve.x, curve.mean[k] - half, curve.mean[k] + half, colour))
            marks.append(fig.Line(curve.x, curve.mean[k], colour, label, 1.2))
        turning = f", times the sign of {curve.turning}" if curve.turning else ""
        title = f"over {curve.variable}{turning}"
        panels.append(fig.Panel(marks, curve.variable, f"effort, {unit}", title))
    return fig.Figure([panels], 2.6, key=True)


# ---- Several logs ----
def timeline_figure(comparison: ChangeReport) -> fig.Figure:
    """Parameters that changed, with 95 % intervals, over days or, without dates, over the order of the logs.

    The largest changes come first. The last panel has the changes of all others in standard deviations.
    """
    line, rows = comparison.timeline, moved_parameters(comparison)
    rows = sorted(rows, key=lambda row: -np.nanmax(np.abs(row.z)))[: TUNING.moved]
    shown = {row.place for row in rows}
    others = [c for c in range(len(line.tracked)) if c not in shown and np.isfinite(line.p[:, c]).any()]
    x = instants(comparison)
    names = [textwrap.shorten(row.name, 32, placeholder="...") for row in rows]
    drawn = [
        (_followed(x, np.array(row.value), np.array(row.sd)), row.unit or "1", name)
        for row, name in zip(rows, names, strict=True)
    ]
    if others:
        title = f"{len(others)} other{'s' * (len(others) > 1)}, no significant change"
        drawn.append((_flat(x, line.z[:, others]), "change / its sd", title))
    room = 0.12 * float(np.ptp(x))
    limits = (float(x.min()) - room, float(x.max()) + room) if room else None
    ticks = None if by_date(comparison) else (x, [f"{place:.0f}" for place in x])
    panels = [
        fig.Panel(marks, y_name=name, title=title, x_limits=limits, x_ticks=ticks) for marks, name, title in drawn
    ]
    grid = fig.rows_of(panels, min(2, len(panels)))
    x_name = "days since the first log" if by_date(comparison) else "log"
    return fig.Figure(grid, 1.75 * len(grid) + 0.3, x_name=x_name)


def by_date(comparison: ChangeReport) -> bool:
    """Whether the x axis shows dates: known, ascending, and not all equal."""
    dates = comparison.dates
    return dates.known and dates.ascending and bool(dates.days[-1] > 0.0)


def instants(comparison: ChangeReport) -> Array:
    """(K,) days since the first log, or 1, 2, .."""
    return comparison.dates.days if by_date(comparison) else np.arange(1.0, len(comparison.logs) + 1.0)


def _followed(x: Array, value: Array, sd: Array) -> list[fig.Mark]:
    known = np.isfinite(sd) & np.isfinite(value)
    return fig.means(x[known], value[known], NORMAL_95 * sd[known], _AFTER, 4.0)


def _flat(x: Array, z: Array) -> list[fig.Mark]:
    """Changes (K, C) in standard deviations, in grey; zero for the first log."""
    drawn = z.copy()
    drawn[0] = 0.0
    known = np.isfinite(drawn)
    pairs = zip(drawn.T, known.T, strict=True)
    return [fig.Line(x[shown], values[shown], fig.INK, "", 0.8, 0.5) for values, shown in pairs]
