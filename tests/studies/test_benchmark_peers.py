"""The benchmark beside peers: methods against the truth, errors on rows that no fit has seen, tables of all rows."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import small_robot

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.log.log import Log
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory
from bayesid.studies.benchmarks import peers
from bayesid.studies.benchmarks.peer_methods import (
    Recording,
    least_squares,
    ordinary,
    weighted,
    weighted_feasible,
    weighted_least_squares,
)
from bayesid.studies.benchmarks.peer_packages import packages

PLAIN = {"ordinary least squares": ordinary, "weighted least squares": weighted, "weighted + SDP": weighted_feasible}


class Arm:
    """Two joints with friction, and a log of them."""

    def __init__(self, noise=0.0, seed=0):
        self.robot = small_robot(2)
        motion = random_trajectory(2, 8.0, rng=3).motion(np.arange(1601) / 200.0)
        self.model = Model(self.robot, make_terms(STANDARD, self.robot, motion))
        self.theta = random_parameters(self.model, rng=np.random.default_rng(2))
        self.effort = self.model.effort(motion, self.theta)
        rng = np.random.default_rng(seed)
        said = self.effort + noise * np.array([1.0, 5.0]) * rng.standard_normal(self.effort.shape)
        self.log = Log(motion.t, motion.q, said, np.ones(2, dtype=bool), dq=motion.dq, source="arm")
        self.recording = Recording.of(self.robot, self.log)


@pytest.fixture(scope="module")
def clean():
    return Arm()


@pytest.fixture(scope="module")
def noisy():
    return Arm(noise=0.5)


def exact(arm):
    """The recording with the motion's efforts themselves, as if nothing were filtered."""
    recording = arm.recording
    effort = recording.model.effort(recording.motion, arm.theta)
    return replace(recording, signals=replace(recording.signals, raw_effort=effort))


def test_without_noise_every_method_returns_the_truth(clean):
    recording = exact(clean)
    truth = base_coefficients(recording.model).project(clean.theta)
    rms = np.sqrt(np.mean(clean.effort**2, axis=0))
    for method in PLAIN.values():
        answer = method(recording)
        np.testing.assert_allclose(answer.beta, truth, atol=1e-4 * np.abs(truth).max())
        assert np.all(np.abs(answer.effort(recording.motion) - recording.signals.raw_effort) < 1e-3 * rms)
    for method in packages().values():  # those that are installed
        rest = recording.error(method(recording).effort(recording.motion))
        assert np.all(rest < 0.1 * rms)


def test_the_covariance_is_that_of_many_fits():
    rng = np.random.default_rng(0)
    columns, sigma, used = rng.standard_normal((200, 2, 3)), np.array([1.0, 4.0]), np.ones((200, 2), dtype=bool)
    noise = sigma * rng.standard_normal((400, 200, 2))
    fits = [weighted_least_squares(columns, columns @ [1.0, -2.0, 0.5] + one, used) for one in noise]
    expected = np.cov(np.array([fit.beta for fit in fits]), rowvar=False)
    np.testing.assert_allclose(np.diag(fits[0].covariance), np.diag(expected), rtol=0.3)
    unweighted = least_squares(columns, columns @ [1.0, -2.0, 0.5] + noise[0], used, np.ones(2))
    assert np.all(np.diag(unweighted.covariance) > 2.0 * np.diag(fits[0].covariance))


def test_the_error_is_that_of_rows_that_the_fit_has_not_seen(noisy):
    first, second = (Recording.of(noisy.robot, peers.half_of(noisy.log, which)) for which in (1, 2))
    assert first.motion.t[-1] < second.motion.t[0]
    assert len(first.log) + len(second.log) == len(noisy.log)
    shifted = second.signals.raw_effort + np.array([3.0, 0.0])
    ruined = replace(second, signals=replace(second.signals, raw_effort=shifted))
    rows = [peers.score("weighted", weighted, first, other, "halves") for other in (second, ruined)]
    assert rows[1].error[0] == pytest.approx(np.hypot(rows[0].error[0], 3.0), rel=0.1)
    assert rows[1].error[1] == rows[0].error[1]
