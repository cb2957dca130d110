"""Which coefficients and signs a log's motion leaves undetermined, before an identification.

Coefficients and whole joints are assessed by the motion alone, for random robots (`PlausibleRobots`). Segments are
assessed by the log's |effort|, equation (2) of `bayesid.excitation.resolvability`; the noise is relative to its RMS.
Noise and unmodelled effects count as effort, so the estimate is optimistic.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from bayesid.arrays import TINY, Array, seed_of
from bayesid.effects import STANDARD, Term, catalogue
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.excitation.resolvability import (
    Excitation,
    check_noise,
    condition_of,
    flip_measured_segments,
    groups_of,
    plausible_robots,
    wrong_sign_probability,
)
from bayesid.excitation.tuning import TUNING
from bayesid.log.reading import LogSource, as_log
from bayesid.log.segments import find_segments
from bayesid.log.signals import prepare
from bayesid.number_text import percent
from bayesid.parallel import one_blas_thread
from bayesid.regression.normal_equations import normal_equations
from bayesid.robot import Robot, check_joints, load_robot


@dataclass(frozen=True, kw_only=True)
class ExcitationAssessment(Excitation):
    """Excitation of a log's motion."""

    model: Model  #: robot and terms
    coefficients: BaseCoefficients  #: the r base coefficients
    source: str  #: name of the log
    reach: Array  #: (n,) range of positions of each actuator, rad
    speed: Array  #: (n,) highest speed, rad/s
    acceleration: Array  #: (n,) highest acceleration, rad/s^2
    idle: Array  #: (n,) share of the time at standstill
    doubtful: Array  #: (n,) expected share of each joint's energy with the wrong sign, segments flipped one by one

    def __repr__(self) -> str:
        lines = [
            f"ExcitationAssessment of {self.source}: {self.state}, condition number {self.condition:.1f}",
            f"undetermined  {len(self.undecided)} of {len(self.coefficients)} coefficients",
            *(f"- {remark}" for remark in self.remarks),
        ]
        return "\n  ".join(lines)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the log leaves undetermined, and which motion determines it."""
        return tuple(_remarks(self))

    @property
    def state(self) -> Literal["good", "look", "bad"]:
        """`bad` if a joint or all its signs are undetermined, else `look` or `good`.

        `look`: many coefficients are undetermined, signs are doubtful, or a joint is often at standstill.
        """
        if _hardly_moving(self) or _flippable(self):
            return "bad"
        many = len(self.undecided) > TUNING.most_undetermined * len(self.uncertainty)
        return "look" if many or (self.doubtful > TUNING.doubtful_energy).any() or _often_still(self) else "good"


@one_blas_thread
def assess_excitation(
    robot: Robot | str | Path,
    log: LogSource,
    terms: Iterable[str | Term] = STANDARD,
    *,
    noise: float = 0.05,
    cutoff: float | None = None,
    rng: np.random.Generator | int | None = 0,
) -> ExcitationAssessment:
    """Assesses which coefficients and signs a log's motion leaves undetermined, without an identification.

    Args:
        robot: a robot, a built-in name or a file.
        log: a log, or anything that `bayesid.read_log` reads.
        terms: effects to be identified, names of the catalogue or terms of your own.
        noise: of the efforts, relative to each joint's RMS effort.
        cutoff: of the low-pass on positions, Hz; by default estimated from the log.
        rng: of the plausible robots: a seed, a generator, or None for a random seed.

    Raises:
        InputError: the robot, the log or an option cannot be used.

    Example:
        >>> assessment = bayesid.assess_excitation("robot.toml", "log.csv", terms)
        >>> assessment.state, round(assessment.condition)
        ('good', 11)
    """
    check_noise(noise)
    robot = robot if isinstance(robot, Robot) else load_robot(robot)
    log = as_log(log, robot)
    check_joints(robot, log.n_joints, log.source)
    signals = prepare(log, cutoff)
    actuators = robot.actuators(signals.motion)
    segments = find_segments(signals, actuators)
    segments = segments[segments.fitted]
    if not len(segments):
        raise InputError("no joint moves", log.source, "record a motion in which every joint moves")
    model = Model(robot, catalogue.make_terms(terms, robot, signals.motion))
    robots = plausible_robots(model, seed_of(rng))
    speed, n = np.abs(actuators.dq), robot.n_joints
    unsigned = np.flatnonzero(~signals.signed).tolist()
    sums = normal_equations(model, robots.coefficients, signals.motion, signals.effort, segments, most_individual=0)
    grams, counts = sums.hessian.by_joint(n), np.bincount(sums.joint, sums.count, n)
    samples, weight = np.maximum(counts, 1).astype(np.int64), min(1.0, TUNING.independent_rate / signals.rate)
    groups = groups_of(unsigned, all_unsigned=len(unsigned) == n)
    sigma = robots.sigma(grams, samples, noise)
    flips = robots.joint_flips(grams, sigma, weight, groups) if unsigned else []
    measured = flip_measured_segments(sums.scaled(noise * sums.rms_effort(n)), segments.start, segments.end, weight)
    wrong = np.bincount(
        measured.joint, sums.energy[sums.known == 0] * wrong_sign_probability(measured.resolvability), n
    )
    return ExcitationAssessment(
        model=model,
        coefficients=robots.coefficients,
        source=log.source,
        noise=noise,
        reach=np.ptp(actuators.q, axis=0),
        speed=speed.max(axis=0),
        acceleration=np.abs(actuators.ddq).max(axis=0),
        idle=np.mean(speed <= actuators.standstill_speed, axis=0),
        condition=condition_of(grams),
        uncertainty=robots.uncertainty(grams, sigma, weight),
        joints=min(flips, key=lambda groups: groups.resolvability.min(), default=None),
        segments=measured,
        doubtful=wrong / np.maximum(np.bincount(sums.joint, sums.energy, n), TINY),
    )


# ---- Remarks ----
def _hardly_moving(assessment: ExcitationAssessment) -> list[int]:
    """0-based actuators that hardly move."""
    return np.flatnonzero((assessment.reach < TUNING.least_range) | (assessment.speed < TUNING.least_speed)).tolist()


def _often_still(assessment: ExcitationAssessment) -> list[int]:
    """Other 0-based actuators that are often at standstill."""
    return sorted(
        set(np.flatnonzero(assessment.idle > TUNING.most_standstill).tolist()) - set(_hardly_moving(assessment))
    )


def _flippable(assessment: ExcitationAssessment) -> list[tuple[int, ...]]:
    """Minimal groups of other actuators for which flipping all signs hardly changes the fit."""
    flips, groups = assessment.joints, list[tuple[int, ...]]()
    if flips is None:
        return groups
    for group, chance in zip(flips.groups, wrong_sign_probability(flips.resolvability).tolist(), strict=True):
        if chance > TUNING.wrong_sign and not any(set(smaller) <= set(group) for smaller in groups):
            groups.append(group)
    return [group for group in groups if not set(group) <= set(_hardly_moving(assessment))]


def _remarks(assessment: ExcitationAssessment) -> Iterator[str]:
    model, coefficients = assessment.model, assessment.coefficients
    for j in _hardly_moving(assessment):
        unit = "m" if model.robot.joints[j].prismatic else "rad"
        yield (
            f"joint {j + 1} covers {assessment.reach[j]:.2g} {unit} and is never faster than {assessment.speed[j]:.2g} "
            f"{unit}/s: move it over most of its range, fast and slowly"
        )
    for group in _flippable(assessment):
        yield (
            f"flipping all signs of {_joints(group)} hardly changes the fit; only physical feasibility excludes it: "
            "accelerate all joints at the same time, so that each loads the others"
        )
    for j in _often_still(assessment):
        yield f"joint {j + 1} is at standstill {percent(assessment.idle[j], 0)} of the time: reduce pauses"
    undetermined = {coefficients.names[i] for i in assessment.undecided}
    for term in model.terms:
        names = [parameter.name for parameter in term.parameters(model.robot) if parameter.name in undetermined]
        if names:
            designs = "`bayesid excite` designs a suitable motion"
            remedy = designs if term.name == "rigid_body" else f"recommended motion: {term.shown_by}"
            kind = term.name.replace("_", " ")
            yield f"undetermined at a noise of {percent(assessment.noise, 0)} ({kind}): {', '.join(names)}; {remedy}"
    for j in np.flatnonzero(assessment.doubtful > TUNING.doubtful_energy).tolist():
        yield (
            f"about {percent(assessment.doubtful[j], 0)} of the energy of joint {j + 1} is expected to get the wrong "
            "sign, in short or weak segments: move so that the torque changes its sign less often, and record longer"
        )
    bodies = model.cone.bodies.ravel().tolist()
    for p in np.flatnonzero(np.abs(coefficients.projection).max(axis=0) > 0.0).tolist():
        if p not in bodies and p not in coefficients.selected:
            others = ", ".join(coefficients.names[i] for i in np.flatnonzero(coefficients.projection[:, p]))
            yield f"{model.parameters[p].name} is identifiable only in combination with {others}"


def _joints(group: tuple[int, ...]) -> str:
    numbers = [str(j + 1) for j in group]
    return f"joint {numbers[0]}" if len(numbers) == 1 else f"joints {', '.join(numbers[:-1])} and {numbers[-1]}"
