"""The study of sets of effects: scores by hand, its plan by kind, a report and a figure of rows made up."""

import json
from dataclasses import asdict
from types import SimpleNamespace

import numpy as np
import pytest
from reported import reported

from bayesid.studies import blind, discrepancy, discrepancy_sets
from bayesid.studies.discrepancy_sets import more_scores, number_error


def effect(name, joints, equivalent=(), **more):
    more = {"parameters": {}, "readable": {}, "gain": 50.0} | more
    return SimpleNamespace(effect=name, joints=joints, equivalent=equivalent, **more)


def truth_of(effects, joints, parameters=()):
    """A truth of two joints; parameters by effect."""
    more = list(parameters) or [{} for _ in effects]
    efforts = np.array([[1.0, -2.0], [-3.0, 4.0]])
    return blind.Truth(effects, joints, {"effects": more}, 5.0, np.ones(2), efforts, efforts, np.array([0.5, 0.25]))


def scores(added, truth):
    result = SimpleNamespace(
        added=added,
        refused=(),
        status="explained",
        unexplained=((1, 3.0),),
        before=np.array([2.0, 1.0]),
        after=np.array([0.6, 0.5]),
        thresholds=SimpleNamespace(log10_bayes_factor=2.0),
        identification=SimpleNamespace(sample_signs=np.sign(truth.log_efforts) * [[1, 1], [1, -1]]),
    )
    return {**discrepancy.score(result, truth), **more_scores(result, truth)}


def test_a_set_is_right_if_each_effect_has_one_of_its_own():
    truth = truth_of(("coulomb_friction", "joint_spring"), ((2,), (2,)))
    both = [effect("hysteresis", (2,), ("coulomb_friction",)), effect("joint_spring", (2,))]
    row = scores(both, truth)
    assert row["each"]
    assert row["all"]
    assert row["false"] == 0
    assert row["after"] == pytest.approx(2.0), "of the touched joint"
    assert row["signs"] == pytest.approx(0.75)
    one_for_both = scores([effect("hysteresis", (2,), ("coulomb_friction", "joint_spring"))], truth)
    assert one_for_both["all"]
    assert not one_for_both["each"]
    elsewhere = scores([*both, effect("joint_spring", (1,))], truth)
    assert elsewhere["each"]
    assert elsewhere["false"] == 1


def test_variables_of_what_was_learned():
    truth = truth_of(("outside",), ((1,),), [{"variables": ["dq2", "q1"]}])
    for found, joints, right in (
        (["q1", "dq2"], (1,), True),
        (["q1"], (1,), False),
        (["q1", "dq2", "t"], (1,), False),
        (["q1", "dq2"], (2,), False),
        (None, (1,), False),
    ):
        learned = effect("learned_effect", joints, **({} if found is None else {"variables": found}))
        row = scores([learned], truth)
        assert row["right_variables"] is right
        assert row["each"] is (joints == (1,))
        assert row["false"] == (joints != (1,))


def test_number_of_the_table():
    for parameters, joints, number, error in (
        ({"d3": (0.004, 1e-4, "m")}, (3,), "d", 0.2),
        ({"d3": (4.0, 0.1, "mm")}, (), "d", 0.2),
        ({"d2": (0.005, 1e-4, "m")}, (), "d", np.nan),
        ({"alpha3": (0.005, 1e-4, "m")}, (), "a", np.nan),
        ({"a": (-0.005, 1e-4, "m")}, (3,), "a", 2.0),
        ({"zero_3": (0.0075, 1e-4, "rad")}, (3,), "theta", 0.5),
    ):
        off = {"row": 3, "number": number, "value": 0.005}
        added = [effect("coulomb_friction", (3,), parameters={number: (0.005, 0.0, "m")})]
        assert np.isnan(number_error(added, off)), "of another effect"
        added.append(effect("joint_zero" if number == "theta" else "kinematic_error", joints, parameters=parameters))
        assert number_error(added, off) == pytest.approx(error, nan_ok=True)
        row = scores(added[1:], truth_of(("kinematic_error",), ((),), [off]))
        assert row["each"]
        assert row["number_error"] == pytest.approx(error, nan_ok=True)


def made_up_rows(count):
    """Rows of right answers."""
    rows = []
    for trial, (scenario, seed) in enumerate(discrepancy_sets.plan(count, 0)):
        names = tuple(scenario.effects.split("+")) if scenario.effects else ()
        silent = "only" in scenario.kind
        added = [] if silent else [effect({"outside": "learned_effect"}.get(name, name), (1,)) for name in names]
        off = {"row": 1, "number": "a", "value": 0.005}
        row = scores(added, truth_of(names, tuple((1,) for _ in names), [off | {"variables": []} for _ in names]))
        timings = {"timings": {"discrepancy": 4.0 + trial, "cpu": 3.0}}
        rows.append({**asdict(scenario), **row, "number_error": 0.1, "seed": seed, "trial": trial, **timings})
    return rows


def test_the_report_counts_rows_of_right_answers_for_each_target():
    rows = made_up_rows(15)
    lines = reported(discrepancy_sets.STUDY, rows).splitlines()
    for target in discrepancy_sets.targets():
        (line,) = [line for line in lines if line.startswith(f"{target.text:<58}")]
        if not target.text.startswith("outside: right"):
            assert "(100.0 %)" in line, line
    wrong = [{**rows[0], "false": 1, "named": json.dumps([["delay", [2], []]])}, *rows[1:]]
    assert "two effects, different joints: set named                  0 of 1" in discrepancy_sets.report(wrong)
