"""What was known of the coefficients before the recording that could not tell hypotheses apart."""

import numpy as np
import pytest

from bayesid.excitation.known import known_of
from bayesid.excitation.rivals import _before, _unstepped
from bayesid.fit.knowledge import Knowledge
from bayesid.fit.noise import Noise
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.model.catalogue import make_terms
from bayesid.model.coefficients import base_coefficients
from bayesid.model.model import Model
from bayesid.model.robot import load_robot
from bayesid.model.terms import STANDARD
from bayesid.simulation.trajectories import random_trajectory

_RATE = 50.0


@pytest.fixture(scope="module")
def motions():
    t = np.arange(501) / _RATE
    return [random_trajectory(6, 10.0, seed=seed).motion(t) for seed in (1, 2)]


@pytest.fixture(scope="module")
def model(motions):
    robot = load_robot("kr5")
    return Model(robot, make_terms(STANDARD, robot, motions[0]))


def result(model, precision):
    n, size = model.robot.n_joints, len(model.parameters)
    noise = Noise(np.ones(n), np.zeros(n), np.ones(n), np.ones(n))
    return known_of(IdentifiedModel(model, np.ones(size), noise, precision), _RATE)


def test_what_an_earlier_log_has_told_is_not_forgotten(model, motions):
    size = len(base_coefficients(model))
    empty = result(model, np.eye(size))
    healthy = 2.0 * empty.information(motions[1], 1.0 / _RATE) + 1e-3 * np.eye(size)
    known = result(model, healthy + empty.information(motions[0], 1.0 / _RATE))
    before = np.linalg.inv(_before(known, known, motions[0]))
    ratio = np.sqrt(np.diag(before) / np.diag(np.linalg.inv(healthy)))
    np.testing.assert_allclose(ratio, 1.0, rtol=0.02)  # but where it knew ten times less than is known now


def test_a_step_that_a_parameter_may_have_made_is_taken_back(model):
    base = base_coefficients(model)
    size, name, sd = len(base), "offset3", np.array([0.5])
    rng = np.random.default_rng(3)
    mixing = rng.standard_normal((size, 3 * size))
    healthy = Knowledge(model, np.ones(len(model.parameters)), mixing @ mixing.T)
    widened = healthy.widened((name,), sd, base)
    known = result(model, widened.precision)
    again = _unstepped(widened.precision, known, [name], sd)
    column = base.names.index(name)
    then, before = (np.sqrt(np.linalg.inv(matrix)[column, column]) for matrix in (healthy.precision, again))
    now = np.sqrt(np.linalg.inv(widened.precision)[column, column])
    assert now > 2.0 * then
    assert before == pytest.approx(max(then, 0.1 * now), rel=0.05)
