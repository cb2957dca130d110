"""A log as a model is to explain it: its moments and its noise."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import small_robot, smooth_motion

from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.log.segments import Segments
from bayesid.log.signals import Signals
from bayesid.regression.evidence import Evidence
from bayesid.regression.noise import residual_noise

RATE = 100.0


@pytest.fixture(scope="module")
def evidence():
    """One joint, 200 samples of random |effort|; what is filtered is of no consequence."""
    robot, motion = small_robot(1), smooth_motion(1, 2.0, RATE, seed=3)
    model = Model(robot, make_terms(["rigid_body", "viscous_friction", "torque_offset"], robot, motion))
    raw = np.abs(np.random.default_rng(4).standard_normal((200, 1)))
    every = np.ones((200, 1), dtype=bool)
    return Evidence.of(
        model, Signals(motion, np.full((200, 1), 7.0), raw, np.array([False]), RATE, 20.0, {}, every), every
    )


@pytest.fixture(scope="module")
def signs():
    return np.random.default_rng(5).uniform(-1.0, 1.0, (200, 1))


@pytest.fixture(scope="module")
def segments():
    ones = np.ones(2, dtype=np.int64)
    return Segments(0 * ones, np.array([0, 90]), np.array([80, 200]), 0 * ones, ones.astype(bool))


def test_moments_have_the_squares_of_the_raw_efforts(evidence, signs, segments):
    """E[s]^2 r^2 is less than r^2, and the energy is that of what was measured; nothing is filtered."""
    moments, raw = evidence.moments(signs, segments), evidence.signals.raw_effort
    columns = evidence.model.columns(evidence.signals.motion)[:, 0, evidence.coefficients.kept]
    for k, rows in enumerate((slice(0, 80), slice(90, 200))):
        assert moments.energy[k] == pytest.approx(np.sum(raw[rows] ** 2))
        np.testing.assert_allclose(moments.gradient[k], columns[rows].T @ (signs * raw)[rows, 0])
        np.testing.assert_allclose(moments.hessian[k], columns[rows].T @ columns[rows])


def test_moments_of_a_signed_log_have_its_own_signs(evidence, signs, segments):
    efforts = signs * evidence.signals.raw_effort
    signed = replace(evidence, signals=replace(evidence.signals, raw_effort=efforts, signed=np.array([True])))
    measured, expected = signed.moments(-np.ones((200, 1)), segments), evidence.moments(signs, segments)
    np.testing.assert_allclose(measured.gradient, expected.gradient)
    np.testing.assert_allclose(measured.energy[1], np.sum(efforts[90:] ** 2))


def test_samples_at_both_ends_and_those_not_fitted_are_not_used(evidence):
    """Half a period of the cut-off of 20 Hz: 0.025 s."""
    fitted = np.arange(200)[:, None] % 5 != 0
    used = replace(evidence, fitted=fitted).used[:, 0]
    assert not used[[0, 1, 2, 197, 198, 199]].any()
    np.testing.assert_array_equal(used[3:197], fitted[3:197, 0])


def test_the_noise_is_that_of_the_nearer_sign_where_samples_are_used(evidence):
    partial = replace(evidence, fitted=np.arange(200)[:, None] < 120)
    predicted = np.random.default_rng(6).standard_normal((200, 1))
    residual = np.sign(predicted) * evidence.signals.raw_effort - predicted
    residual[120:] = 1e3
    used = (np.arange(200)[:, None] >= 3) & (np.arange(200)[:, None] < 120)
    expected = residual_noise(np.where(used, residual, 0.0), used, RATE)
    for name in ("white", "coloured", "correlation", "autocorrelation"):
        np.testing.assert_allclose(getattr(partial.residual_noise(predicted), name), getattr(expected, name), rtol=1e-9)
