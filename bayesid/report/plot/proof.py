"""What the search has proven about all other assignments of signs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayesid.report.plot.ink import BLUE, INK, MAGENTA, ORANGE, SIZE
from bayesid.report.plot.source import Source, findings_of
from bayesid.report.plot.style import dress, legend, one_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SHOWN = 12
"""Assignments, at most: as many as a figure on a telephone has room for."""


def alternatives(result: Source, ax: Axes | None = None) -> Axes:
    """How much more than the best assignment the others cost: those that remain, and all that the proof rules out.

    A cost that is larger by x makes an assignment exp(-x / 2) times as probable, but for the volume of its cone.

    Args:
        result: an identification, its findings, or a result folder.
        ax: where to draw; new by default.

    Raises:
        InputError: the folder holds no result.
        ValueError: nothing has been proven: signs were known, or found by a beam alone.

    Example:
        >>> ax = bayesid.plot.alternatives(result)
        >>> ax.get_xlabel()
        'cost above that of the best assignment'
    """
    findings = findings_of(result)
    search = findings.summary.search
    if search.lower_bound is None or search.cost is None:
        raise ValueError("nothing has been proven about the signs")
    above = (findings.alternatives.cost - search.cost)[:_SHOWN]
    count = max(1, len(above))
    ax = one_axes(ax, 1.1 + 0.22 * count)
    if len(above) > 1:
        ax.scatter(above[1:], np.arange(1, count), s=30.0, color=ORANGE, label="alternative", zorder=3)
    ax.scatter([0.0], [0], s=44.0, color=BLUE, label="best found", zorder=3)
    if search.certified:
        within = search.within or 0.0
        ax.axvline(within, color=INK, linewidth=1.2, linestyle="--")
        ax.axvspan(within, max(1.6 * within, 1.0), color=INK, alpha=0.18, linewidth=0.0, label="all others")
    else:
        open_costs = search.lower_bound - search.cost, 0.0
        ax.axvspan(*open_costs, color=MAGENTA, alpha=0.25, linewidth=0.0, label="not ruled out")
    ax.set_ylim(count - 0.4, -0.6)
    ax.set_yticks([])
    ax.set_xlabel("cost above that of the best assignment", fontsize=SIZE, color=INK)
    dress(ax, "x")
    legend(ax)
    return ax
