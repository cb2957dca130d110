"""The figures of a discrepancy, and the time line of several logs."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np

from bayesid.arrays import Array
from bayesid.discrepancy.case import variables
from bayesid.discrepancy.comparison import LogComparison
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.identification.prediction import NORMAL_95
from bayesid.regression.selection.added_effect import AddedEffect
from bayesid.regression.selection.explanation import LN10
from bayesid.report.plot.figure import BLUE as AFTER
from bayesid.report.plot.figure import (
    INK,
    Band,
    Boxes,
    Dots,
    Figure,
    Line,
    Mark,
    Panel,
    Words,
    level,
    means,
    rows_of,
    thinned,
    upright,
    with_common_limits,
)
from bayesid.report.plot.figure import ORANGE as BEFORE
from bayesid.report.thinning import binned, evenly
from bayesid.report.timeline_text import moved_parameters
from bayesid.report.tuning import TUNING
from bayesid.report.words import best_first, rounded, score_label, unit_of

_AS_IT_WAS, _EXTENDED = "model as it was", "extended"


# ---------------------------------------------------------------------------------------------------------------
# One discrepancy
# ---------------------------------------------------------------------------------------------------------------
def residual_figure(discrepancy: Discrepancy, joint: int) -> Figure:
    """What the model leaves of a joint's (from 1) efforts, before and after, over the variable that shows it best.

    Points are samples of the log, evenly thinned; lines are means over equally many samples with twice their standard
    error, samples taken as independent; the band is the noise floor.
    """
    trial, j = discrepancy.trial, joint - 1
    variable = next(excess.variable for excess in discrepancy.where if excess.joint == joint)
    used = trial.used[:, j]
    value = variables(trial, discrepancy.predicted_before, j)[variable][used]
    floor = float(discrepancy.floor.rms[j])
    panels = []
    sides = (discrepancy.predicted_before, BEFORE, _AS_IT_WAS), (discrepancy.predicted_after, AFTER, _EXTENDED)
    for predicted, colour, title in sides:
        residual = (trial.nearest(predicted) - predicted)[used, j]
        shown = evenly(len(value), TUNING.scatter)
        centre, mean, error = binned(value, residual)
        marks: list[Mark] = [
            Boxes(None, ([-floor], [floor]), INK, "noise floor", 0.25),
            Dots(value[shown], residual[shown], colour, size=2.0, alpha=0.4),
            *means(centre, mean, 2.0 * error, INK),
        ]
        panels.append(Panel(marks, title=title, title_colour=colour, y_name=f"residual, {unit_of(discrepancy, joint)}"))
    x_name = f"{variable}, {unit_of(discrepancy, joint, variable)}"
    return Figure([with_common_limits(panels)], 2.6, x_name=x_name)


def effort_figure(discrepancy: Discrepancy, joint: int) -> Figure:
    """Measured effort of a joint (from 1), where unsigned with the sign of the extended model, and both models'."""
    trial, j = discrepancy.trial, joint - 1
    time = trial.signals.motion.t - trial.signals.motion.origin
    curves = (
        Line(time, trial.nearest(discrepancy.predicted_after)[:, j], INK, "measured", 2.4, 0.55),
        Line(time, discrepancy.predicted_before[:, j], BEFORE, _AS_IT_WAS, 1.0),
        Line(time, discrepancy.predicted_after[:, j], AFTER, _EXTENDED, 1.0),
    )
    panel = Panel(
        thinned(curves, TUNING.page_curve), "time, s", f"effort, {unit_of(discrepancy, joint)}", margins=(0.01, 0.05)
    )
    return Figure([[panel]], 2.4, key=True)


def gap_figure(discrepancy: Discrepancy) -> Figure:
    """RMS of what the model leaves of each joint's efforts, before and after, in units of the noise floor."""
    floor, n = discrepancy.floor.rms, len(discrepancy.before)
    place = np.arange(n)
    marks: list[Mark] = []
    sides = (discrepancy.before, BEFORE, -0.2, _AS_IT_WAS), (discrepancy.after, AFTER, 0.2, _EXTENDED)
    for gap, colour, shift, name in sides:
        ratio, row = gap / floor, place + shift
        texts = [f"{rounded(float(one))} {unit_of(discrepancy, j)}" for j, one in enumerate(gap, start=1)]
        marks.append(Boxes((np.zeros(n), ratio), (row - 0.18, row + 0.18), colour, name))
        marks.append(Words(np.maximum(ratio, 1.0), row, texts))  # clear of the floor's line
    marks.append(upright(1.0, INK, 1.2, "dashed", "noise floor"))
    names = [f"joint {j + 1}" for j in place]
    return _bars(marks, names, "gap, in units of the noise floor", 0.9 + 0.36 * n, 0.22)


def candidate_figure(discrepancy: Discrepancy) -> Figure:
    """The best effects by the log10 of their Bayes factors, before anything was added; those that were are blue."""
    best = best_first(discrepancy.scores)[: TUNING.bars]
    added = {(effect.effect, effect.joints) for effect in discrepancy.added}
    gains, row = np.array([score.gain / LN10 for score in best]), np.arange(len(best))
    needed = discrepancy.thresholds.log10_bayes_factor
    ends, colours = (np.minimum(gains, 0.0), np.maximum(gains, 0.0)), [AFTER if s.key in added else INK for s in best]
    marks: list[Mark] = [
        *([Boxes(ends, (row - 0.35, row + 0.35), colours)] if best else []),
        Words(np.maximum(gains, 0.0), row, [rounded(float(gain)) for gain in gains]),
        upright(needed, BEFORE, 1.2, "dashed", f"needed to be added: {needed:g}"),
        upright(0.0),
    ]
    names = [score_label(score) for score in best]
    return _bars(marks, names, "log10 of the Bayes factor", 0.9 + 0.24 * max(len(best), 1), 0.16)


def learned_figure(added: AddedEffect, unit: str) -> Figure:
    """The functions of an effect without a name over the range seen, each with its 95 % band.

    One of two variables is drawn over the first, at three values of the other.

    Args:
        added: the effect.
        unit: of its effort.
    """
    panels = []
    for curve in added.hypothesis.curves:
        marks: list[Mark] = [level(0.0)]
        for k, value in enumerate(curve.levels):
            colour = (AFTER, INK, BEFORE)[k % 3]
            label = f"{curve.other} = {rounded(float(value), 2)}" if curve.other else "learned"
            half = NORMAL_95 * curve.sd[k]
            marks.append(Band(curve.x, curve.mean[k] - half, curve.mean[k] + half, colour))
            marks.append(Line(curve.x, curve.mean[k], colour, label, 1.2))
        turning = f", times the sign of {curve.turning}" if curve.turning else ""
        title = f"over {curve.variable}{turning}"
        panels.append(Panel(marks, curve.variable, f"effort, {unit}", title))
    return Figure([panels], 2.6, key=True)


def _bars(marks: Sequence[Mark], names: Sequence[str], x_name: str, height: float, room: float) -> Figure:
    """Bars below each other, with room for words beside them, as a share."""
    count = max(len(names), 1)
    ticks = np.arange(len(names)), names
    panel = Panel(
        marks, x_name, y_limits=(-0.6, count - 0.4), y_ticks=ticks, grid="x", margins=(room, 0.0), downwards=True
    )
    return Figure([[panel]], height, key=True)


# ---------------------------------------------------------------------------------------------------------------
# Several logs
# ---------------------------------------------------------------------------------------------------------------
def timeline_figure(comparison: LogComparison) -> Figure:
    """Each parameter that moved, with 95 % intervals, over days since the first log or, without dates, its logs' order.

    Those that moved most come first. The last panel has the changes of all others in their standard deviations.
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
        title = f"{len(others)} other{'s' * (len(others) > 1)}, none moved surely"
        drawn.append((_flat(x, line.z[:, others]), "change / its sd", title))
    room = 0.12 * float(np.ptp(x))
    limits = (float(x.min()) - room, float(x.max()) + room) if room else None
    ticks = None if by_date(comparison) else (x, [f"{place:.0f}" for place in x])
    panels = [Panel(marks, y_name=name, title=title, x_limits=limits, x_ticks=ticks) for marks, name, title in drawn]
    grid = rows_of(panels, min(2, len(panels)))
    x_name = "days since the first log" if by_date(comparison) else "log"
    return Figure(grid, 1.75 * len(grid) + 0.3, x_name=x_name)


def by_date(comparison: LogComparison) -> bool:
    """Whether the logs stand at their dates: these are known, in the order of the logs, and not all the same."""
    dates = comparison.dates
    return dates.known and dates.ascending and bool(dates.days[-1] > 0.0)


def instants(comparison: LogComparison) -> Array:
    """(K,) where the logs stand: days since the first, or 1, 2, .."""
    return comparison.dates.days if by_date(comparison) else np.arange(1.0, len(comparison.logs) + 1.0)


def _followed(x: Array, value: Array, sd: Array) -> list[Mark]:
    known = np.isfinite(sd) & np.isfinite(value)
    return means(x[known], value[known], NORMAL_95 * sd[known], AFTER, 4.0)


def _flat(x: Array, z: Array) -> list[Mark]:
    """(K, C) changes in standard deviations, in grey; none of the first log."""
    drawn = z.copy()
    drawn[0] = 0.0
    known = np.isfinite(drawn)
    return [Line(x[here], one[here], INK, "", 0.8, 0.5) for one, here in zip(drawn.T, known.T, strict=True)]
