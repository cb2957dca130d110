"""The posterior's draws of the least determined coefficients.

Values are about the posterior's mean, in units of the prior's standard deviation. Coefficients that the data decide are
narrow; those that the prior decides reach from -2 to 2.
"""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.report.plot import figure as fig
from bayesid.report.plot.drawing import draw
from bayesid.report.plot.identification import Source, findings_of
from bayesid.report.report_data import ReportData
from bayesid.report.tuning import TUNING

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = (fig.BLUE, fig.ORANGE, fig.INK, fig.MAGENTA)
"""Of the ensembles, in turn."""
_SCALE = "over the prior's sd"


def forest(result: Source, count: int = 12, ax: Axes | None = None) -> Axes:
    """95 % intervals of the least determined coefficients, one per ensemble; they agree after convergence."""
    return draw(forest_figure(findings_of(result), count), ax)[0]


def forest_figure(findings: ReportData, count: int) -> fig.Figure:
    """Of `forest`."""
    chosen = findings.worst(count)
    quantiles = np.quantile(_values(findings, chosen), (0.025, 0.25, 0.5, 0.75, 0.975), axis=1)
    ensembles = quantiles.shape[1]
    marks: list[fig.Mark] = [fig.upright(0.0)]
    for e, (low, first, middle, third, high) in enumerate(quantiles.transpose(1, 0, 2)):
        rows = np.arange(len(chosen)) + 0.6 * ((e + 0.5) / ensembles - 0.5)
        for ends, width in (((low, high), 1.4), ((first, third), 2.8)):
            marks.append(fig.Strokes(ends, (rows, rows), fig.INK, width=width))
        marks.append(fig.Dots(middle, rows, fig.INK))
    panel = fig.Panel(
        marks,
        f"coefficient minus its mean, {_SCALE}",
        y_limits=(-0.5, len(chosen) - 0.5),
        y_ticks=(np.arange(len(chosen)), _names(findings, chosen)),
        grid="x",
        downwards=True,
    )
    return fig.Figure([[panel]], 1.0 + 0.36 * len(chosen))


def pair(result: Source, count: int = 3, axes: Any = None) -> list[Axes]:
    """Draws of the least determined coefficients against each other; correlations show unidentifiable combinations."""
    return draw(pair_figure(findings_of(result), count), axes)


def pair_figure(findings: ReportData, count: int) -> fig.Figure:
    """Of `pair`."""
    chosen = findings.worst(count)
    if len(chosen) < 2:
        raise ValueError("a pair needs two coefficients")
    size, names = len(chosen) - 1, _names(findings, chosen)
    draws = _values(findings, chosen).reshape(-1, len(chosen))

    def panel(row: int, column: int) -> fig.Panel | None:
        dots = fig.Dots(draws[:, column], draws[:, row + 1], fig.BLUE, size=1.4, alpha=0.4)
        x_name, y_name = names[column] * (row == size - 1), names[row + 1] * (column == 0)
        return fig.Panel([dots], x_name, y_name) if column <= row else None

    panels = [[panel(row, column) for column in range(size)] for row in range(size)]
    return fig.Figure(panels, 1.2 + 1.9 * size)


def trace(result: Source, count: int = 4, axes: Any = None) -> list[Axes]:
    """Densities and traces of the least determined coefficients, one colour per ensemble."""
    return draw(trace_figure(findings_of(result), count), axes)


def trace_figure(findings: ReportData, count: int) -> fig.Figure:
    """Of `trace`."""
    chosen = findings.worst(count)
    names, values = _names(findings, chosen), _values(findings, chosen)
    place = np.arange(values.shape[1], dtype=float)
    rows: list[list[fig.Panel | None]] = []
    for k, name in enumerate(names):
        edges = np.histogram_bin_edges(values[..., k], TUNING.histogram)
        densities = [np.histogram(ensemble, edges, density=True)[0] for ensemble in values[..., k]]
        outlines, traces = [], []
        for density, ensemble, colour in zip(densities, values[..., k], cycle(_COLOURS), strict=False):
            steps = np.array([0.0, *np.repeat(density, 2), 0.0])
            outlines.append(fig.Line(np.repeat(edges, 2), steps, colour, width=1.0))
            traces.append(fig.Line(place, ensemble, colour, width=0.4, alpha=0.5))
        last = k == len(names) - 1
        density_panel = fig.Panel(outlines, _SCALE * last, name, y_ticks=fig.NO_TICKS)
        rows.append([density_panel, fig.Panel(traces, "draw, in order of sampling" * last)])
    return fig.Figure(rows, 0.6 + 1.15 * len(chosen))


def rank(result: Source, count: int = 4, axes: Any = None) -> list[Axes]:
    """Ranks of each ensemble's draws among all draws: uniform if the ensembles agree."""
    return draw(rank_figure(findings_of(result), count), axes)


def rank_figure(findings: ReportData, count: int) -> fig.Figure:
    """Of `rank`."""
    chosen = findings.worst(count)
    values = _values(findings, chosen)
    panels = [_ranks(values[..., k], name) for k, name in enumerate(_names(findings, chosen))]
    rows = fig.rows_of(panels, min(2, len(panels)))
    return fig.Figure(rows, 0.5 + 1.7 * len(rows))


# ---------------------------------------------------------------------------------------------------------------
# Parts
# ---------------------------------------------------------------------------------------------------------------
def _ranks(draws: Array, name: str) -> fig.Panel:
    """Histograms of the ranks of each ensemble's draws (E, D) among all draws; the dashed line is uniform."""
    ordered = np.sort(draws, axis=None)
    ranks = 0.5 * (1.0 + np.searchsorted(ordered, draws) + np.searchsorted(ordered, draws, "right"))
    edges = np.linspace(0.5, draws.size + 0.5, TUNING.histogram + 1)
    counts = np.array([np.histogram(ensemble, edges)[0] for ensemble in ranks])
    even, room = draws.shape[1] / TUNING.histogram, 1.2 * float(counts.max())
    marks: list[fig.Mark] = []
    for e, colour in zip(range(len(draws)), cycle(_COLOURS), strict=False):
        x, top = np.repeat(edges, 2)[1:-1], e * room + np.repeat(counts[e], 2)
        marks += [
            fig.Band(x, np.full(len(x), e * room), top, colour, alpha=1.0),
            fig.level(e * room + even, fig.INK, 1.0, "dashed"),
        ]
    return fig.Panel(marks, "rank among all draws", "ensemble", name, y_ticks=fig.NO_TICKS)


def _values(findings: ReportData, chosen: Integers) -> Array:
    if findings.draws is None:
        raise ValueError("no posterior was sampled")
    return findings.standardised(chosen)


def _names(findings: ReportData, chosen: Integers) -> list[str]:
    return [findings.coefficients.name[k] for k in chosen]
