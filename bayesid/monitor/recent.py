"""The last seconds of a stream: as a log, for `bayesid.find_discrepancy`, and as a look at what has changed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.monitor.kinds import Look

_SECONDS = 20.0
"""s that are remembered: as long as the shorter logs from which robots are identified. A round number; not studied."""
_MOST = 20_000
"""Rows, for memory: the last 2 s at 10 kHz."""


@dataclass
class Ring:
    """The newest rows of a table.

    Attributes:
        rows: (R, C) the oldest at `count` modulo R.
        count: rows so far.
    """

    rows: Array
    count: int = 0

    @classmethod
    def of(cls, seconds: float, rate: float, width: int) -> Ring:
        """Empty, for so many seconds at a rate, Hz."""
        return cls(np.full((max(8, min(_MOST, int(seconds * rate) + 1)), width), np.nan))

    def add(self, t: float, *parts: Array) -> None:
        """One more row: an instant, s, and parts one after the other."""
        row, start = self.rows[self.count % len(self.rows)], 1
        row[0] = t
        for part in parts:
            row[start : start + part.size] = part.ravel()
            start += part.size
        self.count += 1

    def newest(self) -> Array:
        """(R', C) the rows in their order."""
        if self.count <= len(self.rows):
            return self.rows[: self.count]
        at = self.count % len(self.rows)
        return np.concatenate([self.rows[at:], self.rows[:at]])


@dataclass
class Recent:
    """What was recorded, and what it looked like to the model now and then.

    Attributes:
        log: rows t, q, effort, dq, nan where not measured.
        looks: rows t, reading, effort, width, body, direction, speed (see `bayesid.monitor.kinds.Look`).
    """

    log: Ring
    looks: Ring

    @classmethod
    def begin(cls, n: int, rate: float, look_rate: float) -> Recent:
        """Before the first sample."""
        return cls(Ring.of(_SECONDS, rate, 1 + 3 * n), Ring.of(_SECONDS, look_rate, 1 + 9 * n))

    def look(self, since: float, signed: Mask, weight: Array) -> Look:
        """What was seen since an instant, s."""
        n = len(signed)
        rows = self.looks.newest()
        rows = rows[rows[:, 0] >= since]
        reading, effort, width, body, direction, speed = np.split(rows[:, 1:], n * np.array([1, 2, 3, 7, 8]), axis=1)
        return Look(reading, effort, width, body.reshape(-1, n, 4), direction, speed, signed, weight)
