import csv
import json

import numpy as np
import pytest
import tomli_w
from conftest import small_robot, smooth_motion

import bayesid
from bayesid.cli import main
from bayesid.discrepancy.comparison import names_of
from bayesid.discrepancy.timeline import ABSENT, PAYLOAD, SHOWN
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.log.log import Log
from bayesid.report.comparison import columns
from bayesid.report.discrepancy import discrepancy_checks, discrepancy_summary
from bayesid.report.plot.discrepancy import timeline_figure
from bayesid.robot import robot_table
from bayesid.simulation.parameters import random_parameters

TERMS = ("rigid_body", "viscous_friction", "coulomb_friction", "torque_offset")
COULOMB, VISCOUS = np.array([4.0, 6.0, 2.0]), np.array([3.0, 4.0, 1.5])
MASS, CENTRE = 3.0, np.array([0.15, -0.05, 0.1])
STICKY = (0.0, 5.0, 0.0)
STEEP = 0.15
"""rad/s, speed over which the hidden friction decays."""


def arm_log(seed, *, worn=(1.0, 1.0, 1.0), sticky=(0.0, 0.0, 0.0), mass=0.0, name=None):
    """The same arm with friction times `worn`, `sticky` N m more near standstill, a body of `mass` held."""
    robot = small_robot(3, seed=2)
    motion = smooth_motion(3, 16.0, 100.0, seed=seed)
    model = Model(robot, make_terms(["rigid_body"], robot, motion))
    theta = random_parameters(model, rng=np.random.default_rng(5))
    body = 0.01 * np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0]) * mass
    first, square = mass * CENTRE, mass * (CENTRE @ CENTRE * np.eye(3) - np.outer(CENTRE, CENTRE))
    theta[-10:] += np.concatenate([body + square[np.triu_indices(3)], first, [mass]])
    factor, dq = np.array(worn), motion.dq
    friction = factor * (COULOMB * np.sign(dq) + VISCOUS * dq)
    friction += np.array(sticky) * np.exp(-((dq / STEEP) ** 2)) * np.sign(dq)
    effort = model.effort(motion, theta) + friction
    effort += 0.3 * np.random.default_rng([seed, 1]).normal(size=effort.shape)
    return Log(motion.t, motion.q, np.abs(effort), np.zeros(3, dtype=bool), source=name or f"log{seed}")


def compared(*logs):
    return bayesid.find_discrepancy(small_robot(3, seed=2), logs, terms=TERMS, posterior=False)


def keys(comparison, status):
    return {(one.name, one.joints) for one in comparison.of(status)}


@pytest.fixture(scope="module")
def loaded():
    return compared(arm_log(1, sticky=STICKY), arm_log(2, sticky=STICKY, mass=MASS))


def test_preexisting_effects_are_distinguished_from_new_ones(loaded):
    assert keys(loaded, "preexisting") == {("stribeck_friction", (2,))}
    assert keys(loaded, "changed") == {("payload", ())}
    assert keys(loaded, "gone") == set()
    (stribeck,) = loaded.of("preexisting")
    assert [what.says for what in stribeck.by_log] == [SHOWN, SHOWN]
    lines = columns(loaded)
    assert any("payload" in line for line in lines["changed"])
    assert any("Stribeck friction, joint 2" in line for line in lines["preexisting"])
    assert "payload" in repr(loaded)
    line = loaded.timeline
    (place,) = [c for c, one in enumerate(line.tracked) if one.name == PAYLOAD]
    assert abs(line.value[1, place] - MASS) < 4.0 * line.sd[1, place]
    assert [line.tracked[c].name for c in np.flatnonzero(line.moved.any(axis=0))] == [PAYLOAD]  # and no link
    places, names = timeline_figure(loaded).panels[0][0].x_ticks  # by the order of logs without dates
    assert (list(places), list(names)) == ([1.0, 2.0], ["1", "2"])


@pytest.mark.long
def test_an_effect_of_the_first_log_alone_is_gone_and_one_of_a_later_log_is_new():
    """There is a warning for logs that are not in the order of their dates."""
    first = arm_log(1, sticky=STICKY, name="arm-2026-08-01.csv")
    both = compared(first, arm_log(2, sticky=(5.0, 0.0, 0.0), name="arm-2026-07-01.csv"))
    assert keys(both, "gone") == {("stribeck_friction", (2,))}
    assert keys(both, "changed") == {("stribeck_friction", (1,))}
    assert keys(both, "preexisting") == set()
    assert [what.says for what in both.of("gone")[0].by_log] == [SHOWN, ABSENT]
    assert both.of("gone")[0].by_log[1].log10_ratio < -2.0
    assert [what.says for what in both.of("changed")[0].by_log] == [ABSENT, SHOWN]
    assert any("order of their dates" in warning for warning in both.warnings)


@pytest.mark.parametrize(
    ("sticky", "shown"),
    [(STICKY, (("stribeck_friction", (2,)),)), pytest.param((0.0, 0.0, 0.0), (), marks=pytest.mark.long)],
    ids=["there again", "gone"],
)
def test_a_stored_model_shows_preexisting_effects(loaded, sticky, shown):
    """The model has the added effects; a later log confirms them alone, or does not."""
    result = bayesid.find_discrepancy(loaded.earlier, arm_log(3, sticky=sticky), posterior=False)
    assert result.preexisting == shown
    assert [check.name for check in discrepancy_checks(result)].count("In both logs") == len(shown)
    listed = [{"effect": effect, "joints": list(joints)} for effect, joints in shown]
    assert discrepancy_summary(result)["preexisting"] == listed


def test_names_of_logs_are_short_and_distinct():
    for sources, names in (
        (("a/x.csv", "b/y.csv"), ("x.csv", "y.csv")),
        (("a/x.csv", "b/x.csv"), ("a/x.csv", "b/x.csv")),
        (("x", "x"), ("log 1", "log 2")),
    ):
        assert names_of([arm_log(1, name=source) for source in sources]) == names


WORN = {"arm-2026-03-14.csv": 1.0, "arm-2026-05-02.csv": 1.15, "arm-2026-07-30.csv": 1.3}
"""Logs, and their friction in joint 2."""
FIRST, SECOND, _ = WORN


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("weeks")
    for k, (name, factor) in enumerate(WORN.items(), 1):
        arm_log(k, worn=(1.0, factor, 1.0)).save(folder / name)
    log = arm_log(3)
    Log(log.t, log.q[:, :2], log.effort[:, :2], log.signed[:2]).save(folder / "two.csv")
    arm_log(1).save(folder / "copy.csv")
    (folder / "arm.toml").write_bytes(tomli_w.dumps(robot_table(small_robot(3, seed=2))).encode())
    (folder / "result").mkdir()
    return folder


@pytest.mark.long
def test_the_command_finds_friction_that_grew_and_writes_json_time_line_and_report(place, tmp_path):
    logs, out = [str(place / name) for name in WORN], tmp_path / "out"
    options = ["--robot", str(place / "arm.toml"), "--terms", ",".join(TERMS), "--no-posterior"]
    assert main(["discrepancy", *logs, *options, "--out", str(out)]) == 0
    written = json.loads((out / "discrepancy.json").read_text())
    assert written["dates_from"] == "dates in the names of the files"
    assert [log["date"] for log in written["logs"]] == ["2026-03-14", "2026-05-02", "2026-07-30"]
    assert {one["parameter"] for one in written["moved"]} == {"Fc2", "Fv2"}
    assert written["preexisting"] == written["gone"] == []
    rows = list(csv.DictReader((out / "timeline.csv").open()))
    assert {"log", "date", "parameter", "value", "sd", "unit", "moved"} <= set(rows[0])
    assert {row["parameter"] for row in rows if row["moved"] == "True"} == {"Fc2", "Fv2"}
    for name, first in (("Fc2", COULOMB[1]), ("Fv2", VISCOUS[1])):
        value, sd = np.array([[row["value"], row["sd"]] for row in rows if row["parameter"] == name], dtype=float).T
        assert np.all(np.abs(value - first * np.array([*WORN.values()])) < 4.0 * sd)
    assert "joint 2: Coulomb friction" in (out / "discrepancy.html").read_text()
    assert (out / "report.html").is_file()
    assert bayesid.load(out).model.robot.n_joints == 3


def test_bad_input_is_one_line_and_exit_code_2(place, tmp_path, capsys):
    for logs, robot, message in (
        ([FIRST], True, "is a single log"),
        ([FIRST, SECOND], False, "give --robot"),
        ([FIRST, FIRST], True, "is given twice"),
        ([FIRST, "copy.csv"], True, "the same recording"),
        ([FIRST, "two.csv"], True, "has 2 joints"),
        (["result", FIRST, SECOND], False, "2 logs with a result"),
        (["result", FIRST], True, "a result has its own robot"),
        ([FIRST, "result"], True, "is a folder"),
        ([FIRST, "nowhere.csv"], True, "no such file"),
    ):
        options = ["--robot", str(place / "arm.toml")] if robot else []
        paths = [str(place / log) for log in logs]
        assert main(["discrepancy", *paths, *options, "--no-posterior", "--out", str(tmp_path / "out")]) == 2
        error = capsys.readouterr().err.strip()
        assert message in error
        assert "\n" not in error
        assert not (tmp_path / "out").exists()
