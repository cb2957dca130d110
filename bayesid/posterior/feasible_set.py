"""The feasible set: a convex region, its centre, and draws along a line through it.

The region is an intersection of half spaces, rows theta + offset >= 0, and of positive definite 4 x 4 matrices affine
in theta (the pseudo-inertias). Equalities confine theta to a plane, theta = origin + N y (`bayesid.effects.plane`), and
y moves. All functions are vectorised over W walkers, the last axis of every array.

The best parameters are on the region's edge, where the Hessian does not describe the posterior. The minimum of the same
quadratic function with a logarithmic barrier,

    phi(theta) = theta' A theta / 2 - b' theta - sum log slack - sum log det P,

lies about as deep inside as the posterior, and the inverse Hessian of phi there is near the posterior's covariance. phi
is self-concordant, so Newton's method with a line search finds its minimum from any inner point (Boyd and Vandenberghe
2004, 9.6).

A line meets a convex region in an interval. A Gaussian along the line is drawn *exactly* inside it without computing
the interval's ends: draw on a bracket that covers the interval; if the draw is outside of the region, it becomes the
bracket's new end; repeat. Each try needs a 4 x 4 elimination, where the ends would need generalised eigenvalues.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.random import RandomState
from scipy.linalg import cho_solve
from scipy.special import log_ndtr, ndtri_exp

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects.parameters import Cone
from bayesid.effects.plane import Plane
from bayesid.posterior.tuning import TUNING
from bayesid.robot.inertia import PSEUDO_INERTIA_BASIS
from bayesid.signs.search.bounds import cholesky

_TRIANGLE = ((0, 0), (1, 0), (2, 0), (3, 0), (1, 1), (2, 1), (3, 1), (2, 2), (3, 2), (3, 3))
"""Order of a symmetric matrix's stored entries: columns of the lower triangle."""
_DIAGONAL = np.array([0, 4, 7, 9])
"""Indices of the diagonal entries in that order."""
_BASIS = np.array([PSEUDO_INERTIA_BASIS[:, i, j] for i, j in _TRIANGLE])
"""(10, 10) derivatives of a pseudo-inertia's entries, in that order, by a body's parameters."""


@dataclass(frozen=True)
class FeasibleSet:
    """A convex region of P parameters."""

    rows: Array  #: (m, P) of the half spaces, including the diagonals of the matrices
    offset: Array  #: (m,) rows theta + offset >= 0
    entries: Array  #: (10, b, P) the lower triangles of b matrices, by column
    constant: Array  #: (10, b) their constant part
    within: Plane | None = None  #: plane of theta; None for the whole space

    @classmethod
    def of(cls, cone: Cone, rows: Array | None = None, offset: Array | None = None) -> FeasibleSet:
        """The cone with stated constraints and further half spaces rows (m, P) theta + offset (m,) >= 0."""
        entries = np.zeros((10, len(cone.bodies), cone.size))
        for b, body in enumerate(cone.bodies):
            entries[:, b, body] = _BASIS
        constant, signs = np.zeros((10, len(cone.bodies))), np.eye(cone.size)[cone.nonnegative]
        windows = np.empty((0, cone.size)) if rows is None else rows
        bounds = np.zeros(len(windows)) if offset is None else offset
        if (stated := cone.stated) is not None:
            windows, bounds = np.concatenate([windows, stated.rows]), np.concatenate([bounds, stated.offset])
            entries = np.concatenate([entries, _triangles(stated.basis)], axis=1)
            constant = np.concatenate([constant, _triangles(stated.constant)], axis=1)
        diagonals = entries[_DIAGONAL].reshape(-1, cone.size)
        return cls(
            np.concatenate([signs, windows, diagonals]),
            np.concatenate([np.zeros(len(signs)), bounds, constant[_DIAGONAL].ravel()]),
            entries,
            constant,
            cone.plane(),
        )

    @cached_property
    def plane(self) -> Plane:
        """The plane of theta."""
        return Plane.whole(self.size) if self.within is None else self.within

    @cached_property
    def flat(self) -> FeasibleSet:
        """The region of y (d,), without equalities."""
        origin, basis = self.plane.origin, self.plane.basis
        return FeasibleSet(
            self.rows @ basis,
            self.offset + self.rows @ origin,
            self.entries @ basis,
            self.constant + self.entries @ origin,
        )

    @property
    def size(self) -> int:
        """Number of parameters P."""
        return int(self.rows.shape[1])

    def relaxed(self, share: float, inner: Array) -> FeasibleSet:
        """The wider region of theta with (theta + share * inner) / (1 + share) in this one; inner (P,) lies inside."""
        return replace(
            self,
            offset=self.offset + share * self.slack(inner[:, None])[:, 0],
            constant=self.constant + share * self.matrices(inner[:, None])[..., 0],
        )

    def excess(self, theta: Array, inner: Array) -> Array:
        """(W,) least share of `relaxed` that includes theta (P, W); negative inside, -1 at `inner` (P,)."""
        needed = -np.min(self.slack(theta) / self.slack(inner[:, None]), axis=0, initial=np.inf)
        if self.entries.shape[1] == 0:
            return needed
        root = self._white(inner)
        matrices = self.full(np.moveaxis(self.matrices(theta), 2, 0))  # (W, b, 4, 4)
        least = np.linalg.eigvalsh(root @ matrices @ root.swapaxes(1, 2))[..., 0]
        return np.maximum(needed, -least.min(axis=1))

    def slack(self, theta: Array) -> Array:
        """(m, W) slack rows theta + offset of theta (P, W)."""
        return self.rows @ theta + self.offset[:, None]

    def matrices(self, theta: Array) -> Array:
        """(10, b, W) triangles of the matrices at theta (P, W)."""
        return self.entries @ theta + self.constant[:, :, None]

    @cached_property
    def basis(self) -> Array:
        """(b, P, 4, 4) derivative of the matrices by each parameter."""
        return self.full(np.moveaxis(self.entries, 2, 0)).swapaxes(0, 1)

    @staticmethod
    def full(triangles: Array) -> Array:
        """(..., b, 4, 4) symmetric matrices from triangles (..., 10, b)."""
        matrices = np.empty((*triangles.shape[:-2], triangles.shape[-1], 4, 4))
        for k, (i, j) in enumerate(_TRIANGLE):
            matrices[..., i, j] = matrices[..., j, i] = triangles[..., k, :]
        return matrices

    def _white(self, theta: Array) -> Array:
        """(b, 4, 4) inverse Cholesky factors of the matrices at theta (P,) inside."""
        return np.linalg.inv(np.linalg.cholesky(self.full(self.matrices(theta[:, None])[..., 0])))

    @cached_property
    def blocks(self) -> Integers:
        """(P,) index of the matrix with each parameter; a further label for parameters in none."""
        shows = np.any(self.entries != 0.0, axis=0)
        if not len(shows):
            return np.zeros(self.size, dtype=np.int64)
        return np.where(shows.any(axis=0), shows.argmax(axis=0), len(shows))

    @property
    def nonnegative(self) -> Mask:
        """(P,) whether a parameter alone is bounded below by zero."""
        alone = (np.count_nonzero(self.rows, axis=1) == 1) & (self.rows.max(axis=1, initial=0.0) > 0.0)
        bounded: Mask = self.rows[alone & (self.offset == 0.0)].any(axis=0)
        return bounded

    def contains(self, theta: Array) -> Mask:
        """(W,) whether theta (P, W) lies strictly inside."""
        inside: Mask = np.all(self.slack(theta) > 0.0, axis=0)
        if self.entries.shape[1] == 0:
            return inside
        with np.errstate(all="ignore"):
            return inside & _positive_definite(self.matrices(theta))

    def barrier(self, theta: Array) -> float:
        """Minus the logs of slack and determinants at theta (P,); inf outside."""
        if not self.contains(theta[:, None])[0]:
            return np.inf
        logs = np.linalg.slogdet(self.full(self.matrices(theta[:, None])[..., 0]))[1]
        return -float(np.log(self.slack(theta[:, None])).sum() + logs.sum())

    def barrier_derivatives(self, theta: Array) -> tuple[Array, Array]:
        """Gradient (P,) and Hessian (P, P) of the barrier at theta (P,) inside."""
        scaled, root = self.rows / self.slack(theta[:, None]), self._white(theta)
        white = root[:, None] @ self.basis @ root.swapaxes(1, 2)[:, None]  # (b, P, 4, 4), symmetric
        slope = -scaled.sum(axis=0) - np.einsum("bpii->p", white)
        flat = white.swapaxes(0, 1).reshape(len(theta), -1)
        return slope, scaled.T @ scaled + flat @ flat.T  # sums of squares stay positive semidefinite under rounding


def _triangles(matrices: Array) -> Array:
    """(10, b, ...) lower triangles of symmetric matrices (b, ..., 4, 4)."""
    rows, columns = zip(*_TRIANGLE, strict=True)
    return np.moveaxis(matrices[..., rows, columns], -1, 0)


def _positive_definite(triangles: Array) -> Mask:
    """(W,) whether lower triangles (10, b, W) are positive definite, by the pivots of L D L'."""
    a = triangles[1:4]
    factor = a / triangles[0]
    second = triangles[4:7] - factor * a[0]
    third = triangles[7:9] - factor[1:] * a[1]
    last = triangles[9] - factor[2] * a[2]
    factor = second[1:] / second[0]
    third -= factor * second[1]
    last -= factor[1] * second[2]
    last -= third[1] ** 2 / third[0]
    pivots = np.minimum(np.minimum(triangles[0], second[0]), np.minimum(third[0], last))
    positive: Mask = pivots.min(axis=0) > 0.0
    return positive


@dataclass(frozen=True)
class Centre:
    """The minimum of phi."""

    theta: Array  #: (P,) strictly inside the region
    covariance: Array  #: (d, d) inverse of phi's Hessian there, for the region's y


def barrier_minimum(region: FeasibleSet, precision: Array, linear: Array, start: Array) -> Centre:
    """Minimum of phi for A (P, P), positive definite, and b (P,), from a start (P,) strictly inside.

    Raises:
        LinAlgError: the Hessian is numerically singular.
    """
    plane, region = region.plane, region.flat
    linear = (linear - precision @ plane.origin) @ plane.basis
    precision, start = plane.basis.T @ precision @ plane.basis, plane.coordinates(start)

    def phi(theta: Array) -> float:
        return float(0.5 * theta @ precision @ theta - linear @ theta + region.barrier(theta))

    theta, value = start, phi(start)
    for _ in range(300):  # Newton's method needs a few dozen
        slope, curvature = region.barrier_derivatives(theta)
        gradient = precision @ theta - linear + slope
        step = -_inverse(precision + curvature) @ gradient
        decrement = -float(gradient @ step)
        if decrement < 1e-6:  # twice the distance from the minimum, nats (Boyd and Vandenberghe 2004, 9.6.3)
            break
        length, lower = 1.0, phi(theta + step)
        while lower > value - 0.25 * length * decrement and length > 1e-12:
            length *= 0.5
            lower = phi(theta + length * step)
        if lower >= value:
            break  # rounding
        theta, value = theta + length * step, lower
    return Centre(plane.point(theta), _inverse(precision + region.barrier_derivatives(theta)[1]))


def factor(matrix: Array) -> Array:
    """(P, P) lower triangular L with L L' = matrix, up to rounding.

    The matrix is positive definite, in mixed units: its rows may differ by many orders of magnitude.

    Raises:
        LinAlgError: the matrix is numerically singular.
    """
    scale = np.sqrt(np.diag(matrix))
    lower: Array = scale[:, None] * cholesky(matrix / np.outer(scale, scale), most=1e-9)
    return lower


def _inverse(matrix: Array) -> Array:
    inverse: Array = cho_solve((factor(matrix), True), np.eye(len(matrix)))
    return 0.5 * (inverse + inverse.T)


def draw_on_line(
    slack: Array,
    matrices: Array,
    row: Array,
    matrix: Array,
    slope: Array,
    curvature: Array,
    random: RandomState,
    idle: float = 0.0,
) -> Array:
    """(W,) steps t along one direction, drawn from exp(slope t - curvature t^2 / 2) inside the region (:eq:`chord`).

    Args:
        slack: (m, W) of the half spaces at t = 0, positive.
        matrices: (10, b, W) at t = 0, positive definite.
        row: (m,) change of the slack per unit of t.
        matrix: (10, b) change of the matrices per unit of t.
        slope: (W,) of the log density at t = 0.
        curvature: (W,) positive.
        random: the random state.
        idle: share of the walkers that may stay (t = 0): the last ones, with the longest brackets relative to the
            interval. Success of a try depends on the line, not on the walker's position on it, so the distribution of
            all walkers does not change.
    """
    bodies = np.flatnonzero(matrix.any(axis=0))
    current, change = matrices if len(bodies) == matrices.shape[1] else matrices[:, bodies], matrix[:, bodies, None]
    brackets = Brackets.of(*_bracket(slack, row), slope, curvature)
    step, log_share = brackets.draw(random)
    if not len(bodies):
        return step
    walkers, t = np.arange(len(slope)), step  # walkers that have not moved yet, and their tries
    with np.errstate(all="ignore"):  # as in `contains`
        for _ in range(TUNING.most_tries):
            (outside,) = np.nonzero(~_positive_definite(current + t * change))
            walkers = walkers[outside]
            if len(walkers) <= idle * len(slope):
                break
            current, brackets = current[..., outside], brackets.shortened(outside, t, log_share)
            t, log_share = brackets.draw(random)
            step[walkers] = t
    step[walkers] = 0.0
    return step


def _bracket(slack: Array, row: Array) -> tuple[Array, Array]:
    """(W,) ends of the interval on which all half spaces hold."""
    down, up = row < 0.0, row > 0.0
    high = np.min(slack[down] / -row[down, None], axis=0, initial=np.inf)
    low = -np.min(slack[up] / row[up, None], axis=0, initial=np.inf)
    return low, high


@dataclass(frozen=True)
class Brackets:
    """Intervals of W lines, t = 0 in each, and a normal distribution on each.

    Lines are reversed so that t = 0 is in the left half of the normal, where its cumulative probability keeps full
    precision; draws are exact in far tails too.
    """

    #: (7, W) ends of the interval of the (reversed) line, logs of the normal's cumulative probability there, position
    #: of t = 0 on that normal, the sd, and +1, or -1 if reversed
    values: Array

    @classmethod
    def of(cls, low: Array, high: Array, slope: Array, curvature: Array) -> Brackets:
        """Intervals low < 0 < high (W,) and the densities exp(slope t - curvature t^2 / 2)."""
        sd = 1.0 / np.sqrt(curvature)
        place, turn = -np.abs(slope) * sd, np.where(slope < 0.0, -1.0, 1.0)
        low, high = low * turn, high * turn
        first, last = np.minimum(low, high), np.maximum(low, high)
        return cls(np.array([first, last, log_ndtr(place + first / sd), log_ndtr(place + last / sd), place, sd, turn]))

    def draw(self, random: RandomState) -> tuple[Array, Array]:
        """(W,) draws t by inversion, and the logs of the cumulative probability there."""
        first, last, log_first, log_last, place, sd, turn = self.values
        upper = 1.0 - random.random_sample(len(place))
        log_share = log_last + np.log1p(upper * np.expm1(log_first - log_last))
        oriented = np.minimum(np.maximum(sd * (ndtri_exp(log_share) - place), first), last)
        return turn * oriented, log_share

    def shortened(self, chosen: Integers, t: Array, log_share: Array) -> Brackets:
        """Those of the chosen lines, with the end on the side of t moved to t; log_share is that of t."""
        values, log_share = self.values[:, chosen], log_share[chosen]
        oriented = t[chosen] * values[6]
        before = oriented < 0.0
        after = ~before
        for end, beyond in enumerate((before, after)):
            np.copyto(values[end], oriented, where=beyond)
            np.copyto(values[2 + end], log_share, where=beyond)
        return Brackets(values)
