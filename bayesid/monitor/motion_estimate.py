"""Where a joint is, how fast it is and how it accelerates, from the samples up to now.

A polynomial is fitted to the samples of a short window that ends now (local regression; Savitzky and Golay 1964, for
uneven instants by its normal equations), and read off at the instant that is asked for: the newest sample, or one some
time ago, where the fit knows both sides and its noise is far lower. A motion that is a polynomial of that degree over
the window is followed without any delay. Nothing older than the window plays a part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from bayesid.arrays import Array
from bayesid.monitor.tuning import TUNING

_DEGREE = 3
"""Of the polynomial: accelerations that change linearly are followed."""


@dataclass
class MotionWindow:
    """The samples of the window, the newest last, and how far they lie from the fit.

    Attributes:
        t: (W,) instants, s.
        values: (W, m n) positions, measured velocities and accelerations as far as there are, rad, rad/s, rad/s^2.
        left: (m n,) average square of what the fit leaves of the newest sample.
        free: average share of a sample's variance that it leaves.
        fits: that the averages are of.
        count: samples in the window.
        full: whether samples have left it.
        places: (W',) where the instants of the last fit lay in the window, from -1 to 0.
        weights: (d + 1, W') that its samples had in the coefficients.
    """

    t: Array
    values: Array
    left: Array
    free: float
    fits: int
    count: int
    full: bool
    places: Array
    weights: Array

    def empty(self) -> None:
        """Without samples; how noisy they are stays known."""
        self.count, self.full = 0, False


@dataclass(frozen=True)
class MotionEstimator:
    """Of n joints.

    Attributes:
        n: joints.
        span: of the window, s.
        rate: of the samples, Hz.
        velocities: whether they are measured.
        accelerations: whether they are.
    """

    n: int
    span: float
    rate: float
    velocities: bool
    accelerations: bool

    def begin(self) -> MotionWindow:
        """Before the first sample."""
        size = min(TUNING.most_in_window, int(np.ceil(self.span * self.rate)) + _DEGREE + TUNING.spare)
        width = self.n * (1 + self.velocities + self.accelerations)
        nothing = np.zeros(0), np.zeros((_DEGREE + 1, 0))
        return MotionWindow(np.zeros(size), np.zeros((size, width)), np.zeros(width), 0.0, 0, 0, False, *nothing)

    def add(self, window: MotionWindow, t: float, values: Array) -> None:
        """One more sample (m n,), and without those that have left the window."""
        window.t[:-1], window.values[:-1] = window.t[1:], window.values[1:]
        window.t[-1], window.values[-1] = t, values
        window.full = window.full or window.count == len(window.t)
        window.count = min(window.count + 1, len(window.t))
        oldest = t - self.span * (1.0 + 1e-9)
        while window.count > _DEGREE + TUNING.spare and window.t[-window.count] < oldest:
            window.count, window.full = window.count - 1, True

    def fit(self, window: MotionWindow) -> LocalMotion | None:
        """The motion about now; None while there are too few samples."""
        if window.count < _DEGREE + TUNING.spare:
            return None
        t, values = window.t[-window.count :], window.values[-window.count :]
        scale = t[-1] - t[0]
        places = (t - t[-1]) / scale
        if len(places) != len(window.places) or not _alike(places, window.places):
            window.places, window.weights = places, _weights(places)
        coefficients = window.weights @ values
        left = values[-1] - coefficients[0]  # the newest sample lies at the origin
        window.fits += 1
        new = max(
            1.0 / window.fits, 1.0 / (TUNING.memory * self.rate)
        )  # a plain average until there is a second of them
        window.left = window.left + new * (left * left - window.left)
        window.free += new * (1.0 - float(window.weights[0, -1]) - window.free)
        variance = window.left / max(window.free, 1e-6)  # less would be rounding
        return LocalMotion(float(t[-1]), float(scale), coefficients, window.weights, variance, window.full, self)


def _alike(places: Array, others: Array) -> bool:
    apart = places - others
    return bool(apart @ apart <= 1e-18)


def _weights(places: Array) -> Array:
    """(d + 1, W) that values at places (W,) have in the coefficients of the polynomial that fits them best."""
    powers = np.ones((_DEGREE + 1, len(places)))
    for k in range(_DEGREE):
        np.multiply(powers[k], places, out=powers[k + 1])
    weights: Array = lapack.dposv(powers @ powers.T, powers)[1]  # a tenth of the time of numpy's front door
    return weights


@dataclass(frozen=True)
class LocalMotion:
    """The polynomial about an instant.

    Attributes:
        t: the instant, s.
        scale: by which times are divided, s.
        coefficients: (d + 1, m n) of the powers.
        weights: (d + 1, W) that samples have in them.
        variance: (m n,) of the samples about it.
        full: whether the window is.
        of: the estimator.
    """

    t: float
    scale: float
    coefficients: Array
    weights: Array
    variance: Array
    full: bool
    of: MotionEstimator

    def at(self, t: float) -> tuple[Array, Array, Array]:
        """(n,) positions, velocities and accelerations at an instant, s."""
        value, slope, curvature = np.array(self._powers(t)) @ self.coefficients
        n, last = self.of.n, slice(-self.of.n, None)
        if self.of.accelerations:
            return value[:n], value[n : 2 * n] if self.of.velocities else slope[:n], value[last]
        if self.of.velocities:
            return value[:n], value[last], slope[last]
        return value[:n], slope[:n], curvature[:n]

    def variance_of_acceleration(self, t: float) -> Array:
        """(n,) of the accelerations, (rad/s^2)^2."""
        order = 0 if self.of.accelerations else 1 if self.of.velocities else 2
        weights = np.array(self._powers(t)[order]) @ self.weights
        variance: Array = self.variance[-self.of.n :] * (weights @ weights)
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
