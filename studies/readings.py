"""Sensors of simulated logs: several kinds of noise, quantisation, a filter behind the rectifier."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.signal import butter, lfilter, sosfiltfilt

from bayesid.arrays import Array

Reading = Callable[[Array, Array, np.random.Generator], Array]
"""From efforts (N, n), the noise's sd (n,) and a generator to readings (N, n), signed as before rectification."""
RATE = 100.0
"""Hz, of the logs."""
_FREEDOM = 3
"""Degrees of freedom of heavy tails: the smallest whole number with a finite variance."""
_STEPS = 256
"""8 bits, from minus to plus the joint's largest effort: as 12 bits of which the log uses a sixteenth of the range."""
_ORDER = 2
"""Of the low-pass behind a rectifier (Butterworth), run forwards and backwards, without delay."""


def _white(efforts: Array, sd: Array, rng: np.random.Generator) -> Array:
    return efforts + sd * rng.standard_normal(efforts.shape)


def _autoregressive(correlation: float) -> Reading:
    """AR(1) noise, stationary from the first sample."""

    def noisy(efforts: Array, sd: Array, rng: np.random.Generator) -> Array:
        steps = rng.standard_normal(efforts.shape) * np.sqrt(1.0 - correlation**2)
        steps[0] /= np.sqrt(1.0 - correlation**2)
        return efforts + sd * lfilter([1.0], [1.0, -correlation], steps, axis=0)

    return noisy


def _quantised(efforts: Array, sd: Array, rng: np.random.Generator) -> Array:
    """Rounded to the sensor's steps, without other noise."""
    step = 2.0 * np.abs(efforts).max(axis=0) / _STEPS
    return step * np.rint(efforts / step)


def _heavy_tailed(efforts: Array, sd: Array, rng: np.random.Generator) -> Array:
    return efforts + sd * rng.standard_t(_FREEDOM, efforts.shape) * np.sqrt((_FREEDOM - 2) / _FREEDOM)


def _filtered(cutoff: float) -> Reading:
    """White noise, rectifier, low-pass (Hz); the result has the sign of the effort before the rectifier."""
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
"""Noise of 1 to 3 % of each joint's RMS effort, except for "8 bit"."""
READINGS: Mapping[str, Reading] = {**NOISES, "filtered 8 Hz": _filtered(8.0), "filtered 3 Hz": _filtered(3.0)}
"""Noises, and filters behind the rectifier."""
