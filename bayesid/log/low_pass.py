"""A low-pass of |effort| after the rectifier: in the sensor, the drive or the logger."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from scipy.special import ndtr

from bayesid.arrays import Array
from bayesid.log.tuning import TUNING


@dataclass(frozen=True, order=True)
class LowPass:
    """A Butterworth low-pass of efforts, cut-off in Hz; order 1 is an RC element.

    With `zero_phase` it runs forwards and backwards: no delay, twice the order.
    """

    order: int
    cutoff: float
    zero_phase: bool

    def __str__(self) -> str:
        way = "forwards and backwards" if self.zero_phase else "with its delay"
        return f"{self.cutoff:.3g} Hz (Butterworth, order {self.order}, {way})"

    def apply(self, values: Array, rate: float) -> Array:
        """Filters (N, ...) values at a rate, Hz; the filter starts at rest."""
        above, below = scipy.signal.butter(self.order, self.cutoff, fs=rate)
        for _ in range(1 + self.zero_phase):
            at_rest = scipy.signal.lfilter_zi(above, below).reshape(-1, *[1] * (values.ndim - 1)) * values[:1]
            values = scipy.signal.lfilter(above, below, values, axis=0, zi=at_rest)[0]
            values = values[::-1] if self.zero_phase else values
        return values

    def autocovariance(self, memory: float, lags: int, rate: float) -> Array:
        """(lags,) autocovariance of filtered noise of variance 1 whose lag-1 correlation is `memory`."""
        reach = int(np.ceil(TUNING.filter_memory * rate / self.cutoff))
        impulse = np.zeros(2 * reach + 1)
        impulse[reach] = 1.0
        response = self.apply(impulse, rate)
        power = scipy.signal.correlate(response, response)
        reach = len(response) - 1 + lags
        noise = float(memory) ** np.abs(np.arange(-reach, reach + 1))
        covariance: Array = scipy.signal.fftconvolve(noise, power, mode="valid")[lags : 2 * lags]
        return covariance


@dataclass(frozen=True)
class AfterRectifier:
    """A low-pass that the |effort| of the unsigned joints has passed."""

    low_pass: LowPass
    read: Array  #: (N, n) |effort| as recorded, resampled, N m
    noise: Array  #: (n,) sd of the noise at the rectifier, which the low-pass removes, N m

    def readings(self, effort: Array, rate: float) -> Array:
        """(N, n, ...) mean readings of efforts, N m, at a rate, Hz."""
        sd = self.noise.reshape(-1, *[1] * (effort.ndim - 2))
        return self.low_pass.apply(mean_magnitude(effort, sd), rate)


def mean_magnitude(effort: Array, sd: Array | float) -> Array:
    """E|e + n| of efforts e with normal noise n of standard deviation sd: mean of a folded normal."""
    ratio = effort / sd
    mean: Array = sd * np.sqrt(2.0 / np.pi) * np.exp(-0.5 * ratio**2) + effort * (2.0 * ndtr(ratio) - 1.0)
    return mean
