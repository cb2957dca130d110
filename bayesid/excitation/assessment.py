"""Which coefficients and signs a log's motion leaves undetermined, before anything is identified.

Coefficients and whole joints are judged by the motion alone, for robots that are plausible (`Expectation`): no effort
enters. Segments are judged by the log's own |effort|, equation (2) of `bayesid.excitation.resolvability`, with its RMS
for the size of the noise. Noise and unmodelled effects in it count as effort, so the estimate is optimistic.
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
    plausible_robots,
    groups_of,
    wrong_sign_probability,
    flip_measured_segments,
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
    """What a log's motion shows, at a noise relative to the RMS efforts."""

    model: Model  #: robot and terms
    coefficients: BaseCoefficients  #: the r base coefficients
    source: str  #: of the log
    reach: Array  #: (n,) range of positions of each actuator, rad
    speed: Array  #: (n,) highest speed, rad/s
    acceleration: Array  #: (n,) highest acceleration, rad/s^2
    idle: Array  #: (n,) share of the time at standstill
    doubtful: Array  #: (n,) expected share of each joint's energy with the wrong sign, segments turned one by one

    def __repr__(self) -> str:
        lines = [
            f"ExcitationAssessment of {self.source}: {self.state}, condition number {self.condition:.1f}",
            f"undecided  {len(self.undecided)} of {len(self.coefficients)} coefficients",
            *(f"- {remark}" for remark in self.remarks),
        ]
        return "\n  ".join(lines)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the log leaves undetermined, and which motion determines it."""
        return tuple(_remarks(self))

    @property
    def state(self) -> Literal["good", "look", "bad"]:
        """`bad` if a joint or all its signs are undetermined, `look` if less is, `good` otherwise.

        What no motion can determine does not count.
        """
        if _still(self) or _flippable(self):
            return "bad"
        many = len(self.undecided) > TUNING.most_undetermined * len(self.uncertainty)
        return "look" if many or (self.doubtful > TUNING.doubtful_energy).any() or _idle(self) else "good"


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
    """Assesses what a log's excitation leaves undetermined, without identifying anything.

    Args:
        robot: a robot, a built-in name or a file.
        log: a log, or anything that `bayesid.read_log` reads.
        terms: names of the catalogue, or terms of your own: what is to be identified.
        noise: of the efforts, relative to each joint's RMS effort.
        cutoff: of the motion's low-pass, Hz; from the data by default.
        rng: of the expected robots: a seed, a generator, or None for others each time.

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
    expectation = plausible_robots(model, seed_of(rng))
    speed, n = np.abs(actuators.dq), robot.n_joints
    unsigned = np.flatnonzero(~signals.signed).tolist()
    sums = normal_equations(
        model, expectation.coefficients, signals.motion, signals.effort, segments, most_individual=0
    )
    grams, counts = sums.hessian.by_joint(n), np.bincount(sums.joint, sums.count, n)
    samples, weight = np.maximum(counts, 1).astype(np.int64), min(1.0, TUNING.independent_rate / signals.rate)
    groups = groups_of(unsigned, all_unsigned=len(unsigned) == n)
    sigma = expectation.sigma(grams, samples, noise)
    flips = expectation.joint_flips(grams, sigma, weight, groups) if unsigned else []
    measured = flip_measured_segments(sums.scaled(noise * sums.rms_effort(n)), segments.start, segments.end, weight)
    wrong = np.bincount(
        measured.joint, sums.energy[sums.known == 0] * wrong_sign_probability(measured.resolvability), n
    )
    return ExcitationAssessment(
        model=model,
        coefficients=expectation.coefficients,
        source=log.source,
        noise=noise,
        reach=np.ptp(actuators.q, axis=0),
        speed=speed.max(axis=0),
        acceleration=np.abs(actuators.ddq).max(axis=0),
        idle=np.mean(speed <= actuators.standstill_speed, axis=0),
        condition=condition_of(grams),
        uncertainty=expectation.uncertainty(grams, sigma, weight),
        joints=min(flips, key=lambda one: one.resolvability.min(), default=None),
        segments=measured,
        doubtful=wrong / np.maximum(np.bincount(sums.joint, sums.energy, n), TINY),
    )


# ---- Remarks ----
def _still(assessment: ExcitationAssessment) -> list[int]:
    """0-based actuators that hardly move."""
    return np.flatnonzero((assessment.reach < TUNING.least_range) | (assessment.speed < TUNING.least_speed)).tolist()


def _idle(assessment: ExcitationAssessment) -> list[int]:
    """Other actuators that are often at standstill."""
    return sorted(set(np.flatnonzero(assessment.idle > TUNING.most_standstill).tolist()) - set(_still(assessment)))


def _flippable(assessment: ExcitationAssessment) -> list[tuple[int, ...]]:
    """Minimal groups of other actuators whose signs can all be flipped with hardly a change of the fit."""
    flips, groups = assessment.joints, list[tuple[int, ...]]()
    if flips is None:
        return groups
    for group, chance in zip(flips.groups, wrong_sign_probability(flips.resolvability).tolist(), strict=True):
        if chance > TUNING.wrong_sign and not any(set(smaller) <= set(group) for smaller in groups):
            groups.append(group)
    return [group for group in groups if not set(group) <= set(_still(assessment))]


def _remarks(assessment: ExcitationAssessment) -> Iterator[str]:
    model, coefficients = assessment.model, assessment.coefficients
    for j in _still(assessment):
        unit = "m" if model.robot.joints[j].prismatic else "rad"
        yield (
            f"joint {j + 1} covers {assessment.reach[j]:.2g} {unit} and is never faster than {assessment.speed[j]:.2g} "
            f"{unit}/s: move it over most of its range, fast and slowly"
        )
    for group in _flippable(assessment):
        yield (
            f"flipping all signs of {_joints(group)} hardly changes the fit; only physical feasibility excludes it: "
            "accelerate the joints at the same time, so that they load each other"
        )
    for j in _idle(assessment):
        yield f"joint {j + 1} is at standstill {percent(assessment.idle[j], 0)} of the time: reduce pauses"
    undecided = {coefficients.names[i] for i in assessment.undecided}
    for term in model.terms:
        own = [parameter.name for parameter in term.parameters(model.robot) if parameter.name in undecided]
        if own:
            designs = "`bayesid excite` designs a suitable motion"
            remedy = designs if term.name == "rigid_body" else f"recommended motion: {term.shown_by}"
            kind = term.name.replace("_", " ")
            yield f"undecided at a noise of {percent(assessment.noise, 0)} ({kind}): {', '.join(own)}; {remedy}"
    for j in np.flatnonzero(assessment.doubtful > TUNING.doubtful_energy).tolist():
        yield (
            f"about {percent(assessment.doubtful[j], 0)} of the energy of joint {j + 1} would have the wrong sign, in "
            "segments that are short or weak: use fewer sign changes of the torque, and record longer"
        )
    bodies = model.cone.bodies.ravel().tolist()
    for p in np.flatnonzero(np.abs(coefficients.projection).max(axis=0) > 0.0).tolist():
        if p not in bodies and p not in coefficients.selected:
            others = ", ".join(coefficients.names[i] for i in np.flatnonzero(coefficients.projection[:, p]))
            yield f"{model.parameters[p].name} is identifiable only in combination with {others}"


def _joints(group: tuple[int, ...]) -> str:
    numbers = [str(j + 1) for j in group]
    return f"joint {numbers[0]}" if len(numbers) == 1 else f"joints {', '.join(numbers[:-1])} and {numbers[-1]}"
