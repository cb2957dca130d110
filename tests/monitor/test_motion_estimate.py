import numpy as np
import pytest

from bayesid.monitor.motion_estimate import MotionWindow

RATE = 100.0


def run(window, t, values, at=0.0):
    """The motion at the time of each sample minus a lag, once it is known."""
    found = []
    for instant, row in zip(t, values, strict=True):
        window.add(float(instant), row)
        local = window.fit()
        if local is not None:
            found.append((instant - at, *local.at(float(instant - at))))
    return [np.array(part) for part in zip(*found, strict=True)]


def cubic(t):
    """(N, 2) positions of two joints, with their derivatives."""
    a, b = np.polynomial.Polynomial([0.3, -1.0, 0.7, 0.2]), np.polynomial.Polynomial([-0.1, 0.4, -0.3, -0.5])
    return [np.stack([p.deriv(k)(t) if k else p(t) for p in (a, b)], axis=1) for k in range(3)]


def jittered(samples, seed=0):
    return np.arange(samples) / RATE + np.random.default_rng(seed).uniform(-0.3, 0.3, samples) / RATE


@pytest.mark.parametrize(
    ("lag", "velocities", "accelerations"), [(0.0, False, False), (0.05, True, False), (0.05, True, True)]
)
def test_cubics_are_followed_without_delay(lag, velocities, accelerations):
    t = jittered(80)
    q, dq, ddq = cubic(t)
    parts = [q, *[dq] * velocities, *[ddq] * accelerations]
    found = run(MotionWindow(2, 0.2, RATE, velocities, accelerations), t, np.hstack(parts), lag)
    for value, expected in zip(found[1:], cubic(found[0]), strict=True):
        np.testing.assert_allclose(value, expected, atol=1e-7)


@pytest.mark.parametrize("velocities", [False, True])
def test_the_variance_of_the_acceleration_is_that_of_its_errors(velocities):
    rng = np.random.default_rng(1)
    t = np.arange(4000) / RATE
    size = 1e-3 if velocities else 1e-4
    window, found, stated = MotionWindow(1, 0.2, RATE, velocities, False), [], []
    for instant in t:
        noise = size * rng.standard_normal(1)
        window.add(float(instant), np.concatenate([np.zeros(1), noise]) if velocities else noise)
        local = window.fit()
        if local is not None and instant > 3.0:
            found.append(local.at(float(instant))[2][0])
            stated.append(local.variance_of_acceleration(float(instant))[0])
    ratio = np.sqrt(np.mean(stated)) / np.std(found)
    assert 0.85 < ratio < 1.15, ratio  # 3700 samples, 20 of which count as one: 5 %


def test_samples_older_than_the_window_have_no_effect():
    t = np.arange(100) / RATE
    one, other = (
        run(MotionWindow(1, 0.2, RATE, False, False), t, values)
        for values in (np.sin(t)[:, None], np.where(t < 0.5, 7.0, np.sin(t))[:, None])
    )
    np.testing.assert_allclose(one[3][-20:], other[3][-20:], atol=1e-9)
