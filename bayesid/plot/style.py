"""How all figures look, and figures without a window or a global state.

All ink is one grey that a page replaces by the colour of its text; the other colours, orange and blue, are seen on
white and on black, and by the colour-blind.
"""

from __future__ import annotations

from typing import Any, Literal

from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK, ORANGE, BLUE = "#767676", "#cc6a1a", "#2b83c6"
WIDTH = 5.4
"""in; two figures fit side by side on a page, one on a telephone."""
SIZE = 10.0
"""Of letters, points."""


def new_figure(height: float, width: float = WIDTH) -> Figure:
    """An empty figure, in."""
    return Figure(figsize=(width, height), layout="constrained", facecolor="none")


def dress(ax: Axes, grid: Literal["both", "x"] = "both") -> None:
    """One ink for all that is not data."""
    ax.set_facecolor("none")
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color(INK)
    ax.tick_params(color=INK, labelcolor=INK, labelsize=SIZE - 1.0)
    ax.grid(axis=grid, color=INK, alpha=0.2, linewidth=0.6)
    ax.set_axisbelow(True)
    for axis in (ax.xaxis, ax.yaxis):
        axis.get_offset_text().set(color=INK, fontsize=SIZE - 1.0)


def legend(figure: Figure, ax: Axes) -> None:
    """Above the axes, in one row."""
    handles, names = ax.get_legend_handles_labels()
    look: dict[str, Any] = {"frameon": False, "fontsize": SIZE - 1.0, "labelcolor": INK}
    figure.legend(handles, names, loc="outside upper center", ncols=len(names), **look)
