"""Which motions a robot can run: limits that hold at every instant, efforts with their band, and clearance.

A motion that violates a limit is no candidate: steps that lead to one are shortened until they touch the limit of
position, velocity, acceleration or jerk, which are linear in the control points (`bayesid.excitation.splines`), and
refused where they lead to efforts beyond theirs or to a collision.

The effort of joint j may be anything within `BAND` standard deviations of the prediction. Between samples it is bounded
by the larger of its neighbours and their second differences: a curve leaves the chord of its samples by an eighth of
that (Davis, Interpolation and Approximation, 1975, theorem 3.1.1).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from bayesid.arrays import Array
from bayesid.excitation.known import Known
from bayesid.excitation.splines import SplineTrajectory
from bayesid.motion import Motion
from bayesid.simulation.trajectories import MotionLimits

BAND = 4.0
"""Standard deviations of the predicted effort that must lie within the limit: beyond them lie 6e-5 of a normal
distribution, and a motion has some hundred instants at which its efforts are independent."""
_TOUCH = 1e-9
"""Relative: rounding of what touches a limit."""
FINE = 0.005
"""s between the samples at which efforts are judged. Friction turns round in some milliseconds, a corner that no second
difference shows: with 10 ms bounds missed up to 0.9 % of the efforts of random motions, with these none of them
(`tests/excitation/test_feasible.py`)."""
_COARSE = 4
"""Of these samples, every so many are judged first: most motions that are refused are refused by them."""
_INSTANT = 1e-9
"""s, rounding of instants."""
_SHARE_BETWEEN = 0.125
"""Of a second difference, by which a curve may leave the chord."""


_BESIDE = 3
"""Samples beside a window: what is said of the time between two samples hangs on four of them."""


class Clearance(Protocol):
    """What tells whether a robot touches itself or its surroundings (`bayesid.robot.collision.CollisionModel`)."""

    @property
    def margin(self) -> float:
        """Least distance that is kept, m."""
        ...

    @property
    def source(self) -> str:
        """What the shapes are, in a sentence."""
        ...

    @property
    def not_watched(self) -> tuple[str, ...]:
        """Pairs whose distances do not count, and why, in sentences."""
        ...

    def nearest(self, q: Array) -> tuple[float, tuple[str, str]]:
        """The least distance of a pose (n,), m, and whose it is."""
        ...

    def stays_clear(self, path: Callable[[Array], Array], t: Array, speed: Array) -> bool:
        """Whether a path (N,) -> (N, n), in each of K intervals between t (K + 1,) no faster than (K, n), is clear."""
        ...

    def distance(self, q: Array) -> Array:
        """(N,) least distance, m, at poses (N, n)."""
        ...


@dataclass(frozen=True)
class Feasibility:
    """What a motion must keep.

    Attributes:
        known: the result that predicts efforts.
        lower: (n,) rad.
        upper: (n,) rad.
        rates: (3, n) largest velocity, acceleration and jerk; inf where there is no limit.
        effort: (n,) N m of the actuators; inf where there is no limit.
        clearance: of the robot; None where nothing tells.
    """

    known: Known
    lower: Array
    upper: Array
    rates: Array
    effort: Array
    clearance: Clearance | None

    @classmethod
    def of(cls, known: Known, limits: MotionLimits, clearance: Clearance | None) -> Feasibility:
        """By limits with one number for each joint."""
        n = known.model.robot.n_joints
        none = np.full(n, np.inf)
        rates = [limits.velocity, limits.acceleration, none if limits.jerk is None else limits.jerk]
        effort = none if limits.effort is None else np.broadcast_to(limits.effort, n).astype(float)
        each = np.array([np.broadcast_to(rate, n) for rate in rates], dtype=float)
        lower, upper = (np.broadcast_to(limit, n).astype(float) for limit in (limits.lower, limits.upper))
        return cls(known, lower, upper, each, effort, clearance)

    def shortened(self, trajectory: SplineTrajectory, step: Array) -> float:
        """How much, from 0 to 1, of a step (K, n) of the control points stays within position, velocity and so on."""
        moved = np.flatnonzero(step.any(axis=0))
        share = float(len(moved) > 0)
        for order, matrix in enumerate(trajectory.basis.bernstein):
            if not len(moved) or (order and not np.isfinite(self.rates[order - 1, moved]).any()):
                continue
            lower, upper = self._between(order)
            at, by = matrix @ trajectory.control[:, moved], matrix @ step[:, moved]
            room = np.where(by > 0.0, upper[moved] - at, at - lower[moved])
            with np.errstate(divide="ignore", invalid="ignore"):
                shares = np.where(by != 0.0, np.maximum(room, 0.0) / np.abs(by), np.inf)
            share = min(share, float(shares.min()))
        return share

    def _between(self, order: int) -> tuple[Array, Array]:
        if order == 0:
            return self.lower, self.upper
        return -self.rates[order - 1], self.rates[order - 1]

    def within_limits(self, trajectory: SplineTrajectory) -> bool:
        """Whether position, velocity, acceleration and jerk hold at every instant."""
        for order in range(4):
            (least, largest), (lower, upper) = trajectory.bounds(order), self._between(order)
            slack = _TOUCH * np.where(np.isfinite(upper), np.maximum(np.abs(lower), np.abs(upper)), 1.0)
            if np.any(least < lower - slack) or np.any(largest > upper + slack):
                return False
        return True

    def effort_band(self, motion: Motion) -> tuple[Array, Array]:
        """(N, n) predicted efforts, N m, and their standard deviations, noise apart: not as gains have them read."""
        known, r = self.known, len(self.known.coefficients)
        columns = known.columns(motion)[:, :, :r]
        return columns @ known.mean[:r], np.asarray(np.linalg.norm(columns @ known.root[:r], axis=2))

    @property
    def limits_effort(self) -> bool:
        """Whether any effort has a limit."""
        return bool(np.isfinite(self.effort).any())

    def bears(self, trajectory: SplineTrajectory, start: float = 0.0, end: float | None = None) -> bool:
        """Whether efforts keep their limits from one instant to another, s, and between samples."""
        if not self.limits_effort:
            return True
        mean, sd = self.effort_band(trajectory.motion(self._judged_at(trajectory, start, end)[::_COARSE]))
        if (np.abs(mean) + BAND * sd > self.effort).any():
            return False
        return bool((self.largest_efforts(trajectory, start, end) <= self.effort).all())

    def largest_efforts(self, trajectory: SplineTrajectory, start: float = 0.0, end: float | None = None) -> Array:
        """(n,) largest |effort| with its band where a motion has changed from one instant to another, s."""
        return largest_efforts(*self.effort_band(trajectory.motion(self._judged_at(trajectory, start, end))))

    def _judged_at(self, trajectory: SplineTrajectory, start: float, end: float | None) -> Array:
        """(N,) instants, s, of those of the whole motion, so that windows and the whole say the same."""
        count, last = fine_steps(trajectory.duration), trajectory.duration if end is None else end
        if self.known.memory:
            start, last = 0.0, trajectory.duration
        step = trajectory.duration / count
        first = max(0, int(start / step) - _BESIDE)
        every = np.linspace(0.0, trajectory.duration, count + 1)
        return every[first : int(np.ceil(last / step)) + _BESIDE + 1]

    def clear(self, trajectory: SplineTrajectory, start: float, end: float) -> bool:
        """Whether the robot keeps clear from one instant to another, s, and between them."""
        if self.clearance is None:
            return True
        edges = trajectory.basis.edges
        first, last = np.searchsorted(edges, [start + _INSTANT, end - _INSTANT]).tolist()
        first = max(first - 1, 0)

        def path(t: Array) -> Array:
            return trajectory.basis.values(t) @ trajectory.control

        return self.clearance.stays_clear(path, edges[first : last + 1], trajectory.speeds()[first:last])

    def possible(self, trajectory: SplineTrajectory, start: float = 0.0, end: float | None = None) -> bool:
        """Whether a robot can run the motion, from one instant to another where all else is known to be possible."""
        end = trajectory.duration if end is None else end
        return (
            self.within_limits(trajectory) and self.bears(trajectory, start, end) and self.clear(trajectory, start, end)
        )


def fine_steps(duration: float) -> int:
    """Steps of about `FINE` in a duration, s."""
    return max(2, int(np.ceil(duration / FINE)))


def largest_efforts(mean: Array, sd: Array) -> Array:
    """(n,) largest |effort| with its band, between samples too, of those at N even instants (N, n), three or more."""
    largest = np.zeros(mean.shape[1])
    for side in (mean + BAND * sd, BAND * sd - mean):
        bent = np.pad(np.abs(np.diff(side, 2, axis=0)), ((1, 1), (0, 0)), mode="edge")
        between = np.maximum(side[1:], side[:-1]) + _SHARE_BETWEEN * np.maximum(bent[1:], bent[:-1])
        largest = np.maximum(largest, between.max(axis=0))
    return largest
