"""Motions as uniform B-splines of degree five, from rest to rest, and their limits.

q(t) = sum_k B_k(t) c_k with control points c_k (de Boor, A Practical Guide to Splines, 1978, chapter IX). Between two
knots, position and derivatives are polynomials. A polynomial lies between its least and largest Bernstein coefficients
(Farouki, The Bernstein polynomial basis: a centennial retrospective, 2012, section 4), which are linear in the control
points. So limits of these coefficients hold at every instant. The first three and the last three control points are the
end poses, so velocity and acceleration are zero there. A control point moves the curve over six knot intervals.

Steps of a search are shortened to the limits of position, velocity, acceleration and jerk. They are refused if efforts
exceed their limits or the robot collides. Efforts must stay within their limits by `TUNING.effort_sds` standard
deviations of the prediction. Between samples they are bounded by the larger neighbour plus an eighth of the second
difference (Davis, Interpolation and Approximation, 1975, theorem 3.1.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BPoly, BSpline, PPoly
from scipy.special import factorial

from bayesid.arrays import Array, frozen
from bayesid.excitation.gaussian_posterior import GaussianPosterior
from bayesid.excitation.tuning import TUNING
from bayesid.motion import Motion
from bayesid.robot.collision import CollisionModel
from bayesid.simulation.trajectories import MotionLimits

DEGREE = 5
"""The jerk is continuous, and its derivative bounded."""
ENDS = 3
"""Equal control points at each end: velocity and acceleration are zero there."""
_ROUNDING = 1e-9
"""Rounding error: s, or relative to the largest change or limit."""
_BESIDE = 3
"""Samples added on each side of a window: the bound between two samples uses four of them."""


@dataclass(frozen=True)
class SplineBasis:
    """B-spline basis of K control points over a duration."""

    duration: float  # s
    spacing: float = TUNING.spacing  # of the knots, s, about

    @cached_property
    def knots(self) -> Array:
        """(K + 6,) s; the first and the last are repeated six times."""
        pieces = max(TUNING.fewest_knots, round(self.duration / self.spacing))
        return np.pad(np.linspace(0.0, self.duration, pieces + 1), DEGREE, mode="edge")

    def __len__(self) -> int:
        return len(self.knots) - DEGREE - 1

    @cached_property
    def places(self) -> Array:
        """(K,) Greville abscissae, s: the curve is near its control points there (de Boor, chapter XI)."""
        return np.asarray(np.lib.stride_tricks.sliding_window_view(self.knots[1:-1], DEGREE).mean(axis=1))

    @cached_property
    def edges(self) -> Array:
        """(M + 1,) s, ends of the pieces that have Bernstein coefficients."""
        knots = np.unique(self.knots)
        return np.interp(
            np.arange(TUNING.pieces_per_interval * (len(knots) - 1) + 1) / TUNING.pieces_per_interval,
            np.arange(len(knots)),
            knots,
        )

    @cached_property
    def _curves(self) -> tuple[BSpline, ...]:
        curve = BSpline(self.knots, np.eye(len(self)), DEGREE)
        return (curve, *(curve.derivative(order) for order in range(1, DEGREE + 1)))

    def values(self, t: Array, order: int = 0) -> Array:
        """(N, K) matrix from control points to the derivative of an order 0 to 5 at t (N,), s."""
        return np.asarray(self._curves[order](np.clip(t, 0.0, self.duration)))

    @cached_property
    def bernstein(self) -> tuple[Array, ...]:
        """(m, K) matrices from control points to Bernstein coefficients of the derivatives of order 0 to 3."""
        return tuple(self._bernstein(order) for order in range(4))

    def _bernstein(self, order: int) -> Array:
        powers = range(DEGREE - order, -1, -1)
        taylor = np.array([self.values(self.edges[:-1], order + k) / factorial(k) for k in powers])
        matrix = BPoly.from_power_basis(PPoly(taylor, self.edges)).c.swapaxes(0, 1).reshape(-1, len(self))
        return np.where(np.abs(matrix) < 1e-12 * np.abs(matrix).max(), 0.0, matrix)  # rounding errors touch limits


@dataclass(frozen=True)
class SplineTrajectory:
    """A motion as a spline."""

    basis: SplineBasis
    control: Array  # (K, n) control points, rad (m for a prismatic joint)
    payload: str = ""  # label of the payload; empty for none

    def __post_init__(self) -> None:
        object.__setattr__(self, "control", frozen(self.control, (len(self.basis), None), "control"))

    @property
    def duration(self) -> float:
        """Duration, s."""
        return self.basis.duration

    def motion(self, t: Array) -> Motion:
        """Positions and their exact derivatives at t (N,), s; beyond the ends, the end poses."""
        q, dq, ddq = (self.basis.values(t, order) @ self.control for order in range(3))
        return Motion(t, q, dq, ddq, 0.0, np.array(self.payload))

    def bounds(self, order: int) -> tuple[Array, Array]:
        """(n,) lower and upper bound of a derivative at all times: its least and largest Bernstein coefficient."""
        coefficients = self.basis.bernstein[order] @ self.control
        return coefficients.min(axis=0), coefficients.max(axis=0)

    def speeds(self) -> Array:
        """(M, n) upper bounds of the speeds in each piece of the basis, rad/s."""
        speeds = np.abs(self.basis.bernstein[1] @ self.control)
        return np.asarray(speeds.reshape(len(self.basis.edges) - 1, DEGREE, -1).max(axis=1))


def at_rest(basis: SplineBasis, pose: Array, payload: str = "") -> SplineTrajectory:
    """The motion that stays at a pose."""
    return SplineTrajectory(basis, np.tile(pose, (len(basis), 1)), payload)


@dataclass(frozen=True)
class Feasibility:
    """Constraints on a motion; inf for no limit."""

    posterior: GaussianPosterior | None  # predicts efforts; None: efforts have no limit
    lower: Array  # (n,) rad
    upper: Array  # (n,) rad
    rates: Array  # (3, n) largest velocity, acceleration and jerk
    effort: Array  # (n,) N m of the actuators
    clearance: CollisionModel | None  # None: collisions are not checked

    @classmethod
    def of(
        cls, posterior: GaussianPosterior | None, limits: MotionLimits, clearance: CollisionModel | None
    ) -> Feasibility:
        """From limits; without a result, position limits have one number per joint."""
        n = np.size(limits.lower) if posterior is None else posterior.model.robot.n_joints
        each = [np.full(n, np.inf if limit is None else limit, dtype=float) for limit in vars(limits).values()]
        lower, upper, *rates, effort = each
        return cls(posterior, lower, upper, np.array(rates), effort, clearance)

    def _between(self, order: int) -> tuple[Array, Array]:
        return (-self.rates[order - 1], self.rates[order - 1]) if order else (self.lower, self.upper)

    def feasible_share(self, trajectory: SplineTrajectory, step: Array) -> float:
        """Largest share, 0 to 1, of a step (K, n) of the control points within position to jerk limits.

        Zero if the motion is at a limit already and the step leads beyond it.
        """
        share = float(step.any())
        for order, matrix in enumerate(trajectory.basis.bernstein):
            lower, upper = self._between(order)
            at, by = matrix @ trajectory.control, matrix @ step
            distance = np.where(by > 0.0, upper - at, at - lower)
            moves = np.abs(by) > _ROUNDING * np.abs(by).max()
            share = min(share, float((distance[moves] / np.abs(by[moves])).min(initial=np.inf)))
        return share if share > TUNING.least_step else 0.0

    def within_limits(self, trajectory: SplineTrajectory) -> bool:
        """Whether position, velocity, acceleration and jerk are within limits at every instant."""
        for order in range(4):
            (least, largest), (lower, upper) = trajectory.bounds(order), self._between(order)
            slack = _ROUNDING * np.where(np.isfinite(upper), np.maximum(np.abs(lower), np.abs(upper)), 1.0)
            if np.any(least < lower - slack) or np.any(largest > upper + slack):
                return False
        return True

    def effort_band(self, motion: Motion) -> tuple[Array, Array]:
        """(N, n) predicted efforts, N m, and their standard deviations without noise and without gain errors."""
        posterior = self.posterior
        assert posterior is not None
        r = len(posterior.coefficients)
        columns = posterior.columns(motion)[:, :, :r]
        return columns @ posterior.mean[:r], np.asarray(np.linalg.norm(columns @ posterior.root[:r], axis=2))

    @property
    def has_effort_limits(self) -> bool:
        """Whether any effort has a limit."""
        return self.posterior is not None and bool(np.isfinite(self.effort).any())

    def keeps_effort_limits(self, trajectory: SplineTrajectory, start: float = 0.0, end: float | None = None) -> bool:
        """Whether efforts are within limits from `start` to `end`, s, between samples too."""
        return not self.has_effort_limits or bool((self.largest_efforts(trajectory, start, end) <= self.effort).all())

    def largest_efforts(self, trajectory: SplineTrajectory, start: float = 0.0, end: float | None = None) -> Array:
        """(n,) largest |effort| of a motion with its band, from `start` to `end`, s.

        Sample times are those of the whole motion, so a window gives the same values as the whole.
        """
        count, last = fine_steps(trajectory.duration), trajectory.duration if end is None else end
        if self.posterior is not None and self.posterior.memory:
            start, last = 0.0, trajectory.duration
        step = trajectory.duration / count
        first = max(0, int(start / step) - _BESIDE)
        every = np.linspace(0.0, trajectory.duration, count + 1)
        at = every[first : int(np.ceil(last / step)) + _BESIDE + 1]
        return largest_efforts(*self.effort_band(trajectory.motion(at)))

    def keeps_distance(self, trajectory: SplineTrajectory, start: float, end: float) -> bool:
        """Whether the robot keeps its least distance from `start` to `end`, s, between samples too."""
        if self.clearance is None:
            return True
        edges = trajectory.basis.edges
        first, last = np.searchsorted(edges, [start + _ROUNDING, end - _ROUNDING]).tolist()
        first = max(first - 1, 0)

        def path(t: Array) -> Array:
            return trajectory.basis.values(t) @ trajectory.control

        return self.clearance.stays_clear(path, edges[first : last + 1], trajectory.speeds()[first:last])

    def is_feasible(self, trajectory: SplineTrajectory, start: float = 0.0, end: float | None = None) -> bool:
        """Whether the motion satisfies all constraints; efforts and distance are checked from `start` to `end`, s."""
        end = trajectory.duration if end is None else end
        within = self.within_limits(trajectory) and self.keeps_effort_limits(trajectory, start, end)
        return within and self.keeps_distance(trajectory, start, end)


def fine_steps(duration: float) -> int:
    """Steps of about `TUNING.effort_step` in a duration, s."""
    return max(2, int(np.ceil(duration / TUNING.effort_step)))


def largest_efforts(mean: Array, sd: Array) -> Array:
    """(n,) largest |effort| with its band, between samples too, from N >= 3 evenly spaced samples (N, n)."""
    largest = np.zeros(mean.shape[1])
    for side in (mean + TUNING.effort_sds * sd, TUNING.effort_sds * sd - mean):
        bent = np.pad(np.abs(np.diff(side, 2, axis=0)), ((1, 1), (0, 0)), mode="edge")
        between = np.maximum(side[1:], side[:-1]) + 0.125 * np.maximum(bent[1:], bent[:-1])
        largest = np.maximum(largest, between.max(axis=0))
    return largest
