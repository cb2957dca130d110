"""Errors of efforts as dense matrices: white noise beside an AR(1) process, and the filter that makes them white."""

from __future__ import annotations

import numpy as np


def covariance(error, count):
    """(count, count) white on the diagonal, and exp(-|dt| / T)."""
    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count))) / error.rate
    return error.white**2 * np.eye(count) + error.coloured**2 * np.exp(-apart / error.correlation)


def bridging(used):
    """(N, N) matrix that puts what is not used on straight lines between its used neighbours."""
    places, rows = np.arange(len(used)), np.flatnonzero(used)
    return np.stack([np.interp(places, rows, np.eye(len(used))[rows, k]) for k in places], axis=1)


def whitening(error, count):
    """(count, count) T with T x white, of unit size: x_i - phi x_(i-1) is a moving average of order one, from rest."""
    phi = np.exp(-1.0 / (error.correlation * error.rate))
    own = error.coloured**2 * (1.0 - phi**2) + error.white**2 * (1.0 + phi**2)
    next_to = -phi * error.white**2
    theta = min(np.roots([next_to, own, next_to]).real, key=abs)
    shift = np.eye(count, k=-1)
    return np.linalg.solve(np.eye(count) - theta * shift, np.eye(count) - phi * shift) / np.sqrt(-next_to / theta)
