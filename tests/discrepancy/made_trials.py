"""Logs of an arm of three joints, and trials without filtering."""

import numpy as np
from conftest import small_robot, smooth_motion

from bayesid.discrepancy.case import Trial
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.log.log import Log
from bayesid.log.signals import Signals
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters

RATE = 100.0
TERMS = ("rigid_body", "viscous_friction")


def made_trial(motion, effort, used=None, signed=False):
    """Every sample is used unless stated otherwise; joints without a sign have |effort|."""
    every = np.ones(effort.shape, dtype=bool)
    flags = np.broadcast_to(np.asarray(signed, dtype=bool), effort.shape[1])
    raw = np.where(flags, effort, np.abs(effort))
    return Trial(Signals(motion, raw, raw, flags, RATE, 20.0, {}, every), motion, every if used is None else used)


def arm_log(seed, extra=None, duration=14.0, robot=2):
    """The same arm for all seeds; `extra` is added to its effort (N, n)."""
    robot, motion = small_robot(3, seed=robot), smooth_motion(3, duration, RATE, seed=seed)
    model = Model(robot, make_terms(TERMS, robot, motion))
    theta = random_parameters(model, rng=np.random.default_rng(5))
    log = simulate(model, theta, motion, rng=np.random.default_rng(seed), noise=0.02, signed=True)
    effort = log.effort if extra is None else log.effort + extra(motion)
    return Log(log.t, log.q, np.abs(effort), np.zeros(3, dtype=bool), source=f"log{seed}")
