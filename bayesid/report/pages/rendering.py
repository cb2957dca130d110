"""Parts of HTML pages: sections of text, tables and figures, from jinja2 templates; numbers rounded for reading."""

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
    alt: str  #: description for screen readers
    group: str = ""  #: name of a group of figures that share the range of their x axes; empty for a single figure


def picture(figure: Figure, name: str, caption: str, alt: str = "", group: str = "") -> Picture:
    """A figure on a page; its description is the caption by default."""
    rows = [[None if panel is None else _panel(panel) for panel in row] for row in figure.panels]
    data = {"panels": rows, "height": figure.height, "x_name": figure.x_name, "key": figure.key}
    return Picture(name, data, caption, alt or caption, group)


COLOURS = {"good": "good", "look": "look", "bad": "bad", "not done": "open"}
"""Of each state of a check the class on the page."""


@dataclass(frozen=True)
class Section:
    """A section of a page: identifier for links, heading, and content."""

    name: str
    title: str
    content: Markup


def section(name: str, title: str, *parts: Markup) -> Section:
    """A section of texts, tables and figures."""
    return Section(name, title, Markup("\n").join(parts))


def paragraph(text: str, note: bool = False) -> Markup:
    """A paragraph; a note is smaller. Commands are between backquotes."""
    return Markup("<p{}>{}</p>").format(Markup(' class="note"') if note else "", code(text))


def lights(checks: Iterable[Check], words: Mapping[str, str], places: Mapping[str, str]) -> Markup:
    """Checks as traffic lights, with a word per state; `places` maps names of checks to sections with more details."""
    return _parts().lights(
        [(check, COLOURS[check.state], words.get(check.state, check.state)) for check in checks], places
    )


def lines(checks: Iterable[Check]) -> Markup:
    """Checks in one line each."""
    return _parts().lines(list(checks))


def table(caption: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> Markup:
    """A table; cells are text, or results of `number`, `percent` and `probability`."""
    return _parts().table(caption, headings, list(rows))


def items(texts: Sequence[str]) -> Markup:
    """A list."""
    return _parts().items(texts)


def columns(lists: Sequence[tuple[str, Sequence[str]]], nothing: str) -> Markup:
    """Lists side by side, each with its heading; an empty one shows `nothing`."""
    return _parts().columns(lists, nothing)


def fold(title: str, *parts: Markup) -> Markup:
    """Parts that open on a click."""
    return Markup("<details><summary>{}</summary>{}</details>").format(title, Markup("\n").join(parts))


def figures(pictures: Sequence[Picture], linked: bool = False) -> Markup:
    """Figures; if `linked`, with a common range of their x axes."""
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
    """A whole page in one file, in light and dark colours, for screen and print; text is escaped.

    The status is a CSS class and a few words; the lead gives it in sentences, or as `lines`; `about` is a list of names
    and values.
    """
    styles = {"style": _read("uPlot.min.css") + _read("style.css"), "script": _script(), "version": version("bayesid")}
    content = {"title": title, "subject": subject, "status": status, "lead": lead, "about": about}
    return fragment("page.html.jinja", **content, warnings=warnings, sections=sections, **styles)


def fragment(template: str, **content: Any) -> str:
    """A filled template; text is escaped."""
    return _environment().get_template(template).render(**content)


@cache
def _parts() -> Any:
    return _environment().get_template("parts.html.jinja").module


def _read(file: str) -> Markup:
    return Markup(resources.files(_ROOM).joinpath(file).read_text(encoding="utf-8"))


@cache
def _script() -> Markup:
    """Scripts of a page: uPlot with its licence, at twice the screen's resolution for print, and figures.js."""
    code = _read("uPlot.iife.min.js").partition("\n")[2]  # without the comment with its URL
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
    """Input of `figures.js`: x to a hundred-thousandth of the axis, y to a ten-thousandth; NaN is null."""
    x_ends, y_ends = panel.limits
    x_digits, y_digits = _digits(x_ends, 5), _digits(y_ends, 4)
    xs: dict[bytes, list[float | None]] = {}  # x of curves; equal ones are stored once

    def across(x: Array) -> int:
        key = np.asarray(x).tobytes()
        xs.setdefault(key, _rounded(x, x_digits))
        return list(xs).index(key)

    def plain(mark: Mark) -> dict[str, Any]:
        named = {item.name: getattr(mark, item.name) for item in fields(mark)}
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
        "marks": [plain(mark) for mark in panel.marks],
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
    """Decimals that resolve at least 10^`figures` steps of an axis."""
    return figures - math.floor(math.log10(ends[1] - ends[0]))


def _rounded(values: ArrayLike, digits: int) -> list[float | None]:
    array = np.round(np.asarray(values, dtype=float), digits)
    return [value if math.isfinite(value) else None for value in array.tolist()]


def typeset(text: str) -> Markup:
    """Escaped text with typographic signs."""
    text = str(escape(text)).replace(" +- ", "&nbsp;&plusmn;&nbsp;").replace("^2", "&sup2;").replace("^3", "&sup3;")
    text = text.replace(" -&gt; ", "&nbsp;&rarr;&nbsp;").replace("&lt;=", "&le;").replace("&gt;=", "&ge;")
    text = re.sub(r"\b(N|kg) (m|s)\b", r"\1&nbsp;\2", text)
    text = re.sub(r"(\d) ?%", r"\1&nbsp;%", text)
    return Markup(re.sub(r"(?<![\w)])-(?=\d)", "&minus;", text))


def code(text: str) -> Markup:
    """Typeset, with commands between backquotes as code."""
    parts = enumerate(text.split("`"))
    return Markup("").join(Markup("<code>{}</code>").format(part) if k % 2 else typeset(part) for k, part in parts)


def cell(text: str) -> Markup:
    """Typeset text; Markup is unchanged, an empty text is a dash."""
    return text if isinstance(text, Markup) else typeset(text) if text else NONE


def data(value: float, text: str) -> Markup:
    """A rounded number as text, with the exact one as the element's value."""
    return Markup('<data value="{}">{}</data>').format(repr(float(value)), typeset(text.rstrip()))


def number(value: float, unit: str = "") -> Markup:
    """A number to three digits, with the exact one as the element's value."""
    if np.isnan(value):
        return NONE
    return data(value, f"unlimited {unit}" if np.isposinf(value) else f"{rounded(float(value))} {unit}")


def probability(value: float) -> Markup:
    """To a thousandth."""
    return data(value, f"{value:.3f}")


def share(value: float) -> Markup:
    """In percent, to a tenth."""
    return NONE if np.isnan(value) else data(value, percent(value, 1))
