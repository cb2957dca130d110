"""Gains estimated with known signs, against raw least squares over all rows and finite differences."""

import numpy as np
import pytest
from conftest import small_robot, smooth_motion
from scipy.optimize import minimize

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.log.gains import Gains
from bayesid.log.signals import Signals
from bayesid.regression.gains import GainPrior, fit_gains, likely_gains, prior_of, signed_moments
from bayesid.regression.knowledge import LinkPrior, NominalParameters
from bayesid.regression.log_data import LogData
from bayesid.regression.noise import Noise
from bayesid.simulation.parameters import random_parameters

RATE, NOISE = 100.0, 0.02
OFF = np.array([1.25, 0.8, 1.1])
"""Gains over the true ones."""
LINKS = LinkPrior(mass=20.0, reach=0.5)


class Case:
    """An arm of three joints with friction, and its signed efforts by gains that are off."""

    def __init__(self, off=OFF, duration=8.0):
        self.robot, self.motion = small_robot(3), smooth_motion(3, duration, RATE, seed=5)
        self.model = Model(self.robot, make_terms(STANDARD, self.robot, self.motion))
        self.theta = random_parameters(self.model, rng=np.random.default_rng(4))
        effort = self.model.effort(self.motion, self.theta)
        self.sd = NOISE * np.sqrt((effort**2).mean(axis=0))
        noisy = effort + self.sd * np.random.default_rng(1).standard_normal(effort.shape)
        self.off, self.effort = np.array(off), noisy * off
        self.noise = Noise(self.sd * off, np.full(3, 1e-9), np.full(3, 0.1), np.ones(3))
        signals = Signals(
            self.motion, self.effort, self.effort, np.ones(3, bool), RATE, 20.0, {}, np.ones(effort.shape, bool)
        )
        every = np.ones(effort.shape, dtype=bool)
        self.log_data = LogData(self.model, base_coefficients(self.model), signals, every, every)

    def fit(self, prior, nominal=None):
        return fit_gains(self.log_data, self.normal_equations, self.noise, prior, LINKS, nominal)

    @property
    def normal_equations(self):
        return signed_moments(self.log_data, np.ones(self.effort.shape))

    def raw_cost(self, log, prior):
        """Of all rows, without moments, cone or linearisation."""
        rows, efforts = [], []
        used = self.log_data.used
        for j in range(3):
            rows.append(np.exp(-log[j]) * self.log_data.columns[used[:, j], j] / (self.sd[j] * self.off[j]))
            efforts.append(self.effort[used[:, j], j] / (self.sd[j] * self.off[j]))
        design, measured = np.concatenate(rows), np.concatenate(efforts)
        size = np.linalg.norm(design, axis=0)
        left = measured - design @ (np.linalg.lstsq(design / size, measured, rcond=1e-12)[0] / size)
        loose = prior.loose
        away = (log - prior.mean)[loose]
        return 0.5 * left @ left + 0.5 * away @ np.linalg.solve(prior.covariance[np.ix_(loose, loose)], away)


@pytest.fixture(scope="module")
def case():
    return Case()


def sd_of(found):
    """(n,) of the logarithms."""
    return np.sqrt(np.diag(found.covariance))


WIDE = GainPrior(np.zeros(3), 0.3**2 * np.eye(3))


def test_the_best_gains_are_those_of_all_rows(case):
    """The arm's parameters lie inside the cone, which then has no say."""
    best = minimize(case.raw_cost, np.zeros(3), args=(WIDE,), method="BFGS", options={"gtol": 1e-6}).x
    found = case.fit(WIDE)
    assert found.converged
    assert found.log == pytest.approx(best, abs=0.05 * sd_of(found).min())  # the decrement it ends at


def test_their_covariance_is_the_inverse_curvature_of_all_rows(case):
    found, step = case.fit(WIDE), 2e-3

    def cost(away):
        return case.raw_cost(found.log + away, WIDE)

    pairs = [[(a + b, a - b) for b in step * np.eye(3)] for a in step * np.eye(3)]
    curvature = [[cost(s) - cost(d) - cost(-d) + cost(-s) for s, d in row] for row in pairs]
    covariance = np.linalg.inv(np.array(curvature) / (4.0 * step**2))
    np.testing.assert_allclose(found.covariance, covariance, atol=0.03 * np.abs(covariance).max())


def test_a_common_factor_leaves_no_trace(case):
    found, one = case.fit(WIDE), np.ones(3)
    assert abs(one @ found.information @ one) < 1e-6 * np.trace(found.information)
    project = case.log_data.coefficients.project
    assert project(found.moves @ one) == pytest.approx(project(found.theta), rel=1e-4, abs=1e-4)


def test_ratios_come_out_and_one_exact_gain_fixes_the_factor():
    found = Case(off=[1.0, 0.8, 1.1]).fit(GainPrior(np.zeros(3), np.diag([0.0, 0.3**2, 0.3**2])))
    assert found.log[0] == 0.0
    z = (found.log[1:] + np.log([0.8, 1.1])) / sd_of(found)[1:]
    assert np.abs(z).max() < 3.5
    assert sd_of(found)[1] < 0.03
    assert sd_of(found)[2] > 0.1, "the last link is light: its joint cannot tell"


def test_a_known_mass_fixes_the_factor_only_as_far_as_the_log_shows_that_mass(case):
    """The mass of the last link is seen in sums alone, Coulomb friction by itself."""
    names = [parameter.name for parameter in case.model.parameters]
    sd, told = sd_of(case.fit(WIDE))[2], {}
    for name in ("m3", "Fc3"):
        place = names.index(name)
        mean, spread = np.full(len(names), np.nan), np.full(len(names), np.nan)
        mean[place], spread[place] = case.theta[place], 1e-3 * case.theta[place]
        told[name] = case.fit(WIDE, NominalParameters(mean, spread))
    assert sd_of(told["m3"])[2] > 0.5 * sd
    assert sd_of(told["Fc3"])[2] < 0.2 * sd
    assert abs(told["Fc3"].log[2] + np.log(OFF[2])) < 3.5 * sd_of(told["Fc3"])[2]


def test_draws_scale_parameters_as_their_gains_say(case):
    found = case.fit(WIDE)
    common = np.full((1, 3), 0.4)
    project = case.log_data.coefficients.project
    scaled = found.scaled(found.theta[None], common)[0]
    assert project(scaled) == pytest.approx(np.exp(0.4) * project(found.theta), rel=1e-4, abs=1e-4)
    assert found.scaled(found.theta[None], np.zeros((1, 3)))[0] == pytest.approx(found.theta)
    own = np.array([[0.0, 0.0, 1e-4]])
    slope = (found.scaled(found.theta[None], own)[0] - found.theta) / 1e-4
    np.testing.assert_allclose(slope, found.moves[:, 2], atol=1e-3 * np.abs(found.moves[:, 2]).max())


def test_the_linearised_best_parameters_are_those_of_other_gains(case):
    """Base coefficients of a raw fit with all gains 1 % up in joint 2 against the stated moves."""
    found, step = case.fit(WIDE), 1e-2

    def best(log):
        weight = 1.0 / (case.sd * case.off)
        design = np.exp(-log)[:, None] * weight[:, None] * case.log_data.columns * case.log_data.used[:, :, None]
        flat = design.reshape(-1, design.shape[2])
        size = np.linalg.norm(flat, axis=0)
        measured = (case.effort * weight * case.log_data.used).ravel()
        return np.linalg.lstsq(flat / size, measured, rcond=1e-12)[0] / size

    away = step * np.array([0.0, 1.0, 0.0])
    change = (best(found.log + away) - best(found.log - away)) / (2.0 * step)
    stated = case.log_data.coefficients.projection @ found.moves[:, 1]
    np.testing.assert_allclose(stated, change, atol=0.03 * np.abs(change).max())


def test_gains_that_nobody_knows_begin_where_a_robot_of_its_reach_would_have_them(case):
    """Readings a thousand times smaller need gains a thousand times larger."""
    gains = Gains(np.ones(3), np.full(3, np.inf))
    factor = likely_gains(case.log_data, gains)
    small = Case(off=OFF / 1000.0)
    np.testing.assert_allclose(likely_gains(small.log_data, gains), 1000.0 * factor, rtol=1e-9)
    half = Gains(np.ones(3), np.array([np.inf, 0.0, 0.2]))
    assert (likely_gains(case.log_data, half)[1:] == 1.0).all()
    prior = prior_of(half)
    assert prior.loose.tolist() == [0, 2]
    assert prior.covariance[0, 0] > 1.0 > prior.covariance[2, 2]
