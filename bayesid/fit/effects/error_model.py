"""The error of a model as a time series: white noise plus an exponentially correlated part, and its likelihood.

x_i = w_i + c_i with c_i = phi c_(i-1) + eta_i is an ARMA(1, 1) process, (1 - phi L) x = (1 - theta L) eps with
:eq:`arma`::

    theta / (1 + theta^2) = phi sw^2 / (sc^2 (1 - phi^2) + sw^2 (1 + phi^2)),   var eps = phi sw^2 / theta

(Box and Jenkins 1976, section 3.4). So one recursive filter whitens residuals and columns alike, and the likelihood is
that of independent innovations: samples count for what they are worth, no autocorrelation time has to be guessed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from bayesid.arrays import Array, Mask

_SHARES = (0.0, 0.03, 0.1, 0.25, 0.5, 0.8, 0.97)
"""Of the coloured part in the variance, from which the fit starts: a coarse grid, refined afterwards; not studied."""
_CORRELATIONS = (0.02, 0.05, 0.12, 0.3, 0.8)
"""s, from which the fit starts: a factor of about 2.5 from one to the next."""
_SHORTEST, _LONGEST = 0.005, 3.0
"""s; a shorter correlation is white at usual rates, a longer one a constant."""
_START_SHARES = 1e-3, 0.999
"""Least and largest share at which the local search starts: its logarithms must be finite."""
_LOGITS = -12.0, 7.0
"""Least and largest logarithm of the shares' ratio in the local search: shares of 6e-6 to 0.999."""
_EVALUATIONS = 40
"""Of the local search; a round number."""
_RESOLUTION = 0.02
"""At which it ends, in logarithms: two per cent, below the sampling error of a thousand samples."""
_STEP = 0.5
"""Its first step, in the logarithms of the shares' ratio and of the correlation time."""
_TINY, _SMALL = 1e-300, 1e-12
"""Guards of a logarithm and of divisions by a share."""


@dataclass(frozen=True)
class ErrorModel:
    """White noise and an Ornstein-Uhlenbeck process, in one joint.

    Attributes:
        white: sd of the part that changes from sample to sample, N m.
        coloured: sd of the part that lasts, N m.
        correlation: its correlation time, s.
        rate: Hz.
    """

    white: float
    coloured: float
    correlation: float
    rate: float

    @property
    def sigma(self) -> float:
        """Sd of both, N m."""
        return float(np.hypot(self.white, self.coloured))

    def whiten(self, values: Array, used: Mask) -> Array:
        """(N, ...) innovations of values (N, ...), in units of their standard deviation; zero where not used (N,)."""
        share = (self.coloured / self.sigma) ** 2
        memory, theta, variance = _arma(share, self.correlation, self.rate)
        innovation = scipy.signal.lfilter([1.0, -memory], [1.0, -theta], bridged(values, used), axis=0)
        innovation[~used] = 0.0
        innovation /= self.sigma * math.sqrt(variance)
        return innovation

    def log_likelihood(self, residual: Array, used: Mask) -> float:
        """Of residuals (N,), those that are used."""
        share = (self.coloured / self.sigma) ** 2
        memory, theta, variance = _arma(share, self.correlation, self.rate)
        square, count = _innovations(bridged(residual, used), used, memory, theta)
        scale = self.sigma**2 * variance
        return -0.5 * (count * math.log(2.0 * math.pi * scale) + square / scale)


def bridged(values: Array, used: Mask) -> Array:
    """Values (N, ...), those not used (N,) on straight lines between their used neighbours, and level at both ends.

    Zeros in their place would be jumps: the first sample after a gap would count for as many as one innovation is
    smaller than the noise, and slow noise for far more than it is worth.
    """
    rows, gaps = np.flatnonzero(used), np.flatnonzero(~used)
    if not len(rows) or not len(gaps):
        return values
    after = np.searchsorted(rows, gaps)
    left, right = rows[np.maximum(after - 1, 0)], rows[np.minimum(after, len(rows) - 1)]
    share = np.where(right > left, (gaps - left) / np.maximum(right - left, 1), 0.0)
    share = share.reshape(-1, *(1,) * (values.ndim - 1))
    filled = values.copy()
    filled[gaps] = (1.0 - share) * values[left] + share * values[right]
    return filled


def fit_error(
    residual: Array, used: Mask, rate: float, limits: tuple[float, float] | None = None
) -> tuple[ErrorModel, float]:
    """The likeliest error model of residuals (N,), of those that are used, and its log likelihood.

    Args:
        residual: (N,) N m.
        used: (N,) samples that count.
        rate: Hz.
        limits: largest white and coloured part, N m; none by default.
    """
    residual = bridged(residual, used)

    def judged(share: float, correlation: float) -> tuple[float, float]:
        """Sigma^2 and log likelihood of a share of the coloured part and a correlation time."""
        memory, theta, variance = _arma(share, correlation, rate)
        square, count = _innovations(residual, used, memory, theta)
        sigma2 = square / (max(count, 1) * variance) + _TINY
        if limits is not None:
            parts = (limits[0] ** 2 / max(1.0 - share, _SMALL), limits[1] ** 2 / max(share, _SMALL))
            sigma2 = min(sigma2, *parts)
        scale = sigma2 * variance
        return sigma2, -0.5 * (count * math.log(2.0 * math.pi * scale) + square / scale)

    def cost(point: Array) -> float:
        return -judged(*_from_point(point))[1]

    grid = [(share, time) for share in _SHARES for time in _CORRELATIONS[: 1 if share == 0.0 else None]]
    best = max(grid, key=lambda at: judged(*at)[1])
    simplex = _to_point(*best) + np.array([[0.0, 0.0], [_STEP, 0.0], [0.0, _STEP]])  # scipy's is flat at 1/2
    options = {"maxfev": _EVALUATIONS, "xatol": _RESOLUTION, "initial_simplex": simplex}
    refined = scipy.optimize.minimize(cost, simplex[0], method="Nelder-Mead", options=options)
    share, correlation = max((best, _from_point(refined.x)), key=lambda at: judged(*at)[1])
    sigma2, value = judged(share, correlation)
    return ErrorModel(np.sqrt(sigma2 * (1.0 - share)), np.sqrt(sigma2 * share), correlation, rate), value


def _to_point(share: float, correlation: float) -> Array:
    share = min(max(share, _START_SHARES[0]), _START_SHARES[1])
    return np.array([np.log(share / (1.0 - share)), np.log(correlation)])


def _from_point(point: Array) -> tuple[float, float]:
    logit, log_time = point.tolist()
    share = 1.0 / (1.0 + math.exp(-min(max(logit, _LOGITS[0]), _LOGITS[1])))
    return share, math.exp(min(max(log_time, math.log(_SHORTEST)), math.log(_LONGEST)))


def _arma(share: float, correlation: float, rate: float) -> tuple[float, float, float]:
    """Phi, theta and the innovations' variance for a total variance of one."""
    memory = math.exp(-1.0 / (correlation * rate))
    white = 1.0 - share
    total = share * (1.0 - memory**2) + white * (1.0 + memory**2)
    ratio = memory * white / total
    theta = 2.0 * ratio / (1.0 + math.sqrt(max(1.0 - 4.0 * ratio**2, 0.0)))
    return memory, theta, total / (1.0 + theta**2)


def _innovations(residual: Array, used: Mask, memory: float, theta: float) -> tuple[float, int]:
    """Sum of squares, and number, of the innovations of the used samples."""
    innovation = scipy.signal.lfilter([1.0, -memory], [1.0, -theta], residual)[used]
    return float(innovation @ innovation), len(innovation)
