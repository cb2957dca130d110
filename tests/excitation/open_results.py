"""Constructed results with many undetermined coefficients, without an identification."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np
from conftest import small_robot, smooth_motion

from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.excitation.gaussian_posterior import gaussian_posterior
from bayesid.identification.identified_model import IdentifiedModel, ParameterDraws
from bayesid.regression.noise import Noise
from bayesid.simulation.logs import SimulatedEffect, with_effects
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import MotionLimits

TERMS = ("rigid_body", "viscous_friction", "coulomb_friction")
NOISE = Noise(
    white=np.array([0.05, 0.11, 0.02]),
    coloured=np.array([0.09, 0.04, 0.03]),
    correlation=np.array([0.05, 0.02, 0.11]),
    autocorrelation=np.array([3.0, 1.5, 9.0]),
)
LIMITS = MotionLimits(
    lower=(-1.4, -0.3, -2.0), upper=(0.9, 1.8, 2.2), velocity=(1.5, 2.5, 3.1), acceleration=(4.0, 9.0, 6.0)
)


NONE = MappingProxyType({})


def earlier_motion(n=3, seed=6):
    """Motion of the result's log: 4 s at 50 Hz."""
    return smooth_motion(n, 4.0, 50.0, seed=seed)


def open_result(n=3, terms=TERMS, seed=2, share=0.02, effects=NONE):
    """A model whose coefficients have a loose prior, and a short log on top that counts for a small share of itself.

    The model may have more effects, of some levels, in the second joint or in the whole robot.
    """
    robot, motion = small_robot(n, seed=seed), earlier_motion(n)
    model = Model(robot, make_terms(terms, robot, motion))
    theta = random_parameters(model, rng=np.random.default_rng(seed))
    added = [SimulatedEffect(name, 2, level) for name, level in effects.items()]
    model, theta = with_effects(model, theta, motion, added, seed)
    base = base_coefficients(model.before_sensors)
    noise = Noise(*(values[:n] for values in vars(NOISE).values()))
    rows = (model.columns(motion)[:, :, base.selected] / noise.sigma[:, None]).reshape(-1, len(base))
    size = 0.3 * np.abs(base.project(theta)) + 0.1
    return IdentifiedModel(model, theta, noise, share * rows.T @ rows + np.diag(size**-2.0))


def open_known(rate=100.0, model_error_covariance=0.0, **options):
    """Its `GaussianPosterior`, with a covariance of the model error."""
    result = open_result(**options)
    if model_error_covariance:
        root = np.random.default_rng(8).normal(size=result.precision.shape) / len(result.precision)
        sd = model_error_covariance * np.sqrt(np.diag(np.linalg.inv(result.precision)))
        result = replace(result, model_error_covariance=np.outer(sd, sd) * (root @ root.T))
    return gaussian_posterior(result, rate)


def gains_result(seed=5, factor=0.0):
    """Draws of parameters and of the gains of joints 1 and 3; that of joint 2 is exact."""
    result, rng = open_result(), np.random.default_rng(seed)
    theta = result.theta * (1.0 + 0.2 * rng.normal(size=(400, len(result.theta))))
    log_gain = rng.normal(size=(400, 3)) * [0.12, 0.0, 0.3] + factor * rng.normal(size=(400, 1)) * [1.0, 0.0, 1.0]
    return replace(result, draws=ParameterDraws(theta, np.tile(NOISE.sigma, (400, 1)), log_gain))
