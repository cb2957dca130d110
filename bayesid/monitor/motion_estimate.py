"""Where a joint is, how fast it is and how it accelerates, from the samples up to now.

A polynomial is fitted to the samples of a short window that ends now (local regression; Savitzky and Golay 1964, for
uneven instants by its normal equations), and read off at the instant that is asked for: the newest sample, or one some
time ago, where the fit knows both sides and its noise is far lower. A motion that is a polynomial of that degree over
the window is followed without any delay. Nothing older than the window plays a part.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import lapack

from bayesid.arrays import Array
from bayesid.monitor.tuning import TUNING

_DEGREE = 3
"""Of the polynomial: accelerations that change linearly are followed."""


@dataclass
class MotionWindow:
    """The samples of n joints in the window, the newest last, and how far they lie from the fit."""

    n: int  # joints
    span: float  # of the window, s
    rate: float  # of the samples, Hz
    velocities: bool  # whether they are measured
    accelerations: bool  # whether they are
    count: int = 0  # samples in the window
    full: bool = False  # whether samples have left it
    t: Array = field(init=False)  # (W,) instants, s
    values: Array = field(init=False)  # (W, m n) positions, measured velocities and accelerations, rad, s
    left: Array = field(init=False)  # (m n,) average square of what the fit leaves of the newest sample
    free: float = 0.0  # average share of a sample's variance that it leaves
    fits: int = 0  # that the averages are of
    places: Array = field(init=False)  # (W',) where the instants of the last fit lay in the window, from -1 to 0
    weights: Array = field(init=False)  # (d + 1, W') that its samples had in the coefficients

    def __post_init__(self) -> None:
        size = min(TUNING.most_in_window, int(np.ceil(self.span * self.rate)) + _DEGREE + TUNING.spare)
        width = self.n * (1 + self.velocities + self.accelerations)
        self.t, self.values, self.left = np.zeros(size), np.zeros((size, width)), np.zeros(width)
        self.places, self.weights = np.zeros(0), np.zeros((_DEGREE + 1, 0))

    def empty(self) -> None:
        """Without samples; how noisy they are stays known."""
        self.count, self.full = 0, False

    def add(self, t: float, values: Array) -> None:
        """One more sample (m n,), and without those that have left the window."""
        self.t[:-1], self.values[:-1] = self.t[1:], self.values[1:]
        self.t[-1], self.values[-1] = t, values
        self.full = self.full or self.count == len(self.t)
        self.count = min(self.count + 1, len(self.t))
        oldest = t - self.span * (1.0 + 1e-9)
        while self.count > _DEGREE + TUNING.spare and self.t[-self.count] < oldest:
            self.count, self.full = self.count - 1, True

    def fit(self) -> LocalMotion | None:
        """The motion about now; None while there are too few samples."""
        if self.count < _DEGREE + TUNING.spare:
            return None
        t, values = self.t[-self.count :], self.values[-self.count :]
        scale = t[-1] - t[0]
        places = (t - t[-1]) / scale
        apart = places - self.places if len(places) == len(self.places) else places
        if apart @ apart > 1e-18:  # of even samples the weights stay as they are
            self.places, self.weights = places, _weights(places)
        weights = self.weights
        coefficients = weights @ values
        left = values[-1] - coefficients[0]  # the newest sample lies at the origin
        self.fits += 1
        new = max(1.0 / self.fits, 1.0 / (TUNING.memory * self.rate))  # a plain average until there is a second of them
        self.left = self.left + new * (left * left - self.left)
        self.free += new * (1.0 - float(weights[0, -1]) - self.free)
        variance = self.left / max(self.free, 1e-6)  # less would be rounding
        measured = self.velocities, self.accelerations
        return LocalMotion(float(t[-1]), float(scale), coefficients, weights, variance, self.full, self.n, measured)


def _weights(places: Array) -> Array:
    """(d + 1, W) that values at places (W,) have in the coefficients of the polynomial that fits them best."""
    powers = np.ones((_DEGREE + 1, len(places)))
    for k in range(_DEGREE):
        np.multiply(powers[k], places, out=powers[k + 1])
    weights: Array = lapack.dposv(powers @ powers.T, powers)[1]  # a tenth of the time of numpy's front door
    return weights


@dataclass(frozen=True)
class LocalMotion:
    """The polynomial about an instant."""

    t: float  # the instant, s
    scale: float  # by which times are divided, s
    coefficients: Array  # (d + 1, m n) of the powers
    weights: Array  # (d + 1, W) that samples have in them
    variance: Array  # (m n,) of the samples about it
    full: bool  # whether the window is
    n: int  # joints
    measured: tuple[bool, bool]  # whether velocities are, and accelerations

    def at(self, t: float) -> tuple[Array, Array, Array]:
        """(n,) positions, velocities and accelerations at an instant, s."""
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
        """(3, d + 1) powers of an instant's place, and their first two derivatives by time."""
        x, rate = (t - self.t) / self.scale, 1.0 / self.scale
        twice = 2.0 * rate * rate
        return (
            (1.0, x, x * x, x**3),
            (0.0, rate, 2.0 * rate * x, 3.0 * rate * x * x),
            (0.0, 0.0, twice, 3.0 * twice * x),
        )
