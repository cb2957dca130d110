"""Noise of a log from the residuals of a fit: size, colour and effective number of samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from bayesid.arrays import TINY, Array, Mask
from bayesid.regression.tuning import TUNING


@dataclass(frozen=True)
class Noise:
    """Second-order statistics of each joint's residual.

    Attributes:
        white: (n,) sd of the uncorrelated part (sensor noise), N m.
        coloured: (n,) sd of the correlated part (model error), N m.
        correlation: (n,) correlation time of the coloured part, s.
        autocorrelation: (n,) integrated autocorrelation time, samples: samples per independent one.
    """

    white: Array
    coloured: Array
    correlation: Array
    autocorrelation: Array

    @property
    def sigma(self) -> Array:
        """(n,) sd of the whole residual, N m."""
        return np.hypot(self.white, self.coloured)

    def scaled(self, factor: Array) -> Noise:
        """The noise times a factor (n,) of each joint."""
        return replace(self, white=factor * self.white, coloured=factor * self.coloured)

    def draw(self, samples: int, replicates: int, rate: float, rng: np.random.Generator) -> Array:
        """(samples, n, replicates) noise, N m: white plus an Ornstein-Uhlenbeck process."""
        return self.of(Normals.draw(samples, len(self.white), replicates, rng), rate)

    def of(self, normals: Normals, rate: float) -> Array:
        """(samples, n, replicates) noise, N m, from given standard normal variables."""
        drawn = self.white[:, None] * normals.white
        for j, memory in enumerate(np.exp(-1.0 / (self.correlation * rate))):
            filtered = scipy.signal.lfilter(
                [np.sqrt(1.0 - memory**2)], [1.0, -memory], normals.innovation[j], axis=0, zi=memory * normals.start[j]
            )
            drawn[:, j] += self.coloured[j] * filtered[0]
        return drawn

    def with_time_of_model(self, rate: float) -> Noise:
        """The noise with the autocorrelation time of its white and coloured part (:eq:`effective-samples`)."""
        memory = np.exp(-1.0 / (self.correlation * rate))
        share = (self.coloured / self.sigma) ** 2
        return replace(self, autocorrelation=1.0 + 2.0 * share * memory / (1.0 - memory))


@dataclass(frozen=True)
class Normals:
    """Standard normal variables of a noise.

    Attributes:
        white: (samples, n, replicates).
        innovation: (n, samples, replicates) of the coloured part.
        start: (n, 1, replicates) initial value of the coloured part.
    """

    white: Array
    innovation: Array
    start: Array

    @classmethod
    def draw(cls, samples: int, joints: int, replicates: int, rng: np.random.Generator) -> Normals:
        """Independent draws."""
        white = rng.standard_normal((samples, joints, replicates))
        coloured = np.stack([rng.standard_normal((samples + 1, replicates)) for _ in range(joints)])
        return cls(white, coloured[:, :-1], coloured[:, -1:])


def residual_noise(residual: Array, used: Mask, rate: float, pairs: Sequence[Array] | None = None) -> Noise:
    """Splits each joint's residual (N, n), N m, into a white and an exponentially correlated part (:eq:`noise-split`).

    Only used samples (N, n) count, at a rate in Hz. `pairs` from `pairs_of_joints` saves counting them again.
    """
    pairs = pairs_of_joints(used, rate) if pairs is None else pairs
    columns = [_split(residual[:, j], used[:, j], rate, counts) for j, counts in enumerate(pairs)]
    return Noise(*(np.array(values) for values in zip(*columns, strict=True)))


def noise_before_fit(observed: Noise, residuals: Callable[[Array], Array], used: Mask, rate: float) -> Noise:
    """The noise whose residuals have the observed figures after a fit, by indirect inference.

    A fit absorbs part of the noise, mostly of slow noise. Simulated noise (N, n, K), N m, is put through the same fit,
    which gives `residuals`. The figures of the noise change until those of the residuals match on average
    (Gourieroux, Monfort and Renault 1993).
    """
    noise, pairs = observed, pairs_of_joints(used, rate)
    # the same normals in each iteration, so that a fixed point exists
    normals = Normals.draw(len(used), used.shape[1], TUNING.noise_replicates, np.random.default_rng(0))
    for _ in range(TUNING.noise_iterations):
        refitted = residuals(noise.of(normals, rate))
        replicates = [residual_noise(refitted[..., k], used, rate, pairs) for k in range(TUNING.noise_replicates)]
        figures = {}
        for name in ("white", "coloured", "correlation"):
            mean = np.exp(np.mean([np.log(getattr(replicate, name)) for replicate in replicates], axis=0))
            change = np.clip(getattr(observed, name) / mean, 1.0 / TUNING.most_change, TUNING.most_change)
            figures[name] = getattr(noise, name) * change
        # a longer correlation cannot be distinguished from the motion
        figures["correlation"] = np.minimum(figures["correlation"], TUNING.longest_lag)
        noise = replace(noise, **figures)
    return noise.with_time_of_model(rate)


def _split(residual: Array, used: Mask, rate: float, pairs: Array) -> tuple[float, float, float, float]:
    """White and coloured sd, correlation time and integrated autocorrelation time of one joint."""
    covariance = autocovariance(residual, used, len(pairs), pairs)
    lag = min(max(1, round(TUNING.white_lag * rate)), len(covariance) - 1)
    total = max(covariance[0], TINY)
    least, most = TUNING.coloured_share
    coloured = float(np.clip(covariance[lag], least * total, most * total))
    below = np.flatnonzero(covariance[lag:] < coloured / np.e)
    lasts = below[0] if below.size else len(covariance)
    correlation = max(lasts / rate, 2.0 / rate)  # two samples are the resolution
    return np.sqrt(total - coloured), np.sqrt(coloured), correlation, integrated_time(covariance)


def pairs_of_joints(used: Mask, rate: float) -> list[Array]:
    """For each joint, the number of pairs of used samples (N, n) at each lag up to the longest."""
    return [pairs_apart(used_here, max(2, int(TUNING.longest_lag * rate))) for used_here in used.T]


def pairs_apart(used: Mask, lags: int) -> Array:
    """(lags,) number of pairs of used samples (N,) at lags 0, 1, ..; fewer lags for a short log."""
    weight = used.astype(float)
    return np.array([weight[: len(weight) - k] @ weight[k:] for k in range(min(lags, len(used) - 1))])


def autocovariance(values: Array, used: Mask, lags: int, pairs: Array | None = None) -> Array:
    """(lags,) autocovariance about zero over pairs of used samples; `pairs` are their numbers if known.

    Dot products are 100 times faster than `scipy.signal.correlate` for a few lags of 20,000 samples.
    """
    kept = np.where(used, values, 0.0)
    pairs = pairs_apart(used, lags) if pairs is None else pairs
    sums = [kept[: len(kept) - k] @ kept[k:] for k in range(len(pairs))]
    return np.array(sums) / np.maximum(pairs, 1.0)


def integrated_time(covariance: Array) -> float:
    """1 + 2 sum of the autocorrelations over Sokal's window, M >= 5 tau(M); at least 1 (:eq:`autocorrelation-time`)."""
    correlation = covariance / max(covariance[0], TINY)
    times = 2.0 * np.cumsum(correlation) - 1.0
    enough = np.flatnonzero(np.arange(len(times)) >= TUNING.sokal * times)
    return float(max(1.0, times[enough[0] if enough.size else -1]))


def times_of(error: Array, used: Mask, rate: float) -> Array:
    """(n,) correlation time of an error (N, n), samples: the longer one of its mean's and of its size's.

    The time of the size is 1 + 2 sum of the squared autocorrelations (Bartlett 1946). An oscillating error needs it:
    its half-waves cancel in the mean, but its size is known only as well as its coherence time allows.
    """
    times = []
    for j, pairs in enumerate(pairs_of_joints(used, rate)):
        covariance = autocovariance(error[:, j], used[:, j], len(pairs), pairs)
        by_chance = 1.0 / np.maximum(pairs, 1.0)  # squared autocorrelation of white noise
        square = (covariance / max(covariance[0], TINY)) ** 2 - by_chance
        times.append(max(integrated_time(covariance), 1.0 + 2.0 * float(square[1:].sum())))
    return np.array(times)


def rms_where(values: Array, used: Mask) -> Array:
    """(n,) RMS of values (N, n) over the used samples (N, n); 0 without any."""
    rms: Array = np.sqrt(np.where(used, values**2, 0.0).sum(axis=0) / np.maximum(used.sum(axis=0), 1))
    return rms


def relative_rms(residual: Array, effort: Array, used: Mask) -> Array:
    """(n,) RMS of the residual over RMS of the effort, over the used samples (N, n)."""
    return np.sqrt((residual**2 * used).sum(axis=0) / np.maximum((effort**2 * used).sum(axis=0), TINY))
