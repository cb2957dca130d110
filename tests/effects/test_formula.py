"""A learned function in words."""

import numpy as np
import pytest

from bayesid.effects.axes import Axis, Component, Family, Quantity
from bayesid.effects.formula import described

POSITION, VELOCITY, LOAD, TIME = Quantity.POSITION, Quantity.VELOCITY, Quantity.LOAD, Quantity.TIME
Q2 = Axis(POSITION, 2, Family.PERIODIC, -1.0, 0.6, 2.0, 2)
Q6 = Axis(POSITION, 6, Family.PERIODIC, -0.4, 1.5, 3.0, 2)
TURNING = Axis(VELOCITY, 5, Family.DIRECTION, -1.0, 1.4, 0.02, 1)


def told(joint, *parts):
    components = [Component(axes, np.eye(len(amplitude))) for axes, amplitude in parts]
    return described(joint, components, [np.array(amplitude) for _, amplitude in parts])


def test_product_of_two_sines():
    """0.21 sin(3 q6 + 0.7) cos(2 q2)."""
    waves = 0.21 * np.outer([1.0, 0.0], [np.sin(0.7), np.cos(0.7)]).ravel()
    words = told(4, ((Q2, Q6), waves))
    assert words.variables == ("q2", "q6")
    value, rest = words.formula.split(" ", 1)
    assert rest in ("sin(2 q2 + 1.6) sin(3 q6 + 0.7) N m", "sin(2 q2 - 1.6) sin(3 q6 - 2.4) N m")
    assert value == "0.21"
    assert words.depends == "the positions of joints 2 and 6"
    assert "not a friction effect" in words.families
    assert "repeats 3 times in a turn of joint 6" in words.families


def test_friction_is_odd_in_the_joints_own_speed():
    raised = Axis(POSITION, 3, Family.PERIODIC, -3.0, 2.5, 1.0, 3)
    words = told(5, ((raised, TURNING), [0.5, 0.0, 0.3]))
    assert words.formula == "0.3 (sin(q3) + 1.7) sign(dq5) N m"
    assert words.depends == "the position of joint 3 and the direction of motion of joint 5"
    assert words.families[0] == "odd in the speed of joint 5, as friction is"
    elsewhere = told(2, ((raised, TURNING), [0.5, 0.0, 0.3]))
    assert elsewhere.families[0] == "not a friction effect"
    even = told(5, ((Axis(VELOCITY, 5, Family.POWER, -1.0, 1.4, 2.0, 1),), [0.4]))
    assert even.formula == "0.4 dq5^2 N m"
    assert not even.families


def test_loads_and_what_fades_with_time():
    speed = Axis(VELOCITY, 5, Family.ODD, -1.0, 1.4, 1.0, 1)
    load = Axis(LOAD, 5, Family.EVEN, -30.0, 40.0, 1.0, 1)
    fading = Axis(TIME, 0, Family.FADING, 0.0, 20.0, 6.0, 2)
    words = told(5, ((speed, load), [-0.03]), ((speed, fading), [0.0, 1.2]))
    assert words.formula == "(-0.03 dq5 |dq5| |tau5| + 1.2 exp(-t / 6 s) dq5 |dq5|) N m"
    assert words.depends == "the speed of joint 5, the load of joint 5 and the time since the recording began"
    assert words.families[1] == "exponential in time, over 6 s, as a joint that warms up"


@pytest.mark.parametrize(
    ("effort", "formula"),
    [
        (lambda x: 0.8 * np.sin(2.0 * x + 0.5), "0.8 sin(2 q1 + 0.5) N m"),
        (lambda x: 3.0 * (x - 0.4), "3 (q1 - 0.4) N m"),
        (lambda x: np.exp(-30.0 * (x - 0.2) ** 2) - np.exp(-40.0 * (x + 0.6) ** 2), "0.43 f(q1) N m"),
    ],
)
def test_a_smooth_function_is_told_by_the_plainest_that_is_nearly_it(effort, formula):
    axis = Axis(POSITION, 1, Family.SMOOTH, -1.2, 1.0, 0.0, 14)
    x = np.linspace(-1.2, 1.0, 300)
    amplitudes = np.linalg.lstsq(axis.columns(x), effort(x), rcond=None)[0]
    words = told(1, ((axis,), amplitudes))
    assert words.formula == formula
    assert words.variables == ("q1",)
