"""The parameters that predict, against nonnegative least squares of the rows and of the prior as more rows."""

import numpy as np
import pytest
from posterior_problems import likelihood
from scipy.optimize import nnls

from bayesid.fit.noise import Noise
from bayesid.model.coefficients import BaseCoefficients
from bayesid.model.parameters import Cone
from bayesid.posterior.predicting import predicting
from bayesid.posterior.prior import Prior
from bayesid.posterior.region import Region
from bayesid.posterior.target import Target

SIZE, ROWS, SEGMENTS = 4, 80, 10
TRUE = np.array([1.3, 0.0, 2.1, 0.4])
MEAN, SD = np.array([0.2, 0.0, 0.5, 0.1]), np.array([2.0, 0.6, 1.0, 0.3])


def noise(sigma, autocorrelation):
    """Of two joints."""
    sigma = np.array(sigma)
    return Noise(sigma, 0.0 * sigma, np.ones(2), np.array(autocorrelation))


OF_TARGET, RESIDUAL = noise([0.5, 1.5], [3.0, 20.0]), noise([0.4, 0.9], [2.0, 8.0])


def problem(fixed):
    """Rows of two joints, N m, and the target in units of its noise; the segments' signs, -1 and +1 in turn."""
    rng = np.random.default_rng(4)
    columns, segment = rng.standard_normal((ROWS, SIZE)), np.arange(ROWS) % SEGMENTS
    joint, signs = segment % 2, np.where(np.arange(SEGMENTS) % 3 == 0, -1, 1)
    effort = columns @ TRUE + 0.3 * rng.standard_normal(ROWS)
    unit = (OF_TARGET.sigma * np.sqrt(OF_TARGET.autocorrelation))[joint]
    data = likelihood(
        columns / unit[:, None], signs[segment] * effort / unit, joint, segment, np.where(fixed, signs, 0), 2
    )
    empty = np.empty((10, 0))
    region = Region(np.eye(SIZE), np.zeros(SIZE), np.empty((10, 0, SIZE)), empty)
    prior = Prior(region, MEAN, SD, np.full(2, 0.3), np.ones(SIZE))
    return columns, effort, joint, Target(prior, data)


def coefficients():
    """Each parameter is one."""
    words = ("",) * SIZE
    return BaseCoefficients(words, words, words, np.arange(SIZE), np.eye(SIZE))


def expected(columns, effort, joint):
    """By nonnegative least squares: joints by their residuals' sd, as slow as their geometric mean."""
    scale = RESIDUAL.sigma[joint] * np.sqrt(np.sqrt(2.0 * 8.0))
    rows = np.vstack([columns / scale[:, None], np.diag(1.0 / SD)])
    return nnls(rows, np.concatenate([effort / scale, MEAN / SD]))[0]


@pytest.mark.parametrize("fixed", [np.ones(SEGMENTS, dtype=bool), np.arange(SEGMENTS) < 4])
def test_it_is_least_squares_of_rows_and_prior(fixed):
    columns, effort, joint, target = problem(fixed)
    strong = 1e3 * TRUE  # so large that no sign is in doubt
    found = predicting(target, Cone.orthant(SIZE), coefficients(), strong, OF_TARGET, RESIDUAL)
    np.testing.assert_allclose(found, expected(columns, effort, joint), rtol=1e-5, atol=1e-6)


def test_a_sign_in_doubt_counts_by_its_expectation():
    _, _, _, target = problem(np.zeros(SEGMENTS, dtype=bool))
    found = predicting(target, Cone.orthant(SIZE), coefficients(), np.zeros(SIZE), OF_TARGET, RESIDUAL)
    some = predicting(target, Cone.orthant(SIZE), coefficients(), TRUE, OF_TARGET, RESIDUAL)
    assert np.all(found < MEAN + 1e-6)  # no effort is expected, so all parameters shrink
    assert np.linalg.norm(some - TRUE) < 0.3 * np.linalg.norm(found - TRUE)
