"""Simulated logs with hidden effects, and their true coefficients, for `complete`, `calibration` and others.

Robots, motions and effects are those of `bayesid.studies.blind`, a generator that shares no code with bayesid. Sizes
are relative to the joint's effort, not to the noise. Joints have friction, offsets and rotors as the standard terms.
Kinematics may differ from the stated table, noise is of several kinds, and some robots and motions are less
informative (`bayesid.studies.stress`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayesid.arrays import Array
from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import BaseCoefficients, base_coefficients
from bayesid.effects.model import Model
from bayesid.log.log import Log
from bayesid.motion import Motion
from bayesid.regression.knowledge import ParameterPrior
from bayesid.robot import Robot, robot_from_table
from bayesid.studies.discrepancy import generator
from bayesid.studies.readings import READINGS
from bayesid.studies.stress import MOTIONS, PointToPoint, bare_robot, held, without_some

SHARES = (0.2, 0.6)
"""Range of the size of a hidden effect: its RMS over that of the joint's healthy effort."""
DURATION = 24.0
"""s, of the generator's logs."""
_SLOW = 0.2
"""Share of the motions with slow parts, as in the generator."""
_ROUNDING_OF_SHARE = 1e-9
"""Share of a coefficient below which the part of a parameter is rounding."""
_VARYING: Mapping[str, tuple[str, ...]] = {
    "coulomb": ("Fc",),
    "viscous": ("Fv",),
    "both": ("Fc", "Fv"),
    "offset_fading": ("offset",),
    "offset_growing": ("offset",),
}
"""Parameters that a thermal drift of each form changes during the log: these have no true value."""


@dataclass(frozen=True)
class Simulated:
    """How a log is made.

    Attributes:
        part: of the study.
        name: of the kind of log within the part.
        robot: "kr5", "random", or another one of `stress.bare_robot`.
        effects: hidden ones, by their names in the catalogue.
        joint: of the hidden effect, from 1; 0 for a random one.
        lag: range of a hidden delay, s; if empty, as large as any other effect.
        noise_range: range of the noise, relative to each joint's RMS effort.
        reading: a key of `READINGS`.
        motion: a key of `stress.MOTIONS`; the generator's own if empty.
        joints: friction, offset and rotor: "all", "some" joints without rotor or viscous friction, or "none".
        terms: of the identified model.
        length: sd of the errors of a and d in the table, m; stated as tolerance, if not zero.
        angle: the same for alpha and theta, rad.
        exact: whether the table is stated to be exact.
        unstated: whether the tolerance is not stated.
        duration: s.
        posterior: whether it is sampled.
    """

    part: str
    name: str
    robot: str
    effects: tuple[str, ...] = ()
    joint: int = 0
    lag: tuple[float, ...] = ()
    noise_range: tuple[float, float] = (0.01, 0.03)
    reading: str = "white"
    motion: str = ""
    joints: str = "all"
    terms: tuple[str, ...] = tuple(STANDARD)
    length: float = 0.0
    angle: float = 0.0
    exact: bool = False
    unstated: bool = False
    duration: float = DURATION
    posterior: bool = False

    @property
    def prior(self) -> ParameterPrior:
        """The stated tolerance of the table."""
        if self.unstated or not (self.length or self.exact):
            return ParameterPrior()
        return ParameterPrior(length_sd=self.length, angle_sd=self.angle)


@dataclass(frozen=True)
class Case:
    """A log and its truth.

    Attributes:
        robot: with its stated table.
        log: with the signs that a signed sensor would have logged; efforts read as zero have none.
        hidden: effects with their joints, from 1; no joints for an effect of the whole robot.
        parameters: true parameters of the standard terms by name, including the friction of a hidden effect at high
            speed; NaN for those that change during the log.
    """

    robot: Robot
    log: Log
    hidden: tuple[tuple[str, tuple[int, ...]], ...]
    parameters: Mapping[str, float]

    def truth(self, model: Model, coefficients: BaseCoefficients) -> Array:
        """(r,) true coefficients of a model that may have more than the standard terms; NaN where none exist."""
        theta = np.array([self.parameters.get(parameter.name, 0.0) for parameter in model.parameters])
        unknown = np.isnan(theta)
        value = coefficients.project(np.where(unknown, 0.0, theta))
        touched = np.abs(coefficients.projection[:, unknown]).max(axis=1, initial=0.0) > _ROUNDING_OF_SHARE
        return np.where(touched, np.nan, value)

    def standard(self, motion: Motion) -> tuple[Model, BaseCoefficients]:
        """The model of the standard terms, and its coefficients."""
        model = Model(self.robot, make_terms(STANDARD, self.robot, motion))
        return model, base_coefficients(model)


def make_case(scenario: Simulated, seed: int) -> Case:
    """The case of a scenario and a seed."""
    blind = generator("complete")
    rng = blind.stream(seed, 0)
    stated = bare_robot(rng, scenario.robot)
    trouble = blind.Trouble(scenario.length, scenario.angle)
    arm = replace(stated, table=blind.wrong_table(stated.table, trouble, blind.stream(seed, 2)))
    motion = _motion(scenario, arm.n, blind.stream(seed, 1), rng)
    play = blind.Play(arm, motion)
    arm = _with_joints(scenario, seed, arm, play)
    play = play.under(arm)
    efforts = play.healthy()
    if isinstance(motion, PointToPoint):
        efforts = efforts + held(arm, motion, play.t, blind.stream(seed, 11))
    scale = blind.rms(efforts[blind.BEFORE :])
    hidden = _hidden(scenario, seed, play, scale)
    for effect in hidden:
        efforts = effect.act(play, efforts)
    rows = _window(scenario, blind, rng)
    noise = blind.stream(seed, 6).uniform(*scenario.noise_range, arm.n) * scale
    effort = READINGS[scenario.reading](efforts[rows], noise, blind.stream(seed, 8))
    log = Log(play.t[rows], play.q[rows], effort, np.ones(arm.n, dtype=bool), source="simulated log")
    joints = [() if effect.draft.joint is None else (effect.draft.joint + 1,) for effect in hidden]
    return Case(
        robot_from_table(stated.table, "simulated robot"),
        log,
        tuple(zip((effect.name for effect in hidden), joints, strict=True)),
        _true_parameters(arm) | _changed(arm, hidden),
    )


def _motion(scenario: Simulated, n: int, draws: np.random.Generator, rng: np.random.Generator) -> Any:
    """A motion with slow parts in some logs, where Stribeck friction shows; not in short logs."""
    drawn = rng.random() < _SLOW and scenario.duration == DURATION
    if scenario.motion:
        return MOTIONS[scenario.motion](draws, n)
    return generator("complete").random_series(draws, n, drawn or "stribeck_friction" in scenario.effects)


def _with_joints(scenario: Simulated, seed: int, arm: Any, play: Any) -> Any:
    """The robot with friction, offsets and rotors."""
    blind = generator("complete")
    if scenario.joints == "none":
        return arm
    arm = blind.with_joints(blind.stream(seed, 4), arm, play)
    return without_some(arm, blind.stream(seed, 10)) if scenario.joints == "some" else arm


def _hidden(scenario: Simulated, seed: int, play: Any, scale: Array) -> Sequence[Any]:
    """The generator's effects, each of the drawn size, or a delay of the drawn lag."""
    blind, rng = generator("complete"), np.random.default_rng([seed, 3])
    if scenario.lag:
        draft = blind.delay(rng, play, int(rng.integers(play.robot.n)))
        return [blind.Hidden("delay", draft, float(rng.uniform(min(scenario.lag), max(scenario.lag))), np.nan)]
    plays, size = [play, play], float(rng.uniform(*SHARES))
    if scenario.joint:
        (name,), efforts = scenario.effects, [play.healthy()] * 2
        return [blind.hide(name, blind.stream(seed, 5), plays, efforts, scale, size, scenario.joint - 1)]
    return blind.all_hidden(scenario.effects, seed, plays, scale, size)


def _window(scenario: Simulated, blind: Any, rng: np.random.Generator) -> slice:
    """The samples that the log takes of the simulated motion."""
    count = round(scenario.duration * blind.RATE)
    start = blind.BEFORE + int(rng.integers(blind.SAMPLES - count + 1))
    return slice(start, start + count)


# ---------------------------------------------------------------------------------------------------------------
# Truth
# ---------------------------------------------------------------------------------------------------------------
def _true_parameters(robot: Any) -> dict[str, float]:
    """Parameters of the standard terms; inertias about the links' frames (Steiner)."""
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
        if effect.name == "stribeck_friction" and form != "bump":  # a bump vanishes at high speed
            changed[f"Fc{joint + 1}"] = float(robot.coulomb[joint]) + effect.magnitude
    return changed
