"""Convergence of several ensembles: R-hat between ensembles, effective sample sizes over walkers.

The numbers are those of `arviz.rhat` and `arviz.ess`, whose checks, copies and sorting of the same draws once for each
of them took a quarter of a posterior's time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from scipy.special import ndtri

from bayesid.arrays import Array, Mask

_TAILS = (0.05, 0.95)
"""Quantiles whose effective sample size is that of the tails (Vehtari et al. 2021)."""
_BLOM = 0.375
"""Offset of ranks in normal scores (Blom 1958)."""


@dataclass(frozen=True)
class Diagnostics:
    """Of K quantities.

    Attributes:
        rhat: (K,) rank-normalised split R-hat (Vehtari et al. 2021), the larger of bulk and tail, between ensembles:
            every ensemble's walkers together are a chain, split into its earlier and its later half.
        bulk: (K,) effective sample size of the bulk; every walker is a chain, so that walkers which do not mix count.
            At most the number of draws, which it is for a constant.
        tail: (K,) the smaller one of the 5 % and 95 % quantiles.
    """

    rhat: Array
    bulk: Array
    tail: Array

    @property
    def max_rhat(self) -> float:
        """The worst R-hat."""
        return float(np.max(self.rhat))

    @property
    def min_ess(self) -> float:
        """The worst effective sample size, of bulk or tail."""
        return float(min(np.min(self.bulk), np.min(self.tail)))

    def passes(self, max_rhat: float, min_ess: float) -> bool:
        """Whether all quantities have converged this far; NaN has not."""
        return self.max_rhat <= max_rhat and self.min_ess >= min_ess


def diagnose(draws: Array) -> Diagnostics:
    """Diagnostics of draws (D, E, W, K): D sweeps of E ensembles of W walkers; D >= 4. A constant counts as converged.

    Draws that are not finite give NaN, which passes no test. Of an odd number of sweeps the middle one is left out.
    """
    size, count = draws.shape[3], float(draws[..., 0].size)
    flat = np.ptp(draws, axis=(0, 1, 2)) == 0.0
    finite = np.isfinite(draws).all(axis=(0, 1, 2))
    rhat, bulk, tail = np.ones(size), np.full(size, np.inf), np.full(size, np.inf)
    rhat[~finite] = bulk[~finite] = tail[~finite] = np.nan
    for k in np.flatnonzero(finite & ~flat).tolist():
        values = np.ascontiguousarray(draws[..., k])
        halves = _halves(values)
        scores = _normal_scores(halves)
        rhat[k] = max(_rhat(scores), _rhat(_normal_scores(np.abs(halves - np.median(halves)))))
        bulk[k] = _effective(scores)
        tail[k] = min(_effective(_halves(values <= quantile)) for quantile in np.quantile(values, _TAILS))
    return Diagnostics(rhat, np.minimum(bulk, count), np.minimum(tail, count))  # of few sweeps, estimates exceed it


def _halves(values: Array | Mask) -> Array:
    """(D // 2, E, W, 2) the earlier and the later sweeps of values (D, E, W)."""
    half = len(values) // 2
    return np.stack([values[:half], values[-half:]], axis=-1).astype(float)


def _normal_scores(values: Array) -> Array:
    """Normal quantiles of the ranks of values (...), which have the same shape."""
    rank = _ranks(values.ravel()).reshape(values.shape)
    scores: Array = ndtri((rank - _BLOM) / (values.size - 2.0 * _BLOM + 1.0))
    return scores


def _ranks(values: Array) -> Array:
    """(N,) from 1 on, of values (N,); equal ones share the mean of theirs."""
    order = np.argsort(values)
    first = np.flatnonzero(np.diff(values[order], prepend=-np.inf))
    count = np.diff(first, append=len(values))
    rank = np.empty(len(values))
    rank[order] = np.repeat(first + 0.5 * (count + 1.0), count)
    return rank


def _rhat(halves: Array) -> float:
    """R-hat of halves (D, E, W, 2) as 2 E chains; infinite where none of them moves."""
    chains = halves.transpose(1, 3, 0, 2).reshape(2 * halves.shape[1], -1)
    draws = chains.shape[1]
    with np.errstate(divide="ignore"):
        ratio = chains.mean(axis=1).var(ddof=1) / chains.var(axis=1, ddof=1).mean()
    return float(np.sqrt(ratio + (draws - 1.0) / draws))


def _effective(halves: Array) -> float:
    """Effective sample size of halves (D, E, W, 2) as 2 E W chains, by Geyer's initial monotone sequence (1992)."""
    if np.ptp(halves) == 0.0:
        return float(halves.size)
    chains = halves.reshape(len(halves), -1)
    draws, means = len(chains), chains.mean(axis=0)
    covariance = _autocovariance(chains - means)
    within = covariance[0] * draws / (draws - 1.0)
    correlation = 1.0 - (within - covariance) / (covariance[0] + means.var(ddof=1))
    correlation[0] = 1.0
    pairs = correlation[: draws // 2 * 2].reshape(-1, 2).sum(axis=1)
    most = max(0, (draws - 3) // 2)
    ends = np.flatnonzero(pairs[:most] <= 0.0)
    last = int(ends[0]) if len(ends) else most
    beyond = correlation[2 * last] if pairs[last] >= 0.0 else max(correlation[2 * last], 0.0)
    time = -1.0 + 2.0 * np.minimum.accumulate(pairs[:last]).sum() + beyond
    return float(halves.size / max(time, 1.0 / np.log10(halves.size)))


def _autocovariance(chains: Array) -> Array:
    """(D,) the mean over chains (D, C) of mean zero, at every lag."""
    length = scipy.fft.next_fast_len(2 * len(chains), real=True)
    spectrum = scipy.fft.rfft(chains, n=length, axis=0)
    power = np.mean(spectrum.real**2 + spectrum.imag**2, axis=1)
    covariance: Array = scipy.fft.irfft(power, n=length)[: len(chains)] / len(chains)
    return covariance
