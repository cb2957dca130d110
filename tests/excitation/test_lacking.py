"""What a result knows: what its draws say beyond its covariance is what the model may lack, and not chance."""

from dataclasses import replace

import numpy as np
import pytest

from bayesid.excitation.known import known_of
from bayesid.fit.noise import Noise
from bayesid.identification.identified_model import IdentifiedModel, ParameterDraws
from bayesid.model.coefficients import base_coefficients
from bayesid.model.model import Model
from bayesid.model.robot import load_robot
from bayesid.model.terms import RigidBody

_DRAWS = 256


@pytest.fixture(scope="module")
def model():
    return Model(load_robot("kr5"), (RigidBody(),))


def identified(model, covariance, lacking, seed):
    """A model with a covariance of its coefficients (r, r), and draws that have more of it."""
    base, rng = base_coefficients(model), np.random.default_rng(seed)
    theta = rng.standard_normal(base.projection.shape[1])
    beta = rng.multivariate_normal(np.zeros(len(covariance)), covariance + lacking, _DRAWS)
    draws = theta + beta @ np.linalg.pinv(base.projection).T
    n = model.robot.n_joints
    noise = Noise(np.ones(n), np.zeros(n), np.ones(n), np.ones(n))
    of_draws = ParameterDraws(draws, np.ones((_DRAWS, n)))
    return IdentifiedModel(model, theta, noise, np.linalg.inv(covariance), of_draws)


def some_covariance(size, seed):
    """Of coefficients in mixed units."""
    rng = np.random.default_rng(seed)
    scale, mixing = np.geomspace(1e-2, 1e2, size), rng.standard_normal((size, 3 * size))
    return mixing @ mixing.T / (3 * size) * np.outer(scale, scale)


def test_where_nothing_is_lacking_chance_is_not_taken_for_it(model):
    size = len(base_coefficients(model))
    for seed in range(5):
        known = known_of(identified(model, some_covariance(size, seed), np.zeros((size, size)), seed), 100.0)
        assert np.all(np.diag(known.lacking) < 0.05 * np.diag(known.now))


def test_what_is_lacking_is_seen(model):
    size = len(base_coefficients(model))
    covariance = some_covariance(size, 1)
    direction = np.linalg.cholesky(covariance) @ np.ones(size) / np.sqrt(size)  # of one sd
    lacking = 16.0 * np.outer(direction, direction)
    found = known_of(identified(model, covariance, lacking, 2), 100.0).lacking
    ratio = np.sqrt(np.diag(found) / np.diag(lacking))
    assert 0.85 < np.median(ratio) < 1.15, ratio  # the sd of 256 draws is known to 4 %, turned by 12 % of chance


def test_what_is_said_to_be_lacking_counts_in_place_of_the_draws(model):
    size = len(base_coefficients(model))
    covariance = some_covariance(size, 1)
    told = identified(model, covariance, 4.0 * covariance, 3)
    known = known_of(replace(told, lacking=0.5 * covariance), 100.0)
    np.testing.assert_allclose(known.lacking, 0.5 * covariance, rtol=1e-6, atol=1e-9)
