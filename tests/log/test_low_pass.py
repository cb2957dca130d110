"""Low-passes that |effort| may have passed, against closed forms and simulated noise."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import lfilter
from scipy.stats import norm

from bayesid.log.low_pass import AfterRectifier, LowPass, mean_magnitude

RATE = 500.0
ALL = [LowPass(order, 6.0, both) for order in (1, 2) for both in (False, True)]


def test_the_first_order_is_an_rc_element():
    """Its step response is 1 - exp(-2 pi f t), its step taken half a sample early by the bilinear transform."""
    step = np.concatenate([np.zeros(50), np.ones(200)])
    t = (np.arange(200) + 0.5) / RATE
    found = LowPass(1, 6.0, zero_phase=False).apply(step, RATE)[50:]
    np.testing.assert_allclose(found, 1.0 - np.exp(-2.0 * np.pi * 6.0 * t), atol=1e-3)


@pytest.mark.parametrize("low_pass", ALL)
def test_half_of_the_power_is_left_at_the_cutoff(low_pass):
    t = np.arange(5000) / RATE
    passed = low_pass.apply(np.sin(2.0 * np.pi * 6.0 * t), RATE)[1000:4000]
    assert np.mean(passed**2) == pytest.approx(0.125 if low_pass.zero_phase else 0.25, rel=0.01)


@pytest.mark.parametrize(("low_pass", "memory"), [*zip(ALL, (0.0, 0.97, 0.97, 0.0), strict=True)])
def test_autocovariance_is_that_of_noise_that_has_passed(low_pass, memory):
    noise = np.random.default_rng(3).standard_normal(400_000)
    noise = lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], noise)
    passed = low_pass.apply(noise, RATE)
    expected = [np.mean(passed[: len(passed) - k] * passed[k:]) for k in (0, 5, 20, 60)]
    found = low_pass.autocovariance(memory, 61, RATE)
    assert found.shape == (61,)
    np.testing.assert_allclose(found[[0, 5, 20, 60]], expected, atol=0.04 * expected[0])


def test_mean_magnitude_is_the_integral_over_the_noise():
    efforts, sd = np.array([-1.7, -0.3, 0.0, 0.2, 2.5]), 0.6
    expected = [quad(lambda x, m=m: abs(x) * norm(m, sd).pdf(x), -8, 8, points=[0.0, m])[0] for m in efforts]
    np.testing.assert_allclose(mean_magnitude(efforts, sd), expected, rtol=1e-7)


def test_readings_are_the_mean_of_noisy_ones():
    rng, t = np.random.default_rng(5), np.arange(200) / RATE
    effort = np.stack([3.0 * np.cos(9.0 * t), 1.0 - 4.0 * t], axis=1)
    low_pass, sd = LowPass(2, 12.0, zero_phase=False), np.array([0.4, 0.1])
    noisy = np.abs(effort + sd * rng.standard_normal((2000, *effort.shape)))
    expected = np.mean([low_pass.apply(one, RATE) for one in noisy], axis=0)
    found = AfterRectifier(low_pass, np.zeros_like(effort), sd).readings(effort, RATE)
    np.testing.assert_allclose(found[20:], expected[20:], atol=0.02)
