"""Simulated arms of three joints with and without something on the flange, for the tests of payloads."""

from __future__ import annotations

import numpy as np
from conftest import small_robot

import bayesid
from bayesid.effects.model import Model
from bayesid.log.log import Log
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

TERMS = ["rigid_body", "viscous_friction", "coulomb_friction"]
MASS, CENTRE = 2.0, np.array([0.03, -0.05, 0.12])
INERTIA = np.array([[0.012, 0.002, -0.001], [0.002, 0.008, 0.0015], [-0.001, 0.0015, 0.006]])
"""kg, m, and kg m^2 about the centre of mass: off the axis, of unequal inertias, with products of inertia."""
TRUTH = np.array([MASS, *CENTRE, 0.012, 0.008, 0.006, 0.002, -0.001, 0.0015])
"""In the order of payload.json."""
NOISE = 0.03
"""Of the effort's RMS in the log without a payload; the same N m in the other."""


def ten_parameters(mass, centre, inertia):
    """Of a body, about the frame's origin, by the parallel axis theorem, written out."""
    x, y, z = centre
    return np.array(
        [
            inertia[0, 0] + mass * (y * y + z * z),
            inertia[0, 1] - mass * x * y,
            inertia[0, 2] - mass * x * z,
            inertia[1, 1] + mass * (x * x + z * z),
            inertia[1, 2] - mass * y * z,
            inertia[2, 2] + mass * (x * x + y * y),
            mass * x,
            mass * y,
            mass * z,
            mass,
        ]
    )


PAYLOAD = ten_parameters(MASS, CENTRE, INERTIA)


class PayloadCase:
    """An arm that was identified without a payload, and its later logs.

    Efforts of the links are those of recursive Newton-Euler, not of the regressor that identification uses.
    """

    def __init__(self, seed: int, duration: float = 8.0, rate: float = 50.0) -> None:
        self.robot, self.rng = small_robot(3), np.random.default_rng(seed)
        t = np.arange(int(duration * rate) + 1) / rate
        self.before, self.after = (random_trajectory(3, duration, rng=100 * seed + k).motion(t) for k in (1, 2))
        self.model = Model.of(self.robot, TERMS, self.before)
        self.theta = random_parameters(self.model, rng=self.rng)
        self.sigma = NOISE * np.sqrt(np.mean(self._effort(self.before, self.theta) ** 2, axis=0))
        self.first = self.log(self.before)
        self.result = bayesid.identify(self.robot, self.first, TERMS, complete="off", posterior=False)

    def log(self, motion, payload=None, friction=None, gain=1.0):
        """|effort| with a payload (10,), and the friction of a joint (from 1) times a factor."""
        theta = self.theta.copy()
        if payload is not None:
            theta[20:30] += payload
        if friction is not None:
            joint, factor = friction
            theta[[29 + joint, 32 + joint]] *= factor
        noise = self.sigma * self.rng.standard_normal(motion.q.shape)
        effort = np.abs(gain * (self._effort(motion, theta) + noise))
        return Log(motion.t, motion.q, effort, np.zeros(3, dtype=bool), source="loaded.csv")

    def later(self, payload=None, friction=None):
        return self.log(self.after, payload, friction)

    def _effort(self, motion, theta):
        links = self.robot.inverse_dynamics(motion, theta[:30])
        return links + self.model.effort(motion, np.concatenate([np.zeros(30), theta[30:]]))
