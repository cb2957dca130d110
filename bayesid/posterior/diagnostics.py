"""Convergence of several ensembles, by ArviZ: R-hat between ensembles, effective sample sizes over walkers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array
from bayesid.parallel import one_at_a_time

_TAILS = (0.05, 0.95)
"""Quantiles whose effective sample size is that of the tails (Vehtari et al. 2021)."""


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


@one_at_a_time  # ArviZ changes warnings as it goes
def diagnose(draws: Array) -> Diagnostics:
    """Diagnostics of draws (D, E, W, K): D sweeps of E ensembles of W walkers; D >= 4.

    A constant counts as converged. Draws that are not finite give NaN, which passes no test. Of an odd number of sweeps
    R-hat leaves out the middle one, which ArviZ would cut in two; of one ensemble it compares quarters, not halves.
    """
    from arviz_stats.base import array_stats  # takes a second, for a posterior alone

    sweeps, ensembles = draws.shape[:2]
    count = float(draws[..., 0].size)
    finite = np.isfinite(draws).all(axis=(0, 1, 2))
    moving = finite & (np.ptp(draws, axis=(0, 1, 2)) > 0.0)
    rhat = np.where(finite, 1.0, np.nan)
    bulk, tail = np.where(finite, [[count], [count]], np.nan)
    halves = np.r_[: sweeps // 2, sweeps - sweeps // 2 : sweeps]
    for k in np.flatnonzero(moving).tolist():
        by_walker = draws[..., k].transpose(1, 2, 0).reshape(-1, sweeps)
        by_ensemble = draws[halves, ..., k].swapaxes(0, 1).reshape(max(ensembles, 2), -1)
        with np.errstate(divide="ignore", invalid="ignore"):  # infinite where no ensemble moves
            rhat[k] = array_stats.rhat(by_ensemble)
        bulk[k] = array_stats.ess(by_walker, method="bulk")
        tail[k] = array_stats.ess(by_walker, method="tail", prob=_TAILS)
    return Diagnostics(rhat, np.minimum(bulk, count), np.minimum(tail, count))  # of few sweeps, estimates exceed it
