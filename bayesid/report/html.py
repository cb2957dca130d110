"""What pages are made of: a whole page, its sections, tables, figures and numbers, in HTML."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib.metadata import version

import numpy as np

from bayesid.report.page_style import STYLE
from bayesid.report.words import rounded

NONE = '<span class="none">&ndash;</span>'


def page(title: str, subject: str, head: Sequence[str], sections: Sequence[str], script: str = "") -> str:
    """A whole page that opens from anywhere, light or dark, and prints; nothing is fetched.

    Args:
        title: its heading, text.
        subject: what it is about, for the window's title, text.
        head: what stands below the heading, HTML.
        sections: HTML.
        script: what makes it more comfortable; without it the page tells the same.
    """
    return "\n".join([
        "<!DOCTYPE html>",
        '<html lang="en">',
        "<head>",
        '<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<meta name="color-scheme" content="light dark">',
        f"<title>{escape(title)}: {escape(subject)}</title>",
        f"<style>{STYLE}</style>",
        "</head>",
        "<body>",
        "<main>",
        "<header>",
        f"<h1>{escape(title)}</h1>",
        *head,
        "</header>",
        *sections,
        f"<footer><p>bayesid {escape(version('bayesid'))}. Joints count from 1. Numbers after &plusmn; are standard "
        "deviations.</p></footer>",
        "</main>",
        *([f"<script>{script}</script>"] if script else []),
        "</body>",
        "</html>",
        "",
    ])  # fmt: skip


def typeset(text: str) -> str:
    """Escaped, with the signs that plain text lacks."""
    text = escape(text).replace(" +- ", "&nbsp;&plusmn;&nbsp;").replace("^2", "&sup2;").replace("^3", "&sup3;")
    text = re.sub(r"\b(N|kg) (m|s)\b", r"\1&nbsp;\2", text)
    text = re.sub(r"(\d) ?%", r"\1&nbsp;%", text)
    return re.sub(r"(?<![\w)])-(?=\d)", "&minus;", text)


def section(name: str, title: str, content: str) -> str:
    """A part of the page; the content is HTML."""
    head = f'<h2 id="{name}-title">{escape(title)}</h2>'
    return f'<section id="{name}" aria-labelledby="{name}-title">{head}{content}</section>'


def table(told: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Cells are HTML, everything else is text; the first column heads its row."""
    head = "".join(f'<th scope="col">{escape(heading)}</th>' for heading in headings)
    body = "".join(
        f'<tr><th scope="row">{first}</th>' + "".join(f"<td>{cell}</td>" for cell in others) + "</tr>"
        for first, *others in rows
    )
    name = escape(", ".join(headings))
    return (
        f'<div class="table" role="region" tabindex="0" aria-label="{name}"><table><caption>{escape(told)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def figure(svg: str, told: str) -> str:
    """An image, HTML, and what it shows, text."""
    return f"<figure>{svg}<figcaption>{escape(told)}</figcaption></figure>"


def figures(pictures: Iterable[str]) -> str:
    """Figures side by side where there is room."""
    return '<div class="figures">' + "".join(pictures) + "</div>"


def number(value: float, unit: str = "") -> str:
    """For people to three digits, for machines exactly."""
    if np.isnan(value):
        return NONE
    return data(value, f"unlimited {unit}" if np.isposinf(value) else f"{rounded(float(value))} {unit}")


def probability(value: float) -> str:
    """To a thousandth."""
    return data(value, f"{value:.3f}")


def data(value: float, told: str) -> str:
    """A number as people read it, and exactly for machines."""
    return f'<data value="{float(value)!r}">{typeset(told.rstrip())}</data>'


def about(told: Iterable[tuple[str, str]]) -> str:
    """What the page is about: names and values, text."""
    rows = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in told)
    return f'<dl class="about">{rows}</dl>'


def warnings(told: Sequence[str]) -> str:
    """What the user should know first; nothing if there is nothing."""
    if not told:
        return ""
    items = "".join(f"<li>{escape(warning)}</li>" for warning in told)
    return f'<aside class="warnings" aria-label="Warnings"><h2>Warnings</h2><ul>{items}</ul></aside>'
