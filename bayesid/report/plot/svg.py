"""Lines, areas and text as SVG, lengths in points."""

from __future__ import annotations

from html import escape

import numpy as np

from bayesid.arrays import Array
from bayesid.report.plot.ink import INK

_DASHES = {"solid": (), "--": (3.7, 1.6), "dotted": (1.0, 1.65)}
"""Drawn and free, in widths of the line."""


def stroked(colour: str, width: float, alpha: float = 1.0, style: str = "solid") -> str:
    """Attributes of a line; its width in points."""
    dashes = " ".join(f"{width * part:g}" for part in _DASHES[style])
    look = f'fill="none" stroke="{colour}" stroke-width="{width:g}"'
    return look + f' stroke-opacity="{alpha:g}"' * (alpha < 1.0) + f' stroke-dasharray="{dashes}"' * bool(dashes)


def filled(colour: str, alpha: float = 1.0) -> str:
    """Attributes of an area."""
    return f'fill="{colour}"' + f' fill-opacity="{alpha:.3g}"' * (alpha < 1.0)


def ruled(lines: str, ticks: str) -> str:
    """The paths of a grid's lines and of ticks."""
    drawn = f'<path d="{lines}" {stroked(INK, 0.6, 0.2)}/>' if lines else ""
    return drawn + (f'<path d="{ticks}" {stroked(INK, 0.8)}/>' if ticks else "")


def line(points: Array) -> str:
    """A line through (N, 2) points, interrupted where one is not finite."""
    holes = np.flatnonzero(~np.isfinite(points).all(axis=1))
    pieces = [piece[np.isfinite(piece).all(axis=1)] for piece in np.split(points, holes)] if len(holes) else [points]
    return "".join("M" + ("L%.2f %.2f" * len(one) % tuple(one.ravel().tolist()))[1:] for one in pieces if len(one))


def circle(x: float, y: float, radius: float) -> str:
    """A path around a disc."""
    half = f"a{radius:.2f} {radius:.2f} 0 0 0"
    return f"M{x - radius:.2f} {y:.2f}{half} {2.0 * radius:.2f} 0{half} {-2.0 * radius:.2f} 0z"


def discs(points: Array, radius: float, colour: str) -> str:
    """Discs at (N, 2) points."""
    return f'<path d="{"".join(circle(x, y, radius) for x, y in points.tolist())}" {filled(colour)}/>'


def words(
    x: float,
    y: float,
    text: str,
    size: float,
    anchor: str = "middle",
    *,
    turned: bool = False,
    colour: str = INK,
    weight: str = "normal",
) -> str:
    """A line of text whose letters stand at y; turned, it reads from below."""
    look = f'font-size="{size:g}" text-anchor="{anchor}" fill="{colour}"' + ' font-weight="bold"' * (weight == "bold")
    place = f'transform="translate({x:.2f} {y:.2f}) rotate(-90)"' if turned else f'x="{x:.2f}" y="{y:.2f}"'
    return f"<text {place} {look}>{escape(text)}</text>"
