"""The model's error b as a hidden Markov chain on a grid, and its forward-backward smoothing in pieces side by side.

b is what makes neighbouring samples judge each other's signs: an Ornstein-Uhlenbeck process (:eq:`model-error`), wider
at standstill, where it must hold all of the static friction. `bayesid.signs.smoothing` looks at it from both sides
(Rabiner 1989, eqs. 19 to 27), `bayesid.signs.filtering` from the past.

A step of one chain is too small a thing to do by itself. So chains are cut into pieces of equal length, and a step of
all pieces is one product of matrices. With which belief a piece is entered is known once the piece before it has an
end. So all pieces are run twice, and then mended where they are entered otherwise than they were run: chains forget,
so that little is left to mend, and what comes out is what one run from end to end gives.

In motion a chain stays near zero, so that most pieces are smoothed in the middle of the grid alone. Where a belief
leans against the end of that, which is seen, the piece needs the whole grid.

Beliefs are in single precision: sums of positive numbers keep their seven digits, however small they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesid.arrays import Array, Integers, Mask
from bayesid.regression.noise import Noise
from bayesid.signs.tuning import TUNING

Single = NDArray[np.float32]
"""Array of floats in single precision."""

TAILS = 4.0
"""Degrees of freedom of the white noise: real residuals have outliers that a normal distribution thinks impossible.
Four is usual (Lange, Little, Taylor 1989). Powers of 2.5 in smoothing and filtering are (nu + 1) / 2."""

_SUM = np.float32(2.0**108)
"""Of a belief's weights: near the largest single, 2^128, so that products with the least transition are no smaller than
the smallest normal one. Below that a processor takes many times as long."""
_BOTH = np.float32(2.0**-98)
"""By which a belief is made smaller before it meets one of the other direction: their product is a single again."""
_SAME = np.float32(1e-4)
"""Relative difference up to which weights are the same, however small they are: what comes may favour the smallest."""

Weigh = Callable[[Integers, slice], tuple[Single, Single]]
"""From pieces and values of the grid to two arrays (L, G', R): likelihoods, up to a factor, and a share of each."""


@dataclass(frozen=True)
class Chain:
    """The error of one joint's model, on G values."""

    grid: Array  # (G,) the values, N m
    moving: Single  # (G, G) rows of transition probabilities in motion
    resting: Single  # (G, G) the same at standstill
    afresh: Single  # (G,) distribution from which it may start afresh at standstill
    start: Single  # (G,) and of its first value
    middle: slice  # the values near which it stays in motion

    @property
    def whole(self) -> slice:
        """All values."""
        return slice(0, len(self.grid))

    def smooth(self, weigh: Weigh, turns: Single, chains: int, wide: Mask) -> tuple[Array, Mask]:
        """(L, B, K) posterior mean of a share of the likelihood, and which of B pieces turn out to need the whole grid.

        Args:
            weigh: likelihoods of K chains that are cut into B pieces of L samples; of R rows, a row a piece and chain.
            turns: (L, B) probability that a chain starts afresh before a sample; positive at standstill only.
            chains: K.
            wide: (B,) pieces that are smoothed on the whole grid.
        """
        (length, pieces), rows = turns.shape, turns.shape[1] * chains
        groups = ((wide, self.whole), (~wide, self.middle))
        parts = [
            _Part.of(np.flatnonzero(which), window, weigh, turns, chains) for which, window in groups if which.any()
        ]
        ones = np.ones_like(self.start)
        forwards = _Pass(_Step(self.moving.T, self.resting.T, ones, self.afresh), self.start, chains, rows)
        backwards = _Pass(_Step(self.moving, self.resting, self.afresh, ones), ones, -chains, rows)
        mean, leans = np.empty((length, rows)), np.zeros(rows, dtype=bool)
        for part, belief, future in zip(parts, forwards.messages(parts), backwards.messages(parts), strict=True):
            both = np.multiply(belief[:-1], _BOTH, out=belief[:-1])
            both *= future[-2::-1]
            share = np.einsum("lgr,lgr->lr", both, part.share)
            both *= part.likelihood
            total = both.sum(axis=1)
            mean[:, part.rows] = share / total
            if part.window != self.whole:
                end = both[:, : TUNING.window_end].sum(axis=1) + both[:, -TUNING.window_end :].sum(axis=1)
                at_end, left_out = np.any(end > TUNING.leaning * total, axis=0), forwards.left_out(part)
                leans[part.rows] = at_end | (left_out > TUNING.leaning)
        return mean.reshape(length, pieces, chains), np.any(leans.reshape(pieces, chains), axis=1)


def error_chains(noise: Noise, at_rest: Array, rate: float) -> list[Chain]:
    """One for each joint of a model whose residual has a noise, and is (n,) N m wide at standstill, at a rate, Hz."""
    resting_memory, wide = float(np.exp(-1.0 / (TUNING.rest_time * rate))), np.maximum(at_rest, noise.coloured)
    chains = []
    for sd, rest, correlation in zip(noise.coloured, wide, noise.correlation, strict=True):
        grid = TUNING.grid_reach * rest * np.linspace(-1.0, 1.0, TUNING.grid)
        memory = np.exp(-1.0 / (correlation * rate))
        centre, spacing = len(grid) // 2, grid[1] - grid[0]
        reach = _spread(grid, sd, memory) / np.sqrt(1.0 - memory**2)
        half = min(int(TUNING.middle * reach / spacing) + TUNING.middle_margin, centre)
        chain = Chain(
            grid=grid,
            moving=_transitions(grid, sd, memory).astype(np.float32),
            resting=_transitions(grid, rest, resting_memory).astype(np.float32),
            afresh=_normal(grid, rest).astype(np.float32),
            start=_normal(grid, sd).astype(np.float32),
            middle=slice(centre - half, centre + half + 1),
        )
        chains.append(chain)
    return chains


def _normal(grid: Array, sd: float) -> Array:
    density = np.exp(-0.5 * (grid / sd) ** 2)
    normal: Array = density / density.sum()
    return normal


def _spread(grid: Array, sd: float, memory: float) -> float:
    """Sd of an Ornstein-Uhlenbeck process's step, no less than the grid can show."""
    return max(sd * np.sqrt(1.0 - memory**2), TUNING.finest_step * (grid[1] - grid[0]))


def _transitions(grid: Array, sd: float, memory: float) -> Array:
    distance = grid[None, :] - memory * grid[:, None]
    density = np.exp(-0.5 * (distance / _spread(grid, sd, memory)) ** 2)
    density += 1e-30  # beliefs must not die out where model and effort contradict each other
    return density / density.sum(axis=1, keepdims=True)


@dataclass(frozen=True)
class _Part:
    window: slice  # part of the grid, G' values
    rows: Integers  # (R,) which of all rows
    likelihood: Single  # (L, G', R) up to a factor
    share: Single  # (L, G', R) of it
    turns: Single  # (L, R) probability that the chain starts afresh before a sample
    turns_after: Single  # (L, R) and after it

    @classmethod
    def of(cls, pieces: Integers, window: slice, weigh: Weigh, turns: Single, chains: int) -> _Part:
        """Pieces of all chains."""
        rows = (pieces[:, None] * chains + np.arange(chains)).ravel()
        after = np.append(turns.T.ravel()[1:], np.float32(0.0)).reshape(turns.T.shape).T
        before, after = (np.repeat(values[:, pieces], chains, axis=1) for values in (turns, after))
        likelihood, share = weigh(pieces, window)
        return cls(window, rows, likelihood, share, before, after)


@dataclass(frozen=True)
class _Step:
    """What becomes of y from one sample to the next: M y in motion, (1 - t) R y + t b a'y at standstill."""

    moving: Single  # (G, G) M
    resting: Single  # (G, G) R
    left: Single  # (G,) a
    right: Single  # (G,) b

    def within(self, window: slice) -> _Step:
        """The same on a part of the grid."""
        moving, resting = (np.ascontiguousarray(step[window, window]) for step in (self.moving, self.resting))
        return _Step(moving, resting, self.left[window], self.right[window])

    def __call__(self, y: Single, turns: Single, out: Single) -> None:
        """Of (G, R) columns, at standstill where turns (R,) are positive."""
        np.matmul(self.moving, y, out=out)
        if turns.any():
            rest = np.flatnonzero(turns)
            resting, t = y[:, rest], turns[rest]
            out[:, rest] = (self.resting @ resting) * (1.0 - t) + np.outer(self.right, (self.left @ resting) * t)
        out *= _SUM / out.sum(axis=0)


class _Pass:
    """What is passed on from sample to sample, forwards, or backwards where the shift is negative.

    Chains are entered with `first` (G,). The shift leads from a row to that of the next piece in this direction.
    """

    def __init__(self, step: _Step, first: Single, shift: int, n_rows: int) -> None:
        self.step, self.first, self.shift = step, first, shift
        self.ends = np.zeros((len(first), n_rows), dtype=np.float32)  # what each row passes on to the next piece

    def messages(self, parts: list[_Part]) -> list[Single]:
        """Of every part (L + 1, G', R): before each sample, in the order of this direction, and after the last one."""
        states = [np.empty((len(part.turns) + 1, *part.likelihood.shape[1:]), dtype=np.float32) for part in parts]
        for part, state in zip(parts, states, strict=True):
            state[0] = _scaled(self.first[part.window, None])
            self._run(part, state)
        for state, entries in zip(states, [self._entries(part) for part in parts], strict=True):
            state[0] = entries
        for part, state in zip(parts, states, strict=True):
            self._run(part, state)
        mended = True
        while mended:
            mended = bool(np.any([self._mend(part, state) for part, state in zip(parts, states, strict=True)]))
        return states

    def _in_order(self, part: _Part) -> tuple[Single, Single, _Step]:
        """(L, R) turns and (L, G', R) likelihoods in the order of this direction, and the step."""
        step = self.step.within(part.window)
        if self.shift > 0:
            return part.turns_after, part.likelihood, step
        return part.turns[::-1], part.likelihood[::-1], step

    def _run(self, part: _Part, states: Single) -> None:
        """Passes on what all rows of a part are entered with."""
        turns, likelihood, step = self._in_order(part)
        weighed = np.empty_like(states[0])
        for i in range(len(turns)):
            np.multiply(states[i], likelihood[i], out=weighed)
            step(weighed, turns[i], states[i + 1])
        self.ends[part.window, part.rows] = states[-1]

    def _mend(self, part: _Part, states: Single) -> bool:
        """The same of rows that are entered otherwise than before, until that changes nothing; whether ends change."""
        turns, likelihood, step = self._in_order(part)
        rows, state = np.arange(len(part.rows)), self._entries(part)
        for i in range(len(states)):
            if i % 4 == 0 or i == len(turns):
                earlier = states[i][:, rows]
                other = (np.abs(state - earlier) > _SAME * np.minimum(state, earlier)).any(axis=0)
                rows, state = rows[other], state[:, other]
                if not rows.size:
                    return False
            states[i][:, rows] = state
            if i < len(turns):
                step(state * likelihood[i][:, rows], turns[i, rows], state)
        self.ends[part.window, part.rows[rows]] = state
        return True

    def _entries(self, part: _Part) -> Single:
        """(G', R) what rows are entered with."""
        before, exists = self._before(part)
        entries = self.ends[part.window, before]
        entries[:, ~exists] = self.first[part.window, None]
        return _scaled(entries)

    def _before(self, part: _Part) -> tuple[Integers, Mask]:
        before, most = part.rows - self.shift, self.ends.shape[1] - 1
        return np.clip(before, 0, most), (before >= 0) & (before <= most)

    def left_out(self, part: _Part) -> Array:
        """(R,) share of what rows are entered with that a part of the grid leaves out."""
        before, exists = self._before(part)
        entered = self.ends[:, before]
        share: Array = 1.0 - entered[part.window].sum(axis=0) / entered.sum(axis=0)
        return np.where(exists, share, 0.0)


def _scaled(columns: Single) -> Single:
    scaled: Single = columns * (_SUM / columns.sum(axis=0))
    return scaled
