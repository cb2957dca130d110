"""How all figures look, and figures without a window or a global state.

All ink is one grey that a page replaces by the colour of its text; the other colours, orange and blue, are seen on
white and on black, and by the colour-blind.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesid.errors import InputError

INK, ORANGE, BLUE, MAGENTA = "#767676", "#cc6a1a", "#2b83c6", "#c2408f"
WIDTH = 5.4
"""in; two figures fit side by side on a page, one on a telephone."""
SIZE = 10.0
"""Of letters, points."""


def new_figure(height: float, width: float = WIDTH) -> Figure:
    """An empty figure, in."""
    return Figure(figsize=(width, height), layout="constrained", facecolor="none")


def root_figure(ax: Axes) -> Figure | None:
    """The figure that an Axes is in, through figures inside of it; `get_figure(root=True)` of matplotlib 3.10."""
    return None if ax.figure is None else ax.figure.figure


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


def legend(ax: Axes) -> None:
    """Above all Axes of a figure made here, in one row; inside the Axes of another's figure, which may have no room."""
    handles, names = ax.get_legend_handles_labels()
    look: dict[str, Any] = {"fontsize": SIZE - 1.0, "labelcolor": INK}
    figure = root_figure(ax)
    if figure is not None and figure.get_layout_engine() is not None:
        figure.legend(handles, names, loc="outside upper center", ncols=len(names), frameon=False, **look)
    else:
        ax.legend(handles, names, framealpha=0.6, **look)


def each_joint(
    n_joints: int, joints: Sequence[int] | None, axes: Sequence[Axes] | Axes | None, height: float, width: float = WIDTH
) -> list[tuple[int, Axes]]:
    """Joints (from 1) and an Axes for each, one below the other in a new figure unless they are given.

    Raises:
        InputError: there is no such joint, or what was given is no list.
        ValueError: there is not one Axes for each.
    """
    if isinstance(joints, int | str):
        raise InputError(f"{joints!r} is no list of joints", "joints", f"give one, as joints=[{joints}]")
    chosen = list(range(1, n_joints + 1)) if joints is None else list(joints)
    if not chosen or not all(1 <= joint <= n_joints for joint in chosen):
        raise InputError(f"there is no joint {chosen}", "joints", f"choose from 1 to {n_joints}")
    drawn = grid_of_axes(axes, len(chosen), 1, height * len(chosen), width)[:, 0].tolist()
    return list(zip(chosen, drawn, strict=True))


def one_axes(ax: Axes | None, height: float, width: float = WIDTH) -> Axes:
    """The Axes given, or one in a new figure."""
    return new_figure(height, width).subplots() if ax is None else ax


def grid_of_axes(
    axes: Any, rows: int, columns: int, height: float, width: float = WIDTH, *, sharex: bool = False
) -> Any:
    """(rows, columns) Axes: those given, row by row, or new ones in a figure of that height and width, in.

    Raises:
        ValueError: there are not as many.
    """
    if axes is None:
        return new_figure(height, width).subplots(rows, columns, squeeze=False, sharex=sharex)
    return given_axes(axes, rows * columns).reshape(rows, columns)


def given_axes(axes: Any, count: int) -> Any:
    """(count,) the Axes in an array, a list or by itself.

    Raises:
        ValueError: there are not as many.
    """
    given = np.asarray(axes, dtype=object).ravel()
    if len(given) != count:
        raise ValueError(f"{len(given)} axes are given, {count} are needed")
    return given
