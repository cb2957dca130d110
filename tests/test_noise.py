import numpy as np
import pytest

from bayesid.noise import autocovariance, integrated_time, relative_rms, residual_noise


def ar1(phi, n, seed=0):
    rng = np.random.default_rng(seed)
    x = np.empty(n)
    x[0] = rng.standard_normal()
    for i in range(1, n):
        x[i] = phi * x[i - 1] + np.sqrt(1 - phi**2) * rng.standard_normal()
    return x


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9])
def test_integrated_time_of_an_ar1_process(phi):
    """Closed form: (1 + phi) / (1 - phi)."""
    found = np.mean([integrated_time(autocovariance(ar1(phi, 20000, s), np.ones(20000, bool), 400)) for s in range(5)])
    assert found == pytest.approx((1 + phi) / (1 - phi), rel=0.15)


def test_white_and_coloured_parts_are_told_apart():
    n, rate = 60000, 250.0
    coloured = 2.0 * ar1(np.exp(-1 / (0.1 * rate)), n, 3)
    white = 0.7 * np.random.default_rng(4).standard_normal(n)
    noise = residual_noise((coloured + white)[:, None], np.ones((n, 1), bool), rate)
    assert noise.coloured[0] == pytest.approx(2.0 * np.exp(-0.5 * 0.02 / 0.1), rel=0.1)
    assert noise.sigma[0] == pytest.approx(np.hypot(2.0, 0.7), rel=0.1)
    assert noise.correlation[0] == pytest.approx(0.1, rel=0.3)


def test_unused_samples_do_not_count():
    n = 5000
    values = ar1(0.8, n, 1)
    used = np.ones(n, bool)
    used[1000:1500] = False
    spoiled = values.copy()
    spoiled[~used] = 1e6
    np.testing.assert_allclose(autocovariance(spoiled, used, 50), autocovariance(np.where(used, values, 7.0), used, 50))


def test_relative_rms():
    effort = np.array([[3.0, 1.0], [4.0, 100.0]])
    used = np.array([[True, True], [True, False]])
    np.testing.assert_allclose(relative_rms(0.1 * effort, effort, used), [0.1, 0.1])
    assert relative_rms(np.array([[0.0], [5.0]]), np.array([[3.0], [4.0]]), np.ones((2, 1), bool)) == pytest.approx(1.0)
