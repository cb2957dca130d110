"""`bayesid excite --for`: the motion after a result, what is written, what is said, and what is refused."""

import csv
import json
import os

import numpy as np
import pytest
from payload_cases import PayloadCase

import bayesid
from bayesid import cli

EFFORTS = "200,150,80"
QUICK = ("--duration", "4", "--rate", "50", "--changes", "60")


def run(*arguments):
    try:
        return cli.main([str(argument) for argument in arguments])
    except SystemExit as end:
        return end.code


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A result, and a folder of a discrepancy that could not tell two effects apart."""
    place, arm = tmp_path_factory.mktemp("made"), PayloadCase(0)
    for name in ("result", "found"):
        bayesid.save_identification(arm.result, place / name, report=False)
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


def test_a_motion_is_written_with_what_it_will_tell_and_what_nobody_checked(here, capsys):
    limits = ("--effort-limits", EFFORTS, "--capsules", "0.03", "--floor", "none")
    assert run("excite", "--for", "result", *QUICK, *limits, "--out", "next") == 0
    said = capsys.readouterr().out
    assert "NOT checked: jerks" in said
    assert "NOT checked: efforts" not in said
    assert "NOT checked: collisions" not in said
    told = json.loads((here / "next" / "next_motion.json").read_text())
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
    assert run("excite", "--for", "result", *QUICK, "--out", "next", "--quiet") == 0  # an earlier one is replaced
    assert capsys.readouterr().out == ""
    assert "efforts" in json.loads((here / "next" / "next_motion.json").read_text())["not_checked"][1]


def test_what_a_discrepancy_could_not_tell_apart_is_told_by_default(here):
    assert run("excite", "--for", "found", *QUICK, "--out", "next", "--quiet") == 0
    told = json.loads((here / "next" / "next_motion.json").read_text())
    pairs = {(one["true"], one["against"]) for one in told["log10_bayes_factors"]}
    assert pairs == {("torque_offset:1", "joint_spring:1"), ("joint_spring:1", "torque_offset:1")}
    assert run("excite", "--for", "found", "--about", "Fc2", *QUICK, "--out", "next", "--quiet") == 0
    told = json.loads((here / "next" / "next_motion.json").read_text())
    assert (told["about"], told["log10_bayes_factors"]) == (["Fc2"], [])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--about", "Fc9"), ("--about", "'Fc9'")),
        (("--between", "torque_offset:1"), ("--between", "two different")),
        (("--between", "grease:1,torque_offset:1"), ("--between", "'grease'")),
        (("--about", "Fc2", "--between", "torque_offset:1,joint_spring:1"), ("--between", "--about")),
        (("--start", "0,1"), ("--start", "2 numbers")),
        (("--effort-limits", "1,2,x"), ("--effort-limits", "no list of numbers")),
        (("--effort-limits", "0.1,0.1,0.1"), ("--effort-limits", "at the start")),
        (("--effort-limits", "5,5"), ("--effort-limits", "5, 5 for 3 joints")),
        (("--effort-limits=-5,5,5",), ("--effort-limits", "positive")),
        (("--margin=-1", "--capsules", "0.03"), ("--margin", "-1 m", "touch")),
        (("--capsules", "5", "--floor", "none"), ("--capsules", "0.01 m")),
        (("--capsules", "0.03", "--tool", "0,0"), ("--tool", "2 numbers")),
        (("--capsules", "0.03", "--floor", "low"), ("--floor", "'low'", "none")),
        (("--floor", "0.1"), ("--floor", "--capsules")),
        (("--margin", "0.1"), ("--margin", "--capsules")),
        (("--tool", "0,0,0.1"), ("--tool", "--capsules")),
        (("--capsules", "-1"), ("--capsules",)),
        (("--log", "log.csv"), ("--log", "--for")),
        (("--robot", "kr5"), ("kr5", "another robot")),
        (("--duration", "0.1"), ("--duration",)),
        (("--changes", "0"), ("--changes",)),
        (("--about", ""), ("--about",)),
        (("--payload", "box"), ("payload", "box")),
        (("--harm", "3"), ("--harmonics", "result")),
        (("--noise", "0.05"), ("--noise", "result")),
        (("--capsules", "0.03", "--meshes", "."), ("--meshes", "--capsules")),
    ],
)
def test_what_cannot_be_used_is_said_in_one_line(here, capsys, options, words):
    assert run("excite", "--for", "result", *QUICK, *options, "--out", "next") == 2
    said = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("warning:")]
    assert len(said) == 1
    assert all(word in said[0] for word in words)
    assert not (here / "next").exists()


def test_options_of_a_result_want_one(here, capsys):
    for option in (("--about", "Fc2"), ("--criterion", "D"), ("--floor", "none")):
        assert run("excite", "--robot", "kr5", *option) == 2
        assert option[0] in (said := capsys.readouterr().err)
        assert "--for" in said
    assert run("excite") == 2
    assert "--robot" in capsys.readouterr().err


def test_a_damaged_discrepancy_is_named(here, capsys):
    os.remove("found")
    os.mkdir("found")
    for path in (here / "result").iterdir():
        os.symlink(path, here / "found" / path.name)
    (here / "found" / "discrepancy.json").write_text('{"found": [{"effect": 3}]}')
    assert run("excite", "--for", "found", *QUICK, "--out", "next") == 2
    assert "discrepancy.json" in capsys.readouterr().err
