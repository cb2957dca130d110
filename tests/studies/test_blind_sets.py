"""Simulated cases by kind: torques by hand, sets in their joints, wrong tables, errors in all logs."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayesid.studies import blind, blind_forms, blind_sets
from bayesid.studies.blind import BEFORE
from bayesid.studies.blind_sets import KINDS, NOTHING, TABLE

T = np.array([0.0, 2.5, 9.0])
Q = np.array([[0.3, -0.7, 1.1], [-0.4, 0.5, 0.2], [0.9, -1.2, -0.6]])
DQ = np.array([[1.5, -0.6, 0.4], [-0.8, 1.1, -0.3], [0.2, 0.5, -2.0]])
DDQ = np.array([[-3.0, 0.4, 1.0], [2.0, -5.0, 0.7], [0.1, 0.2, -0.9]])
RIGID = np.array([[-12.0, 7.0, 1.0], [9.0, -3.0, 0.5], [4.0, 5.0, -0.2]])


def play_of(**arrays):
    """A play with these samples, and others ahead of the log."""
    before = {
        name: np.concatenate([np.full_like(x, 7.7, shape=(BEFORE, *x.shape[1:])), x]) for name, x in arrays.items()
    }
    return SimpleNamespace(**before, robot=SimpleNamespace(n=3))


PLAY = play_of(t=T, q=Q, dq=DQ, ddq=DDQ, rigid=RIGID)
BY_HAND = {
    "worn_region": lambda x, q, p, dq, dp: np.exp(-0.5 * (q - x["centre"]) ** 2 / x["width"] ** 2) * np.sign(dq),
    "quadratic_drag": lambda x, q, p, dq, dp: np.sign(dq) * dq**2,
    "cubic_drag": lambda x, q, p, dq, dp: dq * dq * dq,
    "eccentric_gear": lambda x, q, p, dq, dp: dq + dq * np.cos(2 * q + x["phase"] - np.pi / 2),
    "detent": lambda x, q, p, dq, dp: np.sin(2 * q + x["phase"] + np.pi / 2),
    "crossed_detent": lambda x, q, p, dq, dp: np.sin(3 * p + x["phase"]) * (1 - 2 * np.sin(q) ** 2),
    "friction_by_other_speed": lambda x, q, p, dq, dp: np.sign(dq) * np.sqrt(dp**2),
    "soft_stop": lambda x, q, p, dq, dp: x["side"] * np.exp(-abs(x["end"] - x["side"] * q) / x["width"]),
    "hose": lambda x, q, p, dq, dp: np.sign(q + p - x["rest"]) * (q + p - x["rest"]) ** 2,
    "cable_past_other": lambda x, q, p, dq, dp: (p > x["taut"]) * (p - x["taut"]) * np.sin(q - x["middle"]),
    "wind_of_other": lambda x, q, p, dq, dp: np.sign(dp) * dp**2,
}


def drawn(form, seed=4, j=1):
    """Shape and parameters of a form in joint j, and the other joint."""
    draft = blind_forms.draft_of(form, np.random.default_rng(seed), PLAY, j)
    torque = draft.act(PLAY, np.zeros_like(PLAY.q), 1.0)[BEFORE:]
    assert not np.delete(torque, j, axis=1).any(), "in this joint only"
    return torque[:, j] * draft.parameters["sign"], draft.parameters, draft.parameters["other_joint"] - 1


def test_shapes_of_forms_by_hand():
    for form, by_hand in BY_HAND.items():
        shape, parameters, k = drawn(form)
        expected = by_hand(parameters, Q[:, 1], Q[:, k], DQ[:, 1], DQ[:, k])
        np.testing.assert_allclose(shape, expected, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(drawn("loaded_drag")[0], [-7.0 * 0.6, 3.0 * 1.1, 5.0 * 0.5])
    np.testing.assert_allclose(drawn("accelerating_only")[0], [0.4, 5.0, 0.2])
    shape, x, _ = drawn("slow_wave")
    np.testing.assert_allclose(shape, np.imag(np.exp(1j * (2 * np.pi * x["frequency"] * T + x["phase"]))))
    shape, x, _ = drawn("beat")
    beat = 2 * np.sin(2 * np.pi * x["frequency"] * T) * np.cos(2 * np.pi * x["apart"] * T)
    np.testing.assert_allclose(shape, beat, atol=1e-12)
    shape, x, _ = drawn("slipped_once")
    grown = [(t - x["start"]) / x["length"] for t in T]
    np.testing.assert_allclose(shape, [g if 0 <= g < 1 else 0.0 for g in grown])


@pytest.mark.parametrize("kind", KINDS)
def test_cases_of_a_kind_hide_what_they_say(kind):
    case = blind_sets.of_kind(kind, 1, 11)[0]
    logs, size = blind_sets.simulate(case)
    assert tuple(effect.name for effect in logs.hidden) == case.effects
    joints = [effect.draft.joint for effect in logs.hidden]
    if kind in (blind_sets.PAIRS_TOGETHER, blind_sets.SENSOR):
        assert joints[0] == joints[1] is not None
    if kind in (blind_sets.PAIRS_APART, blind_sets.TRIPLES):
        assert joints[0] != joints[1] or joints[0] is None
    changes = {}
    for number, name in enumerate(("baseline", "log", "holdout")):
        change = getattr(logs, name).clean - logs.plays[number].healthy()[BEFORE:]
        changes[name] = blind.rms(change) / logs.noise
    assert not changes["baseline"].any()
    assert changes["log"].any() == (bool(case.effects) and kind != blind_sets.HOLDOUT_ONLY)
    assert changes["holdout"].any() == (bool(case.effects) and kind != blind_sets.LOG_ONLY)
    if len(case.effects) == 1:
        seen = changes["holdout" if kind == blind_sets.HOLDOUT_ONLY else "log"]
        assert seen.max() == pytest.approx(size, rel=blind.TOLERANCE)
        assert size >= 3.0
    if kind == NOTHING:
        assert size == 0.0


def test_the_table_that_is_off_is_that_of_log_and_holdout():
    """Against MuJoCo's efforts of the robot of the changed table; the stated table is the baseline's."""
    logs, _ = blind_sets.simulate(blind_sets.of_kind(TABLE, 1, 4)[0])
    (effect,) = logs.hidden
    x, play = effect.draft.parameters, logs.plays[1]
    joints = [dict(row) for row in logs.table["joints"]]
    assert joints == logs.robot.table["joints"]
    joints[x["row"] - 1][x["number"]] += x["value"]
    assert abs(x["value"]) == pytest.approx(0.005 if x["number"] in "ad" else np.deg2rad(0.5))
    other = replace(logs.robot, table={**logs.table, "joints": joints})
    expected = play.under(other).healthy() - play.rigid + other.rigid_efforts(play.q, play.dq, play.ddq)
    np.testing.assert_allclose(logs.log.clean, expected[BEFORE:], atol=1e-9)
