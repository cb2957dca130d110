"""Differences of two golden files, without runs."""

import copy
import json

import pytest

from bayesid.studies import golden
from bayesid.studies.golden import Run, differences, execute, reduced

FIGURES = {
    "summary.n_segments": 298,
    "summary.search.cost": 1464.842136,
    "signs.samples": "4ed9a8037716ae9e",
    "mean#Fc1": [12.0, 1e-9],
    "mean#Fc2": [-3.0, 1e-9],
    "payload.mass.value.1": [3.07, 0.001],
}


def results(hashed="a", **changed):
    return {"run": {"hash": hashed, "figures": {**copy.deepcopy(FIGURES), **changed}}}


def told(**changed):
    return differences(results(), results("b", **changed))


def test_equal_files_say_nothing():
    assert differences(results(), results()) == []
    assert told() == []


@pytest.mark.parametrize(
    ("figure", "value"),
    [
        ("signs.samples", "0000000000000000"),
        ("summary.n_segments", 299),
        ("summary.search.cost", 1464.844),
        ("mean#Fc1", [12.0001, 1e-9]),
        ("payload.mass.value.1", [3.08, 0.001]),
        ("payload.inertia.value.1", [0.03, 0.001]),
    ],
)
def test_a_figure_beyond_its_tolerance_is_listed(figure, value):
    (line,) = told(**{figure: value})
    assert figure in line
    assert str(value) in line


@pytest.mark.parametrize(
    ("figure", "value"),
    [
        ("summary.search.cost", 1464.8422),
        ("mean#Fc1", [12.000001, 1e-9]),
        ("payload.mass.value.1", [3.075, 0.001]),
        ("signs.samples", "differs between seeds"),
    ],
)
def test_a_figure_within_its_tolerance_is_not(figure, value):
    assert told(**{figure: value}) == []


def test_missing_runs_and_figures_are_listed():
    assert "missing" in differences(results(), {})[0]
    assert "missing" in differences({}, results())[0]
    fewer = results("b")
    del fewer["run"]["figures"]["mean#Fc2"]
    assert "missing" in differences(results(), fewer)[0]


def test_the_reference_keeps_one_number_of_a_list_that_any_element_changes():
    few = reduced(FIGURES)
    assert {name for name in few if "#" in name} == {"mean#2"}
    moved = reduced({**FIGURES, "mean#Fc2": [-3.0001, 1e-9]})
    assert not golden.same(few["mean#2"], moved["mean#2"])
    assert golden.same(few["mean#2"], reduced(FIGURES)["mean#2"])


def test_a_failed_run_is_listed_and_the_others_run(capsys):
    found = execute([Run("bad", ("identify nowhere.csv --robot kr5 --out out",)), Run("worse", ("no_command",))])
    assert "exit code 2" in found["bad"]["error"]
    assert set(found) == {"bad", "worse"}
    assert len(differences(found, found)) == 2


def test_check_ends_with_one_where_something_differs(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(golden, "figures_of", lambda run: dict(FIGURES))
    now, reference = tmp_path / "now.json", tmp_path / "golden.json"
    monkeypatch.setattr(golden, "REFERENCE", reference)
    assert golden.main(["--only", "demo", "excite", "--out", str(now), "--update"]) == 0
    assert golden.main(["--only", "demo", "--check", str(reference)]) == 0
    reference.write_text(json.dumps(json.loads(reference.read_text()) | {"demo": results("b", status="x")["run"]}))
    assert golden.main(["--only", "demo", "--check", str(reference)]) == 1
    assert "status" in capsys.readouterr().out
    assert golden.main(["--compare", str(now), str(now)]) == 0
