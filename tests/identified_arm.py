"""An arm of three joints and the standard terms, and what identifications of its logs find: once for all tests."""

from functools import cache

import numpy as np
from conftest import small_robot

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.identification.pipeline import identify
from bayesid.posterior.sampler import Sampling
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

NOISE = 0.03
"""Of the efforts' RMS."""
ROBOT = small_robot(3)


@cache
def motion_of(seed):
    return random_trajectory(3, 6.0, rng=seed).motion(np.arange(601) / 100.0)


MODEL = Model(ROBOT, make_terms(STANDARD, ROBOT, motion_of(0)))
THETA = random_parameters(MODEL, rng=np.random.default_rng(4))


@cache
def log_of(seed, signed=True):
    return simulate(MODEL, THETA, motion_of(seed), rng=np.random.default_rng(seed), noise=NOISE, signed=signed)


@cache
def by_least_squares():
    return identify(ROBOT, log_of(0), complete="off", posterior=False)


@cache
def sampled():
    """Without signs, with as few draws as there can be."""
    return identify(ROBOT, log_of(0, signed=False), complete="off", posterior=Sampling(budget=0.0))
