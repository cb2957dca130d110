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
SIGMA = 60.0  # N m, so large that the step is not told at once by the recording
OFFSET, DRIFT = ("torque_offset", (3,)), ("thermal_drift", (3,))


def test_a_step_that_a_parameter_may_have_made_is_taken_back():
    """Of an offset that has changed: it was known as well as before the step."""
    recorded_motion, earlier = (random_trajectory(6, 10.0, seed=seed).motion(np.arange(501) / RATE) for seed in (1, 2))
    robot = load_robot("kr5")
    model = Model(robot, make_terms(STANDARD, robot, recorded_motion))
    base, theta = base_coefficients(model), np.ones(len(model.parameters))

    def known(precision):
        noise = Noise(np.full(6, SIGMA), np.zeros(6), np.ones(6), np.ones(6))
        return known_of(IdentifiedModel(model, theta, noise, precision), RATE)

    empty = known(np.eye(len(base)))
    healthy = 2.0 * empty.information(earlier, 1.0 / RATE) + 1e-3 / SIGMA**2 * np.eye(len(base))
    recorded = empty.information(recorded_motion, 1.0 / RATE)

    def rivals_of(precision):
        changed = {OFFSET: {"offset3": 0.3}}
        return make_rivals(known(precision + recorded), [OFFSET, DRIFT], recorded_motion, recorded_motion, changed)

    (sd,) = rivals_of(healthy).rivals[0].forms[0].sd  # of the step, as the hypothesis has it
    stepped = Knowledge(model, theta, healthy).widened(("offset3",), np.array([sd]), base).precision
    column = base.names.index("offset3")
    covariances = (np.linalg.inv(matrix) for matrix in (healthy, stepped, rivals_of(stepped).prior))
    then, now, before = (np.sqrt(covariance[column, column]) for covariance in covariances)
    assert now > 2.0 * then
    assert before == pytest.approx(then, rel=1e-3)
