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
from bayesid.effects import STANDARD, Term
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.model import Model
from bayesid.excitation.gaussian_posterior import period_of, reference_motion
from bayesid.excitation.limits import check_limits
from bayesid.excitation.resolvability import (
    WRONG,
    Excitation,
    PlausibleRobots,
    JointFlips,
    condition_of,
    plausible_robots,
    groups_of,
    joint_grams,
    wrong_sign_probability,
    noise_tolerance,
    flip_segments,
)
from bayesid.excitation.search import MotionSearch, best_motion
from bayesid.excitation.settings import MotionSettings, instants_of
from bayesid.excitation.splines import Feasibility, SplineBasis, SplineTrajectory
from bayesid.excitation.tuning import TUNING
from bayesid.motion import Motion
from bayesid.parallel import one_blas_thread
from bayesid.progress import SILENT, Progress, Show
from bayesid.regression.knowledge import ParameterPrior
from bayesid.robot import Robot, load_robot
from bayesid.simulation.trajectories import MotionLimits, log_condition_of

CHANGES = 6000
"""Changes of the motion that each of two searches tries."""


@dataclass(frozen=True, kw_only=True)
class Quality(Excitation):
    """What a designed motion shows."""

    joints: JointFlips  # all signs are unknown
    tolerance: float  # noise, relative to the RMS efforts, that the signs bear, for the hardest of the expected robots
    magnitude: Array  # (N, n) |effort| of the robot whose joints are easiest to mistake, N m: all that is seen of it

    @property
    def weak(self) -> Mask:
        """(S,) segments whose sign is more likely wrong than a tenth of the energy's is, at the noise tolerance."""
        weak: Mask = wrong_sign_probability(self.segments.resolvability * (self.noise / self.tolerance) ** 2) > WRONG
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
def design_for_robot(
    robot: Robot | Model | str | Path,
    terms: Iterable[str | Term] = STANDARD,
    *,
    settings: MotionSettings = MotionSettings(),
    prior: ParameterPrior = ParameterPrior(),
    seed: int = 0,
    progress: Progress | Show = SILENT,
) -> ExcitationDesign:
    """`bayesid.design_excitation` for a robot without a result, or for a model with its own terms."""
    progress = Progress.of(progress)
    arm = robot.robot if isinstance(robot, Model) else robot if isinstance(robot, Robot) else load_robot(robot)
    limits = check_limits(settings.limits, arm)
    model = robot if isinstance(robot, Model) else Model.of(arm, terms, _fastest(limits))
    expectation = plausible_robots(model, seed, prior)
    search = _search(expectation, settings, limits)
    changes = CHANGES if settings.changes is None else settings.changes
    start, best = best_motion(search, changes, progress, seed)
    motion = _played(best, settings)
    return ExcitationDesign(
        model=model,
        coefficients=expectation.coefficients,
        trajectory=best,
        motion=motion,
        rate=(len(motion) - 1) / settings.duration,
        periods=settings.periods,
        limits=limits,
        start=quality(expectation, _played(start, settings), settings.noise),
        reached=quality(expectation, motion, settings.noise),
    )


def _search(expectation: PlausibleRobots, settings: MotionSettings, limits: MotionLimits) -> MotionSearch:
    """For a period of the motion, from rest to rest in the middle of the limits."""
    robot, size = expectation.model.robot, expectation.size
    usual = reference_motion(robot, limits)
    noise = expectation.sigma(joint_grams(expectation.columns(usual)), len(usual), settings.noise)
    density = TUNING.independent_rate / float(np.mean(noise**2))

    def weights(motion: Motion) -> Array:
        return np.full((len(motion), robot.n_joints), density * period_of(motion))

    def objective(information: Array) -> float:
        precision = size[:, None] * information * size + np.eye(len(size))
        return 2.0 * log_condition_of(information) - float(np.linalg.slogdet(precision)[1]) / len(size)

    memory = any(effect.memory for effect in expectation.model.effects)
    period = settings.duration / settings.periods
    basis = SplineBasis(period, period / (TUNING.per_swing * settings.harmonics))
    middle = 0.5 * (np.array(limits.lower) + np.array(limits.upper))
    return MotionSearch(
        expectation.columns, weights, objective, memory, Feasibility.of(None, limits, None), basis, middle
    )


def _played(trajectory: SplineTrajectory, settings: MotionSettings) -> Motion:
    """All periods."""
    t = instants_of(settings)
    return replace(trajectory.motion(t % trajectory.duration), t=t)


def quality(expectation: PlausibleRobots, motion: Motion, noise: float) -> Quality:
    """What a motion is worth: figures over its independent samples, for the expected robots."""
    step = -(-len(motion) // TUNING.assessed_instants)
    judged = motion[::step]
    columns, speed = expectation.columns(judged), expectation.model.robot.actuators(judged).dq
    grams, samples = joint_grams(columns), len(judged)
    weight = min(1.0, TUNING.independent_rate * float(motion.t[-1] - motion.t[0]) / samples)
    sigma = expectation.sigma(grams, samples, noise)
    flips = expectation.joint_flips(grams, sigma, weight, groups_of(list(range(len(grams)))))
    segments = [
        flip_segments(columns, columns @ beta, speed, sd, weight)
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
