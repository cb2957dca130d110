"""Simulated logs with effects hidden in them, and the coefficients that are true of them: what `complete` identifies.

Robots, motions and effects are those of `bayesid.studies.blind`, a generator that shares no code with bayesid, in other
sizes: relative to the effort of the joint, not to the noise. Joints have friction, offsets and rotors, as the standard
terms say. The kinematics may be off the table that is given, and the noise of several kinds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from bayesid.arrays import Array
from bayesid.log.log import Log
from bayesid.model.coefficients import BaseCoefficients
from bayesid.model.model import Model
from bayesid.model.robot import Robot, robot_from_table
from bayesid.studies.discrepancy import generator

SHARES = (0.2, 0.6)
"""Between which the size of a hidden effect lies: its RMS over that of the healthy effort of the joint."""
DURATION = 24.0
"""s, of the generator's logs."""
_SLOW = 0.2
"""Share of the motions with slow parts, as in the generator."""
_NONE = 1e-9
"""Share of a coefficient below which a parameter's is rounding."""
_FREEDOM = 3
"""Degrees of freedom of heavy tails: the fewest for which there is a variance."""
_STEPS = 256
"""Of a sensor of 8 bits, from minus its joint's largest effort to plus."""
_VARYING: Mapping[str, tuple[str, ...]] = {
    "coulomb": ("Fc",),
    "viscous": ("Fv",),
    "both": ("Fc", "Fv"),
    "offset_fading": ("offset",),
    "offset_growing": ("offset",),
}
"""What a thermal drift of each form changes during the log: these have no true value."""


@dataclass(frozen=True)
class Simulated:
    """How a log is made, and which part of the study it belongs to.

    Attributes:
        part: of the study.
        name: of the kind of log within the part.
        robot: "kr5" or "random".
        effects: hidden ones, by their names in the catalogue.
        lag: between which a hidden delay lies, s; as large as any other effect if empty.
        noise: a key of `NOISES`.
        length: sd by which the robot's a and d are off its table, m, and
        angle: its alpha and theta, rad; both are stated as the tolerance. The default one holds if they are zero,
        exact: unless the table is stated to be exact.
        duration: s.
        posterior: whether it is sampled.
    """

    part: str
    name: str
    robot: str
    effects: tuple[str, ...] = ()
    lag: tuple[float, ...] = ()
    noise: str = "white"
    length: float = 0.0
    angle: float = 0.0
    exact: bool = False
    duration: float = DURATION
    posterior: bool = False


@dataclass(frozen=True)
class Case:
    """A log, and what is true of it.

    Attributes:
        robot: as it is told: by its table.
        log: with the signs of its efforts.
        hidden: effects with their joints, from 1; without any where it is the whole robot's.
        parameters: true ones of the standard terms, by name, friction of a hidden effect at high speed included; NaN
            for what changes during the log.
    """

    robot: Robot
    log: Log
    hidden: tuple[tuple[str, tuple[int, ...]], ...]
    parameters: Mapping[str, float]

    def truth(self, model: Model, coefficients: BaseCoefficients) -> Array:
        """(r,) true coefficients of a model that may hold more than the standard terms; NaN where there are none."""
        theta = np.array([self.parameters.get(parameter.name, 0.0) for parameter in model.parameters])
        unknown = np.isnan(theta)
        value = coefficients.project(np.where(unknown, 0.0, theta))
        touched = np.abs(coefficients.projection[:, unknown]).max(axis=1, initial=0.0) > _NONE
        return np.where(touched, np.nan, value)


def make_case(scenario: Simulated, seed: int) -> Case:
    """The log of a scenario and a seed, without its noise as the generator plays it."""
    blind = generator("complete")
    rng = blind.stream(seed, 0)
    told = blind.bare_robot(rng, scenario.robot)
    trouble = blind.Trouble(scenario.length, scenario.angle)
    arm = replace(told, table=blind.built_off(told.table, trouble, blind.stream(seed, 2)))
    play = blind.Play(arm, blind.random_series(blind.stream(seed, 1), arm.n, _is_slow(scenario, rng)))
    arm = blind.with_joints(blind.stream(seed, 4), arm, play)
    play = play.under(arm)
    efforts = play.healthy()
    scale = blind.rms(efforts[blind.BEFORE :])
    hidden = _hidden(scenario, seed, play, scale)
    for effect in hidden:
        efforts = effect.act(play, efforts)
    rows = _window(scenario, blind, rng)
    noise = blind.stream(seed, 6).uniform(0.01, 0.03, arm.n) * scale
    effort = NOISES[scenario.noise](efforts[rows], noise, blind.stream(seed, 8))
    log = Log(play.t[rows], play.q[rows], effort, np.ones(arm.n, dtype=bool), source="simulated log")
    joints = [() if effect.draft.joint is None else (effect.draft.joint + 1,) for effect in hidden]
    return Case(
        robot_from_table(told.table, "simulated robot"),
        log,
        tuple(zip((effect.name for effect in hidden), joints, strict=True)),
        _true_parameters(arm) | _changed(arm, hidden),
    )


def _is_slow(scenario: Simulated, rng: np.random.Generator) -> bool:
    """Friction that falls with speed shows in slow parts; a short log would be nothing else."""
    drawn = rng.random() < _SLOW and scenario.duration == DURATION
    return drawn or "stribeck_friction" in scenario.effects


def _hidden(scenario: Simulated, seed: int, play: Any, scale: Array) -> Sequence[Any]:
    """The generator's effects: each of the size drawn, or a delay of the lag drawn."""
    blind, rng = generator("complete"), np.random.default_rng([seed, 3])
    if scenario.lag:
        draft = blind.delay(rng, play, int(rng.integers(play.robot.n)))
        return [blind.Hidden("delay", draft, float(rng.uniform(min(scenario.lag), max(scenario.lag))), np.nan)]
    return blind.all_hidden(scenario.effects, seed, [play, play], scale, float(rng.uniform(*SHARES)))


def _window(scenario: Simulated, blind: Any, rng: np.random.Generator) -> slice:
    """The log's part of what was played."""
    count = round(scenario.duration * blind.RATE)
    start = blind.BEFORE + int(rng.integers(blind.SAMPLES - count + 1))
    return slice(start, start + count)


# ---------------------------------------------------------------------------------------------------------------
# Truth
# ---------------------------------------------------------------------------------------------------------------
def _true_parameters(robot: Any) -> dict[str, float]:
    """Of the standard terms; inertias about the links' frames (Steiner)."""
    true: dict[str, float] = {}
    for i, body in enumerate(robot.links, start=1):
        r = body.centre
        inertia = body.inertia + body.mass * (r @ r * np.eye(3) - np.outer(r, r))
        axes = zip(("xx", "xy", "xz", "yy", "yz", "zz"), inertia[np.triu_indices(3)], strict=True)
        true |= {f"J{i}{axis}": float(value) for axis, value in axes}
        true |= {f"mc{i}{axis}": float(value) for axis, value in zip("xyz", body.mass * r, strict=True)}
        joint = {"Fv": robot.viscous, "Fc": robot.coulomb, "offset": robot.offset, "Ia": robot.rotor}
        true |= {f"m{i}": float(body.mass), **{f"{name}{i}": float(value[i - 1]) for name, value in joint.items()}}
    return true


def _changed(robot: Any, hidden: Sequence[Any]) -> dict[str, float]:
    """Parameters of the standard terms that hidden effects change."""
    changed: dict[str, float] = {}
    for effect in hidden:
        form, joint = effect.draft.parameters.get("form"), effect.draft.joint
        if effect.name == "thermal_drift":
            changed |= {f"{name}{joint + 1}": np.nan for name in _VARYING[form]}
        if effect.name == "stribeck_friction" and form != "bump":  # of which nothing is left at high speed
            changed[f"Fc{joint + 1}"] = float(robot.coulomb[joint]) + effect.magnitude
    return changed


# ---------------------------------------------------------------------------------------------------------------
# Noise
# ---------------------------------------------------------------------------------------------------------------
def _white(efforts: Array, sd: Array, rng: np.random.Generator) -> Array:
    return efforts + sd * rng.standard_normal(efforts.shape)


def _autoregressive(correlation: float) -> Callable[[Array, Array, np.random.Generator], Array]:
    """Noise that is correlated from sample to sample, and stationary from the first."""

    def noisy(efforts: Array, sd: Array, rng: np.random.Generator) -> Array:
        steps = rng.standard_normal(efforts.shape) * np.sqrt(1.0 - correlation**2)
        steps[0] /= np.sqrt(1.0 - correlation**2)
        return efforts + sd * lfilter([1.0], [1.0, -correlation], steps, axis=0)

    return noisy


def _quantised(efforts: Array, sd: Array, rng: np.random.Generator) -> Array:
    """No other noise that would hide the steps."""
    step = 2.0 * np.abs(efforts).max(axis=0) / _STEPS
    return step * np.rint(efforts / step)


def _heavy_tailed(efforts: Array, sd: Array, rng: np.random.Generator) -> Array:
    return efforts + sd * rng.standard_t(_FREEDOM, efforts.shape) * np.sqrt((_FREEDOM - 2) / _FREEDOM)


NOISES: Mapping[str, Callable[[Array, Array, np.random.Generator], Array]] = {
    "white": _white,
    "AR(1) 0.9": _autoregressive(0.9),
    "AR(1) 0.97": _autoregressive(0.97),
    "8 bit": _quantised,
    "Student t": _heavy_tailed,
}
"""Name to what makes readings of efforts (N, n): of an RMS of 1 to 3 % of each joint's RMS effort but for "8 bit"."""
