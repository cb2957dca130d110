"""Periodic trajectories within limits, random or exciting, and the condition number.

Each joint follows a finite Fourier series (Swevers, Ganseman, Tukel, De Schutter and Van Brussel, "Optimal robot
excitation and identification", IEEE Trans. Robotics and Automation 1997), scaled until it reaches one of its limits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from bayesid.arrays import Array, frozen
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.model import Model
from bayesid.motion import Motion
from bayesid.simulation.parameters import or_one
from bayesid.simulation.tuning import TUNING

HARMONICS = 5
"""As in Swevers et al. 1997."""
_FLOOR = 1e-14  # smallest ratio of eigenvalues above rounding: the objective stays finite for dependent columns
UNEXCITED = -0.5 * float(np.log(1e2 * _FLOOR))
"""Logarithm of a condition number that rounding of a Gram matrix does not distinguish from infinity."""


@dataclass(frozen=True)
class MotionLimits:
    """Limits of the joints, one number for all or one per joint; the defaults suit most small industrial arms.

    Attributes:
        lower: lowest position, rad (m for a prismatic joint); the other units follow.
        jerk: None for no limit. Applies to designed motions only.
        effort: largest |effort| of the actuators, N m; None for no limit. Applies to motions after a result only
            (`bayesid.design_excitation`).
    """

    lower: float | tuple[float, ...] = -2.0
    upper: float | tuple[float, ...] = 2.0
    velocity: float | tuple[float, ...] = 3.0
    acceleration: float | tuple[float, ...] = 15.0
    jerk: float | tuple[float, ...] | None = None
    effort: float | tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if not np.all(np.subtract(self.upper, self.lower) > 0.0):
            raise ValueError("the upper position limit must be above the lower one")
        for name in ("velocity", "acceleration", "jerk", "effort"):
            limit = getattr(self, name)
            if limit is not None and not np.all(np.greater(limit, 0.0)):
                raise ValueError(f"{name} limits must be positive")


INDUSTRIAL_ARM = MotionLimits()


@dataclass(frozen=True)
class FourierTrajectory:
    """q_j(t) = centre_j + sum over h of sine_jh sin(2 pi h f t) + cosine_jh cos(2 pi h f t), h = 1 ... H."""

    frequency: float  #: the fundamental f, Hz; the motion repeats after 1 / f
    sine: Array  #: (n, H) amplitudes, rad
    cosine: Array  #: (n, H) amplitudes, rad
    centre: Array  #: (n,) mean positions, rad

    def __post_init__(self) -> None:
        sine = frozen(self.sine, (None, None), "sine")
        for name, shape in (("sine", sine.shape), ("cosine", sine.shape), ("centre", sine.shape[:1])):
            object.__setattr__(self, name, frozen(getattr(self, name), shape, name))
        if not 0.0 < self.frequency < np.inf:
            raise ValueError(f"the fundamental frequency must be positive, not {self.frequency} Hz")

    def motion(self, t: Array) -> Motion:
        """Positions and their exact derivatives at times t (N,), s."""
        omega = 2 * np.pi * self.frequency * np.arange(1, self.sine.shape[1] + 1)
        sin, cos = np.sin(np.outer(t, omega)), np.cos(np.outer(t, omega))
        q = sin @ self.sine.T + cos @ self.cosine.T
        dq = (omega * cos) @ self.sine.T - (omega * sin) @ self.cosine.T
        ddq = -(omega**2 * sin) @ self.sine.T - (omega**2 * cos) @ self.cosine.T
        return Motion(t, self.centre + q, dq, ddq)


def random_trajectory(
    n_joints: int,
    duration: float,
    *,
    rng: np.random.Generator | int | None = 0,
    limits: MotionLimits = INDUSTRIAL_ARM,
    harmonics: int = HARMONICS,
    periods: int = 1,
) -> FourierTrajectory:
    """A random trajectory of n joints that reaches the limits, not optimised.

    Args:
        n_joints: number of joints n.
        duration: of the motion, s.
        rng: of the shape: a seed, a generator, or None for a random seed.
        limits: of the joints; they hold at every instant.
        harmonics: number of harmonics per joint.
        periods: whole number of periods in the duration.

    Raises:
        ValueError: a duration or number is not positive, or limits are for another number of joints.

    Example:
        >>> trajectory = bayesid.random_trajectory(robot.n_joints, duration=4.0, rng=1)
        >>> trajectory.motion(np.arange(401) / 100.0).q.shape
        (401, 3)
    """
    shape = random_shape(n_joints, harmonics, np.random.default_rng(rng))
    return within_limits(shape, fundamental(duration, harmonics, periods), limits)


def fundamental(duration: float, harmonics: int, periods: int) -> float:
    """Fundamental frequency, Hz, for a number of periods in a duration, s; ValueError if a number is out of range."""
    if not 0.0 < duration < np.inf:
        raise ValueError(f"the duration must be positive, not {duration} s")
    if harmonics < 1 or periods < 1:
        raise ValueError(f"{harmonics} harmonics and {periods} periods: both must be at least 1")
    return periods / duration


def samples_of_period(harmonics: int) -> int:
    """Samples per period: enough for a tight bound between them, `within_limits`."""
    return max(TUNING.samples, 20 * harmonics)


def random_shape(n_joints: int, harmonics: int, rng: np.random.Generator) -> Array:
    """(n, 2 H + 1) relative amplitudes of sines and cosines, equal in velocity, and relative shifts of the centres."""
    waves = rng.standard_normal((n_joints, 2, harmonics)) / np.arange(1, harmonics + 1)
    return np.column_stack([waves.reshape(n_joints, -1), rng.uniform(-1.0, 1.0, n_joints)])


def within_limits(shape: Array, frequency: float, limits: MotionLimits) -> FourierTrajectory:
    """The trajectory of a shape (n, 2 H + 1), each joint scaled until it reaches the first of its limits.

    Between N evenly spaced samples a trigonometric polynomial of degree H is at most 1 / cos(pi H / N) times its
    largest sample (Ehlich and Zeller, "Schwankung von Polynomen zwischen Gitterpunkten", 1964). So limits hold at every
    instant.
    """
    n, harmonics = len(shape), shape.shape[1] // 2
    names = ("lower", "upper", "velocity", "acceleration")
    lower, upper, velocity, acceleration = (np.broadcast_to(getattr(limits, name), n) for name in names)
    half = (upper - lower) / 2
    shift = TUNING.shift * half * np.clip(shape[:, -1], -1.0, 1.0)
    count = samples_of_period(harmonics)
    wave = FourierTrajectory(frequency, shape[:, :harmonics], shape[:, harmonics:-1], np.zeros(n))
    motion = wave.motion(np.arange(count) / count / frequency)
    bounds = zip((half - np.abs(shift), velocity, acceleration), (motion.q, motion.dq, motion.ddq), strict=True)
    stretch = np.min([limit / np.abs(values).max(axis=0) for limit, values in bounds], axis=0)
    stretch = stretch[:, None] * np.cos(np.pi * harmonics / count)
    return FourierTrajectory(frequency, stretch * wave.sine, stretch * wave.cosine, (lower + upper) / 2 + shift)


def exciting_trajectory(
    model: Model,
    coefficients: BaseCoefficients,
    duration: float,
    *,
    seed: int = 0,
    limits: MotionLimits = INDUSTRIAL_ARM,
    harmonics: int = HARMONICS,
    periods: int = 1,
    evaluations: int = 1500,
) -> FourierTrajectory:
    """A trajectory with a low `condition_number` for a model: the best of some random draws, improved by SLSQP.

    Args:
        model: to be identified.
        coefficients: its base coefficients.
        duration: of the motion, s.
        seed: of the random draws.
        limits: of the joints; they hold at every instant.
        harmonics: number of harmonics per joint.
        periods: whole number of periods in the duration.
        evaluations: approximate number of evaluations of the condition number; the default takes about 1 s for six
            joints, ten times as many lower it by another 10 %.
    """
    rng, n = np.random.default_rng(seed), model.robot.n_joints
    frequency = fundamental(duration, harmonics, periods)
    grid = np.arange(samples_of_period(harmonics)) / samples_of_period(harmonics) / frequency

    def objective(shape: Array) -> float:
        """Logarithm of the condition number, from the eigenvalues of the Gram matrix."""
        motion = within_limits(shape.reshape(n, -1), frequency, limits).motion(grid)
        columns = _scaled_columns(model, coefficients, motion)
        return _log_ratio(np.linalg.eigvalsh(columns.T @ columns))

    draws = [random_shape(n, harmonics, rng).ravel() for _ in range(TUNING.draws)]
    start = min(draws, key=objective)
    iterations = max(1, evaluations // (len(start) + 1))  # finite differences of every variable per iteration
    result = scipy.optimize.minimize(
        objective, start, method="SLSQP", options={"maxiter": iterations, "ftol": TUNING.precision}
    )
    best = min(start, result.x, key=objective)
    return within_limits(best.reshape(n, -1), frequency, limits)


def condition_number(model: Model, coefficients: BaseCoefficients, motion: Motion) -> float:
    """Condition number of the base regressor, all joints' rows together, its columns scaled to length one.

    The scaling removes the units, so the number measures how well the coefficients can be separated (Gautier and
    Khalil, "Exciting trajectories for the identification of base inertial parameters of robots", IJRR 1992).
    """
    return float(np.linalg.cond(_scaled_columns(model, coefficients, motion)))


def log_condition_of(gram: Array) -> float:
    """Logarithm of `condition_number` from the Gram matrix (r, r) of all rows, for columns of any length."""
    scale = 1.0 / or_one(np.sqrt(np.diag(gram)))
    return _log_ratio(np.linalg.eigvalsh(scale[:, None] * gram * scale))


def _log_ratio(eigenvalues: NDArray[np.floating[Any]]) -> float:
    return float(-0.5 * np.log(max(eigenvalues[0] / eigenvalues[-1], _FLOOR)))


def _scaled_columns(model: Model, coefficients: BaseCoefficients, motion: Motion) -> Array:
    columns = model.columns(motion)[:, :, coefficients.selected].reshape(-1, len(coefficients))
    return columns / or_one(np.linalg.norm(columns, axis=0))
