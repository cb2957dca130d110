"""Simulated logs: what a controller would record of a model, and of a robot with effects that a model may lack."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, overload

import numpy as np
import scipy

from bayesid.arrays import Array, seed_of
from bayesid.effects import RigidBody, Term
from bayesid.effects.catalogue import main_forms, owner
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.distortion import Direction, Distortion, SensorDistortion
from bayesid.effects.effect import Scene
from bayesid.effects.model import Model
from bayesid.errors import InputError, near_names
from bayesid.log.log import Log
from bayesid.motion import Motion
from bayesid.robot import Robot, load_robot
from bayesid.simulation.paper import nominal_parameters
from bayesid.simulation.parameters import random_body, random_parameters, rms
from bayesid.simulation.trajectories import exciting_trajectory
from bayesid.simulation.tuning import TUNING


@overload
def simulate(
    model: Model,
    theta: Array,
    motion: Motion,
    *,
    rng: np.random.Generator | int | None = 0,
    noise: float = 0.05,
    colour: float = 0.0,
    signed: bool | Sequence[bool] = False,
    sensor: Array | None = None,
) -> Log: ...


@overload
def simulate(
    model: Robot | str | Path,
    *,
    rng: np.random.Generator | int | None = 0,
    noise: float = 0.05,
    signed: bool = False,
    duration: float = 20.0,
    rate: float = 100.0,
    effects: Sequence[SimulatedEffect | str] = (),
) -> Log: ...


def simulate(  # noqa: PLR0913  options of either form
    model: Model | Robot | str | Path,
    theta: Array | None = None,
    motion: Motion | None = None,
    *,
    rng: np.random.Generator | int | None = 0,
    noise: float = 0.05,
    colour: float = 0.0,
    signed: bool | Sequence[bool] = False,
    sensor: Array | None = None,
    duration: float = 20.0,
    rate: float = 100.0,
    effects: Sequence[SimulatedEffect | str] = (),
) -> Log:
    """A log of a motion, positions exact, efforts with Gaussian noise and rectified where they are not signed.

    Noise is added before the sensor's distortions and before rectification, as in a controller.

    Args:
        model: the model; or a robot, its name or file, which gets random feasible parameters (the KR5 those of the
            paper) and an exciting trajectory.
        theta: (P,) parameters of the model; not beside a robot.
        motion: N samples of motion; not beside a robot.
        rng: draws the noise and, of a robot, parameters, trajectory and the form of each effect: a generator, a seed,
            or None for another one each time.
        noise: standard deviation of the noise relative to the RMS of each joint's effort.
        colour: correlation of the noise from one sample to the next, AR(1); 0 is white. Of a model.
        signed: whether the efforts keep their sign, for all joints or, of a model, each (n,).
        sensor: (n,) standard deviation of the noise, N m, instead of `noise`: a sensor's is the same in any motion. Of
            a model.
        duration: s, of a robot's log.
        rate: Hz, of a robot's log.
        effects: of a robot, on top of the rigid bodies, as in "coulomb_friction:2:0.1": name, joint and RMS relative to
            that of the joint's effort.

    Raises:
        ValueError: a noise cannot be used.
        InputError: duration or rate cannot be used, or an effect cannot have its level.

    Example:
        >>> log = bayesid.simulate(model, theta, motion, rng=0, noise=0.05)
        >>> log.effort.shape, bool((log.effort >= 0.0).all())
        ((201, 3), True)
        >>> truth = bayesid.simulate(robot, duration=4.0, rate=50.0, effects=["coulomb_friction:2:0.2"], signed=True)
        >>> len(truth), bool(truth.signed.all()), bool(truth.rectified().signed.any())
        (201, True, False)
    """
    if not isinstance(model, Model):
        robot = model if isinstance(model, Robot) else load_robot(model)
        chosen = [parse_effect(one, robot) if isinstance(one, str) else one for one in effects]
        recorded, truth = simulate_log(robot, duration, rate, noise, chosen, seed_of(rng))
        return truth if np.all(signed) else recorded
    if theta is None or motion is None:
        raise InputError("a model alone cannot be simulated", field="theta", remedy="give parameters and a motion too")
    if not 0.0 <= noise < np.inf:
        raise ValueError(f"the noise must be a finite share of the effort, not {noise}")
    if not 0.0 <= colour < 1.0:
        raise ValueError(f"the noise's correlation must lie in [0, 1), not {colour}")
    own = None if sensor is None else np.asarray(sensor)
    if own is not None and not (own.shape == (motion.n_joints,) and np.all((own >= 0.0) & (own < np.inf))):
        raise ValueError(f"the sensor's noise must be {motion.n_joints} finite numbers, one a joint, none negative")
    effort = model.before_sensors.effort(motion, theta)
    sd = noise * rms(effort) if own is None else own
    white, scale = np.random.default_rng(rng).standard_normal(effort.shape), np.sqrt(1.0 - colour**2)
    first = (1.0 - scale) * white[:1]  # stationary noise of unit variance: x_i = c x_(i-1) + sqrt(1 - c^2) e_i
    effort = model.read(effort + sd * scipy.signal.lfilter([scale], [1.0, -colour], white, axis=0, zi=first)[0])
    keeps = np.broadcast_to(np.asarray(signed, dtype=bool), motion.n_joints)
    effort = np.where(keeps, effort, np.abs(effort))
    return Log(motion.t, motion.q, effort, keeps, source=f"simulated {model.robot.name}")


class SimulatedEffect(NamedTuple):
    """An effect to be added to a simulated robot."""

    name: str  # of an effect in `bayesid.effects.catalogue.main_forms()`
    joint: int  # 1-based; where the whole robot is affected, the joint that has the level
    level: float  # RMS of the change of the joint's effort relative to the RMS of that effort without it

    def __str__(self) -> str:
        return f"{self.name}:{self.joint}:{self.level:g}"


def parse_effect(text: str, robot: Robot) -> SimulatedEffect:
    """NAME:JOINT:LEVEL as on the command line; InputError where it names no effect of one of the robot's joints."""
    remedy = f"give NAME:JOINT:LEVEL, NAME one of {', '.join(main_forms())}"
    try:
        name, joint, level = text.split(":")
        effect = SimulatedEffect(name, int(joint), float(level))
    except ValueError:
        raise InputError(f"{text!r} is not NAME:JOINT:LEVEL", field="effects", remedy=remedy) from None
    if effect.name not in main_forms():
        remedy = f"{near_names(effect.name, main_forms())} {remedy}".strip()
        raise InputError(f"{text!r} is not in the catalogue of effects", field="effects", remedy=remedy)
    if not 1 <= effect.joint <= robot.n_joints:
        raise InputError(f"{text!r} names joint {effect.joint}", field="effects", remedy=f"give 1 to {robot.n_joints}")
    if not 0.0 <= effect.level <= 1e3:
        raise InputError(f"{text!r} has a level of {effect.level:g}", field="effects", remedy="give 0 to 1000")
    return effect


def simulate_log(
    robot: Robot, duration: float, rate: float, noise: float, effects: Sequence[SimulatedEffect], seed: int
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
    ranges = (duration, "duration", 1.0, 1e5), (rate, "rate", 10.0, 1e4), (noise, "noise", 0.0, 1e2)
    for value, name, least, most in ranges:  # wide, to catch typing errors
        if not least <= value <= most:
            raise InputError(f"{value:g} is out of range", field=name, remedy=f"give {least:g} to {most:g}")
    if duration * rate > 1e7:  # 1.4 GB of memory for six joints
        remedy = "reduce duration or rate to at most 1e+07 samples"
        raise InputError(f"{duration * rate:g} samples are too many", field="duration", remedy=remedy)
    rng = np.random.default_rng(seed)
    model = Model(robot, (RigidBody(),))
    known = robot.same_kinematics(load_robot("kr5-paper"))
    theta = nominal_parameters() if known else random_parameters(model, rng=rng)
    trajectory = exciting_trajectory(model, base_coefficients(model), duration, seed=seed)
    motion = trajectory.motion(np.arange(int(duration * rate) + 1) / rate)
    model, theta = with_effects(model, theta, motion, effects, seed)
    signed = simulate(model, theta, motion, rng=rng, noise=noise, signed=True)
    return signed.rectified(), signed


def with_effects(
    model: Model, theta: Array, motion: Motion, added: Sequence[SimulatedEffect], seed: int
) -> tuple[Model, Array]:
    """Model and parameters with terms, then distortions of rows, then those of sensors.

    The level of a term is relative to the rigid bodies' effort, that of a distortion to the effort that it meets. Each
    effect draws its form from a stream of its own, so that the others leave it alone.
    """
    scene = _scene(model, theta, motion)
    streams = [np.random.default_rng([seed, k]) for k in range(1, len(added) + 1)]
    pairs = [(effect, rng) for effect, rng in zip(added, streams, strict=True) if effect.level > 0.0]
    drawn = [(_form(effect, scene, rng), effect, rng) for effect, rng in pairs]
    kinds = Distortion, SensorDistortion
    for form, effect, rng in sorted(drawn, key=lambda each: [isinstance(each[0], kind) for kind in kinds]):
        if isinstance(form, Distortion):
            here = _scene(model, theta, motion)
            model = model.extend(_scaled_distortion(form, effect, model, here, theta, rng))
        elif form.frees:
            model, theta = _with_negative(form, effect, model, theta, scene)
        else:
            model, theta = model.extend(form), np.concatenate([theta, _scaled_term(form, effect, scene, rng)])
    return model, theta


def _with_negative(
    form: Term, effect: SimulatedEffect, model: Model, theta: Array, scene: Scene
) -> tuple[Model, Array]:
    """Model and parameters with those that a term frees negative, at the level."""
    j, extended, values = effect.joint - 1, model, theta.copy()
    for symbol, name in zip(form.frees, form.freed(model.robot), strict=True):
        if name not in [parameter.name for parameter in model.parameters]:
            extended, values = extended.extend(owner(symbol)[0](joints=form.joints)), np.append(values, 0.0)
        place = [parameter.name for parameter in extended.parameters].index(name)
        column = extended.columns(scene.motion)[:, :, place]
        values[place] = -effect.level * rms(scene.effort)[j] / rms(column)[j]
    return extended.extend(form), values


def _scene(model: Model, theta: Array, motion: Motion) -> Scene:
    effort = model.effort(motion, theta)
    return model.scene(motion, theta, effort, np.abs(effort))


def _form(effect: SimulatedEffect, scene: Scene, rng: np.random.Generator) -> Term | Distortion:
    variants = main_forms()[effect.name].variants(scene)
    forms = [form for form in variants if form.joints in ((), (effect.joint,))]
    if not forms:
        raise _unreachable(effect, "not applicable to this joint and motion")
    return forms[int(rng.integers(len(forms)))]


def _unreachable(effect: SimulatedEffect, why: str) -> InputError:
    what = f"{str(effect)!r} cannot be simulated: {why}"
    return InputError(what, field="effects", remedy="give another level, joint or seed")


def _scaled_term(term: Term, effect: SimulatedEffect, scene: Scene, rng: np.random.Generator) -> Array:
    """(p,) parameters in a random direction, at the level."""
    unit = _inside_cone(term, scene.robot, rng)
    size = rms(Model(scene.robot, (term,)).effort(scene.motion, unit))
    j = effect.joint - 1
    target = effect.level * rms(scene.effort)[j]
    if not (size[j] > TUNING.trace * size.max() and target > 0.0):
        raise _unreachable(effect, "the effect or the rigid bodies have no effort in this joint")
    return unit * (target / size[j])


def _inside_cone(term: Term, robot: Robot, rng: np.random.Generator) -> Array:
    """(p,) a point inside the term's cone, no parameter near zero: 1 if there is but one, a tool of 1 kg for a body."""
    cone = term.cone(robot)
    if len(cone.bodies):
        towards, (reach, radius) = rng.standard_normal(3), TUNING.grip
        return random_body(np.outer([0.0, reach], towards / np.linalg.norm(towards)), 1.0, radius, rng)
    if cone.size == 1:
        return np.ones(1)
    values = rng.uniform(0.5, 1.0, cone.size) * rng.choice([-1.0, 1.0], cone.size)
    values[cone.nonnegative] = np.abs(values[cone.nonnegative])
    return values


def _scaled_distortion(
    form: Distortion, effect: SimulatedEffect, model: Model, scene: Scene, theta: Array, rng: np.random.Generator
) -> Distortion:
    """The distortion of a form with the magnitude that has the level; the smallest, if there are several.

    It distorts a model with parameters theta (P,), whose effort is the scene's; rng draws the direction.
    """
    before, j = scene.effort, effect.joint - 1
    sign = 1.0 if effect.level >= 1.0 else float(rng.choice([-1.0, 1.0]))  # it may not take away all of the effort
    direction = Direction(sign, float(rng.uniform(0.0, 2.0 * np.pi)))
    whole = rms(before)[j]

    def level(magnitude: float) -> float:
        if magnitude == 0.0:
            return 0.0
        distortion = form.of_magnitude(magnitude, direction, scene)
        sensor = isinstance(distortion, SensorDistortion)
        after = distortion.measured(before) if sensor else model.extend(distortion).effort(scene.motion, theta)
        return float(rms(after - before)[j] / whole)

    largest = form.largest_magnitude(scene)
    low, high = 0.0, TUNING.smallest * largest
    while whole > 0.0 and level(high) < effect.level and high < largest:
        low, high = high, min(2.0 * high, largest)
    if not (whole > 0.0 and level(high) >= effect.level):
        raise _unreachable(effect, f"{form.name} does not change this joint's effort that much")
    xtol = TUNING.xtol * high
    root = scipy.optimize.brentq(lambda x: level(x) - effect.level, low, high, xtol=xtol, rtol=TUNING.xtol)
    near = (root - 2.0 * xtol, root, root + 2.0 * xtol)  # the level may jump at the root
    missed, best = min((abs(level(x) - effect.level), x) for x in near)
    if missed > TUNING.close * effect.level:
        raise _unreachable(effect, f"the level changes in steps here, the nearest one is {level(best):.4g}")
    return form.of_magnitude(best, direction, scene)
