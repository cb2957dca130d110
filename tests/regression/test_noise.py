import numpy as np
import pytest
import scipy

from bayesid.regression.noise import Noise, autocovariance, integrated_time, relative_rms, residual_noise, times_of

RATE = 100.0


def ar1(phi, n, seed=0):
    rng = np.random.default_rng(seed)
    x = np.empty(n)
    x[0] = rng.standard_normal()
    for i in range(1, n):
        x[i] = phi * x[i - 1] + np.sqrt(1 - phi**2) * rng.standard_normal()
    return x


@pytest.mark.parametrize("phi", [0.5, 0.9])
def test_integrated_time_of_an_ar1_process(phi):
    """Closed form: (1 + phi) / (1 - phi)."""
    time = np.mean([integrated_time(autocovariance(ar1(phi, 20000, s), np.ones(20000, bool), 400)) for s in range(5)])
    assert time == pytest.approx((1 + phi) / (1 - phi), rel=0.15)


def test_white_and_coloured_parts_are_separated():
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


def two_joints():
    return Noise(np.array([0.7, 0.2]), np.array([0.5, 1.5]), np.array([0.05, 0.2]), np.ones(2))


def test_draws_have_the_covariance_of_the_closed_form():
    """white^2 + coloured^2 exp(-lag / T), wherever one looks: the process starts in its stationary state."""
    noise, count, drawn_from = two_joints(), 20_000, np.random.default_rng(5)
    drawn = noise.draw(30, count, RATE, drawn_from)
    assert drawn.shape == (30, 2, count)
    for j in range(2):
        lag = np.abs(np.subtract.outer(np.arange(30), np.arange(30))) / RATE
        expected = noise.coloured[j] ** 2 * np.exp(-lag / noise.correlation[j]) + noise.white[j] ** 2 * (lag == 0.0)
        covariance = drawn[:, j] @ drawn[:, j].T / count
        error = np.sqrt((expected[0, 0] ** 2 + expected**2) / count)  # of a sample covariance of normal variables
        assert np.abs((covariance - expected) / error).max() < 5.0
        assert np.abs(drawn[:, j].mean(axis=1)).max() < 5.0 * noise.sigma[j] / np.sqrt(count)
    across = drawn[:, 0] @ drawn[:, 1].T / count
    assert np.abs(across).max() < 5.0 * noise.sigma.prod() / np.sqrt(count), "joints are independent"


def test_the_time_of_the_model_is_the_sum_of_its_autocorrelations():
    noise = two_joints()
    same = noise.with_time_of_model(RATE)
    for j in range(2):
        lags = np.arange(1, 2000) / RATE
        share = noise.coloured[j] ** 2 * np.exp(-lags / noise.correlation[j])
        expected = 1.0 + 2.0 * share.sum() / (noise.coloured[j] ** 2 + noise.white[j] ** 2)
        assert same.autocorrelation[j] == pytest.approx(expected, rel=1e-9)
    for name in ("white", "coloured", "correlation"):
        np.testing.assert_array_equal(getattr(same, name), getattr(noise, name))
    half = Noise(np.array([3.0]), np.array([4.0]), np.array([0.01 / np.log(2.0)]), np.ones(1))  # memory 1/2
    assert half.with_time_of_model(RATE).autocorrelation == pytest.approx(1.0 + 2.0 * 16.0 / 25.0)


def test_a_scaled_noise_is_larger_and_no_other():
    noise = two_joints()
    larger = noise.scaled(np.array([2.0, 0.5]))
    np.testing.assert_allclose(larger.sigma, [2.0 * np.hypot(0.7, 0.5), 0.5 * np.hypot(0.2, 1.5)])
    np.testing.assert_allclose(larger.white, [1.4, 0.1])
    for name in ("correlation", "autocorrelation"):
        np.testing.assert_array_equal(getattr(larger, name), getattr(noise, name))


def test_an_error_that_oscillates_counts_by_its_coherence_time():
    """Damped waves, rho_k = r^k cos(w k): sum of rho by closed form for the mean, of its square for the size."""
    r, w, n = 0.95, 0.5, 400_000
    rng = np.random.default_rng(1)
    turning = scipy.signal.lfilter([1.0], [1.0, -r * np.exp(1j * w)], rng.normal(size=n) + 1j * rng.normal(size=n))
    slow = scipy.signal.lfilter([1.0], [1.0, -0.9], rng.normal(size=n))
    z = r * np.exp(1j * w)
    of_mean = 1.0 + 2.0 * (z / (1.0 - z)).real
    of_size = 1.0 + r**2 / (1.0 - r**2) + (z**2 / (1.0 - z**2)).real
    assert of_mean < 1.0 < 5.0 < of_size
    times = times_of(np.stack([turning.real, slow], axis=1), np.ones((n, 2), dtype=bool), 100.0)
    np.testing.assert_allclose(times, [of_size, 1.9 / 0.1], rtol=0.05)  # Monte Carlo error of 300 lags: 2 %
