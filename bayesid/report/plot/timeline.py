"""The figure of a time line: one panel for each parameter that moved, and one for all that stayed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.arrays import Array
from bayesid.discrepancy.comparison import LogComparison
from bayesid.identification.prediction import NORMAL_95
from bayesid.report.plot.ink import BLUE, INK, SIZE, WIDTH
from bayesid.report.plot.style import NewFigure, dress, new_figure
from bayesid.report.timeline_text import moved_parameters

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST = 11
"""Parameters with a panel of their own: with that of all others two columns of six, a screen full."""
_ROW = 1.75
"""in, of a row of panels."""
_LETTERS = 32
"""Of a title: as many as fit above a panel."""
_ROOM = 0.12
"""Free beside the first and the last log, as a share of the time between them."""


def timeline_figure(comparison: LogComparison, make: NewFigure = new_figure) -> Figure:
    """Each parameter that moved, with 95 % intervals, over days since the first log or, without dates, its logs' order.

    Those that moved most come first. The last panel has the changes of all others in their standard deviations.
    """
    line, rows = comparison.timeline, moved_parameters(comparison)
    rows = sorted(rows, key=lambda row: -np.nanmax(np.abs(row.z)))[:MOST]
    shown = {row.place for row in rows}
    others = [c for c in range(len(line.tracked)) if c not in shown and np.isfinite(line.p[:, c]).any()]
    count = len(rows) + bool(others)
    columns = min(2, count)
    figure = make(_ROW * -(-count // columns) + 0.3, WIDTH)
    axes = figure.subplots(-(-count // columns), columns, squeeze=False).ravel()
    x = instants(comparison)
    for ax, row in zip(axes, rows, strict=False):
        _title(ax, row.name)
        ax.set_ylabel(row.unit or "1", fontsize=SIZE, color=INK)
        _followed(ax, x, np.array(row.value), np.array(row.sd))
    if others:
        _flat(axes[len(rows)], x, line.z[:, others])
    for ax in axes[count:]:
        ax.set_axis_off()
    for ax in axes[:count]:
        room = _ROOM * float(np.ptp(x))
        ax.set_xlim(x.min() - room, x.max() + room)
        if not by_date(comparison):
            ax.set_xticks(x, [f"{place:.0f}" for place in x])
        dress(ax)
    figure.supxlabel("days since the first log" if by_date(comparison) else "log", fontsize=SIZE, color=INK)
    return figure


def by_date(comparison: LogComparison) -> bool:
    """Whether the logs stand at their dates: these are known, in the order of the logs, and not all the same."""
    dates = comparison.dates
    return dates.known and dates.ascending and bool(dates.days[-1] > 0.0)


def instants(comparison: LogComparison) -> Array:
    """(K,) where the logs stand: days since the first, or 1, 2, .."""
    return comparison.dates.days if by_date(comparison) else np.arange(1.0, len(comparison.logs) + 1.0)


def _title(ax: Axes, name: str) -> None:
    text = name if len(name) <= _LETTERS else f"{name[: _LETTERS - 3].rstrip()}..."
    ax.set_title(text, fontsize=SIZE - 1.0, color=INK)


def _followed(ax: Axes, x: Array, value: Array, sd: Array) -> None:
    known = np.isfinite(sd) & np.isfinite(value)
    look: dict[str, Any] = {"linewidth": 1.4, "marker": "o", "markersize": 4.0, "capsize": 3.0}
    ax.errorbar(x[known], value[known], yerr=NORMAL_95 * sd[known], color=BLUE, **look)


def _flat(ax: Axes, x: Array, z: Array) -> None:
    """(K, C) changes in standard deviations, in grey; none of the first log."""
    drawn = z.copy()
    drawn[0] = 0.0
    for one in drawn.T:
        known = np.isfinite(one)
        ax.plot(x[known], one[known], color=INK, linewidth=0.8, alpha=0.5)
    count = z.shape[1]
    _title(ax, f"{count} other{'s' * (count > 1)}, none moved surely")
    ax.set_ylabel("change / its sd", fontsize=SIZE, color=INK)
