"""Simulated logs of a model, or of a robot with added effects."""

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
    """Simulates the log of a motion: exact positions, efforts with Gaussian noise, without signs unless `signed`.

    Noise is added before sensor distortions and rectification.

    Args:
        model: a model; or a robot, its name or file, with random feasible parameters (the KR5 with those of the paper)
            and an exciting trajectory.
        theta: (P,) parameters; with a model only.
        motion: N samples of motion; with a model only.
        rng: of the noise; with a robot also of parameters, trajectory and form of each effect. A generator, a seed, or
            None for a random seed.
        noise: standard deviation of the noise relative to the RMS of each joint's effort.
        colour: correlation of the noise between neighbouring samples, AR(1); 0 is white. With a model only.
        signed: whether efforts keep their sign: all joints, or with a model one per joint (n,).
        sensor: (n,) standard deviation of the noise, N m, in place of `noise`. With a model only.
        duration: of the log, s. With a robot only.
        rate: of the log, Hz. With a robot only.
        effects: added to the rigid bodies, as "coulomb_friction:2:0.1": name, joint, and RMS relative to that of the
            joint's effort. With a robot only.

    Raises:
        ValueError: a noise is out of range.
        InputError: duration or rate is out of range, or an effect cannot have its level.

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
        chosen = [parse_effect(effect, robot) if isinstance(effect, str) else effect for effect in effects]
        recorded, truth = simulate_log(robot, duration, rate, noise, chosen, seed_of(rng))
        return truth if np.all(signed) else recorded
    if theta is None or motion is None:
        raise InputError("is needed to simulate a model", field="theta", remedy="give parameters and a motion")
    if not 0.0 <= noise < np.inf:
        raise ValueError(f"the noise must be at least 0 and finite, not {noise}")
    if not 0.0 <= colour < 1.0:
        raise ValueError(f"the noise's correlation must lie in [0, 1), not {colour}")
    absolute = None if sensor is None else np.asarray(sensor)
    usable = absolute is None or (
        absolute.shape == (motion.n_joints,) and np.all((absolute >= 0.0) & (absolute < np.inf))
    )
    if not usable:
        raise ValueError(f"the sensor's noise must be {motion.n_joints} finite numbers, one per joint, none negative")
    effort = model.before_sensors.effort(motion, theta)
    sd = noise * rms(effort) if absolute is None else absolute
    white, scale = np.random.default_rng(rng).standard_normal(effort.shape), np.sqrt(1.0 - colour**2)
    first = (1.0 - scale) * white[:1]  # stationary noise of unit variance: x_i = c x_(i-1) + sqrt(1 - c^2) e_i
    effort = model.read(effort + sd * scipy.signal.lfilter([scale], [1.0, -colour], white, axis=0, zi=first)[0])
    signed_joints = np.broadcast_to(np.asarray(signed, dtype=bool), motion.n_joints)
    effort = np.where(signed_joints, effort, np.abs(effort))
    return Log(motion.t, motion.q, effort, signed_joints, source=f"simulated {model.robot.name}")


class SimulatedEffect(NamedTuple):
    """An effect to be added to a simulated robot."""

    name: str  # of an effect in `bayesid.effects.catalogue.main_forms()`
    joint: int  # 1-based; for an effect of the whole robot, the joint that has the level
    level: float  # RMS change of the joint's effort relative to its RMS without the effect

    def __str__(self) -> str:
        return f"{self.name}:{self.joint}:{self.level:g}"


def parse_effect(text: str, robot: Robot) -> SimulatedEffect:
    """NAME:JOINT:LEVEL as on the command line; InputError if effect, joint or level cannot be used."""
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
    """A log of |effort| on an exciting trajectory, and the same log with signs.

    Args:
        robot: with the paper's parameters if it is the KR5, else with random feasible ones.
        duration: s.
        rate: Hz.
        noise: relative to each joint's RMS effort.
        effects: added to the rigid bodies; sensor distortions come last.
        seed: of parameters, trajectory, noise and the form of each effect.

    Raises:
        InputError: duration, rate or noise is out of range, or an effect cannot have its level.
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
    of_paper = robot.same_kinematics(load_robot("kr5-paper"))
    theta = nominal_parameters() if of_paper else random_parameters(model, rng=rng)
    trajectory = exciting_trajectory(model, base_coefficients(model), duration, seed=seed)
    motion = trajectory.motion(np.arange(int(duration * rate) + 1) / rate)
    model, theta = with_effects(model, theta, motion, effects, seed)
    signed = simulate(model, theta, motion, rng=rng, noise=noise, signed=True)
    return signed.rectified(), signed


def with_effects(
    model: Model, theta: Array, motion: Motion, added: Sequence[SimulatedEffect], seed: int
) -> tuple[Model, Array]:
    """Model and parameters with added effects: terms, then distortions, then sensor distortions.

    The level of a term is relative to the effort of the rigid bodies, that of a distortion to the effort before it.
    Each effect has its own random stream, so its form does not depend on the others.
    """
    scene = _scene(model, theta, motion)
    streams = [np.random.default_rng([seed, k]) for k in range(1, len(added) + 1)]
    pairs = [(effect, rng) for effect, rng in zip(added, streams, strict=True) if effect.level > 0.0]
    drawn = [(_form(effect, scene, rng), effect, rng) for effect, rng in pairs]
    kinds = Distortion, SensorDistortion
    for form, effect, rng in sorted(drawn, key=lambda each: [isinstance(each[0], kind) for kind in kinds]):
        if isinstance(form, Distortion):
            current = _scene(model, theta, motion)
            model = model.extend(_scaled_distortion(form, effect, model, current, theta, rng))
        elif form.frees:
            model, theta = _with_negative(form, effect, model, theta, scene)
        else:
            model, theta = model.extend(form), np.concatenate([theta, _scaled_term(form, effect, scene, rng)])
    return model, theta


def _with_negative(
    form: Term, effect: SimulatedEffect, model: Model, theta: Array, scene: Scene
) -> tuple[Model, Array]:
    """Model and parameters for a term that frees parameters from their sign: they get negative values at the level."""
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
        raise _unreachable(effect, "it does not apply to this joint and motion")
    return forms[int(rng.integers(len(forms)))]


def _unreachable(effect: SimulatedEffect, why: str) -> InputError:
    problem = f"{str(effect)!r} cannot be simulated: {why}"
    return InputError(problem, field="effects", remedy="give another level, joint or seed")


def _scaled_term(term: Term, effect: SimulatedEffect, scene: Scene, rng: np.random.Generator) -> Array:
    """(p,) parameters in a random direction, with the effect's level."""
    unit = _inside_cone(term, scene.robot, rng)
    size = rms(Model(scene.robot, (term,)).effort(scene.motion, unit))
    j = effect.joint - 1
    target = effect.level * rms(scene.effort)[j]
    if not (size[j] > TUNING.trace * size.max() and target > 0.0):
        raise _unreachable(effect, "the effect or the rigid bodies cause no effort in this joint")
    return unit * (target / size[j])


def _inside_cone(term: Term, robot: Robot, rng: np.random.Generator) -> Array:
    """(p,) a point inside the term's cone, no parameter near zero; 1 for a single one, a tool of 1 kg for a body."""
    cone = term.cone(robot)
    if len(cone.bodies):
        direction, (length, radius) = rng.standard_normal(3), TUNING.payload
        return random_body(np.outer([0.0, length], direction / np.linalg.norm(direction)), 1.0, radius, rng)
    if cone.size == 1:
        return np.ones(1)
    values = rng.uniform(0.5, 1.0, cone.size) * rng.choice([-1.0, 1.0], cone.size)
    values[cone.nonnegative] = np.abs(values[cone.nonnegative])
    return values


def _scaled_distortion(
    form: Distortion, effect: SimulatedEffect, model: Model, scene: Scene, theta: Array, rng: np.random.Generator
) -> Distortion:
    """The distortion of a form with the smallest magnitude that has the effect's level.

    It distorts a model with parameters theta (P,), whose effort is that of the scene; `rng` draws the direction.
    """
    before, j = scene.effort, effect.joint - 1
    sign = 1.0 if effect.level >= 1.0 else float(rng.choice([-1.0, 1.0]))  # it must not cancel the whole effort
    direction = Direction(sign, float(rng.uniform(0.0, 2.0 * np.pi)))
    size = rms(before)[j]

    def level(magnitude: float) -> float:
        if magnitude == 0.0:
            return 0.0
        distortion = form.of_magnitude(magnitude, direction, scene)
        sensor = isinstance(distortion, SensorDistortion)
        after = distortion.measured(before) if sensor else model.extend(distortion).effort(scene.motion, theta)
        return float(rms(after - before)[j] / size)

    largest = form.largest_magnitude(scene)
    low, high = 0.0, TUNING.smallest * largest
    while size > 0.0 and level(high) < effect.level and high < largest:
        low, high = high, min(2.0 * high, largest)
    if not (size > 0.0 and level(high) >= effect.level):
        raise _unreachable(effect, f"{form.name} cannot change this joint's effort that much")
    xtol = TUNING.xtol * high
    root = scipy.optimize.brentq(lambda x: level(x) - effect.level, low, high, xtol=xtol, rtol=TUNING.xtol)
    near = (root - 2.0 * xtol, root, root + 2.0 * xtol)  # the level may jump at the root
    missed, best = min((abs(level(x) - effect.level), x) for x in near)
    if missed > TUNING.close * effect.level:
        raise _unreachable(effect, f"the level changes in steps here; the nearest is {level(best):.4g}")
    return form.of_magnitude(best, direction, scene)
