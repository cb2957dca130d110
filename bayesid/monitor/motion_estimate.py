"""Position, velocity and acceleration of joints, from the samples up to now.

A polynomial is fitted to the samples of a short window that ends now (local regression; Savitzky and Golay 1964, for
uneven sampling by its normal equations). It is evaluated at the newest sample or at an earlier time, where its noise is
far lower as samples lie on both sides. A motion that is a polynomial of this degree is followed without delay.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import lapack

from bayesid.arrays import Array
from bayesid.monitor.tuning import TUNING

_DEGREE = 3
"""Degree of the polynomial: accelerations that change linearly are followed."""


@dataclass
class MotionWindow:
    """The samples of n joints in the window, the newest last, and their noise."""

    n: int  # joints
    span: float  # length of the window, s
    rate: float  # sampling rate, Hz
    velocities: bool  # whether velocities are measured
    accelerations: bool  # whether accelerations are measured
    count: int = 0  # samples in the window
    full: bool = False  # whether samples have left it
    t: Array = field(init=False)  # (W,) times, s
    values: Array = field(init=False)  # (W, m n) positions, measured velocities and accelerations, rad, s
    square: Array = field(init=False)  # (m n,) mean squared residual of the newest sample
    free: float = 0.0  # mean share of a sample's variance that stays in its residual
    fits: int = 0  # number of fits in these means
    places: Array = field(init=False)  # (W',) times of the last fit's samples, scaled to -1..0
    weights: Array = field(init=False)  # (d + 1, W') weights of its samples in the coefficients

    def __post_init__(self) -> None:
        size = min(TUNING.most_in_window, int(np.ceil(self.span * self.rate)) + _DEGREE + TUNING.spare)
        width = self.n * (1 + self.velocities + self.accelerations)
        self.t, self.values, self.square = np.zeros(size), np.zeros((size, width)), np.zeros(width)
        self.places, self.weights = np.zeros(0), np.zeros((_DEGREE + 1, 0))

    def empty(self) -> None:
        """Removes all samples; the estimate of their noise stays."""
        self.count, self.full = 0, False

    def add(self, t: float, values: Array) -> None:
        """Adds a sample (m n,), and removes those that have left the window."""
        self.t[:-1], self.values[:-1] = self.t[1:], self.values[1:]
        self.t[-1], self.values[-1] = t, values
        self.full = self.full or self.count == len(self.t)
        self.count = min(self.count + 1, len(self.t))
        oldest = t - self.span * (1.0 + 1e-9)
        while self.count > _DEGREE + TUNING.spare and self.t[-self.count] < oldest:
            self.count, self.full = self.count - 1, True

    def fit(self) -> LocalMotion | None:
        """The motion near the newest sample; None while there are too few samples."""
        if self.count < _DEGREE + TUNING.spare:
            return None
        t, values = self.t[-self.count :], self.values[-self.count :]
        scale = t[-1] - t[0]
        places = (t - t[-1]) / scale
        apart = places - self.places if len(places) == len(self.places) else places
        if apart @ apart > 1e-18:  # the weights of even samples do not change
            self.places, self.weights = places, _weights(places)
        weights = self.weights
        coefficients = weights @ values
        residual = values[-1] - coefficients[0]  # the newest sample lies at the origin
        self.fits += 1
        new = max(1.0 / self.fits, 1.0 / (TUNING.memory * self.rate))  # a plain mean at first
        self.square = self.square + new * (residual * residual - self.square)
        self.free += new * (1.0 - float(weights[0, -1]) - self.free)
        variance = self.square / max(self.free, 1e-6)  # smaller values are rounding errors
        measured = self.velocities, self.accelerations
        return LocalMotion(float(t[-1]), float(scale), coefficients, weights, variance, self.full, self.n, measured)


def _weights(places: Array) -> Array:
    """(d + 1, W) weights of values at places (W,) in the coefficients of the least-squares polynomial."""
    powers = np.ones((_DEGREE + 1, len(places)))
    for k in range(_DEGREE):
        np.multiply(powers[k], places, out=powers[k + 1])
    weights: Array = lapack.dposv(powers @ powers.T, powers)[1]  # faster than numpy.linalg.solve at this size
    return weights


@dataclass(frozen=True)
class LocalMotion:
    """The polynomial near a time."""

    t: float  # origin, s
    scale: float  # unit of time of the powers, s
    coefficients: Array  # (d + 1, m n) of the powers
    weights: Array  # (d + 1, W) weights of the samples in the coefficients
    variance: Array  # (m n,) of the samples about the polynomial
    full: bool  # whether the window is full
    n: int  # joints
    measured: tuple[bool, bool]  # whether velocities and accelerations are measured

    def at(self, t: float) -> tuple[Array, Array, Array]:
        """(n,) positions, velocities and accelerations at a time, s."""
        value, slope, curvature = np.array(self._powers(t)) @ self.coefficients
        n, last, (velocities, accelerations) = self.n, slice(-self.n, None), self.measured
        if accelerations:
            return value[:n], value[n : 2 * n] if velocities else slope[:n], value[last]
        if velocities:
            return value[:n], value[last], slope[last]
        return value[:n], slope[:n], curvature[:n]

    def variance_of_acceleration(self, t: float) -> Array:
        """(n,) of the accelerations, (rad/s^2)^2."""
        velocities, accelerations = self.measured
        weights = np.array(self._powers(t)[0 if accelerations else 1 if velocities else 2]) @ self.weights
        variance: Array = self.variance[-self.n :] * (weights @ weights)
        return variance

    def _powers(self, t: float) -> tuple[tuple[float, ...], ...]:
        """(3, d + 1) powers of the scaled time, and their first two derivatives by time."""
        x, rate = (t - self.t) / self.scale, 1.0 / self.scale
        twice = 2.0 * rate * rate
        return (
            (1.0, x, x * x, x**3),
            (0.0, rate, 2.0 * rate * x, 3.0 * rate * x * x),
            (0.0, 0.0, twice, 3.0 * twice * x),
        )
