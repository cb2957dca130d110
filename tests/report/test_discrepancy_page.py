"""The page of a discrepancy and its figures, of results made by hand."""

import re
from dataclasses import replace

import numpy as np
import pytest
from html_page import Page
from made_discrepancy import (
    COULOMB,
    FRICTION,
    NOISE,
    NOTHING,
    PREDICTED_AFTER,
    PREDICTED_BEFORE,
    TRIAL,
    floor_of,
    found,
    friction,
    made_of,
    make,
    score,
)
from matplotlib.colors import to_hex
from rich.console import Console
from test_discrepancy_verdicts import BODY, DRIFT, OWN, WORTH, partly_explained

from bayesid.cli.discrepancy_tables import discrepancy_parts
from bayesid.model.terms.hysteresis import Hysteresis
from bayesid.model.terms.payload import Payload
from bayesid.model.terms.torque_offset import TorqueOffset
from bayesid.report.discrepancy_verdicts import discrepancy_checks, lead
from bayesid.report.pages.discrepancy_page import discrepancy_page
from bayesid.report.pages.rendering import typeset
from bayesid.report.plot.discrepancy import (
    AFTER,
    BEFORE,
    INK,
    candidate_figure,
    effort_figure,
    gap_figure,
    residual_figure,
)
from bayesid.report.thinning import binned
from bayesid.report.words import rounded
from bayesid.results.discrepancy_json import discrepancy_summary


def page_of(result):
    text = discrepancy_page(result)
    return Page(text), text


def rows_of(page, caption):
    """Without the heading."""
    return page.table(caption)[1:]


# --- The page --------------------------------------------------------------------------------------------------------
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
    page.whole(text)
    assert page.tags.count("svg") == page.tags.count("figure")
    assert len(text.encode()) < 1_000_000
    assert text == discrepancy_page(result)
    assert typeset(lead(result)) in text
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
    assert TorqueOffset.shown_by in text
    assert page.table("Effects that were added")[2][2] == []


def test_what_an_effect_is_worth_is_in_page_terminal_and_file():
    result = make(added=(found(friction(), FRICTION, **WORTH),), identification=made_of(sliding=(3,)))
    (row,) = rows_of(page_of(result)[0], "What each is worth")
    assert row[2:] == [[2.25], [1.5], [0.05], [3.2], [0.08], [0.5], [0.0125]]
    with (console := Console(width=200)).capture() as caught:
        console.print(*discrepancy_parts(result), sep="\n")
    assert "3.20 -> 0.500 N (8.0 -> 1.2 %) in joint 3" in caught.get()
    assert len(discrepancy_parts(make(added=()))) < len(discrepancy_parts(result)), "no table of effects"
    told = discrepancy_summary(replace(result, unexplained_on={}, all_along=(), floor=make().floor))["found"][0]
    assert told["effort"] == {"joint": 2, "rms": 1.5, "largest": 2.25, "percent": 5.0, "of": "rated effort"}
    cost = {"joint": 3, "before": 3.2, "after": 0.5, "percent_before": 8.0, "percent_after": 1.25}
    assert told["cost_if_ignored"] == pytest.approx(cost)


def test_floors_that_are_a_models_own_error_are_marked():
    floor = floor_of(np.array([0.29, 0.30, 0.31]), "earlier model's residual", lasting=[0, 2], white=0.5)
    page, text = page_of(make(status="no_discrepancy", **NOTHING, floor=floor))
    assert text.count("most of it lasts") == 2
    assert [row[4] for row in rows_of(page, "Gap on later")] == [[0.5 * rms] for rms in floor.rms]


def test_where_nothing_stands_out_the_page_says_so_by_what_was_found():
    texts = {
        page_of(make(where=(), **changes))[1].partition('<section id="where"')[2].partition("</section>")[0]
        for changes in ({}, {"added": (), "status": "unexplained", "unexplained": ((3, 1.6),)}, {"added": ()})
    }
    assert len(texts) == 3


def test_what_became_of_each_candidate_is_told():
    """What was added is listed however poor it was by itself; of all others the best 25."""
    drift = Hysteresis(joints=(2,), width=(0.01,))
    scores = (
        *(score(TorqueOffset(joints=(1,)), gain) for gain in range(10, 40)),
        score(friction(), 9.0),
        score(drift, -2.0),
        score(TorqueOffset(joints=(3,)), 50.0),
        score(Payload(), 45.0),
    )
    page, text = page_of(make(added=(found(friction(), FRICTION), found(drift, {})), scores=scores))
    rows = re.findall(
        r'<tr><th scope="row">(\d+)</th><td>([^<]+)</td><td>[^<]+</td><td>.*?</td><td>([^<]+)</td></tr>', text
    )
    assert [row[:2] for row in rows[:2]] == [("1", "torque offset"), ("2", "payload")]
    assert "left out" in rows[0][2]
    assert "not needed" in rows[1][2]
    assert [row[:2] for row in rows[-2:]] == [("33", "Coulomb friction"), ("34", "presliding hysteresis")]
    assert ["first" in rows[-2][2], "second" in rows[-1][2]] == [True, True]
    listed = rows_of(page, "The best 25 of 34")
    assert [row[3][0] for row in listed[:4]] == pytest.approx([50.0, 45.0, 39.0, 38.0])
    assert len(listed) == 25 + 2


def test_a_candidate_that_is_not_needed_is_held_against_what_took_its_place():
    """By itself it has 60; in the place of the friction 12.5 against 40, in that of the payload 3 against 40."""
    rivals = [(score(TorqueOffset(joints=(2,)), gain),) for gain in (3.0, 12.5, 41.0)]
    added = (found(Payload(), {}, rivals=rivals[0]), found(friction(), FRICTION, rivals=rivals[1]))
    scores = (score(friction(), 40.25), score(TorqueOffset(joints=(2,)), 60.0))
    (said,) = re.findall(r"<td>(not needed[^<]*)</td>", page_of(make(added=added, scores=scores))[1])
    assert re.search(r"Coulomb friction, joint 2.*12\.5.*40\.0", said)
    stronger = (found(friction(), FRICTION, rivals=rivals[2]),)
    (said,) = re.findall(r"<td>(not needed[^<]*)</td>", page_of(make(added=stronger, scores=scores))[1])
    assert "41" not in said


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


# --- Figures ---------------------------------------------------------------------------------------------------------
def test_residuals_are_drawn_over_the_variable_that_shows_them():
    result = make()
    axes = residual_figure(result, 2).axes
    used = TRIAL.used[:, 1]
    speed = TRIAL.actuators.dq[used, 1]
    for ax, predicted in zip(axes, (PREDICTED_BEFORE, PREDICTED_AFTER), strict=True):
        points = np.asarray(ax.collections[0].get_offsets())
        assert len(points) == 1500
        assert ax.collections[0].get_rasterized()
        residual = (TRIAL.nearest(predicted) - predicted)[used, 1]
        order = np.argsort(speed)
        place = order[np.searchsorted(speed[order], points[:, 0])]
        np.testing.assert_allclose(residual[place], points[:, 1], rtol=1e-12)
        np.testing.assert_allclose(
            ax.containers[0].lines[0].get_xydata(), np.stack(binned(speed, residual)[:2], axis=1)
        )
        band = ax.patches[0].get_extents().transformed(ax.transData.inverted())
        np.testing.assert_allclose([band.y0, band.y1], [-0.30, 0.30], rtol=1e-9)
    means = [ax.containers[0].lines[0].get_ydata() for ax in axes]
    assert means[0].max() > 0.8 * COULOMB
    assert means[0].min() < -0.8 * COULOMB
    assert np.abs(means[1]).max() < 0.5 * NOISE


def test_efforts_are_drawn_over_time():
    (ax,) = effort_figure(make(), 2).axes
    time = TRIAL.signals.motion.t - TRIAL.signals.motion.origin
    drawn = TRIAL.nearest(PREDICTED_AFTER), PREDICTED_BEFORE, PREDICTED_AFTER
    for line, effort in zip(ax.lines, drawn, strict=True):
        np.testing.assert_array_equal(line.get_xydata(), np.stack([time, effort[:, 1]], axis=1))


def test_gaps_are_drawn_in_units_of_the_floor():
    result = make()
    (ax,) = gap_figure(result).axes
    widths = np.array([[bar.get_width() for bar in bars] for bars in ax.containers])
    np.testing.assert_allclose(widths * result.floor.rms, [result.before, result.after], rtol=1e-12)
    assert [text.get_text() for text in ax.texts] == [
        f"{rounded(gap)} N m" for gap in (*result.before.tolist(), *result.after.tolist())
    ]
    assert [line.get_xdata()[0] for line in ax.lines] == [1.0]


def test_candidates_are_drawn_best_first_and_at_most_twelve():
    more = [score(TorqueOffset(joints=(1,)), gain) for gain in np.arange(20.0, 32.0)]
    result = make(scores=(*make().scores, *more))
    (ax,) = candidate_figure(result).axes
    bars = ax.containers[0]
    np.testing.assert_allclose([bar.get_width() for bar in bars], [40.25, *np.arange(31.0, 20.0, -1.0)], rtol=1e-12)
    assert [to_hex(bar.get_facecolor()) for bar in bars] == [AFTER, *[INK] * 11]
    assert ax.lines[0].get_xdata()[0] == 2.0
    assert to_hex(ax.lines[0].get_color()) == BEFORE
    assert ax.get_yticklabels()[0].get_text() == "Coulomb friction, joint 2"
    assert not candidate_figure(make(scores=())).axes[0].containers[0].patches
