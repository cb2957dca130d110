"""Where the Axes of a figure stand: beside their numbers, names and titles, measured as text without being drawn.

matplotlib's constrained layout draws all numbers twice to learn what room they need, which takes longer than to draw
the figure. What a page's figures have around their Axes is known: numbers, a name of each axis, a title, one legend
above, one name below all. Other figures are laid out by matplotlib.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.text import Annotation, Text
from matplotlib.textpath import text_to_path

from bayesid.arrays import Array

_POINTS = 72.0
"""An inch, in what lengths of a figure are."""
_LINE = 1.05
"""Height of a line of text over its letters' size."""
_FREE = 3.0
"""Points left free around each Axes with all that belongs to it, as in constrained layout."""
_PASSES = 2
"""The numbers depend on the room of an axis, and that on the numbers; a second look no longer moves anything."""


def lay_out(figure: Figure) -> bool:
    """Places the Axes of a figure that are cells of one grid; False if it has others, and nothing is done."""
    grid = _grid(figure)
    if grid is None:
        return False
    width, height = _POINTS * figure.get_size_inches()
    above, below = _legends(figure), sum(_height(text, _FREE) for text in figure.texts)
    for _ in range(_PASSES):
        margins = np.array([[_margins(ax, ax.get_position().size * (width, height)) for ax in row] for row in grid])
        left, right = (margins[..., side].max(axis=0) + _FREE for side in (0, 1))
        bottom, top = (margins[..., side].max(axis=1) + _FREE for side in (2, 3))
        inner = width - (left + right).sum(), height - above - below - (bottom + top).sum()
        size = np.maximum(np.array(inner) / grid.shape[::-1], 1.0)
        x = np.cumsum(left + np.concatenate([[0.0], right[:-1]])) + size[0] * np.arange(grid.shape[1])
        y = height - above - np.cumsum(top + np.concatenate([[0.0], bottom[:-1]]))
        y -= size[1] * np.arange(1, grid.shape[0] + 1)
        for (row, column), ax in np.ndenumerate(grid):
            ax.set_position((x[column] / width, y[row] / height, size[0] / width, size[1] / height))
    return True


def _grid(figure: Figure) -> Any:
    """(rows, columns) Axes of a figure that has nothing else; None for others."""
    places = [ax.get_subplotspec() for ax in figure.axes]
    if figure.subfigs or not places or any(place is None for place in places):
        return None
    rows, columns = {place.get_gridspec().get_geometry() for place in places if place is not None}.pop()
    if len(figure.axes) != rows * columns:
        return None
    return np.array(figure.axes, dtype=object).reshape(rows, columns)


def _legends(figure: Figure) -> float:
    """Height of what stands above all Axes."""
    boxes = [legend.get_window_extent() for legend in figure.legends]
    return sum(2.0 * _FREE + float(box.height) * _POINTS / figure.dpi for box in boxes)


def _margins(ax: Axes, size: Array) -> Array:
    """(4,) points that numbers, names and title take to the left, right, bottom and top of an Axes."""
    if not ax.axison:
        return np.zeros(4)
    across, up = (_Numbers(axis, float(length)) for axis, length in zip((ax.xaxis, ax.yaxis), size, strict=True))
    bottom = across.depth(across.heights) + _height(ax.xaxis.label, ax.xaxis.labelpad) + across.offset
    left = up.depth(up.widths) + _height(ax.yaxis.label, ax.yaxis.labelpad)
    notes = [_outside(text) for text in ax.texts if isinstance(text, Annotation)]
    top = max([_height(ax.title, 6.0), up.offset, *notes])  # matplotlib's distance of titles
    low, high = up.beyond(up.heights)
    first, last = across.beyond(across.widths)
    return np.array([max(left, first), last, max(bottom, low), max(top, high)])


class _Numbers:
    """The numbers at an axis.

    Args:
        axis: of an Axes.
        size: of it, points.
    """

    def __init__(self, axis: Axis, size: float) -> None:
        ax, look = axis.axes, axis.get_tick_params()
        side, length = (0, "labelbottom") if axis is ax.xaxis else (1, "labelleft")
        ends = ax.viewLim.intervalx if side == 0 else ax.viewLim.intervaly
        places = np.asarray(axis.get_majorticklocs(), dtype=float)
        share = (places - ends[0]) / (ends[1] - ends[0])
        texts = axis.get_major_formatter().format_ticks(places.tolist())
        shown = (share > -1e-9) & (share < 1.0 + 1e-9)
        self._size = size
        self._room = 7.0 if shown.any() else 0.0  # a tick and the pad beyond it, 3.5 points each
        self._share, font = share[shown], float(look.get("labelsize", 10.0))
        texts = [text for text, here in zip(texts, shown, strict=True) if here] if look.get(length, True) else []
        self.widths = np.array([_width(text, font) for text in texts])
        self.heights = np.full(len(texts), _LINE * font)
        self.offset = _LINE * font if axis.get_major_formatter().get_offset() else 0.0

    def depth(self, sizes: Array) -> float:
        """How far they reach from the axis."""
        return self._room + float(sizes.max(initial=0.0))

    def beyond(self, sizes: Array) -> tuple[float, float]:
        """How far they reach beyond the axis' ends."""
        if not len(sizes):
            return 0.0, 0.0
        start, end = self._share * self._size, (1.0 - self._share) * self._size
        return float(np.max(0.5 * sizes - start, initial=0.0)), float(np.max(0.5 * sizes - end, initial=0.0))


def _height(text: Text, pad: float = 0.0) -> float:
    """Of a line of text and its distance; 0 without text."""
    return _LINE * float(text.get_fontsize()) + pad if text.get_text() else 0.0


def _outside(note: Annotation) -> float:
    """Height of what is written above an Axes."""
    return note.xyann[1] + _height(note) if note.get_verticalalignment() == "bottom" else 0.0


@lru_cache(maxsize=4096)
def _width(text: str, size: float) -> float:
    """Of a line of text in matplotlib's own font, which is broader than most."""
    return float(text_to_path.get_text_width_height_descent(text, FontProperties(size=size), False)[0])
