"""An arm with a motion, and what every distortion of the catalogue makes of its efforts, by hand apart from bayesid."""

from collections.abc import Callable
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
from oracles import (
    actuator_efforts,
    built_in_table,
    dh_chain,
    gear,
    joint_torques,
    parameters_of,
    random_clouds,
    random_table,
    turn,
)

from bayesid.effects.catalogue import make_effect
from bayesid.effects.model import Model
from bayesid.motion import Motion
from bayesid.robot import robot_from_table

TABLES = {
    "tx40": built_in_table("tx40"),  # coupled wrist, gravity along -z
    "random": random_table("modified", 4, seed=1),  # a joint that slides, gravity along none of the axes
}
BEGIN, RATE, FASTEST, WARMING = 3.0, 100.0, 3.0, 0.7  # s, Hz, rad/s, s


class Entry(NamedTuple):
    read: Callable  # of the healthy efforts (a function of the table and of times), the table, times, numbers by name
    numbers: Callable  # for joints whose efforts have these RMS values (n,)


def table_error(number, first, last):
    """A number of each row is off, by errors that go from one to another over the joints."""
    return Entry(
        lambda healthy, table, t, error: healthy(off(table, number, error), t),
        lambda size: {"error": np.linspace(first, last, len(size))},
    )


def turned(gravity, first_angle, second_angle):
    """Gravity about the base's axis furthest from it, made perpendicular to it, and about one across both."""
    gravity = np.array(gravity)
    down = gravity / np.linalg.norm(gravity)
    first = np.zeros(3)
    first[np.abs(gravity).argmin()] = 1.0
    first = first - down * (down @ first)
    first = first / np.sqrt(first @ first)
    vector = first_angle * first + second_angle * np.cross(first, down)
    angle = np.linalg.norm(vector)
    return turn(vector / angle, angle) @ gravity if angle else gravity


def off(table, number, error):
    """The table with this number of each row larger by an error."""
    rows = [{**row, number: row[number] + step} for row, step in zip(table["joints"], error, strict=True)]
    return {**table, "joints": rows}


READ = {
    "gain_error": Entry(
        lambda healthy, table, t, gain: healthy(table, t) * gain,
        lambda size: {"gain": np.linspace(0.7, 1.4, len(size))},
    ),
    "delay": Entry(lambda healthy, table, t, lag: healthy(table, t - lag[0]), lambda size: {"lag": (0.0234,)}),
    "base_tilt": Entry(
        lambda healthy, table, t, angle: healthy({**table, "gravity": turned(table["gravity"], *angle)}, t),
        lambda size: {"angle": (0.2, -0.35)},
    ),
    "link_length": table_error("a", 0.03, -0.05),
    "link_twist": table_error("alpha", -0.1, 0.15),
    "link_offset": table_error("d", 0.05, -0.04),
    "joint_zero": table_error("theta", 0.1, -0.15),
    "gear_ratio": Entry(
        lambda healthy, table, t, error: healthy(table, t, 1.0 + np.array(error)),
        lambda size: {"error": np.linspace(0.08, -0.12, len(size))},
    ),
    "clipping": Entry(
        lambda healthy, table, t, limit: healthy(table, t) / np.maximum(1.0, np.abs(healthy(table, t)) / limit),
        lambda size: {"limit": 0.9 * size},
    ),
    "dead_zone": Entry(
        lambda healthy, table, t, width: healthy(table, t) * (np.abs(healthy(table, t)) >= width),
        lambda size: {"width": 0.8 * size},
    ),
    "dead_zone.shrinking": Entry(
        lambda healthy, table, t, width: healthy(table, t) - np.clip(healthy(table, t), -np.array(width), width),
        lambda size: {"width": 0.8 * size},
    ),
}
"""Of each distortion of the catalogue; a new one needs an entry here."""


def sines(n, t):
    """Two sines a joint, up to the highest frequency."""
    rng = np.random.default_rng(5)
    size, phase = rng.uniform(0.2, 0.6, (2, n)), rng.uniform(0, 6, (2, n))
    speed = np.stack([np.full(n, FASTEST), rng.uniform(0.3, 0.6, n) * FASTEST])
    waves = size * np.exp(1j * (speed * t[:, None, None] + phase))
    return Motion(t, *(((1j * speed) ** k * waves).sum(axis=1).imag for k in range(3)))


def cubics(n, t):
    """Cubics of time, which splines follow exactly, beyond their ends as well."""
    a, b, c, d = np.random.default_rng(6).uniform(-0.7, 0.7, (4, n))
    x = t[:, None] - BEGIN - 0.9
    return Motion(t, ((a * x + b) * x + c) * x + d, (3 * a * x + 2 * b) * x + c, 6 * a * x + 2 * b)


class Arm:
    """Point masses, viscous friction, and a zero that drifts; by hand and as a model."""

    def __init__(self, name, motion_at, rate=RATE):
        self.table = TABLES[name]
        n = len(self.table["joints"])
        self.robot = robot_from_table(self.table, "test")
        self.clouds, rng = random_clouds(n, seed=3), np.random.default_rng(4)
        self.viscous, self.drift = rng.uniform(0.5, 3.0, n), rng.uniform(-2.0, 2.0, n)
        drift = make_effect("thermal_drift.offset", {"time": [WARMING] * n})
        self.model = Model(self.robot, (make_effect("rigid_body", {}), make_effect("viscous_friction", {}), drift))
        drifts = np.stack([np.zeros(n), self.drift], axis=1).ravel()
        self.theta = np.concatenate([parameters_of(self.clouds), self.viscous, drifts])
        self.motion_at = lambda t: motion_at(n, t)
        self.t = BEGIN + np.arange(int(1.8 * rate) + 1) / rate
        self.motion = self.motion_at(self.t)

    def healthy(self, table, t, further=None):
        motion, gravity = self.motion_at(t), np.array(table["gravity"])
        if further is not None:  # motors turn by such factors, joints as they are coupled
            of_motors = np.array(table.get("transmission", np.eye(len(further))))
            to_joints = np.linalg.solve(of_motors, np.diag(further) @ of_motors).T
            motion = Motion(t, *(getattr(motion, key) @ to_joints for key in ("q", "dq", "ddq")))
        bodies = actuator_efforts(
            joint_torques(dh_chain(table), self.clouds, gravity, motion), table.get("transmission")
        )
        warmth = 1.0 - np.exp((BEGIN - t) / WARMING)
        return bodies + self.viscous * gear(table, motion.dq) + self.drift * warmth[:, None]

    @cached_property
    def effort(self):
        effort = self.healthy(self.table, self.t)
        effort.setflags(write=False)
        return effort

    def distortion(self, name):
        return make_effect(name, READ[name].numbers(np.sqrt(np.mean(self.effort**2, axis=0))))

    def read(self, distortion, t=None):
        numbers = {key: values for key, values in distortion.shape.items() if key != "joints"}
        return READ[distortion.name].read(self.healthy, self.table, self.t if t is None else t, **numbers)

    @cached_property
    def scene(self):
        effort = self.model.effort(self.motion, self.theta)
        return self.model.scene(self.motion, self.theta, effort, np.abs(effort))


@cache
def shared_arm(name, motion_at, rate=RATE):
    return Arm(name, motion_at, rate)
