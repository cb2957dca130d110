"""Figures of pages: what matplotlib would draw stands where it would stand, and nothing is cut off."""

import re
from itertools import combinations
from xml.etree import ElementTree

import numpy as np
import pytest
from made_findings import make_findings, with_alternatives
from matplotlib.backends.backend_svg import FigureCanvasSVG

from bayesid.report import plot
from bayesid.report.plot.ink import BLUE, ORANGE
from bayesid.report.plot.paper import Paper

FOUND = with_alternatives(make_findings(n=3, validated=True))
FIGURES = {
    "one": lambda axes: plot.torques(FOUND, [1], axes=axes),
    "validation": lambda axes: plot.validation(FOUND, [2], axes=axes),
    "joints": lambda axes: plot.residuals(FOUND, "velocity", axes=axes),
    "memory": lambda axes: plot.autocorrelation(FOUND, axes=axes),
    "trace": lambda axes: plot.trace(FOUND, 3, axes=axes),
    "pair": lambda axes: plot.pair(FOUND, 3, axes=axes),
    "rank": lambda axes: plot.rank(FOUND, 3, axes=axes),
    "forest": lambda axes: plot.forest(FOUND, ax=axes),
    "legend": lambda axes: plot.alternatives(FOUND, ax=axes),
}


def both(name):
    """matplotlib's Axes, laid out by it, and the panels."""
    theirs, ours = (np.atleast_1d(np.array(FIGURES[name](axes), dtype=object)) for axes in (None, Paper))
    figure = theirs[0].figure
    FigureCanvasSVG(figure)
    figure.dpi = 72
    figure.get_layout_engine().execute(figure)
    ours[0].figure.svg("name", "alt")
    return theirs, ours


def drawn(figure, name="name"):
    """The elements of a figure, which is well-formed."""
    return list(ElementTree.fromstring(figure.svg(name, "what it shows")).iter())


def numbers(path):
    return np.array([float(one) for one in re.findall(r"-?\d+\.?\d*", path)])


def size_of(figure):
    """Width and height of its SVG, points."""
    return numbers(re.search(r'viewBox="0 0 ([\d. ]+)"', figure.svg("name", "alt"))[1])


@pytest.mark.parametrize("name", FIGURES)
def test_panels_stand_and_end_about_where_matplotlib_puts_axes(name):
    theirs, ours = both(name)
    width, height = 72 * theirs[0].figure.get_size_inches()
    for ax, panel in zip(theirs, ours, strict=True):
        left, top, across, down = panel.box
        box = left / width, 1.0 - (top + down) / height, (left + across) / width, 1.0 - top / height
        np.testing.assert_allclose(box, ax.get_position().extents, atol=0.05)
        corners = panel.at(ax.get_xlim(), ax.get_ylim())
        np.testing.assert_allclose(corners, [[left, top + down], [left + across, top]], atol=0.02 * max(across, down))


@pytest.mark.parametrize("name", FIGURES)
def test_panels_with_all_that_belongs_to_them_are_apart_and_on_the_paper(name):
    """Letters of names at the y axis stand upright on a line at least their own size from the edge."""
    _, panels = both(name)
    width, height = size_of(panels[0].figure)
    boxes = []
    for panel in panels:
        left, top, across, down = panel.box
        before, after, below, above = panel.surround(across, down)
        boxes.append(np.array([left - before, top - above, left + across + after, top + down + below]))
    assert all((box >= 0.0).all() and box[2] <= width and box[3] <= height for box in boxes)
    for a, b in combinations(boxes, 2):
        assert np.maximum(a[:2] - b[2:], b[:2] - a[2:]).max() > 0.0
    for one in (one for one in drawn(panels[0].figure) if one.tag == "text"):
        turned = one.get("transform")
        x, y = numbers(turned)[:2] if turned else (float(one.get("x")), float(one.get("y")))
        assert (0.75 * float(one.get("font-size")) if turned else 0.0) <= x <= width
        assert 0.75 * float(one.get("font-size")) <= y <= height


def test_a_curve_goes_through_its_points():
    panel = Paper(2.0, 4.0).subplots()
    x, y = np.array([0.0, 1.0, 4.0]), np.array([-2.0, 6.0, 1.0])
    panel.plot(x, y, color=BLUE, linewidth=1.5, linestyle="dotted")[0].set_gid("x-curve")
    (group,) = [one for one in drawn(panel.figure) if one.get("id") == "name-x-curve"]
    (path,) = group
    points = numbers(path.get("d")).reshape(-1, 2)
    left, top, width, height = panel.box
    np.testing.assert_allclose(points[:, 0], left + width * (x + 0.2) / 4.4, atol=0.006)
    np.testing.assert_allclose(points[:, 1], top + height * (6.4 - y) / 8.8, atol=0.006)
    assert (path.get("stroke"), path.get("stroke-width"), path.get("fill")) == (BLUE, "1.5", "none")
    assert len(path.get("stroke-dasharray").split()) == 2
    broken = Paper(2.0).subplots()
    broken.plot(np.arange(6.0), np.array([0.0, 1.0, np.nan, 2.0, 3.0, np.inf]), color=ORANGE)
    (path,) = [one.get("d") for one in drawn(broken.figure) if one.get("stroke") == ORANGE]
    assert (path.count("M"), path.count("L")) == (2, 2), "interrupted where nothing is known"


def test_names_stand_at_the_x_axis_and_an_axis_of_one_value_has_room():
    panel = Paper(2.0).subplots()
    panel.set_xlim(3.0, 3.0)
    panel.set_xticks([3.0], ["the third"])
    look = {"fontsize": 7.0, "color": BLUE}
    for x, text in ((3.0, "within"), (9.0, "beyond")):
        panel.annotate(text, (x, 0.98), (3.0, 0.0), panel.get_xaxis_transform(), "offset points", **look)
    left, right = panel.get_xlim()
    assert left < 3.0 < right
    said = [one.text for one in drawn(panel.figure) if one.tag == "text"]
    assert {"the third", "within"} <= set(said)
    assert "beyond" not in said
