"""What was known of the coefficients before the recording that could not tell hypotheses apart."""

import numpy as np
import pytest

from bayesid.excitation.known import known_of
from bayesid.excitation.rivals import make_rivals
from bayesid.fit.knowledge import Knowledge
from bayesid.fit.noise import Noise
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.model.catalogue import make_terms
from bayesid.model.coefficients import base_coefficients
from bayesid.model.model import Model
from bayesid.model.robot import load_robot
from bayesid.model.terms import STANDARD
from bayesid.simulation.trajectories import random_trajectory

RATE = 50.0
SIGMA = 60.0
"""N m, so large that the step is not told at once by the recording."""
OFFSET, DRIFT = ("torque_offset", (3,)), ("thermal_drift", (3,))


@pytest.fixture(scope="module")
def motions():
    return [random_trajectory(6, 10.0, seed=seed).motion(np.arange(501) / RATE) for seed in (1, 2)]


@pytest.fixture(scope="module")
def model(motions):
    robot = load_robot("kr5")
    return Model(robot, make_terms(STANDARD, robot, motions[0]))


def result(model, precision, sigma):
    n, size = model.robot.n_joints, len(model.parameters)
    noise = Noise(np.full(n, sigma), np.zeros(n), np.ones(n), np.ones(n))
    return known_of(IdentifiedModel(model, np.ones(size), noise, precision), RATE)


def after(model, earlier, recorded, sigma):
    """What an earlier log has told (r, r) and what a recording tells beside it, with noise of sigma N m."""
    empty = result(model, np.eye(len(base_coefficients(model))), sigma)
    healthy = 2.0 * empty.information(earlier, 1.0 / RATE) + 1e-3 / sigma**2 * np.eye(len(empty))
    return healthy, empty.information(recorded, 1.0 / RATE)


def test_what_an_earlier_log_has_told_is_not_forgotten(model, motions):
    healthy, recorded = after(model, motions[1], motions[0], 1.0)
    known = result(model, healthy + recorded, 1.0)
    rivals = make_rivals(known, [("stribeck_friction", (3,)), DRIFT], motions[0], motions[0])
    ratio = np.sqrt(np.diag(np.linalg.inv(rivals.prior)) / np.diag(np.linalg.inv(healthy)))
    np.testing.assert_allclose(ratio, 1.0, rtol=0.02)  # but where it knew ten times less than is known now


def test_a_step_that_a_parameter_may_have_made_is_taken_back(model, motions):
    """Of an offset that has changed: it was known as well as before the step."""
    base, changed = base_coefficients(model), {OFFSET: {"offset3": 0.3}}
    healthy, recorded = after(model, motions[1], motions[0], SIGMA)
    column = base.names.index("offset3")

    def of(precision):
        return make_rivals(result(model, precision + recorded, SIGMA), [OFFSET, DRIFT], motions[0], motions[0], changed)

    (sd,) = of(healthy).rivals[0].forms[0].sd  # of the step, as the hypothesis has it
    stepped = Knowledge(model, np.ones(len(model.parameters)), healthy).widened(("offset3",), np.array([sd]), base)
    then, now, before = (
        np.sqrt(np.linalg.inv(matrix)[column, column])
        for matrix in (healthy, stepped.precision, of(stepped.precision).prior)
    )
    assert now > 2.0 * then
    assert before == pytest.approx(then, rel=1e-3)
