"""Logs with one fault each: found, named with joint and time, and left out; logs without one are left as they are."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import real_log
from simulated_arms import STRONG, arm_with_friction

from bayesid.identification.pipeline import identify
from bayesid.log.faults import find_faults
from bayesid.log.log import Log
from bayesid.log.reading import read_log
from bayesid.log.signals import prepare
from bayesid.motion import Motion
from bayesid.simulation.logs import simulate

ROWS = slice(412, 419)
"""60 ms of the simulated log, in which all joints move."""


@pytest.fixture(scope="module")
def log():
    return arm_with_friction(0.7).log()


def changed(log, reading, rows, joint, values) -> Log:
    channel = getattr(log, reading).copy()
    channel[rows, joint] = values
    return replace(log, **{reading: channel})


def named(log) -> list[tuple[int, str, str, list[int]]]:
    """Joint (from 1), reading, kind and rows of what is found in a log without repeated rows."""
    found = find_faults(log.t, log.q, log.effort, log.dq)
    return [(fault.joint + 1, fault.reading, fault.kind, fault.rows.tolist()) for fault in found]


def strong_rows(log, joint, count=3) -> list[int]:
    """Rows in the middle of the log, far apart, in which the effort is about its typical one."""
    effort = log.effort[:, joint]
    inner = [i for i in range(100, 700, 40) if effort[i] > 0.7 * np.median(effort)]
    return inner[:count]


def test_a_log_without_faults_stays_as_it_is(log):
    assert named(log) == []
    assert named(replace(log, effort=np.round(log.effort, 1))) == [], "coarse currents"


@pytest.mark.real
@pytest.mark.parametrize("name", ["dualarm/a", "kr300/a", "lwr4/a", "panda/a", "tx40/a", "ur10e/c_loaded"])
def test_nothing_is_found_in_real_logs(name):
    log = read_log(real_log(f"{name}.csv"))
    for one in (log, log.rectified()):
        signals = prepare(one)
        assert signals.faults == ()
        assert signals.measured.all()


@pytest.mark.parametrize("reading", ["effort", "q"])
def test_outliers_are_named_with_joint_and_time(log, reading):
    joint, rows = 1, strong_rows(log, 1)
    bad = changed(log, reading, rows, joint, 10.0 * getattr(log, reading)[rows, joint])
    what = "effort" if reading == "effort" else "position"
    assert named(bad) == [(2, what, "outlier", rows)]
    pair = [rows[0], rows[0] + 1]
    assert named(changed(log, reading, pair, 1, 10.0 * getattr(log, reading)[pair, 1]))[0][3] == pair
    line = str(prepare(bad).faults[0])
    assert line.startswith(f"joint 2: 3 samples of the {what} far from neighbouring samples, at {log.t[rows[0]]:.3f}, ")


def test_an_outlier_leaves_no_trace_in_the_signals(log):
    """The effort is left out, its neighbours are not; the position is what a spline through its neighbours says."""
    rows = strong_rows(log, 1)
    clean = prepare(log)
    signals = prepare(changed(log, "effort", rows, 1, 10.0 * log.effort[rows, 1]))
    assert np.flatnonzero(~signals.measured[:, 1]).tolist() == rows
    assert signals.measured[:, [0, 2]].all()
    assert np.abs(signals.effort - clean.effort).max() < 0.2 * log.effort[:, 1].std()
    signals = prepare(changed(log, "q", rows, 1, 10.0 * log.q[rows, 1]))
    assert signals.measured.all()
    assert np.abs(signals.motion.ddq - clean.motion.ddq).max() < 1e-3 * np.abs(clean.motion.ddq).max()


@pytest.mark.parametrize("rows", [3, 6, 12, 30])
def test_a_position_that_leaves_and_comes_back_by_jumps(log, rows):
    q = np.array(log.q)
    q[40 : 40 + rows, 1] += 0.7
    q[100:102, 1] = [3.0, -2.0]
    signals, right = prepare(replace(log, q=q)), prepare(log)
    assert [(one.joint, one.reading, one.kind) for one in signals.faults] == [(1, "position", "outlier")]
    assert set(range(40, 40 + rows)) | {100, 101} == set(signals.faults[0].rows.tolist())
    known = signals.measured[:, 1]
    np.testing.assert_allclose(signals.motion.dq[known, 1], right.motion.dq[known, 1], atol=0.02)


def test_dropouts(log):
    zero = changed(log, "effort", ROWS, 2, 0.0)
    assert named(zero) == [(3, "effort", "zero", list(range(412, 419)))]
    held = changed(log, "effort", ROWS, 0, log.effort[411, 0])
    assert named(held) == [(1, "effort", "held", list(range(412, 419)))]
    assert str(prepare(held).faults[0]).startswith("joint 1: effort is frozen in motion, 0.07 s in all, from 4.120 s")
    held = changed(log, "q", ROWS, 0, log.q[411, 0])
    assert named(held) == [(1, "position", "held", list(range(412, 419)))]
    assert np.abs(prepare(held).motion.q - prepare(log).motion.q).max() < 1e-3 * np.ptp(log.q[:, 0])


def test_a_joint_that_freezes_for_good(log):
    """Its position is unknown from then on, and so is what any joint ought to need."""
    fast = 200 + int(np.argmax(np.abs(np.gradient(log.q[200:400, 1]))))
    frozen = changed(log, "q", slice(fast, None), 1, log.q[fast, 1])
    assert named(frozen) == [(2, "position", "held", list(range(fast + 1, len(log))))]
    measured = prepare(frozen).measured
    assert not measured[fast + 1 :].any()
    assert measured[: fast - 50].all()
    stuck = changed(log, "effort", slice(300, None), 1, log.effort[299, 1])
    assert named(stuck) == [(2, "effort", "held", list(range(300, len(log))))]


def test_rows_of_zeros_are_lost_packets(log):
    """Dropped, as if they had not been recorded."""
    there = np.isin(np.arange(len(log)), np.arange(len(log))[ROWS], invert=True)[:, None]
    lost = replace(log, q=log.q * there, effort=log.effort * there)
    signals, clean = prepare(lost), prepare(log)
    assert str(signals.faults[0]).startswith("all joints: all readings are zero for 0.07 s in all, from 4.120 s on; ")
    assert np.abs(signals.motion.q - clean.motion.q).max() < 1e-3 * np.ptp(log.q)


def test_rows_that_repeat_until_positions_jump_are_dropped(log):
    """All joints in one line; a robot that rests goes on slowly."""
    held = np.arange(len(log))
    held[300:360] = 299
    frozen = replace(log, q=log.q[held], effort=log.effort[held])
    signals, right = prepare(frozen), prepare(log)
    assert [str(fault).partition(" for ")[0] for fault in signals.faults] == [
        "all joints: all readings are frozen in motion"
    ]
    known = signals.measured.all(axis=1)
    assert 0.8 < known.mean() < 0.95
    np.testing.assert_allclose(signals.motion.dq[known], right.motion.dq[known], atol=0.05)
    rests = np.maximum(np.arange(len(log)) - 60, np.minimum(np.arange(len(log)), 300))
    slow = replace(log, q=log.q[rests], effort=log.effort[rests])
    assert all(fault.reading != "row" for fault in prepare(slow).faults)


def test_what_is_no_fault(log):
    """Clipping, a dead zone, a step of friction, and a channel that is read more rarely than the log is written."""
    top = np.quantile(log.effort[:, 0], 0.8)
    assert named(changed(log, "effort", slice(None), 0, np.minimum(log.effort[:, 0], top))) == []
    weak = log.effort[:, 1] < np.quantile(log.effort[:, 1], 0.2)
    assert named(changed(log, "effort", weak, 1, 0.0)) == []
    assert named(changed(log, "effort", slice(400, None), 2, log.effort[400:, 2] + 8.0 * log.effort[:, 2].max())) == []
    rare = np.arange(len(log)) // 8 * 8
    assert named(replace(log, effort=log.effort[rare])) == []
    assert named(replace(log, q=log.q[rare])) == []


@pytest.mark.filterwarnings("error")
def test_signs_elsewhere_stay_right_where_a_joint_has_no_effort_at_all(log):
    arm = arm_with_friction(0.7)
    result = identify(arm.robot, changed(log, "effort", slice(None), 2, 0.0), posterior=False)
    right, strong = arm.right(result)
    assert right[:, :2][strong[:, :2]].mean() > 0.995
    assert (result.probability[:, 2] == 0.5).all(), "nothing is known of its signs"
    assert result.warnings[0].startswith("joint 3: effort reads exactly zero in motion, ")
    assert "joint 3: no effort recorded in motion; Fv3, Fc3, offset3" in " ".join(result.warnings)
    assert "does not excite" not in " ".join(result.warnings)
    assert not result.model_error_probability.any()


@pytest.mark.filterwarnings("error")
def test_signs_elsewhere_stay_right_where_a_joint_stands_still():
    """It does stand still: what the others need does not depend on how it was read."""
    arm, moves = arm_with_friction(0.7), np.array([1.0, 1.0, 0.0])
    whole = arm.motion
    motion = Motion(whole.t, whole.q * moves + [0.0, 0.0, 0.4], whole.dq * moves, whole.ddq * moves)
    log = simulate(arm.model, arm.theta, motion, rng=np.random.default_rng(7), noise=0.05)
    result = identify(arm.robot, log, posterior=False)
    effort = arm.model.effort(motion, arm.theta)[:, :2]
    strong = np.abs(effort) >= STRONG * np.abs(effort).max(axis=0)
    assert ((result.probability[:, :2] >= 0.5) == (effort > 0.0))[strong].mean() > 0.995
    assert result.warnings[0].startswith("joint 3 does not move in the whole log, 0.000 to 8.000 s; ")
