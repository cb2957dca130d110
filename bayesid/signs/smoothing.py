"""The sign of every sample, given a fitted model: forward-backward smoothing of the model's error.

Segments are cut where |effort| is about zero, which is enough for the search. Samples near a cut, in the noise around
zero or at standstill (where friction has no known direction) depend on their neighbours too. For each joint,
:eq:`reading`::

    e_i = |mu_i + n_i|,   mu_i = p_i + b_i,

p_i the model's effort, n_i white noise with Student's t distribution, b_i the model's error: an Ornstein-Uhlenbeck
process (:eq:`model-error`), whose spread at standstill covers the static friction. Given b, both signs of e_i have the
likelihoods t(e_i - mu_i) and t(-e_i - mu_i) (:eq:`sample-likelihood`). b is scalar, so on a grid the posterior is exact
(Rabiner 1989, eqs. 19 to 27), and with it P(sign_i = +). The residual's autocorrelation is part of this likelihood.

If |effort| has passed a low-pass h after the rectifier, a reading depends on |mu| around it, and on its own sign only
through b (:eq:`filtered-likelihood`)::

    e_i = (h * E|mu + n|)_i + white noise,   P(sign_i = + | b) = P(mu_i + n_i > 0),

with n the noise that the low-pass removed, and b constant over its length. Around a zero crossing e_i depends little on
b, so its fluctuation there is that of n.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import ndtr

from bayesid.arrays import Array, Integers, Mask
from bayesid.log.low_pass import AfterRectifier, mean_magnitude
from bayesid.log.signals import Signals
from bayesid.parallel import in_parallel
from bayesid.progress import Steps, no_steps
from bayesid.regression.noise import Noise
from bayesid.signs.chain import TAILS, Chain, Single, error_chains
from bayesid.signs.tuning import TUNING, Tuning

_FARTHEST = 1e15
"""Largest effort, in scales of the white noise; its square is finite in single precision."""


def sign_probabilities(
    signals: Signals, predicted: Array, moving: Mask, noise: Noise, progress: Steps = no_steps
) -> Array:
    """(N, n) P(sign = +) of every sample: smoothed, or 0 or 1 where the sign is known.

    A joint without a used sample has no known friction and noise: 0.5. The model's effort `predicted` is (N, n) N m, or
    (N, n, K) of K draws of the model, over which to average. `moving` (N, n) is False at standstill. The noise is that
    of the residual in motion.
    """
    after, rate = signals.after_rectifier, signals.rate
    read = signals.magnitude if after is None else np.where(signals.signed, signals.magnitude, after.read)
    smoothed = smooth(read, predicted, moving, noise, rate, progress, after=after, known=signals.signed)
    return signals.with_known_signs(np.where(moving.any(axis=0), smoothed, 0.5))


def smooth(  # noqa: PLR0913  of a joint, and how it is smoothed
    effort: Array,
    predicted: Array,
    moving: Mask,
    noise: Noise,
    rate: float,
    progress: Steps = no_steps,
    tuning: Tuning = TUNING,
    after: AfterRectifier | None = None,
    known: Mask | None = None,
) -> Array:
    """(N, n) P(sign = +) of every sample of |effort| (N, n), N m, at a rate, Hz; see `sign_probabilities`.

    The efforts are as read, possibly after a low-pass behind the rectifier. Joints of `known` (n,) signs get 0.5.
    """
    hidden = [j for j in range(effort.shape[1]) if known is None or not known[j]]
    if not hidden:
        return np.full_like(effort, 0.5)
    draws = predicted if predicted.ndim == 3 else predicted[:, :, None]
    processes = _joints(effort, draws.mean(axis=2), moving, noise, rate, after)
    moves = moving.copy()
    moves[1:] &= moving[:-1]  # both ends of a standstill take a wide step
    turns = _turns(moves)
    probability = np.full_like(effort, 0.5)
    for start in range(0, len(effort), tuning.smoothed):
        stop = min(start + tuning.smoothed, len(effort))
        around = slice(max(0, start - tuning.overlap), min(len(effort), stop + tuning.overlap))
        joints = [
            partial(_smooth, effort[around, j], draws[around, j], turns[around, j], processes[j], tuning)
            for j in hidden
        ]
        many = draws[around, 0].size > tuning.side_by_side  # for less work a fork takes longer
        means = in_parallel(joints) if many else (joint() for joint in joints)
        for j, mean in zip(hidden, means, strict=True):
            probability[start:stop, j] = mean[start - around.start : stop - around.start]
        progress(stop, len(effort))
    return probability


@dataclass(frozen=True)
class _Joint:
    chain: Chain
    white: float  # scale of the white noise, N m
    after: AfterRectifier | None  # the low-pass behind the rectifier
    taken: float  # sd of the noise that it removed, N m
    rate: float  # of the samples, Hz


def _joints(
    effort: Array, predicted: Array, moving: Mask, noise: Noise, rate: float, after: AfterRectifier | None
) -> list[_Joint]:
    seen = np.abs(predicted) if after is None else after.readings(predicted, rate)
    chains = error_chains(noise, _doubt_at_rest(effort - seen, predicted, moving), rate)
    if after is not None:  # readings depend on b around them
        chains = [replace(chain, middle=chain.whole) for chain in chains]
    taken = np.zeros(len(chains)) if after is None else after.noise
    return [
        _Joint(chain, white, after, by_low_pass, rate)
        for chain, white, by_low_pass in zip(chains, noise.white.tolist(), taken.tolist(), strict=True)
    ]


def _turns(moves: Mask) -> Array:
    """(N, n) probability that friction reverses before a sample; constant within a standstill."""
    turns = np.zeros(moves.shape)
    for j in range(moves.shape[1]):
        edges = np.flatnonzero(np.diff(np.concatenate([[True], moves[:, j], [True]]).astype(int)))
        for start, end in edges.reshape(-1, 2).tolist():
            turns[start:end, j] = 1.0 - (1.0 - TUNING.turns_at_rest) ** (1.0 / (end - start))
    return turns


def _doubt_at_rest(mismatch: Array, predicted: Array, moving: Mask) -> Array:
    """(n,) sd of the model's error at standstill, N m: from |effort|, and from the unknown direction of friction.

    A friction reversal changes |effort| little. Its size is the change of the model's effort between the last sample
    before a standstill and the first one after it.
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


def _smooth(effort: Array, predicted: Array, turns: Array, joint: _Joint, tuning: Tuning) -> Array:
    """(N,) P(sign = +) of a joint's |effort| (N,), averaged over K predictions (N, K).

    `turns` (N,) are the probabilities of a friction reversal, positive at standstill. Pieces next to a standstill, and
    those that need it, use the whole grid.
    """
    length = min(tuning.piece, len(effort))
    cut = _cut(turns, length)
    wide = _and_beside(np.any(cut > 0.0, axis=0)) | (joint.chain.middle == joint.chain.whole)
    at_once = max(1, tuning.side_by_side // len(effort))
    total = np.zeros(len(effort))
    for k in range(0, predicted.shape[1], at_once):
        some = predicted[:, k : k + at_once]
        readings = (_Readings if joint.after is None else _FilteredReadings).of(effort, some, joint, length)
        while True:
            mean, leans = joint.chain.smooth(readings.weigh, cut, some.shape[1], wide)
            if not np.any(leans & ~wide):
                break
            wide = wide | _and_beside(leans)
        total += mean.sum(axis=2).T.ravel()[: len(effort)]
    return total / predicted.shape[1]


def _and_beside(pieces: Mask) -> Mask:
    """(B,) the pieces and their neighbours, as messages to the whole grid must come from a whole grid."""
    return pieces | np.append(pieces[1:], False) | np.append(False, pieces[:-1])


def _cut(values: Array | Single, length: int) -> Single:
    """(L, B, ...) from (N, ...): B pieces of L samples; the last one is padded with zeros."""
    pieces = -(-len(values) // length)
    full = np.zeros((pieces * length, *values.shape[1:]), dtype=np.float32)
    full[: len(values)] = values
    return full.reshape(pieces, length, *values.shape[1:]).swapaxes(0, 1)


@dataclass(frozen=True)
class _Readings:
    """Readings of one joint for K draws, in B pieces of L samples, in scales of the white noise."""

    up: Single  # (L, B, K) value of b at which a reading has its predicted size with sign +
    down: Single  # (L, B, K) the same with sign -
    points: Single  # (G,) the grid
    spare: int  # padding samples of the last piece

    @classmethod
    def of(cls, effort: Array, predicted: Array, joint: _Joint, length: int) -> _Readings:
        """From |effort| (N,) and predictions (N, K)."""
        scale = max(np.sqrt(TAILS) * joint.white, TUNING.finest_noise * joint.chain.grid[-1])
        signed = [np.clip((sign * effort[:, None] - predicted) / scale, -_FARTHEST, _FARTHEST) for sign in (1.0, -1.0)]
        up, down = (_cut(values, length) for values in signed)
        return cls(up, down, (joint.chain.grid / scale).astype(np.float32), -len(effort) % length)

    def weigh(self, pieces: Integers, window: slice) -> tuple[Single, Single]:
        """(L, G', R) likelihoods of b (:eq:`sample-likelihood`), up to a factor, and the share of sign +."""
        length, chains, points = len(self.up), self.up.shape[2], self.points[window, None]
        up, down = (values[:, pieces].reshape(length, 1, -1) for values in (self.up, self.down))
        least = 1.0 + np.minimum(_off(up, points), _off(down, points)) ** 2
        shape = (length, len(points), len(pieces) * chains)
        plus, likelihood, root = np.empty(shape, "f4"), np.empty(shape, "f4"), np.empty(shape[1:], "f4")
        for i in range(length):
            _students(up[i], points, least[i], root, plus[i])
            _students(down[i], points, least[i], root, likelihood[i])
            likelihood[i] += plus[i]
        if self.spare and pieces[-1] == self.up.shape[1] - 1:
            likelihood[-self.spare :, :, -chains:] = 1.0
        return likelihood, plus


def _off(values: Single, points: Single) -> Single:
    """Distance of values from the nearest point of a grid (G, 1)."""
    first, spacing = points[0, 0], points[1, 0] - points[0, 0]
    nearest = np.clip(np.rint((values - first) / spacing), 0.0, len(points) - 1.0)
    off: Single = np.abs(values - first - spacing * nearest)
    return off


def _students(values: Single, points: Single, least: Single, root: Single, out: Single) -> None:
    """Student's t of (1, R) values about a grid (G, 1), over that at a distance d; `least` is 1 + d^2."""
    np.subtract(values, points, out=out)
    np.multiply(out, out, out=out)
    np.add(out, 1.0, out=out)
    np.divide(least, out, out=out)
    np.sqrt(out, out=root)
    np.multiply(out, out, out=out)  # the power (nu + 1) / 2 = 2.5 for nu = 4
    np.multiply(out, root, out=out)


@dataclass(frozen=True)
class _FilteredReadings:
    """The same if |effort| has passed a low-pass."""

    likelihood: Single  # (L, B, K, G) of b (:eq:`filtered-likelihood`), up to a factor
    plus: Single  # (L, B, K, G) share of sign +

    @classmethod
    def of(cls, effort: Array, predicted: Array, joint: _Joint, length: int) -> _FilteredReadings:
        """From |effort| (N,) as read, and predictions (N, K)."""
        assert joint.after is not None
        grid = joint.chain.grid
        mean, spacing = predicted[..., None] + grid, grid[1] - grid[0]
        readings = joint.after.low_pass.apply(mean_magnitude(mean, joint.taken), joint.rate)
        follows = np.clip(np.gradient(readings, axis=2) / spacing, -1.0, 1.0)
        least = max(joint.white, 0.5 * spacing)  # the grid's resolution
        variance = least**2 + (1.0 - follows**2) * joint.taken**2
        misfit = 1.0 + (effort[:, None, None] - readings) ** 2 / (TAILS * variance)
        log_likelihood = -0.5 * (TAILS + 1.0) * np.log(misfit) - 0.5 * np.log(variance)
        likelihood = np.exp(log_likelihood - log_likelihood.max(axis=2, keepdims=True))
        cut = _cut(likelihood, length)
        cut[length - (-len(effort) % length) :, -1] = 1.0
        return cls(cut, cut * _cut(ndtr(mean / joint.taken), length))

    def weigh(self, pieces: Integers, window: slice) -> tuple[Single, Single]:
        """(L, G', R) likelihoods and the share of sign +."""
        shape = len(self.plus), -1, window.stop - window.start
        likelihood, plus = (values[:, pieces][..., window].reshape(shape) for values in (self.likelihood, self.plus))
        return np.ascontiguousarray(likelihood.swapaxes(1, 2)), np.ascontiguousarray(plus.swapaxes(1, 2))
