"""Uncertainty of a result before and after a recording, against full regressions on rows."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import smooth_motion
from open_results import NOISE, gains_result, open_result

from bayesid.excitation.gaussian_posterior import gaussian_posterior
from bayesid.excitation.resolvability import plausible_robots
from bayesid.identification.identified_model import ParameterDraws
from bayesid.regression.knowledge import inverse_of

PERIOD = 0.02


@pytest.fixture(scope="module")
def motion():
    return smooth_motion(3, 3.0, 1.0 / PERIOD, seed=11)


def test_covariance_after_a_recording_is_that_of_a_regression(motion):
    """The noise counts independent samples: per sample the sampling period over the correlation time."""
    result = open_result()
    known = gaussian_posterior(result, 1.0 / PERIOD)
    found = known.covariance(known.information(motion))
    memory = np.exp(-PERIOD / NOISE.correlation)
    times = 1.0 + 2.0 * NOISE.coloured**2 / (NOISE.white**2 + NOISE.coloured**2) * memory / (1.0 - memory)
    sigma = np.sqrt(NOISE.white**2 + NOISE.coloured**2)
    rows = result.model.columns(motion)[:, :, known.coefficients.selected] / (sigma * np.sqrt(times))[:, None]
    moving = np.abs(motion.dq) > result.model.robot.actuators(motion).standstill_speed
    prior = np.linalg.cholesky(result.precision).T
    stacked = np.vstack([prior, rows[moving]])
    _, values, vectors = np.linalg.svd(stacked, full_matrices=False)
    np.testing.assert_allclose(found, (vectors.T / values**2) @ vectors, rtol=1e-6, atol=1e-9 * np.abs(found).max())
    assert np.all(np.diag(found) < np.diag(known.covariance_now))
    before, after = np.diag(known.covariance_now), np.diag(found)
    assert (after / before).min() < 0.05  # the motion tells something


def test_columns_are_derivatives_of_the_readings(motion):
    """Readings are converted by fixed gains: a true gain that is larger makes all readings smaller."""
    known = gaussian_posterior(gains_result(), 50.0)
    assert known.names[-2:] == ("log_gain1", "log_gain3")
    assert known.units[-2:] == ("", "")
    np.testing.assert_array_equal(known.gains, [0, 2])
    kept, theta = known.coefficients.selected, known.theta

    def read(moves):
        moved = theta.copy()
        moved[kept] += moves[: len(kept)]
        log_gain = np.array([moves[-2], 0.0, moves[-1]])
        return known.model.effort(motion, moved) / np.exp(log_gain)

    columns, step = known.columns(motion), 1e-5
    for k in range(len(known)):
        moves = np.zeros(len(known))
        moves[k] = step
        slope = (read(moves) - read(-moves)) / (2.0 * step)
        np.testing.assert_allclose(columns[:, :, k], slope, atol=1e-6 * max(1.0, np.abs(slope).max()))


def test_gains_and_coefficients_have_a_joint_covariance():
    result = gains_result(factor=0.4)
    known, draws = gaussian_posterior(result, 50.0), result.draws
    drawn = np.hstack([known.coefficients.project(draws.theta), draws.log_gain[:, [0, 2]]])
    centred = drawn - drawn.mean(axis=0)
    covariance = centred.T @ centred / (len(drawn) - 1)
    np.testing.assert_allclose(known.covariance_now, covariance, rtol=1e-5, atol=1e-9 * np.abs(covariance).max())
    assert known.covariance_now[-1, -2] / np.sqrt(known.covariance_now[-1, -1] * known.covariance_now[-2, -2]) > 0.5
    np.testing.assert_allclose(known.mean[-2:], draws.log_gain.mean(axis=0)[[0, 2]])


def test_draws_wider_than_the_information_give_the_model_error():
    result, rng = open_result(), np.random.default_rng(2)
    base = gaussian_posterior(result, 50.0).coefficients
    wide = np.linalg.cholesky(4.0 * np.linalg.inv(result.precision))
    theta = result.theta + (rng.normal(size=(20_000, len(base))) @ wide.T) @ np.linalg.pinv(base.projection).T
    known = gaussian_posterior(replace(result, draws=ParameterDraws(theta, np.tile(NOISE.sigma, (20_000, 1)))), 50.0)
    inside = np.linalg.inv(result.precision)
    np.testing.assert_allclose(inverse_of(known.precision), inside, rtol=1e-6, atol=1e-9 * np.abs(inside).max())
    ratio = np.diag(known.model_error_covariance) / np.diag(inside)
    np.testing.assert_allclose(ratio, 3.0, rtol=0.07)  # five times 4 / 3 sqrt(2 / 20000)
    told = replace(
        result, draws=ParameterDraws(theta, np.tile(NOISE.sigma, (20_000, 1))), model_error_covariance=0.5 * inside
    )
    np.testing.assert_allclose(
        gaussian_posterior(told, 50.0).model_error_covariance, 0.5 * inside, rtol=1e-6, atol=1e-9
    )


def test_without_a_posterior_the_prior_is_the_spread_of_plausible_robots():
    result = open_result()
    precision = result.precision.copy()
    blind = gaussian_posterior(result, 50.0).coefficients.names.index("Fv2")
    precision[blind], precision[:, blind] = 0.0, 0.0
    known = gaussian_posterior(replace(result, precision=precision), 50.0)
    assert known.assumed_prior
    assert not gaussian_posterior(result, 50.0).assumed_prior
    size = plausible_robots(known.model).size
    np.testing.assert_allclose(known.precision - precision, np.diag(size**-2.0), rtol=1e-9, atol=1e-9)
    assert np.sqrt(known.covariance_now[blind, blind]) == pytest.approx(size[blind])
