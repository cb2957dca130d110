"""The study `poor`: efforts that its generator adds to rigid bodies, and a row of one trial."""

from dataclasses import replace

import numpy as np
import pytest

from bayesid.studies import blind, poor, poor_arms
from bayesid.studies.poor_arms import ARMS, CURRENTS, EFFECTS, SENSORS
from tests.studies.reported import reported


def noiseless(monkeypatch, arm, effects, seed):
    """A case without noise, and a healthy arm."""
    monkeypatch.setattr(poor_arms, "NOISE", (0.0, 0.0))
    return poor_arms.make_case(arm, effects, seed), poor_arms.make_case(arm, (), seed)


def speed_of(case):
    """(M, n) central differences."""
    return np.gradient(case.q, case.t, axis=0)


def test_a_turned_base_turns_gravity_the_other_way():
    turned = poor_arms.tilted(np.array([0.0, 0.0, -9.81]), 0.0, np.deg2rad(30.0))
    np.testing.assert_allclose(turned, [0.0, -9.81 * 0.5, -9.81 * np.sqrt(0.75)], atol=1e-12)


def test_a_tilted_base_acts_by_gravity_alone(monkeypatch):
    case, healthy = noiseless(monkeypatch, SENSORS, ("base_tilt",), 3)
    ((name, joints, numbers),) = case.hidden
    assert (name, joints) == ("base_tilt", ())
    assert 0.5 <= numbers["degrees"] <= 3.0
    arm = poor_arms.bare_arm(blind.stream(3, 0), SENSORS)
    gravity = poor_arms.tilted(blind.GRAVITY, numbers["heading"], np.deg2rad(numbers["degrees"]))
    table = {**arm.table, "gravity": gravity.tolist()}
    still = np.zeros_like(case.q)
    held = [replace(arm, table=one).rigid_efforts(case.q, still, still) for one in (table, arm.table)]
    np.testing.assert_allclose(case.effort - healthy.effort, held[0] - held[1], atol=1e-9)
    assert np.any(case.effort[:, 0] != healthy.effort[:, 0]), "joint 1 holds weight by now"


@pytest.mark.parametrize("arm", ARMS)
def test_a_torque_of_three_harmonics_acts_in_one_joint(monkeypatch, arm):
    case, healthy = noiseless(monkeypatch, arm, ("position_torque",), 4)
    ((_, (joint,), numbers),) = case.hidden
    added, q = case.effort - healthy.effort, case.q[:, joint - 1]
    assert not np.delete(added, joint - 1, axis=1).any()
    (a, b, c), (x, y, z) = numbers["amplitudes"], numbers["phases"]
    by_hand = np.imag(a * np.exp(1j * (q + x)) + b * np.exp(1j * (2 * q + y)) + c * np.exp(1j * (3 * q + z)))
    np.testing.assert_allclose(added[:, joint - 1], by_hand, atol=1e-9)
    share = blind.rms(by_hand) / blind.rms(healthy.effort[:, joint - 1])
    assert share == pytest.approx(numbers["share"])
    assert 0.3 <= share <= 1.0


def test_overcompensated_drives_push_in_the_direction_of_motion(monkeypatch):
    case, healthy = noiseless(monkeypatch, CURRENTS, ("overcompensated_friction",), 2)
    joints = [joint for _, (joint,), _ in case.hidden]
    assert 1 <= len(joints) <= 3
    dq = speed_of(case)[1:-1]
    arm = poor_arms.with_joints(*_drawn(CURRENTS, 2))
    for _, (joint,), numbers in case.hidden:
        j = joint - 1
        scale = blind.rms(healthy.effort[:, j])
        slope = numbers["viscous"] * scale / blind.rms(dq[:, j])
        assert -1.5 <= numbers["viscous"] < 0.0 < numbers["coulomb"]
        own = slope * dq[:, j] + numbers["coulomb"] * scale * np.sign(dq[:, j])
        instead_of = arm.viscous[j] * dq[:, j] + arm.coulomb[j] * np.sign(dq[:, j])
        fast = np.abs(dq[:, j]) > 0.05  # differences are not exact where the joint turns round
        added = (case.effort - healthy.effort)[1:-1, j]
        np.testing.assert_allclose(added[fast], (own - instead_of)[fast], atol=0.01 * scale)
    assert not np.delete(case.effort - healthy.effort, [j - 1 for j in joints], axis=1).any()


def _drawn(arm, seed):
    """Arguments of `with_joints` for a case."""
    rng = blind.stream(seed, 0)
    robot = poor_arms.bare_arm(rng, arm)
    rate = int(rng.integers(50, 101))
    t = np.arange(round(rng.uniform(20.0, 30.0) * rate)) / rate
    q, dq, ddq = blind.random_series(blind.stream(seed, 1), robot.n, slow=False)(t)
    return blind.stream(seed, 2), robot, arm, robot.rigid_efforts(q, dq, ddq), dq, ddq


def test_small_efforts_of_one_joint_read_zero():
    case, healthy = (poor_arms.make_case(SENSORS, effects, 5) for effects in (("dead_zone",), ()))
    ((_, (joint,), numbers),) = case.hidden
    read, effort = case.effort[:, joint - 1], healthy.effort[:, joint - 1]
    below = np.abs(effort) < numbers["share"] * blind.rms(effort)
    assert below.any()
    assert not read[below].any()
    np.testing.assert_array_equal(read[~below], effort[~below])
    np.testing.assert_array_equal(*(np.delete(one.effort, joint - 1, axis=1) for one in (case, healthy)))


def test_a_short_plan_has_each_effect_alone_on_both_arms():
    scenarios = [scenario for scenario, _ in poor.plan(8, 0)]
    assert {(s.effects, s.arm) for s in scenarios} == {((effect,), arm) for effect in EFFECTS for arm in ARMS}
    assert len({scenario for scenario, _ in poor.plan(20, 0)}) == 20


def row_of(**changes):
    """A row of a case in which all is well."""
    row = {
        "trial": 0,
        "seed": 7,
        "effects": ["base_tilt"],
        "arm": SENSORS,
        "right": 0.999,
        "joints_right": [1.0, 0.998],
        "sure": 1000,
        "sure_wrong": 0,
        "hidden": ["base_tilt"],
        "named": ["base_tilt"],
        "equivalent": [],
        "residual": [0.05, 0.04],
        "certified": True,
        "timings": {"identify": 10.0},
    }
    return row | changes


def test_the_report_says_what_a_failing_case_lacks():
    failing = row_of(trial=1, right=0.9, joints_right=[1.0, 0.8], named=["joint_spring 2"], sure_wrong=5)
    text = reported(poor.STUDY, [row_of(), failing])
    assert poor.figures([row_of(), failing]) == {
        "right": 0.5,
        "named": 0.5,
        "by_name": 0.5,
        "clean": 0.5,
        "wrong": 5 / 2000,
        "seconds": 10.0,
    }
    assert "trial 0" not in text
    reason = (
        "signs 90.0 %: joint 2 80.0 % (residual 4 %); not named: base_tilt; other effects named: joint_spring 2; 5 of"
    )
    assert f"trial 1, seed 7, base_tilt alone, {SENSORS}: {reason}" in text


def test_what_looks_like_a_hidden_effect_stands_for_it_once():
    row = row_of(hidden=["position_torque 5"], named=["torque_ripple 5"], equivalent=["position_torque 5"])
    figures = poor.figures([row])
    assert (figures["named"], figures["by_name"], figures["clean"]) == (1.0, 0.0, 1.0)
    assert poor.figures([row | {"named": ["torque_ripple 5", "gravity_spring 5"]}])["clean"] == 0.0


@pytest.mark.long
def test_one_trial():
    row = poor.trial(poor.Scenario(("dead_zone",), CURRENTS), 0)
    assert row["right"] > 0.9
    assert len(row["joints_right"]) == len(row["residual"]) == 6
    assert row["sure"] > 0
    assert row["hidden"][0].startswith("dead_zone ")
    assert row["timings"]["identify"] > 0.0


def test_one_torque_of_three_harmonics_is_not_named_as_two_effects():
    """A spring and a ripple, chosen one after the other, stand for it; it alone explains as much."""
    row = poor.trial(*poor.plan(3, 0)[2])
    assert row["hidden"] == row["named"] == ["position_torque 5"]
    assert row["right"] > 0.999
