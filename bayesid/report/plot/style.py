"""How all figures look, and figures without a window or a global state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from bayesid.errors import InputError
from bayesid.report.plot.ink import INK, SIZE, WIDTH
from bayesid.report.plot.paper import Panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NewFigure = Callable[[float, float], Any]
"""Makes a figure of a height and a width, in: matplotlib's, or `Paper`, whose panels stand in for Axes on pages."""


def new_figure(height: float, width: float = WIDTH) -> Figure:
    """An empty figure, in."""
    from matplotlib.figure import Figure  # takes half a second to import, which pages do without

    return Figure(figsize=(width, height), layout="constrained", facecolor="none")


def root_figure(ax: Axes) -> Figure | None:
    """The figure that an Axes is in, through figures inside of it; `get_figure(root=True)` of matplotlib 3.10."""
    return None if ax.figure is None else ax.figure.figure


def dress(ax: Axes | Panel, grid: Literal["both", "x"] = "both") -> None:
    """One ink for all that is not data."""
    if isinstance(ax, Panel):
        ax.dress(grid)
        return
    ax.set_facecolor("none")
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color(INK)
    ax.tick_params(color=INK, labelcolor=INK, labelsize=SIZE - 1.0)
    ax.grid(axis=grid, color=INK, alpha=0.2, linewidth=0.6)
    ax.set_axisbelow(True)
    for axis in (ax.xaxis, ax.yaxis):
        axis.get_offset_text().set(color=INK, fontsize=SIZE - 1.0)


def legend(ax: Axes | Panel) -> None:
    """Above all Axes of a figure made here, in one row; inside the Axes of another's figure, which may have no room."""
    if isinstance(ax, Panel):
        ax.legend()
        return
    handles, names = ax.get_legend_handles_labels()
    look: dict[str, Any] = {"fontsize": SIZE - 1.0, "labelcolor": INK}
    figure = root_figure(ax)
    if figure is not None and figure.get_layout_engine() is not None:
        figure.legend(handles, names, loc="outside upper center", ncols=len(names), frameon=False, **look)
    else:
        ax.legend(handles, names, framealpha=0.6, **look)


def each_joint(
    n_joints: int, joints: Sequence[int] | None, axes: Any, height: float, width: float = WIDTH
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


def one_axes(ax: Any, height: float, width: float = WIDTH) -> Any:
    """The Axes given, or one in a new figure of that height and width, in."""
    return grid_of_axes(ax, 1, 1, height, width)[0, 0]


def grid_of_axes(
    axes: Any, rows: int, columns: int, height: float, width: float = WIDTH, *, sharex: bool = False
) -> Any:
    """(rows, columns) Axes: those given, row by row, or new ones in a figure of that height and width, in.

    Args:
        axes: in an array, a list or by itself; or a `NewFigure`, `new_figure` by default.
        rows: of the grid.
        columns: of the grid.
        height: of a new figure.
        width: of a new figure.
        sharex: whether new ones share their x axes.

    Raises:
        ValueError: there are not as many.
    """
    make: NewFigure | None = new_figure if axes is None else axes if callable(axes) else None
    if make is not None:
        return make(height, width).subplots(rows, columns, squeeze=False, sharex=sharex)
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
