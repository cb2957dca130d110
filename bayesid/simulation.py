"""Simulated logs of a model, and plausible parameters for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from bayesid.coefficients import base_coefficients
from bayesid.errors import InputError
from bayesid.excitation import exciting_trajectory
from bayesid.inertia import from_pseudo_inertia
from bayesid.log import Log
from bayesid.model import Model
from bayesid.motion import Array, Motion
from bayesid.paper import nominal_parameters
from bayesid.robot import Robot, load_robot
from bayesid.terms import CATALOGUE, RigidBody, make_terms

_KG_PER_M = 25.0
"""Mass of an arm per metre of stretched length: about 20 for the UR10e and the Panda, 32 for the KR5."""
_SLENDERNESS = 0.1
"""Radius of the first link relative to the reach."""
_SHORTEST_REACH = 0.1
_MOST_SAMPLES = 1e7
_LARGEST_EFFECT = 1e3


def simulate(
    model: Model,
    theta: Array,
    motion: Motion,
    *,
    rng: np.random.Generator,
    noise: float = 0.05,
    colour: float = 0.0,
    signed: bool | Sequence[bool] = False,
) -> Log:
    """A log of a motion, positions exact, efforts with Gaussian noise and rectified where they are not signed.

    A controller rectifies what it measures, so the noise is added first; an absolute value near zero is then biased.

    Args:
        model: the model.
        theta: (P,) its parameters.
        motion: N samples of motion.
        rng: draws the noise.
        noise: standard deviation of the noise relative to the RMS of each joint's effort.
        colour: correlation of the noise from one sample to the next, AR(1); 0 is white.
        signed: whether the efforts keep their sign, for all joints or each (n,).

    Raises:
        ValueError: the noise is negative or not finite, or its colour not in [0, 1).
    """
    if not 0.0 <= noise < np.inf:
        raise ValueError(f"the noise must be a finite share of the effort, not {noise}")
    if not 0.0 <= colour < 1.0:
        raise ValueError(f"the noise's correlation must lie in [0, 1), not {colour}")
    effort = model.effort(motion, theta)
    effort = effort + noise * _rms(effort) * _ar1(rng.standard_normal(effort.shape), colour)
    keeps = np.broadcast_to(np.asarray(signed, dtype=bool), motion.n_joints)
    effort = np.where(keeps, effort, np.abs(effort))
    return Log(motion.t, motion.q, effort, keeps, source=f"simulated {model.robot.name}")


def random_parameters(model: Model, rng: np.random.Generator) -> Array:
    """(P,) plausible parameters of any model, strictly inside its cone and without symmetries.

    Bodies are made to measure for the link they belong to. Every other parameter is so large that its effort is some
    share of the bodies' effort: 5 to 25 % if it cannot be negative (friction, rotor inertia), 1 to 5 % of either sign
    if it can (offsets). Without bodies in the model that share is of 1 N m.
    """
    theta, cone = np.zeros(len(model.parameters)), model.cone
    ends, masses = _link_ends(model.robot), _random_masses(model.robot, rng)
    radii = _SLENDERNESS * _reach(model.robot) * np.cbrt(masses / masses[0])
    for body in cone.bodies:
        link = model.parameters[body[0]].joint - 1
        theta[body] = _random_body(ends[link], masses[link], radii[link], rng)
    columns = model.columns(_random_motion(model.robot.n_joints, rng))
    others = np.setdiff1d(np.arange(cone.size), cone.bodies)
    shares = rng.uniform(0.01, 0.05, cone.size) * rng.choice([-1.0, 1.0], cone.size)
    shares[cone.nonnegative] = rng.uniform(0.05, 0.25, len(cone.nonnegative))
    theta[others] = shares[others] * _whole(_rms(columns @ theta), _rms(columns[:, :, others]))
    return theta


def _ar1(white: Array, colour: float) -> Array:
    """(N, n) stationary noise of unit variance from white noise (N, n): x_i = c x_(i-1) + sqrt(1 - c^2) e_i."""
    scale = np.sqrt(1.0 - colour**2)
    shaped: Array = lfilter([scale], [1.0, -colour], white, axis=0, zi=(1.0 - scale) * white[:1])[0]
    return shaped


def _rms(values: Array) -> Array:
    """Root mean square over the samples, the first axis."""
    size: Array = np.sqrt(np.mean(values**2, axis=0))
    return size


def _whole(effort: Array, columns: Array) -> Array:
    """(k,) parameters whose RMS effort is that of the joint they act on most, from RMS values (n,) and (n, k)."""
    strongest, largest = np.argmax(columns, axis=0), np.max(columns, axis=0)
    whole: Array = np.where(effort > 0.0, effort, 1.0)[strongest] / np.where(largest > 0.0, largest, 1.0)
    return whole


def _random_motion(n_joints: int, rng: np.random.Generator) -> Motion:
    """200 unrelated instants at the speeds of an industrial arm at work."""
    shape = (200, n_joints)
    q, dq, ddq = (rng.uniform(-limit, limit, shape) for limit in (2.0, 2.0, 5.0))
    return Motion(np.arange(200.0), q, dq, ddq)


# ---------------------------------------------------------------------------------------------------------------
# Links
# ---------------------------------------------------------------------------------------------------------------
def _link_ends(robot: Robot) -> Array:
    """(n, 2, 3) where each link starts and ends, in its own frame, m: from its joint to the next.

    The last link ends at its own frame, which the standard convention puts at the flange.
    """
    ends = []
    for i, joint in enumerate(robot.joints):
        children = [child.placement for child in robot.joints if child.parent == i]
        far = (children[0] if children else joint.link_frame)[:3, 3]
        rotation, origin = joint.link_frame[:3, :3], joint.link_frame[:3, 3]
        ends.append((np.stack([np.zeros(3), far]) - origin) @ rotation)
    return np.array(ends)


def _reach(robot: Robot) -> float:
    """Length of the stretched arm, m."""
    ends = _link_ends(robot)
    return max(_SHORTEST_REACH, float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum()))


def _random_masses(robot: Robot, rng: np.random.Generator) -> Array:
    """(n,) masses, kg, each link lighter than the one before it."""
    total = _KG_PER_M * _reach(robot) * rng.uniform(0.7, 1.4)
    relative = np.cumprod(rng.uniform(0.55, 0.9, robot.n_joints))
    masses: Array = total * relative / relative.sum()
    return masses


def _random_body(ends: Array, mass: float, radius: float, rng: np.random.Generator) -> Array:
    """(10,) parameters of a lopsided rod between `ends` (2, 3): a positive definite spread about its centre of mass."""
    along = ends[1] - ends[0]
    centre = ends[0] + rng.uniform(0.3, 0.7) * along + radius * rng.uniform(-0.5, 0.5, 3)
    axes = np.linalg.qr(rng.standard_normal((3, 3)))[0] * (radius * rng.uniform(0.5, 1.0, 3))
    spread = axes @ axes.T + np.outer(along, along) / 12
    point = np.append(centre, 1.0)
    pseudo_inertia = np.outer(point, point)
    pseudo_inertia[:3, :3] += spread
    return from_pseudo_inertia(mass * pseudo_inertia)


# ---------------------------------------------------------------------------------------------------------------
# Whole logs
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Effect:
    """A term added to one joint of a simulated robot.

    Attributes:
        name: in `bayesid.terms.CATALOGUE`.
        joint: 1-based.
        level: RMS of the effect relative to the RMS of the joint's effort without it.
    """

    name: str
    joint: int
    level: float


def parse_effect(text: str, robot: Robot) -> Effect:
    """NAME:JOINT:LEVEL as on the command line.

    Raises:
        InputError: it is not of that form, or names no effect of one joint.
    """
    choices = [name for name in CATALOGUE if name != RigidBody.name]
    remedy = f"give NAME:JOINT:LEVEL, NAME one of {', '.join(choices)}"
    try:
        name, joint, level = text.split(":")
        effect = Effect(name, int(joint), float(level))
    except ValueError:
        raise InputError(f"{text!r} is not NAME:JOINT:LEVEL", "--effect", remedy) from None
    possible = 1 <= effect.joint <= robot.n_joints and 0.0 <= effect.level <= _LARGEST_EFFECT
    if effect.name not in choices or not possible:
        raise InputError(f"{text!r} names no effect of this robot", "--effect", remedy)
    return effect


def simulate_log(
    robot: Robot, duration: float, rate: float, noise: float, effects: Sequence[Effect], seed: int
) -> tuple[Log, Log]:
    """A log of |effort| on an exciting trajectory, and the same log with its signs.

    Args:
        robot: gets the paper's parameters if it is the KR5, else random feasible ones.
        duration: s.
        rate: Hz.
        noise: relative to each joint's RMS effort.
        effects: on top of the rigid bodies.
        seed: of parameters, trajectory and noise.

    Raises:
        InputError: duration, rate or noise cannot be used.
    """
    ranges = ((duration, "--duration", 1.0, 1e5), (rate, "--rate", 10.0, 1e4), (noise, "--noise", 0.0, 1e2))
    for value, option, least, most in ranges:
        if not least <= value <= most:
            raise InputError(f"{value:g} cannot be used", option, f"give {least:g} to {most:g}")
    if duration * rate > _MOST_SAMPLES:
        raise InputError(f"{duration * rate:g} samples", "--duration", f"ask for at most {_MOST_SAMPLES:g}")
    rng = np.random.default_rng(seed)
    model = Model(robot, (RigidBody(),))
    known = robot.same_kinematics(load_robot("kr5"))
    theta = nominal_parameters() if known else random_parameters(model, rng)
    trajectory = exciting_trajectory(model, base_coefficients(model), duration, seed=seed)
    motion = trajectory.motion(np.arange(int(duration * rate) + 1) / rate)
    model, theta = _with_effects(model, theta, motion, effects)
    signed = simulate(model, theta, motion, rng=rng, noise=noise, signed=True)
    return signed.rectified(), signed


def _with_effects(model: Model, theta: Array, motion: Motion, effects: Sequence[Effect]) -> tuple[Model, Array]:
    rms = _rms(model.effort(motion, theta))
    for name in dict.fromkeys(effect.name for effect in effects):
        (term,) = make_terms([name], model.robot, motion)
        size = _rms(term.columns(model.robot, motion))
        values = np.zeros(model.robot.n_joints)
        for effect in effects:
            j = effect.joint - 1
            if effect.name == name:
                values[j] += effect.level * rms[j] / size[j, j]
        model, theta = model.extend(term), np.concatenate([theta, values])
    return model, theta
