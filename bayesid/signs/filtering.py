"""The sign of every sample in real time, or with a delay of a few samples.

The model's error b is filtered on a grid. A reading multiplies the distribution of b (:eq:`sample-likelihood`), a time
step spreads it (:eq:`model-error`). P(sign = +) is the positive sign's share. With a delay of L samples, their
likelihoods are passed backwards too (Rabiner 1989, section III.A; fixed-lag smoothing).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bayesid.arrays import Array, Mask, every
from bayesid.regression.noise import Noise
from bayesid.signs.chain import TAILS, Single, error_chains
from bayesid.signs.tuning import TUNING

_ONE = np.float32(1.0)
_LEAST = np.float32(1e-30)
"""Least weight of a distribution, so that outliers do not make it zero."""


@dataclass(frozen=True)
class SignFilter:
    """Filter of the hidden error of n joints on grids of G values; its state is a `Belief`."""

    grid: Single  # (n, G) values of b, N m
    white: Array  # (n,) sd of the white noise, N m
    forwards: Single  # (n, G, G) columns of transition probabilities in motion
    backwards: Single  # (n, G, G) rows of the same
    rest_forwards: Single  # (n, G, G) at standstill
    rest_backwards: Single  # (n, G, G) at standstill
    afresh: Single  # (n, G) distribution of b after a restart at standstill
    start: Single  # (n, G) distribution of its first value
    turns: float  # probability of a restart in a step
    stride: int  # samples from one step to the next
    look_ahead: int  # L samples of delay

    @classmethod
    def of(cls, noise: Noise, at_rest: Array, rate: float, look_ahead: int = 0) -> SignFilter:
        """From the residual's noise in motion, its sd (n,) N m at standstill, and the rate, Hz."""
        stride = max(1, int(rate / TUNING.fastest_filter))
        steps = rate / stride
        chains = error_chains(noise, at_rest, steps)
        moving, resting = (_single([getattr(chain, name) for chain in chains]) for name in ("moving", "resting"))
        return cls(
            grid=_single([chain.grid for chain in chains]),
            white=noise.white,
            forwards=_single(moving.swapaxes(1, 2)),
            backwards=moving,
            rest_forwards=_single(resting.swapaxes(1, 2)),
            rest_backwards=resting,
            afresh=_single([chain.afresh for chain in chains]),
            start=_single([chain.start for chain in chains]),
            turns=1.0 - (1.0 - TUNING.turns_at_rest) ** (1.0 / max(1.0, TUNING.rest_time * steps)),
            stride=stride,
            look_ahead=look_ahead,
        )

    def begin(self) -> Belief:
        """The state before the first reading."""
        return Belief(self.start.copy(), np.ones(len(self.grid), dtype=bool), 0, deque(maxlen=self.look_ahead + 1))

    def update(
        self, belief: Belief, reading: Array, predicted: Array, sd: Array, moves: Mask
    ) -> tuple[Array | None, Array]:
        """(n,) P(sign = +) of the reading L samples ago, None at first; and of this reading from the past only.

        Changes the belief. A reading (n,) is |effort|, N m, nan if missing; a prediction (n,) has an sd (n,) from its
        motion; `moves` (n,) is False at standstill.
        """
        plus, likelihood = self._weigh(reading, predicted, sd)
        steps, both = belief.count > 0 and belief.count % self.stride == 0, moves & belief.moved
        before = self._step(belief.weights, both) + _LEAST if steps else belief.weights
        after = before * likelihood
        total = np.add.reduce(after, axis=1)
        now = np.minimum(np.vecdot(before, plus) / total, _ONE).astype(float)
        after /= total[:, None]
        belief.weights, belief.moved, belief.count = after, moves, belief.count + 1
        if self.look_ahead == 0:
            return now, now
        belief.past.append(_Past(before, plus, likelihood, both, steps))
        return self._looked_back(*belief.past) if belief.count > self.look_ahead else None, now

    def _weigh(self, reading: Array, predicted: Array, sd: Array) -> tuple[Single, Single]:
        """(n, G) likelihoods of b for the positive sign, and for both, up to a factor."""
        scale = np.maximum(np.sqrt(TAILS * (self.white * self.white + sd * sd)), TUNING.finest_noise * self.grid[:, -1])
        known = np.isfinite(reading)
        all_known = every(known)
        size = reading if all_known else np.where(known, reading, 0.0)
        signed = (np.array([size - predicted, -size - predicted]) / scale).astype(np.float32)
        inverse = (1.0 / scale).astype(np.float32)
        square = signed[:, :, None] - self.grid * inverse[:, None]
        square *= square
        square += 1.0
        least = np.minimum.reduce(square, axis=2)
        share = np.minimum(least[0], least[1])[:, None] / square
        root = np.sqrt(share)
        share *= share
        share *= root  # the power (nu + 1) / 2 = 2.5 for nu = 4
        plus, likelihood = share[0], share[0] + share[1]
        if not all_known:
            plus[~known] = (predicted[:, None] + self.grid > 0.0)[~known]
            likelihood[~known] = 1.0
        return plus, likelihood

    def _step(self, weights: Single, moves: Mask) -> Single:
        after: Single = np.matmul(self.forwards, weights[:, :, None])[:, :, 0]
        for j in () if every(moves) else np.flatnonzero(~moves).tolist():
            stays = self.rest_forwards[j] @ weights[j]
            after[j] = (1.0 - self.turns) * stays + self.turns * self.afresh[j] * weights[j].sum()
        return after

    def _back(self, future: Single, moves: Mask) -> Single:
        before: Single = np.matmul(self.backwards, future[:, :, None])[:, :, 0]
        for j in () if every(moves) else np.flatnonzero(~moves).tolist():
            stays = self.rest_backwards[j] @ future[j]
            before[j] = (1.0 - self.turns) * stays + self.turns * (self.afresh[j] @ future[j])
        return before

    def _looked_back(self, oldest: _Past, *later: _Past) -> Array:
        future = np.ones_like(oldest.before)
        for reading in reversed(later):
            future = reading.likelihood * future
            if reading.step:
                future = self._back(future, reading.moves)
                future = future / future.max(axis=1, keepdims=True)
        both = oldest.before * future
        total = (both * oldest.likelihood).sum(axis=1)
        share: Array = np.minimum((both * oldest.plus).sum(axis=1) / total, _ONE).astype(float)
        return share


def _single(values: Array | Single | list[Array] | list[Single]) -> Single:
    return np.ascontiguousarray(values, dtype=np.float32)


class _Past(NamedTuple):
    before: Single  # (n, G) weights of b before it
    plus: Single  # (n, G) likelihood of each value with sign +
    likelihood: Single  # (n, G) with either sign
    moves: Mask  # (n,) False during standstill and at both its ends, which take a wide step, as in smoothing
    step: bool  # whether a time step comes before it


@dataclass
class Belief:
    """State of a filter: the distribution of b, and the last L + 1 readings."""

    weights: Single  # (n, G) of the values of b after the last reading
    moved: Mask  # (n,) False if the last reading was at standstill
    count: int  # readings so far
    past: deque[_Past]  # the last L + 1 readings, oldest first, if L is positive
