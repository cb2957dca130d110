"""The sign of every single sample, given a fitted model: forward-backward smoothing of the model's error.

Segments are cut where |effort| looks like touching zero, and they are all the search needs. But samples near a cut,
in the noise around zero or at standstill (where nobody knows friction's direction) are better judged together with
their neighbours. For each joint,

    e_i = |mu_i + n_i|,   mu_i = p_i + b_i,

p_i the model's effort, n_i white noise, b_i the model's error: an Ornstein-Uhlenbeck process, wider at standstill,
where it must hold all of the static friction. Given b, both signs of e_i are possible with the likelihoods
N(e_i; mu_i) and N(-e_i; mu_i). b is one number, so on a grid the posterior is exact (Rabiner 1989, eqs. 19 to 27), and
with it P(sign_i = +): a sign-marginalised likelihood in which the residual's autocorrelation is part of the model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.motion import Array, Mask
from bayesid.noise import Noise

_IMPOSSIBLE = 1e-30
_GRID = 101
_REACH = 4.0
"""Half-width of the grid in standard deviations of b."""
_REST_TIME = 0.2
"""s; how fast static friction may build up."""
_BLOCK, _OVERLAP = 20_000, 1_000
"""Samples smoothed at once, and how far a block looks into its neighbours: memory stays bounded on long logs."""


def sign_probabilities(effort: Array, predicted: Array, moving: Mask, noise: Noise, rate: float) -> Array:
    """(N, n) P(sign = +) of every sample.

    Args:
        effort: (N, n) unfiltered |effort|, N m.
        predicted: (N, n) the model's effort, N m.
        moving: (N, n) False at standstill.
        noise: of the residual in motion.
        rate: Hz.
    """
    process = _process(effort, predicted, moving, noise, rate)
    probability = np.empty_like(effort)
    for start in range(0, len(effort), _BLOCK):
        stop = min(start + _BLOCK, len(effort))
        around = slice(max(0, start - _OVERLAP), min(len(effort), stop + _OVERLAP))
        block = _smooth(effort[around], predicted[around], moving[around], process)
        probability[start:stop] = block[start - around.start : stop - around.start]
    return probability


@dataclass(frozen=True)
class _Process:
    """The hidden process of every joint on its grid.

    Attributes:
        grid: (n, G) values of b, N m.
        white: (n, 1) sd of the white noise, N m.
        step: (2, n, G, G) transition probabilities, at standstill and in motion.
        prior: (n, G) stationary distribution in motion.
    """

    grid: Array
    white: Array
    step: Array
    prior: Array


def _process(effort: Array, predicted: Array, moving: Mask, noise: Noise, rate: float) -> _Process:
    mismatch = np.where(moving, 0.0, effort - np.abs(predicted))
    at_rest = np.sqrt((mismatch**2).sum(axis=0) / np.maximum((~moving).sum(axis=0), 1))
    rest = np.maximum(at_rest, noise.coloured)
    grid = (_REACH * rest)[:, None] * np.linspace(-1.0, 1.0, _GRID)
    rest_step = _transitions(grid, rest, np.full(len(rest), np.exp(-1.0 / (_REST_TIME * rate))))
    step = _transitions(grid, noise.coloured, np.exp(-1.0 / (noise.correlation * rate)))
    prior = np.exp(-0.5 * (grid / noise.coloured[:, None]) ** 2)
    return _Process(grid, noise.white[:, None], np.stack([rest_step, step]), prior / prior.sum(axis=1, keepdims=True))


def _transitions(grid: Array, sd: Array, memory: Array) -> Array:
    """(n, G, G) rows of p(b' | b) of an Ornstein-Uhlenbeck process; no narrower than the grid can show."""
    spread = np.maximum(sd * np.sqrt(1.0 - memory**2), 0.75 * (grid[:, 1] - grid[:, 0]))
    distance = grid[:, None, :] - memory[:, None, None] * grid[:, :, None]
    density = np.exp(-0.5 * (distance / spread[:, None, None]) ** 2)
    density += _IMPOSSIBLE  # beliefs must not die out where model and effort contradict each other
    return density / density.sum(axis=2, keepdims=True)


def _smooth(effort: Array, predicted: Array, moving: Mask, process: _Process) -> Array:
    """(N, n) P(sign = +) by one forward and one backward pass."""
    n_samples, n = effort.shape
    joints, all_moving, state = np.arange(n), np.all(moving, axis=1), moving.astype(np.int64)

    def step(i: int) -> Array:
        return process.step[1] if all_moving[i] else process.step[state[i], joints]

    forward = np.empty((n_samples, *process.grid.shape))
    belief = process.prior
    for i in range(n_samples):
        if i:
            belief = (belief[:, None, :] @ step(i))[:, 0]
        belief = belief * _likelihoods(effort[i], predicted[i], process)[0]
        belief /= belief.sum(axis=1, keepdims=True)
        forward[i] = belief
    probability = np.empty((n_samples, n))
    future = np.ones_like(belief)
    for i in range(n_samples - 1, -1, -1):
        likelihood, plus = _likelihoods(effort[i], predicted[i], process)
        both = forward[i] * future
        probability[i] = (both * plus).sum(axis=1) / both.sum(axis=1)
        future = (step(i) @ (likelihood * future)[:, :, None])[:, :, 0]
        future /= future.sum(axis=1, keepdims=True)
    return probability


def _likelihoods(effort: Array, predicted: Array, process: _Process) -> tuple[Array, Array]:
    """(n, G) likelihood of one |effort| for every b, up to a factor, and P(sign = + | b)."""
    mean = predicted[:, None] + process.grid
    quadratic = -0.5 * ((effort[:, None] - np.abs(mean)) / process.white) ** 2  # the likelier of the two signs
    odds = np.exp(-2.0 * effort[:, None] * np.abs(mean) / process.white**2)  # of the other one against it
    likelihood = np.maximum(np.exp(quadratic - quadratic.max(axis=1, keepdims=True)), _IMPOSSIBLE) * (1.0 + odds)
    plus = np.where(mean >= 0.0, 1.0, odds) / (1.0 + odds)
    return likelihood, plus
