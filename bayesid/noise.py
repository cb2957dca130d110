"""What the residuals of a fit say about the noise: its size, its colour, and how many samples really count."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.motion import Array, Mask

_WHITE_LAG = 0.02
"""s; sensor noise is forgotten after this long, model error is not."""
_LONGEST = 0.5
"""s; beyond this lag a residual's correlation is not followed."""


@dataclass(frozen=True)
class Noise:
    """Second-order statistics of each joint's residual.

    Attributes:
        white: (n,) sd of the part that changes from sample to sample (sensor), N m.
        coloured: (n,) sd of the part that lasts (model error), N m.
        correlation: (n,) correlation time of the coloured part, s.
        autocorrelation: (n,) integrated autocorrelation time, samples: that many samples count as one.
    """

    white: Array
    coloured: Array
    correlation: Array
    autocorrelation: Array

    @property
    def sigma(self) -> Array:
        """(n,) sd of the whole residual, N m."""
        return np.hypot(self.white, self.coloured)


def residual_noise(residual: Array, used: Mask, rate: float) -> Noise:
    """Splits each joint's residual into a white and an exponentially correlated part.

    Args:
        residual: (N, n) residuals, N m.
        used: (N, n) which samples count.
        rate: Hz.
    """
    columns = [_split(residual[:, j], used[:, j], rate) for j in range(residual.shape[1])]
    return Noise(*(np.array(values) for values in zip(*columns, strict=True)))


def _split(residual: Array, used: Mask, rate: float) -> tuple[float, float, float, float]:
    covariance = autocovariance(residual, used, max(2, int(_LONGEST * rate)))
    lag = min(max(1, round(_WHITE_LAG * rate)), len(covariance) - 1)
    total = max(covariance[0], 1e-300)
    coloured = float(np.clip(covariance[lag], 0.05 * total, 0.98 * total))
    below = np.flatnonzero(covariance[lag:] < coloured / np.e)
    correlation = (below[0] if below.size else len(covariance)) / rate
    return np.sqrt(total - coloured), np.sqrt(coloured), max(correlation, 2.0 / rate), integrated_time(covariance)


def autocovariance(values: Array, used: Mask, lags: int) -> Array:
    """(lags,) autocovariance about zero over the pairs of samples that are both used."""
    kept = np.where(used, values, 0.0)
    weight = used.astype(float)
    lags = min(lags, len(values) - 1)
    sums = [kept[: len(kept) - k] @ kept[k:] for k in range(lags)]
    pairs = [weight[: len(kept) - k] @ weight[k:] for k in range(lags)]
    return np.array(sums) / np.maximum(pairs, 1.0)


def integrated_time(covariance: Array) -> float:
    """1 + 2 sum of the autocorrelations, summed over Sokal's window (the first M >= 5 tau(M)); at least 1."""
    correlation = covariance / max(covariance[0], 1e-300)
    times = 2.0 * np.cumsum(correlation) - 1.0
    enough = np.flatnonzero(np.arange(len(times)) >= 5.0 * times)
    return float(max(1.0, times[enough[0] if enough.size else -1]))


def relative_rms(residual: Array, effort: Array, used: Mask) -> Array:
    """(n,) RMS of the residual over RMS of the effort, over the used samples (N, n)."""
    return np.sqrt((residual**2 * used).sum(axis=0) / np.maximum((effort**2 * used).sum(axis=0), 1e-300))
