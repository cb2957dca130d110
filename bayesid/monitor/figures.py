"""What there is to say of a stream as a whole, gathered sample by sample in memory that does not grow."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.monitor.tracked import REST, Tracked

_FIRST, _STEP, _BINS = 1e-6, math.log(1.01), 2000
"""s of the first bin of the update times, log of the ratio of two bins, and how many: up to minutes, to 1 %."""


@dataclass
class UpdateTimes:
    """How long updates took, as a histogram.

    Attributes:
        counts: of the bins.
    """

    counts: Integers = field(default_factory=lambda: np.zeros(_BINS, dtype=np.int64))

    def add(self, seconds: float) -> None:
        """One update more."""
        place = int(math.log(max(seconds, _FIRST) / _FIRST) / _STEP)
        self.counts[min(place, _BINS - 1)] += 1

    def quantile(self, share: float) -> float:
        """s, to 1 %; nan where there was no update."""
        total = self.counts.sum()
        if not total:
            return math.nan
        place = int(np.searchsorted(np.cumsum(self.counts), share * total))
        return _FIRST * math.exp(_STEP * (place + 0.5))


@dataclass
class StreamFigures:
    """Of n joints.

    Attributes:
        moving: (n,) instants in motion.
        squares: (n,) sum of the squared residuals in motion, (N m)^2.
        pushed: (n,) largest external torque over its threshold so far, of two samples in a row the lesser, as the test
            of a contact takes it (`bayesid.monitor.changes`); nan while none is known.
        instants: that were looked at.
        times: of the updates.
        last: (n,) external torque over its threshold in the last sample; nan where it was not known.
    """

    moving: Integers
    squares: Array
    pushed: Array
    instants: int = 0
    times: UpdateTimes = field(default_factory=UpdateTimes)
    last: Array | None = None

    @classmethod
    def of_joints(cls, n: int) -> StreamFigures:
        """Before the first sample."""
        return cls(np.zeros(n, dtype=np.int64), np.zeros(n), np.full(n, np.nan))

    def add(self, now: Tracked) -> None:
        """One instant more that was looked at."""
        self.instants += 1
        counts = np.array([state != REST for state in now.state]) & np.isfinite(now.residual)
        self.moving += counts
        self.squares += np.where(counts, now.residual, 0.0) ** 2
        ratio = np.where(np.isfinite(now.threshold), np.abs(now.external) / now.threshold, np.nan)
        if self.last is not None:
            self.pushed = np.fmax(self.pushed, np.minimum(ratio, self.last))
        self.last = ratio

    @property
    def rms(self) -> Array:
        """(n,) RMS of the residuals in motion, N m; nan of joints that never moved."""
        return np.where(self.moving > 0, np.sqrt(self.squares / np.maximum(self.moving, 1)), np.nan)


def looked_at(now: Tracked) -> bool:
    """Whether an update has brought an instant of which something is known."""
    return now.fresh and bool(np.isfinite(now.predicted).all())
