"""Motions with a low condition number: the columns of the base regressor are as independent as possible."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from bayesid.arrays import Array
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.model import Model
from bayesid.motion import Motion
from bayesid.simulation.trajectories import (
    HARMONICS,
    INDUSTRIAL_ARM,
    FourierTrajectory,
    MotionLimits,
    fundamental,
    instants,
    random_shape,
    within_limits,
)

_DRAWS = 20
"""Random trajectories, the best of which is improved; a round number, not studied."""
_PRECISION = 1e-3
"""Of the logarithm of the condition number, at which the improvement ends: a tenth of a percent of the number."""
EVALUATIONS = 1500
"""About a second for six joints; ten times as many gain another tenth."""
_FLOOR = 1e-14
"""Smallest ratio of eigenvalues above rounding: keeps the objective finite where columns are dependent."""
UNEXCITED = -0.5 * float(np.log(1e2 * _FLOOR))
"""Logarithm of a condition number that a Gram matrix does not distinguish from infinity."""


def exciting_trajectory(
    model: Model,
    coefficients: BaseCoefficients,
    duration: float,
    *,
    seed: int = 0,
    limits: MotionLimits = INDUSTRIAL_ARM,
    harmonics: int = HARMONICS,
    periods: int = 1,
    evaluations: int = EVALUATIONS,
) -> FourierTrajectory:
    """A trajectory with a low `condition_number`: the best of some random draws, improved by SLSQP.

    Args:
        model: the model to be identified.
        coefficients: its base coefficients.
        duration: length of the motion, s.
        seed: of the random draws; each seed ends in another trajectory.
        limits: of the joints; they hold at every instant, not only at samples.
        harmonics: sines and cosines a joint.
        periods: whole number of periods in the duration.
        evaluations: of the condition number, about, for the improvement.

    Raises:
        ValueError: a duration or number that is not positive, or limits for another number of joints.

    Example:
        >>> trajectory = bayesid.exciting_trajectory(model, result.coefficients, 4.0, harmonics=2, evaluations=20)
        >>> trajectory.motion(np.arange(401) / 100.0).q.shape
        (401, 3)
    """
    rng, n = np.random.default_rng(seed), model.robot.n_joints
    frequency = fundamental(duration, harmonics, periods)
    grid = np.arange(instants(harmonics)) / instants(harmonics) / frequency

    def objective(shape: Array) -> float:
        return log_condition(model, coefficients, within_limits(shape.reshape(n, -1), frequency, limits).motion(grid))

    draws = [random_shape(n, harmonics, rng).ravel() for _ in range(_DRAWS)]
    start = min(draws, key=objective)
    iterations = max(1, evaluations // (len(start) + 1))  # SLSQP differences every variable once an iteration
    result = scipy.optimize.minimize(
        objective, start, method="SLSQP", options={"maxiter": iterations, "ftol": _PRECISION}
    )
    best = min(start, result.x, key=objective)
    return within_limits(best.reshape(n, -1), frequency, limits)


def condition_number(model: Model, coefficients: BaseCoefficients, motion: Motion) -> float:
    """Condition number of the base regressor, all joints' rows together, its columns scaled to length one.

    The scaling takes the units out: what is left is how well the coefficients can be separated (Gautier and
    Khalil, "Exciting trajectories for the identification of base inertial parameters of robots", IJRR 1992).
    """
    return float(np.linalg.cond(_scaled_columns(model, coefficients, motion)))


def log_condition_of(gram: Array) -> float:
    """The logarithm of `condition_number` from the Gram matrix (r, r) of all rows, its columns of any length."""
    lengths = np.sqrt(np.diag(gram))
    scale = 1.0 / np.where(lengths > 0.0, lengths, 1.0)
    return _log_ratio(np.linalg.eigvalsh(scale[:, None] * gram * scale))


def log_condition(model: Model, coefficients: BaseCoefficients, motion: Motion) -> float:
    """The logarithm of `condition_number`, three times as fast: from the eigenvalues of the Gram matrix."""
    columns = _scaled_columns(model, coefficients, motion)
    return _log_ratio(np.linalg.eigvalsh(columns.T @ columns))


def _log_ratio(eigenvalues: NDArray[np.floating[Any]]) -> float:
    return float(-0.5 * np.log(max(eigenvalues[0] / eigenvalues[-1], _FLOOR)))


def _scaled_columns(model: Model, coefficients: BaseCoefficients, motion: Motion) -> Array:
    """(N n, r) columns of length one; a column of zeros stays."""
    columns = model.columns(motion)[:, :, coefficients.kept].reshape(-1, len(coefficients))
    lengths = np.linalg.norm(columns, axis=0)
    return columns / np.where(lengths > 0.0, lengths, 1.0)
