"""What is put right of a log's joints as it is read."""

import numpy as np
import pytest

from bayesid.errors import InputError
from bayesid.log.reading import read_log, read_motion

T = np.arange(200) / 100.0
LOG = {
    "t": T,
    "q": np.column_stack([np.sin(T), np.cos(3.0 * T), np.sin(2.0 * T)]),
    "dq": np.column_stack([np.cos(T), -3.0 * np.sin(3.0 * T), 2.0 * np.cos(2.0 * T)]),
    "tau": np.column_stack([5.0 * np.sin(4.0 * T), np.abs(7.0 * np.cos(5.0 * T)), 3.0 * np.cos(T)]),
}


def test_joints_are_exchanged_turned_scaled_and_shifted():
    log = read_log(LOG, correct="q1=-q3, q3=q1 + 1.5, tau1=0.001*tau3,i3=-i1")
    np.testing.assert_allclose(log.q, np.column_stack([-LOG["q"][:, 2], LOG["q"][:, 1], LOG["q"][:, 0] + 1.5]))
    np.testing.assert_allclose(log.dq, np.column_stack([-LOG["dq"][:, 2], LOG["dq"][:, 1], LOG["dq"][:, 0]]))
    effort = np.column_stack([1e-3 * LOG["tau"][:, 2], LOG["tau"][:, 1], -LOG["tau"][:, 0]])
    np.testing.assert_allclose(log.effort, effort)
    assert log.signed.tolist() == [True, False, True]
    assert log.read_with["correct"] == "q1=-q3, q3=q1 + 1.5, tau1=0.001*tau3,i3=-i1"


def test_all_joints_at_once_and_signs_that_move_with_their_efforts():
    turned = read_log(LOG, unsigned="none", correct="tau=-tau,q=-q")
    np.testing.assert_allclose(turned.effort, -LOG["tau"])
    np.testing.assert_allclose(turned.q, -LOG["q"])
    moved = read_log(LOG, correct="tau1=tau2,tau2=-tau1")
    assert moved.signed.tolist() == [False, True, True]
    assert (read_log(LOG, correct="tau2=-tau2").effort[:, 1] >= 0.0).all(), "an absolute value stays one"


def test_a_motion_has_its_positions_corrected():
    motion = read_motion(LOG, correct="q2=-q2,tau1=-tau1")
    np.testing.assert_allclose(motion.q[:, 1], -LOG["q"][:, 1])


@pytest.mark.parametrize(
    "wrong",
    [
        "",
        "q1",
        "q1=tau1",
        "q=q1",
        "q1=q",
        "q4=q1",
        "q1=q9",
        "tau1=tau1+2",
        "q1=q2,q1=q3",
        "q1=0*q1",
        "dq1=-dq1",
        "q2=q2+90grad",
    ],
)
def test_what_cannot_be_understood_is_refused(wrong):
    with pytest.raises(InputError) as refused:
        read_log(LOG, correct=wrong)
    assert refused.value.field == "correct"
    assert refused.value.remedy


def test_a_shift_may_be_in_degrees():
    shifted, plain = (read_log(LOG, correct=f"q2=q2-{zero}").q for zero in ("90deg", repr(0.5 * np.pi)))
    np.testing.assert_allclose(shifted, plain)


@pytest.mark.parametrize(
    ("half", "whole"),
    [("q2=q3", "q2=q3,q3=q2"), ("q1=q2,q2=q3", "q1=q2,q2=q3,q3=q1"), ("q1=q3,q3=q1,tau1=tau3", "tau1=tau3,tau3=tau1")],
)
def test_half_of_an_exchange_is_refused_with_the_whole(half, whole):
    with pytest.raises(InputError) as refused:
        read_log(LOG, correct=half)
    assert refused.value.remedy.endswith(whole)
    read_log(LOG, correct=whole)
