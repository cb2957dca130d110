"""The efforts of every term of the catalogue, written by hand apart from bayesid."""

import math
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from oracles import STEP, actuator_efforts, dh_chain, gear, joint_torques, parameters_of, random_clouds
from scipy.linalg import expm


class Entry(NamedTuple):
    effort: Callable  # of a robot's table, a motion, the parameters, and the numbers of the shape by name
    nonnegative: tuple[str, ...] = ()  # symbols of the parameters that cannot be negative
    shape: Callable | None = None  # of n actuators; if not given, the motion shows it and the effort knows how


def rigid_body(table, motion, theta):
    """Each link's ten parameters as those of ten point masses, of either sign: the torque is linear in them."""
    axes = np.eye(3)
    points = np.array([np.zeros(3), *axes, *-axes, *(1 - axes)])
    one_each = np.array([parameters_of([(points[k : k + 1], np.ones(1))]) for k in range(10)]).T
    clouds = [(points, np.linalg.solve(one_each, link)) for link in theta.reshape(-1, 10)]
    torques = joint_torques(dh_chain(table), clouds, np.array(table["gravity"]), motion)
    return actuator_efforts(torques, table.get("transmission"))


def payload(table, motion, theta):
    """The same on an arm whose links weigh nothing."""
    return rigid_body(table, motion, np.concatenate([np.zeros(10 * (len(table["joints"]) - 1)), theta]))


def tool_wrench(table, motion, theta, turns_with_tool):
    """Virtual work: what the actuators supply is minus the wrench's work per unit of each joint's motion."""
    chain, torques = dh_chain(table), []
    for q in motion.q:
        tool = chain(q)[0][-1]
        force, couple = np.append(theta, np.zeros(6 - len(theta))).reshape(2, 3)
        if turns_with_tool:
            force, couple = tool[:3, :3] @ force, tool[:3, :3] @ couple
        moves = [chain(q + 1j * STEP * e)[0][-1].imag / STEP for e in np.eye(len(q))]
        spins = [move[:3, :3] @ tool[:3, :3].T for move in moves]
        works = [force @ m[:3, 3] + couple @ [w[2, 1], w[0, 2], w[1, 0]] for m, w in zip(moves, spins, strict=True)]
        torques.append(-np.array(works))
    return actuator_efforts(np.array(torques), table.get("transmission"))


def top_speeds(table, motion):
    return np.abs(gear(table, motion.dq)).max(axis=0)


def direction(table, motion, smoothing=None):
    """Of the motors' motion; smoothed over a hundredth of each one's highest speed."""
    smoothing = 0.01 * top_speeds(table, motion) if smoothing is None else smoothing
    return np.tanh(gear(table, motion.dq) / smoothing)


def slipping(u, width, smooth):
    """(N,) state of one elastic element that slips, sample by sample; it begins at rest."""
    states = [0.0]
    for before, after in pairwise(u):
        way, towards = abs(after - before) / width, np.sign(after - before)
        if smooth:  # dz/dx = towards - z over this way
            end = (expm(way * np.array([[-1.0, towards], [0.0, 0.0]])) @ [states[-1], 1.0])[0]
        else:
            end = towards * min(towards * states[-1] + way, 1.0)
        states.append(end)
    return states


def hysteresis(table, motion, theta, width, smooth):
    u = gear(table, motion.q)
    return theta * np.transpose([slipping(u[:, j], w, smooth) for j, w in enumerate(width)])


PARTS = (0.25, 0.5, 1.0)


def layered_hysteresis(table, motion, theta, width):
    u, per_joint = gear(table, motion.q), theta.reshape(-1, 3)
    return np.transpose(
        [per_joint[j] @ [slipping(u[:, j], part * w, False) for part in PARTS] for j, w in enumerate(width)]
    )


def elastic_return(u, w):
    """(N,) dz/dx = towards while the element is relieved, towards - z while it is strained."""
    states = [0.0]
    for before, after in pairwise(u):
        way, towards, z = abs(after - before) / w, np.sign(after - before), states[-1]
        back = min(way, abs(z)) if towards * z < 0 else 0.0
        z += towards * back
        states.append((expm((way - back) * np.array([[-1.0, towards], [0.0, 0.0]])) @ [z, 1.0])[0])
    return states


def elastic_hysteresis(table, motion, theta, width):
    u = gear(table, motion.q)
    return theta * np.transpose([elastic_return(u[:, j], w) for j, w in enumerate(width)])


def warmth(motion, time):
    return 1 - np.exp((motion.t[0] - motion.t)[:, None] / np.array(time))


def asymmetric_coulomb(table, motion, theta):
    forwards, backwards = theta.reshape(-1, 2).T
    way = direction(table, motion)
    return np.where(way > 0, forwards, backwards) * way


def stribeck_friction(table, motion, theta):
    kinetic, extra = theta.reshape(-1, 2).T
    slowness = 10 * gear(table, motion.dq) / top_speeds(table, motion)
    return (kinetic + extra / np.exp(slowness**2)) * direction(table, motion)


def cable_drag(table, motion, theta, start, side):
    stretch = gear(table, motion.q) - start
    return theta * np.where(np.sign(stretch) == side, stretch, 0.0)


def cable_stiffening(table, motion, theta, start):
    cubic, linear = theta.reshape(-1, 2).T
    bent = gear(table, motion.q) - start
    return (cubic * bent**2 + linear) * bent


def joint_spring(table, motion, theta):
    stiffness, constant = theta.reshape(-1, 2).T
    return constant + stiffness * gear(table, motion.q)


def waves(table, motion, theta, harmonic):
    """Imaginary and real parts of turning pointers."""
    pointers = np.exp(1j * gear(table, motion.q) * harmonic)
    return theta[0::2] * pointers.imag + theta[1::2] * pointers.real


def two_harmonics(table, motion, theta):
    u = gear(table, motion.q)
    s1, c1, s2, c2 = theta.reshape(-1, 4).T
    return s1 * np.sin(u) + c1 * np.cos(u) + 2 * s2 * np.sin(u) * np.cos(u) + c2 * (1 - 2 * np.sin(u) ** 2)


def drifting(motion, theta, time, what):
    """What changes from its first amplitude by its second, as the joint warms up."""
    cold, warm = theta.reshape(-1, 2).T
    return (cold + warm * warmth(motion, time)) * what


def friction_drift(table, motion, theta, smoothing, time):
    dry, viscous = theta.reshape(-1, 2, 2).swapaxes(0, 1)
    way = direction(table, motion, smoothing)
    return drifting(motion, dry, time, way) + drifting(motion, viscous, time, gear(table, motion.dq))


def load_dependent_friction(table, motion, theta, smoothing, links):
    return theta * np.abs(rigid_body(table, motion, np.array(links))) * direction(table, motion, smoothing)


LEARNED = {
    "joints": [2],
    "number": [1.0],
    "functions": [  # each axis: quantity, joint, family, low, high, order, count; then the rows of the weights
        [
            [[0.0, 1.0, 0.0, -0.6, 0.9, 0.0, 3.0], [1.0, 2.0, 4.0, -1.0, 1.0, 0.3, 1.0]],
            [[0.3, -1.0], [0.7, 0.2], [0.1, 2.0]],
        ],
        [
            [[3.0, 1.0, 2.0, -900.0, 900.0, 1.0, 1.0], [4.0, 0.0, 5.0, 0.0, 1.0, 0.07, 2.0]],  # rows of load and time
            [[0.01], [-0.02]],
        ],
        [[[0.0, 3.0, 1.0, -1.0, 1.0, 2.0, 3.0]], [[0.4], [1.5], [-0.6]]],
        [[[2.0, 3.0, 3.0, -2.0, 2.0, 2.0, 1.0], [1.0, 1.0, 6.0, -1.0, 1.0, 1.0, 1.0]], [[0.25]]],
    ],
}
"""Four functions: of q1 and the direction of joint 2, of the load of joint 1 and time, of q3, of ddq3 and the speed of
joint 1. The ranges are shorter than what joints do, but for the load's."""


def learned_effect(table, motion, theta, links, **_):
    """Sample by sample; what is beyond a range is drawn back to it, or to half a range further."""
    load, efforts = rigid_body(table, motion, np.array(links)), np.zeros(motion.q.shape)
    u, du, ddu = (gear(table, x) for x in (motion.q, motion.dq, motion.ddq))
    for i, t in enumerate(motion.t - motion.t[0]):
        place = (min(max(u[i, 0], -0.6), 0.9) + 0.6 + 0.225) / 1.95  # of 1.5 rad, and 15 % more at either end
        cosines = [1.0, math.cos(math.pi * place), math.cos(2 * math.pi * place)]
        first = (0.3 * theta[0] - theta[1]) * cosines[0] + (0.7 * theta[0] + 0.2 * theta[1]) * cosines[1]
        first += (0.1 * theta[0] + 2.0 * theta[1]) * cosines[2]
        second = load[i, 0] * (0.01 - 0.02 / math.exp(t / 0.07))
        third = 0.4 + 1.5 * math.cos(2 * u[i, 2]) - 0.6 * math.sin(2 * u[i, 2])
        pushed, speed = min(max(ddu[i, 2], -4.0), 4.0), min(max(du[i, 0], -2.0), 2.0)
        last = 0.25 * pushed * abs(pushed) * abs(speed)
        efforts[i, 1] = first * math.tanh(du[i, 1] / 0.3) + theta[2] * second + theta[3] * third + theta[4] * last
    return efforts


def three_harmonics(table, motion, theta):
    angle, (s1, c1, s2, c2, s3, c3) = gear(table, motion.q), theta.reshape(-1, 6).T
    first, second = s1 * np.sin(angle) + c1 * np.cos(angle), s2 * np.sin(2.0 * angle) + c2 * np.cos(2.0 * angle)
    return first + second + s3 * np.sin(3.0 * angle) + c3 * np.cos(3.0 * angle)


def numbers(**ends):
    """A shape whose fields go from one number to another over the actuators."""
    return lambda n: {key: np.linspace(*pair, n) for key, pair in ends.items()}


PLACES, SMOOTHINGS, WIDTHS = (-0.7, 0.9), (0.02, 0.7), (0.8, 4.0)
TIMES = (0.04, 0.2)  # of the order of the test's motion, s
EFFORTS = {
    "rigid_body": Entry(rigid_body),
    "viscous_friction": Entry(lambda table, motion, theta: theta * gear(table, motion.dq), ("Fv",)),
    "viscous_friction.saturating": Entry(
        lambda table, motion, theta, knee: theta * (1.0 - 2.0 / (1.0 + np.exp(2.0 * gear(table, motion.dq) / knee))),
        ("Fe",),
        numbers(knee=(0.6, 2.4)),
    ),
    "coulomb_friction": Entry(lambda table, motion, theta: theta * direction(table, motion), ("Fc",)),
    "torque_offset": Entry(lambda table, motion, theta: np.tile(theta, (len(motion), 1))),
    "rotor_inertia": Entry(lambda table, motion, theta: theta * gear(table, motion.ddq), ("Ia",)),
    "asymmetric_coulomb": Entry(asymmetric_coulomb, ("Fp", "Fm")),
    "stribeck_friction": Entry(stribeck_friction, ("Fk", "Fs")),
    "load_dependent_friction": Entry(
        load_dependent_friction,
        ("Fl",),
        lambda n: {"smoothing": np.linspace(*SMOOTHINGS, n), "links": parameters_of(random_clouds(n, seed=7))},
    ),
    "joint_spring": Entry(joint_spring, ("k",)),
    "gravity_spring": Entry(partial(waves, harmonic=1.0)),
    "gravity_spring.free_length": Entry(two_harmonics),
    "position_torque": Entry(three_harmonics),
    "overcompensated_friction": Entry(lambda table, motion, theta: np.zeros(motion.q.shape)),
    "torque_ripple": Entry(waves, shape=numbers(harmonic=(3.3, 17.9))),
    "hysteresis": Entry(partial(hysteresis, smooth=False), ("Fh",), numbers(width=WIDTHS)),
    "hysteresis.smooth": Entry(partial(hysteresis, smooth=True), ("Fhs",), numbers(width=WIDTHS)),
    "hysteresis.layers": Entry(layered_hysteresis, ("Fha", "Fhb", "Fhc"), numbers(width=WIDTHS)),
    "hysteresis.elastic": Entry(elastic_hysteresis, ("Fhe",), numbers(width=WIDTHS)),
    "cable_drag": Entry(
        cable_drag, ("kd",), lambda n: {"start": np.linspace(*PLACES, n), "side": (-1.0) ** np.arange(n)}
    ),
    "cable_drag.friction": Entry(
        lambda table, motion, theta, smoothing, start: (
            theta * np.sqrt((gear(table, motion.q) - start) ** 2) * direction(table, motion, smoothing)
        ),
        ("Fd",),
        numbers(smoothing=SMOOTHINGS, start=PLACES),
    ),
    "cable_drag.stiffening": Entry(cable_stiffening, ("kd3_",), numbers(start=PLACES)),
    "thermal_drift": Entry(
        lambda table, motion, theta, smoothing, time: drifting(
            motion, theta, time, direction(table, motion, smoothing)
        ),
        shape=numbers(smoothing=SMOOTHINGS, time=TIMES),
    ),
    "thermal_drift.viscous": Entry(
        lambda table, motion, theta, time: drifting(motion, theta, time, gear(table, motion.dq)),
        shape=numbers(time=TIMES),
    ),
    "thermal_drift.both": Entry(friction_drift, shape=numbers(smoothing=SMOOTHINGS, time=TIMES)),
    "thermal_drift.offset": Entry(
        lambda table, motion, theta, time: drifting(motion, theta, time, 1.0), shape=numbers(time=TIMES)
    ),
    "learned_effect": Entry(
        learned_effect, shape=lambda n: {**LEARNED, "links": parameters_of(random_clouds(n, seed=7))}
    ),
    "payload": Entry(payload),
    "payload.carried": Entry(
        lambda table, motion, theta, label: payload(table, motion, theta) * (motion.payload == label[0])[:, None],
        shape=lambda n: {"label": ("tool1",)},
    ),
    "tool_wrench": Entry(partial(tool_wrench, turns_with_tool=False)),
    "tool_wrench.couple": Entry(partial(tool_wrench, turns_with_tool=False)),
    "tool_wrench.following": Entry(partial(tool_wrench, turns_with_tool=True)),
    "tool_wrench.following_couple": Entry(partial(tool_wrench, turns_with_tool=True)),
}
"""Of each term of the catalogue; a new term needs an entry here."""


def by_hand(name, table, motion, theta):
    """(N, n) the effort that the entry of a term makes."""
    entry = EFFORTS[name]
    return entry.effort(table, motion, theta, **(entry.shape(len(table["joints"])) if entry.shape else {}))
