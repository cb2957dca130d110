"""A figure as a part of a page: text in the page's font and colour, nothing but what is in it."""

from __future__ import annotations

import io
import re
from html import escape

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from bayesid.process import ALONE
from bayesid.report.plot.layout import lay_out
from bayesid.report.plot.style import INK

_DPI = 130
"""Of what is an image inside of a figure: sharp on a screen, and small."""
_POINTS = 72
"""An inch; what a figure's lengths are in."""


def inline_svg(figure: Figure, name: str, alt: str) -> str:
    """A figure as an element of a page: text in the page's font and colour, nothing but what is in it.

    Args:
        figure: of this package.
        name: begins its identifiers, so that those of several figures do not clash.
        alt: what it shows, for those who do not see it.
    """
    text = io.StringIO()
    with ALONE, mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "bayesid"}):
        _lay_out(figure)
        figure.savefig(text, format="svg", dpi=_DPI, transparent=True)
    svg = text.getvalue()[text.getvalue().index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", svg, flags=re.DOTALL)
    head, body = svg.split(">", 1)
    box = re.search(r'viewBox="[^"]*"', head)
    body = re.sub(r'\bid="', f'id="{name}-', body)
    body = re.sub(r'(url\(|href=")#', rf"\g<1>#{name}-", body).replace("xlink:href", "href")
    body = re.sub(r"font-family: [^;\"]*;? ?", "", body).replace(INK, "currentColor")
    body = re.sub(r' d="([^"]*)"', lambda match: f' d="{_shortened(match[1])}"', body)
    return f'<svg role="img" aria-label="{escape(alt)}" {box[0] if box else ""}>{body.strip()}'


def _lay_out(figure: Figure) -> None:
    """Places the axes once and for all; `savefig` would draw everything twice to do so."""
    engine = figure.get_layout_engine()
    if engine is not None:
        FigureCanvasSVG(figure)  # whose letters are measured as they will be drawn
        figure.dpi = _POINTS
        if not lay_out(figure):
            engine.execute(figure)
        with mpl.rc_context({"figure.autolayout": False, "figure.constrained_layout.use": False}):
            figure.set_layout_engine(None)


def _shortened(path: str) -> str:
    """The path to a hundredth of a point."""
    return re.sub(r"-?\d+\.\d+", lambda match: f"{float(match[0]):.2f}".rstrip("0").rstrip("."), " ".join(path.split()))
