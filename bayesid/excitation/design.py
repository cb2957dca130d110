"""Design of a motion for a first identification, from the kinematics of the robot alone.

Every joint follows a spline within its limits that starts and ends at rest. `bayesid.excitation.search` minimises
log kappa^2 + mean log v (:eq:`design-worth`). kappa is the condition number of the base regressor with columns of unit
length (:eq:`condition-number`), v the posterior variance of coefficients over their variance among plausible robots.
kappa does not depend on the size of efforts, v hardly on badly conditioned sums. The design also reports the
resolvability of signs, but does not optimise it: a design for signs gave no more right signs
(`bayesid.studies.benchmarks.excitation`).

Collisions and effort limits are not checked here; `bayesid.excitation.next_motion` checks them.
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
    JointFlips,
    PlausibleRobots,
    condition_of,
    flip_segments,
    groups_of,
    joint_grams,
    noise_tolerance,
    plausible_robots,
    wrong_sign_probability,
)
from bayesid.excitation.search import MotionSearch, best_motion
from bayesid.excitation.settings import MotionSettings, sample_times
from bayesid.excitation.splines import Feasibility, SplineBasis, SplineTrajectory
from bayesid.excitation.tuning import TUNING
from bayesid.motion import Motion
from bayesid.parallel import one_blas_thread
from bayesid.progress import SILENT, Progress, Show
from bayesid.regression.knowledge import ParameterPrior
from bayesid.robot import Robot, load_robot
from bayesid.simulation.trajectories import MotionLimits, log_condition_of

CHANGES = 6000
"""Changes of the motion that each of two searches tries, about 10 s for six joints. Chosen; not measured."""


@dataclass(frozen=True, kw_only=True)
class Quality(Excitation):
    """Excitation of a designed motion."""

    joints: JointFlips  # all signs are unknown
    tolerance: float  # noise tolerance, the least of the plausible robots
    magnitude: Array  # (N, n) |effort|, N m, of the plausible robot with the lowest resolvability

    @property
    def weak(self) -> Mask:
        """(S,) segments whose sign is wrong with a probability above 10 % at the noise tolerance."""
        weak: Mask = wrong_sign_probability(self.segments.resolvability * (self.noise / self.tolerance) ** 2) > WRONG
        return weak


@dataclass(frozen=True)
class ExcitationDesign:
    """A designed motion for a first identification."""

    model: Model  #: robot and terms
    coefficients: BaseCoefficients  #: the r base coefficients to be identified
    trajectory: SplineTrajectory  #: one period of the motion
    motion: Motion  #: N samples of all periods, from rest to rest
    rate: float  #: of the samples, Hz
    periods: int  #: number of periods
    limits: MotionLimits  #: of each joint
    start: Quality  #: of the best random motion, before the search
    reached: Quality  #: of the designed motion

    def __repr__(self) -> str:
        lines = [
            f"ExcitationDesign for {self.model.robot.name}: {len(self.motion)} samples at {self.rate:g} Hz",
            f"condition number  {self.reached.condition:.1f} ({self.start.condition:.1f} before the search)",
            f"undetermined      {len(self.undecided)} of {len(self.coefficients)} coefficients",
            "next              .motion, bayesid.save(this, folder)",
        ]
        return "\n  ".join(lines)

    @property
    def of_limits(self) -> Motion:
        """Positions scaled to -1 at the lower and 1 at the upper limit; velocities and accelerations over theirs."""
        lower, upper = np.asarray(self.limits.lower), np.asarray(self.limits.upper)
        motion, centred = self.motion, 2.0 * self.motion.q - lower - upper
        dq, ddq = motion.dq / np.asarray(self.limits.velocity), motion.ddq / np.asarray(self.limits.acceleration)
        return replace(motion, q=centred / (upper - lower), dq=dq, ddq=ddq)

    @property
    def undecided(self) -> tuple[int, ...]:
        """Indices of coefficients that a log of this motion leaves undetermined."""
        return self.reached.undecided

    @property
    def noise(self) -> float:
        """Noise relative to the RMS efforts, for which the motion is assessed."""
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
    robots = plausible_robots(model, seed, prior)
    search = _search(robots, settings, limits)
    changes = CHANGES if settings.changes is None else settings.changes
    start, best = best_motion(search, changes, progress, seed)
    motion = _all_periods(best, settings)
    return ExcitationDesign(
        model=model,
        coefficients=robots.coefficients,
        trajectory=best,
        motion=motion,
        rate=(len(motion) - 1) / settings.duration,
        periods=settings.periods,
        limits=limits,
        start=quality(robots, _all_periods(start, settings), settings.noise),
        reached=quality(robots, motion, settings.noise),
    )


def _search(robots: PlausibleRobots, settings: MotionSettings, limits: MotionLimits) -> MotionSearch:
    """Search for one period, from rest to rest in the middle of the limits."""
    robot, size = robots.model.robot, robots.size
    usual = reference_motion(robot, limits)
    noise = robots.sigma(joint_grams(robots.columns(usual)), len(usual), settings.noise)
    density = TUNING.independent_rate / float(np.mean(noise**2))

    def weights(motion: Motion) -> Array:
        return np.full((len(motion), robot.n_joints), density * period_of(motion))

    def objective(information: Array) -> float:
        precision = size[:, None] * information * size + np.eye(len(size))
        return 2.0 * log_condition_of(information) - float(np.linalg.slogdet(precision)[1]) / len(size)

    memory = any(effect.memory for effect in robots.model.effects)
    period = settings.duration / settings.periods
    basis = SplineBasis(period, period / (TUNING.per_swing * settings.harmonics))
    middle = 0.5 * (np.array(limits.lower) + np.array(limits.upper))
    return MotionSearch(robots.columns, weights, objective, memory, Feasibility.of(None, limits, None), basis, middle)


def _all_periods(trajectory: SplineTrajectory, settings: MotionSettings) -> Motion:
    t = sample_times(settings)
    return replace(trajectory.motion(t % trajectory.duration), t=t)


def quality(robots: PlausibleRobots, motion: Motion, noise: float) -> Quality:
    """Excitation of a motion for plausible robots."""
    step = -(-len(motion) // TUNING.assessed_samples)
    thinned = motion[::step]
    columns, speed = robots.columns(thinned), robots.model.robot.actuators(thinned).dq
    grams, samples = joint_grams(columns), len(thinned)
    weight = min(1.0, TUNING.independent_rate * float(motion.t[-1] - motion.t[0]) / samples)
    sigma = robots.sigma(grams, samples, noise)
    flips = robots.joint_flips(grams, sigma, weight, groups_of(list(range(len(grams)))))
    segments = [
        flip_segments(columns, columns @ beta, speed, sd, weight) for beta, sd in zip(robots.betas, sigma, strict=True)
    ]
    hardest = int(np.argmin([groups.resolvability.min() for groups in flips]))
    of_hardest = segments[hardest]
    return Quality(
        noise=noise,
        condition=condition_of(grams),
        uncertainty=robots.uncertainty(grams, sigma, weight),
        joints=flips[hardest],
        segments=replace(of_hardest, start=of_hardest.start * step, end=np.minimum(of_hardest.end * step, len(motion))),
        tolerance=min(noise_tolerance(*pair, noise) for pair in zip(flips, segments, strict=True)),
        magnitude=np.abs(robots.model.effort(motion, robots.thetas[hardest])),
    )


def _fastest(limits: MotionLimits) -> Motion:
    """A motion at the highest speeds, which set the speed of standstill, where friction is smoothed."""
    speed = np.array([limits.velocity, limits.velocity])
    return Motion(np.arange(2.0), 0.0 * speed, speed, 0.0 * speed)
