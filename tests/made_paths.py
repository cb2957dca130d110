"""Poses and paths for the tests of collision models."""

import numpy as np

FINE = np.linspace(0.0, 1.5, 2001)
GJK = 1e-5  # ten times the tolerance of coal's iterations


def poses(n, count, seed=0, size=2.5):
    return np.random.default_rng(seed).uniform(-size, size, (count, n))


def sines(n, seed, size=1.0):
    """A motion (path, bounds of its speeds) with amplitudes of their own."""
    rng = np.random.default_rng(seed)
    start, amplitude, rate, phase = rng.uniform([[-2], [0.2], [0.5], [0]], [[2], [0.6], [3.0], [6]], (4, n))

    def path(t):
        return start + size * amplitude * np.sin(rate * t[:, None] + phase)

    return path, size * amplitude * rate
