"""A simulated arm of three joints: its identified model, and streams with events."""

from __future__ import annotations

from functools import cache

import numpy as np
from conftest import small_robot

import bayesid
from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.monitor.tracker import SignTracker
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

RATE = 100.0
NOISE = 0.02
"""Share of the effort's RMS."""
ROBOT = small_robot(3)
T = np.arange(3000) / RATE


def motion_of(seed, t=T):
    """A random motion whose period is 12 s."""
    return random_trajectory(3, 12.0, rng=seed).motion(t)


@cache
def truth():
    """Model and parameters."""
    model = Model(ROBOT, make_terms(STANDARD, ROBOT, motion_of(1)))
    return model, random_parameters(model, rng=np.random.default_rng(4))


@cache
def identified():
    """The model identified from 20 s of another motion, without signs."""
    model, theta = truth()
    motion = motion_of(1, np.arange(2000) / RATE)
    log = bayesid.Log(motion.t, motion.q, np.abs(noisy(model.effort(motion, theta), 1)), [False] * 3)
    return bayesid.identify(ROBOT, log, posterior=False)


def noisy(effort, seed):
    """With sensor noise."""
    sd = NOISE * np.sqrt((effort**2).mean(axis=0))
    return effort + sd * np.random.default_rng(seed).standard_normal(effort.shape)


@cache
def stream(seed=2, theta=None):
    """Motion and signed efforts of a run, with the true or given parameters."""
    model, usual = truth()
    motion = motion_of(seed)
    return motion, noisy(model.effort(motion, usual if theta is None else np.array(theta)), seed)


def changed(**factors):
    """The true parameters, some of them multiplied, as a tuple."""
    model, theta = truth()
    theta = theta.copy()
    names = [parameter.name for parameter in model.parameters]
    for name, factor in factors.items():
        theta[names.index(name)] *= factor
    return tuple(theta.tolist())


def run(motion, effort, tracker=None, rows=slice(None), **options):
    """A tracker and all its records."""
    tracker = SignTracker(identified(), RATE, **options) if tracker is None else tracker
    rows = zip(motion.t[rows], motion.q[rows], np.abs(effort[rows]), strict=True)
    return tracker, [tracker.update(t, q, e) for t, q, e in rows]


def right_share(records, motion, effort, least=0.05):
    """Share of right signs in samples in motion whose effort is not small."""
    k = np.searchsorted(motion.t, [record.t - 1e-6 for record in records])
    probability = np.array([record.probability for record in records])
    used = (np.abs(effort) >= least * np.abs(effort).max(axis=0))[k]
    used &= (np.abs(motion.dq) > 0.01 * motion.top_speed)[k]
    used[:25] = False  # the first samples are those of the window
    return ((probability > 0.5) == (effort[k] > 0.0))[used].mean()
