"""Logs of robots whose rigid-body model is poor; shares no code with bayesid.

Rigid bodies and motions are those of `bayesid.studies.blind`; effects are written here. A 7-joint arm has torque
sensors behind its gears, which measure little friction; an industrial arm of 6 joints has motor currents.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesid.studies import blind

SENSORS, CURRENTS = "torque sensors", "currents"
ARMS = SENSORS, CURRENTS
EFFECTS = "base_tilt", "position_torque", "overcompensated_friction", "dead_zone"
HARMONICS = 3
AMPLITUDES = 0.5, 1.0  # of the harmonics before scaling
TILT = 0.5, 3.0  # degrees
# shares of a joint's RMS effort
TORQUE = 0.3, 1.0
VISCOUS, COULOMB = (0.3, 1.5), (0.1, 0.4)  # of over-compensated drives, at RMS speed
DEAD_BAND = 0.05, 0.3
NOISE = 0.02, 0.05
FRICTION = {SENSORS: (0.01, 0.05), CURRENTS: (0.2, 0.6)}  # of the rigid bodies' effort
ROTOR = {SENSORS: (0.0, 0.0), CURRENTS: (0.03, 0.12)}
OFFSET = 0.02

_LENGTHS = 0.36, 0.0, 0.42, 0.0, 0.4, 0.0, 0.126  # m, of an LBR iiwa 14
_TWISTS = -1, 1, 1, -1, -1, 1, 0  # quarter turns
_MASSES = 4.0, 4.0, 3.0, 2.7, 1.7, 1.8, 1.5  # kg, the last one with a tool


@dataclass(frozen=True)
class Case:
    """A signed log and its hidden effects: name, joints (from 1, none for the whole robot) and parameters."""

    table: dict
    t: np.ndarray
    q: np.ndarray
    effort: np.ndarray
    hidden: tuple[tuple[str, tuple[int, ...], dict], ...]


# --- Effects ---------------------------------------------------------------------------------------------------------
def tilted(gravity, heading, angle):
    """Gravity (3,) in the frame of a base turned about the horizontal axis (cos heading, sin heading, 0)."""
    axis = np.array([np.cos(heading), np.sin(heading), 0.0])
    along = axis * (axis @ gravity)
    return along + np.cos(angle) * (gravity - along) - np.sin(angle) * np.cross(axis, gravity)


def position_torque(q, amplitudes, phases):
    """Sum over h = 1, 2, ... of amplitude sin(h q + phase)."""
    return sum(a * np.sin(h * q + phase) for h, (a, phase) in enumerate(zip(amplitudes, phases, strict=True), start=1))


def read_with_dead_band(effort, width):
    """Exactly 0 below the width."""
    return np.where(np.abs(effort) < width, 0.0, effort)


# --- Robots ----------------------------------------------------------------------------------------------------------
def bare_arm(rng, arm):
    """The robot without friction, offsets and rotors."""
    if arm == CURRENTS:
        return blind.bare_robot(rng, "kr5")
    joints = [
        {"a": 0.0, "alpha": quarters * np.pi / 2, "d": length * float(rng.uniform(0.9, 1.1)), "theta": 0.0}
        for length, quarters in zip(_LENGTHS, _TWISTS, strict=True)
    ]
    table = {"name": "robot", "convention": "standard", "gravity": blind.GRAVITY.tolist(), "joints": joints}
    links, none = blind.random_links(rng, joints, np.array(_MASSES) * rng.uniform(0.8, 1.25, 7)), np.zeros(7)
    return blind.Robot(table, links, none, none, none, none)


def with_joints(rng, robot, arm, rigid, dq, ddq):
    """The robot with friction, offsets and rotors, in proportion to its efforts in a motion."""
    n, scale, speed = robot.n, blind.rms(rigid), blind.rms(dq)
    share = rng.uniform(0.3, 0.7, n)
    friction = scale * rng.uniform(*FRICTION[arm], n)
    friction /= blind.rms(share * dq / speed + (1 - share) * np.sign(dq))
    offset, rotor = scale * rng.uniform(-OFFSET, OFFSET, n), scale * rng.uniform(*ROTOR[arm], n) / blind.rms(ddq)
    return replace(robot, viscous=friction * share / speed, coulomb=friction * (1 - share), offset=offset, rotor=rotor)


# --- Cases -----------------------------------------------------------------------------------------------------------
def make_case(arm, effects, seed):
    """The case of an arm with these hidden effects; each effect has its own stream of random numbers."""
    rng = blind.stream(seed, 0)
    stated = bare_arm(rng, arm)
    n, rate = stated.n, int(rng.integers(50, 101))
    t = np.arange(round(rng.uniform(20.0, 30.0) * rate)) / rate
    q, dq, ddq = blind.random_series(blind.stream(seed, 1), n, slow=False)(t)
    rigid, hidden = stated.rigid_efforts(q, dq, ddq), []
    robot = with_joints(blind.stream(seed, 2), stated, arm, rigid, dq, ddq)
    viscous, coulomb, torque = robot.viscous.copy(), robot.coulomb.copy(), robot.offset + robot.rotor * ddq
    scale = blind.rms(rigid + viscous * dq + coulomb * np.sign(dq) + torque)
    if "base_tilt" in effects:
        draws = blind.stream(seed, 3)
        heading, angle = float(draws.uniform(0, 2 * np.pi)), float(np.deg2rad(draws.uniform(*TILT)))
        table = {**stated.table, "gravity": tilted(blind.GRAVITY, heading, angle).tolist()}
        rigid = replace(stated, table=table).rigid_efforts(q, dq, ddq)
        hidden.append(("base_tilt", (), {"heading": heading, "degrees": float(np.rad2deg(angle))}))
    if "overcompensated_friction" in effects:
        draws = blind.stream(seed, 4)
        for j in sorted(draws.choice(n, int(draws.integers(1, 4)), replace=False).tolist()):
            shares = float(draws.uniform(*VISCOUS)), float(draws.uniform(*COULOMB))
            viscous[j], coulomb[j] = -shares[0] * scale[j] / blind.rms(dq[:, j]), shares[1] * scale[j]
            hidden.append(("overcompensated_friction", (j + 1,), {"viscous": -shares[0], "coulomb": shares[1]}))
    if "position_torque" in effects:
        draws = blind.stream(seed, 5)
        j, share = int(draws.integers(n)), float(draws.uniform(*TORQUE))
        amplitudes, phases = draws.uniform(*AMPLITUDES, HARMONICS), draws.uniform(0, 2 * np.pi, HARMONICS)
        amplitudes *= share * scale[j] / blind.rms(position_torque(q[:, j], amplitudes, phases))
        torque[:, j] += position_torque(q[:, j], amplitudes, phases)
        numbers = {"share": share, "amplitudes": amplitudes.tolist(), "phases": phases.tolist()}
        hidden.append(("position_torque", (j + 1,), numbers))
    effort = rigid + viscous * dq + coulomb * np.sign(dq) + torque
    draws = blind.stream(seed, 6)
    effort = effort + draws.uniform(*NOISE, n) * blind.rms(effort) * draws.normal(size=effort.shape)
    if "dead_zone" in effects:
        draws = blind.stream(seed, 7)
        j, share = int(draws.integers(n)), float(draws.uniform(*DEAD_BAND))
        effort[:, j] = read_with_dead_band(effort[:, j], share * blind.rms(effort[:, j]))
        hidden.append(("dead_zone", (j + 1,), {"share": share}))
    return Case(stated.table, t, q, effort, tuple(hidden))
