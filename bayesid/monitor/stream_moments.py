"""Moments of a stream: sums of all of it, and of its stretches as far as they are kept.

The sums of all that came are added up joint by joint: coefficients need no more, and it takes no more memory however
long the stream is. Of each joint some stretches are kept by themselves, so that their signs can be searched again; the
others are merged into one. Moments are kept with the signs that were taken, so what is merged only adds.

Whatever has come before an instant counts less by exp(-dt / forget), dt later (exponentially weighted least squares,
Ljung 1999, section 11.2).

A stretch ends where the sign that was taken changes, where the actuator stops or turns round, and where |effort| comes
out of the noise around zero, in which it may have changed its sign. All of that shows in two neighbouring samples, so
it does not matter how a stream is cut into chunks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.model import FeltColumns, Model
from bayesid.effects.tuning import TUNING as EFFECTS
from bayesid.monitor.tuning import TUNING
from bayesid.motion import Motion
from bayesid.regression.moments import HessianSums, Moments

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
        weak=samples.magnitude <= TUNING.clearly * sigma,
    )
    used, sign, turned, weak = (
        np.concatenate([getattr(edge, name)[None], getattr(now, name)])
        for name in ("used", "sign", "direction", "weak")
    )
    silent = np.diff(samples.motion.t, prepend=edge.t) > TUNING.pause
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


# ---------------------------------------------------------------------------------------------------------------
# Moments
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Setting:
    """What stays the same along a stream.

    Attributes:
        model: robot, terms and distortions.
        coefficients: its r base coefficients.
        sigma: (n,) sd of the noise, N m.
        forget: time constant, s; inf to forget nothing.
        signed: (n,) joints whose efforts have signs.
        most_individual: stretches of each joint that are kept by themselves.
    """

    model: Model
    coefficients: BaseCoefficients
    sigma: Array
    forget: float
    signed: Mask
    most_individual: int

    @property
    def reach(self) -> tuple[int, int]:
        """How many samples before and behind a sample its columns depend on."""
        memory = any(effect.memory for effect in self.model.effects)
        return (EFFECTS.look_back, EFFECTS.look_ahead) if memory else (0, 0)

    def fade(self, seconds: float) -> float:
        """What is left of a weight after some time."""
        return 1.0 if np.isinf(self.forget) else float(np.exp(-seconds / self.forget))


@dataclass(frozen=True)
class Totals:
    """Sums over all samples of each of n joints, N m; each sample with its weight.

    Attributes:
        hessian: (n, r, r) of y' y for the rows y.
        lost: (n, r, r) of (1 - (E s)^2) y' y: what is not known as long as signs are not.
        gradient: (n, r) of y' E s |effort|.
        energy: (n,) of squared efforts.
        weight: (n,) of the weights.
    """

    hessian: Array
    lost: Array
    gradient: Array
    energy: Array
    weight: Array

    @classmethod
    def zero(cls, n: int, r: int) -> Totals:
        """Nothing, of n joints and r coefficients."""
        return cls(np.zeros((n, r, r)), np.zeros((n, r, r)), np.zeros((n, r)), np.zeros(n), np.zeros(n))

    def __add__(self, other: Totals) -> Totals:
        return Totals(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    def faded(self, share: float) -> Totals:
        """The same with less weight."""
        return self if share == 1.0 else Totals(*(share * getattr(self, f.name) for f in fields(self)))


@dataclass(frozen=True)
class Stretches:
    """Moments of S stretches of constant sign, or of parts of them, as they weigh at an instant.

    Attributes:
        moments: of them, N m, with the signs that were taken: +1 is as taken, -1 turned.
        number: (S,) of the stretch in its joint; `MERGED` for what holds many.
        start: (S,) s.
        end: (S,) last sample, s.
        doubt: (S,) expected energy of samples whose sign is wrong, (N m)^2.
        time: the instant, s.
    """

    moments: Moments
    number: Integers
    start: Array
    end: Array
    doubt: Array
    time: float

    def at(self, time: float, setting: Setting) -> Stretches:
        """The same as they weigh later."""
        share = setting.fade(time - self.time)
        if share == 1.0:
            return replace(self, time=time)
        m = self.moments
        hessian = m.hessian.scaled(np.full(len(m.hessian), share))
        m = replace(m, hessian=hessian, gradient=share * m.gradient, energy=share * m.energy)
        return replace(self, moments=m, doubt=share * self.doubt, time=time)

    def merged(self, number: Integers) -> Stretches:
        """Those of one joint and one number (S,) made one, in the order of joints and numbers."""
        joint = self.moments.joint
        keys, into = np.unique(np.stack([joint, number]), axis=1, return_inverse=True)
        into, size = into.ravel().astype(np.int64), keys.shape[1]
        start, end, doubt = np.full(size, np.inf), np.full(size, -np.inf), np.zeros(size)
        np.minimum.at(start, into, self.start)
        np.maximum.at(end, into, self.end)
        np.add.at(doubt, into, self.doubt)
        return Stretches(self.moments.merged(into), keys[1], start, end, doubt, self.time)


@dataclass(frozen=True)
class StreamMoments:
    """What is kept of a stream.

    Attributes:
        totals: of all samples so far, weighed at the last of them.
        pieces: moments of stretches, in the order in which they came.
        bound: parts of Hessians from which on they are condensed.
        edge: the last sample that has been added.
        began: the first sample, s.
        steps: number of steps from one sample to the next, pauses left out.
        span: their sum, s.
        context: motion that columns to come depend on.
        waiting: samples whose columns depend on motion to come.
        top_speed: (n,) the highest speed of each actuator so far, rad/s.
        last: the last sample that has come, s.
    """

    totals: Totals
    pieces: tuple[Stretches, ...]
    bound: int
    edge: Edge
    began: float
    steps: int
    span: float
    context: Motion
    waiting: StreamSamples
    top_speed: Array
    last: float

    @classmethod
    def begin(cls, setting: Setting) -> StreamMoments:
        """Before the first sample."""
        n, nothing = setting.model.robot.n_joints, np.zeros((0, setting.model.robot.n_joints))
        still = Motion(np.zeros(0), nothing, nothing, nothing)
        return cls(
            totals=Totals.zero(n, len(setting.coefficients)),
            pieces=(),
            bound=0,
            edge=Edge.none(n),
            began=np.nan,
            steps=0,
            span=0.0,
            context=still,
            waiting=StreamSamples(still, nothing, nothing, nothing, nothing.astype(bool)),
            top_speed=np.zeros(n),
            last=-np.inf,
        )


def advanced(setting: Setting, running: StreamMoments, samples: StreamSamples, top_speed: Array) -> StreamMoments:
    """What is kept once more samples have come.

    Args:
        setting: of the stream.
        running: what was kept.
        samples: at least one, later than all before.
        top_speed: (n,) the highest speed of each actuator with them, rad/s.
    """
    if np.isnan(running.began):  # what begins with the recording begins now
        begun = replace(running.context, origin=samples.motion.origin)
        running = replace(running, began=float(samples.motion.t[0]), context=begun)
    back, ahead = setting.reach
    waiting = running.waiting.followed_by(samples)
    motion, first = joined(running.context, waiting.motion), len(running.context)
    ready = max(len(waiting) - ahead, 0)
    for begin in range(0, ready, EFFECTS.chunk):
        rows = slice(begin, min(begin + EFFECTS.chunk, ready))
        around = slice(max(first + rows.start - back, 0), first + rows.stop + ahead)
        inside = slice(first + rows.start - around.start, first + rows.stop - around.start)
        columns = FeltColumns.of(setting.model.columns(motion[around])[inside]).chosen(setting.coefficients.kept)
        running = _taken(setting, running, waiting[rows], columns)
    context = motion[max(first + ready - back, 0) : first + ready]
    last = float(samples.motion.t[-1])
    return replace(running, context=context, waiting=waiting[ready:], top_speed=top_speed, last=last)


def _taken(setting: Setting, running: StreamMoments, samples: StreamSamples, columns: FeltColumns) -> StreamMoments:
    """What is kept once samples, whose columns (N, n, r) are there, have been added."""
    t, before = samples.motion.t, running.edge
    number, edge = numbered(before, samples, setting.sigma, setting.signed)
    weight = np.exp((t - edge.t) / setting.forget)
    piece = _piece(setting, samples, columns, number, weight)
    totals = running.totals.faded(setting.fade(edge.t - before.t)) + _totals(samples, columns, weight, piece.moments)
    steps = np.diff(t, prepend=before.t)
    steps = steps[steps <= TUNING.pause]
    pieces, bound = (*running.pieces, piece), running.bound
    held = sum(len(one.moments.hessian) for one in pieces)
    if held > bound:  # condensing now and then costs less than every time
        pieces = (condensed(setting, pieces, edge),)
        held = len(pieces[0].moments.hessian)
        bound = max(2 * held, setting.most_individual * len(setting.signed))
    return replace(
        running,
        totals=totals,
        pieces=pieces,
        bound=bound,
        edge=edge,
        steps=running.steps + len(steps),
        span=running.span + float(steps.sum()),
    )


def _piece(
    setting: Setting, samples: StreamSamples, columns: FeltColumns, number: Integers, weight: Array
) -> Stretches:
    """Moments of the stretches of some samples, with columns (N, n, r), weighed by (N,) at the last of them."""
    joint, start, end, which = runs(number)
    hessian, gradient = HessianSums(columns.size, joint), np.zeros((len(joint), columns.size))
    felt = {j: hessian.feel(j, columns.felt[j]) for j in np.unique(joint)}
    root = np.sqrt(weight)[:, None]
    rows = [root * values for values in columns.values]
    effort, square = root * samples.sign * samples.magnitude, weight[:, None] * samples.magnitude**2
    wrong = np.maximum(0.5 * (1.0 - np.abs(samples.sign)), TUNING.least_doubt) * square
    energy, doubt = np.zeros(len(joint)), np.zeros(len(joint))
    for k, (j, a, b) in enumerate(zip(joint, start, end, strict=True)):
        hessian.add_rows(k, rows[j][a:b])
        gradient[k, felt[j]] = rows[j][a:b].T @ effort[a:b, j]
        energy[k], doubt[k] = square[a:b, j].sum(), wrong[a:b, j].sum()
    known, t = setting.signed[joint].astype(np.int64), samples.motion.t
    moments = Moments(joint, known, hessian.done(), gradient, energy, end - start)
    return Stretches(moments, which, t[start], t[end - 1], doubt, float(t[-1]))


def _totals(samples: StreamSamples, columns: FeltColumns, weight: Array, moments: Moments) -> Totals:
    """Sums over samples with columns (N, n, r), weighed by (N,), of which the moments of the stretches are there."""
    n, r = samples.used.shape[1], columns.size
    lost, gradient, energy = np.zeros((n, r, r)), np.zeros((n, r)), np.zeros(n)
    np.add.at(gradient, moments.joint, moments.gradient)
    np.add.at(energy, moments.joint, moments.energy)
    unknown = samples.used * (1.0 - samples.sign**2)
    for j, (felt, values) in enumerate(zip(columns.felt, columns.values, strict=True)):
        doubtful = unknown[:, j] > 1e-12  # less is rounding
        rows = np.sqrt(weight[doubtful] * unknown[doubtful, j])[:, None] * values[doubtful]
        lost[j][np.ix_(felt, felt)] = rows.T @ rows
    return Totals(moments.hessian.by_joint(n), lost, gradient, energy, weight @ samples.used)


def condensed(setting: Setting, pieces: Sequence[Stretches], edge: Edge) -> Stretches:
    """All stretches, of each joint at most so many by themselves as the setting says, those most in doubt.

    The last of each joint stays by itself too, for it may go on.
    """
    every = [piece.at(edge.t, setting) for piece in pieces]
    moments = every[0].moments.join(*(one.moments for one in every[1:]))
    names = ("number", "start", "end", "doubt")
    parts = {name: np.concatenate([getattr(one, name) for one in every]) for name in names}
    whole = Stretches(moments, **parts, time=edge.t)
    whole = whole.merged(whole.number)
    joint, kept = whole.moments.joint, np.zeros(len(whole.number), dtype=bool)
    for j in np.unique(joint):
        here = np.flatnonzero((joint == j) & (whole.number != MERGED))
        kept[here[np.argsort(-whole.doubt[here], kind="stable")][: setting.most_individual]] = True
        kept[here[whole.number[here] == edge.number[j]]] = True
    return whole.merged(np.where(kept, whole.number, MERGED))
