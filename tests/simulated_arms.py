"""Simulated arms of three joints for the tests of signs: truth, logs, and the share of signs that is right."""

from functools import cache

import numpy as np
from conftest import small_robot

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.log.segments import find_segments
from bayesid.log.signals import prepare
from bayesid.signs.search.certified import Certified
from bayesid.signs.sign_solution import find_signs
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

T = np.arange(801) / 100.0
STRONG = 0.05
"""Samples count from this share of their joint's largest |effort| on."""
BUDGET = 0.5
"""s for the search's proof: a model that does not hold leaves thousands of assignments to look through."""


class Simulated:
    """An arm of three joints; Coulomb friction `coulomb` times as large as all else, RMS; 0 leaves all effects out."""

    def __init__(self, coulomb, seed=4):
        self.robot = small_robot(3)
        self.motion = random_trajectory(3, 8.0, rng=seed).motion(T)
        self.model = Model(self.robot, make_terms(STANDARD, self.robot, self.motion))
        names = [parameter.name for parameter in self.model.parameters]
        self.theta = random_parameters(self.model, rng=np.random.default_rng(seed))
        friction = [names.index(f"Fc{j}") for j in (1, 2, 3)]
        if not coulomb:
            self.theta[30:] = 0.0
        else:
            columns = self.model.columns(self.motion)
            self.theta[friction] = 0.0
            rest = self.model.effort(self.motion, self.theta)
            for j, k in enumerate(friction):
                self.theta[k] = coulomb * rms(rest[:, j]) / rms(columns[:, j, k])

    def log(self, signed=False, noise=0.05):
        return simulate(self.model, self.theta, self.motion, rng=np.random.default_rng(7), noise=noise, signed=signed)

    def right(self, result):
        """(N, n) whether a sample's likelier sign is right, and whether the sample is strong."""
        effort = self.model.effort(self.motion, self.theta)
        signs = np.where(result.probability >= 0.5, 1.0, -1.0)
        return np.sign(effort) == signs, np.abs(effort) >= STRONG * np.abs(effort).max(axis=0)

    def right_share(self, result):
        """Of the strong samples."""
        right, strong = self.right(result)
        return right[strong].mean()


def rms(values):
    return np.sqrt(np.mean(values**2))


@cache
def arm_with_friction(coulomb):
    """One for all tests: `Simulated`."""
    return Simulated(coulomb)


@cache
def solution_of_standard_terms(coulomb):
    """Signs under the model of the truth, searched once for all tests."""
    arm = arm_with_friction(coulomb)
    return signs_of(arm.robot, arm.log(), STANDARD)


def signs_of(robot, log, terms, search=None, earlier=None):
    """Signs under one model, from a raw log."""
    signals = prepare(log)
    model = Model(robot, make_terms(terms, robot, signals.motion))
    segments = find_segments(signals, robot.actuators(signals.motion))
    return find_signs(model, signals, segments, search or Certified(budget=BUDGET), earlier=earlier)
