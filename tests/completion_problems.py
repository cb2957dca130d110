"""An arm of two joints with an effect that its model lacks, and what an identification makes of its log."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from conftest import small_robot

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_effect, make_terms
from bayesid.effects.model import Model
from bayesid.identification import pipeline
from bayesid.signs.search.certified import Certified
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

ROBOT = small_robot(2, 3)
MOTION = random_trajectory(2, 8.0, rng=4).motion(np.arange(401) / 50.0)
BASE = Model(ROBOT, make_terms(STANDARD, ROBOT, MOTION))
THETA = random_parameters(BASE, rng=np.random.default_rng(4))
SIZE = np.sqrt(np.mean(BASE.effort(MOTION, THETA) ** 2, axis=0))
"""N m, RMS."""
TOP = np.abs(MOTION.dq).max(axis=0)
LAG = 0.02
"""s."""
STRIBECK = {"Fs2": 1.0 * SIZE[1], "speed2": 0.1 * TOP[1]}
LOAD = 0.3
RIPPLE = 7.0
"""Waves a turn of a torque ripple that is larger than all else in its joint: the signs found without it are wrong."""


def dry(term):
    return term.name == "coulomb_friction"


def _truth(name):
    """Model and parameters."""
    smooth = {"joints": [2], "smoothing": [0.01 * TOP[1]]}
    if name == "stribeck_friction":
        return BASE.extend(make_effect(name, {**smooth, "speed": [STRIBECK["speed2"]]})), [0.0, STRIBECK["Fs2"]]
    if name == "load_dependent_friction":
        return BASE.extend(make_effect(name, {**smooth, "links": BASE.links(THETA).ravel().tolist()})), [LOAD]
    if name == "torque_ripple":
        ripple = make_effect(name, {"joints": [2], "harmonic": [RIPPLE]})
        return BASE.extend(ripple), [2.0 * SIZE[1], SIZE[1]]
    if name == "turns_at_once":
        sharp = [replace(t, smoothing=tuple(1e-3 * v for v in t.smoothing)) if dry(t) else t for t in BASE.terms]
        return Model(ROBOT, tuple(sharp)), []
    if name == "delay":
        return BASE.extend(make_effect(name, {"lag": [LAG]})), []
    return BASE, []


@cache
def log_with(name="", signed=False):
    model, more = _truth(name)
    noise = {"rng": np.random.default_rng(7), "noise": 0.001 if name == "turns_at_once" else 0.03}
    return simulate(model, np.append(THETA, more), MOTION, signed=signed, **noise)


def identify(name="", signed=False, posterior=False, **options):
    search = Certified(budget=2.0)
    return pipeline.identify(ROBOT, log_with(name, signed), search=search, posterior=posterior, **options)


@cache
def identified(name="", signed=False, complete="auto"):
    """Once for all tests."""
    return identify(name, signed, complete=complete)


def true_signs(name):
    """(N, n) and which samples are strong."""
    effort = log_with(name, True).effort
    return np.sign(effort), np.abs(effort) > 0.1 * np.abs(effort).max(axis=0)
