"""Where the parameters may lie: a convex region, and the draws along a line through it.

The region is an intersection of half spaces, rows theta + offset >= 0, and of positive definite 4 x 4 matrices that are
affine in theta (the pseudo-inertias). Everything is vectorised over W walkers, the last axis of every array.

A line through a convex region meets it in an interval. So a Gaussian along the line is drawn *exactly* inside it
without the interval's ends: draw on a bracket that covers the interval; a draw outside of the region moves the
bracket's end to itself, for nothing beyond it lies inside; repeat. That needs a 4 x 4 elimination a try, where the ends
would need generalised eigenvalues.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.special import log_ndtr, ndtri_exp

from bayesid.arrays import Array, Mask
from bayesid.model.inertia import PSEUDO_INERTIA_BASIS
from bayesid.model.parameters import Cone

_TRIANGLE = ((0, 0), (1, 0), (2, 0), (3, 0), (1, 1), (2, 1), (3, 1), (2, 2), (3, 2), (3, 3))
"""Order in which the entries of a symmetric matrix are kept: column after column of the lower triangle."""
_DIAGONAL = np.array([0, 4, 7, 9])
"""Places of the diagonal's entries in that order."""
_BASIS = np.array([PSEUDO_INERTIA_BASIS[:, i, j] for i, j in _TRIANGLE])
"""(10, 10) change of a pseudo-inertia's entries, in that order, with each of a body's parameters."""
_MOST_TRIES = 200
"""A bracket that has shrunk this often is a point; the walker stays. A round number; not studied."""


class Uniforms(Protocol):
    """A source of uniform variables on [0, 1): emcee's random state, or any numpy one."""

    def random_sample(self, size: int | tuple[int, ...]) -> Array:
        """Draws of this shape."""


@dataclass(frozen=True)
class Region:
    """A convex region of P parameters.

    Attributes:
        rows: (m, P) of the half spaces, the diagonals of the matrices among them.
        offset: (m,) rows theta + offset >= 0.
        entries: (10, b, P) the lower triangles of b matrices, by column.
        constant: (10, b) their part that does not depend on theta.
    """

    rows: Array
    offset: Array
    entries: Array
    constant: Array

    @classmethod
    def of(cls, cone: Cone, rows: Array | None = None, offset: Array | None = None) -> Region:
        """The cone, cut by further half spaces rows (m, P) theta + offset (m,) >= 0."""
        entries = np.zeros((10, len(cone.bodies), cone.size))
        for b, body in enumerate(cone.bodies):
            entries[:, b, body] = _BASIS
        signs = np.eye(cone.size)[cone.nonnegative]
        windows = np.empty((0, cone.size)) if rows is None else rows
        bounds = np.zeros(len(windows)) if offset is None else offset
        diagonals = entries[_DIAGONAL].reshape(-1, cone.size)
        return cls(
            np.concatenate([signs, windows, diagonals]),
            np.concatenate([np.zeros(len(signs)), bounds, np.zeros(len(diagonals))]),
            entries,
            np.zeros((10, len(cone.bodies))),
        )

    @property
    def size(self) -> int:
        """Number of parameters P."""
        return int(self.rows.shape[1])

    def relaxed(self, share: float, inner: Array) -> Region:
        """The wider region of all theta with (theta + share * inner) / (1 + share) in this one; inner (P,) is in it."""
        return replace(
            self,
            offset=self.offset + share * self.slack(inner[:, None])[:, 0],
            constant=self.constant + share * self.matrices(inner[:, None])[..., 0],
        )

    def excess(self, theta: Array, inner: Array) -> Array:
        """(W,) the share by which it must be relaxed to hold theta (P, W); negative inside, -1 at `inner` (P,)."""
        needed = -np.min(self.slack(theta) / self.slack(inner[:, None]), axis=0, initial=np.inf)
        if self.entries.shape[1] == 0:
            return needed
        root = np.linalg.inv(np.linalg.cholesky(self.full(self.matrices(inner[:, None])[..., 0])))
        matrices = self.full(np.moveaxis(self.matrices(theta), 2, 0))  # (W, b, 4, 4)
        least = np.linalg.eigvalsh(root @ matrices @ root.swapaxes(1, 2))[..., 0]
        return np.maximum(needed, -least.min(axis=1))

    def slack(self, theta: Array) -> Array:
        """(m, W) rows theta + offset of theta (P, W)."""
        return self.rows @ theta + self.offset[:, None]

    def matrices(self, theta: Array) -> Array:
        """(10, b, W) triangles of the matrices of theta (P, W)."""
        return self.entries @ theta + self.constant[:, :, None]

    @cached_property
    def basis(self) -> Array:
        """(b, P, 4, 4) change of the matrices with each parameter."""
        return self.full(np.moveaxis(self.entries, 2, 0)).swapaxes(0, 1)

    @staticmethod
    def full(triangles: Array) -> Array:
        """(..., b, 4, 4) symmetric matrices of triangles (..., 10, b)."""
        matrices = np.empty((*triangles.shape[:-2], triangles.shape[-1], 4, 4))
        for k, (i, j) in enumerate(_TRIANGLE):
            matrices[..., i, j] = matrices[..., j, i] = triangles[..., k, :]
        return matrices

    @property
    def nonnegative(self) -> Mask:
        """(P,) whether a parameter cannot be negative by itself."""
        alone = (np.count_nonzero(self.rows, axis=1) == 1) & (self.rows.max(axis=1, initial=0.0) > 0.0)
        bounded: Mask = self.rows[alone & (self.offset == 0.0)].any(axis=0)
        return bounded

    def contains(self, theta: Array) -> Mask:
        """(W,) whether theta (P, W) lies strictly inside."""
        inside: Mask = np.all(self.slack(theta) > 0.0, axis=0) & positive_definite(self.matrices(theta))
        return inside


def positive_definite(triangles: Array) -> Mask:
    """(W,) whether all b matrices are positive definite, from their lower triangles (10, b, W): pivots of L D L'."""
    if triangles.shape[1] == 0:
        return np.ones(triangles.shape[2], dtype=bool)
    with np.errstate(all="ignore"):  # after a pivot that is not positive, what follows does not matter
        a = triangles[1:4]
        factor = a / triangles[0]
        second = triangles[4:7] - factor * a[0]
        third = triangles[7:9] - factor[1:] * a[1]
        last = triangles[9] - factor[2] * a[2]
        factor = second[1:] / second[0]
        third -= factor * second[1]
        last = last - factor[1] * second[2]
        last -= third[1] ** 2 / third[0]
        pivots = np.minimum(np.minimum(triangles[0], second[0]), np.minimum(third[0], last))
    positive: Mask = np.all(pivots > 0.0, axis=0)
    return positive


def draw_on_line(
    slack: Array, matrices: Array, row: Array, matrix: Array, slope: Array, curvature: Array, random: Uniforms
) -> Array:
    """(W,) steps t along one direction, drawn from exp(slope t - curvature t^2 / 2) inside the region (:eq:`chord`).

    Args:
        slack: (m, W) of the half spaces at t = 0, positive.
        matrices: (10, b, W) at t = 0, positive definite.
        row: (m,) change of the slack per unit of t.
        matrix: (10, b) change of the matrices per unit of t.
        slope: (W,) of the log density at t = 0.
        curvature: (W,) positive.
        random: where uniform variables come from.
    """
    low, high = _bracket(slack, row)
    sd = 1.0 / np.sqrt(curvature)
    mean = slope / curvature
    step = np.zeros(len(slope))
    walkers = np.arange(len(slope))  # that have not moved yet
    bodies = np.flatnonzero(np.any(matrix != 0.0, axis=0))
    current, change = matrices if len(bodies) == matrices.shape[1] else matrices[:, bodies], matrix[:, bodies, None]
    for _ in range(_MOST_TRIES):
        t = draw_between(low, high, mean, sd, random)
        inside = positive_definite(current + t * change)
        if inside.all():
            step[walkers] = t
            break
        step[walkers[inside]] = t[inside]
        outside = ~inside
        walkers, t, mean, sd, current = walkers[outside], t[outside], mean[outside], sd[outside], current[..., outside]
        low, high = np.where(t < 0.0, t, low[outside]), np.where(t > 0.0, t, high[outside])
    return step


def _bracket(slack: Array, row: Array) -> tuple[Array, Array]:
    """(W,) ends of the interval in which all half spaces are kept."""
    down, up = row < 0.0, row > 0.0
    high = np.min(slack[down] / -row[down, None], axis=0, initial=np.inf)
    low = -np.min(slack[up] / row[up, None], axis=0, initial=np.inf)
    return low, high


def draw_between(low: Array, high: Array, mean: Array, sd: Array, random: Uniforms) -> Array:
    """(W,) draws from normal distributions restricted to [low, high], by inversion; exact far in a tail too."""
    a, b = (low - mean) / sd, (high - mean) / sd
    flip = a > -b  # the left tail is the one with digits to spare
    a, b = np.where(flip, -b, a), np.where(flip, -a, b)
    log_a, log_b = log_ndtr(a), log_ndtr(b)
    u = random.random_sample(len(mean))
    # log(Phi(a) + u (Phi(b) - Phi(a)))
    z = ndtri_exp(log_b + np.log1p((u - 1.0) * -np.expm1(log_a - log_b)))
    z = np.where(flip, -z, z)
    return np.clip(mean + sd * z, low, high)
