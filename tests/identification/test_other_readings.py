"""Wrong robot, wrong units, wrong joint order: told apart from noise, and never found where all is right."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import real_log

from bayesid.fit.evidence import Evidence
from bayesid.identification import other_readings
from bayesid.identification.other_readings import better_reading
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log, read_log
from bayesid.log.segments import find_segments
from bayesid.log.signals import prepare
from bayesid.model.catalogue import make_terms
from bayesid.model.model import Model
from bayesid.model.robot import load_robot, robot_from_table
from bayesid.model.terms import STANDARD
from bayesid.report.findings import find_findings
from bayesid.report.verdicts import check_findings, verdict
from bayesid.results.folders import save_identification
from bayesid.signs.search.certified import Certified
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory
from bayesid.studies import blind

DEGREE = np.pi / 180.0


@cache
def signed_log(name="kr5", noise=0.02, duration=8.0, colour=0.0, seed=3):
    robot = load_robot(name)
    motion = random_trajectory(robot.n_joints, duration, seed=seed).motion(np.arange(int(50 * duration) + 1) / 50.0)
    model, rng = Model(robot, make_terms(STANDARD, robot, motion)), np.random.default_rng(seed)
    theta = random_parameters(model, rng)
    return simulate(model, theta, motion, rng=rng, noise=noise, colour=colour, signed=True)


def moved(log, order=None, factor=1.0):
    """The log with its joints in another order, and its positions so many times as large."""
    order = np.arange(log.n_joints) if order is None else np.array(order)
    q, dq = (None if part is None else part[:, order] * factor for part in (log.q, log.dq))
    return replace(log, q=q, dq=dq, effort=log.effort[:, order], signed=log.signed[order])


def reading_of(robot, signed, rectified=True):
    """What is found at the signs that best suit the robot given, settled from the true ones: no search is needed."""
    robot = load_robot(robot) if isinstance(robot, str) else robot
    as_signed = prepare(signed)
    true, signals = as_signed.effort, prepare(signed.rectified()) if rectified else as_signed
    model = Model(robot, make_terms(STANDARD, robot, signals.motion))
    segments = find_segments(signals, robot.actuators(signals.motion))
    moving = segments.per_sample(segments.moving, *signals.effort.shape) > 0
    evidence = Evidence.of(model, signals, moving)
    used, effort = evidence.used, true
    rows = evidence.columns / np.linalg.norm(evidence.columns, axis=(0, 1))
    weight = used / np.sqrt((effort**2 * used).sum(axis=0))
    flat = (rows * weight[:, :, None]).reshape(effort.size, -1)
    inverse = np.linalg.pinv(flat.T @ flat, rcond=1e-12, hermitian=True) @ flat.T
    for _ in range(10):
        predicted = rows @ (inverse @ (effort * weight).ravel())
        effort = np.where(signals.signed, effort, np.where(predicted >= 0.0, 1.0, -1.0) * np.abs(effort))
    time = evidence.residual_noise(predicted).autocorrelation
    return better_reading(evidence, np.where(effort >= 0.0, 1.0, -1.0), time)


def test_a_reading_leaves_what_least_squares_leave():
    """Where all signs are known; tables of other robots have columns of which rounding says whether they count."""
    robot, signals = load_robot("kr5"), prepare(signed_log())
    model = Model(robot, make_terms(STANDARD, robot, signals.motion))
    evidence = Evidence.of(model, signals, np.ones(signals.effort.shape, dtype=bool))
    some = other_readings._Excerpt.of(evidence, np.sign(signals.effort))[::7]
    readings = [one for one in other_readings._readings(robot) if one.kind != "robot"][::5]
    assert {one.kind for one in readings} == {"joint order", "direction", "units", "mounting"}
    assert any(one.of_one_joint for one in readings)
    for reading, left in zip(readings, other_readings._left_by(readings, some), strict=True):
        motion = reading.motion(some.motion)
        columns = Model(reading.robot, make_terms(STANDARD, reading.robot, motion)).columns(motion)
        effort = some.effort[:, reading.efforts] * reading.turned * reading.units
        weight = some.used[:, reading.order] / np.linalg.norm(effort * some.used[:, reading.order], axis=0)
        rows, target = (columns * weight[:, :, None]).reshape(effort.size, -1), (effort * weight).ravel()
        rows = rows[:, rows.any(axis=0)]
        rows /= np.linalg.norm(rows, axis=0)
        residual = (target - rows @ np.linalg.lstsq(rows, target, rcond=1e-5)[0]).reshape(effort.shape)
        share = np.linalg.norm(residual, axis=0)[np.argsort(reading.efforts)]
        np.testing.assert_allclose(left.share, share, rtol=1e-6, err_msg=reading.change)


# ---------------------------------------------------------------------------------------------------------------
# What is found
# ---------------------------------------------------------------------------------------------------------------
SWAPPED = [(1, 0, 2, 3, 4, 5), (0, 2, 1, 3, 4, 5), (0, 1, 3, 2, 4, 5), (5, 4, 3, 2, 1, 0)]


@pytest.mark.parametrize("rectified", [True, False])
@pytest.mark.parametrize("order", SWAPPED)
def test_joints_in_another_order(order, rectified):
    found = reading_of("kr5", moved(signed_log(), order), rectified)
    first = int(np.flatnonzero(np.array(order) != np.arange(6))[0])
    named = f"joints {first + 1} and {first + 2} exchanged" if order[0] != 5 else "the joints in reversed order"
    assert (found.kind, found.change) == ("joint order", named)
    assert found.leaves < 0.7 * found.given


@pytest.mark.parametrize("rectified", [True, False])
@pytest.mark.parametrize("order", SWAPPED[:3])
def test_efforts_in_another_order_than_positions(order, rectified):
    log = signed_log()
    found = reading_of("kr5", replace(log, effort=log.effort[:, order]), rectified)
    first = int(np.flatnonzero(np.array(order) != np.arange(6))[0])
    named = f"the efforts of joints {first + 1} and {first + 2} exchanged, and not their positions"
    assert (found.kind, found.change) == ("joint order", named)
    assert found.leaves < 0.7 * found.given


@pytest.mark.parametrize("rectified", [True, False])
@pytest.mark.parametrize(
    ("factor", "named"), [(1.0 / DEGREE, "positions in degrees, not rad"), (DEGREE, "positions in rad, not degrees")]
)
def test_positions_in_another_unit(factor, named, rectified):
    found = reading_of("kr5", moved(signed_log(), factor=factor), rectified)
    assert (found.kind, found.change) == ("units", named)


@pytest.mark.parametrize("rectified", [True, False])
@pytest.mark.parametrize("joint", [2, 5])
def test_one_joint_in_other_units(joint, rectified):
    one, log = np.arange(6) == joint - 1, signed_log()
    found = reading_of("kr5", moved(log, factor=np.where(one, 1.0 / DEGREE, 1.0)), rectified)
    assert (found.kind, found.change) == ("units", f"the positions of joint {joint} alone in degrees, not rad")
    if joint == 2:  # what a wrist needs tells nothing of the others: its efforts are as good in any unit
        found = reading_of("kr5", replace(log, effort=log.effort * np.where(one, 1000.0, 1.0)), rectified)
        assert (found.kind, found.change) == ("units", f"the efforts of joint {joint} alone in N mm, not N m")


@pytest.mark.parametrize("joint", [2, 3, 4])
def test_a_joint_counted_the_other_way(joint):
    factor = np.where(np.arange(6) == joint - 1, -1.0, 1.0)
    log = moved(signed_log(), factor=factor)
    assert reading_of("kr5", log).kind == "direction"
    for efforts in (1.0, factor):
        found = reading_of("kr5", replace(log, effort=log.effort * efforts), rectified=False)
        named = f"joint {joint} counted" if efforts is factor else f"the positions of joint {joint} counted"
        assert found.change.startswith(named)


@pytest.mark.parametrize(("given", "true"), [("ur10e", "kr5"), ("kr5", "ur10e"), ("kr5", "tx40"), ("tx40", "ur10e")])
def test_another_robot_is_named_where_it_is_built_in(given, true):
    found = reading_of(given, signed_log(true))
    assert (found.kind, found.change) == ("robot", f"the built-in table of {true}")


def test_a_robot_hung_upside_down_and_lengths_in_mm():
    robot = load_robot("kr5")
    assert reading_of(replace(robot, gravity=-robot.gravity), signed_log()).change == "gravity along -z of the base"
    rows = [{"a": 300.0, "alpha": 1.0, "d": 500.0, "theta": 0.3}, {"a": 400.0, "alpha": 0.7, "d": 100.0, "theta": 0.0}]
    table = {"name": "arm", "convention": "standard", "joints": [*rows, rows[0]]}
    metres = [row | {"a": 1e-3 * row["a"], "d": 1e-3 * row["d"]} for row in table["joints"]]
    log = arm_log(robot_from_table(table | {"joints": metres}, "test"))
    assert reading_of(robot_from_table(table, "test"), log).change == "the robot's lengths in mm, not m"


def arm_log(robot):
    motion = random_trajectory(robot.n_joints, 8.0, seed=1).motion(np.arange(401) / 50.0)
    model, rng = Model(robot, make_terms(STANDARD, robot, motion)), np.random.default_rng(1)
    return simulate(model, random_parameters(model, rng), motion, rng=rng, noise=0.01, signed=True)


# ---------------------------------------------------------------------------------------------------------------
# What is not
# ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["kr5", "ur10e", "panda", "tx40"])
@pytest.mark.parametrize(("noise", "colour", "duration"), [(0.15, 0.0, 3.0), (0.15, 0.9, 3.0), (0.5, 0.0, 8.0)])
def test_noise_is_no_wrong_robot(name, noise, colour, duration):
    assert reading_of(name, signed_log(name, noise, duration, colour, seed=5)) is None


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("effect", sorted(blind.EFFECTS))
def test_a_hidden_effect_is_no_wrong_robot(effect, seed):
    case = blind.simulate(seed + 10, effect, 8.0)
    robot, log = robot_from_table(case.robot.table, "blind"), case.log
    assert reading_of(robot, Log(log.t, log.q, log.measured, np.ones(log.q.shape[1], dtype=bool))) is None


RIGHT = ["ur10e/b_20s", "panda/a", "tx40/a", "kr300/a", "dualarm/a", "lwr4/a"]


@pytest.mark.parametrize("name", RIGHT)
def test_the_right_file_of_a_real_log(name):
    path = real_log(f"{name}.csv")
    robot = next(path.parent.glob("robot.*"))
    for rectified in (True, False):
        assert reading_of(load_robot(robot), read_log(path), rectified) is None


# ---------------------------------------------------------------------------------------------------------------
# Real logs
# ---------------------------------------------------------------------------------------------------------------
def built_in(name):
    path = real_log(f"{name}/{'b_20s' if name == 'ur10e' else 'a'}.csv")
    return load_robot(path.parent / "robot.toml"), read_log(path)


@pytest.mark.parametrize("rectified", [True, False])
@pytest.mark.parametrize("name", ["ur10e", "panda"])
def test_real_logs_read_wrongly(name, rectified):
    robot, log = built_in(name)
    order = np.arange(robot.n_joints)
    order[[1, 2]] = 2, 1
    found = reading_of(robot, moved(log, order), rectified)
    assert found.change == "joints 2 and 3 exchanged"
    assert reading_of(robot, moved(log, factor=1.0 / DEGREE), rectified).kind == "units"
    factor = np.where(np.arange(robot.n_joints) == 2, -1.0, 1.0)
    assert reading_of(robot, moved(log, factor=factor), rectified).kind == "direction"


KILO, MILLI = (1000.0, "N mm, not N m"), (0.001, "kN m, not N m")


@pytest.mark.parametrize(
    ("name", "joint", "unit"),
    [
        *(("ur10e", 2, KILO), ("ur10e", 3, KILO), ("ur10e", 4, MILLI), ("panda", 4, KILO), ("panda", 4, MILLI)),
        *(("tx40", 2, KILO), ("tx40", 2, MILLI), ("tx40", 3, MILLI)),
    ],
)
def test_one_joint_of_a_real_log_in_other_units(name, joint, unit):
    """Not all are found: what a wrist needs is as good in any unit; in its place another joint may be named."""
    robot, log = built_in(name)
    one, (factor, units) = np.arange(robot.n_joints) == joint - 1, unit
    found = reading_of(robot, replace(log, effort=log.effort * np.where(one, factor, 1.0)))
    assert (found.kind, found.change) == ("units", f"the efforts of joint {joint} alone in {units}")


@pytest.mark.parametrize(("given", "true"), [("kr5", "ur10e"), ("ur10e", "tx40")])
def test_real_logs_of_another_robot(given, true):
    _, log = built_in(true)
    found = reading_of(given, log)
    assert (found.kind, found.change) == ("robot", f"the built-in table of {true}")


# ---------------------------------------------------------------------------------------------------------------
# What becomes of it
# ---------------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def exchanged():
    log = moved(signed_log(), (0, 2, 1, 3, 4, 5)).rectified()
    return identify("kr5", log, complete="off", search=Certified(budget=0.3), posterior=False)


def test_the_verdict_is_red_and_its_first_remedy_the_robot_file(exchanged, tmp_path):
    assert exchanged.better_reading.change == "joints 2 and 3 exchanged"
    assert exchanged.warnings[0].startswith("check the robot file")
    assert "joints 2 and 3 exchanged" in exchanged.warnings[0]
    found = verdict(check_findings(find_findings(exchanged)))
    assert found.state == "bad"
    save_identification(exchanged, tmp_path / "out", report=False)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["better_reading"]["kind"] == "joint order"
    assert summary["verdict"]["state"] == "bad"
    assert summary["verdict"]["reasons"][0]["check"] == "Robot file"
    assert summary["verdict"]["reasons"][0]["remedy"].startswith("check the robot file")


def test_nothing_is_tried_where_the_fit_is_good():
    result = identify("kr5", signed_log(), complete="off", search=Certified(budget=0.3), posterior=False)
    assert result.fit.relative_residual.max() < 0.1
    assert result.better_reading is None
    assert result.timings["other readings"] < 0.05
