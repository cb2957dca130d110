"""One identification for all tests of what is written of it, and what reads the files again."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from functools import cache, partial

import numpy as np
from conftest import small_robot

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.identification.pipeline import identify
from bayesid.posterior.sampler import Sampling
from bayesid.report.folders import save_identification
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

save = partial(save_identification, report=False)
"""Without the report, which takes seconds and has tests of its own."""
PROMISED = {
    *("summary.json", "segments.csv", "signed_log.csv", "coefficients.csv", "parameters.csv", "model.toml"),
    *("bayesid.toml", "robot.urdf", "robot.xml", "findings.npz"),
}


def simulated(robot, signed=False, terms=STANDARD, seed=4, duration=6.0, parameters=None):
    """At 100 Hz; parameters are random, of the same seed or of another."""
    t = np.arange(int(100 * duration) + 1) / 100.0
    motion = random_trajectory(robot.n_joints, duration, rng=seed).motion(t)
    model = Model(robot, make_terms(terms, robot, motion))
    rng = np.random.default_rng(seed)
    theta = random_parameters(model, rng=rng if parameters is None else np.random.default_rng(parameters))
    return simulate(model, theta, motion, rng=rng, noise=0.03, signed=signed)


@cache
def identified():
    """Joint 2 keeps its sign; time counts from 1970."""
    robot = small_robot(3)
    log = simulated(robot, signed=[False, True, False])
    return identify(robot, replace(log, t=log.t + 1.7e9), posterior=False, complete="off")


@cache
def sampled():
    """The same log, its posterior sampled until it has converged."""
    return identify(identified().model.robot, identified().log, posterior=Sampling(rng=3), complete="off")


@cache
def validated():
    return identified().validate(simulated(identified().model.robot, seed=11))


def table(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def numbers(rows, *keys):
    """(rows,) or (rows, keys) of a table."""
    return np.array([[float(row[key]) for key in keys] for row in rows]).squeeze()


def strict(text):
    """JSON as others read it, which has no infinity."""

    def refuse(word):
        raise AssertionError(f"{word} is not JSON")

    return json.loads(text, parse_constant=refuse)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}
