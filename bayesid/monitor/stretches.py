"""Where a stream's signs are constant: stretches that go on from chunk to chunk.

A stretch ends where the sign that was taken changes, where the actuator stops or turns round, and where |effort| comes
out of the noise around zero, in which it may have changed its sign. All of that shows in two neighbouring samples, so
it does not matter how a stream is cut into chunks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array, Integers, Mask
from bayesid.motion import Motion

PAUSE = 0.5
"""s; after a longer pause of the stream every stretch is a new one: a residual's correlation is not followed beyond
(`bayesid.regression.noise`)."""
_CLEARLY = 2.0
"""Standard deviations of the noise within which |effort| may be zero, as in `bayesid.signs.rounds`."""
UNUSED = -1
"""The number of a sample that no stretch holds."""
MERGED = 0
"""The number of what a joint's stretches have been merged into, and of all stretches of a joint with signs."""


@dataclass(frozen=True)
class StreamSamples:
    """N samples of a stream.

    Attributes:
        motion: of n joints.
        speed: (N, n) velocities of the actuators, rad/s.
        magnitude: (N, n) |effort|, N m.
        sign: (N, n) its expected sign, -1 to +1.
        used: (N, n) whether it counts.
    """

    motion: Motion
    speed: Array
    magnitude: Array
    sign: Array
    used: Mask

    def __len__(self) -> int:
        return len(self.motion)

    def __getitem__(self, rows: slice) -> StreamSamples:
        if rows == slice(0, len(self)):
            return self
        return StreamSamples(
            self.motion[rows], self.speed[rows], self.magnitude[rows], self.sign[rows], self.used[rows]
        )

    def followed_by(self, others: StreamSamples) -> StreamSamples:
        """These, and behind them others."""
        if not len(self):
            return others
        names = ("speed", "magnitude", "sign", "used")
        parts = (np.concatenate([getattr(self, name), getattr(others, name)]) for name in names)
        return StreamSamples(joined(self.motion, others.motion), *parts)


def joined(motion: Motion, following: Motion) -> Motion:
    """A motion and the one that follows it, which begins where the first did."""
    if not len(motion) and motion.origin == following.origin:
        return following
    parts = {k: np.concatenate([getattr(motion, k), getattr(following, k)]) for k in ("t", "q", "dq", "ddq", "payload")}
    return Motion(**parts, origin=motion.origin)


@dataclass(frozen=True)
class Edge:
    """The last sample of a stream, by which the next one goes on with a stretch or does not.

    Attributes:
        t: its instant, s; -inf before the first.
        used: (n,) whether it counts.
        sign: (n,) that was taken, +1 or -1.
        direction: (n,) of the actuator, +1, -1 or 0.
        weak: (n,) whether |effort| is within the noise around zero.
        number: (n,) of each joint's last stretch, from 1.
    """

    t: float
    used: Mask
    sign: Integers
    direction: Integers
    weak: Mask
    number: Integers

    @classmethod
    def none(cls, n: int) -> Edge:
        """Before the first sample of n joints."""
        no, zero = np.zeros(n, dtype=bool), np.zeros(n, dtype=np.int64)
        return cls(-np.inf, no, zero, zero, no, zero)


def numbered(edge: Edge, samples: StreamSamples, sigma: Array, signed: Mask) -> tuple[Integers, Edge]:
    """(N, n) the number of the stretch that each sample belongs to, `UNUSED` if to none, and the last sample.

    Args:
        edge: the sample before the first.
        samples: at least one.
        sigma: (n,) sd of the noise, N m.
        signed: (n,) joints whose efforts have signs, so that their stretches need not be told apart.
    """
    now = replace(
        edge,
        used=samples.used,
        sign=np.where(samples.sign >= 0.0, 1, -1),
        direction=np.sign(samples.speed).astype(np.int64),
        weak=samples.magnitude <= _CLEARLY * sigma,
    )
    used, sign, turned, weak = (
        np.concatenate([getattr(edge, name)[None], getattr(now, name)])
        for name in ("used", "sign", "direction", "weak")
    )
    silent = np.diff(samples.motion.t, prepend=edge.t) > PAUSE
    ends = ~used[:-1] | silent[:, None] | (sign[1:] != sign[:-1]) | (turned[1:] * turned[:-1] < 0)
    ends |= weak[:-1] & ~weak[1:]
    number = edge.number + np.cumsum(used[1:] & ends, axis=0)
    last = Edge(float(samples.motion.t[-1]), used[-1], sign[-1], turned[-1], weak[-1], number[-1])
    return np.where(samples.used, np.where(signed, MERGED, number), UNUSED), last


def runs(number: Integers) -> tuple[Integers, Integers, Integers, Integers]:
    """(S,) joint, first sample, the one behind the last, and number of every run of samples of one stretch.

    Args:
        number: (N, n) of each sample's stretch.
    """
    found = []
    for j, column in enumerate(number.T):
        bounds = np.concatenate([[0], np.flatnonzero(np.diff(column)) + 1, [len(column)]])
        inside = column[bounds[:-1]] != UNUSED
        start, end = bounds[:-1][inside], bounds[1:][inside]
        found.append(np.stack([np.full(len(start), j), start, end, column[start]]))
    joint, start, end, which = np.concatenate(found, axis=1)
    return joint, start, end, which
