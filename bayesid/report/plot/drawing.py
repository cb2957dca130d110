"""Draws figures with matplotlib, without a window or a global state; imports it when the first one is drawn."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.parallel import SETTINGS_LOCK
from bayesid.report.plot.figure import INK, WIDTH, Band, Boxes, Dots, Figure, Line, Mark, Panel, Strokes, Words, corners

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MatplotlibFigure

SIZE = 10.0
"""Of letters, points."""


def new_figure(height: float, width: float = WIDTH) -> MatplotlibFigure:
    """An empty figure, in."""
    from matplotlib.figure import Figure as MatplotlibFigure

    return MatplotlibFigure(figsize=(width, height), layout="constrained", facecolor="none")


def chosen_joints(n_joints: int, joints: Sequence[int] | None) -> list[int]:
    """Joints from 1, all by default.

    Raises:
        InputError: there is no such joint, or `joints` is not a list.
    """
    if isinstance(joints, int | str):
        raise InputError(f"{joints!r} is not a list of joints", "joints", f"give one, as joints=[{joints}]")
    chosen = list(range(1, n_joints + 1)) if joints is None else list(joints)
    if not chosen or not all(1 <= joint <= n_joints for joint in chosen):
        raise InputError(f"there is no joint {chosen}", "joints", f"choose from 1 to {n_joints}")
    return chosen


def given_axes(axes: Any, count: int) -> Any:
    """(count,) the given Axes: an array, a list or a single one; ValueError if their number is not `count`."""
    given = np.asarray(axes, dtype=object).ravel()
    if len(given) != count:
        raise ValueError(f"{len(given)} axes are given, {count} are needed")
    return given


def draw(figure: Figure, axes: Any = None) -> list[Axes]:
    """Draws a figure in a new matplotlib figure or in the given Axes, and returns one Axes per panel.

    `axes` are one per panel, or one per place of the rows, row by row; ValueError for another number.
    """
    places = [panel for row in figure.panels for panel in row]
    columns = len(figure.panels[0])
    if axes is None:
        made = new_figure(figure.height, figure.width)
        given = made.subplots(len(figure.panels), columns, squeeze=False, height_ratios=figure.heights).ravel()
        made.supxlabel(figure.x_name, fontsize=SIZE, color=INK)
    else:
        every = np.size(np.asarray(axes, dtype=object)) == len(places)
        places = places if every else list(figure.shown)
        given = given_axes(axes, len(places))
    drawn = []
    for k, (ax, panel) in enumerate(zip(given, places, strict=True)):
        if panel is None:
            ax.set_axis_off()
            continue
        draw_panel(ax, panel)
        drawn.append(ax)
        below = places[k + columns] if axes is None and k + columns < len(places) else None
        shared = below is not None and below.x_limits == panel.x_limits is not None
        ax.tick_params(labelbottom=not shared)
    if figure.key:
        named = {label: mark for panel in figure.shown for label, mark in panel.labelled.items()}
        legend(drawn[0], [_handle(mark) for mark in named.values()], list(named), outside=axes is None)
    return drawn


def draw_panel(ax: Axes, panel: Panel) -> None:
    """Draws one panel into an Axes."""
    (left, right), (bottom, top) = panel.limits
    ax.set_xlim(left, right)
    ax.set_ylim(*((top, bottom) if panel.downwards else (bottom, top)))
    for mark in panel.marks:
        _draw_mark(ax, mark)
    if panel.x_ticks is not None:
        ax.set_xticks(*panel.x_ticks)
    if panel.y_ticks is not None:
        ax.set_yticks(*panel.y_ticks)
    dress(ax, panel.x_name, panel.y_name, panel.title, panel.grid)
    ax.title.set_color(panel.title_colour)


def dress(ax: Axes, x_name: str = "", y_name: str = "", title: str = "", grid: Literal["both", "x"] = "both") -> None:
    """Names of the axes; one colour for everything except data."""
    ax.set_xlabel(x_name, fontsize=SIZE, color=INK)
    ax.set_ylabel(y_name, fontsize=SIZE, color=INK)
    ax.set_title(title, fontsize=SIZE, color=INK)
    ax.set_facecolor("none")
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color(INK)
    ax.tick_params(color=INK, labelcolor=INK, labelsize=SIZE - 1.0)
    ax.grid(axis=grid, color=INK, alpha=0.2, linewidth=0.6)
    ax.set_axisbelow(True)
    for axis in (ax.xaxis, ax.yaxis):
        axis.get_offset_text().set(color=INK, fontsize=SIZE - 1.0)


def svg_of(ax: Axes, alt: str) -> str:
    """The figure of an Axes as an SVG element for HTML; `alt` describes it for screen readers."""
    from matplotlib import rc_context

    text = io.StringIO()
    with SETTINGS_LOCK, rc_context({"svg.fonttype": "none", "svg.hashsalt": "bayesid"}):
        figure: Any = ax.figure
        figure.savefig(text, format="svg", metadata={"Date": None})
    element = re.sub(r"<metadata>.*?</metadata>", "", text.getvalue(), flags=re.DOTALL)
    element = element[element.index("<svg") :].replace(INK, "currentColor")
    return element.replace("<svg ", f'<svg role="img" aria-label="{escape(alt)}" ', 1)


# ---------------------------------------------------------------------------------------------------------------
# Marks
# ---------------------------------------------------------------------------------------------------------------
def _draw_mark(ax: Axes, mark: Mark) -> None:
    look: dict[str, Any]
    if isinstance(mark, Line):
        look = {"linewidth": mark.width, "alpha": mark.alpha, "linestyle": mark.style, "gid": mark.label}
        ax.plot(mark.x, mark.y, color=mark.colour, label=mark.label or None, **look)
    elif isinstance(mark, Band):
        ax.fill_between(mark.x, mark.low, mark.high, color=mark.colour, alpha=mark.alpha, linewidth=0.0, gid=mark.label)
    elif isinstance(mark, Dots):
        many = np.size(mark.x) > 300  # drawn as a picture, below lines: a thousand shapes make a file large
        look = {"alpha": mark.alpha, "rasterized": many, "zorder": 1.0 if many else 3.0, "gid": mark.label}
        ax.scatter(mark.x, mark.y, s=mark.size**2, color=mark.colour, linewidths=0.0, **look)
    elif isinstance(mark, Words):
        for x, y, text in zip(np.ravel(mark.x), np.ravel(mark.y), mark.texts, strict=True):
            beside: dict[str, Any] = {"fontsize": SIZE - 1.5, "color": INK, "va": "center_baseline"}
            ax.annotate(text, (x, y), (4.0, 0.0), textcoords="offset points", **beside)
    elif isinstance(mark, Boxes):
        _draw_boxes(ax, mark)
    else:
        _draw_strokes(ax, mark)


def _draw_boxes(ax: Axes, mark: Boxes) -> None:
    from matplotlib.collections import PolyCollection

    x, y = corners(mark)
    across = mark.x is None or mark.y is None
    look: dict[str, Any] = {"facecolors": _colours(mark)}
    if mark.hatched:
        look = {"facecolors": "none", "edgecolors": INK, "hatch": "////", "alpha": 0.5}
    outlines = np.stack([x[:, [0, 1, 1, 0]], y[:, [0, 0, 1, 1]]], axis=2)
    place = {"transform": _transform(ax, mark), "zorder": 0.0 if across else 1.0}
    ax.add_collection(PolyCollection(list(outlines), linewidths=0.0, gid=mark.label, **look, **place), autolim=False)
    left, right = ax.get_xlim()
    figure: Any = ax.figure
    width = ax.get_position().width * float(figure.figure.get_figwidth())
    above: dict[str, Any] = {"ha": "center", "va": "bottom", "color": INK, "fontsize": SIZE - 1.0}
    for (start, end), letter in zip(x, mark.letters, strict=False):
        if (end - start) / (right - left) * width > 0.13:  # in: room for a letter
            middle, frame = (0.5 * (start + end), 0.999), ax.get_xaxis_transform()
            ax.annotate(letter, middle, (0.0, 3.0), frame, "offset points", annotation_clip=True, **above)


def _draw_strokes(ax: Axes, mark: Strokes) -> None:
    from matplotlib.collections import LineCollection

    lines = np.stack(corners(mark), axis=2)
    look: dict[str, Any] = {"colors": mark.colour, "linewidths": mark.width, "linestyles": mark.style}
    drawn = LineCollection(list(lines), transform=_transform(ax, mark), gid=mark.label, zorder=2.0, **look)
    ax.add_collection(drawn, autolim=False)


def _transform(ax: Axes, mark: Boxes | Strokes) -> Any:
    if mark.x is None:
        return ax.get_yaxis_transform()
    return ax.transData if mark.y is not None else ax.get_xaxis_transform()


def _colours(mark: Boxes) -> Array:
    from matplotlib.colors import to_rgba_array

    colours = to_rgba_array(mark.colour if isinstance(mark.colour, str) else list(mark.colour))
    colours = np.tile(colours, (len(corners(mark)[0]) if len(colours) == 1 else 1, 1))
    colours[:, 3] = mark.alpha
    return colours


def legend(ax: Axes, handles: Sequence[Any], names: Sequence[str], outside: bool) -> None:
    """A legend above all Axes of a figure made here, or inside the first Axes of a given figure."""
    look: dict[str, Any] = {"fontsize": SIZE - 1.0, "labelcolor": INK}
    if outside:
        look |= {"ncols": len(names) if len(names) <= 6 else 4, "frameon": False}
        figure: Any = ax.figure
        figure.legend(handles, names, loc="outside upper center", **look)
    else:
        ax.legend(handles, names, framealpha=0.6, **look)


def _handle(mark: Mark) -> Any:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    if isinstance(mark, Line | Strokes):
        return Line2D([], [], color=mark.colour, linewidth=mark.width, linestyle=mark.style)
    if isinstance(mark, Dots):
        return Line2D([], [], color=mark.colour, linestyle="none", marker="o", markersize=min(mark.size, 6.0))
    if isinstance(mark, Boxes) and mark.hatched:
        return Patch(facecolor="none", edgecolor=INK, hatch="////", linewidth=0.0)
    assert isinstance(mark, Boxes | Band)
    colour = mark.colour if isinstance(mark.colour, str) else mark.colour[0]
    return Patch(color=colour, alpha=float(np.max(mark.alpha)), linewidth=0.0)
