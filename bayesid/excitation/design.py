"""Design of a motion that shows coefficients and signs, for a controller to play.

Every joint follows a Fourier series within its limits that starts and ends at rest. Its shape minimises
(:eq:`excitation-objective`)

    log kappa + lambda mean over robots of log sum_A w_A R_A^(-1/2),   lambda = 1,                           (4)

kappa the condition number of the base regressor with columns of unit length, A the groups of joints whose signs can be
turned at once, R_A their resolvability and w_A their share of the energy (`bayesid.excitation.resolvability`). Both
parts are logarithms of what amplifies noise: kappa into coefficients, R_A^(-1/2) into signs. Neither depends on the
noise's size. The second part is a soft minimum: groups that are easily turned weigh most, and those with little energy
less. The robots are plausible ones, as the motion has to be designed before anything is known.

Segments have no part in (4): they come and go where an effort touches zero, and a gradient method that sees them stops
after a dozen steps. What couples the joints serves them too, and the result tells how far each of them is resolved.

Collisions of the robot with itself or its surroundings, and limits of its efforts, are not checked.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from bayesid import terms as catalogue
from bayesid.coefficients import BaseCoefficients
from bayesid.errors import InputError
from bayesid.excitation.condition import condition_number, log_condition_of
from bayesid.excitation.expectation import Expectation, expect, undecided
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
from bayesid.excitation.trajectory import (
    HARMONICS,
    FourierTrajectory,
    MotionLimits,
    from_rest,
    instants,
    random_shape,
    within_limits,
)
from bayesid.model import Model
from bayesid.motion import Array, Mask, Motion
from bayesid.robot import Robot, load_robot
from bayesid.signs import Progress

EVALUATIONS = 6000
"""About ten seconds for six joints."""
_DRAWS = 20
_JUDGED = 2000
"""Instants, at most, at which a finished motion is judged."""
_LONGEST, _MOST_SAMPLES, _MOST_HARMONICS = 3600.0, 1_000_000, 20


@dataclass(frozen=True)
class Quality:
    """What a motion is worth, at one noise.

    Attributes:
        condition: condition number of the base regressor.
        tolerance: noise, relative to the RMS efforts, that the signs bear, for the hardest of the expected robots.
        joints: groups of joints that may be turned, for the robot for which the easiest one is easiest to mistake.
        segments: those of that robot, and what turning them weighs.
        effort: (N, n) that robot's efforts, N m.
        left: (r,) of each coefficient's usual size: its standard deviation after a log of this motion, signs given.
        noise: relative to the RMS efforts, at which all this is meant.
    """

    condition: float
    tolerance: float
    joints: JointFlips
    segments: SegmentFlips
    effort: Array
    left: Array
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

    @property
    def of_limits(self) -> Motion:
        """Positions from -1 at the lower to 1 at the upper limit, velocities and accelerations as shares of theirs."""
        lower, upper = np.asarray(self.limits.lower), np.asarray(self.limits.upper)
        motion = self.motion
        return Motion(
            motion.t, (2.0 * motion.q - lower - upper) / (upper - lower), motion.dq / np.asarray(self.limits.velocity),
            motion.ddq / np.asarray(self.limits.acceleration),
        )  # fmt: skip

    @property
    def undecided(self) -> tuple[int, ...]:
        """Coefficients that a log of this motion leaves undecided."""
        return undecided(self.reached.left)

    @property
    def noise(self) -> float:
        """Relative to the RMS efforts, at which the motion is judged."""
        return self.reached.noise


@threadpool_limits.wrap(limits=1, user_api="blas")  # matrices are small: threads only wait for each other
def design_excitation(
    robot: Robot | str | Path,
    terms: Iterable[str] = catalogue.DEFAULT,
    *,
    duration: float = 20.0,
    rate: float = 100.0,
    limits: MotionLimits | None = None,
    harmonics: int = HARMONICS,
    periods: int = 1,
    seed: int = 0,
    noise: float = 0.05,
    nominal: Mapping[str, tuple[float, float]] | None = None,
    sign_weight: float = 1.0,
    evaluations: int = EVALUATIONS,
    progress: Progress | None = None,
) -> ExcitationDesign:
    """Designs a periodic motion from rest to rest that shows coefficients and signs.

    Args:
        robot: a robot, a built-in name or a file.
        terms: names from `bayesid.terms.CATALOGUE`: what is to be identified.
        duration: of the whole motion, s.
        rate: of the samples, Hz; rounded so that a whole number of them fits the duration.
        limits: of the joints; they hold at every instant. By default those that suit most small arms.
        harmonics: sines and cosines a joint, at least 2.
        periods: whole number of periods in the duration.
        seed: of the random starts and of the expected robots.
        noise: of the efforts, relative to each joint's RMS effort, at which the result is judged.
        nominal: parameters known beforehand (CAD): name to mean and standard deviation; others are drawn.
        sign_weight: lambda of (4); 0 for a robot whose efforts have their signs: the condition number alone counts.
        evaluations: of the objective, about.
        progress: called as progress(stage, done, total).

    Raises:
        InputError: the robot, the limits or an option cannot be used.
    """
    _check(duration, rate, harmonics, periods, noise)
    robot = robot if isinstance(robot, Robot) else load_robot(robot)
    limits = check_limits(limits, robot)
    model = Model(robot, catalogue.make_terms(terms, robot, _fastest(limits)))
    expectation = expect(model, seed, nominal)
    frequency, n = periods / duration, robot.n_joints
    count = instants(harmonics)
    grid = np.arange(count) / count / frequency
    done = 0

    def trajectory(shape: Array) -> FourierTrajectory:
        return within_limits(from_rest(shape.reshape(n, -1)), frequency, limits)

    def objective(shape: Array) -> float:
        nonlocal done
        done += 1
        if progress is not None:
            progress("design", min(done, evaluations), evaluations)
        return amplification(expectation, trajectory(shape).motion(grid), sign_weight)

    rng = np.random.default_rng(seed)
    start = min((random_shape(n, harmonics, rng).ravel() for _ in range(_DRAWS)), key=objective)
    iterations = max(1, evaluations // (len(start) + 1))  # SLSQP differences every variable once an iteration
    found = minimize(objective, start, method="SLSQP", options={"maxiter": iterations, "ftol": 1e-3})
    best = trajectory(min(start, found.x, key=objective))
    if progress is not None:
        progress("design", evaluations, evaluations)
    t = np.linspace(0.0, duration, round(duration * rate) + 1)
    before, motion = trajectory(start).motion(t), best.motion(t)
    return ExcitationDesign(
        model, expectation.coefficients, best, motion, (len(t) - 1) / duration, periods, limits,
        quality(expectation, before, noise), quality(expectation, motion, noise),
    )  # fmt: skip


def amplification(expectation: Expectation, motion: Motion, sign_weight: float = 1.0) -> float:
    """The objective (4) of a motion."""
    grams = joint_grams(expectation.columns(motion))
    if not sign_weight or len(grams) == 1:  # one joint alone can always be turned
        return log_condition_of(grams.sum(axis=0))
    groups = groups_of(list(range(len(grams))))
    signs = [
        np.log(flips.share @ np.maximum(flips.resolvability, 1e-12) ** -0.5)
        for flips in expectation.joint_flips(grams, len(motion), 1.0, 1.0, groups)
    ]
    return log_condition_of(grams.sum(axis=0)) + sign_weight * float(np.mean(signs))


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
    hardest = int(np.argmin([one.resolvability.min() for one in flips]))
    shown = segments[hardest]
    return Quality(
        condition=condition_number(expectation.model, expectation.coefficients, judged),
        tolerance=min(tolerance),
        joints=flips[hardest],
        segments=SegmentFlips(
            shown.joint, shown.start * step, np.minimum(shown.end * step, len(motion)), shown.share,
            shown.resolvability,
        ),
        effort=expectation.model.effort(motion, expectation.thetas[hardest]),
        left=expectation.left(grams, len(judged), noise, weight),
        noise=noise,
    )  # fmt: skip


def _fastest(limits: MotionLimits) -> Motion:
    """A motion at the highest speeds: friction's direction is smoothed over what is standstill beside them."""
    speed = np.array([limits.velocity, limits.velocity])
    return Motion(np.arange(2.0), 0.0 * speed, speed, 0.0 * speed)


def _check(duration: float, rate: float, harmonics: int, periods: int, noise: float) -> None:
    if not 0.5 <= duration <= _LONGEST:
        raise InputError(f"{duration:g} s cannot be used", "--duration", f"give 0.5 to {_LONGEST:g} s")
    if not 2 <= harmonics <= _MOST_HARMONICS:
        remedy = f"give 2 to {_MOST_HARMONICS}: one alone cannot start and end at rest"
        raise InputError(f"{harmonics} harmonics cannot be used", "--harmonics", remedy)
    if periods < 1:
        raise InputError(f"{periods} periods cannot be used", "--periods", "give 1 or more")
    least = 4.0 * harmonics * periods / duration
    most = _MOST_SAMPLES / duration
    if not least <= rate <= most:
        remedy = f"give {least:.3g} Hz, twice the Nyquist rate of the highest harmonic, to {most:.3g} Hz"
        raise InputError(f"{rate:g} Hz cannot be used", "--rate", remedy)
    if not 0.0 < noise <= 10.0:
        raise InputError(f"a noise of {noise:g} cannot be used", "--noise", "give a share of the RMS effort, as 0.05")
