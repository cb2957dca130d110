"""`bayesid excite --for`: the motion after a result, its files, text and errors."""

import csv
import json
import os
from dataclasses import replace

import numpy as np
import pytest
from command_line import assert_refused, run
from payload_cases import PayloadCase

import bayesid

QUICK = ("--duration", "4", "--rate", "50", "--changes", "20")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A result, and a folder of a discrepancy with two equivalent effects."""
    place, arm = tmp_path_factory.mktemp("made"), PayloadCase(0)
    for name in ("result", "found"):
        bayesid.save(arm.result, place / name, report=False)
    found = {
        "effect": "torque_offset",
        "joints": [1],
        "equivalent": ["joint_spring"],
        "change_of_what_was_there": False,
        "alternatives": [{"effect": "joint_spring", "joints": [1]}],
        "parameters": {"offset1": {"value": 0.4, "sd": 0.1, "unit": "N m"}},
    }
    (place / "found" / "discrepancy.json").write_text(json.dumps({"found": [found]}))
    return place


@pytest.fixture
def here(made, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("result", "found"):
        os.symlink(made / name, tmp_path / name)
    return tmp_path


def test_a_next_motion_is_written_with_predictions_and_checks(here, capsys):
    (here / "limits.toml").write_text("effort = [200, 150, 80]\n")
    limits = ("--limits", "limits.toml", "--capsules", "0.03", "--floor", "none")
    assert run("excite", "--for", "result", "--about", "Fc2", *QUICK, *limits, "--out", "next") == 0
    said = capsys.readouterr().out
    assert "NOT checked: jerks" in said
    assert "NOT checked: efforts" not in said
    assert "NOT checked: collisions" not in said
    told = json.loads((here / "next" / "next_motion.json").read_text())
    assert (told["about"], told["log10_bayes_factors"]) == (["Fc2"], [])
    assert told["open"] <= told["open_now"]
    assert told["reached"]["distance"] >= told["margin"]
    assert np.all(np.array(told["reached"]["effort_with_band"]) <= [200.0, 150.0, 80.0])
    rows = list(csv.DictReader((here / "next" / "predicted.csv").open()))
    assert all(float(row["sd"]) <= float(row["sd_now"]) * (1.0 + 1e-9) for row in rows)
    table = np.genfromtxt(here / "next" / "speed_100" / "motion.csv", delimiter=",", names=True)
    slow = np.genfromtxt(here / "next" / "speed_10" / "motion.csv", delimiter=",", names=True)
    np.testing.assert_allclose(slow["q2"][::10][: len(table)], table["q2"], atol=2e-9)
    np.testing.assert_allclose([table["dq1"][0], table["dq1"][-1]], 0.0, atol=1e-9)
    assert "<svg" in (here / "next" / "next_motion.svg").read_text()


def test_equivalent_effects_of_a_discrepancy_are_distinguished_by_default(here, capsys):
    """An earlier motion is replaced only with --force."""
    (here / "next").mkdir()
    (here / "next" / "next_motion.json").touch()
    assert_refused(capsys, ("excite", "--for", "found", *QUICK, "--out", "next"), ["next", "--force"])
    assert run("excite", "--for", "found", *QUICK, "--out", "next", "--quiet", "--force") == 0
    told = json.loads((here / "next" / "next_motion.json").read_text())
    pairs = {(one["true"], one["against"]) for one in told["log10_bayes_factors"]}
    assert pairs == {("torque_offset:1", "joint_spring:1"), ("joint_spring:1", "torque_offset:1")}
    assert "efforts" in told["not_checked"][1]
    assert capsys.readouterr().out == ""


def test_programs_of_a_corrected_result_use_the_controllers_positions(made, tmp_path):
    """Joint 2 is flipped and shifted, and joints 1 and 3 are exchanged."""
    written = {}
    for name, correct in (("plain", None), ("turned", "q1=q3,q3=q1,q2=-q2+0.5")):
        stored = bayesid.load(made / "result")
        if correct is not None:
            stored = replace(stored, read_with={"correct": correct})
        design = bayesid.design_excitation(
            stored, about=["Fc2"], settings=bayesid.MotionSettings(duration=4.0, rate=50.0, changes=10)
        )
        place = bayesid.save(design, tmp_path / name)
        table = np.genfromtxt(place / "speed_100" / "motion.csv", delimiter=",", names=True)
        written[name] = table, (place / "speed_100" / "motion.src").read_text()
    (plain, _), (turned, program) = written["plain"], written["turned"]
    np.testing.assert_allclose(turned["q2"], 0.5 - plain["q2"], atol=2e-9)
    np.testing.assert_allclose(turned["dq2"], -plain["dq2"], atol=2e-9)
    np.testing.assert_allclose(turned["q1"], plain["q3"], atol=2e-9)
    np.testing.assert_allclose(turned["dq3"], plain["dq1"], atol=2e-9)
    assert "uncorrected log" in " ".join(program.split())
