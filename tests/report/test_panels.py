"""Figures of pages: what matplotlib would draw stands where it would stand, and nothing is cut off."""

import re
from itertools import combinations, product
from xml.etree import ElementTree

import numpy as np
import pytest
from made_findings import make_findings, with_alternatives
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from bayesid.report import plot
from bayesid.report.plot.axis import Axis, number_texts, round_numbers
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
ENDS = [(0.0, 1.0), (-3.7, 12.9), (-68.2, 71.3), (1990.0, 2010.5), (-0.11, 0.104), (3e-7, 5.1e-6), (0.0, 3e6)]


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


# --- Axes ------------------------------------------------------------------------------------------------------------
def test_round_numbers_are_those_of_matplotlib():
    for (low, high), room in product(ENDS, (1, 2, 4, 7, 9)):
        theirs = MaxNLocator(room, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high)
        slack = 1e-9 * (high - low)
        inside = theirs[(theirs >= low - slack) & (theirs <= high + slack)]
        np.testing.assert_allclose(round_numbers(low, high, room), inside, atol=slack)


def test_numbers_are_written_as_matplotlib_writes_them():
    for low, high in ENDS:
        places = round_numbers(low, high, 6)
        theirs = ScalarFormatter(useOffset=False)
        theirs.set_powerlimits((-4, 5))
        theirs.create_dummy_axis()
        theirs.axis.set_view_interval(low, high)
        texts, power = number_texts(places)
        value = [float(f"{text}{power[1:]}".replace("\N{MINUS SIGN}", "-")) for text in texts]
        np.testing.assert_allclose(value, places, rtol=1e-9, atol=1e-12 * (high - low))
        if not power:
            assert texts == theirs.format_ticks(places.tolist())
    assert number_texts(np.array([0.25, 0.5, 0.75]))[0] == ["0.25", "0.50", "0.75"]
    assert number_texts(np.array([-2.0, 0.0, 2.0])) == (["\N{MINUS SIGN}2", "0", "2"], "")
    assert number_texts(np.array([2e-6, 4e-6])) == (["2", "4"], "1e\N{MINUS SIGN}6")


def test_an_axis_without_data_or_with_one_value_has_ends():
    axis = Axis()
    assert axis.ends[0] < axis.ends[1]
    axis.take([7.0, np.nan, np.inf])
    assert axis.ends[0] < 7.0 < axis.ends[1]
    axis.take([3.0])
    assert axis.ends == pytest.approx((2.8, 7.2))
    axis.limit(5.0, 5.0)
    assert axis.ends[0] < 5.0 < axis.ends[1]
    axis.limit(2.8, 7.2)
    axis.inverted = True
    assert axis.share([7.2, 2.8]) == pytest.approx([0.0, 1.0])


# --- Where panels stand ----------------------------------------------------------------------------------------------
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


# --- What is drawn ---------------------------------------------------------------------------------------------------
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


def test_bars_begin_at_zero_and_bands_reach_from_end_to_end():
    panel = Paper(2.0).subplots()
    panel.barh(np.array([0.0, 1.0]), np.array([2.0, 5.0]), height=0.5, color=[BLUE, ORANGE])
    panel.axvspan(1.0, 3.0, color="#000000", alpha=0.2)
    shapes = {one.get("fill"): numbers(one.get("d")) for one in drawn(panel.figure) if one.tag == "path"}
    left, top, width, height = panel.box
    for colour, length in ((BLUE, 2.0), (ORANGE, 5.0)):
        across = shapes[colour][::2]
        np.testing.assert_allclose([across.min(), across.max()], [left, left + width * length / 5.25], atol=0.01)
    band = shapes["#000000"]
    np.testing.assert_allclose(
        [band[::2].min(), band[::2].max(), band[1::2].min(), band[1::2].max()],
        [left + width / 5.25, left + 3.0 * width / 5.25, top, top + height],
        atol=0.01,
    )


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_holds_what_it_refers_to_and_takes_the_ink_of_its_page(name):
    figure = both(name)[1][0].figure
    svg = figure.svg("name", 'a "figure" <1>')
    assert svg == figure.svg("name", 'a "figure" <1>')
    assert svg.startswith('<svg role="img" aria-label="a &quot;figure&quot; &lt;1&gt;" viewBox="0 0 ')
    assert not re.search(r"#767676|font-family|<style|http|nan|inf\b", svg)
    identifiers = [one.get("id") for one in ElementTree.fromstring(svg).iter() if one.get("id")]
    assert len(set(identifiers)) == len(identifiers)
    assert set(re.findall(r"url\(#([^)]*)", svg)) <= set(identifiers)
    words = {one.text for one in drawn(figure) if one.tag == "text"}
    for ax in both(name)[0]:
        assert {text for text in (ax.get_xlabel(), ax.get_ylabel(), ax.get_title()) if text} <= words


def test_signs_stand_above_their_bands_unless_they_are_out_of_sight():
    (panel,) = FIGURES["one"](Paper)
    whole = {one.get("id"): one[0] for one in drawn(panel.figure) if "-glyph-" in one.get("id", "")}
    table = FOUND.segments
    for k in np.flatnonzero(table.joint == 0):
        glyph = whole[f"name-glyph-{k}"]
        assert glyph.text[0] == ("+" if table.sign[k] > 0 else "\N{MINUS SIGN}")
        assert float(glyph.get("y")) < panel.box[1]
        middle = panel.at(0.5 * (table.start[k] + table.end[k]), 0.0)[0, 0]
        assert float(glyph.get("x")) == pytest.approx(middle, abs=0.006)
    t = FOUND.samples.t
    panel.set_xlim(t[0], t[0] + 0.2 * (t[-1] - t[0]))
    assert 0 < sum("-glyph-" in one.get("id", "") for one in drawn(panel.figure)) < len(whole)


def test_panels_that_share_axes_have_the_same_ends_and_numbers_once():
    first, second = Paper(2.0).subplots(1, 2, sharex=True, sharey=True)
    first.plot(np.array([0.0, 1.0]), np.array([0.0, 1.0]), color=BLUE)
    second.plot(np.array([0.0, 9.0]), np.array([0.0, 4.0]), color=BLUE)
    first.figure.svg("name", "alt")
    assert first.get_xlim() == second.get_xlim() == pytest.approx((-0.45, 9.45))
    assert second.surround(100.0, 100.0)[0] < first.surround(100.0, 100.0)[0]


def test_figures_of_nothing_are_well_formed():
    panel, nothing = Paper(2.0).subplots(), np.empty(0)
    panel.plot(nothing, nothing, color=BLUE)
    panel.scatter(nothing, nothing, s=4.0, color=BLUE)
    panel.errorbar(nothing, nothing, yerr=nothing, color=BLUE, linewidth=1.0, markersize=3.0, capsize=2.0)
    panel.hlines(nothing, nothing, nothing, colors=BLUE, linewidth=1.0)
    panel.barh(nothing, nothing, height=0.5, color=BLUE)
    panel.broken_barh([], (0.0, 1.0), zorder=0.0, facecolors=[])
    assert drawn(panel.figure)
