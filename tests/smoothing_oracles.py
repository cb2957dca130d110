"""What smoothing and filtering of signs are held to: sizes by definition, and paths of the hidden error, weighed."""

import numpy as np
from scipy.stats import t

from bayesid.regression.noise import Noise


def noise_of(white, coloured, correlation, n=1):
    """The same of n joints."""
    return Noise(np.full(n, white), np.full(n, coloured), np.full(n, correlation), np.ones(n))


def size_at_rest(effort, predicted, moving, coloured):
    """RMS of what |effort| shows at rest, or half the RMS jump over standstills; no less than in motion."""
    rest = ~moving
    shown = np.sqrt(np.mean((effort - np.abs(predicted))[rest] ** 2)) if rest.any() else 0.0
    jumps, last = [], None
    for i, moves in enumerate(moving):
        if moves and last is not None and i - last > 1:
            jumps.append(predicted[i] - predicted[last])
        last = i if moves else last
    return max(shown, 0.5 * np.sqrt(np.mean(np.square(jumps))) if jumps else 0.0, coloured)


def ornstein_uhlenbeck(size, memory, rng):
    """Steps of a process of a size, sd, from one value to the next."""
    return lambda b: memory * b + size * np.sqrt(1.0 - memory**2) * rng.standard_normal(len(b))


def weighed_paths(effort, predicted, white, first, steps, look_ahead=None):
    """(N',) P(sign = +) and its Monte Carlo error, by weighing paths of the error: no grid, no recursion over beliefs.

    `white` is the scale of a Student's t of four degrees, `first` the paths' first errors, `steps` those from each
    sample to the next; `look_ahead` samples are waited for, all if None.
    """
    b, log_weight, plus, found = first, np.zeros(len(first)), [], []
    for i, (e, p) in enumerate(zip(effort, predicted, strict=True)):
        b = steps[i - 1](b) if i else b
        up, down = t(4).pdf((e - p - b) / white), t(4).pdf((-e - p - b) / white)
        log_weight = log_weight + np.log(up + down)
        plus.append(up / (up + down))
        if look_ahead is not None and i >= look_ahead:
            weight = np.exp(log_weight - log_weight.max())
            found.append(weight @ plus[i - look_ahead] / weight.sum())
    weight = np.exp(log_weight - log_weight.max())
    error = 0.5 * np.sqrt((weight**2).sum()) / weight.sum()
    return np.array([weight @ share for share in plus]) / weight.sum() if look_ahead is None else np.array(found), error
