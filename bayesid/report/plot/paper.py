"""Figures of pages: what takes the place of matplotlib's Figure and Axes where a page is made, and writes SVG.

The functions that draw know only a few methods of an Axes, which a `Panel` has too. matplotlib makes objects of every
tick and number, and of every line's looks, which takes seconds a page; a panel writes each as a line of text. Around
it stand what figures here have: numbers, a name of each axis, a title, one legend above, one name below all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from html import escape
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from bayesid.arrays import Array
from bayesid.report.plot.axis import Axis, text_width
from bayesid.report.plot.ink import INK, SIZE, WIDTH
from bayesid.report.plot.svg import circle, discs, filled, line, ruled, stroked, words

_POINTS = 72.0
"""An inch; what lengths on paper are in."""
_LINE = 1.05
"""Height of a line of text over its letters' size."""
_FREE = 3.0
"""Points left free around each panel with all that belongs to it."""
_TICK, _PAD = 3.5, 3.5
"""Points, of a tick and beyond it."""
_INSIDE = 0.775
"""Share of the width that is inside of a panel, about, before it has its place; as matplotlib's."""
_EDGE = 1.0
"""Points, of the line around a dot of a curve."""
_PASSES = 2
"""The numbers depend on the room of an axis, and that on the numbers; a second look no longer moves anything."""
_SMALL = SIZE - 1.0
"""Letters of numbers and legends, points."""
_NAME = _LINE * SIZE + 4.0
"""Points, of an axis' name and the pad before it."""
_SWATCH = 18.0, 7.0
"""Of a legend, points."""
_MIDDLE = 0.36
"""Of a letter's size, from a line's middle down to where its letters stand."""
_UNDER = 0.5
"""Order of the grid among what is drawn."""
_TOP = "top"
"""Stands for the transform of positions at a panel's upper edge."""
_Curve = tuple[ArrayLike, ArrayLike]
"""x and y."""


@dataclass
class _Mark:
    """What is drawn on a panel, once that has its place: SVG, made of what begins its identifiers.

    A label stands beside the swatch in a legend; by the name a script finds it.
    """

    order: float
    draw: Callable[[str], str]
    label: str = ""
    swatch: str = ""
    name: str = ""

    def set_gid(self, name: str) -> None:
        self.name = name


# ---------------------------------------------------------------------------------------------------------------
# Paper
# ---------------------------------------------------------------------------------------------------------------
class Paper:
    """A figure of a page.

    Args:
        height: in.
        width: in.
    """

    def __init__(self, height: float, width: float = WIDTH) -> None:
        self._size = _POINTS * np.array([width, height])
        self._panels: Any = np.empty((0, 0), dtype=object)
        self._legend: list[_Mark] = []
        self._below = ""

    @property
    def figure(self) -> Paper:
        """Itself, as matplotlib's figures have it."""
        return self

    def get_figwidth(self) -> float:
        """In."""
        return float(self._size[0] / _POINTS)

    def subplots(
        self, rows: int = 1, columns: int = 1, *, squeeze: bool = True, sharex: bool = False, sharey: bool = False
    ) -> Any:
        """A panel or (rows, columns) of them, which may share their axes; the outer ones show the numbers then."""
        self._panels = np.empty((rows, columns), dtype=object)
        x, y = Axis(), Axis()
        for row, column in np.ndindex(rows, columns):
            shown = not sharex or row == rows - 1, not sharey or column == 0
            axes = x if sharex else Axis(), y if sharey else Axis()
            self._panels[row, column] = Panel(self, *axes, shown, _INSIDE * self._size[0] / columns)
        return self._panels if not squeeze else self._panels[0, 0] if rows * columns == 1 else self._panels.squeeze()

    def supxlabel(self, text: str, **_: Any) -> None:
        """A name of all x axes."""
        self._below = text

    def key(self, marks: Sequence[_Mark]) -> None:
        """A legend above all panels."""
        self._legend = list(marks)

    def svg(self, name: str, alt: str) -> str:
        """The figure as an element of a page: text in the page's font and colour, nothing but what is in it.

        Args:
            name: begins its identifiers, so that those of several figures do not clash.
            alt: what it shows, for those who do not see it.
        """
        self._lay_out()
        width, height = self._size
        parts = [self._key_svg(), *(panel.svg(name, k, self._panels.size == 1) for k, panel in enumerate(self._shown))]
        if self._below:
            parts.append(words(width / 2.0, height - _FREE - 0.2 * SIZE, self._below, SIZE))
        box = f'viewBox="0 0 {width:g} {height:g}"'
        return f'<svg role="img" aria-label="{escape(alt)}" {box}>{"".join(parts)}</svg>'.replace(INK, "currentColor")

    @property
    def _shown(self) -> list[Panel]:
        return [panel for panel in self._panels.ravel() if panel.axison]

    def _lay_out(self) -> None:
        """Places the panels beside their numbers, names and titles."""
        width, height = self._size
        above = 4.0 * _FREE + _LINE * _SMALL if self._legend else 0.0
        below = _LINE * SIZE + _FREE if self._below else 0.0
        rows, columns = self._panels.shape
        inner = self._size / (columns, rows) - 40.0
        for _ in range(_PASSES):
            margins = np.array([[panel.surround(*inner) for panel in row] for row in self._panels])
            left, right = (margins[..., side].max(axis=0) + _FREE for side in (0, 1))
            bottom, top = (margins[..., side].max(axis=1) + _FREE for side in (2, 3))
            free = width - (left + right).sum(), height - above - below - (bottom + top).sum()
            inner = np.maximum(np.array(free) / (columns, rows), 1.0)
        x = np.cumsum(left + np.concatenate([[0.0], right[:-1]])) + inner[0] * np.arange(columns)
        y = above + np.cumsum(top + np.concatenate([[0.0], bottom[:-1]])) + inner[1] * np.arange(rows)
        for (row, column), panel in np.ndenumerate(self._panels):
            panel.box = x[column], y[row], *inner

    def _key_svg(self) -> str:
        widths = [text_width(mark.label, _SMALL) + _SWATCH[0] + 0.6 * _SMALL for mark in self._legend]
        between, y = 1.4 * _SMALL, 2.0 * _FREE + 0.5 * _SMALL
        x = 0.5 * (self._size[0] - sum(widths) - between * (len(widths) - 1))
        parts = []
        for mark, width in zip(self._legend, widths, strict=True):
            parts.append(f'<g transform="translate({x:.2f} {y - 0.5 * _SWATCH[1]:.2f})">{mark.swatch}</g>')
            parts.append(words(x + _SWATCH[0] + 0.6 * _SMALL, y + _MIDDLE * _SMALL, mark.label, _SMALL, "start"))
            x += width + between
        return "".join(parts)


# ---------------------------------------------------------------------------------------------------------------
# Panel
# ---------------------------------------------------------------------------------------------------------------
class Panel:
    """One pair of axes on a paper, with the methods of matplotlib's Axes that figures here use, and their arguments."""

    def __init__(self, figure: Paper, x: Axis, y: Axis, numbered: tuple[bool, bool], room: float) -> None:
        self.figure, self.axison = figure, True
        self.box = 0.0, 0.0, room, room
        self._x, self._y, self._numbered, self._grid = x, y, numbered, "both"
        self._marks: list[_Mark] = []
        self._name = {"x": "", "y": ""}
        self._above = 0.0

    # -- lines ----------------------------------------------------------------------------------------------------
    def plot(self, *data: Any, color: str, label: str = "", **look: Any) -> list[_Mark]:
        """A curve y, or y over x; dots with "o" as third."""
        x, y = (np.arange(len(data[0])), data[0]) if len(data) == 1 else data[:2]
        self._take(x, y)
        if len(data) == 3:
            radius = 0.5 * (look["markersize"] + _EDGE)
            return [self._add(2.0, lambda _: discs(self.at(x, y), radius, color), label)]
        stroke = stroked(color, look.get("linewidth", 1.5), look.get("alpha", 1.0), look.get("linestyle", "solid"))
        return [self._lines(2.0, lambda: [(x, y)], stroke, label)]

    def errorbar(self, x: Array, y: Array, *, yerr: Array, color: str, **look: Any) -> None:
        """A curve with dots, and bars from y - yerr to y + yerr."""
        low, high, half = y - yerr, y + yerr, look["capsize"]
        bars = [((a, a), ends) for a, *ends in zip(x, low, high, strict=True)]
        self._take([*x, *x], [*low, *high])

        def caps(_: str) -> str:
            ends = np.concatenate([self.at(x, low), self.at(x, high)]).tolist()
            tips = "".join(f"M{a - half:.2f} {b:.2f}h{2.0 * half:g}" for a, b in ends)
            return f'<path d="{tips}" {stroked(color, _EDGE)}/>'

        self.plot(x, y, color=color, linewidth=look["linewidth"])
        self.plot(x, y, "o", color=color, markersize=look["markersize"])
        self._lines(2.0, lambda: bars, stroked(color, look["linewidth"]))
        self._add(2.0, caps)

    def axhline(self, y: float, color: str, linewidth: float, linestyle: str = "solid") -> None:
        """A line across."""
        self._y.take([y])
        self._lines(2.0, lambda: [(self._x.ends, (y, y))], stroked(color, linewidth, 1.0, linestyle))

    def axvline(self, x: float, color: str, linewidth: float, linestyle: str = "solid", label: str = "") -> None:
        """A line up."""
        self._x.take([x])
        self._lines(2.0, lambda: [((x, x), self._y.ends)], stroked(color, linewidth, 1.0, linestyle), label)

    def hlines(self, y: Array, left: Array, right: Array, colors: str, linewidth: float) -> None:
        """Lines from left to right."""
        self._take([*left, *right], y)
        lines = [((a, b), (row, row)) for row, a, b in zip(y, left, right, strict=True)]
        self._lines(1.0, lambda: lines, stroked(colors, linewidth))

    # -- areas ----------------------------------------------------------------------------------------------------
    def axhspan(self, low: float, high: float, color: str, alpha: float, label: str = "", **look: Any) -> None:
        """A band across."""
        self._y.take([low, high])
        self._boxes(look.get("zorder", 1.0), lambda: [(self._x.ends, (low, high))], [filled(color, alpha)], label)

    def axvspan(self, left: float, right: float, color: str, alpha: float, label: str = "", **_: Any) -> None:
        """A band up."""
        self._x.take([left, right])
        self._boxes(1.0, lambda: [((left, right), self._y.ends)], [filled(color, alpha)], label)

    def barh(self, y: Array, width: Array, height: float, color: str | Sequence[str], label: str = "") -> None:
        """Bars from zero to the right, or to the left."""
        low, high = y - 0.5 * height, y + 0.5 * height
        self._x.take([0.0], base=True)
        self._take(width, [*low, *high])
        bars = [((0.0, end), rows) for end, *rows in zip(width, low, high, strict=True)]
        colours = [color] * len(bars) if isinstance(color, str) else color
        self._boxes(1.0, lambda: bars, [filled(colour) for colour in colours], label)

    def broken_barh(self, ranges: Sequence[tuple[float, float]], _: Any, zorder: float, **look: Any) -> _Mark:
        """Bands up, from each left end on as broad as is told: in colours with an opacity, or hatched."""

        def bands() -> list[_Curve]:
            return [((left, left + width), self._y.ends) for left, width in ranges]

        if "hatch" in look:
            return self._hatched(zorder, bands, look["alpha"])
        return self._boxes(zorder, bands, [filled(*one) for one in look["facecolors"]])

    def fill_between(self, x: Any, low: Any, high: Any, label: str = "", **look: Any) -> _Mark:
        """What lies between two curves; a legend's entry if they are empty."""
        if "hatch" in look:
            return self._hatched(1.0, list, 1.0, label)
        self._take([*x, *x], [*low, *high])
        outline = [*x, *reversed(x)], [*low, *reversed(high)]
        return self._areas(1.0, lambda: [outline] * bool(len(x)), [filled(look["color"], look["alpha"])], label)

    def stairs(self, values: Array, edges: Array, baseline: float = 0.0, fill: bool = False, *, color: str) -> None:
        """A histogram's outline over a base, or all below it."""
        self._take(edges, values)
        self._y.take([baseline], base=True)
        curve = np.repeat(edges, 2), np.array([baseline, *np.repeat(values, 2), baseline])
        if fill:
            self._areas(1.0, lambda: [curve], [filled(color)])
        else:
            self._lines(1.0, lambda: [curve], stroked(color, 1.0))

    def scatter(self, x: Any, y: Any, s: float, color: str, alpha: float = 1.0, label: str = "", **look: Any) -> None:
        """Dots; where they lie on each other they are darker."""
        self._take(x, y)
        radius = 0.5 * (float(np.sqrt(s)) + look.get("linewidths", 1.5))
        dot = f'<path d="{circle(0.0, 0.0, radius)}" {filled(color, alpha)}/>'

        def draw(prefix: str) -> str:
            marks = " ".join(f'marker-{place}="url(#{prefix})"' for place in ("start", "mid", "end"))
            marker = f'<marker id="{prefix}" overflow="visible" markerUnits="userSpaceOnUse">{dot}</marker>'
            return f'{marker}<path d="{line(self.at(x, y))}" fill="none" {marks}/>'

        self._add(look.get("zorder", 1.0), draw, label, f'<g transform="translate(9 3.5)">{dot}</g>')

    # -- text -----------------------------------------------------------------------------------------------------
    def annotate(self, text: str, xy: tuple[float, float], shift: Any, above: str = "", *_: Any, **look: Any) -> _Mark:
        """Text some points away from a place, or from the upper edge of the panel."""
        size, top = look["fontsize"], above == _TOP
        if top:
            self._above = max(self._above, shift[1] + _LINE * size)

        def draw(_: str) -> str:
            ((x, y),) = self.at(*xy).tolist()
            if top and not self.box[0] <= x <= self.box[0] + self.box[2]:
                return ""
            lower = self.box[1] - 0.24 * size if top else y + _MIDDLE * size
            return words(x + shift[0], lower - shift[1], text, size, "middle" if look.get("ha") else "start")

        return self._add(3.0, draw)

    def set_title(self, text: str, fontsize: float, color: str = INK, fontweight: str = "normal") -> None:
        """A line above."""
        self._above = _LINE * fontsize + 6.0

        def draw(_: str) -> str:
            left, top, width, _height = self.box
            return words(left + 0.5 * width, top - 6.0, text, fontsize, colour=color, weight=fontweight)

        self._add(3.0, draw)

    def set_xlabel(self, text: str, **_: Any) -> None:
        """Names the x axis."""
        self._name["x"] = text

    def set_ylabel(self, text: str, **_: Any) -> None:
        """Names the y axis."""
        self._name["y"] = text

    # -- axes -----------------------------------------------------------------------------------------------------
    def set_xlim(self, left: float, right: float) -> None:
        """The x axis' ends."""
        self._x.limit(left, right)

    def set_ylim(self, bottom: float, top: float) -> None:
        """The y axis' ends."""
        self._y.limit(bottom, top)

    def get_position(self) -> SimpleNamespace:
        """With its width as a share of the paper's."""
        return SimpleNamespace(width=self.box[2] / (_POINTS * self.figure.get_figwidth()))

    def get_xlim(self) -> tuple[float, float]:
        """The x axis' ends."""
        return self._x.ends

    def set_xticks(self, places: ArrayLike, texts: Sequence[str] | None = None) -> None:
        """What stands at the x axis in place of round numbers."""
        self._x.number(places, texts)

    def set_yticks(self, places: ArrayLike, texts: Sequence[str] | None = None) -> None:
        """What stands at the y axis in place of round numbers."""
        self._y.number(places, texts)

    def invert_yaxis(self) -> None:
        """Upside down."""
        self._y.inverted = True

    def margins(self, x: float) -> None:
        """Room free at the x axis' ends, as a share of what the data take."""
        self._x.margin = x

    def set_axis_off(self) -> None:
        """Shows nothing."""
        self.axison = False

    def get_xaxis_transform(self) -> str:
        """For text above the panel."""
        return _TOP

    def dress(self, grid: Literal["both", "x"]) -> None:
        """Along which axes' numbers lines are drawn."""
        self._grid = grid

    def legend(self) -> None:
        """Says above all panels what is drawn on this one."""
        self.figure.key([mark for mark in self._marks if mark.label])

    # -- parts ----------------------------------------------------------------------------------------------------
    def at(self, x: ArrayLike, y: ArrayLike) -> Array:
        """(N, 2) points on the paper."""
        left, top, width, height = self.box
        across, up = np.atleast_1d(self._x.share(x)), np.atleast_1d(self._y.share(y))
        return np.column_stack([left + width * across, top + height * (1.0 - up)])

    def _take(self, x: Any, y: Any) -> None:
        self._x.take(x)
        self._y.take(y)

    def _add(self, order: float, draw: Callable[[str], str], label: str = "", swatch: str = "") -> _Mark:
        self._marks.append(_Mark(order, draw, label, swatch))
        return self._marks[-1]

    def _lines(self, order: float, curves: Callable[[], Iterable[_Curve]], look: str, label: str = "") -> _Mark:
        swatch = f'<path d="M0 3.5H18" {look}/>'
        return self._add(order, lambda _: f'<path d="{self._paths(curves())}" {look}/>', label, swatch)

    def _areas(
        self, order: float, outlines: Callable[[], Iterable[_Curve]], looks: Sequence[str], label: str = ""
    ) -> _Mark:
        def draw(_: str) -> str:
            shapes = zip(outlines(), looks, strict=False)
            return "".join(f'<path d="{self._paths([outline])}z" {look}/>' for outline, look in shapes)

        return self._add(order, draw, label, f'<path d="M0 0H18V7H0z" {looks[0] if looks else ""}/>')

    def _boxes(
        self, order: float, boxes: Callable[[], Iterable[_Curve]], looks: Sequence[str], label: str = ""
    ) -> _Mark:
        return self._areas(order, lambda: _corners(boxes()), looks, label)

    def _paths(self, curves: Iterable[_Curve]) -> str:
        return "".join(line(self.at(*curve)) for curve in curves)

    def _hatched(self, order: float, boxes: Callable[[], Iterable[_Curve]], alpha: float, label: str = "") -> _Mark:
        def draw(prefix: str) -> str:
            strokes = f'<path d="M-1 1l2-2M0 6l6-6M5 7l2-2" {stroked(INK, 1.0)}/>'
            tile = f'<pattern id="{prefix}" width="6" height="6" patternUnits="userSpaceOnUse">{strokes}</pattern>'
            return f'{tile}<path d="{self._paths(_corners(boxes()))}" fill="url(#{prefix})" fill-opacity="{alpha:g}"/>'

        return self._add(order, draw, label, f'<path d="M0 7l7-7M4 7l7-7M8 7l7-7M12 7l6-6" {stroked(INK, 1.0)}/>')

    # -- on the paper ---------------------------------------------------------------------------------------------
    def surround(self, width: float, height: float) -> tuple[float, float, float, float]:
        """Points that numbers, names and title take to the left, right, bottom and top of a panel of that size."""
        if not self.axison:
            return 0.0, 0.0, 0.0, 0.0
        across, names, power = self._x.numbers(width, 3.0 * _SMALL)
        up, texts, factor = self._y.numbers(height, 2.0 * _SMALL)
        half = [0.5 * text_width(name, _SMALL) for name in names * self._numbered[0]]
        shares = across.tolist()[: len(half)]
        beyond = [(a - share * width, a - (1.0 - share) * width) for a, share in zip(half, shares, strict=True)]
        first, last = np.max(beyond, axis=0, initial=0.0) if beyond else (0.0, 0.0)
        left = (_TICK + _PAD) * bool(texts) + self._broadest(texts) + _NAME * bool(self._name["y"])
        lines = _LINE * _SMALL * (bool(half) + bool(power))
        below = (_TICK + _PAD) * bool(names) + lines + _NAME * bool(self._name["x"])
        high = 0.5 * _SMALL if texts and float(up.max()) > 0.9 else 0.0
        return max(left, float(first)), float(last), below, max(self._above, _LINE * _SMALL * bool(factor), high)

    def svg(self, name: str, number: int, alone: bool) -> str:
        """All of it; a panel that is alone on its paper has identifiers for the page's script."""
        left, top, width, height = self.box
        corners = f"M{left:.2f} {top + height:.2f}L{left:.2f} {top:.2f}L{left + width:.2f} {top:.2f}"
        area = f'<path d="{corners}L{left + width:.2f} {top + height:.2f}z" fill="none"/>'
        clip = f"{name}-clip{number}"
        marks = sorted(self._marks, key=lambda mark: mark.order)
        drawn = [(mark.order, self._drawn(mark, name, f"{name}-{number}-{k}")) for k, mark in enumerate(marks)]
        under, over, text = (
            "".join(svg for order, svg in drawn if low <= order < high)
            for low, high in ((-1.0, _UNDER), (_UNDER, 3.0), (3.0, 4.0))
        )
        parts = [
            f'<clipPath id="{clip}">{area.replace(" fill=", " stroke=")}</clipPath>',
            f'<g id="{name}-area">{area}</g>' if alone else "",
            f'<g clip-path="url(#{clip})">{under}</g>' if under else "",
            f'<g id="{name}-xaxis">{self._across()}</g>' if alone else self._across(),
            self._up(),
            f'<g clip-path="url(#{clip})">{over}</g>',
            f'<path d="M{left:.2f} {top:.2f}v{height:.2f}h{width:.2f}" {stroked(INK, 0.8)}/>{text}',
        ]
        return "".join(parts)

    def _drawn(self, mark: _Mark, name: str, prefix: str) -> str:
        svg = mark.draw(prefix)
        return f'<g id="{name}-{mark.name}">{svg}</g>' if mark.name and svg else svg

    def _across(self) -> str:
        """The x axis below the panel."""
        left, top, width, height = self.box
        share, texts, power = self._x.numbers(width, 3.0 * _SMALL)
        places, low = (left + width * share).tolist(), top + height
        below = low + _TICK + _PAD + 0.8 * _SMALL
        grid = "".join(f"M{x:.2f} {low:.2f}v{-height:.2f}" for x in places)
        ticks = "".join(f"M{x:.2f} {low:.2f}v{_TICK}" for x in places)
        numbers = [words(x, below, text, _SMALL) for x, text in zip(places, texts, strict=True)] * self._numbered[0]
        end = low + self.surround(width, height)[2]
        name = words(left + 0.5 * width, end - 0.25 * SIZE, self._name["x"], SIZE) if self._name["x"] else ""
        name += words(left + width, below + _LINE * _SMALL, power, _SMALL, "end") if power else ""
        return f"<g>{ruled(grid, ticks)}{''.join(numbers)}</g><g>{name}</g>"

    def _up(self) -> str:
        """The y axis at its left."""
        left, top, width, height = self.box
        share, texts, power = self._y.numbers(height, 2.0 * _SMALL)
        places = (top + height * (1.0 - share)).tolist()
        grid = "".join(f"M{left:.2f} {y:.2f}h{width:.2f}" for y in places) if self._grid == "both" else ""
        ticks = "".join(f"M{left:.2f} {y:.2f}h{-_TICK}" for y in places)
        beside = left - _TICK - _PAD
        numbers = [
            words(beside, y + _MIDDLE * _SMALL, text, _SMALL, "end") for y, text in zip(places, texts, strict=False)
        ]
        x = left - self.surround(width, height)[0] + _LINE * SIZE - 0.25 * SIZE
        y = top + 0.5 * height
        name = words(x, y, self._name["y"], SIZE, turned=True) if self._name["y"] else ""
        name += words(left, top - 0.25 * _SMALL, power, _SMALL, "start") if power else ""
        return f"{ruled(grid, ticks)}{''.join(numbers * self._numbered[1])}{name}"

    def _broadest(self, texts: Sequence[str]) -> float:
        """Points that the numbers of the y axis take."""
        return max((text_width(text, _SMALL) for text in texts), default=0.0) * self._numbered[1]


def _corners(boxes: Iterable[Any]) -> list[_Curve]:
    """Outlines of boxes, each from an x to another and from a y to another."""
    return [((a, b, b, a, a), (c, c, d, d, c)) for (a, b), (c, d) in boxes]
