"""Convergence of several ensembles: R-hat between ensembles, effective sample sizes over walkers. By ArviZ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array
from bayesid.process import one_at_a_time, quiet

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


@one_at_a_time
def diagnose(draws: Array) -> Diagnostics:
    """Diagnostics of draws (D, E, W, K): D sweeps of E ensembles of W walkers; D >= 4. A constant counts as converged.

    Draws that are not finite give NaN, which passes no test.
    """
    with quiet(FutureWarning):  # ArviZ 0.x announces its next version on import
        import arviz  # here, for it takes half a second that no other command should wait

    sweeps, ensembles, walkers, size = draws.shape
    pooled = draws.transpose(1, 0, 2, 3).reshape(ensembles, sweeps * walkers, size)
    single = draws.transpose(1, 2, 0, 3).reshape(ensembles * walkers, sweeps, size)
    flat = np.ptp(draws, axis=(0, 1, 2)) == 0.0
    finite = np.isfinite(draws).all(axis=(0, 1, 2))
    rhat, bulk, tail = np.ones(size), np.full(size, np.inf), np.full(size, np.inf)
    rhat[~finite] = bulk[~finite] = tail[~finite] = np.nan
    for k in np.flatnonzero(finite & ~flat):
        rhat[k] = arviz.rhat(pooled[..., k], method="rank")
        bulk[k] = arviz.ess(single[..., k], method="bulk")
        tail[k] = min(arviz.ess(single[..., k], method="quantile", prob=prob) for prob in _TAILS)
    count = float(sweeps * ensembles * walkers)  # of a few sweeps, estimates may exceed the number of draws
    return Diagnostics(rhat, np.minimum(bulk, count), np.minimum(tail, count))
