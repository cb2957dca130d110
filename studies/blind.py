"""Robot logs with hidden physical effects, to score model discrepancies; shares no code with bayesid.

Rigid bodies are computed by MuJoCo, everything else here from textbooks. Efforts are those of the actuators, so
friction has the sign of the speed. Magnitudes of effects follow from their requested size.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, fields, replace
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple
from weakref import WeakKeyDictionary

import mujoco
import numpy as np
import tomli_w
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq
from scipy.signal import butter, lfilter, sosfiltfilt

KR5 = Path(str(files("bayesid.robot") / "robots" / "kr5-paper.toml"))
GRAVITY = np.array([0.0, 0.0, -9.81])
RATE, SAMPLES, BEFORE = 100, 2400, 100  # Hz; samples of a log; samples before it, for delayed efforts
DURATION = SAMPLES / RATE
RIGID, STANDARD = "rigid_body", "rigid_body,viscous_friction,coulomb_friction,torque_offset,rotor_inertia"
FILES = ("baseline.csv", "holdout.csv", "log.csv", "robot.toml", "terms.txt")
TOLERANCE = 0.01  # of the size
NOISE = 0.01, 0.03  # of each joint's RMS effort in the baseline
SHOWN = 0.3  # least size in the hold-out log over that in the log, if possible

EFFECTS = (
    "viscous_friction",
    "coulomb_friction",
    "asymmetric_coulomb",
    "stribeck_friction",
    "load_dependent_friction",
    "torque_offset",
    "rotor_inertia",
    "joint_spring",
    "gravity_spring",
    "torque_ripple",
    "hysteresis",
    "payload",
    "base_tilt",
    "gain_error",
    "delay",
    "cable_drag",
    "thermal_drift",
    "tool_wrench",
    "clipping",
    "dead_zone",
)
OUTSIDE = "outside"
OUTSIDE_FORMS = ("tanh", "coupling", "velocity_product", "remote_friction", "gaussian_process", "bursts")


def stream(seed, number):
    """Random numbers for one purpose, independent of those for others."""
    return np.random.default_rng([seed, number])


def rms(x):
    return np.sqrt(np.mean(np.square(x), axis=0))


# --- Robot -----------------------------------------------------------------------------------------------------------
class Body(NamedTuple):
    """Mass, centre of mass in the link frame, inertia about it along the link frame's axes."""

    mass: float
    centre: np.ndarray
    inertia: np.ndarray


def dh_matrices(row, q):
    """(M, 4, 4) from frame i - 1 to frame i: Rot z, Trans z, Trans x, Rot x."""
    angle = row["theta"] + np.asarray(q, dtype=float)
    c, s = np.cos(angle), np.sin(angle)
    ca, sa, zero = np.cos(row["alpha"]), np.sin(row["alpha"]), np.zeros_like(angle)
    rows = [
        [c, -s * ca, s * sa, row["a"] * c],
        [s, c * ca, -c * sa, row["a"] * s],
        [zero, zero + sa, zero + ca, zero + row["d"]],
        [zero, zero, zero, zero + 1.0],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def combined(first, second):
    """Two bodies as one (Steiner)."""
    mass = first.mass + second.mass
    centre = (first.mass * first.centre + second.mass * second.centre) / mass
    inertia = np.zeros((3, 3))
    for body in (first, second):
        r = body.centre - centre
        inertia = inertia + body.inertia + body.mass * (r @ r * np.eye(3) - np.outer(r, r))
    return Body(mass, centre, inertia)


def spread_inertia(mass, covariance):
    """Inertia of a mass spread with this covariance; physical whenever the covariance is positive."""
    return mass * (np.trace(covariance) * np.eye(3) - covariance)


def numbers(values):
    return " ".join(f"{float(x):.17g}" for x in values)


@dataclass(frozen=True)
class Robot:
    """DH table, links, and the efforts of healthy joints: fv dq + fc sign(dq) + offset + ia ddq.

    Stribeck friction adds fc bump exp(-(dq / bump_speed)^2) sign(dq).
    """

    table: dict
    links: tuple[Body, ...]
    viscous: np.ndarray
    coulomb: np.ndarray
    offset: np.ndarray
    rotor: np.ndarray
    bump: float = 0.0
    bump_speed: float = 0.1  # rad/s

    @property
    def n(self):
        return len(self.links)

    @property
    def xml(self):
        """The arm for MuJoCo: body i has link frame i, its joint turns about z of frame i - 1."""
        opening, closing = "", ""
        for row, body in zip(self.table["joints"], self.links, strict=True):
            frame = dh_matrices(row, np.zeros(1))[0]
            rotation, origin = frame[:3, :3], frame[:3, 3]
            quat, inertia = np.zeros(4), body.inertia
            mujoco.mju_mat2Quat(quat, rotation.ravel())
            full = [*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]]
            opening += f'<body pos="{numbers(origin)}" quat="{numbers(quat)}">'
            opening += f'<inertial pos="{numbers(body.centre)}" mass="{body.mass:.17g}" fullinertia="{numbers(full)}"/>'
            opening += f'<joint type="hinge" axis="{numbers(rotation[2])}" pos="{numbers(-rotation.T @ origin)}"/>'
            closing += "</body>"
        flags = '<flag contact="disable" constraint="disable" limit="disable" frictionloss="disable"/>'
        option = f'<option gravity="{numbers(self.table["gravity"])}">{flags}</option>'
        head = f'<mujoco><compiler angle="radian" autolimits="true"/>{option}<worldbody>'
        return f"{head}{opening}{closing}</worldbody></mujoco>"

    def rigid_efforts(self, q, dq, ddq):
        """(M, n) efforts of the rigid bodies by MuJoCo's inverse dynamics."""
        model = mujoco.MjModel.from_xml_string(self.xml)
        data, efforts = mujoco.MjData(model), np.empty_like(q)
        qpos, qvel, qacc, out = data.qpos, data.qvel, data.qacc, data.qfrc_inverse
        for k in range(len(q)):
            qpos[:], qvel[:], qacc[:] = q[k], dq[k], ddq[k]
            mujoco.mj_inverse(model, data)
            efforts[k] = out
        return efforts

    def loaded(self, body):
        """The robot with a body held by its last link."""
        return replace(self, links=(*self.links[:-1], combined(self.links[-1], body)))


def random_row(rng, parallel, last):
    """A DH row; parallel axes have a distance."""
    if parallel:
        alpha = 0.0
    elif rng.random() < 0.75:
        alpha = float(rng.choice([-1, 1])) * np.pi / 2
    else:
        alpha = float(rng.choice([-1, 1]) * rng.uniform(0.5, 1.3))
    a = float(rng.uniform(0.1, 0.5)) if parallel or rng.random() < 0.5 else 0.0
    d = float(rng.choice([-1, 1]) * rng.uniform(0.1, 0.4)) if a == 0.0 or rng.random() < 0.3 else 0.0
    theta = float(rng.choice([0.0, np.pi / 2, -np.pi / 2, rng.uniform(-3, 3)]))
    return {"a": a, "alpha": alpha, "d": 0.3 * d if last else d, "theta": theta}


def random_joints(rng):
    n, rows, parallel = int(rng.integers(4, 8)), [], 0
    for i in range(n):
        chance = 0.1 if i == 0 else 0.3
        parallel = parallel + 1 if parallel < 2 and rng.random() < chance else 0
        rows.append(random_row(rng, parallel > 0, i == n - 1))
    return rows


def random_links(rng, joints, masses):
    """A rod from the joint to the link frame, off the axis, with some thickness."""
    links = []
    for row, mass in zip(joints, masses, strict=True):
        frame = dh_matrices(row, np.zeros(1))[0]
        start = -frame[:3, :3].T @ frame[:3, 3]
        thickness = rng.uniform(0.03, 0.07, 3)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        covariance = np.outer(start, start) / 12 + turn @ np.diag(thickness**2) @ turn.T
        centre = rng.uniform(0.3, 0.7) * start + rng.choice([-1, 1], 3) * rng.uniform(0.01, 0.05, 3)
        links.append(Body(float(mass), centre, spread_inertia(mass, covariance)))
    return tuple(links)


def kr5_masses(rng):
    masses = np.array([11.0, 7.0, 5.5, 2.2, 1.5, 0.8]) * rng.uniform(0.9, 1.1, 6)
    return 28.0 * masses / masses.sum()


def bare_robot(rng, kind):
    if kind == "kr5":
        joints = tomllib.loads(KR5.read_text(encoding="utf-8"))["joints"]
        masses = kr5_masses(rng)
    else:
        joints = random_joints(rng)
        masses = np.geomspace(8.0, 0.8, len(joints)) * rng.uniform(0.8, 1.25, len(joints))
    table = {"name": "robot", "convention": "standard", "gravity": GRAVITY.tolist(), "joints": joints}
    none = np.zeros(len(joints))
    return Robot(table, random_links(rng, joints, masses), none, none, none, none)


def with_joints(rng, robot, play):
    """The robot with friction, offsets and rotors, in proportion to its efforts in a motion."""
    scale, n = rms(play.rigid), robot.n
    share = rng.uniform(0.3, 0.7, n)
    speed = rms(play.dq)
    friction = scale * rng.uniform(0.05, 0.2, n)
    friction /= rms(share * play.dq / speed + (1 - share) * np.sign(play.dq))
    offset = scale * rng.uniform(-0.02, 0.02, n)
    rotor = scale * rng.uniform(0.03, 0.12, n) / rms(play.ddq)
    viscous, coulomb = friction * share / speed, friction * (1 - share)
    return replace(robot, viscous=viscous, coulomb=coulomb, offset=offset, rotor=rotor)


# --- Errors of model and noise that all logs share --------------------------------------------------------------------
class Trouble(NamedTuple):
    """Errors of the model or the noise that all three logs share; none is a hidden effect.

    length, angle: sd of the errors of a and d, m, and of alpha and theta, rad, in the table. memory: AR(1) coefficient
    of the noise. cutoff: low-pass of the efforts before rectification, Hz; 0 for none. bits: of the readings, from
    minus to plus the joint's largest healthy effort, in place of noise; 0 for none. stribeck: static over Coulomb
    friction, minus one; the log then has slow parts.
    """

    length: float = 0.0
    angle: float = 0.0
    memory: float = 0.0
    cutoff: float = 0.0
    bits: int = 0
    stribeck: float = 0.0


NO_TROUBLE = Trouble()


def wrong_table(table, trouble, rng):
    """The true table of a robot whose stated table has errors."""
    sd = {"a": trouble.length, "alpha": trouble.angle, "d": trouble.length, "theta": trouble.angle}
    joints = [{key: row[key] + step * rng.standard_normal() for key, step in sd.items()} for row in table["joints"]]
    return {**table, "joints": joints}


def noise_like(draws, memory):
    """AR(1) noise from independent draws (M, n), stationary and of the same sd."""
    steps = draws * np.sqrt(1.0 - memory**2)
    steps[0] = draws[0]
    return lfilter([1.0], [1.0, -memory], steps, axis=0)


def low_passed(efforts, cutoff):
    return sosfiltfilt(butter(2, cutoff, fs=RATE, output="sos"), efforts, axis=0) if cutoff else efforts


# --- Motion ----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Series:
    """Fourier series (n, 5) about centres (n,), times an envelope low + (1 - low) sin^4(pi t / period + phase)."""

    frequency: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    centre: np.ndarray
    envelope: tuple[float, float, float] | None

    def wave(self, t):
        """Value, speed and acceleration (M, n) without centre."""
        w = 2 * np.pi * self.frequency
        angle = w * t[:, None, None]
        c, s = np.cos(angle), np.sin(angle)
        value = self.cosine * c + self.sine * s
        speed = np.sum(w * (self.sine * c - self.cosine * s), axis=-1)
        f = (value.sum(axis=-1), speed, -np.sum(w**2 * value, axis=-1))
        if self.envelope is None:
            return f
        e = (part[:, None] for part in self.modulation(t))
        return product(tuple(e), f)

    def modulation(self, t):
        low, period, phase = self.envelope
        w = np.pi / period
        s, c = np.sin(w * t + phase), np.cos(w * t + phase)
        rise = 1 - low
        return low + rise * s**4, rise * 4 * w * s**3 * c, rise * 4 * w**2 * (3 * s**2 * c**2 - s**4)

    def __call__(self, t):
        q, dq, ddq = self.wave(t)
        return self.centre + q, dq, ddq


def product(e, f):
    """A product with its two derivatives."""
    return e[0] * f[0], e[1] * f[0] + e[0] * f[1], e[2] * f[0] + 2 * e[1] * f[1] + e[0] * f[2]


def random_series(rng, n, slow):
    """A random motion within 2 rad, with peak speeds of 1 to 2.5 rad/s where the range allows."""
    frequency = np.arange(1, 6) / rng.uniform(8, 12) * np.ones((n, 1))
    if rng.random() < 0.5:
        frequency = frequency * (1 + 0.15 * rng.uniform(-1, 1, (n, 5)))
    cosine, sine = rng.normal(size=(2, n, 5)) / np.sqrt(np.arange(1, 6))
    envelope = (0.04, float(rng.uniform(8, 14)), float(rng.uniform(0, np.pi))) if slow else None
    series = Series(frequency, cosine, sine, np.zeros(n), envelope)
    q, dq, _ = series.wave(times())
    reach, peak = np.abs(q).max(axis=0), np.abs(dq).max(axis=0)
    scale = np.minimum(rng.uniform(1.0, 2.5, n) / peak, 1.8 / reach)
    centre = rng.uniform(-1, 1, n) * np.minimum(0.8, 2.0 - scale * reach)
    return Series(frequency, cosine * scale[:, None], sine * scale[:, None], centre, envelope)


def times():
    return np.arange(-BEFORE, SAMPLES) / RATE


class Play:
    """A robot in a motion that begins BEFORE samples ahead of the log."""

    def __init__(self, robot, series):
        self.robot, self.t = robot, times()
        self.q, self.dq, self.ddq = series(self.t)
        self.rigid = robot.rigid_efforts(self.q, self.dq, self.ddq)

    @cached_property
    def frames(self):
        """(M, n + 1, 4, 4) of the base and the links."""
        frames = [np.broadcast_to(np.eye(4), (len(self.t), 4, 4))]
        for row, q in zip(self.robot.table["joints"], self.q.T, strict=True):
            frames.append(frames[-1] @ dh_matrices(row, q))
        return np.stack(frames, axis=1)

    @cached_property
    def weights(self):
        """(M, n, 3): torques that hold the links are weights @ gravity."""
        axes, origins = self.frames[:, :-1, :3, 2], self.frames[:, :-1, :3, 3]
        total = np.zeros_like(axes)
        for i, body in enumerate(self.robot.links):
            frame = self.frames[:, i + 1]
            centre = frame[:, :3, :3] @ body.centre + frame[:, :3, 3]
            total[:, : i + 1] -= body.mass * np.cross(axes[:, : i + 1], centre[:, None] - origins[:, : i + 1])
        return total

    def healthy(self):
        robot = self.robot
        dry = 1 + robot.bump * np.exp(-((self.dq / robot.bump_speed) ** 2))
        friction = robot.viscous * self.dq + robot.coulomb * dry * np.sign(self.dq)
        return self.rigid + friction + robot.offset + robot.rotor * self.ddq

    def under(self, robot):
        """The same motion with other joints; efforts of the rigid bodies are kept."""
        other = copy(self)
        other.robot = robot
        return other


# --- Effects ---------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Draft:
    """An effect without magnitude; act(play, efforts, magnitude) returns the efforts with it.

    Without a limit the effect is proportional to the magnitude; otherwise the magnitude is searched below the limit.
    """

    joint: int | None
    parameters: dict
    act: Callable
    limit: float | None = None


def on_joint(j, parameters, shape, sign=1.0):
    """A torque on joint j, proportional to its magnitude."""

    def act(play, efforts, magnitude):
        result = efforts.copy()
        result[:, j] += sign * magnitude * shape(play)
        return result

    return Draft(j, parameters | {"sign": sign}, act)


def on_robot(parameters, shape):
    """Torques (M, n) proportional to their magnitude."""
    return Draft(None, parameters, lambda play, efforts, magnitude: efforts + magnitude * shape(play))


def either(rng):
    return float(rng.choice([-1.0, 1.0]))


def pick(rng, *names):
    return str(rng.choice(names))


def viscous_friction(rng, play, j):
    return on_joint(j, {}, lambda p: p.dq[:, j])


def coulomb_friction(rng, play, j):
    return on_joint(j, {}, lambda p: np.sign(p.dq[:, j]))


def asymmetric_coulomb(rng, play, j):
    weaker, strong = float(rng.uniform(0.0, 0.6)), either(rng)

    def shape(p):
        direction = np.sign(p.dq[:, j])
        return np.where(direction == strong, 1.0, weaker) * direction

    return on_joint(j, {"weaker": weaker, "strong_direction": strong}, shape)


def stribeck_friction(rng, play, j):
    form = pick(rng, "full", "bump", "exponential")
    speed, ratio = float(rng.uniform(0.05, 0.3)), float(rng.uniform(1.5, 3.0))

    def shape(p):
        x = np.abs(p.dq[:, j]) / speed
        bump = np.exp(-x) if form == "exponential" else np.exp(-(x**2))
        return (bump if form == "bump" else 1 + (ratio - 1) * bump) * np.sign(p.dq[:, j])

    return on_joint(j, {"form": form, "speed": speed, "static_over_coulomb": ratio}, shape)


def load_dependent_friction(rng, play, j):
    return on_joint(j, {}, lambda p: np.abs(p.rigid[:, j]) * np.sign(p.dq[:, j]))


def torque_offset(rng, play, j):
    return on_joint(j, {}, lambda p: 1.0, either(rng))


def rotor_inertia(rng, play, j):
    return on_joint(j, {}, lambda p: p.ddq[:, j])


def within(rng, play, j, low, high):
    """A random quantile of the joint's positions, from `low` to `high`."""
    return float(np.quantile(play.q[BEFORE:, j], rng.uniform(low, high)))


def joint_spring(rng, play, j):
    rest = within(rng, play, j, 0.1, 0.9)
    return on_joint(j, {"rest": rest}, lambda p: p.q[:, j] - rest)


def gravity_spring(rng, play, j):
    form, rest = pick(rng, "sine", "two_points"), float(rng.uniform(-np.pi, np.pi))
    near, far, free = rng.uniform(0.05, 0.2), rng.uniform(0.3, 0.6), rng.uniform(0.3, 0.95)
    length = float(free * (far - near))

    def shape(p):
        x = p.q[:, j] - rest
        if form == "sine":
            return np.sin(x)
        distance = np.sqrt(near**2 + far**2 - 2 * near * far * np.cos(x))
        return (distance - length) * near * far * np.sin(x) / distance

    lengths = {"near": float(near), "far": float(far), "free_length": length} if form == "two_points" else {}
    return on_joint(j, {"form": form, "rest": rest} | lengths, shape)


def torque_ripple(rng, play, j):
    fastest = np.abs(play.dq[:, j]).max()
    most = int(np.clip(2 * np.pi * 20 / fastest, 6, 60))  # 20 Hz at most
    order, phase = int(rng.integers(5, most + 1)), float(rng.uniform(0, 2 * np.pi))
    second = float(rng.uniform(0.2, 0.5)) if 2 * order <= most and rng.random() < 0.4 else 0.0
    other = float(rng.uniform(0, 2 * np.pi))

    def shape(p):
        q = p.q[:, j]
        return np.sin(order * q + phase) + second * np.sin(2 * order * q + other)

    return on_joint(j, {"order": order, "phase": phase, "second": second, "second_phase": other}, shape)


def stop_operator(q, width):
    """Elastic up to the width, then sliding; -1 to 1."""
    steps, z, out = (np.diff(q, prepend=q[0]) / width).tolist(), 0.0, []
    for step in steps:
        z = min(1.0, max(-1.0, z + step))
        out.append(z)
    return np.array(out)


def dahl(q, width):
    """dz/dq = (1 - z sign(dq)) / width; exact for motions without reversal within a sample."""
    steps, z, out = (np.diff(q, prepend=q[0]) / width).tolist(), 0.0, []
    decay = np.exp(-np.abs(steps)).tolist()
    for step, share in zip(steps, decay, strict=True):
        end = 1.0 if step > 0 else -1.0
        z = end + (z - end) * share
        out.append(z)
    return np.array(out)


def bouc_wen(q, width, beta, power):
    """dz/dq = (1 - |z|^power (beta sign(z dq) + 1 - beta)) / width, by midpoint steps."""

    def slope(z, direction):
        return 1.0 - abs(z) ** power * (beta * (1.0 if z * direction > 0 else -1.0) + 1.0 - beta)

    z, out = 0.0, []
    for step in (np.diff(q, prepend=q[0]) / width).tolist():
        parts = 1 + int(abs(step) / 0.25)
        h = step / parts
        for _ in range(parts):
            z += h * slope(z + 0.5 * h * slope(z, h), h)
        out.append(z)
    return np.array(out)


def hysteresis(rng, play, j):
    form, width = (
        pick(rng, "stop", "maxwell_slip", "dahl", "bouc_wen"),
        float(np.exp(rng.uniform(*np.log([0.02, 0.2])))),
    )
    beta, power = float(rng.uniform(0.5, 0.9)), float(rng.choice([1.0, 2.0]))
    shapes = {
        "stop": lambda q: stop_operator(q, width),
        "maxwell_slip": lambda q: sum(stop_operator(q, share * width) for share in (0.25, 0.5, 0.75, 1.0)) / 4,
        "dahl": lambda q: dahl(q, width),
        "bouc_wen": lambda q: bouc_wen(q, width, beta, power),
    }
    more = {"beta": beta, "power": power} if form == "bouc_wen" else {}
    return on_joint(j, {"form": form, "width": width} | more, lambda p: shapes[form](p.q[:, j]))


def payload(rng, play, j):
    """The magnitude is the mass; the inertia is proportional to it."""
    direction = rng.normal(size=3)
    centre = rng.uniform(0.03, 0.12) * direction / np.linalg.norm(direction)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    radii = rng.uniform(0.02, 0.08, 3)
    body = Body(1.0, centre, spread_inertia(1.0, turn @ np.diag(radii**2) @ turn.T))
    units = WeakKeyDictionary()

    def shape(p):
        if p not in units:
            units[p] = p.robot.loaded(body).rigid_efforts(p.q, p.dq, p.ddq) - p.rigid
        return units[p]

    return on_robot({"centre": centre.tolist(), "inertia_per_mass": body.inertia.tolist()}, shape)


def base_tilt(rng, play, j):
    heading = float(rng.uniform(0, 2 * np.pi))
    axis = np.array([np.cos(heading), np.sin(heading), 0.0])

    def act(p, efforts, angle):
        tilted = np.cos(angle) * GRAVITY + np.sin(angle) * np.cross(axis, GRAVITY)
        return efforts + p.weights @ (tilted - GRAVITY)

    return Draft(None, {"heading": heading}, act, 1.0)


def gain_error(rng, play, j):
    sign = either(rng)

    def act(p, efforts, magnitude):
        result = efforts.copy()
        result[:, j] *= 1 + sign * magnitude
        return result

    return Draft(j, {"sign": sign}, act)


def delay(rng, play, j):
    joint = None if rng.random() < 0.5 else j

    def act(p, efforts, lag):
        columns = slice(None) if joint is None else joint
        result = efforts.copy()
        late = np.maximum(p.t - lag, p.t[0])
        result[:, columns] = PchipInterpolator(p.t, efforts[:, columns])(late)
        return result

    return Draft(joint, {"all_joints": joint is None}, act, 0.95 * BEFORE / RATE)


def cable_drag(rng, play, j):
    form, side = pick(rng, "beyond", "friction", "cubic"), either(rng)
    rest = within(rng, play, j, *((0.3, 0.7) if form == "beyond" else (0.2, 0.8)))

    def shape(p):
        x = p.q[:, j] - rest
        if form == "beyond":
            return side * np.maximum(0.0, side * x)
        return x**3 if form == "cubic" else np.abs(x) * np.sign(p.dq[:, j])

    return on_joint(j, {"form": form, "rest": rest, "side": side}, shape)


def thermal_drift(rng, play, j):
    form = pick(rng, "coulomb", "viscous", "both", "offset_fading", "offset_growing")
    constant, share = float(rng.uniform(0.3, 1.5) * DURATION), float(rng.uniform(0.3, 0.7))

    def shape(p):
        dq, fading = p.dq[:, j], np.exp(-p.t / constant)
        sizes = {
            "coulomb": np.sign(dq) * fading,
            "viscous": dq * fading,
            "both": (share * np.sign(dq) + (1 - share) * dq) * fading,
            "offset_fading": fading,
            "offset_growing": 1 - fading,
        }
        return sizes[form]

    sign = either(rng) if form.startswith("offset") else 1.0
    return on_joint(j, {"form": form, "time_constant": constant, "coulomb_share": share}, shape, sign)


def tool_wrench(rng, play, j):
    frame, lever = pick(rng, "base", "tool"), float(rng.uniform(0.05, 0.3)) if rng.random() < 0.5 else 0.0
    force, torque = rng.normal(size=(2, 3))
    force, torque = force / np.linalg.norm(force), lever * torque / np.linalg.norm(torque)

    def shape(p):
        turn = p.frames[:, -1, :3, :3] if frame == "tool" else np.eye(3)
        f, m = (np.broadcast_to(turn @ x, (len(p.t), 3))[:, None] for x in (force, torque))
        axes, origins, flange = p.frames[:, :-1, :3, 2], p.frames[:, :-1, :3, 3], p.frames[:, -1:, :3, 3]
        return -np.sum(f * np.cross(axes, flange - origins) + m * axes, axis=-1)

    return on_robot({"frame": frame, "force": force.tolist(), "torque_per_force": torque.tolist()}, shape)


def clipping(rng, play, j):
    """The magnitude is the distance of the limit below 1.5 times the healthy robot's peak."""
    peak = 1.5 * float(np.abs(play.healthy()[BEFORE:, j]).max())

    def act(p, efforts, depth):
        result = efforts.copy()
        result[:, j] = np.clip(efforts[:, j], depth - peak, peak - depth)
        return result

    return Draft(j, {"peak": peak}, act, peak)


def dead_zone(rng, play, j):
    form = pick(rng, "reads_zero", "shrunk")

    def act(p, efforts, width):
        result, x = efforts.copy(), efforts[:, j]
        shrunk = np.sign(x) * np.maximum(np.abs(x) - width, 0.0)
        result[:, j] = shrunk if form == "shrunk" else np.where(np.abs(x) < width, 0.0, x)
        return result

    return Draft(j, {"form": form}, act, float(np.abs(play.healthy()[BEFORE:, j]).max()))


def tanh_torque(rng, play, j, k):
    phase = float(rng.uniform(0, np.pi))
    return {"phase": phase}, lambda p: np.tanh(3 * np.sin(2 * p.q[:, j] + phase) * p.dq[:, j])


def coupling(rng, play, j, k):
    first, second = play.q[BEFORE:, [j, k]].mean(axis=0).tolist()
    return {"zeros": [first, second]}, lambda p: (p.q[:, j] - first) * (p.q[:, k] - second)


def velocity_product(rng, play, j, k):
    power = int(rng.integers(1, 3))
    return {"power": power}, lambda p: p.dq[:, j] * p.dq[:, k] ** power


def remote_friction(rng, play, j, k):
    phase = float(rng.uniform(0, 2 * np.pi))
    return {"phase": phase}, lambda p: np.maximum(0.0, np.sin(3 * p.q[:, k] + phase)) * np.sign(p.dq[:, j])


def gaussian_process(rng, play, j, k):
    """A random function of position and speed, by random Fourier features."""
    waves, phases = rng.normal(size=(2, 80)) / [[0.3], [0.5]], rng.uniform(0, 2 * np.pi, 80)
    return {}, lambda p: np.cos(np.outer(p.q[:, j], waves[0]) + np.outer(p.dq[:, j], waves[1]) + phases).sum(axis=1)


def bursts(rng, play, j, k):
    frequency, starts = float(rng.uniform(2, 12)), np.sort(rng.uniform(0, DURATION - 3, 4))
    lengths = rng.uniform(1, 3, 4)

    def shape(p):
        windows = (p.t[:, None] >= starts) & (p.t[:, None] < starts + lengths)
        return windows.any(axis=1) * np.sin(2 * np.pi * frequency * p.t)

    return {"frequency": frequency, "starts": starts.tolist(), "lengths": lengths.tolist()}, shape


OUTSIDE_SHAPES = dict(
    zip(
        OUTSIDE_FORMS, (tanh_torque, coupling, velocity_product, remote_friction, gaussian_process, bursts), strict=True
    )
)


def outside(rng, play, j):
    form, k = pick(rng, *OUTSIDE_FORMS), (j + int(rng.integers(1, play.robot.n))) % play.robot.n
    parameters, shape = OUTSIDE_SHAPES[form](rng, play, j, k)
    return on_joint(
        j, {"form": form, "other_joint": k + 1} | parameters, shape, either(rng) if form != "remote_friction" else 1.0
    )


DRAFTS = {name: globals()[name] for name in (*EFFECTS, OUTSIDE)}
READERS = ("clipping", "dead_zone")  # errors of the sensor, which may act on the noise as well
ORDER = ("delay", "gain_error", *READERS)  # effects on the sum of all torques, in this order


# --- Size ------------------------------------------------------------------------------------------------------------
def ratio_of(with_, without, sd):
    """RMS of an effect over the noise, for the joint where this is largest."""
    return float(np.max(rms((with_ - without)[BEFORE:]) / sd))


def magnitude_for(draft, play, efforts, sd, size):
    """Magnitude that gives the size; None if there is none."""

    def ratio(x):
        return ratio_of(draft.act(play, efforts, x), efforts, sd)

    if draft.limit is None:
        unit = ratio(1.0)
        return size / unit if unit > 0 else None
    low, high = 0.0, draft.limit / 1024
    while ratio(high) < size:
        low, high = high, 2 * high
        if high > draft.limit:
            return None
    return float(brentq(lambda x: ratio(x) - size, low, high, xtol=1e-12, rtol=1e-6))


@dataclass(frozen=True)
class Hidden:
    """An effect with its magnitude, and its size in the hold-out log."""

    name: str
    draft: Draft
    magnitude: float
    holdout_size: float

    def act(self, play, efforts):
        return self.draft.act(play, efforts, self.magnitude)


def sized(name, draft, plays, efforts, sd, size):
    """The effect at this size in the first of the plays; None if that is not possible."""
    x = magnitude_for(draft, plays[0], efforts[0], sd, size)
    if x is None:
        return None
    found, later = (ratio_of(draft.act(p, e, x), e, sd) for p, e in zip(plays, efforts, strict=True))
    return Hidden(name, draft, float(x), later) if abs(found / size - 1) < TOLERANCE else None


def hide(name, rng, plays, efforts, sd, size, joint):
    """The effect at this size, in the joint if it is possible there and shows in the hold-out log too.

    `plays` and `efforts` are those of the log and the hold-out log.
    """
    for attempt in range(100):
        j = joint if attempt < 20 else int(rng.integers(plays[0].robot.n))
        effect = sized(name, DRAFTS[name](rng, plays[0], j), plays, efforts, sd, size)
        if effect is not None and (effect.holdout_size > SHOWN * size or attempt >= 60):
            return effect
    raise RuntimeError(f"{name}: no magnitude gives the size {size}")


# --- Cases -----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Truth:
    """The truth of a case; written to another folder than the case.

    Joints, from 1: one tuple per effect, () for the whole robot. Efforts are signed and include noise. The floor (n,)
    is the RMS error of the hold-out log's efforts due to noise alone.
    """

    effects: tuple[str, ...]
    joints: tuple[tuple[int, ...], ...]
    parameters: dict
    size: float
    noise: np.ndarray
    log_efforts: np.ndarray
    holdout_efforts: np.ndarray
    floor: np.ndarray

    @property
    def log_signs(self):
        return np.sign(self.log_efforts)


ARRAYS = ("noise", "log_efforts", "holdout_efforts", "floor")


def write_truth(path, truth):
    """As .npz, plain arrays and JSON."""
    plain = {f.name: getattr(truth, f.name) for f in fields(truth) if f.name not in ARRAYS}
    with Path(path).open("wb") as file:
        np.savez(file, plain=json.dumps(plain), **{name: getattr(truth, name) for name in ARRAYS})


def read_truth(path):
    with np.load(path) as data:
        plain = json.loads(str(data["plain"]))
        arrays = {name: data[name] for name in ARRAYS}
    joints = tuple(tuple(j) for j in plain.pop("joints"))
    return Truth(effects=tuple(plain.pop("effects")), joints=joints, **plain, **arrays)


@dataclass(frozen=True)
class Log:
    """A log's motion, and its signed efforts (N, n) without and with noise."""

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    clean: np.ndarray
    measured: np.ndarray


@dataclass(frozen=True)
class Simulation:
    """A case before it is written."""

    robot: Robot
    table: dict
    terms: str
    baseline: Log
    log: Log
    holdout: Log
    noise: np.ndarray
    hidden: tuple[Hidden, ...]
    parameters: dict
    plays: tuple[Play, ...]


@dataclass(frozen=True)
class Scene:
    """A robot's three motions without hidden effects: of the baseline, the log and the hold-out log.

    `stated` is the robot with its stated table; `steps` (n,) are those of quantised readings, or 0.
    """

    seed: int
    stated: Robot
    plays: tuple[Play, Play, Play]
    noise: np.ndarray
    steps: np.ndarray
    trouble: Trouble
    parameters: dict

    @property
    def robot(self):
        return self.plays[0].robot


def drawn_scene(seed, robot=None, style=None, slow=None, slow_baseline=None, trouble=NO_TROUBLE, noise=NOISE):
    """Robot, motions and noise; robot is "kr5" or "random", style "bare" or "standard"; None for a random choice.

    `slow`: whether log and hold-out log have slow parts.
    """
    rng = stream(seed, 0)
    drawn = "kr5" if rng.random() < 0.4 else "random", "standard" if rng.random() < 0.5 else "bare", rng.random() < 0.2
    robot, style, slow = (d if x is None else x for x, d in zip((robot, style, slow), drawn, strict=True))
    drawn_baseline = rng.random() < 0.2
    slow_baseline = drawn_baseline if slow_baseline is None else slow_baseline
    stated = bare_robot(rng, robot)
    arm = replace(stated, table=wrong_table(stated.table, trouble, stream(seed, 11)), bump=trouble.stribeck)
    series = [random_series(stream(seed, 1 + i), arm.n, x) for i, x in enumerate((slow_baseline, slow, slow))]
    plays = [Play(arm, s) for s in series]
    if style == "standard":
        arm = with_joints(stream(seed, 4), arm, plays[0])
        plays = [play.under(arm) for play in plays]
    healthy = [play.healthy()[BEFORE:] for play in plays]
    peaks, sd = np.max(np.abs(healthy), axis=(0, 1)), stream(seed, 6).uniform(*noise, arm.n) * rms(healthy[0])
    steps = 2 * peaks / 2**trouble.bits if trouble.bits else np.zeros(arm.n)
    sd = steps / np.sqrt(12) if trouble.bits else sd
    parameters = {"robot": robot, "style": style, "slow": bool(slow)}
    return Scene(seed, stated, tuple(plays), sd, steps, trouble, parameters)


def played(scene, number, hidden, noise_first):
    """The log of one of the scene's motions with its hidden effects."""
    play, trouble = scene.plays[number], scene.trouble
    efforts = play.healthy()
    noise = scene.noise * noise_like(
        stream(scene.seed, 8 + number).standard_normal((SAMPLES, play.robot.n)), trouble.memory
    )
    noise = 0.0 * noise if trouble.bits else noise
    measured = efforts[BEFORE:] + noise
    for effect in hidden:
        efforts = effect.act(play, efforts)
        of_noise = noise_first and effect.name in READERS
        measured = effect.act(play, measured) if of_noise else efforts[BEFORE:] + noise
    measured = np.rint(measured / scene.steps) * scene.steps if trouble.bits else measured
    t, q, dq, clean = (x[BEFORE:] for x in (play.t, play.q, play.dq, efforts))
    return Log(t - t[0], q, dq, clean, low_passed(measured, trouble.cutoff))


def simulation(scene, in_log, in_holdout):
    """The logs of a scene with effects hidden in the log and in the hold-out log."""
    noise_first = bool(stream(scene.seed, 7).random() < 0.5)
    logs = [played(scene, i, hidden, noise_first) for i, hidden in enumerate(((), in_log, in_holdout))]
    effects = tuple(in_log) or tuple(in_holdout)
    parameters = scene.parameters | {"noise_before_sensor": noise_first}
    parameters["effects"] = [
        h.draft.parameters | {"magnitude": h.magnitude, "holdout_size": h.holdout_size} for h in effects
    ]
    terms = STANDARD if parameters["style"] == "standard" else RIGID
    return Simulation(scene.robot, scene.stated.table, terms, *logs, scene.noise, effects, parameters, scene.plays)


def first_torques(names):
    """Torques first, then the effects on their sum in the order of ORDER."""
    return sorted(names, key=lambda name: ORDER.index(name) + 1 if name in ORDER else 0)


def all_hidden(names, seed, plays, sd, size):
    """The effects, each at its size; two share a joint half of the time."""
    rng, n = stream(seed, 5), plays[0].robot.n
    joint, efforts, hidden = int(rng.integers(n)), [play.healthy() for play in plays], []
    for name in first_torques(names):
        effect = hide(name, rng, plays, efforts, sd, size, joint)
        hidden.append(effect)
        efforts = [effect.act(p, e) for p, e in zip(plays, efforts, strict=True)]
        joint = joint if effect.draft.joint is None else effect.draft.joint
        if rng.random() < 0.5:
            joint = (joint + int(rng.integers(1, n))) % n
    return tuple(hidden)


def simulate(seed, effect, size, robot=None, style=None, slow=None, trouble=NO_TROUBLE):
    """A case's three logs; see drawn_scene."""
    names = () if effect is None else (effect,) if isinstance(effect, str) else tuple(effect)
    slow = True if "stribeck_friction" in names else slow
    scene = drawn_scene(seed, robot, style, slow, trouble=trouble)
    hidden = all_hidden(names, seed, scene.plays[1:], scene.noise, size)
    return simulation(scene, hidden, hidden)


def write_log(path, log):
    """Writes efforts without sign; column widths do not depend on the values."""
    n = log.q.shape[1]
    header = ",".join(["t", *(f"q{i + 1}" for i in range(n)), *(f"tau{i + 1}" for i in range(n))])
    line = ",".join(["%.2f", *["%.15f"] * n, *["%.9e"] * n]) + "\n"
    values = np.column_stack([log.t, log.q, np.abs(log.measured)])
    Path(path).write_text(header + "\n" + (line * len(values)) % tuple(values.ravel().tolist()), encoding="utf-8")


def truth_of(case, size):
    """The truth of a simulated case."""
    names = tuple(h.name for h in case.hidden)
    joints = tuple(() if h.draft.joint is None else (h.draft.joint + 1,) for h in case.hidden)
    floor = rms(np.abs(case.holdout.measured) - np.abs(case.holdout.clean))
    efforts = case.log.measured, case.holdout.measured
    return Truth(names, joints, case.parameters, float(size) if names else 0.0, case.noise, *efforts, floor)


def write_case(folder, case):
    """Write a simulated case's FILES into the folder."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.toml").write_text(tomli_w.dumps(case.table))
    (folder / "terms.txt").write_text(case.terms + "\n")
    for name in ("baseline", "log", "holdout"):
        write_log(folder / f"{name}.csv", getattr(case, name))


def make_case(folder, seed, effect, size, robot=None, style=None, slow=None, trouble=NO_TROUBLE):
    """Write FILES into the folder and return the truth; an effect is a name, two names, "outside" or None."""
    case = simulate(seed, effect, size, robot, style, slow, trouble)
    write_case(folder, case)
    return truth_of(case, size)


# --- Plan ------------------------------------------------------------------------------------------------------------
class Case(NamedTuple):
    """Arguments of make_case."""

    seed: int
    effect: str | tuple[str, str] | None
    size: float
    robot: str
    style: str


def shares(trials):
    """Numbers of cases with a single effect, a pair, none, and one outside; at least one each from eight trials."""
    exact = np.array([220, 25, 30, 25]) * trials / 300
    counts = np.floor(exact).astype(int)
    if trials >= 8:
        counts = np.maximum(counts, 1)
    while counts.sum() != trials:
        step = 1 if counts.sum() < trials else -1
        counts[np.argmax(step * (exact - counts))] += step
    return counts.tolist()


def log_uniform(rng, low, high, count):
    """Sizes that fill the range evenly."""
    return low * (high / low) ** rng.permutation((np.arange(count) + rng.random(count)) / max(count, 1))


def turns(rng, count):
    """Effects in random order, each again only after all others."""
    return [str(x) for _ in range(-(-count // len(EFFECTS))) for x in rng.permutation(EFFECTS)][:count]


def random_pairs(rng, count):
    first, pairs = turns(rng, count), []
    for name in first:
        others = [x for x in EFFECTS if x != name]
        pairs.append((name, str(rng.choice(others))))
    return pairs


def single_sizes(rng, names):
    """Sizes of 0.5 to 10 that fill the range evenly within each effect."""
    sizes = {name: iter(log_uniform(rng, 0.5, 10.0, names.count(name))) for name in sorted(set(names))}
    return [next(sizes[name]) for name in names]


def arms(effects):
    """(robot, style) for each, in turn for each effect: two of five are a KR5, one of two is bare."""
    seen, found = {}, []
    for effect in effects:
        kind = "pair" if isinstance(effect, tuple) else effect
        turn = seen.setdefault(kind, len(seen))
        seen[kind] += 1
        found.append((("kr5", "random", "random", "kr5", "random")[turn % 5], ("bare", "standard")[turn % 2]))
    return found


def plan(trials, seed):
    """A balanced list of cases in random order."""
    rng = np.random.default_rng(seed)
    single, pairs, none, beyond = shares(trials)
    names = turns(rng, single)
    kinds = list(zip(names, single_sizes(rng, names), strict=True))
    kinds += zip(random_pairs(rng, pairs), log_uniform(rng, 3.0, 10.0, pairs), strict=True)
    kinds += [(None, 0.0)] * none
    kinds += [(OUTSIDE, size) for size in log_uniform(rng, 3.0, 10.0, beyond)]
    seeds = rng.choice(2**31, trials, replace=False)
    cases = [
        Case(int(s), effect, float(size), *arm)
        for (effect, size), s, arm in zip(kinds, seeds, arms([effect for effect, _ in kinds]), strict=True)
    ]
    return [cases[i] for i in rng.permutation(trials)]
