"""Design of a motion that shows coefficients, for a controller to play, before anything is known of the robot.

Every joint follows a spline within its limits that starts and ends at rest. `bayesid.excitation.search` looks for
the least of log kappa^2 + mean log v (:eq:`design-worth`): kappa is the condition number of the base regressor with
columns of unit length (:eq:`condition-number`), the amplification of noise into coefficients, and v the variance of
coefficients over that of plausible robots. The first says nothing of how large efforts are, the second nothing of sums
that are shown badly. The result says how far signs are resolved, too, but is not designed for that: over 97 pairs of
logs a design for signs gave as many right ones (`bayesid.studies.benchmarks.excitation` has what stands of it).

Collisions of the robot with itself or its surroundings, and limits of its efforts, are not checked here; a motion for a
result keeps them (`bayesid.excitation.next_motion`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects import STANDARD, Term, catalogue
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.model import Model
from bayesid.excitation.known import period_of, usual_motion
from bayesid.excitation.limits import check_between, check_limits
from bayesid.excitation.resolvability import (
    WRONG,
    Excitation,
    Expectation,
    JointFlips,
    check_noise,
    condition_of,
    expect,
    groups_of,
    joint_grams,
    mistaken,
    noise_tolerance,
    turn_segments,
)
from bayesid.excitation.search import MotionSearch, best_motion
from bayesid.excitation.splines import Feasibility, SplineBasis, SplineTrajectory
from bayesid.excitation.tuning import TUNING
from bayesid.motion import Motion
from bayesid.parallel import one_blas_thread
from bayesid.progress import SILENT, Progress, Show
from bayesid.regression.knowledge import ParameterPrior
from bayesid.robot import Robot, load_robot
from bayesid.simulation.trajectories import HARMONICS, MotionLimits, log_condition_of


@dataclass(frozen=True, kw_only=True)
class TrajectoryShape:
    """What is given of a motion before its shape is designed."""

    duration: float = 20.0  #: of the whole motion, s
    rate: float = 100.0  #: of the samples, Hz; rounded so that a whole number of them fits the duration
    harmonics: int = HARMONICS  #: how many times a joint may swing to and fro in a period, about, 2 to 20
    periods: int = 1  #: how many times the motion is played in the duration

    def __post_init__(self) -> None:
        fewest = 4.0 * self.harmonics * self.periods  # twice as many as Nyquist asks for
        check_between(self.duration, 0.5, 3600.0, "TrajectoryShape.duration", "s")
        check_between(self.harmonics, 2, 20, "TrajectoryShape.harmonics", "harmonics")
        check_between(self.periods, 1, 1000, "TrajectoryShape.periods", "periods")
        check_between(self.rate * self.duration, fewest, 1e6, "TrajectoryShape.rate", "samples")

    @property
    def instants(self) -> Array:
        """(N,) of the samples, s."""
        return np.linspace(0.0, self.duration, round(self.duration * self.rate) + 1)


@dataclass(frozen=True, kw_only=True)
class Objective:
    """What a design aims at."""

    noise: float = 0.05  #: of the efforts, relative to each joint's RMS effort, at which the result is judged
    #: changes of the motion that each of two searches tries; 6000 take about ten seconds for six joints
    evaluations: int = 6000

    def __post_init__(self) -> None:
        check_noise(self.noise)


@dataclass(frozen=True, kw_only=True)
class Quality(Excitation):
    """What a designed motion shows."""

    joints: JointFlips  # all signs are unknown
    tolerance: float  # noise, relative to the RMS efforts, that the signs bear, for the hardest of the expected robots
    magnitude: Array  # (N, n) |effort| of the robot whose joints are easiest to mistake, N m: all that is seen of it

    @property
    def weak(self) -> Mask:
        """(S,) segments whose sign is more likely wrong than a tenth of the energy's is, at the noise tolerance."""
        weak: Mask = mistaken(self.segments.resolvability * (self.noise / self.tolerance) ** 2) > WRONG
        return weak


@dataclass(frozen=True)
class ExcitationDesign:
    """A motion to be played."""

    model: Model  #: robot and terms
    coefficients: BaseCoefficients  #: the r base coefficients that it is to show
    trajectory: SplineTrajectory  #: a period of the motion as a spline
    motion: Motion  #: N samples of it, from rest to rest
    rate: float  #: of these, Hz
    periods: int  #: that it holds
    limits: MotionLimits  #: of each joint
    start: Quality  #: the best of some random motions
    reached: Quality  #: what the design has made of it

    def __repr__(self) -> str:
        lines = [
            f"ExcitationDesign for {self.model.robot.name}: {len(self.motion)} instants at {self.rate:g} Hz",
            f"condition number  {self.start.condition:.1f} at the start, {self.reached.condition:.1f} now",
            f"undecided         {len(self.undecided)} of {len(self.coefficients)} coefficients",
            "go on with        .motion, bayesid.save(this, folder)",
        ]
        return "\n  ".join(lines)

    @property
    def of_limits(self) -> Motion:
        """Positions from -1 at the lower to 1 at the upper limit, velocities and accelerations as shares of theirs."""
        lower, upper = np.asarray(self.limits.lower), np.asarray(self.limits.upper)
        motion, centred = self.motion, 2.0 * self.motion.q - lower - upper
        dq, ddq = motion.dq / np.asarray(self.limits.velocity), motion.ddq / np.asarray(self.limits.acceleration)
        return replace(motion, q=centred / (upper - lower), dq=dq, ddq=ddq)

    @property
    def undecided(self) -> tuple[int, ...]:
        """Coefficients that a log of this motion leaves undecided."""
        return self.reached.undecided

    @property
    def noise(self) -> float:
        """Relative to the RMS efforts, at which the motion is judged."""
        return self.reached.noise


@one_blas_thread
def design_excitation(
    robot: Robot | str | Path,
    terms: Iterable[str | Term] = STANDARD,
    *,
    shape: TrajectoryShape = TrajectoryShape(),
    limits: MotionLimits | None = None,
    objective: Objective = Objective(),
    prior: ParameterPrior = ParameterPrior(),
    seed: int = 0,
    progress: Progress | Show = SILENT,
) -> ExcitationDesign:
    """Designs a periodic motion from rest to rest that shows coefficients and signs.

    Args:
        robot: a robot, a built-in name or a file.
        terms: names of the catalogue, or terms of your own: what is to be identified.
        shape: duration, rate, harmonics and periods.
        limits: of the joints; they hold at every instant. By default those that suit most small arms.
        objective: what the design aims at.
        prior: parameters that are known beforehand (CAD); others are drawn.
        seed: of the random starts and of the expected robots.
        progress: called as progress(stage, done, total) at the start, during and at the end of each stage.

    Raises:
        InputError: the robot, the limits or an option cannot be used.

    Example:
        >>> shape = bayesid.TrajectoryShape(duration=5.0, harmonics=2)
        >>> design = bayesid.design_excitation(robot, terms, shape=shape, objective=bayesid.Objective(evaluations=50))
        >>> design.motion.q.shape
        (501, 3)
    """
    progress = Progress.of(progress)
    robot = robot if isinstance(robot, Robot) else load_robot(robot)
    limits = check_limits(limits, robot)
    model = Model(robot, catalogue.make_terms(terms, robot, _fastest(limits)))
    expectation = expect(model, seed, prior)
    search = _search(expectation, shape, limits, objective)
    start, best = best_motion(search, objective.evaluations, progress, seed)
    motion = _played(best, shape)
    return ExcitationDesign(
        model=model,
        coefficients=expectation.coefficients,
        trajectory=best,
        motion=motion,
        rate=(len(motion) - 1) / shape.duration,
        periods=shape.periods,
        limits=limits,
        start=quality(expectation, _played(start, shape), objective.noise),
        reached=quality(expectation, motion, objective.noise),
    )


def _search(
    expectation: Expectation, shape: TrajectoryShape, limits: MotionLimits, objective: Objective
) -> MotionSearch:
    """For a period of the motion, from rest to rest in the middle of the limits."""
    robot, size = expectation.model.robot, expectation.size
    usual = usual_motion(robot, limits)
    noise = expectation.sigma(joint_grams(expectation.columns(usual)), len(usual), objective.noise)
    density = TUNING.independent / float(np.mean(noise**2))

    def weights(motion: Motion) -> Array:
        return np.full((len(motion), robot.n_joints), density * period_of(motion))

    def worth(information: Array) -> float:
        precision = size[:, None] * information * size + np.eye(len(size))
        return 2.0 * log_condition_of(information) - float(np.linalg.slogdet(precision)[1]) / len(size)

    memory = any(effect.memory for effect in expectation.model.effects)
    period = shape.duration / shape.periods
    basis = SplineBasis(period, period / (TUNING.per_swing * shape.harmonics))
    middle = 0.5 * (np.array(limits.lower) + np.array(limits.upper))
    return MotionSearch(expectation.columns, weights, worth, memory, Feasibility.of(None, limits, None), basis, middle)


def _played(trajectory: SplineTrajectory, shape: TrajectoryShape) -> Motion:
    """All periods."""
    return replace(trajectory.motion(shape.instants % trajectory.duration), t=shape.instants)


def quality(expectation: Expectation, motion: Motion, noise: float) -> Quality:
    """What a motion is worth: figures over its independent samples, for the expected robots."""
    step = -(-len(motion) // TUNING.judged)
    judged = motion[::step]
    columns, speed = expectation.columns(judged), expectation.model.robot.actuators(judged).dq
    grams, samples = joint_grams(columns), len(judged)
    weight = min(1.0, TUNING.independent * float(motion.t[-1] - motion.t[0]) / samples)
    sigma = expectation.sigma(grams, samples, noise)
    flips = expectation.joint_flips(grams, sigma, weight, groups_of(list(range(len(grams)))))
    segments = [
        turn_segments(columns, columns @ beta, speed, sd, weight)
        for beta, sd in zip(expectation.betas, sigma, strict=True)
    ]
    hardest = int(np.argmin([groups.resolvability.min() for groups in flips]))
    shown = segments[hardest]
    return Quality(
        noise=noise,
        condition=condition_of(grams),
        uncertainty=expectation.uncertainty(grams, sigma, weight),
        joints=flips[hardest],
        segments=replace(shown, start=shown.start * step, end=np.minimum(shown.end * step, len(motion))),
        tolerance=min(noise_tolerance(*pair, noise) for pair in zip(flips, segments, strict=True)),
        magnitude=np.abs(expectation.model.effort(motion, expectation.thetas[hardest])),
    )


def _fastest(limits: MotionLimits) -> Motion:
    """A motion at the highest speeds: friction's direction is smoothed over what is standstill beside them."""
    speed = np.array([limits.velocity, limits.velocity])
    return Motion(np.arange(2.0), 0.0 * speed, speed, 0.0 * speed)
