"""The sign of every single sample, given a fitted model: forward-backward smoothing of the model's error.

Segments are cut where |effort| looks like touching zero, and they are all the search needs. But samples near a cut,
in the noise around zero or at standstill (where nobody knows friction's direction) are better judged together with
their neighbours. For each joint, :eq:`reading`::

    e_i = |mu_i + n_i|,   mu_i = p_i + b_i,

p_i the model's effort, n_i white noise with the tails of Student's t, b_i the model's error: an Ornstein-Uhlenbeck
process (:eq:`model-error`), wider at standstill, where it must hold all of the static friction. Given b, both signs of
e_i are possible with the likelihoods t(e_i - mu_i) and t(-e_i - mu_i) (:eq:`sample-likelihood`). b is one number, so on
a grid the posterior is exact (Rabiner 1989, eqs. 19 to 27), and with it P(sign_i = +): a sign-marginalised likelihood
in which the residual's autocorrelation is part of the model.

Where |effort| has passed a low-pass h after the rectifier, a reading tells of |mu| all around it, and its own sign only
by way of b (:eq:`filtered-likelihood`)::

    e_i = (h * E|mu + n|)_i + white noise,   P(sign_i = + | b) = P(mu_i + n_i > 0),

n the noise that has not passed and b taken to be constant over its length. Around a zero crossing e_i hardly depends on
b; in return it fluctuates by itself: its noise there is n's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from bayesid.arrays import Array, Mask
from bayesid.fit.noise import Noise
from bayesid.log.low_pass import AfterRectifier
from bayesid.log.signals import Signals
from bayesid.progress import Steps, no_steps

_IMPOSSIBLE = 1e-30
"""Transition density that no step falls below: far under any likelihood, far over the smallest double."""
_GRID = 101
"""Values of b: with `_REACH` a spacing of 0.08 standard deviations, below what transitions can resolve."""
_FINEST = 0.75
"""Spacings of the grid: a narrower transition would fall between its points. A round number; not studied."""
_REACH = 4.0
"""Half-width of the grid in standard deviations of b."""
_REST_TIME = 0.5
"""s; how fast static friction may build up. A round number; not studied."""
_TURNS = 0.5
"""Probability that friction turns round at once in a standstill, at any of its samples: nothing is known of it."""
_TAILS = 4.0
"""Degrees of freedom of the white noise: real residuals have outliers that a normal distribution thinks impossible. A
round number; not studied."""


@dataclass(frozen=True, kw_only=True)
class Blocks:
    """What is smoothed at once: memory stays bounded, at 430 MB of forward beliefs for six joints.

    Attributes:
        samples: of a block.
        overlap: samples by which a block looks into its neighbours: many correlation times of the model's error.
        draws: of the model.
    """

    samples: int = 20_000
    overlap: int = 1_000
    draws: int = 4


_HALVED = Blocks(samples=10_000)
"""Readings behind a low-pass take as much memory again."""


def sign_probabilities(
    signals: Signals, predicted: Array, moving: Mask, noise: Noise, progress: Steps = no_steps
) -> Array:
    """(N, n) P(sign = +) of every sample: smoothed, or 0 or 1 where the sign is known.

    Of a joint without a single sample to go by nothing is known of friction and noise: 0.5.

    Args:
        signals: the log.
        predicted: (N, n) the model's effort, N m; or (N, n, K) of K draws of the model, over which to average.
        moving: (N, n) False at standstill.
        noise: of the residual in motion.
        progress: called as progress(done, total).
    """
    after, rate = signals.after_rectifier, signals.rate
    if after is None:
        smoothed = smooth(signals.magnitude, predicted, moving, noise, rate, progress)
    else:
        read = np.where(signals.signed, signals.magnitude, after.read)
        smoothed = smooth(read, predicted, moving, noise, rate, progress, _HALVED, after)
    return signals.with_known_signs(np.where(moving.any(axis=0), smoothed, 0.5))


def smooth(
    effort: Array,
    predicted: Array,
    moving: Mask,
    noise: Noise,
    rate: float,
    progress: Steps = no_steps,
    blocks: Blocks = Blocks(),
    after: AfterRectifier | None = None,
) -> Array:
    """(N, n) P(sign = +) of every sample of |effort| (N, n), N m, at a rate, Hz; see `sign_probabilities`.

    The efforts are as they were read: those that have passed a low-pass after the rectifier as well.
    """
    draws = predicted if predicted.ndim == 3 else predicted[:, :, None]
    process = _process(effort, draws.mean(axis=2), moving, noise, rate, after)
    moves = moving.copy()
    moves[1:] &= moving[:-1]  # a standstill is left as it is entered: by a wide step
    turns = _turns(moves)
    probability = np.zeros_like(effort)
    for start in range(0, len(effort), blocks.samples):
        stop = min(start + blocks.samples, len(effort))
        around = slice(max(0, start - blocks.overlap), min(len(effort), stop + blocks.overlap))
        for k in range(0, draws.shape[2], blocks.draws):
            last = min(k + blocks.draws, draws.shape[2])
            block = _smooth(effort[around], draws[around, :, k:last], turns[around], process)
            probability[start:stop] += block[start - around.start : stop - around.start].sum(axis=2)
            progress(start * draws.shape[2] + (stop - start) * last, draws[:, 0].size)
    return probability / draws.shape[2]


@dataclass(frozen=True)
class _Process:
    """The hidden process of every joint on its grid.

    Attributes:
        grid: (n, G) values of b, N m.
        white: (n,) scale of the white noise, N m.
        step: (2, n, G, G) transition probabilities, at standstill and in motion.
        prior: (n, G) stationary distribution in motion.
        rest: (n, G) and at standstill.
        rate: of the samples, Hz.
        after: what |effort| has passed after the rectifier; None where there is nothing.
    """

    grid: Array
    white: Array
    step: Array
    prior: Array
    rest: Array
    rate: float
    after: AfterRectifier | None


def _process(
    effort: Array, predicted: Array, moving: Mask, noise: Noise, rate: float, after: AfterRectifier | None
) -> _Process:
    seen = np.abs(predicted) if after is None else after.readings(predicted, rate)
    rest = np.maximum(_doubt_at_rest(effort - seen, predicted, moving), noise.coloured)
    grid = (_REACH * rest)[:, None] * np.linspace(-1.0, 1.0, _GRID)
    step = _transitions(grid, noise.coloured, np.exp(-1.0 / (noise.correlation * rate)))
    rest_step = _transitions(grid, rest, np.full(len(rest), np.exp(-1.0 / (_REST_TIME * rate))))
    prior, at_rest = _stationary(grid, noise.coloured), _stationary(grid, rest)
    return _Process(grid, noise.white, np.stack([rest_step, step]), prior, at_rest, rate, after)


def _turns(moves: Mask) -> Array:
    """(N, n) probability that friction turns round at once before a sample: over each standstill in all, `_TURNS`."""
    turns = np.zeros(moves.shape)
    for j in range(moves.shape[1]):
        edges = np.flatnonzero(np.diff(np.concatenate([[True], moves[:, j], [True]]).astype(int)))
        for start, end in edges.reshape(-1, 2).tolist():
            turns[start:end, j] = 1.0 - (1.0 - _TURNS) ** (1.0 / (end - start))
    return turns


def _doubt_at_rest(mismatch: Array, predicted: Array, moving: Mask) -> Array:
    """(n,) sd of the model's error at standstill, N m: what |effort| shows of it, and what it cannot show.

    Friction that has turned round already, or not yet, leaves |effort| nearly as it was. The change of the model's
    effort from the last sample before a standstill to the first one after it shows how much that is.
    """
    mismatch = np.where(moving, 0.0, mismatch)
    seen = np.sqrt((mismatch**2).sum(axis=0) / np.maximum((~moving).sum(axis=0), 1))
    jump = np.zeros(len(seen))
    for j in range(len(seen)):
        edges = np.flatnonzero(np.diff(moving[:, j].astype(int)))
        before, after = edges[:-1][~moving[edges[:-1] + 1, j]], edges[1:][moving[edges[1:] + 1, j]] + 1
        if before.size and after.size:
            first = np.searchsorted(after, before, side="right")
            pairs = first < len(after)
            change = predicted[after[first[pairs]], j] - predicted[before[pairs], j]
            jump[j] = np.sqrt(np.mean(change**2)) if change.size else 0.0
    return np.maximum(seen, 0.5 * jump)


def _stationary(grid: Array, sd: Array) -> Array:
    """(n, G) normal distribution on the grid."""
    density = np.exp(-0.5 * (grid / sd[:, None]) ** 2)
    normal: Array = density / density.sum(axis=1, keepdims=True)
    return normal


def _transitions(grid: Array, sd: Array, memory: Array) -> Array:
    """(n, G, G) rows of p(b' | b) of an Ornstein-Uhlenbeck process; no narrower than the grid can show."""
    spread = np.maximum(sd * np.sqrt(1.0 - memory**2), _FINEST * (grid[:, 1] - grid[:, 0]))
    distance = grid[:, None, :] - memory[:, None, None] * grid[:, :, None]
    density = np.exp(-0.5 * (distance / spread[:, None, None]) ** 2)
    density += _IMPOSSIBLE  # beliefs must not die out where model and effort contradict each other
    return density / density.sum(axis=2, keepdims=True)


def _smooth(effort: Array, predicted: Array, turns: Array, process: _Process) -> Array:
    """(N, n, K) P(sign = +) for K predictions (N, n, K), by one forward and one backward pass.

    Where friction may turn round at once, with the probabilities `turns` (N, n), a joint is at standstill.
    """
    n_samples, n, draws = predicted.shape
    joints, moves = np.arange(n), turns == 0.0
    all_moving, state = np.all(moves, axis=1), moves.astype(np.int64)
    likelihoods = _likelihoods_of(effort, predicted, process)

    def step(i: int) -> Array:
        return process.step[1] if all_moving[i] else process.step[state[i], joints]

    def turned(i: int, stays: Array, turns_round: Array) -> Array:
        turn = turns[i][:, None, None]
        return stays if all_moving[i] else (1.0 - turn) * stays + turn * turns_round

    forward = np.empty((n_samples, n, draws, process.grid.shape[1]))
    belief = np.repeat(process.prior[:, None], draws, axis=1)
    for i in range(n_samples):
        if i:
            belief = turned(i, belief @ step(i), process.rest[:, None])
        belief = belief * likelihoods(i)[0]
        belief /= belief.sum(axis=2, keepdims=True)
        forward[i] = belief
    probability = np.empty(predicted.shape)
    future = np.ones_like(belief)
    for i in range(n_samples - 1, -1, -1):
        likelihood, plus = likelihoods(i)
        both = forward[i] * future
        probability[i] = (both * plus).sum(axis=2) / both.sum(axis=2)
        then = likelihood * future
        future = turned(i, then @ step(i).swapaxes(1, 2), then @ process.rest[:, :, None])
        future /= future.sum(axis=2, keepdims=True)
    return probability


def _likelihoods_of(effort: Array, predicted: Array, process: _Process) -> Callable[[int], tuple[Array, Array]]:
    """From a sample to what `_likelihoods` gives of it."""
    after = process.after
    if after is None:
        return lambda i: _likelihoods(effort[i], predicted[i], process)
    readings = after.readings(predicted[..., None] + process.grid[:, None], process.rate)
    return lambda i: _filtered_likelihoods(effort[i], predicted[i], readings[i], process, after.noise[:, None, None])


def _filtered_likelihoods(
    effort: Array, predicted: Array, readings: Array, process: _Process, before: Array
) -> tuple[Array, Array]:
    """The same where |effort| has passed a low-pass, of its mean readings (n, K, G).

    `before` (n, 1, 1) is the sd of the noise that did not pass.
    """
    grid = process.grid[:, None]
    spacing = (process.grid[:, 1] - process.grid[:, 0])[:, None, None]
    follows = np.clip(np.gradient(readings, axis=2) / spacing, -1.0, 1.0)
    least = np.maximum(process.white[:, None, None], 0.5 * spacing)  # the grid tells no finer
    variance = least**2 + (1.0 - follows**2) * before**2
    misfit = 1.0 + (effort[:, None, None] - readings) ** 2 / (_TAILS * variance)
    log_likelihood = -0.5 * (_TAILS + 1.0) * np.log(misfit) - 0.5 * np.log(variance)
    likelihood = np.exp(log_likelihood - log_likelihood.max(axis=2, keepdims=True))
    return likelihood, ndtr((predicted[:, :, None] + grid) / before)


def _likelihoods(effort: Array, predicted: Array, process: _Process) -> tuple[Array, Array]:
    """(n, K, G) likelihood of one |effort| (n,) for every draw (n, K) and b, up to a factor, and P(sign = + | b)."""
    mean = predicted[:, :, None] + process.grid[:, None]
    seen, white = effort[:, None, None], np.sqrt(_TAILS) * process.white[:, None, None]
    likelier = 1.0 + ((seen - np.abs(mean)) / white) ** 2  # of the two signs
    other = 1.0 + ((seen + np.abs(mean)) / white) ** 2
    odds = (likelier / other) ** (0.5 * (_TAILS + 1.0))
    least = likelier.min(axis=2, keepdims=True)
    likelihood = (least / likelier) ** (0.5 * (_TAILS + 1.0)) * (1.0 + odds)
    plus = np.where(mean >= 0.0, 1.0, odds) / (1.0 + odds)
    return likelihood, plus
