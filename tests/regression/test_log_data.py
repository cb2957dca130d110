"""Log data: normal equations, noise, and marginalised effects, against dense covariances."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from conftest import small_robot, smooth_motion

from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.log.segments import Segments
from bayesid.log.signals import Signals
from bayesid.regression.least_squares import fit_signed
from bayesid.regression.log_data import LogData, make_nuisance
from bayesid.regression.noise import residual_noise
from bayesid.simulation.parameters import random_parameters

RATE = 100.0


@pytest.fixture(scope="module")
def log_data():
    """One joint, 200 samples of random |effort|; what is filtered is of no consequence."""
    robot, motion = small_robot(1), smooth_motion(1, 2.0, RATE, seed=3)
    model = Model(robot, make_terms(["rigid_body", "viscous_friction", "torque_offset"], robot, motion))
    raw = np.abs(np.random.default_rng(4).standard_normal((200, 1)))
    every = np.ones((200, 1), dtype=bool)
    return LogData.of(
        model, Signals(motion, np.full((200, 1), 7.0), raw, np.array([False]), RATE, 20.0, {}, every), every
    )


@pytest.fixture(scope="module")
def signs():
    return np.random.default_rng(5).uniform(-1.0, 1.0, (200, 1))


@pytest.fixture(scope="module")
def segments():
    ones = np.ones(2, dtype=np.int64)
    return Segments(0 * ones, np.array([0, 90]), np.array([80, 200]), 0 * ones, ones.astype(bool))


def test_moments_have_the_squares_of_the_raw_efforts(log_data, signs, segments):
    """E[s]^2 r^2 is less than r^2, and the energy is that of what was measured; nothing is filtered."""
    normal_equations, raw = log_data.normal_equations(signs, segments), log_data.signals.raw_effort
    columns = log_data.model.columns(log_data.signals.motion)[:, 0, log_data.coefficients.selected]
    for k, rows in enumerate((slice(0, 80), slice(90, 200))):
        assert normal_equations.energy[k] == pytest.approx(np.sum(raw[rows] ** 2))
        np.testing.assert_allclose(normal_equations.gradient[k], columns[rows].T @ (signs * raw)[rows, 0])
        np.testing.assert_allclose(normal_equations.hessian[k], columns[rows].T @ columns[rows])


def test_moments_of_a_signed_log_have_its_own_signs(log_data, signs, segments):
    efforts = signs * log_data.signals.raw_effort
    signed = replace(log_data, signals=replace(log_data.signals, raw_effort=efforts, signed=np.array([True])))
    measured, expected = (
        signed.normal_equations(-np.ones((200, 1)), segments),
        log_data.normal_equations(signs, segments),
    )
    np.testing.assert_allclose(measured.gradient, expected.gradient)
    np.testing.assert_allclose(measured.energy[1], np.sum(efforts[90:] ** 2))


def test_samples_at_both_ends_and_those_not_fitted_are_not_used(log_data):
    """Half a period of the cut-off of 20 Hz: 0.025 s."""
    fitted = np.arange(200)[:, None] % 5 != 0
    used = replace(log_data, fitted=fitted).used[:, 0]
    assert not used[[0, 1, 2, 197, 198, 199]].any()
    np.testing.assert_array_equal(used[3:197], fitted[3:197, 0])


def test_the_noise_is_that_of_the_nearer_sign_where_samples_are_used(log_data):
    partial = replace(log_data, fitted=np.arange(200)[:, None] < 120)
    predicted = np.random.default_rng(6).standard_normal((200, 1))
    residual = np.sign(predicted) * log_data.signals.raw_effort - predicted
    residual[120:] = 1e3
    used = (np.arange(200)[:, None] >= 3) & (np.arange(200)[:, None] < 120)
    expected = residual_noise(np.where(used, residual, 0.0), used, RATE)
    for name in ("white", "coloured", "correlation", "autocorrelation"):
        np.testing.assert_allclose(getattr(partial.residual_noise(predicted), name), getattr(expected, name), rtol=1e-9)


COUNT, JOINTS, FREE, SUMMED = 90, 2, 4, 3
EXACT = 1e-6
"""Directions whose spread is a thousandth of the error are left out: they change a variance by 1e-6 of itself."""


def in_chunks(rows, cut=7):
    """Rows in chunks of uneven length, each time anew."""
    places = [slice(a, b) for a, b in pairwise([0, cut, 5 * cut, len(rows)])]
    return lambda: ((place, rows[place]) for place in places)


class Case:
    """Columns of a model in mixed units and of effects that partly look like them, joints of different noise."""

    def __init__(self, seed=0, size=0.3, count=COUNT):
        rng = np.random.default_rng(seed)
        self.model = rng.normal(size=(count, JOINTS, FREE)) * [1.0, 40.0, 0.03, 2.0]
        alike = 0.4 * self.model[:, :, :SUMMED] * [1.0, 0.02, 20]
        self.columns = 2.0 * rng.normal(size=(count, JOINTS, SUMMED)) + alike
        self.used = rng.uniform(size=(count, JOINTS)) < 0.8
        self.weight = np.array([0.7, 2.3])
        root = size * rng.normal(size=(SUMMED, SUMMED))
        self.moments = root @ root.T
        self.effort = rng.normal(size=(count, JOINTS))

    def made(self, **changes):
        arguments = {
            "columns": self.columns.__getitem__,
            "model": in_chunks(self.model),
            "used": self.used,
            "weight": self.weight,
            "names": ("a", "b"),
            "scales": np.array([0.5, 2.0]),
            "moments": self.moments,
        }
        return make_nuisance(**{**arguments, **changes})

    def rows(self, values):
        """Used rows in units of the error."""
        scaled = values / self.weight.reshape(1, -1, *(1,) * (values.ndim - 2))
        return scaled[self.used]


def dense_covariance(of_model, of_columns, moments):
    """H^-1 + H^-1 Y'Z A Z'Y H^-1."""
    inverse = np.linalg.inv(of_model.T @ of_model)
    across = inverse @ of_model.T @ of_columns
    return inverse + across @ moments @ across.T


def assert_covariance(found, expected, relative):
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / scale, expected / scale, atol=relative, rtol=0)


@pytest.mark.parametrize("size", [0.3, 50.0])
def test_covariance_is_that_of_effects_with_these_moments(size):
    case = Case(size=size)
    white = case.rows(case.made().whiten(case.model))
    expected = dense_covariance(case.rows(case.model), case.rows(case.columns), case.moments)
    assert_covariance(np.linalg.inv(white.T @ white), expected, EXACT)
    plain = np.linalg.inv(case.rows(case.model).T @ case.rows(case.model))
    assert (np.diag(expected) / np.diag(plain)).max() > 1.001


@pytest.mark.parametrize("what", ["effort", "model"])
def test_chunks_together_are_the_whole(what):
    case = Case(seed=1)
    nuisance, values = case.made(), getattr(case, what)
    places = [slice(a, b) for a, b in pairwise([0, 1, 40, 90])]
    shared = nuisance.shared((place, values[place]) for place in places)
    parts = [nuisance.without(place, values[place], shared) for place in places]
    np.testing.assert_allclose(np.concatenate(parts), nuisance.whiten(values), rtol=1e-11, atol=1e-12)


def test_effects_orthogonal_to_the_model_change_nothing():
    case = Case()
    y, z = case.rows(case.model), case.rows(case.columns)
    apart = np.zeros_like(case.columns)
    apart[case.used] = z - y @ np.linalg.lstsq(y, z, rcond=None)[0]
    apart *= case.weight[:, None]
    assert case.made(columns=apart.__getitem__) is None
    assert case.made(moments=np.zeros((SUMMED, SUMMED))) is None
    assert case.made(moments=1e-12 * case.moments) is None


@pytest.mark.parametrize(("count", "precision"), [(20_000, np.float64), (20_001, np.float32)])
def test_long_logs_are_kept_in_single_precision(count, precision):
    case = Case(seed=4, count=count)
    nuisance = case.made()
    assert nuisance.directions.dtype == precision
    shared = nuisance.shared(in_chunks(case.model, 11)())
    tolerance = (1e-5 if precision == np.float32 else 1e-11) * np.abs(shared).max()
    np.testing.assert_allclose(nuisance.of_model, shared, rtol=0, atol=tolerance)
    white = case.rows(nuisance.whiten(case.model))
    expected = dense_covariance(case.rows(case.model), case.rows(case.columns), case.moments)
    assert_covariance(np.linalg.inv(white.T @ white), expected, 1e-5)


class Arm:
    """Two joints with signed efforts, and columns of marginalised effects."""

    def __init__(self):
        robot, self.motion = small_robot(2, 3), smooth_motion(2, 5.0, 100.0, seed=6)
        self.model = Model(robot, make_terms(["rigid_body", "viscous_friction"], robot, self.motion))
        self.coefficients = base_coefficients(self.model)
        theta = random_parameters(self.model, rng=np.random.default_rng(2))
        self.exact = self.model.effort(self.motion, theta)
        rng = np.random.default_rng(4)
        size = np.sqrt(np.mean(self.exact**2, axis=0))
        self.effort = self.exact + 0.1 * size * rng.normal(size=self.exact.shape)
        self.columns = np.stack([np.tanh(5.0 * self.motion.dq), self.motion.dq**3, np.sin(self.motion.q)], axis=3 - 1)
        self.columns = self.columns * size[:, None]
        self.moments = np.diag([0.1, 0.02, 0.3]) ** 2

    def log_data(self, signed=True):
        every = np.ones_like(self.effort, dtype=bool)
        effort = self.effort if signed else np.abs(self.effort)
        signals = Signals(self.motion, effort, effort, np.array([signed] * 2), 100.0, 20.0, {}, every)
        return LogData(self.model, self.coefficients, signals, every, every)

    def nuisance(self, log_data, fit):
        weight = fit.noise.sigma * np.sqrt(fit.noise.autocorrelation)
        names = ("tanh", "cube", "sine")
        return make_nuisance(
            self.columns.__getitem__, log_data.chunks, log_data.used, weight, names, np.ones(3), self.moments
        ), weight


@pytest.fixture(scope="module")
def arm():
    return Arm()


@pytest.mark.parametrize("signed", [True, False])
def test_a_fit_has_the_same_estimate_and_is_less_certain(arm, signed):
    log_data = arm.log_data(signed)
    plain = fit_signed(log_data, np.sign(arm.exact))
    nuisance, weight = arm.nuisance(log_data, plain)
    found = fit_signed(replace(log_data, nuisance=nuisance), np.sign(arm.exact))
    for name in ("theta", "beta", "predicted"):
        np.testing.assert_array_equal(getattr(found, name), getattr(plain, name))
    np.testing.assert_array_equal(found.noise.sigma, plain.noise.sigma)
    used = log_data.used
    y, z = ((values / weight[:, None])[used] for values in (log_data.columns, arm.columns))
    assert_covariance(found.covariance, dense_covariance(y, z, arm.moments), 1e-5)
    assert np.all(found.sd > plain.sd)
    assert (found.sd / plain.sd).max() > 1.5


def test_moments_are_those_of_whitened_rows(arm):
    """Summed within segments of each joint; an orientation turns the efforts in the end."""
    log_data = arm.log_data()
    nuisance, _ = arm.nuisance(log_data, fit_signed(log_data, np.sign(arm.exact)))
    log_data = replace(log_data, nuisance=nuisance)
    columns, effort = nuisance.whiten(log_data.columns), nuisance.whiten(arm.effort)
    places = [(0, 60, 200), (0, 200, 330), (1, 55, 440)]
    joint, start, end = np.array(places).T
    segments = Segments(joint, start, end, np.ones(3, dtype=np.int64), np.ones(3, dtype=bool))
    orientation = np.random.default_rng(0).choice([-1.0, 1.0], arm.effort.shape)
    found = log_data.normal_equations(np.sign(arm.exact), segments, orientation=orientation)
    plain = log_data.normal_equations(np.sign(arm.exact), segments, summed_out=False)
    for k, (j, first, last) in enumerate(places):
        rows, values = columns[first:last, j], effort[first:last, j]
        np.testing.assert_allclose(found.hessian[k], rows.T @ rows, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(found.gradient[k], rows.T @ values, rtol=1e-8, atol=1e-8)
        assert found.energy[k] == pytest.approx(values @ values)
        own = log_data.columns[first:last, j]
        np.testing.assert_allclose(plain.gradient[k], own.T @ arm.effort[first:last, j], rtol=1e-8, atol=1e-8)
    unsigned = replace(arm.log_data(False), nuisance=nuisance)
    turned = unsigned.normal_equations(orientation, segments, orientation=orientation)
    expected = nuisance.whiten(orientation * np.abs(arm.effort)) * orientation
    for k, (j, first, last) in enumerate(places):
        rows, values = columns[first:last, j], expected[first:last, j]
        np.testing.assert_allclose(turned.gradient[k], rows.T @ values, rtol=1e-8, atol=1e-8)
        assert turned.energy[k] == pytest.approx(values @ values)
