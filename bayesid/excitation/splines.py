"""Motions of a uniform B-spline of degree five, from rest to rest at given poses, whose bounds hold at every instant.

q(t) = sum_k B_k(t) c_k with control points c_k (de Boor, A Practical Guide to Splines, 1978, chapter IX). Between two
knots it is a polynomial, and so are its derivatives; a polynomial lies between the least and the largest of its
Bernstein coefficients (Farouki, The Bernstein polynomial basis: a centennial retrospective, 2012, section 4), which are
linear in the control points. So what holds for these coefficients of positions, velocities, accelerations and jerks
holds at every instant, between samples too. The first three and the last three control points are the poses at both
ends, which leaves no velocity and no acceleration there. A control point moves the curve for six knots alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from bayesid.arrays import Array, frozen
from bayesid.motion import Motion

DEGREE = 5
"""The jerk is continuous, and its derivative bounded."""
ENDS = 3
"""Control points at each end that are its pose: position, no velocity, no acceleration."""
SPACING = 0.25
"""s between knots: a joint may turn round every half second, as fast as accelerations of usual arms allow. A round
number; not studied."""
_FEWEST = 4
"""Knots of the shortest motion."""
_HALVES = 2
"""Parts of the time between two knots with coefficients of their own: with two, bounds of positions, velocities,
accelerations and jerks are too wide by 4, 9, 15 and 14 % of their range at most (`tests/excitation/test_splines.py`),
and by a third of that for most control points."""
_ROUNDING = 1e-12
"""Of a weight in a Bernstein coefficient, relative to the largest: beyond that of the arithmetic, 1e-16, and far below
the least that is not zero, 2.6e-4."""


@dataclass(frozen=True)
class SplineBasis:
    """The basis of K control points over a duration.

    Attributes:
        duration: s.
        spacing: of the knots, s, about.
    """

    duration: float
    spacing: float = SPACING

    @cached_property
    def knots(self) -> Array:
        """(K + 6,) s; the first and the last six times."""
        pieces = max(_FEWEST, round(self.duration / self.spacing))
        inner = np.linspace(0.0, self.duration, pieces + 1)
        return np.concatenate([np.zeros(DEGREE), inner, np.full(DEGREE, self.duration)])

    def __len__(self) -> int:
        return len(self.knots) - DEGREE - 1

    @cached_property
    def places(self) -> Array:
        """(K,) s, where the curve is about at its control points, the means of inner knots (de Boor, chapter XI)."""
        return np.array([self.knots[k + 1 : k + DEGREE + 1].mean() for k in range(len(self))])

    @cached_property
    def _differences(self) -> tuple[Array, ...]:
        """(K - d, K) what takes control points to those of the d-th derivative, d = 0 to 3 (de Boor, chapter X)."""
        maps = [np.eye(len(self))]
        for order in range(1, 4):
            degree, knots = DEGREE - order + 1, self.knots[order - 1 : len(self.knots) - order + 1]
            span = knots[degree + 1 : -1] - knots[1 : -degree - 1]
            maps.append(degree / span[:, None] * np.diff(maps[-1], axis=0))
        return tuple(maps)

    @cached_property
    def edges(self) -> Array:
        """(M + 1,) s, between which Bernstein coefficients are."""
        knots = np.unique(self.knots)
        return np.interp(np.arange(_HALVES * (len(knots) - 1) + 1) / _HALVES, np.arange(len(knots)), knots)

    @cached_property
    def bernstein(self) -> tuple[Array, ...]:
        """(m, K) what takes control points to Bernstein coefficients of the d-th derivative, d = 0 to 3."""
        return tuple(self._bernstein(order) for order in range(4))

    def _bernstein(self, order: int) -> Array:
        degree, edges = DEGREE - order, self.edges
        at = (np.arange(degree + 1) + 0.5) / (degree + 1)
        power = np.arange(degree + 1)
        of_polynomial = scipy.special.binom(degree, power) * at[:, None] ** power * (1.0 - at[:, None]) ** power[::-1]
        t = (edges[:-1, None] + np.diff(edges)[:, None] * at).ravel()
        values = self.values(t, order).reshape(len(edges) - 1, degree + 1, -1)
        matrix = np.linalg.solve(of_polynomial, values).reshape(-1, len(self))
        matrix[np.abs(matrix) < _ROUNDING * np.abs(matrix).max()] = 0.0  # else it would touch limits where it is zero
        return matrix

    def values(self, t: Array, order: int = 0) -> Array:
        """(N, K) what takes control points to the d-th derivative, d = 0 to 3, at instants t (N,)."""
        knots = self.knots[order : len(self.knots) - order]
        inside = np.clip(t, 0.0, self.duration)
        own = scipy.interpolate.BSpline.design_matrix(inside, knots, DEGREE - order)
        values: Array = own @ self._differences[order]
        return values


@dataclass(frozen=True)
class SplineTrajectory:
    """A motion.

    Attributes:
        basis: of its control points.
        control: (K, n) rad (m for a joint that slides).
        payload: label of what the flange carries; empty where it carries nothing.
    """

    basis: SplineBasis
    control: Array
    payload: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "control", frozen(self.control, (len(self.basis), None), "control"))

    @property
    def duration(self) -> float:
        """S."""
        return self.basis.duration

    def motion(self, t: Array) -> Motion:
        """Positions and their exact derivatives at the instants t (N,), s; the pose of an end beyond it.

        Example:
            >>> motion = design.trajectory.motion(np.array([0.0, 0.5]))
            >>> bool((motion.dq[0] == 0.0).all())  # from rest
            True
        """
        q, dq, ddq = (self.basis.values(t, order) @ self.control for order in range(3))
        return Motion(t, q, dq, ddq, 0.0, np.array(self.payload))

    def bounds(self, order: int) -> tuple[Array, Array]:
        """(n,) least and largest Bernstein coefficient of the d-th derivative, which lies between them always."""
        coefficients = self.basis.bernstein[order] @ self.control
        return coefficients.min(axis=0), coefficients.max(axis=0)

    def speeds(self) -> Array:
        """(M, n) largest speeds between each two of the basis's edges, rad/s."""
        coefficients = self.basis.bernstein[1] @ self.control
        speeds: Array = np.abs(coefficients).reshape(len(self.basis.edges) - 1, -1, self.control.shape[1]).max(axis=1)
        return speeds


def at_rest(basis: SplineBasis, pose: Array, payload: str = "") -> SplineTrajectory:
    """The motion that stays where it is."""
    return SplineTrajectory(basis, np.tile(pose, (len(basis), 1)), payload)
