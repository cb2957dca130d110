"""Does a designed motion determine what a result leaves open, as predicted? Simulated logs.

Coefficients: robots with random parameters and the standard friction; sensor noise of 5 % of the RMS effort of a random
motion. In the first log of 10 s one inner joint hardly moves. A motion is designed for the open coefficients, within
limits of positions, velocities, accelerations, jerks and efforts. The robot runs it, a random motion, and the first one
again, and is identified from the first log together with each of the three. The report gives open coefficients before
and after, standard deviations over predicted ones, errors over standard deviations, and whether the true robot keeps
its limits.

Hypotheses: an effect is hidden in a joint that hardly moves in a short log, so that other effects explain the log as
well (`bayesid.find_discrepancy`). A motion is designed to discriminate between them. The robot runs it, or a random
one, and both logs together are explained again. The effect is discriminated if it is named, has no equivalents, and has
a decisive Bayes factor against each of its former equivalents.

A design tries about half the default number of changes (`TUNING.coefficient_changes`,
`TUNING.hypothesis_changes`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array
from bayesid.discrepancy.workflow import Discrepancy, explain_log
from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.excitation.next_motion import NextExperiment, design_next
from bayesid.excitation.settings import MotionSettings
from bayesid.excitation.splines import largest_efforts
from bayesid.excitation.tuning import TUNING
from bayesid.identification.identification import KNOWN, Identification
from bayesid.identification.pipeline import QUICK, identify
from bayesid.log.log import Log, join_logs
from bayesid.motion import Motion
from bayesid.posterior.sampler import Sampling
from bayesid.regression.selection.added_effect import AddedEffect
from bayesid.regression.selection.fitted_effects import LN10
from bayesid.regression.selection.hypotheses import EffectKey
from bayesid.robot import Robot, robot_from_table
from bayesid.signs.search.certified import Certified
from bayesid.simulation.logs import SimulatedEffect, simulate, with_effects
from bayesid.simulation.parameters import random_parameters, rms
from bayesid.simulation.trajectories import MotionLimits, random_trajectory
from bayesid.studies.next_motion_report import ARM, COEFFICIENTS, EFFECTS, HYPOTHESES, ROBOTS, draw, report
from bayesid.studies.record import Row
from bayesid.studies.simulated import BUDGET, STRONG, make_robot
from bayesid.studies.study import Study, in_turn, mixed

CHANGES, TELLING_CHANGES = 1500, 500
"""About half the defaults: shorter designs against slightly better ones. Chosen; not measured."""
_RATE, _DURATION = 100.0, 10.0
"""Hz, and s of each log of a coefficients' trial."""
_SENSOR, _FINER = 0.05, 0.03
"""Noise over the RMS effort of a random motion: in trials of coefficients, and of hypotheses."""
_USUAL = MotionLimits(jerk=150.0)
"""rad/s^3, typical of small arms; above what five harmonics in 10 s need."""
_STRONGER = 1.5
"""Effort limits over the largest |effort| of a random motion."""
_STILL = (0.05, 0.2)
"""rad to either side and rad/s of the joint that hardly moves in the first log."""
_NEAR = (0.8, 1.25)
"""Ratio of achieved to predicted standard deviations that counts as predicted. Chosen; not measured."""
_FINE = 1e-3
"""s between checks of the limits: a fiftieth of the step of the design."""
_TOUCH = 1e-5
"""Relative tolerance at the limits: rounding of a third difference over (1 ms)^3."""
_ANOTHER = 4_000_000
"""Added to the seed for the random motion that the designed one is compared with."""
_LEARNED, _SHORT = 12.0, 5.0
"""s of the healthy log, and of the two logs with an effect."""
_LITTLE = (0.25, 0.5)
"""rad to either side and rad/s of the joint with an effect, in the first of these."""
_TRIES = 4
"""Joints, sizes and motions of the short log that are tried until one is ambiguous."""
_JOINTS = 7
"""Of a random arm."""

_SIZES = (0.03, 0.12)
"""RMS of an effect over that of its joint's effort: one to four times the noise."""


@dataclass(frozen=True)
class Scenario:
    """What a trial leaves open.

    Attributes:
        part: "coefficients" or "hypotheses".
        robot: built-in name, or "arm" for a random one.
        effect: hidden effect; empty for none.
        limited: whether efforts are limited.
        changes: number of changes that a design tries.
    """

    part: str
    robot: str
    effect: str = ""
    limited: bool = True
    changes: int = CHANGES


SCENARIOS = mixed(
    [
        [Scenario(COEFFICIENTS, robot, limited=limited) for robot in ROBOTS for limited in (True, False)],
        [
            Scenario(HYPOTHESES, robot, effect, changes=TELLING_CHANGES)
            for effect in EFFECTS
            for robot in ("kr5", "ur10e")
        ],
    ]
)


@dataclass(frozen=True)
class _Truth:
    """The true robot.

    Attributes:
        model: robot and terms.
        theta: (P,) its parameters.
        sensor: (n,) N m, sd of the noise of its efforts.
        limits: of its joints.
    """

    model: Model
    theta: Array
    sensor: Array
    limits: MotionLimits

    def log(self, motion: Motion, seed: int) -> Log:
        """The recorded log of a motion."""
        return simulate(self.model, self.theta, motion, rng=np.random.default_rng(seed), sensor=self.sensor)


def trial(scenario: Scenario, seed: int) -> Row:
    """One robot and one design; both parts have the same columns."""
    row = _of_coefficients(scenario, seed) if scenario.part == COEFFICIENTS else _of_hypotheses(scenario, seed)
    return {**dict.fromkeys(_COLUMNS), **row}


def _robot(name: str, seed: int) -> Robot:
    return random_arm(seed) if name == ARM else make_robot(name)


def _truth(robot: Robot, seed: int, noise: float, *, limited: bool = True) -> _Truth:
    usual = _random(robot.n_joints, _DURATION, seed)
    model = Model(robot, make_terms(STANDARD, robot, usual))
    theta = random_parameters(model, rng=np.random.default_rng(seed))
    effort = model.effort(usual, theta)
    largest = tuple((_STRONGER * np.abs(effort).max(axis=0)).tolist())
    return _Truth(model, theta, noise * rms(effort), replace(_USUAL, effort=largest) if limited else _USUAL)


def random_arm(seed: int) -> Robot:
    """Seven joints, each perpendicular to the one before; links of 0.2 to 0.45 m along or across the axis."""
    rng = np.random.default_rng([seed, 9])
    rows = []
    for j in range(_JOINTS):
        along, across = rng.uniform(0.2, 0.45), rng.uniform(0.0, 0.1)
        a, d = (across, along) if j % 2 == 0 else (along if rng.random() < 0.5 else across, 0.0)
        alpha = float(rng.choice([-0.5, 0.5]) * np.pi)
        rows.append({"a": float(a), "alpha": alpha, "d": float(d), "theta": float(rng.uniform(-np.pi, np.pi))})
    table = {"name": ARM, "convention": "standard", "gravity": [0.0, 0.0, -9.81], "joints": rows}
    return robot_from_table(table, ARM)


def _random(n: int, duration: float, seed: int, still: int | None = None, most: tuple[float, float] = _STILL) -> Motion:
    """A random motion; the joint `still` moves at most `most` (rad to either side, rad/s)."""
    lower, upper, velocity = np.full(n, _USUAL.lower), np.full(n, _USUAL.upper), np.full(n, _USUAL.velocity)
    if still is not None:
        lower[still], upper[still], velocity[still] = -most[0], most[0], most[1]
    limits = replace(
        _USUAL, lower=tuple(lower.tolist()), upper=tuple(upper.tolist()), velocity=tuple(velocity.tolist())
    )
    t = np.arange(round(duration * _RATE) + 1) / _RATE
    return random_trajectory(n, duration, rng=seed, limits=limits).motion(t)


# ---------------------------------------------------------------------------------------------------------------
# Coefficients
# ---------------------------------------------------------------------------------------------------------------
def _of_coefficients(scenario: Scenario, seed: int) -> Row:
    robot = _robot(scenario.robot, seed)
    n = robot.n_joints
    still = int(np.random.default_rng([seed, 1]).integers(1, n - 1))
    first = _random(n, _DURATION, seed, still)
    truth = _truth(robot, seed, _SENSOR, limited=scenario.limited)
    log = truth.log(first, seed)
    now = _identified(truth, log, seed)
    run = MotionSettings(duration=_DURATION, rate=_RATE, limits=truth.limits, changes=scenario.changes)
    design = design_next(now, settings=run)
    motions = {"designed": design.motion, "random": _random(n, _DURATION, seed + _ANOTHER), "repeat": first}
    logs = {name: join_logs([log, truth.log(motion, seed + _ANOTHER)]) for name, motion in motions.items()}
    results = {name: _identified(truth, both, seed) for name, both in logs.items()}
    after: Row = {}
    for name, result in results.items():
        effort = np.vstack([truth.model.effort(motion, truth.theta) for motion in (first, motions[name])])
        after |= {
            f"open_{name}": _open(result),
            f"error_{name}": _error(truth, result),
            f"right_{name}": _right(result, logs[name].t, effort),
        }
    return {
        "coefficients": len(now.beta),
        "open_now": _open(now),
        "open_predicted": design.predicted.open,
        "open_lacking": design.predicted.open_lacking,
        **after,
        **_ratios(design, results["designed"]),
        **kept_limits(truth, design),
        "random_allowed": _allowed(design, motions["random"]),
        "timings": {"design": design.seconds},
    }


def _allowed(design: NextExperiment, motion: Motion) -> bool | None:
    """Whether a motion certainly keeps the limits of efforts, by the result; None without limits."""
    if not design.feasibility.has_effort_limits:
        return None
    return bool((largest_efforts(*design.feasibility.effort_band(motion)) <= design.feasibility.effort).all())


def _identified(truth: _Truth, log: Log, seed: int) -> Identification:
    return identify(
        truth.model.robot,
        log,
        truth.model.terms,
        complete="only-uncertainty",
        search=Certified(budget=BUDGET),
        posterior=Sampling(rng=seed),
    )


def _open(result: Identification) -> int:
    return int(np.sum(result.sd > KNOWN * np.abs(result.beta)))


def _error(truth: _Truth, result: Identification) -> float:
    """RMS over the coefficients of errors over standard deviations."""
    error = (result.beta - result.coefficients.project(truth.theta)) / result.sd
    return float(np.sqrt(np.mean(error**2)))


def _right(result: Identification, t: Array, effort: Array) -> float:
    """Share of strong samples whose sign is right, from true efforts (N, n) at times t (N,).

    The result also has samples in the pause between two logs.
    """
    strong = np.abs(effort) >= STRONG * np.abs(effort).max(axis=0)
    rows = np.searchsorted(result.signals.motion.t, t - 0.5 / _RATE)
    return float((result.sample_signs[rows] == np.sign(effort))[strong].mean())


def _ratios(design: NextExperiment, result: Identification) -> Row:
    """Counts of achieved standard deviations near and above the predicted ones, matched by name."""
    assert result.posterior is not None
    predicted = design.predicted
    places = [predicted.names.index(name) for name in result.coefficients.names]
    sd, lacking = predicted.sd[places], predicted.sd_lacking[places]
    noise = np.sqrt(np.diag(result.posterior.covariance_of_log)) / sd
    low, high = _NEAR
    return {
        "noise_near": int(np.sum((noise >= low) & (noise <= high))),
        "noise_above": int(np.sum(noise > high)),
        "noise_median": float(np.median(noise)),
        "total_between": int(np.sum((result.sd >= low * sd) & (result.sd <= high * lacking))),
        "total_above": int(np.sum(result.sd > high * lacking)),
        "total_near": int(np.sum((result.sd >= low * sd) & (result.sd <= high * sd))),
    }


def kept_limits(truth: _Truth, design: NextExperiment) -> Row:
    """Whether the true robot keeps its limits at every ms of the motion, and its largest share of an effort limit.

    Derivatives are differences of positions: means of the true derivatives, so not larger.
    """
    count = round(design.trajectory.duration / _FINE) + 1
    motion = design.trajectory.motion(np.linspace(0.0, design.trajectory.duration, count))
    limits = design.limits
    assert limits is not None
    assert limits.jerk is not None
    lower, upper = np.asarray(limits.lower), np.asarray(limits.upper)
    shares = [np.abs(motion.q - 0.5 * (upper + lower)) / (0.5 * (upper - lower))]
    for order, limit in enumerate((limits.velocity, limits.acceleration, limits.jerk), start=1):
        shares.append(np.abs(np.diff(motion.q, order, axis=0)) / _FINE**order / np.asarray(limit))
    largest = [float(share.max()) for share in shares]
    kept: Row = {"motion_held": max(largest) <= 1.0 + _TOUCH}
    if limits.effort is None:
        return kept
    effort = float((np.abs(truth.model.effort(motion, truth.theta)) / np.asarray(limits.effort)).max())
    return {**kept, "effort_held": effort <= 1.0, "effort_share": effort}


# ---------------------------------------------------------------------------------------------------------------
# Hypotheses
# ---------------------------------------------------------------------------------------------------------------
def _of_hypotheses(scenario: Scenario, seed: int) -> Row:
    healthy = _truth(_robot(scenario.robot, seed), seed, _FINER, limited=scenario.limited)
    learned = _random(healthy.model.robot.n_joints, _LEARNED, seed)
    search = Certified(budget=BUDGET)
    known = identify(
        healthy.model.robot, healthy.log(learned, seed), STANDARD, complete="off", search=search, posterior=False
    )
    for k in range(1, _TRIES + 1):
        truth, key = _with_effect(healthy, learned, scenario.effect, seed, k)
        still = _random(healthy.model.robot.n_joints, _SHORT, seed + k * _ANOTHER, key[1][0] - 1, _LITTLE)
        log = truth.log(still, seed + k)
        found = _found(known, log)
        competing = _equivalents(found, key)
        if competing:
            break
    else:
        return {"ambiguous": False}
    run = MotionSettings(duration=_SHORT, rate=_RATE, limits=truth.limits, changes=scenario.changes)
    design = design_next(found, settings=run)
    random = _random(healthy.model.robot.n_joints, _SHORT, seed - 1 + _ANOTHER)
    after: Row = {}
    for name, motion in {"designed": design.motion, "random": random}.items():
        again = _found(known, join_logs([log, truth.log(motion, seed + _ANOTHER)]))
        after |= {f"{what}_{name}": value for what, value in _discriminated(again, key, competing).items()}
    factors = design.predicted.log10_bayes_factors
    expected = [factors[_name(key), _name((effect, key[1]))] for effect in competing]
    return {
        "joint": key[1][0],
        "ambiguous": True,
        "equivalents": ",".join(competing),
        **after,
        "expected": float(np.min(expected)),
        **kept_limits(truth, design),
        "timings": {"design": design.seconds},
    }


def _with_effect(healthy: _Truth, motion: Motion, effect: str, seed: int, attempt: int) -> tuple[_Truth, EffectKey]:
    """The robot with an effect in a random joint, of a random size on a motion."""
    rng = np.random.default_rng([seed, 2, attempt])
    joint = int(rng.integers(1, healthy.model.robot.n_joints + 1))
    level = float(np.exp(rng.uniform(*np.log(_SIZES))))
    hidden = [SimulatedEffect(effect, joint, level)]
    model, theta = with_effects(healthy.model, healthy.theta, motion, hidden, seed)
    return replace(healthy, model=model, theta=theta), (effect, (joint,))


def _found(known: Identification, log: Log) -> Discrepancy:
    return explain_log(known, log, search=QUICK, posterior=False)


def _equivalents(found: Discrepancy, key: EffectKey) -> tuple[str, ...]:
    """Effects that the log cannot distinguish from the hidden one; none if that is not among the named ones."""
    effect, joints = key
    for added in found.added:
        named = {added.effect, *added.equivalent}
        if added.joints == joints and effect in named and added.equivalent:
            return tuple(sorted(named - {effect}))
    return ()


def _discriminated(found: Discrepancy, key: EffectKey, competing: Sequence[str]) -> Row:
    """Whether the hidden effect is named and discriminated, and its log10 Bayes factor."""
    named = next((added for added in found.added if added.hypothesis.key == key), None)
    weighed = named or next(
        (added for added in found.added if added.effect in competing and added.joints == key[1]), None
    )
    factor = None if weighed is None else _factor(weighed, key, competing)
    discriminated = (
        named is not None
        and not set(named.equivalent) & set(competing)
        and factor is not None
        and factor >= TUNING.decisive
    )
    return {"named": named is not None, "factor": factor, "discriminated": discriminated}


def _factor(weighed: AddedEffect, key: EffectKey, competing: Sequence[str]) -> float | None:
    """Log10 Bayes factor of an effect against its likeliest competitor; those without a score are far less likely."""
    gains = {score.key: score.gain for score in weighed.competing}
    others = [gains[effect, key[1]] for effect in competing if (effect, key[1]) in gains]
    if key not in gains or not others:
        return None
    return float((gains[key] - max(others)) / LN10)


def _name(key: EffectKey) -> str:
    """The name of a hypothesis in predictions."""
    effect, joints = key
    return ":".join([effect, *map(str, joints)])


_COLUMNS = (
    *("coefficients", "open_now", "open_predicted", "open_lacking"),
    *(f"{what}_{name}" for name in ("designed", "random", "repeat") for what in ("open", "error", "right")),
    *("noise_near", "noise_above", "noise_median", "total_between", "total_above", "total_near"),
    *("joint", "ambiguous", "equivalents"),
    *(f"{what}_{name}" for name in ("designed", "random") for what in ("named", "factor", "discriminated")),
    *("expected", "motion_held", "effort_held", "effort_share", "random_allowed"),
)


STUDY = Study("next_motion", 56, in_turn(SCENARIOS), trial, report, draw)
