"""A figure as data: panels of lines, bands, boxes, dots and words.

Two renderers draw it: matplotlib (`bayesid.report.plot.drawing`) and, on HTML pages, `pages/figures.js` with uPlot.
Colours: grey ink, which a page replaces by the colour of its text; orange, blue and magenta are visible on white and on
black, and to colour-blind readers.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from bayesid.arrays import Array
from bayesid.report.report_data import envelope

INK, ORANGE, BLUE, MAGENTA = "#767676", "#cc6a1a", "#2b83c6", "#c2408f"
WIDTH, WIDE = 5.4, 10.0
"""Widths, inches: two figures of the first width fit side by side on a page, one of the second fills it."""
Style = Literal["solid", "dashed", "dotted"]
Ends = tuple[ArrayLike, ArrayLike] | None
"""(K,) lower and (K,) upper ends; None: the whole panel."""
Ticks = tuple[ArrayLike, Sequence[str]] | None
"""Positions and texts of an axis' ticks; None: multiples of 1, 2 or 5."""
NO_TICKS: Ticks = ((), ())


@dataclass(frozen=True)
class Line:
    """A curve through (N,) points, interrupted where a value is NaN; width in points."""

    x: Array
    y: Array
    colour: str
    label: str = ""
    width: float = 1.4
    alpha: float = 1.0
    style: Style = "solid"


@dataclass(frozen=True)
class Band:
    """The area between two curves of (N,) points."""

    x: Array
    low: Array
    high: Array
    colour: str
    label: str = ""
    alpha: float = 0.25


@dataclass(frozen=True)
class Boxes:
    """K rectangles: bars, or shaded ranges of an axis."""

    x: Ends  #: left and right ends
    y: Ends  #: lower and upper ends
    colour: str | Sequence[str]  #: one for all boxes, or one per box
    label: str = ""  #: in the legend
    alpha: ArrayLike = 1.0  #: opacity, one for all boxes or one per box
    hatched: bool = False  #: hatched instead of filled
    letters: Sequence[str] = ()  #: K texts above the panel, each shown if it is narrower than its box
    details: Sequence[str] = ()  #: K texts that a page shows for the box under the pointer


@dataclass(frozen=True)
class Strokes:
    """K straight lines, each from (left, bottom) to (right, top): intervals, error bars, or limits across a panel."""

    x: Ends
    y: Ends
    colour: str
    label: str = ""
    width: float = 1.2
    style: Style = "solid"


@dataclass(frozen=True)
class Dots:
    """(N,) dots; diameter in points."""

    x: ArrayLike
    y: ArrayLike
    colour: str
    label: str = ""
    size: float = 3.0
    alpha: float = 1.0


@dataclass(frozen=True)
class Words:
    """Texts to the right of (K,) positions."""

    x: ArrayLike
    y: ArrayLike
    texts: Sequence[str]


Mark = Line | Band | Boxes | Strokes | Dots | Words


@dataclass(frozen=True)
class Panel:
    """One pair of axes."""

    marks: Sequence[Mark]  #: in drawing order, the lowest first
    x_name: str = ""  #: name and unit of the x axis
    y_name: str = ""  #: name and unit of the y axis
    title: str = ""  #: above the panel
    title_colour: str = INK  #: colour of the title
    x_limits: tuple[float, float] | None = None  #: ends of the x axis; None: range of the data plus a margin
    y_limits: tuple[float, float] | None = None  #: ends of the y axis, the lower one first
    x_ticks: Ticks = None  #: ticks of the x axis
    y_ticks: Ticks = None  #: ticks of the y axis
    grid: Literal["both", "x"] = "both"  #: axes with grid lines at their ticks
    margins: tuple[float, float] = (0.05, 0.05)  #: of x and y, over the range of the data
    downwards: bool = False  #: whether y grows downwards

    @property
    def limits(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Ends of both axes; without a margin at zero if boxes, such as bars, end there."""
        boxes = any(isinstance(mark, Boxes) for mark in self.marks)
        x, y = (_around(list(self._values(side)), self.margins[side], boxes) for side in (0, 1))
        return self.x_limits or x, self.y_limits or y

    @property
    def labelled(self) -> dict[str, Mark]:
        """Marks by their labels, for a legend."""
        return {mark.label: mark for mark in self.marks if not isinstance(mark, Words) and mark.label}

    def _values(self, side: int) -> Iterator[Array]:
        """Values of the marks in x (0) or y (1)."""
        for mark in self.marks:
            if isinstance(mark, Boxes | Strokes):
                ends = (mark.x, mark.y)[side]
                yield from () if ends is None else (np.ravel(np.asarray(end, dtype=float)) for end in ends)
            elif isinstance(mark, Band) and side:
                yield from (mark.low, mark.high)
            else:
                yield np.ravel(np.asarray(mark.x if side == 0 or isinstance(mark, Band) else mark.y, dtype=float))


@dataclass(frozen=True)
class Figure:
    """Panels in rows of equal length; None for an empty place."""

    panels: Sequence[Sequence[Panel | None]]  #: the rows
    height: float  #: inches
    width: float = WIDTH  #: inches
    x_name: str = ""  #: name below all panels
    key: bool = False  #: whether there is a legend
    heights: Sequence[float] | None = None  #: relative heights of the rows; equal by default

    @property
    def shown(self) -> list[Panel]:
        """The panels, row by row."""
        return [panel for row in self.panels for panel in row if panel is not None]


def rows_of(panels: Sequence[Panel], columns: int) -> list[list[Panel | None]]:
    """Panels in rows of equal length; the last row is filled with None."""
    filled: list[Panel | None] = [*panels, *[None] * (-len(panels) % columns)]
    return [filled[first : first + columns] for first in range(0, len(filled), columns)]


def listing(
    marks: Sequence[Mark], names: Sequence[str], x_name: str, height: float, *, rows: int = 0, margin: float = 0.05
) -> Figure:
    """Bars or dots below each other, row 0 on top, with names, or a number of rows without names."""
    ends = -0.6, max(len(names), rows, 1) - 0.4
    ticks = np.arange(len(names)), names
    panel = Panel(marks, x_name, y_limits=ends, y_ticks=ticks, grid="x", margins=(margin, 0.0), downwards=True)
    return Figure([[panel]], height, key=True)


def with_common_limits(panels: Sequence[Panel]) -> list[Panel]:
    """The same panels, with the same ends of their axes."""
    x, y = (np.array(ends) for ends in zip(*(panel.limits for panel in panels), strict=True))
    common = [(float(ends[:, 0].min()), float(ends[:, 1].max())) for ends in (x, y)]
    return [replace(panel, x_limits=common[0], y_limits=common[1]) for panel in panels]


def thinned(curves: Sequence[Line | Band], most: int) -> list[Line | Band]:
    """Curves over the same x, thinned to about `most` common rows that include the extremes of each curve."""
    edges = [(curve.low, curve.high) if isinstance(curve, Band) else (curve.y,) for curve in curves]
    values = [edge for pair in edges for edge in pair]
    rows = np.unique(np.concatenate([envelope(value, most // len(values)) for value in values]))
    x = curves[0].x[rows]
    return [
        replace(curve, x=x, low=curve.low[rows], high=curve.high[rows])
        if isinstance(curve, Band)
        else replace(curve, x=x, y=curve.y[rows])
        for curve in curves
    ]


def corners(mark: Boxes | Strokes) -> tuple[Array, Array]:
    """(K, 2) ends in x and (K, 2) in y, which are 0 and 1 for a whole panel."""
    count = max(np.size(end) for ends in (mark.x, mark.y) if ends is not None for end in ends)
    pairs = [(0.0, 1.0) if ends is None else ends for ends in (mark.x, mark.y)]
    left, right = (np.stack([np.broadcast_to(np.asarray(end, float), (count,)) for end in pair], 1) for pair in pairs)
    return left, right


def level(at: float, colour: str = INK, width: float = 0.8, style: Style = "solid", label: str = "") -> Strokes:
    """A line across a panel."""
    return Strokes(None, ([at], [at]), colour, label, width, style)


def upright(at: float, colour: str = INK, width: float = 0.8, style: Style = "solid", label: str = "") -> Strokes:
    """A line up a panel."""
    return Strokes(([at], [at]), None, colour, label, width, style)


def means(x: Array, mean: Array, half: Array, colour: str, size: float = 3.0) -> list[Mark]:
    """A curve with dots and error bars of a half length each."""
    return [
        Line(x, mean, colour, "means"),
        Dots(x, mean, colour, size=size),
        Strokes((x, x), (mean - half, mean + half), colour, width=1.4),
    ]


def _around(values: Sequence[Array], margin: float, boxes: bool) -> tuple[float, float]:
    finite = np.concatenate([np.empty(0), *values])
    finite = finite[np.isfinite(finite)]
    if not finite.size:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    if high - low <= 1e-12 * max(abs(low), abs(high)):  # one value: room for it
        room = 0.05 * abs(low) or 0.05
        return low - room, high + room
    room = margin * (high - low)
    return low - room * (low != 0.0 or not boxes), high + room * (high != 0.0 or not boxes)
