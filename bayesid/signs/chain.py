"""Forward-backward smoothing of the model's error b as a hidden Markov chain on a grid, in parallel pieces.

b is an Ornstein-Uhlenbeck process (:eq:`model-error`), which couples the signs of neighbouring samples. At standstill
its spread covers the static friction. `bayesid.signs.smoothing` uses both directions (Rabiner 1989, eqs. 19 to 27),
`bayesid.signs.filtering` the past only.

One step of a chain is too little work for a vectorised call. So chains are cut into pieces of equal length, and a step
of all pieces is one matrix product. A piece's initial distribution is known only after the piece before it. All pieces
run twice; those whose initial distribution changed then run again. Chains forget their start, so few do. The result
equals that of a single run.

In motion b stays near zero, so most pieces use the middle of the grid. A piece whose distribution reaches the end of
the middle uses the whole grid.

Distributions are in single precision; sums of positive numbers keep seven digits.
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
"""Degrees of freedom of the white noise's Student's t, as usual with outliers (Lange, Little, Taylor 1989). Powers of
2.5 in smoothing and filtering are (nu + 1) / 2."""

_SUM = np.float32(2.0**108)
"""Sum of a distribution's weights: near the largest single, 2^128, so that products with the smallest transition are no
denormal numbers, which are slow."""
_BOTH = np.float32(2.0**-98)
"""Factor on a distribution before it multiplies one of the other direction, so that the product is a single."""
_SAME = np.float32(1e-4)
"""Relative difference below which weights count as equal; small weights may become large later."""

Weigh = Callable[[Integers, slice], tuple[Single, Single]]
"""From pieces and grid values to two arrays (L, G', R): likelihoods, up to a factor, and a share of each."""


@dataclass(frozen=True)
class Chain:
    """The model's error in one joint, on G values."""

    grid: Array  # (G,) the values, N m
    moving: Single  # (G, G) rows of transition probabilities in motion
    resting: Single  # (G, G) the same at standstill
    afresh: Single  # (G,) distribution after a restart at standstill
    start: Single  # (G,) distribution of the first value
    middle: slice  # the values used in motion

    @property
    def whole(self) -> slice:
        """All values."""
        return slice(0, len(self.grid))

    def smooth(self, weigh: Weigh, turns: Single, chains: int, wide: Mask) -> tuple[Array, Mask]:
        """(L, B, K) posterior mean of a share of the likelihood, and which of B pieces need the whole grid.

        Args:
            weigh: likelihoods of K chains in B pieces of L samples, with R rows: one for each piece and chain.
            turns: (L, B) probability that a chain restarts before a sample; positive at standstill only.
            chains: K.
            wide: (B,) pieces that use the whole grid.
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
                at_end, left_out = np.any(end > TUNING.outside_share * total, axis=0), forwards.left_out(part)
                leans[part.rows] = at_end | (left_out > TUNING.outside_share)
        return mean.reshape(length, pieces, chains), np.any(leans.reshape(pieces, chains), axis=1)


def error_chains(noise: Noise, at_rest: Array, rate: float) -> list[Chain]:
    """One chain for each joint: noise of the residual in motion, sd (n,) N m at standstill, rate in Hz."""
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
    """Sd of a step of an Ornstein-Uhlenbeck process, at least the grid's resolution."""
    return max(sd * np.sqrt(1.0 - memory**2), TUNING.finest_step * (grid[1] - grid[0]))


def _transitions(grid: Array, sd: float, memory: float) -> Array:
    distance = grid[None, :] - memory * grid[:, None]
    density = np.exp(-0.5 * (distance / _spread(grid, sd, memory)) ** 2)
    density += 1e-30  # keeps distributions positive if model and effort contradict each other
    return density / density.sum(axis=1, keepdims=True)


@dataclass(frozen=True)
class _Part:
    window: slice  # part of the grid, G' values
    rows: Integers  # (R,) indices of the rows
    likelihood: Single  # (L, G', R) up to a factor
    share: Single  # (L, G', R) of it
    turns: Single  # (L, R) probability of a restart before a sample
    turns_after: Single  # (L, R) the same after it

    @classmethod
    def of(cls, pieces: Integers, window: slice, weigh: Weigh, turns: Single, chains: int) -> _Part:
        """The rows of some pieces in all chains."""
        rows = (pieces[:, None] * chains + np.arange(chains)).ravel()
        after = np.append(turns.T.ravel()[1:], np.float32(0.0)).reshape(turns.T.shape).T
        before, after = (np.repeat(values[:, pieces], chains, axis=1) for values in (turns, after))
        likelihood, share = weigh(pieces, window)
        return cls(window, rows, likelihood, share, before, after)


@dataclass(frozen=True)
class _Step:
    """A step of y to the next sample: M y in motion, (1 - t) R y + t b a'y at standstill."""

    moving: Single  # (G, G) M
    resting: Single  # (G, G) R
    left: Single  # (G,) a
    right: Single  # (G,) b

    def within(self, window: slice) -> _Step:
        """The same on a part of the grid."""
        moving, resting = (np.ascontiguousarray(step[window, window]) for step in (self.moving, self.resting))
        return _Step(moving, resting, self.left[window], self.right[window])

    def __call__(self, y: Single, turns: Single, out: Single) -> None:
        """Changes columns (G, R); standstill where turns (R,) are positive."""
        np.matmul(self.moving, y, out=out)
        if turns.any():
            rest = np.flatnonzero(turns)
            resting, t = y[:, rest], turns[rest]
            out[:, rest] = (self.resting @ resting) * (1.0 - t) + np.outer(self.right, (self.left @ resting) * t)
        out *= _SUM / out.sum(axis=0)


class _Pass:
    """Messages from sample to sample, forwards, or backwards if the shift is negative.

    Chains start with `first` (G,). The shift leads from a row to that of the next piece in this direction.
    """

    def __init__(self, step: _Step, first: Single, shift: int, n_rows: int) -> None:
        self.step, self.first, self.shift = step, first, shift
        self.ends = np.zeros((len(first), n_rows), dtype=np.float32)  # last message of each row

    def messages(self, parts: list[_Part]) -> list[Single]:
        """Messages of every part (L + 1, G', R): before each sample, in this direction, and after the last one."""
        states = [np.empty((len(part.turns) + 1, *part.likelihood.shape[1:]), dtype=np.float32) for part in parts]
        for part, state in zip(parts, states, strict=True):
            state[0] = _scaled(self.first[part.window, None])
            self._run(part, state)
        for state, entries in zip(states, [self._entries(part) for part in parts], strict=True):
            state[0] = entries
        for part, state in zip(parts, states, strict=True):
            self._run(part, state)
        changed = True
        while changed:
            changed = bool(np.any([self._rerun(part, state) for part, state in zip(parts, states, strict=True)]))
        return states

    def _in_order(self, part: _Part) -> tuple[Single, Single, _Step]:
        """(L, R) turns and (L, G', R) likelihoods in this direction, and the step."""
        step = self.step.within(part.window)
        if self.shift > 0:
            return part.turns_after, part.likelihood, step
        return part.turns[::-1], part.likelihood[::-1], step

    def _run(self, part: _Part, states: Single) -> None:
        turns, likelihood, step = self._in_order(part)
        weighed = np.empty_like(states[0])
        for i in range(len(turns)):
            np.multiply(states[i], likelihood[i], out=weighed)
            step(weighed, turns[i], states[i + 1])
        self.ends[part.window, part.rows] = states[-1]

    def _rerun(self, part: _Part, states: Single) -> bool:
        """Runs rows with changed initial messages again until nothing changes; whether last messages change."""
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
        before, exists = self._before(part)
        entries = self.ends[part.window, before]
        entries[:, ~exists] = self.first[part.window, None]
        return _scaled(entries)

    def _before(self, part: _Part) -> tuple[Integers, Mask]:
        before, most = part.rows - self.shift, self.ends.shape[1] - 1
        return np.clip(before, 0, most), (before >= 0) & (before <= most)

    def left_out(self, part: _Part) -> Array:
        """(R,) share of the initial messages outside of a part of the grid."""
        before, exists = self._before(part)
        entered = self.ends[:, before]
        share: Array = 1.0 - entered[part.window].sum(axis=0) / entered.sum(axis=0)
        return np.where(exists, share, 0.0)


def _scaled(columns: Single) -> Single:
    scaled: Single = columns * (_SUM / columns.sum(axis=0))
    return scaled
