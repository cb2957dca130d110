"""What pages are made of: sections of text, tables and figures, in jinja2's templates; numbers as people read them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from importlib import resources
from importlib.metadata import version
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape
from numpy.typing import ArrayLike

from bayesid.arrays import Array
from bayesid.identification.checks import Check
from bayesid.number_text import percent, rounded
from bayesid.report.plot.figure import Band, Boxes, Figure, Line, Mark, Panel, Strokes, Ticks, corners
from bayesid.report.report_data import evenly
from bayesid.report.tuning import TUNING

_ROOM = "bayesid.report.pages"
NONE = Markup('<span class="none">&ndash;</span>')


@dataclass(frozen=True)
class Picture:
    """A figure on a page."""

    name: str  #: its identifier
    data: Mapping[str, Any]  #: what `figures.js` draws
    caption: str  #: below it
    alt: str  #: what it shows, for those who do not see it
    group: str = ""  #: name of the figures that share the range of their x axes; empty if it stands by itself


def picture(figure: Figure, name: str, caption: str, alt: str = "", group: str = "") -> Picture:
    """A figure on a page; what it shows is the caption by default."""
    rows = [[None if panel is None else _panel(panel) for panel in row] for row in figure.panels]
    data = {"panels": rows, "height": figure.height, "x_name": figure.x_name, "key": figure.key}
    return Picture(name, data, caption, alt or caption, group)


COLOURS = {"good": "good", "look": "look", "bad": "bad", "not done": "open"}
"""Of each state of a check the class on the page."""


@dataclass(frozen=True)
class Section:
    """A part of a page: the identifier that links lead to, its heading, and what stands below."""

    name: str
    title: str
    content: Markup


def section(name: str, title: str, *parts: Markup) -> Section:
    """A section of texts, tables and figures."""
    return Section(name, title, Markup("\n").join(parts))


def paragraph(text: str, note: bool = False) -> Markup:
    """A paragraph; a note is smaller. Commands stand between backquotes."""
    return Markup("<p{}>{}</p>").format(Markup(' class="note"') if note else "", code(text))


def lights(checks: Iterable[Check], words: Mapping[str, str], places: Mapping[str, str]) -> Markup:
    """Checks as traffic lights, with a word for each state, and the sections that show more by the check's name."""
    return _parts().lights([(one, COLOURS[one.state], words.get(one.state, one.state)) for one in checks], places)


def lines(checks: Iterable[Check]) -> Markup:
    """Checks in one line each, with the colour of their state."""
    return _parts().lines([(one, COLOURS[one.state]) for one in checks])


def table(caption: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> Markup:
    """A table; cells are text, or what `number` and the like make of a number."""
    return _parts().table(caption, headings, list(rows))


def items(texts: Sequence[str]) -> Markup:
    """A list."""
    return _parts().items(texts)


def columns(lists: Sequence[tuple[str, Sequence[str]]], nothing: str) -> Markup:
    """Lists side by side, each with its heading; `nothing` stands where one is empty."""
    return _parts().columns(lists, nothing)


def figures(pictures: Sequence[Picture], linked: bool = False) -> Markup:
    """Figures, or those over time that share their range."""
    return _parts().linked(pictures) if linked else _parts().figures(pictures)


def page(
    title: str,
    subject: str,
    status: tuple[str, str],
    lead: str | Markup,
    about: Sequence[tuple[str, str]],
    warnings: Sequence[str],
    sections: Sequence[Section],
) -> str:
    """A whole page that opens from anywhere, light or dark, and prints; nothing is fetched, text is escaped.

    The status is a class and a few words, the lead says the same in a sentence or two, or as `lines` does,
    and `about` names and values.
    """
    styles = {"style": _read("uPlot.min.css") + _read("style.css"), "script": _script(), "version": version("bayesid")}
    content = {"title": title, "subject": subject, "status": status, "lead": lead, "about": about}
    return fragment("page.html.jinja", **content, warnings=warnings, sections=sections, **styles)


def fragment(template: str, **content: Any) -> str:
    """What a template makes of its content; text is escaped."""
    return _environment().get_template(template).render(**content)


@cache
def _parts() -> Any:
    return _environment().get_template("parts.html.jinja").module


def _read(file: str) -> Markup:
    return Markup(resources.files(_ROOM).joinpath(file).read_text(encoding="utf-8"))


@cache
def _script() -> Markup:
    """The library uPlot under its licence, which draws at twice a screen's resolution, to print well; and ours."""
    code = _read("uPlot.iife.min.js").partition("\n")[2]  # without its address
    sharp = "const uPlot = ((devicePixelRatio) => {{\n{}\nreturn uPlot;\n}})(Math.max(2, devicePixelRatio));\n"
    licence = Markup("/* uPlot 1.6.32\n{}*/\n").format(_read("uPlot.LICENSE"))
    return licence + Markup(sharp.format(code)) + _read("figures.js")


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader(_ROOM),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    environment.filters |= {"typeset": typeset, "code": code, "cell": cell}
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":")}
    environment.globals["NONE"] = NONE
    return environment


def _panel(panel: Panel) -> dict[str, Any]:
    """For `figures.js`: numbers to a hundred-thousandth of an axis in x, to a ten-thousandth in y; nan is null."""
    x_ends, y_ends = panel.limits
    x_digits, y_digits = _digits(x_ends, 5), _digits(y_ends, 4)
    xs: dict[bytes, list[float | None]] = {}  # of curves, which several have in common

    def across(x: Array) -> int:
        key = np.asarray(x).tobytes()
        xs.setdefault(key, _rounded(x, x_digits))
        return list(xs).index(key)

    def told(mark: Mark) -> dict[str, Any]:
        named = {one.name: getattr(mark, one.name) for one in fields(mark)}
        if isinstance(mark, Line):
            named |= {"x": across(mark.x), "y": _rounded(mark.y, y_digits)}
        elif isinstance(mark, Band):
            named |= {"x": across(mark.x), "low": _rounded(mark.low, y_digits), "high": _rounded(mark.high, y_digits)}
        elif isinstance(mark, Boxes | Strokes):
            x, y = corners(mark)
            named["x"] = None if mark.x is None else [_rounded(end, x_digits) for end in x.T]
            named["y"] = None if mark.y is None else [_rounded(end, y_digits) for end in y.T]
        else:
            places = np.ravel(mark.x), np.ravel(mark.y)
            chosen = evenly(len(places[0]), TUNING.scatter)
            named |= {"x": _rounded(places[0][chosen], x_digits), "y": _rounded(places[1][chosen], y_digits)}
        if isinstance(mark, Boxes) and np.ndim(mark.alpha):
            named["alpha"] = _rounded(mark.alpha, 3)
        return {"kind": type(mark).__name__.lower(), **named}

    return {
        "marks": [told(mark) for mark in panel.marks],
        "xs": list(xs.values()),
        "x": _axis(panel.x_name, x_ends, panel.x_ticks, True),
        "y": _axis(panel.y_name, y_ends, panel.y_ticks, panel.grid == "both"),
        "title": panel.title,
        "tint": panel.title_colour,
        "downwards": panel.downwards,
    }


def _axis(name: str, ends: tuple[float, float], ticks: Ticks, grid: bool) -> dict[str, Any]:
    places = None if ticks is None else [np.asarray(ticks[0], dtype=float).tolist(), list(ticks[1])]
    return {"name": name, "ends": ends, "ticks": places, "grid": grid}


def _digits(ends: tuple[float, float], figures: int) -> int:
    """Behind the point, so that an axis is divided into ten to the power of so many figures at least."""
    return figures - math.floor(math.log10(ends[1] - ends[0]))


def _rounded(values: ArrayLike, digits: int) -> list[float | None]:
    array = np.round(np.asarray(values, dtype=float), digits)
    return [value if math.isfinite(value) else None for value in array.tolist()]


def typeset(text: str) -> Markup:
    """Escaped, with the signs that plain text lacks."""
    text = str(escape(text)).replace(" +- ", "&nbsp;&plusmn;&nbsp;").replace("^2", "&sup2;").replace("^3", "&sup3;")
    text = text.replace(" -&gt; ", "&nbsp;&rarr;&nbsp;")
    text = re.sub(r"\b(N|kg) (m|s)\b", r"\1&nbsp;\2", text)
    text = re.sub(r"(\d) ?%", r"\1&nbsp;%", text)
    return Markup(re.sub(r"(?<![\w)])-(?=\d)", "&minus;", text))


def code(text: str) -> Markup:
    """Typeset, with commands between backquotes as code."""
    parts = enumerate(text.split("`"))
    return Markup("").join(Markup("<code>{}</code>").format(part) if k % 2 else typeset(part) for k, part in parts)


def cell(text: str) -> Markup:
    """Typeset, unless it is already; a dash for nothing."""
    return text if isinstance(text, Markup) else typeset(text) if text else NONE


def data(value: float, text: str) -> Markup:
    """A number as people read it, and exactly for machines."""
    return Markup('<data value="{}">{}</data>').format(repr(float(value)), typeset(text.rstrip()))


def number(value: float, unit: str = "") -> Markup:
    """For people to three digits, for machines exactly."""
    if np.isnan(value):
        return NONE
    return data(value, f"unlimited {unit}" if np.isposinf(value) else f"{rounded(float(value))} {unit}")


def probability(value: float) -> Markup:
    """To a thousandth."""
    return data(value, f"{value:.3f}")


def share(value: float) -> Markup:
    """In percent, to a tenth."""
    return NONE if np.isnan(value) else data(value, percent(value, 1))
