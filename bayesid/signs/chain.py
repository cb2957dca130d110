"""The model's error b as a hidden Markov chain on a grid, and its forward-backward smoothing in pieces side by side.

b is what makes neighbouring samples judge each other's signs: an Ornstein-Uhlenbeck process (:eq:`model-error`), wider
at standstill, where it must hold all of the static friction. `bayesid.signs.smoothing` looks at it from both sides
(Rabiner 1989, eqs. 19 to 27), `bayesid.signs.filtering` from the past.

A step of one chain is too small a thing to do by itself. So chains are cut into pieces of equal length, and a step of
all pieces is one product of matrices. With which belief a piece is entered is not known yet: it starts from what the
last samples before it say by themselves, and once the piece before it has an end, it is mended from its first sample
on, up to where that changes nothing any more, for chains forget. What comes out is what one run from end to end gives.

In motion a chain stays near zero, so that most pieces are smoothed in the middle of the grid alone. Where a belief
leans against the end of that, which is seen, the piece needs the whole grid.

Beliefs are in single precision: sums of positive numbers keep their seven digits, however small they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bayesid.arrays import Array, Integers, Mask
from bayesid.signs.tuning import TUNING

Single = NDArray[np.float32]
"""Array of floats in single precision."""

TAILS = 4.0
"""Degrees of freedom of the white noise: real residuals have outliers that a normal distribution thinks impossible. A
round number; not studied. Powers of 2.5 in smoothing and filtering are (nu + 1) / 2."""

_SUM = np.float32(2.0**108)
"""Of a belief's weights: near the largest single, 2^128, so that products with the least transition are no smaller than
the smallest normal one. Below that a processor takes many times as long."""
_BOTH = np.float32(2.0**-98)
"""By which a belief is made smaller before it meets one of the other direction: their product is a single again."""
_SAME = np.float32(1e-4)
"""Relative difference up to which weights are the same, however small they are: what comes may favour the smallest."""


# ---------------------------------------------------------------------------------------------------------------
# The process
# ---------------------------------------------------------------------------------------------------------------
def error_grid(largest: Array) -> Array:
    """(n, G) values of b, N m, for processes whose largest sd is (n,), N m."""
    grid: Array = (TUNING.grid_reach * largest)[:, None] * np.linspace(-1.0, 1.0, TUNING.grid)
    return grid


def stationary(grid: Array, sd: Array) -> Array:
    """(n, G) normal distribution on the grid."""
    density = np.exp(-0.5 * (grid / sd[:, None]) ** 2)
    normal: Array = density / density.sum(axis=1, keepdims=True)
    return normal


def spread(grid: Array, sd: Array, memory: Array) -> Array:
    """(n,) sd of an Ornstein-Uhlenbeck process's step, no less than the grid can show."""
    spread: Array = np.maximum(sd * np.sqrt(1.0 - memory**2), TUNING.finest_step * (grid[:, 1] - grid[:, 0]))
    return spread


def transitions(grid: Array, sd: Array, memory: Array) -> Array:
    """(n, G, G) rows of p(b' | b) of an Ornstein-Uhlenbeck process."""
    distance = grid[:, None, :] - memory[:, None, None] * grid[:, :, None]
    density = np.exp(-0.5 * (distance / spread(grid, sd, memory)[:, None, None]) ** 2)
    density += 1e-30  # beliefs must not die out where model and effort contradict each other
    return density / density.sum(axis=2, keepdims=True)


# ---------------------------------------------------------------------------------------------------------------
# Smoothing
# ---------------------------------------------------------------------------------------------------------------
Weigh = Callable[[Integers, slice], tuple[Single, Single]]
"""From pieces and values of the grid to two arrays (L, G', R): likelihoods, up to a factor, and a share of each."""


@dataclass(frozen=True)
class Chain:
    """A hidden Markov chain on G values."""

    moving: Single  # (G, G) rows of transition probabilities in motion
    resting: Single  # (G, G) the same at standstill
    afresh: Single  # (G,) distribution from which it may start afresh at standstill
    start: Single  # (G,) and of its first value
    middle: slice  # the values near which it stays in motion

    @property
    def whole(self) -> slice:
        """All values."""
        return slice(0, len(self.start))

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
        forwards = _Pass(parts, _Step(self.moving.T, self.resting.T, ones, self.afresh), self.start, chains, rows)
        backwards = _Pass(parts, _Step(self.moving, self.resting, self.afresh, ones), ones, -chains, rows)
        beliefs, futures = forwards.messages(), backwards.messages()
        mean, leans = np.empty((length, rows)), np.zeros(rows, dtype=bool)
        for part, belief, future in zip(parts, beliefs, futures, strict=True):
            both = np.multiply(belief[:-1], _BOTH, out=belief[:-1])
            both *= future[-2::-1]
            share = np.einsum("lgr,lgr->lr", both, part.share)
            both *= part.likelihood
            total = both.sum(axis=1)
            mean[:, part.rows] = share / total
            if part.window != self.whole:
                end = both[:, : TUNING.window_end].sum(axis=1) + both[:, -TUNING.window_end :].sum(axis=1)
                leans[part.rows] = np.any(end > TUNING.leaning * total, axis=0) | (
                    forwards.left_out(part) > TUNING.leaning
                )
        return mean.reshape(length, pieces, chains), np.any(leans.reshape(pieces, chains), axis=1)


@dataclass(frozen=True)
class _Part:
    """Rows that are smoothed on the same part of the grid."""

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
        next_piece = np.append(turns[0, 1:], np.float32(0.0))
        after = np.concatenate([turns[1:], next_piece[None]])
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


@dataclass
class _Pass:
    """What is passed on from sample to sample, forwards, or backwards where the shift is negative."""

    parts: list[_Part]  # of all rows
    step: _Step  # from one sample to the next
    first: Single  # (G,) with what chains are entered
    shift: int  # from a row to that of the next piece in this direction
    n_rows: int  # of all parts
    ends: Single = field(init=False)  # (G, n_rows) what each row passes on to the next piece

    def __post_init__(self) -> None:
        self.ends = np.zeros((len(self.first), self.n_rows), dtype=np.float32)

    def messages(self) -> list[Single]:
        """Of every part (L + 1, G', R): before each sample, in the order of this direction, and after the last one."""
        for part in self.parts:
            self._run(part, np.repeat(_scaled(self.first[part.window, None]), len(part.rows), axis=1), TUNING.run_in)
        states = [self._run(part, self._entries(part, part.rows), len(part.likelihood)) for part in self.parts]
        late = self._next(np.arange(self.n_rows))
        while late.size:
            changed = [self._mend(part, state, late) for part, state in zip(self.parts, states, strict=True)]
            late = self._next(np.concatenate(changed))
        return states

    def left_out(self, part: _Part) -> Array:
        """(R,) share of what rows are entered with that a part of the grid leaves out."""
        entered = self.ends[:, np.clip(part.rows - self.shift, 0, self.n_rows - 1)]
        share: Array = 1.0 - entered[part.window].sum(axis=0) / entered.sum(axis=0)
        return np.where(self._exist(part.rows - self.shift), share, 0.0)

    def _exist(self, rows: Integers) -> Mask:
        exist: Mask = (rows >= 0) & (rows < self.n_rows)
        return exist

    def _next(self, rows: Integers) -> Integers:
        following = rows + self.shift
        return following[self._exist(following)]

    def _entries(self, part: _Part, rows: Integers) -> Single:
        """(G', R) what rows are entered with."""
        before = rows - self.shift
        entries = self.ends[part.window, np.clip(before, 0, self.n_rows - 1)]
        entries[:, ~self._exist(before)] = self.first[part.window, None]
        return _scaled(entries)

    def _in_order(self, part: _Part) -> tuple[Single, Single]:
        """(L, G', R) likelihoods and (L, R) probabilities that follow them, in the order of this direction."""
        if self.shift > 0:
            return part.likelihood, part.turns_after
        return part.likelihood[::-1], part.turns[::-1]

    def _run(self, part: _Part, state: Single, samples: int) -> Single:
        """(samples + 1, G', R) what is passed on over the last samples of all rows of a part."""
        likelihood, turns = (values[-samples:] for values in self._in_order(part))
        states = np.empty((len(turns) + 1, *state.shape), dtype=np.float32)
        step, weighed = self.step.within(part.window), np.empty_like(state)
        states[0] = state
        for i in range(len(turns)):
            np.multiply(states[i], likelihood[i], out=weighed)
            step(weighed, turns[i], states[i + 1])
        self.ends[part.window, part.rows] = states[-1]
        return states

    def _mend(self, part: _Part, states: Single, late: Integers) -> Integers:
        """Rows whose end changes once those that are late are entered with what is before them."""
        likelihood, turns = self._in_order(part)
        step = self.step.within(part.window)
        at = np.flatnonzero(np.isin(part.rows, late))
        state = self._entries(part, part.rows[at])
        for i in range(len(states)):
            if i % TUNING.compared_every == 0 or i == len(turns):
                earlier = states[i][:, at]
                other = (np.abs(state - earlier) > _SAME * np.minimum(state, earlier)).any(axis=0)
                at, state = at[other], state[:, other]
                if not at.size:
                    return at
            states[i][:, at] = state
            if i < len(turns):
                weighed = state * likelihood[i][:, at]
                step(weighed, turns[i, at], state)
        self.ends[part.window, part.rows[at]] = state
        return part.rows[at]


def _scaled(columns: Single) -> Single:
    scaled: Single = columns * (_SUM / columns.sum(axis=0))
    return scaled
