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
_SHARE_BETWEEN = 0.125
"""Of a second difference, by which a curve may leave the chord."""


_BESIDE = 3
"""Samples beside a window: what is said of the time between two samples hangs on four of them."""


class Clearance(Protocol):
    """What tells whether a robot touches itself or its surroundings."""

    def stays_clear(self, path: Callable[[Array], Array], t: Array, speed: Array, margin: float) -> bool:
        """Whether the path (N,) -> (N, n), no faster than speed (n,), keeps the margin between all instants t."""
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
        margin: least distance, m.
    """

    known: Known
    lower: Array
    upper: Array
    rates: Array
    effort: Array
    clearance: Clearance | None
    margin: float

    @classmethod
    def of(cls, known: Known, limits: MotionLimits, clearance: Clearance | None, margin: float) -> Feasibility:
        """By limits with one number for each joint."""
        n = known.model.robot.n_joints
        none = np.full(n, np.inf)
        rates = [limits.velocity, limits.acceleration, none if limits.jerk is None else limits.jerk]
        effort = none if limits.effort is None else np.broadcast_to(limits.effort, n).astype(float)
        each = np.array([np.broadcast_to(rate, n) for rate in rates], dtype=float)
        lower, upper = (np.broadcast_to(limit, n).astype(float) for limit in (limits.lower, limits.upper))
        return cls(known, lower, upper, each, effort, clearance, margin)

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
        """(N, n) predicted efforts, N m, and their standard deviations, noise apart."""
        columns = self.known.columns(motion)
        return columns @ np.concatenate([self.known.mean[: len(self.known.coefficients)], self._no_gains]), _sd(
            columns, self.known.root
        )

    @property
    def _no_gains(self) -> Array:
        return np.zeros(len(self.known.gains))

    @property
    def limits_effort(self) -> bool:
        """Whether any effort has a limit."""
        return bool(np.isfinite(self.effort).any())

    def bears(self, trajectory: SplineTrajectory, start: float = 0.0, end: float | None = None) -> bool:
        """Whether efforts keep their limits from one instant to another, s, and between samples."""
        return not self.limits_effort or bool((self.largest_efforts(trajectory, start, end) <= self.effort).all())

    def largest_efforts(self, trajectory: SplineTrajectory, start: float = 0.0, end: float | None = None) -> Array:
        """(n,) largest |effort| with its band where a motion has changed from one instant to another, s.

        Samples are those of the whole motion, so that windows and the whole say the same.
        """
        count, last = fine_steps(trajectory.duration), trajectory.duration if end is None else end
        if self.known.memory:
            start, last = 0.0, trajectory.duration
        step = trajectory.duration / count
        first = max(0, int(start / step) - _BESIDE)
        t = np.linspace(0.0, trajectory.duration, count + 1)[first : int(np.ceil(last / step)) + _BESIDE + 1]
        return largest_efforts(*self.effort_band(trajectory.motion(t)))

    def clear(self, trajectory: SplineTrajectory, start: float, end: float) -> bool:
        """Whether the robot keeps clear from one instant to another, s, and between them."""
        if self.clearance is None:
            return True
        speed = np.max(np.abs(trajectory.bounds(1)), axis=0)

        def path(t: Array) -> Array:
            return trajectory.basis.values(t) @ trajectory.control

        return self.clearance.stays_clear(path, np.array([start, end]), speed, self.margin)

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


def _sd(columns: Array, root: Array) -> Array:
    """(N, n) of efforts whose columns are (N, n, R)."""
    return np.asarray(np.linalg.norm(columns @ root, axis=2))
