"""One simulated log, identified without its signs and scored against the truth, for the sensitivity studies.

Every seed has its own parameters, motion and noise. Budgets count work, not seconds, so rows are reproducible.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array
from bayesid.effects import STANDARD, RigidBody
from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.identification.identification import Identification
from bayesid.identification.options import Preprocessing
from bayesid.identification.pipeline import identify
from bayesid.identification.prediction import NORMAL_95
from bayesid.log.log import Log
from bayesid.log.segments import Segmentation
from bayesid.motion import Motion
from bayesid.posterior.sampler import Sampling
from bayesid.regression.knowledge import LinkPrior, ParameterPrior
from bayesid.regression.noise import relative_rms
from bayesid.robot import Robot, load_robot, robot_from_table
from bayesid.signs.search.beam import Beam
from bayesid.signs.search.certified import Certified
from bayesid.signs.search.protocol import Search
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import FourierTrajectory, MotionLimits, exciting_trajectory, random_trajectory
from bayesid.studies.record import Row

ROBOTS = ("kr5", "ur10e", "panda", "tx40")
STRONG = 0.05
"""A sample counts when its true |effort| is at least this share of its joint's maximum."""
RATE = 100.0
"""Hz."""
PERIOD = 12.0
"""s, of the longest motion that does not repeat: a longer period would only slow its five harmonics."""
_REACH = 2.0
"""rad, to either side; like the next two the default of `MotionLimits`."""
_VELOCITY = 3.0
"""rad/s"""
_ACCELERATION = 15.0
"""rad/s^2"""
_EVALUATIONS = 150
"""Of the objective of an exciting motion; fewer than by default, since a study designs many. Chosen; not measured."""
BUDGET = 3.0
"""Nominal seconds of a search's proof: fewer proofs against a faster study. Chosen; not measured."""
_KNOWN = 0.1
"""A coefficient counts as known when its sd is at most this share of its size."""
_NEW = 1_000_000
"""Added to the seed for the motion that is predicted: more than any study has trials."""
_NEW_DURATION = 10.0
"""s, of that motion."""
_RELATIVE_TO_LARGEST = 1e-3
"""Share of the largest parameter: the least size from which the error of a stated parameter is computed."""


@dataclass(frozen=True)
class Scenario:
    """How a log is made and identified.

    Attributes:
        robot: built-in name; with /k, its first k joints.
        noise: of the efforts, relative to each joint's RMS effort.
        duration: s; beyond PERIOD the motion repeats.
        trajectory: "exciting" (condition number optimised) or "random".
        reach: share of the range of positions that the motion may use.
        speed: share of the highest speeds; accelerations take its square.
        encoder: sd of the positions' noise, rad.
        cutoff: of the motion's low-pass, Hz; 0 for the automatic choice.
        prominence: see `bayesid.Preprocessing`.
        threshold: see `bayesid.Preprocessing`.
        search: "certified" or "beam".
        beam_width: of a beam.
        initial_segments: of a beam.
        posterior: whether it is sampled.
        prior_width: factor on a mass scale of 10 kg per link; 1 for the scales of robot and efforts.
        nominal: relative error, and standard deviation, of stated link parameters; 0 for none.
    """

    robot: str = "kr5"
    noise: float = 0.05
    duration: float = 12.0
    trajectory: str = "exciting"
    reach: float = 1.0
    speed: float = 1.0
    encoder: float = 0.0
    cutoff: float = 0.0
    prominence: float = Segmentation().prominence
    threshold: float = Segmentation().threshold
    search: str = "certified"
    beam_width: int = 5
    initial_segments: int = 5
    posterior: bool = False
    prior_width: float = 1.0
    nominal: float = 0.0


@dataclass(frozen=True)
class Truth:
    """A log and its true parameters.

    Attributes:
        model: robot and terms.
        theta: (P,) true parameters.
        effort: (N, n) without noise, with its sign, N m.
        log: to be identified.
    """

    model: Model
    theta: Array
    effort: Array
    log: Log


def trial(scenario: Scenario, seed: int) -> Row:
    """Simulates a log, identifies the robot without its signs, and scores the result."""
    truth = make_truth(scenario, seed)
    result = identify(
        truth.model.robot,
        truth.log,
        STANDARD,
        complete="off",
        search=_search(scenario),
        posterior=Sampling(rng=seed) if scenario.posterior else False,
        preprocessing=Preprocessing(
            cutoff=scenario.cutoff or None, prominence=scenario.prominence, threshold=scenario.threshold
        ),
        prior=_prior(scenario, truth, seed),
    )
    return {**_of_signs(truth, result), **_of_model(truth, result, seed), "timings": result.timings}


def make_truth(scenario: Scenario, seed: int) -> Truth:
    """Simulates a log with random parameters and motion."""
    rng, robot = np.random.default_rng(seed), make_robot(scenario.robot)
    motion = _trajectory(scenario, robot, seed).motion(np.arange(round(scenario.duration * RATE) + 1) / RATE)
    model = Model(robot, make_terms(STANDARD, robot, motion))
    theta = random_parameters(model, rng=rng)
    log = simulate(model, theta, motion, rng=rng, noise=scenario.noise)
    log = replace(log, q=log.q + scenario.encoder * rng.standard_normal(log.q.shape))
    return Truth(model, theta, model.effort(motion, theta), log)


def make_robot(name: str) -> Robot:
    """A built-in robot, or its first joints, as "panda/4"."""
    whole, _, count = name.partition("/")
    robot = load_robot(whole)
    if not count:
        return robot
    if robot.transmission is not None:
        raise ValueError(f"the joints of {whole} are coupled")
    return replace(robot, name=name, joints=robot.joints[: int(count)])


def two_joint_arm() -> Robot:
    """A vertical axis and a horizontal one, links of 0.4 and 0.35 m."""
    rows = ((0.0, np.pi / 2, 0.4), (0.35, 0.0, 0.0))
    joints = [{"a": a, "alpha": alpha, "d": d, "theta": 0.0} for a, alpha, d in rows]
    return robot_from_table({"name": "arm", "convention": "standard", "joints": joints}, "arm")


def _trajectory(scenario: Scenario, robot: Robot, seed: int) -> FourierTrajectory:
    reach, speed = scenario.reach * _REACH, scenario.speed
    limits = MotionLimits(-reach, reach, speed * _VELOCITY, speed**2 * _ACCELERATION)
    periods = max(1, round(scenario.duration / PERIOD))
    if scenario.trajectory == "random":
        return random_trajectory(robot.n_joints, scenario.duration, rng=seed, limits=limits, periods=periods)
    bodies = Model(robot, (RigidBody(),))
    return exciting_trajectory(
        bodies,
        base_coefficients(bodies),
        scenario.duration,
        seed=seed,
        limits=limits,
        periods=periods,
        evaluations=_EVALUATIONS,
    )


def _search(scenario: Scenario) -> Search:
    beam = Beam(width=scenario.beam_width, initial_segments=scenario.initial_segments, budget=np.inf)
    return beam if scenario.search == "beam" else Certified(budget=BUDGET, fallback=beam)


def _prior(scenario: Scenario, truth: Truth, seed: int) -> ParameterPrior:
    usual, nominal = LinkPrior(), _nominal(truth, scenario.nominal, seed)
    if scenario.prior_width == 1.0:
        return ParameterPrior(nominal=nominal)
    return ParameterPrior(link_mass=scenario.prior_width * usual.mass, link_reach=usual.reach, nominal=nominal)


def _nominal(truth: Truth, error: float, seed: int) -> dict[str, tuple[float, float]]:
    """Stated link parameters and their standard deviations, with errors of that size."""
    if not error:
        return {}
    rng = np.random.default_rng([seed, 1])
    sd = error * np.maximum(np.abs(truth.theta), _RELATIVE_TO_LARGEST * np.abs(truth.theta).max())
    values = truth.theta + sd * rng.standard_normal(len(sd))
    bodies = truth.model.cone.bodies.ravel()
    return {truth.model.parameters[k].name: (float(values[k]), float(sd[k])) for k in bodies}


# ---------------------------------------------------------------------------------------------------------------
# Scores
# ---------------------------------------------------------------------------------------------------------------
def _of_signs(truth: Truth, result: Identification) -> Row:
    strong = np.abs(truth.effort) >= STRONG * np.abs(truth.effort).max(axis=0)
    right = result.sample_signs == np.sign(truth.effort)
    joints = np.array([right[strong[:, j], j].mean() for j in range(strong.shape[1])])
    confidence = np.maximum(result.probability, 1.0 - result.probability)
    return {
        "segments": len(result.segments),
        "searched": len(result.search.signs),
        "right": float(right[strong].mean()),
        "joints_flipped": int(np.sum(joints < 0.5)),
        "confidence": float(confidence[strong].mean()),
        "certified": bool(result.search.certified),
        "nodes": int(result.search.nodes),
        "solves": int(result.search.solves),
    }


def _of_model(truth: Truth, result: Identification, seed: int) -> Row:
    error = torque_error(truth, result, seed)
    true, beta, sd = result.coefficients.project(truth.theta), result.beta, result.sd
    low, high = beta - NORMAL_95 * sd, beta + NORMAL_95 * sd
    converged = parameters = None
    if result.posterior is not None:
        low, high = result.posterior.interval(0.95)
        converged = bool(result.posterior.converged)
        off = np.abs(result.theta - truth.theta) <= NORMAL_95 * result.parameter_sd[0]
        parameters = float(off.mean())
    return {
        "condition": float(result.fit.condition),
        "residual": float(np.median(result.fit.relative_residual)),
        "torque_error": float(np.median(error)),
        "torque_error_worst": float(error.max()),
        "coefficients": len(true),
        "known": int(np.sum(sd <= _KNOWN * np.abs(true))),
        "inside": int(np.sum((low <= true) & (true <= high))),
        "parameters_inside": parameters,
        "converged": converged,
        "warnings": len(result.warnings),
    }


def torque_error(truth: Truth, result: Identification, seed: int) -> Array:
    """(n,) relative RMS error of the efforts that the model predicts for a new motion."""
    n = truth.model.robot.n_joints
    trajectory = random_trajectory(n, _NEW_DURATION, rng=seed + _NEW)
    motion: Motion = trajectory.motion(np.arange(0.0, _NEW_DURATION, 1.0 / RATE))
    expected = truth.model.effort(motion, truth.theta)
    error = result.model.effort(motion, result.theta) - expected
    return relative_rms(error, expected, np.ones_like(expected, dtype=bool))
