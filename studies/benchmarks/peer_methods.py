"""Other methods for a log with signs: ordinary and weighted least squares, the nearest feasible robot.

Filter, rows and regressor are those of bayesid, so that only the methods differ.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import BaseCoefficients, base_coefficients
from bayesid.effects.model import Model
from bayesid.errors import SolverError
from bayesid.identification.prediction import NORMAL_95
from bayesid.log.log import Log
from bayesid.log.segments import find_segments
from bayesid.log.signals import Signals, prepare, signed_effort
from bayesid.motion import Motion
from bayesid.parallel import quiet
from bayesid.regression.knowledge import LinkPrior
from bayesid.robot import Robot
from bayesid.robot.inertia import PSEUDO_INERTIA_BASIS

try:
    import cvxpy as cp
except ImportError:
    raise SystemExit("cvxpy is not installed: pip install 'bayesid[bench]'") from None

_ROUNDING = 1e-10
"""Singular values of columns of length 1, relative to the largest, below which a direction is rounding."""
_TIKHONOV = 1e-6
"""Weight of the Tikhonov term towards the typical link, in units of one whitened row; the default `prior_weight` of
figaroh. It determines only parameters that the log does not."""


@dataclass(frozen=True)
class Recording:
    """A log as every method gets it.

    Attributes:
        robot: of the log.
        log: with its signs.
        signals: the log on an even grid of N time steps, its motion filtered.
        used: (N, n) samples that are fitted and predicted: in motion, without both ends.
    """

    robot: Robot
    log: Log
    signals: Signals
    used: Mask

    @classmethod
    def of(cls, robot: Robot, log: Log) -> Recording:
        """Prepared as `identify` does it."""
        signals = prepare(log)
        segments = find_segments(signals, robot.actuators(signals.motion))
        moving = segments.per_sample(segments.moving, *signals.effort.shape) > 0
        return cls(robot, log, signals, moving & signals.inner)

    @property
    def motion(self) -> Motion:
        """The filtered motion."""
        return self.signals.motion

    @cached_property
    def model(self) -> Model:
        """The standard terms."""
        return Model(self.robot, make_terms(STANDARD, self.robot, self.motion))

    def error(self, predicted: Array) -> Array:
        """(n,) RMS of a prediction's (N, n) difference from the lightly filtered efforts, N m."""
        residual = signed_effort(self.signals, np.ones_like(predicted)) - predicted
        return np.sqrt((residual**2 * self.used).sum(axis=0) / self.used.sum(axis=0))


@dataclass(frozen=True)
class Answer:
    """A method's result.

    Attributes:
        model: robot and terms.
        coefficients: its r base coefficients.
        beta: (r,) their values.
        interval: (2, r) ends of their 95 % intervals; NaN without intervals.
        effort: function to efforts (N, n) of a motion, N m.
        theta: (P,) parameters; None from a method that gives only coefficients.
        seconds: of computing time.
    """

    model: Model
    coefficients: BaseCoefficients
    beta: Array
    interval: Array
    effort: Callable[[Motion], Array]
    theta: Array | None
    seconds: float


Method = Callable[[Recording], Answer]
"""From a log with signs to a result."""


def timed(method: Method) -> Method:
    """The method with its seconds in the result."""

    def answer(recording: Recording) -> Answer:
        began = time.perf_counter()
        found = method(recording)
        return replace(found, seconds=time.perf_counter() - began)

    return answer


# ---------------------------------------------------------------------------------------------------------------
# Least squares
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class LeastSquares:
    """Rows, whitened by each joint's sd, and their unconstrained least squares.

    Attributes:
        rows: (K, r) of the base coefficients' regressor.
        effort: (K,) efforts.
        beta: (r,) the least squares.
        sigma: (n,) sd that the rows were divided by, N m.
    """

    rows: Array
    effort: Array
    beta: Array
    sigma: Array

    @property
    def covariance(self) -> Array:
        """(r, r) for white noise, its variance the residual's over the degrees of freedom."""
        residual = self.effort - self.rows @ self.beta
        variance = float(residual @ residual) / (len(residual) - len(self.beta))
        length = np.linalg.norm(self.rows, axis=0)
        scaled = self.rows / length
        return variance * np.linalg.pinv(scaled.T @ scaled, rcond=_ROUNDING, hermitian=True) / np.outer(length, length)


def least_squares(columns: Array, effort: Array, used: Mask, sigma: Array) -> LeastSquares:
    """Least squares of columns (N, n, r) and efforts (N, n) where `used` (N, n), each joint divided by sigma (n,)."""
    rows, right = (columns / sigma[:, None])[used], (effort / sigma)[used]
    length = np.maximum(np.linalg.norm(rows, axis=0), np.finfo(float).tiny)
    beta = np.linalg.lstsq(rows / length, right, rcond=_ROUNDING)[0] / length
    return LeastSquares(rows, right, beta, sigma)


def weighted_least_squares(columns: Array, effort: Array, used: Mask) -> LeastSquares:
    """IDIM-WLS (Gautier 1997): each joint divided by its residual of ordinary least squares."""
    ordinary = least_squares(columns, effort, used, np.ones(effort.shape[1]))
    squares = (effort - columns @ ordinary.beta) ** 2 * used
    return least_squares(columns, effort, used, np.sqrt(squares.sum(axis=0) / used.sum(axis=0)))


def _without_constraint(recording: Recording, fit: Callable[[Array, Array, Mask], LeastSquares]) -> Answer:
    model, coefficients = recording.model, base_coefficients(recording.model)
    kept = coefficients.selected
    found = fit(model.columns(recording.motion)[:, :, kept], recording.signals.raw_effort, recording.used)
    half = NORMAL_95 * np.sqrt(np.diag(found.covariance))
    interval = np.stack([found.beta - half, found.beta + half])

    def effort(motion: Motion) -> Array:
        return model.columns(motion)[:, :, kept] @ found.beta

    return Answer(model, coefficients, found.beta, interval, effort, None, 0.0)


@timed
def ordinary(recording: Recording) -> Answer:
    """Ordinary least squares of the base coefficients."""
    return _without_constraint(
        recording, lambda columns, effort, used: least_squares(columns, effort, used, np.ones(effort.shape[1]))
    )


@timed
def weighted(recording: Recording) -> Answer:
    """Weighted least squares of the base coefficients."""
    return _without_constraint(recording, weighted_least_squares)


# ---------------------------------------------------------------------------------------------------------------
# Feasible parameters
# ---------------------------------------------------------------------------------------------------------------
@timed
def weighted_feasible(recording: Recording) -> Answer:
    """Weighted least squares, then the nearest feasible parameters in its metric, by an SDP.

    It minimises (B theta - beta)' H (B theta - beta), as do FloBaRoID (Sousa and Cortesao 2014) and figaroh's
    `physical_fit`.
    """
    model, coefficients = recording.model, base_coefficients(recording.model)
    columns = model.columns(recording.motion)[:, :, coefficients.selected]
    found = weighted_least_squares(columns, recording.signals.raw_effort, recording.used)
    theta = nearest_feasible(model, coefficients, found)
    beta = coefficients.project(theta)
    none = np.full((2, len(beta)), np.nan)
    return Answer(model, coefficients, beta, none, lambda motion: model.columns(motion) @ theta, theta, 0.0)


def nearest_feasible(model: Model, coefficients: BaseCoefficients, found: LeastSquares) -> Array:
    """(P,) the feasible parameters with the least squared residuals.

    Raises:
        SolverError: Clarabel failed.
    """
    scale, typical = _typical(model)
    root = np.linalg.qr(found.rows, mode="r")
    scaled = cp.Variable(model.cone.size)
    energy = float(np.sum((root @ found.beta) ** 2))  # scales the problem: the solver fails on large numbers
    residual = (root @ (coefficients.projection * scale) @ scaled - root @ found.beta) / np.sqrt(energy)
    objective = cp.sum_squares(residual) + _TIKHONOV / energy * cp.sum_squares(scaled - typical / scale)
    _solve(cp.Problem(cp.Minimize(objective), _inside(model, cp.multiply(scale, scaled), 0.0)))
    return np.asarray(scale * scaled.value)


def most_feasible(model: Model, coefficients: BaseCoefficients, beta: Array) -> Array:
    """(P,) of all parameters with these coefficients (r,) the ones with the largest margin in the cone, up to 0.

    Raises:
        SolverError: Clarabel failed.
    """
    scale, typical = _typical(model)
    scaled, slack = cp.Variable(model.cone.size), cp.Variable()
    size = np.maximum(np.abs(coefficients.projection * scale).max(axis=1), np.finfo(float).tiny)
    same = (coefficients.projection * scale / size[:, None]) @ scaled == beta / size
    near = 1e-9 * cp.sum_squares(scaled - typical / scale)
    inside = _inside(model, cp.multiply(scale, scaled), slack)
    _solve(cp.Problem(cp.Maximize(slack - near), [same, slack <= 0.0, *inside]))
    return np.asarray(scale * scaled.value)


def _typical(model: Model) -> tuple[Array, Array]:
    """(P,) scales of the parameters, and (P,) parameters of a typical link in every body."""
    scale, typical = np.ones(model.cone.size), np.zeros(model.cone.size)
    for body in model.cone.bodies:
        scale[body], typical[body] = LinkPrior().sd, LinkPrior().centre
    return scale, typical


def _inside(model: Model, theta: cp.Expression, slack: cp.Expression | float) -> list[cp.Constraint]:
    """Eigenvalues of all pseudo-inertias, friction and rotor inertia are at least the slack."""
    cone = model.cone
    bodies = [sum(theta[int(i)] * PSEUDO_INERTIA_BASIS[k] for k, i in enumerate(body)) for body in cone.bodies]
    positive = [theta[cone.nonnegative] >= slack] if len(cone.nonnegative) else []
    return [*positive, *(body - slack * np.eye(4) >> 0 for body in bodies)]


def _solve(problem: cp.Problem) -> None:
    with quiet(UserWarning):  # of an inaccurate solution, which has five digits
        problem.solve(solver=cp.CLARABEL)
    if problem.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
        raise SolverError("the nearest feasible parameters through cvxpy", problem.status)


def feasibility(answer: Answer) -> tuple[float, int]:
    """Smallest eigenvalue of the pseudo-inertias (mixed units), and number of negative friction and rotor parameters.

    For a method with coefficients only: the best values of any parameters with these coefficients, at most zero. A
    negative value means that no robot has these coefficients.
    """
    model, theta = answer.model, answer.theta
    if theta is None:
        theta = most_feasible(model, answer.coefficients, answer.beta)
    least = float(model.cone.smallest_eigenvalues(theta).min())
    return least, int(np.sum(theta[model.cone.nonnegative] < -_ROUNDED))


_ROUNDED = 1e-6
"""N m, N m s, kg m^2: accuracy of the solver."""
