"""Are confidences and intervals correct? Simulated logs with known truth.

`own`: logs of bayesid's simulator, identified with the terms that made them (`complete="off"`). Noise of 2 to 15 % of
each joint's RMS effort, white or AR(1) with 0.9 at 100 Hz; 3 s or 15 s; new parameters, motion and noise for each. Logs
of `misfit` have an effect outside of the model: a spring, torque ripple or an offset that changes with position, 0.2 to
1 times each joint's RMS effort. No coefficient is right then, and confidences must be low.

`CLASSES`: logs of another engine (MuJoCo, `bayesid.studies.hidden`), identified with all defaults. One class per
difficulty, all with the same seeds.

Tables: the share of right signs by bin of confidence, for samples (sign of the noisy effort), samples at rest and
segments (sign of the sum of the samples); the coverage of 95 % intervals of coefficients of the standard terms; and
certificates although the data prefer other signs (`bayesid.studies.preference`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects import STANDARD, RigidBody
from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.identification.identification import Identification
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log
from bayesid.posterior.sampler import Sampling
from bayesid.robot import load_robot
from bayesid.signs.search.certified import Certified
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import exciting_trajectory
from bayesid.studies.calibration_report import EDGES, draw, report
from bayesid.studies.discrepancy import generator
from bayesid.studies.hidden import Case, Simulated, make_case
from bayesid.studies.preference import Witnessed, preference, true_signs
from bayesid.studies.record import Row
from bayesid.studies.study import Plan, Study, mixed

ROBOTS = ("kr5", "ur10e", "panda", "tx40")
NOISES = (0.02, 0.05, 0.10, 0.15)
COLOURS = (0.0, 0.9)
DURATIONS = (3.0, 15.0)
_RATE = 100.0
MISFITS: dict[str, Callable[[Array], Array]] = {
    "spring": lambda q: q,
    "ripple": lambda q: np.sin(20.0 * q + 1.0),
    "steps": lambda q: np.sign(np.sin(3.0 * q)),
}
LEVELS = (0.2, 0.35, 0.5, 0.75, 1.0)
"""Of a misfit, relative to the joint's RMS effort."""
_OWN, _LOGS = 256, 20
"""Logs of bayesid's simulator, and of each class."""
_ARMS = ("kr5", "random")
_MILLIMETRE, _DEGREE = 1e-3, float(np.pi / 180.0)
_PRECISE, _POOR = (0.001, 0.01), (0.03, 0.15)
"""Noise at which the Tikhonov term matters most, and at which inertia alone does not determine the signs."""


# ---------------------------------------------------------------------------------------------------------------
# Logs
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Scenario:
    """One log of bayesid's simulator.

    Attributes:
        robot: built-in name.
        noise: relative to each joint's RMS effort.
        colour: AR(1) coefficient of the noise.
        duration: s.
        misfit: an effect outside of the model; empty for none.
        level: its size relative to each joint's RMS effort.
        part: of the study.
    """

    robot: str
    noise: float
    colour: float
    duration: float
    misfit: str = ""
    level: float = 0.0
    part: str = "own"


ORDINARY = [
    Scenario(robot, noise, colour, duration)
    for noise in NOISES
    for duration in DURATIONS
    for robot in ROBOTS
    for colour in COLOURS
]
MISFITTING = [Scenario(r, 0.03, 0.0, 12.0, name, level) for name in MISFITS for level in LEVELS for r in ROBOTS]


def _of(name: str, robot: str = "", **options: Any) -> Simulated:
    return Simulated("classes", name, robot, posterior=True, **options)


def _alone(name: str, motion: str, robot: str = "pendulum", **options: Any) -> Simulated:
    """A log whose signs are ambiguous."""
    return _of(name, robot, motion=motion, joints="none", **options)


CLASSES = (
    _of("right"),
    _of("zeros", joints="some"),
    _of("stribeck", effects=("stribeck_friction",)),
    _of("load_dependent", effects=("load_dependent_friction",)),
    _of("dh", length=_MILLIMETRE, angle=0.1 * _DEGREE),
    _of("dh_wide", length=5.0 * _MILLIMETRE, angle=0.5 * _DEGREE),
    _of("dh_unstated", length=5.0 * _MILLIMETRE, angle=0.5 * _DEGREE, unstated=True),
    _of("delay", effects=("delay",), lag=(0.02, 0.02)),
    _of("warming", effects=("thermal_drift",)),
    _of("counterbalance", "kr5", effects=("gravity_spring",), joint=2),
    _of("point_to_point", motion="point to point"),
    _of("short", duration=2.0),
    _of("heavy_tails", reading="Student t"),
    _of("quantised", reading="8 bit"),
    _of("coloured", reading="AR(1) 0.97"),
    _of("filtered_8", reading="filtered 8 Hz"),
    _of("filtered_3", reading="filtered 3 Hz"),
    _alone("pendulum", "swing", noise_range=_PRECISE),
    _alone("sine", "one sine", noise_range=_PRECISE),
    _alone("lever", "one sine", "lever", noise_range=_PRECISE),
    _alone("symmetric", "crawl", terms=("rigid_body",)),
    _of("no_gravity", "upright", joints="none", noise_range=_POOR),
)
"""The last five are ambiguous by design. Without a robot: KR5 and random arms in turn."""


def shuffled(kinds: Sequence[Scenario]) -> Plan:
    """Every kind about equally often, every trial with its own seed."""

    def plan(trials: int, seed: int) -> list[tuple[Scenario, int]]:
        order = np.random.default_rng(seed).permutation(len(kinds))
        return [(kinds[order[k % len(kinds)]], seed + k) for k in range(trials)]

    return plan


def plan(trials: int, seed: int) -> Sequence[tuple[Scenario | Simulated, int]]:
    """Own logs and those of the classes, evenly mixed; then all again with other seeds.

    Raises:
        InputError: MuJoCo is not installed.
    """
    generator("calibration")
    turns = -(-trials // (_OWN + _LOGS * len(CLASSES)))
    logs: list[tuple[Scenario | Simulated, int]] = []
    for turn in range(turns):
        own = shuffled(ORDINARY)(_OWN * turns, seed)[turn * _OWN : (turn + 1) * _OWN]
        numbers = range(turn * _LOGS, (turn + 1) * _LOGS)
        classes = [(replace(c, robot=c.robot or _ARMS[k % 2]), seed + k) for k in numbers for c in CLASSES]
        logs += mixed([own, classes])
    return logs[:trials]


# ---------------------------------------------------------------------------------------------------------------
# Trials
# ---------------------------------------------------------------------------------------------------------------
def trial(scenario: Scenario | Simulated, seed: int) -> Row:
    """Simulates a log, identifies the robot without its signs and scores confidences and intervals."""
    search, sampling = Witnessed(Certified()), Sampling(rng=seed)
    if isinstance(scenario, Scenario):
        _, theta, log = make_log(scenario, seed)
        result = identify(scenario.robot, log.rectified(), complete="off", search=search, posterior=sampling)
        truth = result.coefficients.project(theta)
    else:
        case = make_case(scenario, seed)
        log, stated = case.log, scenario.prior
        result = identify(case.robot, log.rectified(), scenario.terms, search=search, posterior=sampling, prior=stated)
        truth = _truth(case, result)
    return {**_of_signs(result, log), **_of_coefficients(result, truth), **_of_search(result, search, log)}


def make_log(scenario: Scenario, seed: int) -> tuple[Model, Array, Log]:
    """The model, its true parameters and the log with its signs, on the pipeline's grid."""
    rng = np.random.default_rng(seed)
    robot = load_robot(scenario.robot)
    bodies = Model(robot, (RigidBody(),))
    trajectory = exciting_trajectory(bodies, base_coefficients(bodies), scenario.duration, seed=seed)
    motion = trajectory.motion(np.arange(int(scenario.duration * _RATE) + 1) / _RATE)
    model = Model(robot, make_terms(STANDARD, robot, motion))
    theta = random_parameters(model, rng=rng)
    log = simulate(model, theta, motion, rng=rng, noise=scenario.noise, colour=scenario.colour, signed=True)
    if scenario.misfit:
        effect = MISFITS[scenario.misfit](motion.q)
        size = scenario.level * np.sqrt(np.mean(log.effort**2, axis=0) / np.mean(effect**2, axis=0))
        log = replace(log, effort=log.effort + size * effect)
    return model, theta, log


def _truth(case: Case, result: Identification) -> Array:
    """(r,) true coefficients of the standard terms; NaN for those of added effects, and where none exists."""
    _, standard = case.standard(result.signals.motion)
    truth, names = case.truth(result.model, result.coefficients), set(standard.names)
    return np.where([name in names for name in result.coefficients.names], truth, np.nan)


# ---------------------------------------------------------------------------------------------------------------
# Scores
# ---------------------------------------------------------------------------------------------------------------
def _of_signs(result: Identification, log: Log) -> Row:
    """Bins of confidence; readings of zero have no sign and are left out."""
    effort = on_grid(result, log)
    confidence = np.maximum(result.probability, 1.0 - result.probability)
    right, some = result.sample_signs == np.sign(effort), effort != 0.0
    at_rest = some & (result.segments.per_sample(result.segments.moving, *effort.shape) == 0.0)
    of_segments = true_signs(result.segments, effort) == result.signs
    return {
        "samples": bins(confidence[some], right[some]),
        "rest": bins(confidence[at_rest], right[at_rest]),
        "segments": bins(result.confidence, of_segments),
        "right": float(right[some].mean()),
    }


def on_grid(result: Identification, log: Log) -> Array:
    """(N, n) the log's signed efforts at the pipeline's time steps."""
    t = result.signals.motion.t
    after = np.clip(np.searchsorted(log.t, t), 1, len(log.t) - 1)
    nearest = after - (t - log.t[after - 1] < log.t[after] - t)
    effort: Array = log.effort[nearest]
    return effort


def bins(confidence: Array, right: Mask) -> list[list[float]]:
    """For each bin: count, number of right signs, sum of confidences."""
    place = np.clip(np.searchsorted(EDGES, confidence.ravel(), side="right") - 1, 0, len(EDGES) - 1)
    columns = (np.ones(right.size), right.ravel(), confidence.ravel())
    return np.stack([np.bincount(place, weights=column, minlength=len(EDGES)) for column in columns], axis=1).tolist()


def _of_coefficients(result: Identification, truth: Array) -> Row:
    """Number of intervals that contain the true coefficients; the others, and their errors in standard deviations."""
    assert result.posterior is not None
    low, high = result.posterior.interval(0.95)
    known = np.isfinite(truth)
    inside = known & (low <= truth) & (truth <= high)
    missed = np.flatnonzero(known & ~inside)
    return {
        "inside": int(inside.sum()),
        "coefficients": int(known.sum()),
        "missed": [result.coefficients.names[k] for k in missed],
        "missed_by": ((result.beta - truth) / result.sd)[missed].tolist(),
        "modes": len(result.posterior.modes),
        "heaviest": float(result.posterior.modes[0].weight),
        "converged": bool(result.posterior.converged),
    }


def _of_search(result: Identification, search: Witnessed, log: Log) -> Row:
    """Certificate, preference of the data for other signs (units of the cost), added effects."""
    truth = true_signs(result.searched, on_grid(result, log))
    entered = [] if result.model_selection is None else [effect.effect for effect in result.model_selection.effects]
    return {
        "certified": bool(result.search.certified),
        "preference": preference(search.problem_of(result.search), result.search.signs, truth),
        "entered": entered,
        "timings": result.timings,
    }


STUDY = Study("calibration", _OWN + _LOGS * len(CLASSES), plan, trial, report, draw)
