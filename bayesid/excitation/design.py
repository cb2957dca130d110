"""Design of a motion that shows coefficients, for a controller to play, before anything is known of the robot.

Every joint follows a Fourier series within its limits that starts and ends at rest. Its shape minimises the condition
number of the base regressor with columns of unit length (:eq:`condition-number`), the amplification of noise into
coefficients. The result says how far signs are resolved, too, but is not designed for that: over 97 pairs of logs a
design for signs gave as many right ones as this one (`bayesid.studies.benchmarks.excitation` has what stands of it).

Collisions of the robot with itself or its surroundings, and limits of its efforts, are not checked here; a motion for a
result keeps them (`bayesid.excitation.next_motion`).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy

from bayesid.arrays import Array, Mask
from bayesid.effects import STANDARD, Term, catalogue
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.excitation.expectation import Expectation, check_noise, expect, undecided
from bayesid.excitation.limits import check_limits
from bayesid.excitation.resolvability import (
    INDEPENDENT,
    WRONG,
    JointFlips,
    SegmentFlips,
    expected_noise,
    groups_of,
    joint_grams,
    mistaken,
    noise_tolerance,
    turn_segments,
)
from bayesid.motion import Motion
from bayesid.parallel import one_blas_thread
from bayesid.progress import SILENT, Progress
from bayesid.regression.knowledge import Beliefs
from bayesid.robot import Robot, load_robot
from bayesid.simulation.trajectories import (
    HARMONICS,
    FourierTrajectory,
    MotionLimits,
    condition_number,
    from_rest,
    instants,
    log_condition_of,
    random_shape,
    within_limits,
)

_DRAWS = 20
"""Random shapes, the best of which is the start; a round number, not studied."""
_TOLERANCE = 1e-3
"""Of the objective, a logarithm, at which SLSQP ends: a thousandth of a condition number."""
_JUDGED = 2000
"""Instants, at most, at which a finished motion is judged: 400 a period of the highest of five harmonics."""
_DURATIONS = 0.5, 3600.0
"""s; from shortest to longest: a joint needs time to move, and no identification needs an hour."""
_HARMONICS = 2, 20
"""From fewest to most: one alone cannot start and end at rest, and more give steps of acceleration."""
_MOST_SAMPLES = 1_000_000
"""Of a file that a controller reads."""
_OVERSAMPLING = 4.0
"""Samples in the period of the highest harmonic at least: twice the Nyquist rate."""


@dataclass(frozen=True, kw_only=True)
class TrajectoryShape:
    """What is given of a motion before its shape is designed.

    Attributes:
        duration: of the whole motion, s.
        rate: of the samples, Hz; rounded so that a whole number of them fits the duration.
        harmonics: sines and cosines a joint, at least 2.
        periods: whole number of periods in the duration.

    Example:
        >>> shape = bayesid.TrajectoryShape(duration=10.0, rate=50.0, harmonics=3, periods=2)
        >>> shape.frequency, len(shape.instants)
        (0.2, 501)
    """

    duration: float = 20.0
    rate: float = 100.0
    harmonics: int = HARMONICS
    periods: int = 1

    def __post_init__(self) -> None:
        shortest, longest = _DURATIONS
        if not shortest <= self.duration <= longest:
            remedy = f"give {shortest:g} to {longest:g} s"
            raise InputError(f"{self.duration:g} s cannot be used", field="TrajectoryShape.duration", remedy=remedy)
        fewest, most = _HARMONICS
        if not fewest <= self.harmonics <= most:
            remedy = f"give {fewest} to {most}: one alone cannot start and end at rest"
            raise InputError(
                f"{self.harmonics} harmonics cannot be used", field="TrajectoryShape.harmonics", remedy=remedy
            )
        if self.periods < 1:
            raise InputError(
                f"{self.periods} periods cannot be used", field="TrajectoryShape.periods", remedy="give 1 or more"
            )
        slowest, fastest = _OVERSAMPLING * self.harmonics * self.periods / self.duration, _MOST_SAMPLES / self.duration
        if not slowest <= self.rate <= fastest:
            remedy = f"give {slowest:.3g} Hz, twice the Nyquist rate of the highest harmonic, to {fastest:.3g} Hz"
            raise InputError(f"{self.rate:g} Hz cannot be used", field="TrajectoryShape.rate", remedy=remedy)

    @property
    def frequency(self) -> float:
        """The fundamental, Hz.

        Example:
            >>> bayesid.TrajectoryShape(duration=10.0, periods=2).frequency
            0.2
        """
        return self.periods / self.duration

    @property
    def instants(self) -> Array:
        """(N,) of the samples, s.

        Example:
            >>> float(bayesid.TrajectoryShape(duration=10.0, rate=50.0).instants[-1])
            10.0
        """
        return np.linspace(0.0, self.duration, round(self.duration * self.rate) + 1)


@dataclass(frozen=True, kw_only=True)
class Objective:
    """What a design aims at.

    Attributes:
        noise: of the efforts, relative to each joint's RMS effort, at which the result is judged.
        evaluations: of the condition number, about; 6000 take about ten seconds for six joints.

    Example:
        >>> objective = bayesid.Objective(evaluations=50)  # a short search
        >>> design = bayesid.design_excitation(robot, terms, objective=objective)
        >>> design.reached.condition < design.start.condition
        True
    """

    noise: float = 0.05
    evaluations: int = 6000

    def __post_init__(self) -> None:
        check_noise(self.noise)


@dataclass(frozen=True)
class Quality:
    """What a motion is worth, at one noise.

    Attributes:
        condition: condition number of the base regressor.
        tolerance: noise, relative to the RMS efforts, that the signs bear, for the hardest of the expected robots.
        joints: groups of joints that may be turned, for the robot for which the easiest one is easiest to mistake.
        segments: those of that robot, and what turning them weighs.
        effort: (N, n) that robot's efforts, N m.
        uncertainty: (r,) standard deviation of each coefficient after a log of this motion, signs given, over its usual
            size.
        noise: relative to the RMS efforts, at which all this is meant.
    """

    condition: float
    tolerance: float
    joints: JointFlips
    segments: SegmentFlips
    effort: Array
    uncertainty: Array
    noise: float

    @property
    def magnitude(self) -> Array:
        """(N, n) |effort|, N m: all that is seen of it."""
        return np.abs(self.effort)

    @property
    def weak(self) -> Mask:
        """(S,) segments whose sign is more likely wrong than a tenth of the energy's is, at the noise tolerance."""
        weak: Mask = mistaken(self.segments.resolvability * (self.noise / self.tolerance) ** 2) > WRONG
        return weak


@dataclass(frozen=True)
class ExcitationDesign:
    """A motion to be played.

    Attributes:
        model: robot and terms.
        coefficients: the r base coefficients that it is to show.
        trajectory: the motion as a Fourier series.
        motion: N samples of it, from rest to rest.
        rate: of these, Hz.
        periods: that it holds.
        limits: of each joint.
        start: the best of some random motions.
        reached: what the design has made of it.

    Example:
        >>> design = bayesid.design_excitation(robot, terms, objective=bayesid.Objective(evaluations=50))
        >>> design.reached.condition < design.start.condition
        True
    """

    model: Model
    coefficients: BaseCoefficients
    trajectory: FourierTrajectory
    motion: Motion
    rate: float
    periods: int
    limits: MotionLimits
    start: Quality
    reached: Quality

    def __repr__(self) -> str:
        lines = [
            f"ExcitationDesign for {self.model.robot.name}: {len(self.motion)} instants at {self.rate:g} Hz",
            f"condition number  {self.start.condition:.1f} at the start, {self.reached.condition:.1f} now",
            f"undecided         {len(self.undecided)} of {len(self.coefficients)} coefficients",
            "go on with        .motion, bayesid.save_design(this, folder)",
        ]
        return "\n  ".join(lines)

    @property
    def of_limits(self) -> Motion:
        """Positions from -1 at the lower to 1 at the upper limit, velocities and accelerations as shares of theirs.

        Example:
            >>> bool(np.abs(design.of_limits.dq).max() <= 1.0)
            True
        """
        lower, upper = np.asarray(self.limits.lower), np.asarray(self.limits.upper)
        motion, centred = self.motion, 2.0 * self.motion.q - lower - upper
        dq, ddq = motion.dq / np.asarray(self.limits.velocity), motion.ddq / np.asarray(self.limits.acceleration)
        return replace(motion, q=centred / (upper - lower), dq=dq, ddq=ddq)

    @property
    def undecided(self) -> tuple[int, ...]:
        """Coefficients that a log of this motion leaves undecided.

        Example:
            >>> [design.coefficients.names[k] for k in design.undecided]
            ['J2xy', 'J2yz', 'J3yz']
        """
        return undecided(self.reached.uncertainty)

    @property
    def noise(self) -> float:
        """Relative to the RMS efforts, at which the motion is judged.

        Example:
            >>> design.noise
            0.05
        """
        return self.reached.noise


@one_blas_thread
def design_excitation(
    robot: Robot | str | Path,
    terms: Iterable[str | Term] = STANDARD,
    *,
    shape: TrajectoryShape = TrajectoryShape(),
    limits: MotionLimits | None = None,
    objective: Objective = Objective(),
    beliefs: Beliefs = Beliefs(),
    seed: int = 0,
    progress: Progress = SILENT,
) -> ExcitationDesign:
    """Designs a periodic motion from rest to rest that shows coefficients and signs.

    Args:
        robot: a robot, a built-in name or a file.
        terms: names of the catalogue, or terms of your own: what is to be identified.
        shape: duration, rate, harmonics and periods.
        limits: of the joints; they hold at every instant. By default those that suit most small arms.
        objective: what the design aims at.
        beliefs: parameters that are known beforehand (CAD); others are drawn.
        seed: of the random starts and of the expected robots.
        progress: of the design.

    Raises:
        InputError: the robot, the limits or an option cannot be used.

    Example:
        >>> shape = bayesid.TrajectoryShape(duration=5.0, harmonics=2)
        >>> design = bayesid.design_excitation(robot, terms, shape=shape, objective=bayesid.Objective(evaluations=50))
        >>> design.motion.q.shape
        (501, 3)
    """
    robot = robot if isinstance(robot, Robot) else load_robot(robot)
    limits = check_limits(limits, robot)
    model = Model(robot, catalogue.make_terms(terms, robot, _fastest(limits)))
    expectation = expect(model, seed, beliefs)
    start, best = _optimised(expectation, shape, limits, objective, seed, progress)
    t = shape.instants
    motion = best.motion(t)
    return ExcitationDesign(
        model=model,
        coefficients=expectation.coefficients,
        trajectory=best,
        motion=motion,
        rate=(len(t) - 1) / shape.duration,
        periods=shape.periods,
        limits=limits,
        start=quality(expectation, start.motion(t), objective.noise),
        reached=quality(expectation, motion, objective.noise),
    )


def _optimised(
    expectation: Expectation,
    shape: TrajectoryShape,
    limits: MotionLimits,
    objective: Objective,
    seed: int,
    progress: Progress,
) -> tuple[FourierTrajectory, FourierTrajectory]:
    """The best of some random trajectories, and what the optimisation makes of it."""
    n, total = expectation.model.robot.n_joints, objective.evaluations
    count = instants(shape.harmonics)
    grid = np.arange(count) / count / shape.frequency
    calls = itertools.count(1)

    def trajectory(series: Array) -> FourierTrajectory:
        return within_limits(from_rest(series.reshape(n, -1)), shape.frequency, limits)

    def cost(series: Array) -> float:
        progress("design", min(next(calls), total), total)
        return log_condition_of(joint_grams(expectation.columns(trajectory(series).motion(grid))).sum(axis=0))

    rng = np.random.default_rng(seed)
    start = min((random_shape(n, shape.harmonics, rng).ravel() for _ in range(_DRAWS)), key=cost)
    iterations = max(1, total // (len(start) + 1))  # SLSQP differences every variable once an iteration
    result = scipy.optimize.minimize(cost, start, method="SLSQP", options={"maxiter": iterations, "ftol": _TOLERANCE})
    best = min(start, result.x, key=cost)
    progress("design", total, total)
    return trajectory(start), trajectory(best)


def quality(expectation: Expectation, motion: Motion, noise: float) -> Quality:
    """What a motion is worth: figures over its independent samples, for the expected robots."""
    step = -(-len(motion) // _JUDGED)
    judged = motion[::step]
    columns = expectation.columns(judged)
    grams, speed = joint_grams(columns), expectation.model.robot.actuators(judged).dq
    span = float(motion.t[-1] - motion.t[0])
    weight = min(1.0, INDEPENDENT * span / len(judged))
    flips = expectation.joint_flips(grams, len(judged), noise, weight, groups_of(list(range(len(grams)))))
    segments = [
        turn_segments(columns, columns @ beta, speed, expected_noise(grams, beta, len(judged), noise), weight)
        for beta in expectation.betas
    ]
    tolerance = [noise_tolerance(*pair, noise) for pair in zip(flips, segments, strict=True)]
    hardest = int(np.argmin([groups.resolvability.min() for groups in flips]))
    shown = segments[hardest]
    last = np.minimum(shown.end * step, len(motion))
    return Quality(
        condition=condition_number(expectation.model, expectation.coefficients, judged),
        tolerance=min(tolerance),
        joints=flips[hardest],
        segments=replace(shown, start=shown.start * step, end=last),
        effort=expectation.model.effort(motion, expectation.thetas[hardest]),
        uncertainty=expectation.uncertainty(grams, len(judged), noise, weight),
        noise=noise,
    )


def _fastest(limits: MotionLimits) -> Motion:
    """A motion at the highest speeds: friction's direction is smoothed over what is standstill beside them."""
    speed = np.array([limits.velocity, limits.velocity])
    return Motion(np.arange(2.0), 0.0 * speed, speed, 0.0 * speed)
