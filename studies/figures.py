"""Figures of many trials: medians with their spread, axes of shares and errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Figure
from matplotlib.ticker import NullLocator

from bayesid.arrays import Array

COLOURS = ("#1b7f79", "#c0392b", "#2c5d9b", "#d08a1d", "#6a4c93", "#555555", "#a0522d")
"""Distinct for colour-blind readers, and in print together with the markers."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")


def spreads(axes: Axes, groups: Mapping[str, Sequence[tuple[float, Sequence[float]]]]) -> None:
    """One line of medians over x per group, with bars from the 10 % to the 90 % quantile.

    Args:
        axes: to draw on.
        groups: name of each line to (x, values) pairs.
    """
    count = len(groups)
    for k, ((name, pairs), colour, marker) in enumerate(zip(groups.items(), cycle(COLOURS), cycle(MARKERS))):
        if not pairs:  # not reached in a short run
            continue
        x = _aside(axes, np.array([x for x, _ in pairs], dtype=float), (k - (count - 1) / 2) * 0.012)
        middle = np.array([np.median(values) for _, values in pairs])
        low, high = (np.array([np.quantile(values, q) for _, values in pairs]) for q in (0.1, 0.9))
        bars = np.clip([middle - low, high - middle], 0.0, None)
        axes.errorbar(x, middle, bars, color=colour, marker=marker, ms=4, lw=1.2, elinewidth=0.8, capsize=2, label=name)


def name_ticks(axes: Axes, places: Mapping[str, float]) -> None:
    """Labels at their places on the x axis, rotated where they would touch."""
    rotation = 60 if sum(map(len, places)) > 32 else 0
    axes.set_xticks(list(places.values()), list(places), rotation=rotation, fontsize=8)
    axes.xaxis.set_minor_locator(NullLocator())


def wrong_axis(axes: Axes) -> None:
    """Axis of shares in percent, most of them zero: linear near zero, logarithmic above."""
    axes.set_ylabel("strong samples with the wrong sign, %")
    axes.set_yscale("symlog", linthresh=0.1)  # a log has some thousand strong samples
    axes.set_ylim(-0.01, max(1.5, 1.3 * axes.get_ylim()[1]))
    ticks = [value for value in (0.0, 0.1, 1.0, 10.0, 50.0) if value < axes.get_ylim()[1]]
    axes.set_yticks(ticks, [f"{value:g}" for value in ticks])
    axes.minorticks_off()


def error_axis(axes: Axes) -> None:
    """Logarithmic axis of errors of predicted efforts in percent."""
    axes.set_ylabel("effort error, new motion, %")
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("")
    axes.grid(axis="y", color="#dddddd", lw=0.6)


def _aside(axes: Axes, x: Array, share: float) -> Array:
    """Shifts points, so that bars do not hide each other."""
    if axes.get_xscale() == "log":
        return x * (x.max() / x.min()) ** share
    return x + share * (x.max() - x.min())
