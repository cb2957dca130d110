"""How much memory an identification will need, told before it begins."""

from __future__ import annotations

import os

import numpy as np

from bayesid.errors import InputError
from bayesid.log.log import Log

_AT_LEAST = 0.4e9
"""Bytes, whatever the log: what is loaded, and one block of `bayesid.signs.smoothing`. As measured."""
_A_VALUE = 30.0
"""Bytes for each value of |effort| on the log's even grid, which is read and filtered joint by joint."""
_A_KEPT_VALUE, _KEPT = 800.0, 100_000
"""Bytes more for each that is left when a long log has been thinned to about so many instants: columns of all terms,
and what a fit makes of them. As measured on a UR10e's logs: 0.6 GB in all for 100,000 rows, 1.0 GB for 360,000, 1.4 GB
for 3,600,000."""
_USUAL_SHARE = 0.8
"""Of the machine's memory, which an identification may have unless another limit is asked for. A round number."""


def check_memory(log: Log, limit: float | None) -> None:
    """Checks that a log fits, from its rows, its joints and the even grid on which it will lie.

    Args:
        log: as read.
        limit: GB; 0.8 of the machine's memory where it is None, and none where the system does not tell that.

    Raises:
        InputError: it does not fit.
    """
    allowed = _usual_limit() if limit is None else limit
    needed = memory_needed(log)
    if needed > allowed:
        said = (
            f"{len(log)} rows of {log.n_joints} joints need about {needed:.2g} GB of memory, {allowed:.2g} are allowed"
        )
        raise InputError(
            said, log.source, "give more `Preparation.max_memory`, resample the log at a lower rate, or cut it"
        )


def memory_needed(log: Log) -> float:
    """GB that an identification of a log will need at its peak, about."""
    steps = np.diff(log.t)
    grid = (log.t[-1] - log.t[0]) / max(float(np.median(steps)), np.finfo(float).tiny) if len(steps) else 0.0
    instants = max(float(len(log)), grid)
    return float(1e-9 * (_AT_LEAST + log.n_joints * (_A_VALUE * instants + _A_KEPT_VALUE * min(instants, _KEPT))))


def _usual_limit() -> float:
    try:
        return 1e-9 * _USUAL_SHARE * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):  # Windows has no sysconf
        return float("inf")
