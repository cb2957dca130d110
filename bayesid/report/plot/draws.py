"""The posterior's draws of the coefficients that the log decides worst, by ArviZ.

In units of the prior's standard deviation, about the posterior's mean: what the data decide well is narrow, what the
prior decides reaches from -2 to 2.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes

from bayesid.arrays import Array, Integers
from bayesid.posterior.arviz_plots import draw_forest, draw_pair, draw_rank, draw_trace
from bayesid.report.findings import Findings
from bayesid.report.plot.source import Source, findings_of
from bayesid.report.plot.style import BLUE, INK, MAGENTA, ORANGE, SIZE, dress, given_axes, grid_of_axes, one_axes

_COLOURS = [BLUE, ORANGE, INK, MAGENTA]
"""Of the ensembles."""
_SCALE = "over the prior's sd"


def forest(result: Source, count: int = 12, ax: Axes | None = None) -> Axes:
    """95 % intervals of the worst-decided coefficients, one an ensemble; ensembles that disagree have not converged.

    Args:
        result: an identification with a posterior, its findings, or a result folder.
        count: coefficients, at most.
        ax: where to draw; new by default.

    Raises:
        InputError: the folder holds no result.
        ValueError: no posterior was sampled.

    Example:
        >>> ax = bayesid.plot.forest(result, count=5)
        >>> len(ax.get_yticks())
        5
    """
    findings = findings_of(result)
    chosen = findings.worst(count)
    ax = one_axes(ax, 1.0 + 0.36 * len(chosen))
    look = {"colors": INK, "textsize": SIZE, "linewidth": 1.4, "markersize": 3}
    names = _names(findings, chosen)
    draw_forest(_values(findings, chosen), names, ax, look)
    ax.set_yticks(ax.get_yticks(), names[::-1])  # ArviZ's rows stand from the last one up, one tick for all ensembles
    ax.axvline(0.0, color=INK, linewidth=0.8)
    ax.set_title("")
    ax.set_xlabel(f"coefficient less its mean, {_SCALE}", fontsize=SIZE, color=INK)
    dress(ax, "x")
    return ax


def pair(result: Source, count: int = 3, axes: Any = None) -> list[Axes]:
    """Draws of the worst-decided coefficients against each other: what the log tells only in combination.

    Args:
        result: an identification with a posterior, its findings, or a result folder.
        count: coefficients, from 2 up.
        axes: (count - 1, count - 1) of them; new ones by default.

    Returns:
        The Axes on and below the diagonal, row by row.

    Raises:
        InputError: the folder holds no result.
        ValueError: no posterior was sampled, there are fewer than two coefficients, or not as many Axes.

    Example:
        >>> axes = bayesid.plot.pair(result, count=3)
        >>> len(axes)
        3
    """
    findings = findings_of(result)
    chosen = findings.worst(count)
    if len(chosen) < 2:
        raise ValueError("a pair needs two coefficients")
    size = len(chosen) - 1
    grid = grid_of_axes(axes, size, size, 1.2 + 1.9 * size)
    look = {"scatter_kwargs": {"color": BLUE, "alpha": 0.4, "s": 6.0}, "textsize": SIZE}
    names = _names(findings, chosen)
    draw_pair(_values(findings, chosen), names, grid if size > 1 else grid[0, 0], look)
    for row in range(size):
        for column in range(size):
            ax = grid[row, column]
            if column > row:
                ax.set_axis_off()
                continue
            ax.set_xlabel(names[column] if row == size - 1 else "", fontsize=SIZE, color=INK)
            ax.set_ylabel(names[row + 1] if column == 0 else "", fontsize=SIZE, color=INK)
            _as_image(ax.collections)
            dress(ax)
    return [ax for ax in grid.ravel() if ax.axison]


def trace(result: Source, count: int = 4, axes: Any = None) -> list[Axes]:
    """Densities of the worst-decided coefficients, and their draws in the order of sweeps, one colour an ensemble.

    Args:
        result: an identification with a posterior, its findings, or a result folder.
        count: coefficients, at most.
        axes: (count, 2) of them; new ones by default.

    Returns:
        Two Axes for each coefficient.

    Raises:
        InputError: the folder holds no result.
        ValueError: no posterior was sampled, or there are not as many Axes.

    Example:
        >>> axes = bayesid.plot.trace(result, count=3)
        >>> len(axes)
        6
    """
    findings = findings_of(result)
    chosen = findings.worst(count)
    grid = grid_of_axes(axes, len(chosen), 2, 0.6 + 1.15 * len(chosen))
    look = {
        "chain_prop": {"color": _COLOURS[: findings.n_ensembles]},
        "trace_kwargs": {"alpha": 0.5, "linewidth": 0.4},
        "plot_kwargs": {"textsize": SIZE},
    }
    names = _names(findings, chosen)
    draw_trace(_values(findings, chosen), names, grid, look)
    for (density, draws), name in zip(grid, names, strict=True):
        density.set_title("")
        draws.set_title("")
        density.set_ylabel(name, fontsize=SIZE - 1.0, color=INK)
        _as_image(draws.lines)
        for ax in (density, draws):
            dress(ax)
        density.set_yticks([])
    grid[-1][0].set_xlabel(_SCALE, fontsize=SIZE, color=INK)
    grid[-1][1].set_xlabel("draw, in the order of sweeps", fontsize=SIZE, color=INK)
    return [ax for row in grid for ax in row]


def rank(result: Source, count: int = 4, axes: Any = None) -> list[Axes]:
    """Ranks of each ensemble's draws among all: flat where the ensembles agree.

    Args:
        result: an identification with a posterior, its findings, or a result folder.
        count: coefficients, at most.
        axes: one for each coefficient; new ones by default.

    Returns:
        One Axes for each coefficient.

    Raises:
        InputError: the folder holds no result.
        ValueError: no posterior was sampled, or there are not as many Axes.

    Example:
        >>> axes = bayesid.plot.rank(result, count=4)
        >>> len(axes)
        4
    """
    findings = findings_of(result)
    chosen = findings.worst(count)
    if axes is None:
        rows = -(-len(chosen) // 2)
        places = grid_of_axes(None, rows, min(2, len(chosen)), 0.5 + 1.7 * rows).ravel()
    else:
        places = given_axes(axes, len(chosen))
    look = {
        "colors": _COLOURS[: findings.n_ensembles],
        "bar_kwargs": {"edgecolor": "none"},
        "ref_line_kwargs": {"color": INK, "linestyle": "--", "linewidth": 1.0},
    }
    for ax, k, name in zip(places, chosen, _names(findings, chosen), strict=False):
        draw_rank(_values(findings, np.array([k])), name, ax, look)
        ax.set_title(name, fontsize=SIZE, color=INK)
        ax.set_xlabel("rank among all draws", fontsize=SIZE - 1.0, color=INK)
        ax.set_ylabel("ensemble", fontsize=SIZE - 1.0, color=INK)
        dress(ax)
    for ax in places[len(chosen) :]:
        ax.set_axis_off()
    return [ax for ax in places if ax.axison]


# ---------------------------------------------------------------------------------------------------------------
# Parts
# ---------------------------------------------------------------------------------------------------------------
def _values(findings: Findings, chosen: Integers) -> Array:
    """(E, D, K) draws of K coefficients."""
    if findings.draws is None:
        raise ValueError("no posterior was sampled")
    return findings.standardised(chosen)


def _names(findings: Findings, chosen: Integers) -> list[str]:
    return [findings.coefficients.name[k] for k in chosen]


def _as_image(artists: Any) -> None:
    """What would be tens of thousands of paths becomes a picture inside the figure."""
    each: Artist
    for each in artists:
        each.set_rasterized(True)
