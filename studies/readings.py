"""What sensors make of the efforts of simulated logs: noise of several kinds, steps, a filter behind the rectifier."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.signal import butter, lfilter, sosfiltfilt

from bayesid.arrays import Array

Reading = Callable[[Array, Array, np.random.Generator], Array]
"""From efforts (N, n), the noise's sd (n,) and draws to what is read (N, n), in the signs of the rectified efforts."""
RATE = 100.0
"""Hz, of the logs that are read."""
_FREEDOM = 3
"""Degrees of freedom of heavy tails: the fewest for which there is a variance."""
_STEPS = 256
"""Of a sensor of 8 bits, from minus its joint's largest effort to plus. One of 12 bits reads the same if the log uses a
sixteenth of its range."""
_ORDER = 2
"""Of the low-pass behind a rectifier (Butterworth), run forwards and backwards: it delays nothing."""


def _white(efforts: Array, sd: Array, rng: np.random.Generator) -> Array:
    return efforts + sd * rng.standard_normal(efforts.shape)


def _autoregressive(correlation: float) -> Reading:
    """Noise that is correlated from sample to sample, and stationary from the first."""

    def noisy(efforts: Array, sd: Array, rng: np.random.Generator) -> Array:
        steps = rng.standard_normal(efforts.shape) * np.sqrt(1.0 - correlation**2)
        steps[0] /= np.sqrt(1.0 - correlation**2)
        return efforts + sd * lfilter([1.0], [1.0, -correlation], steps, axis=0)

    return noisy


def _quantised(efforts: Array, sd: Array, rng: np.random.Generator) -> Array:
    """No other noise that would hide the steps."""
    step = 2.0 * np.abs(efforts).max(axis=0) / _STEPS
    return step * np.rint(efforts / step)


def _heavy_tailed(efforts: Array, sd: Array, rng: np.random.Generator) -> Array:
    return efforts + sd * rng.standard_t(_FREEDOM, efforts.shape) * np.sqrt((_FREEDOM - 2) / _FREEDOM)


def _filtered(cutoff: float) -> Reading:
    """White noise, then the rectifier, then a low-pass (Hz): zeros are filled, and what is left has no sign of its own.

    It is given that of the effort before the rectifier.
    """
    sections = butter(_ORDER, cutoff, output="sos", fs=RATE)

    def read(efforts: Array, sd: Array, rng: np.random.Generator) -> Array:
        noisy = _white(efforts, sd, rng)
        return np.sign(noisy) * np.abs(sosfiltfilt(sections, np.abs(noisy), axis=0))

    return read


NOISES: Mapping[str, Reading] = {
    "white": _white,
    "AR(1) 0.9": _autoregressive(0.9),
    "AR(1) 0.97": _autoregressive(0.97),
    "8 bit": _quantised,
    "Student t": _heavy_tailed,
}
"""Of an RMS of 1 to 3 % of each joint's RMS effort but for "8 bit"."""
READINGS: Mapping[str, Reading] = {**NOISES, "filtered 8 Hz": _filtered(8.0), "filtered 3 Hz": _filtered(3.0)}
"""All there are: noises, and filters behind the rectifier."""
