"""The posterior's draws of the coefficients that the log decides worst.

In units of the prior's standard deviation, about the posterior's mean: what the data decide well is narrow, what the
prior decides reaches from -2 to 2.
"""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.report.findings import Findings
from bayesid.report.plot import figure as fig
from bayesid.report.plot.drawing import draw
from bayesid.report.plot.identification import Source, findings_of
from bayesid.report.tuning import TUNING

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = (fig.BLUE, fig.ORANGE, fig.INK, fig.MAGENTA)
"""Of the ensembles, in turn."""
_SCALE = "over the prior's sd"


def forest(result: Source, count: int = 12, ax: Axes | None = None) -> Axes:
    """95 % intervals of the worst-decided coefficients, one an ensemble; ensembles that disagree have not converged.

    Example:
        >>> ax = bayesid.plot.forest(result, count=5)
        >>> len(ax.get_yticks())
        5
    """
    return draw(forest_figure(findings_of(result), count), ax)[0]


def forest_figure(findings: Findings, count: int) -> fig.Figure:
    """Of `forest`."""
    chosen = findings.worst(count)
    quantiles = np.quantile(_values(findings, chosen), (0.025, 0.25, 0.5, 0.75, 0.975), axis=1)
    ensembles = quantiles.shape[1]
    marks: list[fig.Mark] = [fig.upright(0.0)]
    for e, (low, first, middle, third, high) in enumerate(quantiles.transpose(1, 0, 2)):
        rows = np.arange(len(chosen)) + 0.6 * ((e + 0.5) / ensembles - 0.5)
        marks += [
            fig.Strokes((low, high), (rows, rows), fig.INK, width=1.4),
            fig.Strokes((first, third), (rows, rows), fig.INK, width=2.8),
        ]
        marks.append(fig.Dots(middle, rows, fig.INK))
    panel = fig.Panel(
        marks,
        f"coefficient less its mean, {_SCALE}",
        y_limits=(-0.5, len(chosen) - 0.5),
        y_ticks=(np.arange(len(chosen)), _names(findings, chosen)),
        grid="x",
        downwards=True,
    )
    return fig.Figure([[panel]], 1.0 + 0.36 * len(chosen))


def pair(result: Source, count: int = 3, axes: Any = None) -> list[Axes]:
    """Draws of the worst-decided coefficients against each other: what the log tells only in combination.

    Example:
        >>> axes = bayesid.plot.pair(result, count=3)
        >>> len(axes)
        3
    """
    return draw(pair_figure(findings_of(result), count), axes)


def pair_figure(findings: Findings, count: int) -> fig.Figure:
    """Of `pair`."""
    chosen = findings.worst(count)
    if len(chosen) < 2:
        raise ValueError("a pair needs two coefficients")
    size = len(chosen) - 1
    names = _names(findings, chosen)
    draws = _values(findings, chosen).reshape(-1, len(chosen))
    panels = [
        [
            fig.Panel(
                [fig.Dots(draws[:, column], draws[:, row + 1], fig.BLUE, size=1.4, alpha=0.4)],
                names[column] if row == size - 1 else "",
                names[row + 1] if column == 0 else "",
            )
            if column <= row
            else None
            for column in range(size)
        ]
        for row in range(size)
    ]
    return fig.Figure(panels, 1.2 + 1.9 * size)


def trace(result: Source, count: int = 4, axes: Any = None) -> list[Axes]:
    """Densities of the worst-decided coefficients, and their draws in the order of sweeps, one colour an ensemble.

    Example:
        >>> axes = bayesid.plot.trace(result, count=3)
        >>> len(axes)
        6
    """
    return draw(trace_figure(findings_of(result), count), axes)


def trace_figure(findings: Findings, count: int) -> fig.Figure:
    """Of `trace`."""
    chosen = findings.worst(count)
    names, values = _names(findings, chosen), _values(findings, chosen)
    place = np.arange(values.shape[1], dtype=float)
    rows: list[list[fig.Panel | None]] = []
    for k, name in enumerate(names):
        edges = np.histogram_bin_edges(values[..., k], TUNING.histogram)
        densities = [np.histogram(ensemble, edges, density=True)[0] for ensemble in values[..., k]]
        outlines = [
            fig.Line(np.repeat(edges, 2), np.array([0.0, *np.repeat(density, 2), 0.0]), colour, width=1.0)
            for density, colour in zip(densities, cycle(_COLOURS), strict=False)
        ]
        traces = [
            fig.Line(place, ensemble, colour, width=0.4, alpha=0.5)
            for ensemble, colour in zip(values[..., k], cycle(_COLOURS), strict=False)
        ]
        last = k == len(names) - 1
        rows.append(
            [
                fig.Panel(outlines, _SCALE if last else "", name, y_ticks=fig.NO_TICKS),
                fig.Panel(traces, "draw, in the order of sweeps" if last else ""),
            ]
        )
    return fig.Figure(rows, 0.6 + 1.15 * len(chosen))


def rank(result: Source, count: int = 4, axes: Any = None) -> list[Axes]:
    """Ranks of each ensemble's draws among all: flat where the ensembles agree.

    Example:
        >>> axes = bayesid.plot.rank(result, count=4)
        >>> len(axes)
        4
    """
    return draw(rank_figure(findings_of(result), count), axes)


def rank_figure(findings: Findings, count: int) -> fig.Figure:
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
    """Histograms of the ranks of each ensemble's draws (E, D) among all, one above the other; dashed if uniform."""
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


def _values(findings: Findings, chosen: Integers) -> Array:
    """(E, D, K) draws of K coefficients."""
    if findings.draws is None:
        raise ValueError("no posterior was sampled")
    return findings.standardised(chosen)


def _names(findings: Findings, chosen: Integers) -> list[str]:
    return [findings.coefficients.name[k] for k in chosen]
