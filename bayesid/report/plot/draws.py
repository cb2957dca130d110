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
from bayesid.report.plot.ink import BLUE, INK, MAGENTA, ORANGE, SIZE
from bayesid.report.plot.source import Source, findings_of
from bayesid.report.plot.style import dress, given_axes, grid_of_axes, one_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = [BLUE, ORANGE, INK, MAGENTA]
"""Of the ensembles, in turn."""
_SCALE = "over the prior's sd"
_QUANTILES = (0.025, 0.25, 0.5, 0.75, 0.975)
"""Ends of the thin line, of the thick one, and the dot between."""
_ROW = 0.6
"""Of the room of a coefficient in a forest, for the ensembles' lines."""
_BINS = 20
"""Of histograms: of the thousand draws that an ensemble keeps, fifty a bin, which chance moves by 14 %."""


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
    names = _names(findings, chosen)
    quantiles = np.quantile(_values(findings, chosen), _QUANTILES, axis=1)
    ensembles = quantiles.shape[1]
    for e, (low, first, middle, third, high) in enumerate(quantiles.transpose(1, 0, 2)):
        rows = np.arange(len(chosen)) + _ROW * ((e + 0.5) / ensembles - 0.5)
        ax.hlines(rows, low, high, colors=INK, linewidth=1.4)
        ax.hlines(rows, first, third, colors=INK, linewidth=2.8)
        ax.plot(middle, rows, "o", color=INK, markersize=3)
    ax.set_yticks(np.arange(len(chosen)), names)
    ax.invert_yaxis()
    ax.axvline(0.0, color=INK, linewidth=0.8)
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
    names = _names(findings, chosen)
    draws = _values(findings, chosen).reshape(-1, len(chosen))
    for row in range(size):
        for column in range(size):
            ax = grid[row, column]
            if column > row:
                ax.set_axis_off()
                continue
            ax.scatter(draws[:, column], draws[:, row + 1], color=BLUE, alpha=0.4, s=2.0, rasterized=True)
            ax.set_xlabel(names[column] if row == size - 1 else "", fontsize=SIZE, color=INK)
            ax.set_ylabel(names[row + 1] if column == 0 else "", fontsize=SIZE, color=INK)
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
    names = _names(findings, chosen)
    values = _values(findings, chosen)
    for k, (density, draws) in enumerate(grid):
        edges = np.histogram_bin_edges(values[..., k], _BINS)
        for ensemble, colour in zip(values[..., k], cycle(_COLOURS), strict=False):
            density.stairs(np.histogram(ensemble, edges, density=True)[0], edges, color=colour)
            # as a picture, or it would be a thousand strokes inside the figure
            draws.plot(ensemble, color=colour, alpha=0.5, linewidth=0.4, rasterized=True)
        density.set_ylabel(names[k], fontsize=SIZE - 1.0, color=INK)
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
    if axes is None or callable(axes):
        rows = -(-len(chosen) // 2)
        places = grid_of_axes(axes, rows, min(2, len(chosen)), 0.5 + 1.7 * rows).ravel()
    else:
        places = given_axes(axes, len(chosen))
    for ax, k, name in zip(places, chosen, _names(findings, chosen), strict=False):
        _draw_ranks(ax, _values(findings, np.array([k]))[..., 0])
        ax.set_title(name, fontsize=SIZE, color=INK)
        ax.set_xlabel("rank among all draws", fontsize=SIZE - 1.0, color=INK)
        ax.set_ylabel("ensemble", fontsize=SIZE - 1.0, color=INK)
        dress(ax)
        ax.set_yticks([])
    for ax in places[len(chosen) :]:
        ax.set_axis_off()
    return [ax for ax in places if ax.axison]


# ---------------------------------------------------------------------------------------------------------------
# Parts
# ---------------------------------------------------------------------------------------------------------------
def _draw_ranks(ax: Axes, draws: Array) -> None:
    """Histograms of the ranks of each ensemble's draws (E, D) among all, one above the other; dashed if uniform."""
    ordered = np.sort(draws, axis=None)
    ranks = 0.5 * (1.0 + np.searchsorted(ordered, draws) + np.searchsorted(ordered, draws, "right"))
    edges = np.linspace(0.5, draws.size + 0.5, _BINS + 1)
    counts = np.array([np.histogram(ensemble, edges)[0] for ensemble in ranks])
    even, room = draws.shape[1] / _BINS, 1.2 * float(counts.max())
    for e, colour in zip(range(len(draws)), cycle(_COLOURS), strict=False):
        ax.stairs(e * room + counts[e], edges, baseline=e * room, fill=True, color=colour)
        ax.axhline(e * room + even, color=INK, linestyle="--", linewidth=1.0)


def _values(findings: Findings, chosen: Integers) -> Array:
    """(E, D, K) draws of K coefficients."""
    if findings.draws is None:
        raise ValueError("no posterior was sampled")
    return findings.standardised(chosen)


def _names(findings: Findings, chosen: Integers) -> list[str]:
    return [findings.coefficients.name[k] for k in chosen]
