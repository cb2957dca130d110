"""Logs as they would be after filters that cost nothing."""

import numpy as np

from bayesid.discrepancy.compare import Trial
from bayesid.log.signals import Signals

RATE = 100.0


def made_trial(motion, effort, used=None, signed=False):
    """Every sample is used unless stated otherwise; joints without a sign have |effort|."""
    every = np.ones(effort.shape, dtype=bool)
    flags = np.broadcast_to(np.asarray(signed, dtype=bool), effort.shape[1])
    raw = np.where(flags, effort, np.abs(effort))
    return Trial(Signals(motion, raw, raw, flags, RATE, 20.0, {}, every), motion, every if used is None else used)
