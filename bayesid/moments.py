"""Moments: all that the data say about a model, in a size that does not depend on the log's length.

For every segment k of constant sign, with Y_k its rows of the regressor and e_k its efforts (absolute values where the
sign is unknown),

    H_k = Y_k' Y_k,   g_k = Y_k' e_k,   c_k = e_k' e_k,

and the cost of coefficients beta under signs s is  f = beta' (sum H_k) beta - 2 beta' (sum s_k g_k) + sum c_k.
Moments of chunks of one log add; those of different logs, with different segments, join.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.coefficients import BaseCoefficients
from bayesid.model import Model
from bayesid.motion import Array, Integers, Motion
from bayesid.segments import Segments


@dataclass(frozen=True)
class Moments:
    """Moments of S segments for r coefficients, in units of the noise when `scaled`.

    Attributes:
        joint: (S,) 0-based actuator of each segment.
        known: (S,) sign known beforehand, +1 or -1; 0 where it is to be found.
        hessian: (S, r, r) H_k.
        gradient: (S, r) g_k.
        energy: (S,) c_k.
        count: (S,) samples.
    """

    joint: Integers
    known: Integers
    hessian: Array
    gradient: Array
    energy: Array
    count: Integers

    def __len__(self) -> int:
        return len(self.joint)

    def __add__(self, other: Moments) -> Moments:
        """Moments of the same segments from more of their samples."""
        if not np.array_equal(self.joint, other.joint) or not np.array_equal(self.known, other.known):
            raise ValueError("only moments of the same segments add; join those of different logs")
        return Moments(
            self.joint, self.known, self.hessian + other.hessian, self.gradient + other.gradient,
            self.energy + other.energy, self.count + other.count,
        )  # fmt: skip

    def join(self, other: Moments) -> Moments:
        """Moments of two logs of the same model: the segments of one after those of the other."""
        names = ("joint", "known", "hessian", "gradient", "energy", "count")
        return Moments(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in names))

    def scaled(self, sigma: Array) -> Moments:
        """Rows weighted by 1 / sigma (n,), the noise of each joint's effort, N m."""
        weight = 1.0 / sigma[self.joint] ** 2
        return Moments(
            self.joint, self.known, weight[:, None, None] * self.hessian, weight[:, None] * self.gradient,
            weight * self.energy, self.count,
        )  # fmt: skip

    def rms_effort(self, n: int) -> Array:
        """(n,) RMS effort of each of n joints, N m."""
        return np.sqrt(self._joint_means(self.energy, n))

    def residual_sd(self, beta: Array, signs: Integers, n: int) -> Array:
        """(n,) RMS residual of each of n joints under coefficients beta (r,) and signs (S,), N m."""
        cost = self.hessian @ beta @ beta - 2.0 * signs * (self.gradient @ beta) + self.energy
        floor = 1e-6 * self.rms_effort(n)  # rounding may leave less than nothing
        return np.maximum(np.sqrt(np.maximum(self._joint_means(cost, n), 0.0)), floor)

    def _joint_means(self, sums: Array, n: int) -> Array:
        """(n,) sums over segments (S,) per sample of each joint."""
        total = np.bincount(self.joint, weights=sums, minlength=n)
        return total / np.bincount(self.joint, weights=self.count, minlength=n)

    def cost(self, beta: Array, signs: Array) -> float:
        """f(beta, s) for coefficients beta (r,) and signs (S,)."""
        return float(beta @ self.hessian.sum(axis=0) @ beta - 2 * beta @ (signs @ self.gradient) + self.energy.sum())


def moments(
    model: Model, coefficients: BaseCoefficients, motion: Motion, effort: Array, segments: Segments
) -> Moments:
    """Moments of a log, streamed over chunks of its samples.

    Args:
        model: the model.
        coefficients: its r base coefficients.
        motion: N samples of motion.
        effort: (N, n) efforts, N m; absolute values for segments of unknown sign.
        segments: where the sign is constant; samples outside of every segment do not count.
    """
    size, r = len(segments), len(coefficients)
    hessian, gradient, energy = np.zeros((size, r, r)), np.zeros((size, r)), np.zeros(size)
    for rows, columns in model.chunks(motion):
        columns = columns[:, :, coefficients.kept]
        for k in np.flatnonzero((segments.start < rows.stop) & (segments.end > rows.start)):
            j = segments.joint[k]
            inside = slice(max(segments.start[k], rows.start), min(segments.end[k], rows.stop))
            y, e = columns[inside.start - rows.start : inside.stop - rows.start, j], effort[inside, j]
            hessian[k] += y.T @ y
            gradient[k] += y.T @ e
            energy[k] += e @ e
    return Moments(segments.joint, segments.known, hessian, gradient, energy, segments.end - segments.start)
