"""Moments of a stream: recursive least squares with forgetting, and the stretches whose signs can be searched again.

Whatever has come before an instant counts less by exp(-dt / forget), dt later (exponentially weighted least squares,
Ljung 1999, section 11.2). The moments are those of `bayesid.regression.moments`, kept with the signs that were taken:
they add up however the stream is cut into chunks. Of each joint some stretches are kept by themselves, so that their
signs can be searched again; the others are merged into one. So memory does not grow with the stream.

A stretch ends where the sign that was taken changes, where the actuator stops or turns round, and where |effort| comes
out of the noise around zero, in which it may have changed its sign. All of that shows in two neighbouring samples, so
it does not matter how a stream is cut into chunks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.model import FeltColumns, Model
from bayesid.effects.tuning import TUNING as EFFECTS
from bayesid.monitor.tuning import TUNING
from bayesid.motion import Motion
from bayesid.regression.moments import HessianSums, Moments
from bayesid.signs.search.protocol import Search, SearchResult, SignProblem

_MERGED = 0
"""The number of what a joint's stretches have been merged into, and of all stretches of a joint with signs."""
_UNUSED = -1
"""The number of a sample that no stretch holds."""
_SURELY = 2.0 * float(np.log(99.0))
"""Cost, twice the nats, from which on a sign is as good as certain: 99 to 1, `bayesid.identification.SURE`."""


@dataclass(frozen=True)
class StreamSamples:
    """N samples of a stream."""

    motion: Motion  # of n joints
    speed: Array  # (N, n) velocities of the actuators, rad/s
    magnitude: Array  # (N, n) |effort|, N m
    sign: Array  # (N, n) its expected sign, -1 to +1
    used: Mask  # (N, n) whether it counts

    @classmethod
    def none(cls, n: int) -> StreamSamples:
        """No sample of n joints."""
        nothing = np.zeros((0, n))
        motion = Motion(np.zeros(0), nothing, nothing, nothing)
        return cls(motion, nothing, nothing, nothing, nothing.astype(bool))

    def __len__(self) -> int:
        return len(self.motion)

    def __getitem__(self, rows: slice) -> StreamSamples:
        return StreamSamples(*(part[rows] for part in vars(self).values()))

    def followed_by(self, others: StreamSamples) -> StreamSamples:
        """These, and behind them others, by the origin of the first."""
        if not len(self):
            return others
        mine, theirs = self.motion, others.motion
        names = ("t", "q", "dq", "ddq", "payload")
        both = {name: np.concatenate([getattr(mine, name), getattr(theirs, name)]) for name in names}
        pairs = zip([*vars(self).values()][1:], [*vars(others).values()][1:], strict=True)
        return StreamSamples(Motion(**both, origin=mine.origin), *(np.concatenate(pair) for pair in pairs))


@dataclass(frozen=True)
class Stretches:
    """Moments of S stretches of constant sign, or of parts of them, as they weigh at an instant."""

    moments: Moments  # of them, N m, with the signs that were taken: +1 is as taken, -1 turned
    number: Integers  # (S,) of the stretch in its joint; 0 for what holds many
    start: Array  # (S,) s
    end: Array  # (S,) last sample, s
    doubt: Array  # (S,) expected energy of samples whose sign is wrong, (N m)^2
    time: float  # the instant, s

    @classmethod
    def none(cls, size: int) -> Stretches:
        """No stretch, of so many coefficients."""
        no, nothing = np.zeros(0, dtype=np.int64), np.zeros(0)
        empty = Moments(no, no, HessianSums(size, no).done(), np.zeros((0, size)), nothing, no)
        return cls(empty, no, nothing, nothing, nothing, -np.inf)

    def faded(self, share: float, time: float) -> Stretches:
        """The same as they weigh later: a share of what they did."""
        if share == 1.0:
            return replace(self, time=time)
        m = self.moments
        hessian = m.hessian.scaled(np.full(len(m.hessian), share))
        m = replace(m, hessian=hessian, gradient=share * m.gradient, energy=share * m.energy)
        return replace(self, moments=m, doubt=share * self.doubt, time=time)

    def followed_by(self, others: Sequence[Stretches]) -> Stretches:
        """These and others, all as they weigh at one instant."""
        every = (self, *others)
        names = ("number", "start", "end", "doubt")
        parts = {name: np.concatenate([getattr(one, name) for one in every]) for name in names}
        return Stretches(self.moments.join(*(one.moments for one in others)), **parts, time=self.time)

    def merged(self, number: Integers) -> Stretches:
        """Those of one joint and one number (S,) made one, in the order of joints and numbers."""
        joint = self.moments.joint
        keys, into = np.unique(np.stack([joint, number]), axis=1, return_inverse=True)
        into, size = into.ravel().astype(np.int64), keys.shape[1]
        start, end = np.full(size, np.inf), np.full(size, -np.inf)
        np.minimum.at(start, into, self.start)
        np.maximum.at(end, into, self.end)
        doubt = np.bincount(into, self.doubt, size).astype(np.float64)
        return Stretches(self.moments.merged(into), keys[1], start, end, doubt, self.time)


@dataclass
class StreamMoments:
    """What is kept of a stream of n joints."""

    model: Model  # robot, terms and distortions
    coefficients: BaseCoefficients  # its r base coefficients
    sigma: Array  # (n,) sd of the noise, N m
    forget: float  # time constant, s; inf to forget nothing
    signed: Mask  # (n,) joints whose efforts have signs
    most_individual: int  # stretches of each joint that are kept by themselves
    pieces: list[Stretches] = field(init=False)  # in the order in which they came
    bound: int = 0  # parts of Hessians from which on they are condensed
    lost: Array = field(init=False)  # (n, r, r) sums of (1 - (E s)^2) y' y: what is not known as long as signs are not
    weight: Array = field(init=False)  # (n,) sums of the samples' weights
    number: Integers = field(init=False)  # (n,) of each joint's last stretch, from 1
    time: float = -np.inf  # the last sample that has been added, s
    began: float = np.nan  # the first sample, s
    steps: int = 0  # from one sample to the next, pauses left out
    span: float = 0.0  # their sum, s
    kept: StreamSamples = field(init=False)  # those on which columns to come depend, and those that wait for them
    waiting: int = 0  # how many of these wait
    top_speed: Array = field(init=False)  # (n,) the highest speed of each actuator so far, rad/s
    last: float = -np.inf  # the last sample that has come, s

    def __post_init__(self) -> None:
        n, r = len(self.sigma), len(self.coefficients)
        self.pieces, self.lost = [Stretches.none(r)], np.zeros((n, r, r))
        self.weight, self.top_speed, self.number = np.zeros(n), np.zeros(n), np.zeros(n, dtype=np.int64)
        self.kept = StreamSamples.none(n)

    def fade(self, seconds: float) -> float:
        """What is left of a weight after some time."""
        return 1.0 if np.isinf(self.forget) else float(np.exp(-seconds / self.forget))

    def add(self, samples: StreamSamples, top_speed: Array) -> None:
        """Takes at least one more sample, later than all before.

        Args:
            samples: those.
            top_speed: (n,) the highest speed of each actuator with them, rad/s.
        """
        memory = any(effect.memory for effect in self.model.effects)
        back, ahead = (EFFECTS.look_back, EFFECTS.look_ahead) if memory else (0, 0)
        if np.isnan(self.began):
            self.began = float(samples.motion.t[0])
        every, first = self.kept.followed_by(samples), len(self.kept) - self.waiting
        ready = max(len(every) - ahead, first)
        for begin in range(first, ready, EFFECTS.chunk):
            end = min(begin + EFFECTS.chunk, ready)
            around = slice(max(begin - back, 0), end + ahead)
            columns = self.model.columns(every.motion[around])[begin - around.start : end - around.start]
            number = self._numbered(every[max(begin - 1, 0) : end], first=begin == 0)
            self._add(every[begin:end], number, FeltColumns.of(columns).chosen(self.coefficients.kept))
        self.kept, self.waiting = every[max(ready - max(back, 1), 0) :], len(every) - ready
        self.top_speed, self.last = top_speed, float(samples.motion.t[-1])

    def stretches(self) -> Stretches:
        """All that came; of each joint at most so many stretches by themselves as are kept, those most in doubt.

        The last of each joint stays by itself too, for it may go on.
        """
        every = [piece.faded(self.fade(self.time - piece.time), self.time) for piece in self.pieces]
        whole = every[0].followed_by(every[1:])
        whole = whole.merged(whole.number)
        joint, kept = whole.moments.joint, np.zeros(len(whole.number), dtype=bool)
        for j in np.unique(joint):
            here = np.flatnonzero((joint == j) & (whole.number != _MERGED))
            kept[here[np.argsort(-whole.doubt[here], kind="stable")][: self.most_individual]] = True
            kept[here[whole.number[here] == self.number[j]]] = True
        return whole.merged(np.where(kept, whole.number, _MERGED))

    def _add(self, samples: StreamSamples, number: Integers, columns: FeltColumns) -> None:
        """Adds samples with the numbers (N, n) of their stretches and with columns (N, n, r)."""
        t, before = samples.motion.t, self.time
        self.time = float(t[-1])
        weight, share = np.exp((t - self.time) / self.forget), self.fade(self.time - before)
        self.number = number[-1]
        self.pieces.append(self._piece(samples, columns, number, weight))
        self.lost = share * self.lost + _lost(samples, columns, weight)
        self.weight = share * self.weight + weight @ samples.used
        steps = np.diff(t, prepend=before)
        steps = steps[steps <= TUNING.pause]
        self.steps, self.span = self.steps + len(steps), self.span + float(steps.sum())
        if sum(len(one.moments.hessian) for one in self.pieces) > self.bound:  # now and then costs less than every time
            self.pieces = [self.stretches()]
            self.bound = max(2 * len(self.pieces[0].moments.hessian), self.most_individual * len(self.signed))

    def _numbered(self, samples: StreamSamples, *, first: bool) -> Integers:
        """(N, n) the number of the last stretch up to each sample; one that was numbered comes before the first."""
        plus, direction, used = samples.sign >= 0.0, np.sign(samples.speed), samples.used
        weak, silent = samples.magnitude <= TUNING.clearly * self.sigma, np.diff(samples.motion.t) > TUNING.pause
        ends = ~used[:-1] | silent[:, None] | (plus[1:] != plus[:-1]) | (weak[:-1] & ~weak[1:])
        ends |= direction[1:] * direction[:-1] < 0.0
        begins = used[1:] & ends
        return self.number + np.cumsum(np.vstack([used[:1], begins]) if first else begins, axis=0)

    def _piece(self, samples: StreamSamples, columns: FeltColumns, number: Integers, weight: Array) -> Stretches:
        """Moments of the stretches of some samples, with columns (N, n, r), weighed by (N,) at the last of them."""
        joint, start, end, which = _runs(np.where(samples.used, np.where(self.signed, _MERGED, number), _UNUSED))
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
        known, t = self.signed[joint].astype(np.int64), samples.motion.t
        sums = Moments(joint, known, hessian.done(), gradient, energy, end - start)
        return Stretches(sums, which, t[start], t[end - 1], doubt, float(t[-1]))


def _runs(number: Integers) -> tuple[Integers, Integers, Integers, Integers]:
    """(S,) joint, first sample, the one behind the last, and number of every run of samples of one number (N, n)."""
    found = []
    for j, column in enumerate(number.T):
        bounds = np.concatenate([[0], np.flatnonzero(np.diff(column)) + 1, [len(column)]])
        start, end = bounds[:-1], bounds[1:]
        found.append(np.stack([np.full(len(start), j), start, end, column[start]])[:, column[start] != _UNUSED])
    joint, start, end, which = np.concatenate(found, axis=1)
    return joint, start, end, which


def _lost(samples: StreamSamples, columns: FeltColumns, weight: Array) -> Array:
    """(n, r, r) sums over samples with columns (N, n, r), weighed by (N,), of what is not known without their signs."""
    n, r = samples.used.shape[1], columns.size
    lost, unknown = np.zeros((n, r, r)), samples.used * (1.0 - samples.sign**2)
    for j, (felt, values) in enumerate(zip(columns.felt, columns.values, strict=True)):
        doubtful = unknown[:, j] > 1e-12  # less is rounding
        rows = np.sqrt(weight[doubtful] * unknown[doubtful, j])[:, None] * values[doubtful]
        lost[j][np.ix_(felt, felt)] = rows.T @ rows
    return lost


# ---------------------------------------------------------------------------------------------------------------
# Signs
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class TurnedStretch:
    """A stretch of constant sign that fits surely better with the other sign."""

    joint: int  # from 1
    start: float  # its first sample, s
    end: float  # its last sample, s
    n_samples: int  # in it
    cost: float  # by how much more its efforts cost with the sign that was taken, parameters as found (twice the nats)
    settled: bool  # whether all assignments that come near the best one agree on its sign
    merged: bool  # whether it holds all stretches of the joint that are not kept, which can only be turned together


@dataclass(frozen=True)
class SignCheck:
    """The signs that were taken beside those that a search over all of a stream finds.

    Attributes:
        stretches: those whose sign is another, as good as certainly (99 to 1), the dearest first; near zero effort, and
            in a sample or three, signs may differ too.
        cost_taken: least cost in the cone with the signs that were taken, efforts in units of their noise.
        cost: the same with the signs that were found.
        certified: whether no other signs of the stretches can cost less than those that were found.
        n_stretches: how many were searched.
        search: its result, +1 for the sign that was taken, -1 for the other.
    """

    stretches: tuple[TurnedStretch, ...]
    cost_taken: float
    cost: float
    certified: bool
    n_stretches: int
    search: SearchResult

    @property
    def differ(self) -> bool:
        """Whether the signs that were found differ from those that were taken."""
        return bool(self.stretches)

    def __repr__(self) -> str:
        turned = f"{len(self.stretches)} of {self.n_stretches} stretches would be turned"
        how = "proven" if self.certified else "not proven"
        lines = [f"SignCheck: {turned}, {how}; cost {self.cost:.6g}, as taken {self.cost_taken:.6g}"]
        lines += [f"joint {one.joint}, {one.start:.6g} to {one.end:.6g} s: {one.cost:.3g}" for one in self.stretches]
        return "\n  ".join(lines)


def check_signs(problem: SignProblem, stretches: Stretches, search: Search) -> SignCheck:
    """Searches the signs of a stream's stretches, whose moments in units of the noise are the problem's.

    Raises:
        SolverError: an optimisation failed.
    """
    result = search.find(problem)
    result = search.conclude(replace(problem, earlier=result)).with_work_of([result])
    taken = problem.solver().prepared().solve_precisely(problem.moments.gradient.sum(axis=0))
    cost_taken = problem.energy + taken.cost
    cost = -4.0 * problem.moments.gradient @ problem.coefficients.project(result.theta)
    turned = np.flatnonzero((result.signs < 0) & (cost >= _SURELY) & (problem.moments.count > TUNING.outliers))
    turned = turned[np.argsort(-cost[turned], kind="stable")] if result.cost < cost_taken else turned[:0]
    listed = tuple(
        TurnedStretch(
            joint=int(stretches.moments.joint[k]) + 1,
            start=float(stretches.start[k]),
            end=float(stretches.end[k]),
            n_samples=int(stretches.moments.count[k]),
            cost=float(cost[k]),
            settled=result.settled is not None and bool(result.settled[k]),
            merged=bool(stretches.number[k] == _MERGED),
        )
        for k in turned
    )
    return SignCheck(listed, cost_taken, result.cost, result.certified, len(result.signs), result)
