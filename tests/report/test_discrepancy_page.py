"""The page of a discrepancy and its figures, for made-up results."""

import numpy as np
import pytest
from html_page import Page
from made_discrepancy import COULOMB, NOISE, NOTHING, PREDICTED_AFTER, PREDICTED_BEFORE, TRIAL, found, friction, make
from test_discrepancy_verdicts import BODY, DRIFT, OWN, partly_explained

from bayesid.effects.bodies import Payload
from bayesid.effects.friction import CoulombFriction
from bayesid.report.brief import in_brief
from bayesid.report.discrepancy import discrepancy_checks
from bayesid.report.pages.discrepancy_page import discrepancy_page
from bayesid.report.pages.rendering import typeset
from bayesid.report.plot.discrepancy import residual_figure
from bayesid.report.plot.drawing import draw
from bayesid.report.report_data import binned


def page_of(result):
    text = discrepancy_page(result)
    return Page(text), text


def rows_of(page, caption):
    """Without the heading."""
    return page.table(caption)[1:]


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"status": "partly_explained", "unexplained": ((3, 1.5),)},
        {"status": "unexplained", "unexplained": ((2, 5.24),), "added": ()},
        {"status": "no_discrepancy", **NOTHING, "scores": ()},
    ],
    ids=lambda changes: changes.get("status", "explained"),
)
def test_the_page_is_whole_and_needs_nothing_else(changes):
    result = make(**changes)
    page, text = page_of(result)
    page.whole(text, scripts=1)
    assert len(page.labels) == page.tags.count("figure")
    assert len(text.encode()) < 1_000_000
    assert text == discrepancy_page(result)
    top = text.partition("<nav")[0]
    assert all(typeset(one.message) in top for one in in_brief(result))
    assert all(typeset(check.message) in text for check in discrepancy_checks(result))


def test_the_page_holds_the_numbers_of_the_result():
    result = make(unexplained=((3, 1.7),))
    page, text = page_of(result)
    gap = rows_of(page, "Gap on later")
    for j, row in enumerate(gap):
        ratio, white = result.after[j] / result.floor.rms[j], result.floor.white[j]
        assert row[1:6] == [[result.before[j]], [result.after[j]], [result.floor.rms[j]], [white], [ratio]]
    assert gap[2][7] == [1.7]
    assert "lower bound" in text
    (verdict,) = rows_of(page, "Effects that were added")
    assert verdict[2:7] == [[COULOMB], [pytest.approx(40.0)], [0.99], [0.004], [0.006]]
    (where,) = rows_of(page, "Joints in which")
    assert where[1] == [1.87]
    assert where[3] == [-1.25, 0.75]
    assert [row[3] for row in rows_of(page, "The best 3 of 3")] == [
        [pytest.approx(gain)] for gain in (40.25, 1.5, -0.75)
    ]


def test_without_an_added_effect_the_model_is_refitted():
    for result, name in ((make(), "extended"), (make(added=(), unexplained=((2, 5.2),)), "refitted")):
        text = discrepancy_page(result).lower()
        assert {kind for kind in ("extended", "refitted") if f"{kind} model" in text} == {name}


def test_the_table_of_effects_has_bodies_changes_and_what_is_unknown():
    page, text = page_of(partly_explained())
    assert [row[2] for row in rows_of(page, "Effects that were added")] == [
        [value for value, _, _ in BODY.values()],
        [7.3],
    ]
    assert "9.1&nbsp;&rarr;&nbsp;7.3&nbsp;&plusmn;&nbsp;0.5 N&nbsp;m" in text
    assert "mp3" not in text
    total = {"Fc2": (7.3, 0.5, "N m"), "change of Fc2": (-1.8, 0.5, "N m")}
    page, _ = page_of(make(added=(found(DRIFT, OWN | total),)))
    assert sorted(page.table("Effects that were added")[1][2]) == [0.8, 7.3, 300.0]
    unknown = found(friction(), {"Fc2": (np.nan, np.nan, "N m")}, equivalent=["torque_offset"])
    page, text = page_of(make(added=(unknown, found(Payload()))))
    assert "unknown N&nbsp;m" in text
    assert CoulombFriction.shown_by in text
    assert page.table("Effects that were added")[2][2] == []


def test_text_from_outside_is_escaped():
    page, text = page_of(make())
    for raw, escaped in (
        ("later <b>.csv", "later &lt;b&gt;.csv"),
        ('log "1" & <2>.csv', "log &#34;1&#34; &amp; &lt;2&gt;.csv"),
        ("arm <A&B>", "arm &lt;A&amp;B&gt;"),
        ("<script>alert(1)</script>", "&lt;script&gt;alert(1)&lt;/script&gt;"),
    ):
        assert raw not in text
        assert escaped in text
    assert "b" not in page.tags


def test_residuals_are_drawn_over_the_variable_that_shows_them():
    result = make()
    axes = draw(residual_figure(result, 2))
    used = TRIAL.used[:, 1]
    speed = TRIAL.actuators.dq[used, 1]
    for ax, predicted in zip(axes, (PREDICTED_BEFORE, PREDICTED_AFTER), strict=True):
        floor, dots = ax.collections[:2]
        points = np.asarray(dots.get_offsets())
        assert len(points) == 1500
        assert dots.get_rasterized()
        residual = (TRIAL.nearest(predicted) - predicted)[used, 1]
        order = np.argsort(speed)
        place = order[np.searchsorted(speed[order], points[:, 0])]
        np.testing.assert_allclose(residual[place], points[:, 1], rtol=1e-12)
        np.testing.assert_allclose(ax.lines[0].get_xydata(), np.stack(binned(speed, residual)[:2], axis=1))
        height = floor.get_paths()[0].vertices[:, 1]
        np.testing.assert_allclose([height.min(), height.max()], [-0.30, 0.30], rtol=1e-9)
    means = [ax.lines[0].get_ydata() for ax in axes]
    assert means[0].max() > 0.8 * COULOMB
    assert means[0].min() < -0.8 * COULOMB
    assert np.abs(means[1]).max() < 0.5 * NOISE
