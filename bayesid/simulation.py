"""Simulated logs of a model, and plausible parameters for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq
from scipy.signal import lfilter

from bayesid.coefficients import base_coefficients
from bayesid.distortions import CATALOGUE as DISTORTIONS
from bayesid.distortions import Distortion
from bayesid.distortions.base_tilt import BaseTilt
from bayesid.distortions.clipping import Clipping
from bayesid.distortions.dead_zone import DeadZone
from bayesid.distortions.delay import Delay
from bayesid.distortions.gain_error import GainError
from bayesid.errors import InputError
from bayesid.excitation import HARMONICS, exciting_trajectory
from bayesid.inertia import from_pseudo_inertia
from bayesid.log import Log
from bayesid.model import Model
from bayesid.motion import Array, Motion
from bayesid.paper import nominal_parameters
from bayesid.robot import Robot, load_robot
from bayesid.terms import CATALOGUE, RigidBody, Scene, Term

_KG_PER_M = 25.0
"""Mass of an arm per metre of stretched length: about 20 for the UR10e and the Panda, 32 for the KR5."""
_SLENDERNESS = 0.1
"""Radius of the first link relative to the reach."""
_SHORTEST_REACH = 0.1
_MOST_SAMPLES = 1e7
_LARGEST_EFFECT = 1e3
_TRACE = 1e-4
"""Share of an effect on the joint where it acts most, below which it does not act on another."""
_CLOSE = 0.01
"""How far from the level that is asked for an effect may end, relative to it."""
_STEEPEST = 1.0
"""rad, the largest tilt."""
_GRIP, _GIRTH = 0.2, 0.04
"""m, how far a payload reaches from the flange, and its radius."""
_Dial = Callable[[float], Distortion]
"""A distortion by its magnitude: with 0 it does nothing."""


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

    A controller rectifies what it measures, so the noise is added first; an absolute value near zero is then biased. A
    sensor's distortions act on the noise as well.

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
    effort = model.before_sensors.effort(motion, theta)
    effort = model.read(effort + noise * _rms(effort) * _ar1(rng.standard_normal(effort.shape), colour))
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
    """An effect added to a simulated robot.

    Attributes:
        name: main form of a term in `bayesid.terms.CATALOGUE` or of a distortion in `bayesid.distortions.CATALOGUE`.
        joint: 1-based; where the whole robot is affected, the joint that has the level.
        level: RMS of the change of the joint's effort relative to the RMS of that effort without it.
    """

    name: str
    joint: int
    level: float

    def __str__(self) -> str:
        """As on the command line."""
        return f"{self.name}:{self.joint}:{self.level:g}"


def _main_forms() -> Mapping[str, type[Term] | type[Distortion]]:
    kinds: dict[str, type[Term] | type[Distortion]] = {**CATALOGUE, **DISTORTIONS}
    return {name: kind for name, kind in kinds.items() if "." not in name and name != RigidBody.name}


EFFECTS = _main_forms()
"""What can be added to a simulated robot."""


def parse_effect(text: str, robot: Robot) -> Effect:
    """NAME:JOINT:LEVEL as on the command line.

    Raises:
        InputError: it is not of that form, or names no effect of one of the robot's joints.
    """
    remedy = f"give NAME:JOINT:LEVEL, NAME one of {', '.join(EFFECTS)}"
    try:
        name, joint, level = text.split(":")
        effect = Effect(name, int(joint), float(level))
    except ValueError:
        raise InputError(f"{text!r} is not NAME:JOINT:LEVEL", "--effect", remedy) from None
    possible = 1 <= effect.joint <= robot.n_joints and 0.0 <= effect.level <= _LARGEST_EFFECT
    if effect.name not in EFFECTS or not possible:
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
        effects: on top of the rigid bodies; sensors distort what all others have made.
        seed: of parameters, trajectory, noise and the form of each effect.

    Raises:
        InputError: duration, rate or noise cannot be used, or an effect cannot have its level.
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
    model, theta = _with_effects(model, theta, motion, effects, seed)
    signed = simulate(model, theta, motion, rng=rng, noise=noise, signed=True)
    return signed.rectified(), signed


def _with_effects(
    model: Model, theta: Array, motion: Motion, effects: Sequence[Effect], seed: int
) -> tuple[Model, Array]:
    """Model and parameters with terms, then distortions.

    The level of a term is relative to the rigid bodies' effort, that of a distortion to the effort that it meets. Each
    effect draws its form from a stream of its own, so that the others leave it alone.
    """
    scene = _scene(model, theta, motion)
    streams = [np.random.default_rng([seed, k]) for k in range(1, len(effects) + 1)]
    present = [(effect, rng) for effect, rng in zip(effects, streams, strict=True) if effect.level > 0.0]
    for effect, rng in sorted(present, key=lambda one: _turn(one[0])):
        form = _form(effect, scene, rng)
        if isinstance(form, Distortion):
            model = model.distort(_scaled_distortion(form, effect, model, theta, motion, rng))
        else:
            model = model.extend(form)
            theta = np.concatenate([theta, _scaled_term(form, effect, scene, rng)])
    return model, theta


def _scene(model: Model, theta: Array, motion: Motion) -> Scene:
    effort = model.effort(motion, theta)

    def effort_with(robot: Robot) -> Array:
        return replace(model, robot=robot).effort(motion, theta)

    return Scene(model.robot, motion, model.robot.actuators(motion), effort, np.abs(effort), theta, effort_with)


def _turn(effect: Effect) -> int:
    """Terms, then distortions of rows, then those of sensors."""
    kind = EFFECTS[effect.name]
    return 1 + kind.of_sensor if issubclass(kind, Distortion) else 0


def _form(effect: Effect, scene: Scene, rng: np.random.Generator) -> Term | Distortion:
    """One of the forms in which the effect may be hidden in this joint, or in the whole robot."""
    variants: Iterable[Term | Distortion] = EFFECTS[effect.name].variants(scene)
    forms = [one for one in variants if one.joints in ((), (effect.joint,))]
    if not forms:
        raise _unreachable(effect, "it has no form in this joint and motion")
    return forms[int(rng.integers(len(forms)))]


def _unreachable(effect: Effect, why: str) -> InputError:
    return InputError(f"{str(effect)!r} cannot be had: {why}", "--effect", "give another level, joint or seed")


def _scaled_term(term: Term, effect: Effect, scene: Scene, rng: np.random.Generator) -> Array:
    """(p,) parameters in a random direction, at the level."""
    unit = _direction(term, scene.robot, rng)
    size = _rms(Model(scene.robot, (term,)).effort(scene.motion, unit))
    j = effect.joint - 1
    wanted = effect.level * _rms(scene.effort)[j]
    if not (size[j] > _TRACE * size.max() and wanted > 0.0):
        raise _unreachable(effect, "it does not act on this joint, or nothing else does")
    return unit * (wanted / size[j])


def _direction(term: Term, robot: Robot, rng: np.random.Generator) -> Array:
    """(p,) a point inside the term's cone, no parameter near zero: 1 if there is but one, a tool of 1 kg for a body."""
    cone = term.cone(robot)
    if len(cone.bodies):
        towards = rng.standard_normal(3)
        return _random_body(np.outer([0.0, _GRIP], towards / np.linalg.norm(towards)), 1.0, _GIRTH, rng)
    if cone.size == 1:
        return np.ones(1)
    values = rng.uniform(0.5, 1.0, cone.size) * rng.choice([-1.0, 1.0], cone.size)
    values[cone.nonnegative] = np.abs(values[cone.nonnegative])
    return values


def _scaled_distortion(
    form: Distortion, effect: Effect, model: Model, theta: Array, motion: Motion, rng: np.random.Generator
) -> Distortion:
    """The distortion with the magnitude that has the level; the smallest, if there are several."""
    before, j = model.effort(motion, theta), effect.joint - 1
    rms = _rms(before)[j]
    dial, highest = _dial(form, effect, before, motion, rng)

    def level(x: float) -> float:
        if x == 0.0:
            return 0.0
        one = dial(x)
        after = one.measured(before) if one.of_sensor else model.distort(one).effort(motion, theta)
        return float(_rms(after - before)[j] / rms)

    low, high = 0.0, highest / 64.0
    while rms > 0.0 and level(high) < effect.level and high < highest:
        low, high = high, min(2.0 * high, highest)
    if not (rms > 0.0 and level(high) >= effect.level):
        raise _unreachable(effect, f"{form.name} does not change this joint's effort as much")
    x = brentq(lambda x: level(x) - effect.level, low, high, xtol=1e-6 * high, rtol=1e-6)
    missed, x = min((abs(level(near) - effect.level), near) for near in (x - 2e-6 * high, x, x + 2e-6 * high))
    if missed > _CLOSE * effect.level:
        raise _unreachable(effect, f"the samples of this joint make it change in steps, as to {level(x):.4g}")
    return dial(x)


def _dial(
    form: Distortion, effect: Effect, effort: Array, motion: Motion, rng: np.random.Generator
) -> tuple[_Dial, float]:
    """The distortion by its magnitude, in a random direction, and the largest magnitude.

    A lag is at most a radian of the fastest harmonic: the motion is not known before it begins.
    """
    peak = 1.001 * float(np.abs(effort[:, effect.joint - 1]).max())
    side = 1.0 if effect.level >= 1.0 else float(rng.choice([-1.0, 1.0]))  # no gain is negative
    heading = rng.uniform(0.0, 2.0 * np.pi)
    span = float(motion.t[-1] - motion.t[0])
    dials: dict[type[Distortion], tuple[_Dial, float]] = {
        GainError: (lambda x: form.moved(np.array([side * x])), 2.0 * _LARGEST_EFFECT),
        Delay: (lambda x: Delay(joints=form.joints, lag=(x,)), span / (2.0 * np.pi * HARMONICS)),
        BaseTilt: (lambda x: form.moved(x * np.array([np.cos(heading), np.sin(heading)])), _STEEPEST),
        Clipping: (lambda x: Clipping(joints=form.joints, limit=(peak - x,)), peak),
        DeadZone: (lambda x: DeadZone(joints=form.joints, width=(x,)), peak),
    }
    return dials[type(form)]
