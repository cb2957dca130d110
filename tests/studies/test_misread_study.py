"""The study `misread`: its cases, and a row of one trial."""

import numpy as np
import pytest

from bayesid.studies import misread
from bayesid.studies.misread import HOW, RIGHT, STUDY, Scenario, make_case
from tests.studies.reported import reported


def test_each_misread_log_stands_beside_its_right_one():
    planned = misread.plan(2 * len(HOW), 7)
    assert {scenario.how for scenario, _ in planned} == {*HOW, RIGHT}
    for (wrong, seed), (right, same) in zip(planned[::2], planned[1::2], strict=True):
        assert (wrong.robot, wrong.known, seed, right.how) == (right.robot, right.known, same, RIGHT)


@pytest.mark.parametrize("how", HOW)
def test_a_misread_log_differs_in_what_it_says(how):
    wrong, right = (make_case(Scenario(one, "kr5", True, 2.0), 3) for one in (how, RIGHT))
    assert wrong.kind
    assert not right.kind
    q, effort = wrong.log.q != right.log.q, wrong.log.effort != right.log.effort
    assert (q.any(), effort.any()) != (False, False)
    hidden = make_case(Scenario(how, "kr5", False, 2.0), 3).log
    np.testing.assert_array_equal(hidden.effort, np.abs(wrong.log.effort))


def test_a_row_of_each_kind_and_the_report():
    rows = []
    for k, how in enumerate(("efforts exchanged", RIGHT)):
        scenario = Scenario(how, "kr5", True, 5.0)
        rows.append({"trial": k, "seed": 4, **vars(scenario), **misread.trial(scenario, 4)})
    assert [row["found"] for row in rows] == ["joint order", ""]
    assert [row["stopped"] for row in rows] == [True, False]
    assert misread.figures(rows)["named"] == 1.0
    assert STUDY.short(rows) == []
    assert "right finding: 100.0 %" in reported(STUDY, rows)
