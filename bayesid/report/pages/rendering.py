"""What pages are made of: jinja2's templates, the style and script beside them, and numbers as people read them."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from functools import cache
from importlib import resources
from importlib.metadata import version
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from bayesid.report.words import rounded

_ROOM = "bayesid.report.pages"
NONE = Markup('<span class="none">&ndash;</span>')


@dataclass(frozen=True)
class Picture:
    """A figure on a page: what is drawn, HTML, and what it shows, text."""

    svg: Markup
    caption: str


def picture(figure: Any, name: str, caption: str, alt: str = "") -> Picture:
    """A figure of this package on a page.

    Args:
        figure: a `bayesid.report.plot.paper.Paper`.
        name: begins its identifiers.
        caption: below it.
        alt: for those who do not see it; the caption by default.
    """
    return Picture(Markup(figure.svg(name, alt or caption)), caption)


def render(template: str, title: str, subject: str, script: str = "", **content: Any) -> str:
    """A whole page that opens from anywhere, light or dark, and prints; nothing is fetched.

    Args:
        template: its file.
        title: its heading.
        subject: what it is about, robot and log, for the window's title.
        script: file of what makes it more comfortable; without it the page says the same.
        content: what the template needs; text is escaped.
    """
    page = {"title": title, "subject": subject, "version": version("bayesid"), "style": _read("style.css")}
    script = _read(script) if script else ""
    return _environment().get_template(template).render(**page, script=script, **content)


def fragment(template: str, **content: Any) -> str:
    """A part of somebody else's page, of a template and what it needs; text is escaped."""
    return _environment().get_template(template).render(**content)


def _read(file: str) -> Markup:
    return Markup(resources.files(_ROOM).joinpath(file).read_text(encoding="utf-8"))


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
    filters = (typeset, code, data, number, probability, percent)
    environment.filters |= {function.__name__: function for function in filters} | {"json": json.dumps}
    environment.globals["NONE"] = NONE
    return environment


# ---------------------------------------------------------------------------------------------------------------
# Text and numbers
# ---------------------------------------------------------------------------------------------------------------
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


def percent(share: float) -> Markup:
    """To a tenth of a percent."""
    return data(share, f"{share:.1%}")
