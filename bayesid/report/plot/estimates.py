"""The coefficients with their intervals, each in units of its own size."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayesid.report.plot.ink import BLUE, INK, ORANGE, SIZE
from bayesid.report.plot.source import Source, findings_of
from bayesid.report.plot.style import dress, legend, one_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ROW = 0.19
"""in, of a coefficient: letters of 8 points, and a gap."""
_CLIP = 2.5
"""Sizes beyond which an interval is cut off: what is known so badly needs no more room."""


def coefficients(result: Source, ax: Axes | None = None) -> Axes:
    """Mean, 95 % interval and nominal value of every coefficient, over its size.

    Orange ones are decided by the prior, not by the data. The size of a coefficient is that of its mean, or of half its
    interval where that is larger.

    Args:
        result: an identification, its findings, or a result folder.
        ax: where to draw; new by default.

    Raises:
        InputError: the folder holds no result.

    Example:
        >>> ax = bayesid.plot.coefficients(result)
        >>> ax.figure.savefig("coefficients.svg")
    """
    findings = findings_of(result)
    table = findings.coefficients
    place, bar = np.arange(len(table.mean)), table.bar
    ax = one_axes(ax, 1.0 + _ROW * len(place))
    for chosen, colour, name in ((table.by_data, BLUE, "decided by data"), (~table.by_data, ORANGE, "by the prior")):
        if chosen.any():
            ax.barh(place[chosen], bar.mean[chosen], height=0.6, color=colour, alpha=0.35, label=name)
            low, high = bar.low[chosen].clip(-_CLIP, _CLIP), bar.high[chosen].clip(-_CLIP, _CLIP)
            ax.hlines(place[chosen], low, high, color=colour, linewidth=2.0)
    known = np.isfinite(bar.nominal)
    if known.any():
        nominal = bar.nominal[known].clip(-_CLIP, _CLIP)
        ax.plot(nominal, place[known], linestyle="none", marker="|", markersize=8, color=INK, label="nominal")
    ax.axvline(0.0, color=INK, linewidth=0.8)
    ax.set_yticks(place, table.name)
    ax.set_ylim(len(place) - 0.4, -0.6)
    ax.set_xlabel("value over its size", fontsize=SIZE, color=INK)
    dress(ax, "x")
    ax.tick_params(axis="y", labelsize=SIZE - 2.0)
    legend(ax)
    return ax
