"""Misread logs: named before the search or after it, told apart from noise, and nothing named where all is right."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import real_log

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.identification.misread import better_reading, misread_before
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log
from bayesid.log.reading import read_log
from bayesid.log.segments import find_segments
from bayesid.log.signals import prepare
from bayesid.regression.log_data import LogData
from bayesid.report.folders import save_identification
from bayesid.report.grading import verdict
from bayesid.report.report_data import report_data
from bayesid.report.verdicts import check_findings
from bayesid.robot import load_robot, robot_from_table
from bayesid.signs.search.certified import Certified
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory
from bayesid.studies import blind

DEGREE = np.pi / 180.0


@cache
def signed_log(name="kr5", noise=0.02, duration=8.0, colour=0.0, seed=3):
    return log_of(load_robot(name), noise, duration, colour, seed)


def log_of(robot, noise, duration=8.0, colour=0.0, seed=3):
    motion = random_trajectory(robot.n_joints, duration, rng=seed).motion(np.arange(int(50 * duration) + 1) / 50.0)
    model, rng = Model(robot, make_terms(STANDARD, robot, motion)), np.random.default_rng(seed)
    theta = random_parameters(model, rng=rng)
    return simulate(model, theta, motion, rng=rng, noise=noise, colour=colour, signed=True)


def moved(log, order=None, factor=1.0):
    """The log with its joints in another order, and its positions so many times as large."""
    order = np.arange(log.n_joints) if order is None else np.array(order)
    q, dq = (None if part is None else part[:, order] * factor for part in (log.q, log.dq))
    return replace(log, q=q, dq=dq, effort=log.effort[:, order], signed=log.signed[order])


def evidence_of(robot, signals):
    model = Model(robot, make_terms(STANDARD, robot, signals.motion))
    segments = find_segments(signals, robot.actuators(signals.motion))
    return LogData.of(model, signals, segments.per_sample(segments.moving, *signals.effort.shape) > 0)


def reading_of(robot, signed, rectified=True):
    """What is found at the signs that best suit the robot given, settled from the true ones: no search is needed."""
    robot = load_robot(robot) if isinstance(robot, str) else robot
    as_signed = prepare(signed)
    signals = prepare(signed.rectified()) if rectified else as_signed
    log_data, effort = evidence_of(robot, signals), as_signed.effort
    rows = log_data.columns / np.linalg.norm(log_data.columns, axis=(0, 1))
    weight = log_data.used / np.sqrt((effort**2 * log_data.used).sum(axis=0))
    flat = (rows * weight[:, :, None]).reshape(effort.size, -1)
    inverse = np.linalg.pinv(flat.T @ flat, rcond=1e-12, hermitian=True) @ flat.T
    for _ in range(10):
        predicted = rows @ (inverse @ (effort * weight).ravel())
        effort = np.where(signals.signed, effort, np.where(predicted >= 0.0, 1.0, -1.0) * np.abs(effort))
    time = log_data.residual_noise(predicted).autocorrelation
    return better_reading(log_data, np.where(effort >= 0.0, 1.0, -1.0), time)


def left_by_least_squares(motion, effort, used):
    """Of the standard terms of a KR5: RMS over the joints of their relative residuals."""
    robot = load_robot("kr5")
    columns = Model(robot, make_terms(STANDARD, robot, motion)).columns(motion)
    weight = used / np.linalg.norm(effort * used, axis=0)
    rows, target = (columns * weight[:, :, None]).reshape(effort.size, -1), (effort * weight).ravel()
    rows = rows[:, rows.any(axis=0)]
    rows /= np.linalg.norm(rows, axis=0)
    residual = target - rows @ np.linalg.lstsq(rows, target, rcond=1e-5)[0]
    return np.sqrt(np.mean((residual.reshape(effort.shape) ** 2).sum(axis=0)))


def test_what_is_left_is_what_least_squares_leave():
    """Where all signs are known: by the reading that is given, and by the one that is found."""
    log, order = moved(signed_log(), (0, 2, 1, 3, 4, 5)), [0, 2, 1, 3, 4, 5]
    found, signals = reading_of("kr5", log, rectified=False), prepare(log)
    motion, used = signals.motion, evidence_of(load_robot("kr5"), signals).used
    assert found.given == pytest.approx(left_by_least_squares(motion, signals.effort, used), rel=1e-6)
    right = replace(motion, q=motion.q[:, order], dq=motion.dq[:, order], ddq=motion.ddq[:, order])
    left = left_by_least_squares(right, signals.effort[:, order], used[:, order])
    assert found.leaves == pytest.approx(left, rel=1e-6)
    assert found.leaves < 0.7 * found.given


def wrong(order=None, positions=None, efforts=None, factor=None, units=None):
    """A log of a KR5 read wrongly: joints, positions or efforts in another order; factors of joint: factor, of all."""

    def of_joints(factors):
        return 1.0 if factors is None else np.array([factors.get(j, factors.get("all", 1.0)) for j in range(1, 7)])

    log = moved(signed_log(), order, of_joints(factor))
    effort = log.effort if efforts is None else log.effort[:, efforts]
    if positions is not None:
        log = replace(log, q=log.q[:, positions], dq=None if log.dq is None else log.dq[:, positions])
    return replace(log, effort=effort * of_joints(units))


WRONG = [
    ({"order": (1, 0, 2, 3, 4, 5)}, "joints 1 and 2 exchanged"),
    ({"order": (5, 4, 3, 2, 1, 0)}, "the joints in reversed order"),
    ({"efforts": (0, 1, 3, 2, 4, 5)}, "the efforts of joints 3 and 4 exchanged, not their positions"),
    ({"positions": (0, 1, 2, 4, 3, 5)}, "the positions of joints 4 and 5 exchanged, not their efforts"),
    ({"factor": {"all": 1.0 / DEGREE}}, "positions in degrees, not rad"),
    ({"factor": {"all": DEGREE}}, "positions in rad, not degrees"),
    ({"factor": {5: 1.0 / DEGREE}}, "the positions of joint 5 alone in degrees, not rad"),
    ({"units": {2: 1000.0}}, "the efforts of joint 2 alone in N mm, not N m"),
]


@pytest.mark.parametrize("rectified", [True, False])
@pytest.mark.parametrize(("how", "change"), WRONG)
def test_a_log_that_is_read_wrongly(how, change, rectified):
    found = reading_of("kr5", wrong(**how), rectified)
    assert found.change == change
    assert found.kind == ("joint order" if "factor" not in how and "units" not in how else "units")


def test_a_joint_counted_the_other_way():
    """Which of the two is told where signs are known."""
    assert reading_of("kr5", wrong(factor={3: -1.0})).kind == "direction"
    for units, named in (({3: -1.0}, "joint 3 reversed"), (None, "the positions of joint 3 reversed")):
        found = reading_of("kr5", wrong(factor={3: -1.0}, units=units), rectified=False)
        assert found.change.startswith(named)


def test_another_robot_or_mounting_is_named():
    found = reading_of("ur10e", signed_log())
    assert (found.kind, found.change) == ("robot", "the built-in table of kr5-paper")
    robot = load_robot("kr5")
    assert reading_of(replace(robot, gravity=-robot.gravity), signed_log()).change == "gravity along -z of the base"
    millimetres, metres = three_joints(1.0), three_joints(1e-3)
    assert reading_of(millimetres, log_of(metres, 0.01, seed=1)).change == "the robot's lengths in mm, not m"


def test_robots_that_explain_a_log_as_well_are_named_too():
    """Arms of one make differ in size: what noise leaves open is said."""
    found = reading_of("kr5r650", log_of(load_robot("ur10e"), 0.3, seed=3))
    assert found.kind == "robot"
    assert {"ur5e", "ur10e"} <= set(found.change.replace("(", " ").replace(")", " ").replace(",", " ").split())


def three_joints(k):
    rows = [(300.0, 1.0, 500.0, 0.3), (400.0, 0.7, 100.0, 0.0), (300.0, 1.0, 500.0, 0.3)]
    joints = [{"a": k * a, "alpha": alpha, "d": k * d, "theta": theta} for a, alpha, d, theta in rows]
    return robot_from_table({"name": "arm", "convention": "standard", "joints": joints}, "test")


@pytest.mark.parametrize(
    ("name", "noise", "colour", "duration"),
    [("kr5", 0.5, 0.0, 8.0), ("panda", 0.15, 0.0, 3.0), ("tx40", 0.15, 0.9, 3.0)],
)
def test_noise_is_no_wrong_robot(name, noise, colour, duration):
    assert reading_of(name, signed_log(name, noise, duration, colour, seed=5)) is None


@pytest.mark.parametrize("effect", ["gravity_spring", "base_tilt", "gain_error", "dead_zone"])
def test_a_hidden_effect_is_no_wrong_robot(effect):
    case = blind.simulate(10, effect, 8.0)
    robot, log = robot_from_table(case.robot.table, "blind"), case.log
    assert reading_of(robot, Log(log.t, log.q, log.measured, np.ones(log.q.shape[1], dtype=bool))) is None


@pytest.mark.real
@pytest.mark.parametrize("name", ["ur10e/b_20s", "panda/a", "tx40/a", "kr300/a", "dualarm/a", "lwr4/a"])
def test_real_logs_read_rightly_and_wrongly(name):
    path = real_log(f"{name}.csv")
    robot, log = load_robot(next(path.parent.glob("robot.*"))), read_log(path)
    for rectified in (True, False):
        assert reading_of(robot, log, rectified) is None
    if name not in (one := {"ur10e/b_20s": 2, "panda/a": 4}):
        return
    order = np.arange(robot.n_joints)
    order[[1, 2]] = 2, 1
    assert reading_of(robot, moved(log, order)).change == "joints 2 and 3 exchanged"
    assert reading_of(robot, moved(log, factor=1.0 / DEGREE)).kind == "units"
    third = np.where(np.arange(robot.n_joints) == 2, -1.0, 1.0)
    assert reading_of(robot, moved(log, factor=third)).kind == "direction"
    units = np.where(np.arange(robot.n_joints) == one[name] - 1, 1000.0, 1.0)
    found = reading_of(robot, replace(log, effort=log.effort * units))
    assert (found.kind, found.change) == ("units", f"the efforts of joint {one[name]} alone in N mm, not N m")


def test_the_verdict_is_red_and_its_first_remedy_the_robot_file(tmp_path):
    log = moved(signed_log(), (0, 2, 1, 3, 4, 5)).rectified()
    exchanged = identify("kr5", log, complete="off", search=Certified(budget=0.3), posterior=False, anyway=True)
    assert exchanged.better_reading.change == "joints 2 and 3 exchanged"
    assert "joints 2 and 3 exchanged" in exchanged.warnings[0]
    assert verdict(check_findings(report_data(exchanged)))["state"] == "bad"
    save_identification(exchanged, tmp_path / "out", report=False)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["better_reading"]["kind"] == "joint order"
    assert summary["verdict"]["state"] == "bad"
    assert summary["verdict"]["reasons"][0]["check"] == "Robot file"


def test_nothing_is_tried_where_the_fit_is_good():
    result = identify("kr5", signed_log(), complete="off", search=Certified(budget=0.3), posterior=False)
    assert result.fit.relative_residual.max() < 0.1
    assert result.better_reading is None
    assert result.timings["other readings"] < 1.0


# ---------------------------------------------------------------------------------------------------------------
# Before the search
# ---------------------------------------------------------------------------------------------------------------
def before(log, robot="kr5"):
    robot = load_robot(robot) if isinstance(robot, str) else robot
    return misread_before(evidence_of(robot, prepare(log)))


def times(log, q=None, effort=None):
    """Positions and efforts of joints (from 1) so many times as large."""
    q, effort = (np.array([(x or {}).get(j, 1.0) for j in range(1, log.n_joints + 1)]) for x in (q, effort))
    return replace(log, q=log.q * q, dq=None if log.dq is None else log.dq * q, effort=log.effort * effort)


def hung(gravity):
    """A robot that is mounted otherwise, for a log that was simulated of the one given."""
    return replace(load_robot("kr5"), gravity=np.array(gravity))


EARLY = {
    "joints exchanged": (lambda log: moved(log, (2, 1, 0, 3, 4, 5)), "joint order", "q1=q3,q3=q1,tau1=tau3,tau3=tau1"),
    "efforts exchanged": (
        lambda log: replace(log, effort=log.effort[:, [1, 0, 2, 3, 4, 5]]),
        "joint order",
        "tau1=tau2,",
    ),
    "joint turned": (lambda log: times(log, {3: -1.0}, {3: -1.0}), "direction", "q3=-q3"),
    "zero off": (lambda log: replace(log, q=log.q - [0, 0.5 * np.pi, 0, 0, 0, 0]), "zeros", "q2=q2+1.5708"),
    "N mm": (lambda log: times(log, effort={2: 1e3}), "units", "tau2=0.001"),
    "motor side": (lambda log: times(log, effort={3: 1 / 80}), "units", "tau3="),
}


@pytest.mark.parametrize("how", EARLY)
@pytest.mark.parametrize("rectified", [True, False])
def test_a_misread_log_is_named_before_its_signs_are_searched(how, rectified):
    misread, kind, correct = EARLY[how]
    log = misread(signed_log())
    found = before(log.rectified() if rectified else log)
    assert (found.kind, found.sure) == (kind, True)
    assert correct in found.remedy
    assert ("flips its torque" in found.remedy) == (kind == "direction")
    assert found.log10_odds > 6.0


@pytest.mark.parametrize("rectified", [True, False])
@pytest.mark.parametrize(("gravity", "kind"), [([0.0, 0.0, 9.81], "mounting"), ([0.0, 0.0, 0.0], "no gravity")])
def test_a_base_upside_down_and_efforts_without_weight(gravity, kind, rectified):
    log = log_of(hung(gravity), 0.02)
    found = before(log.rectified() if rectified else log)
    assert (found.kind, found.sure) == (kind, True)
    assert f"`gravity`={','.join(f'{g:g}' for g in gravity)}" in found.remedy
    assert before(log.rectified() if rectified else log, hung(gravity)) is None


@pytest.mark.parametrize("rectified", [True, False])
@pytest.mark.parametrize("seed", [3, 11])
def test_a_table_with_other_zeros_than_the_controllers_is_named(rectified, seed):
    """Joint 1 turns the other way, and two zeros are off: no correction of one joint mends that."""
    log = signed_log("kr5r650", noise=0.05, seed=seed)
    log = log.rectified() if rectified else log
    found = before(log, "kr5")
    assert (found.kind, found.sure) == ("robot", True)
    assert "kr5r650" in found.message
    assert "`robot` kr5r650" in found.remedy
    assert before(log, "kr5r650") is None
    paper = times(log, {1: -1.0}, {1: 1.0 if rectified else -1.0})
    paper = replace(paper, q=paper.q + np.array([0.0, 0.5, -0.5, 0.0, 0.0, 0.0]) * np.pi)
    assert before(paper, "kr5-paper") is None
    assert before(paper, "kr5r650").remedy.endswith("if so, give `robot` kr5-paper")


@pytest.mark.parametrize("joints", [range(1, 7), [3]])
def test_torques_that_count_the_other_way_show_where_signs_are_known(joints):
    log = times(signed_log(), effort=dict.fromkeys(joints, -1.0))
    found = before(log)
    assert (found.kind, found.sure) == ("direction", True)
    assert ("tau=-tau" if len(joints) == 6 else "tau3=-tau3") in found.remedy
    assert before(log.rectified()) is None, "it does not matter to |torque|"


def test_efforts_that_are_no_robots_or_none_of_the_motion():
    log = signed_log()
    large = before(times(log, effort=dict.fromkeys(range(1, 7), 1e3)).rectified())
    assert (large.kind, large.sure) == ("scale", False)
    assert "1000 times" in large.message
    noise = replace(log, effort=np.random.default_rng(0).standard_normal(log.effort.shape))
    for one in (noise, noise.rectified()):
        assert before(one).kind == "motion"


@pytest.mark.parametrize("name", ["kr5", "ur10e", "panda"])
def test_nothing_is_named_of_a_right_log(name):
    log = signed_log(name, noise=0.05, seed=8)
    assert before(log, name) is None
    assert before(log.rectified(), name) is None


@pytest.mark.parametrize("effect", ["gravity_spring", "base_tilt", "gain_error", "dead_zone"])
def test_a_hidden_effect_is_no_misreading(effect):
    case = blind.simulate(10, effect, 8.0)
    robot, log = robot_from_table(case.robot.table, "blind"), case.log
    signed = Log(log.t, log.q, log.measured, np.ones(log.q.shape[1], dtype=bool))
    assert before(signed, robot) is None
    assert before(signed.rectified(), robot) is None


def test_what_is_surely_misread_is_refused_with_what_mends_it(tmp_path):
    """Unless it is wanted anyway; what is said to mend it does."""
    log, path = signed_log(), tmp_path / "log.csv"
    moved(log, (2, 1, 0, 3, 4, 5)).rectified().save(path)
    quick = {"complete": "off", "search": Certified(budget=0.1), "posterior": False}
    with pytest.raises(InputError, match="joints 1 and 3 exchanged") as refused:
        identify("kr5", read_log(path), **quick)
    assert "`anyway`" in refused.value.remedy
    correct = refused.value.remedy.split("`correct` ")[1].split(", or")[0]
    mended = read_log(path, correct=correct)
    np.testing.assert_allclose(mended.q, log.q, atol=1e-9)
    np.testing.assert_allclose(mended.effort, np.abs(log.effort), atol=1e-9)
    assert before(mended) is None


@pytest.mark.real
@pytest.mark.parametrize("name", ["ur10e/b_20s", "panda/a", "tx40/a", "kr300/a", "dualarm/a", "lwr4/a", "tiago/a"])
def test_nothing_is_named_of_real_logs_before_the_search(name):
    path = real_log(f"{name}.csv")
    robot, log = load_robot(next(path.parent.glob("robot.*"))), read_log(path)
    assert before(log, robot) is None
    assert before(log.rectified(), robot) is None


@pytest.mark.real
@pytest.mark.parametrize("name", ["ur10e/b_20s", "tx40/a"])
def test_torques_of_a_real_robot_that_count_the_other_way(name):
    """Many other readings leave as much by least squares, each a little less by chance; none is feasible."""
    path = real_log(f"{name}.csv")
    robot, log = load_robot(next(path.parent.glob("robot.*"))), read_log(path)
    found = before(replace(log, effort=-log.effort), robot)
    assert (found.kind, found.sure) == ("direction", True)
    assert "tau=-tau" in found.remedy


REAL = {
    "turned": (lambda log: moved(log, factor=[1.0, -1.0, 1.0, 1.0, 1.0, 1.0]), "q2=-q2,tau2=-tau2"),
    "exchanged": (lambda log: moved(log, (0, 2, 1, 3, 4, 5)), "q2=q3,q3=q2,tau2=tau3,tau3=tau2"),
    "zeros": (lambda log: replace(log, q=log.q + 0.5 * np.pi * np.eye(6)[1]), "q2=q2-1.5708"),
    "N mm": (lambda log: times(log, effort={2: 1e3}), "tau2=0.001*tau2"),
    "N mm of a joint that carries little": (lambda log: times(log, effort={5: 1e3}), "tau5=0.001*tau5"),
}


@pytest.mark.real
@pytest.mark.parametrize("how", REAL)
@pytest.mark.parametrize("name", ["ur10e/b_20s", "tx40/a"])
def test_misread_logs_of_real_robots_whose_signs_are_hidden(name, how):
    """The TX40's joint 5 leaves 16 % by any reading: other joints must count as much."""
    path, (misread, correct) = real_log(f"{name}.csv"), REAL[how]
    robot, log = load_robot(next(path.parent.glob("robot.*"))), read_log(path)
    found = before(misread(log).rectified(), robot)
    assert correct in found.remedy
    assert found.sure or how == "zeros" or (name, how) == ("tx40/a", "N mm")


@pytest.mark.real
def test_two_zeros_of_a_real_robot_that_are_off_together():
    path = real_log("ur10e/b_20s.csv")
    robot, log = load_robot(path.with_name("robot.toml")), read_log(path)
    found = before(replace(log, q=log.q + 0.5 * np.pi * np.array([0, 1, 0, 1, 0, 0])).rectified(), robot)
    assert "q2=q2-1.5708,q4=q4-1.5708" in found.remedy
