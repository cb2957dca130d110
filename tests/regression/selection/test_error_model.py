import numpy as np
import pytest
from dense_errors import covariance
from scipy.optimize import minimize
from scipy.stats import multivariate_normal

from bayesid.regression.selection.error_model import ErrorModel, fit_error

RATE = 50.0
MODELS = {
    "both": ErrorModel(0.3, 0.5, 0.1, RATE),
    "white": ErrorModel(0.7, 0.0, 0.1, RATE),
    "coloured": ErrorModel(0.0, 2.5, 0.08, RATE),
}
FORGOTTEN = 150
"""Samples after which the filter has forgotten how it began: theta^2 is below 0.73 in all of these models."""


def draws(error, count, replicates, seed):
    """(count, replicates) by Cholesky."""
    noise = np.random.default_rng(seed).standard_normal((count, replicates))
    return np.linalg.cholesky(covariance(error, count)) @ noise


def density(error, values):
    return multivariate_normal(np.zeros(len(values)), covariance(error, len(values))).logpdf(values)


@pytest.fixture(params=MODELS)
def error(request):
    return MODELS[request.param]


def everything(count):
    return np.ones(count, dtype=bool)


def test_likelihood_is_that_of_the_dense_normal_once_the_beginning_is_forgotten(error):
    """p(later | earlier) = p(all) / p(earlier); what is left of the beginning is below theta^300 = 1e-20."""
    residual = draws(error, 500, 1, 3)[:, 0] * np.linspace(0.5, 1.7, 500)  # of the wrong size, which no formula minds
    expected = density(error, residual) - density(error, residual[:FORGOTTEN])
    whole, beginning = (error.log_likelihood(part, everything(len(part))) for part in (residual, residual[:FORGOTTEN]))
    assert whole - beginning == pytest.approx(expected, rel=1e-9)


def test_unused_samples_change_nothing():
    """For any values of unused samples."""
    error = MODELS["both"]
    residual = draws(error, 300, 1, 5)[:, 0]
    used = np.arange(300) % 60 >= 13
    spoiled = np.where(used, residual, 1e6)
    assert error.log_likelihood(spoiled, used) == error.log_likelihood(residual, used)
    assert fit_error(spoiled, used, RATE) == fit_error(residual, used, RATE)
    assert not error.whiten(spoiled, used)[~used].any()
    np.testing.assert_array_equal(error.whiten(spoiled, used), error.whiten(residual, used))


def test_whitened_noise_is_white_and_of_unit_size(error):
    """1200 x 50 innovations: lags of a white sequence are zero to 1 / sqrt(M), its variance one to sqrt(2 / M)."""
    white = error.whiten(draws(error, 1200 + FORGOTTEN, 50, 7), everything(1200 + FORGOTTEN))[FORGOTTEN:] / error.scale
    assert np.mean(white**2) == pytest.approx(1.0, abs=4.5 * np.sqrt(2.0 / white.size))
    for lag in (1, 2, 3, 5, 8, 13, 40):
        assert np.mean(white[lag:] * white[:-lag]) == pytest.approx(0.0, abs=4.5 / np.sqrt(white.size))


FITTED = {
    "both": ErrorModel(0.3, 0.5, 0.1, RATE),
    "mostly white": ErrorModel(1.0, 0.5, 0.3, RATE),
    "mostly coloured": ErrorModel(0.1, 0.8, 0.25, RATE),
}


@pytest.mark.parametrize(
    ("name", "limits"),
    [("both", None), ("both", (0.25, 0.9)), ("mostly white", (0.6, 0.3)), ("mostly coloured", (0.2, 0.2))],
)
def test_fit_is_the_likeliest_of_all_within_the_limits(name, limits):
    """Against 12 x 12 x 9 points; where limits make a kink half a nat is little beside a decade, 2.3 of them."""
    residual = draws(FITTED[name], 800, 1, 11)[:, 0]
    used = everything(800)
    found, value = fit_error(residual, used, RATE, limits)
    assert value == pytest.approx(found.log_likelihood(residual, used), rel=1e-9)
    largest = limits or (3.0, 3.0)
    assert found.white <= largest[0] * (1.0 + 1e-9)
    assert found.coloured <= largest[1] * (1.0 + 1e-9)
    best = max(
        ErrorModel(white, coloured, correlation, RATE).log_likelihood(residual, used)
        for white in largest[0] * np.linspace(0.02, 1.0, 12)
        for coloured in largest[1] * np.linspace(0.02, 1.0, 12)
        for correlation in np.geomspace(0.01, 2.0, 9)
    )
    assert value > best - (0.01 if limits is None else 0.5)


@pytest.mark.parametrize("name", ["both", "mostly white"])
def test_fit_is_likeliest_on_a_lattice_that_loses_little(name):
    """Against a simplex search from the truth, on a log with gaps; neighbours of the lattice two per cent away."""
    truth, used = FITTED[name], np.arange(900) % 90 >= 7
    residual = draws(truth, 900, 1, 21)[:, 0]
    found, value = fit_error(residual, used, RATE)

    def unlikeliness(logs):
        return -ErrorModel(*np.exp(logs), RATE).log_likelihood(residual, used)

    begin = np.log([truth.white, truth.coloured, truth.correlation])
    best = minimize(unlikeliness, begin, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9, "maxiter": 3000})
    assert -best.fun - 0.03 < value <= -best.fun + 1e-6
    cells = np.log([(found.coloured / found.white) ** 2, found.correlation]) - [7.0, np.log(3.0)]
    np.testing.assert_allclose(cells / 0.02, np.round(cells / 0.02), atol=1e-6)


def test_fit_of_smooth_errors_is_likeliest_with_the_largest_share():
    """Nothing white: the share ends at its largest, 0.999, and the correlation time is the likeliest with that."""
    rate = 100.0
    residual = draws(ErrorModel(0.0, 2.0, 0.6, rate), 900, 1, 22)[:, 0]
    found, value = fit_error(residual, everything(900), rate)
    assert (found.coloured / found.white) ** 2 == pytest.approx(np.exp(7.0), rel=1e-9)
    likeliest = max(
        ErrorModel(size * found.white, size * found.coloured, time, rate).log_likelihood(residual, everything(900))
        for time in np.geomspace(0.05, 3.0, 60)
        for size in np.geomspace(0.4, 2.5, 60)
    )
    assert value > likeliest - 0.05


def test_a_zero_residual_gives_a_zero_error():
    found, value = fit_error(np.zeros(100), everything(100), RATE)
    assert found.sigma < 1e-100
    assert np.isfinite(value)
