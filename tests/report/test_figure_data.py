"""Figures as data: limits, what a page is told of them, and that it equals what was found."""

import numpy as np
import pytest
from html_page import Page
from made_findings import make_findings

from bayesid.report.pages.identification_page import identification_page
from bayesid.report.pages.rendering import picture
from bayesid.report.plot.figure import BLUE, INK, Boxes, Dots, Figure, Line, Panel, level, rows_of, with_common_limits

FOUND = make_findings(n=2, validated=True)
X = np.array([0.0, 1.0, 4.0])


def told(panel):
    """Of a panel alone in a figure, what a page is told."""
    return picture(Figure([[panel]], 2.0), "name", "caption").data["panels"][0][0]


def test_limits_have_a_margin_but_not_below_bars():
    line = Line(X, np.array([-2.0, np.nan, 6.0]), BLUE)
    assert Panel([line]).limits == (pytest.approx((-0.2, 4.2)), pytest.approx((-2.4, 6.4)))
    assert Panel([line], y_limits=(0.0, 1.0)).limits[1] == (0.0, 1.0)
    bars = Boxes((np.zeros(2), np.array([3.0, 5.0])), (np.array([-0.3, 0.7]), np.array([0.3, 1.3])), BLUE)
    assert Panel([bars]).limits[0] == pytest.approx((0.0, 5.25))
    assert Panel([level(3.0), Boxes(([1.0], [2.0]), None, INK)]).limits[1][0] < 3.0, "one value has room around it"
    assert Panel([]).limits == ((0.0, 1.0), (0.0, 1.0))
    common = with_common_limits([Panel([line]), Panel([Dots([9.0], [0.0], BLUE)])])
    assert common[0].limits == common[1].limits
    assert rows_of([*common, common[0]], 2)[1] == [common[0], None]


def test_a_page_is_told_curves_once_rounded_and_interrupted():
    y = np.array([1.23456789, np.nan, -8.7654321])
    panel = told(Panel([Line(X, y, BLUE, "one"), Line(X.copy(), 2.0 * y, INK, "two", style="dotted")]))
    assert panel["xs"] == [[0.0, 1.0, 4.0]]
    assert [mark["x"] for mark in panel["marks"]] == [0, 0]
    first = panel["marks"][0]["y"]
    assert first[1] is None
    np.testing.assert_allclose([first[0], first[2]], [y[0], y[2]], atol=1e-3)
    assert len(told(Panel([Dots(np.arange(9999.0), np.arange(9999.0), BLUE)]))["marks"][0]["x"]) == 1500


def test_the_page_holds_the_efforts_and_the_segments_that_were_found():
    page = Page(identification_page(FOUND))
    efforts = [one["panels"][0][0] for one in page.figures if one["panels"][0][0]["y"]["name"].startswith("joint")]
    samples, table = FOUND.samples, FOUND.segments
    for j, panel in enumerate(efforts[: FOUND.n_joints]):
        marks = {mark["label"]: mark for mark in panel["marks"]}
        for label, values in (("with signs", samples.signed), ("model", samples.predicted)):
            np.testing.assert_allclose(panel["xs"][marks[label]["x"]], samples.t, atol=1e-4)
            np.testing.assert_allclose(marks[label]["y"], values[:, j], atol=2e-3)
        plus = (table.joint == j) & (table.sign > 0)
        np.testing.assert_allclose(marks["sign +"]["x"], [table.start[plus], table.end[plus]], atol=1e-4)
        assert marks["sign +"]["letters"] == ["+?" if one else "+" for one in table.ambiguous[plus]]
        assert panel["x"]["ends"] == [samples.t[0], samples.t[-1]]
