"""Moments of a stream: recursive least squares with forgetting, and the stretches whose signs can be searched again.

Whatever has come before an instant counts less by exp(-dt / forget), dt later (exponentially weighted least squares,
Ljung 1999, section 11.2). They are those of `bayesid.regression.normal_equations`, kept with the signs that were taken:
they add up however the stream is cut into chunks. Of each joint some stretches are kept by themselves, so that their
signs can be searched again; the others are merged into one. So memory does not grow with the stream.

A stretch ends where the sign that was taken changes, where the actuator stops or turns round, and where |effort| comes
out of the noise around zero, in which it may have changed its sign. All of that shows in two neighbouring samples, so
it does not matter how a stream is cut into chunks.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.model import Model
from bayesid.effects.tuning import TUNING as EFFECTS
from bayesid.monitor.tuning import TUNING
from bayesid.motion import Motion
from bayesid.regression.normal_equations import Hessians, NormalEquations
from bayesid.signs.search.protocol import Search, SearchResult, SignProblem

_MERGED = 0
"""The number of what a joint's stretches have been merged into, and of all stretches of a joint with signs."""
_SURELY = 2.0 * float(np.log(99.0))
"""Cost, twice the nats, from which on a sign is as good as certain: 99 to 1, `bayesid.identification.SURE`."""
Samples = dict[str, NDArray[Any]]
"""N samples of a stream: t, q, dq, ddq and payload of the motion, and of each joint (N, n) the actuator's speed, rad/s,
the magnitude |effort|, N m, its expected sign, -1 to +1, and whether it is used."""


@dataclass
class Stretch:
    """Moments of a stretch of constant sign, or of many, as they weigh now: N m, with the sign that was taken."""

    hessian: Array  # (r, r)
    gradient: Array  # (r,)
    start: float = np.inf  # s
    end: float = -np.inf  # last sample, s
    energy: float = 0.0
    doubt: float = 0.0  # expected energy of samples whose sign is wrong, (N m)^2
    count: int = 0  # samples

    def add(self, other: Stretch) -> None:
        """Takes another one in."""
        self.start, self.end = min(self.start, other.start), max(self.end, other.end)
        for name in ("hessian", "gradient", "energy", "doubt", "count"):
            setattr(self, name, getattr(self, name) + getattr(other, name))

    def fade(self, share: float) -> None:
        """Weighs a share of what it did."""
        for name in ("hessian", "gradient", "energy", "doubt"):
            setattr(self, name, share * getattr(self, name))


@dataclass
class StreamMoments:
    """What is kept of a stream of n joints."""

    model: Model  # robot, terms and distortions
    coefficients: BaseCoefficients  # its r base coefficients
    sigma: Array  # (n,) sd of the noise, N m
    forget: float  # time constant, s; inf to forget nothing
    signed: Mask  # (n,) joints whose efforts have signs
    most_individual: int  # stretches of each joint that are kept by themselves
    stretches: dict[tuple[int, int], Stretch] = field(default_factory=dict)  # by joint and number in it
    lost: Array = field(init=False)  # (n, r, r) sums of (1 - (E s)^2) y' y: what is not known as long as signs are not
    weight: Array = field(init=False)  # (n,) sums of the samples' weights
    number: Integers = field(init=False)  # (n,) of each joint's last stretch, from 1
    time: float = -np.inf  # the last sample that has been added, s
    began: float = np.nan  # the first sample, s
    origin: float = np.nan  # when the motion began, s
    steps: int = 0  # from one sample to the next, pauses left out
    span: float = 0.0  # their sum, s
    kept: Samples = field(default_factory=dict)  # on which columns to come depend, and those that wait for them
    waiting: int = 0  # how many of these wait
    top_speed: Array = field(init=False)  # (n,) the highest speed of each actuator so far, rad/s
    last: float = -np.inf  # the last sample that has come, s

    def __post_init__(self) -> None:
        n, r = len(self.sigma), len(self.coefficients)
        self.lost, self.number = np.zeros((n, r, r)), np.zeros(n, dtype=np.int64)
        self.weight, self.top_speed = np.zeros((2, n))

    def fade(self, seconds: float) -> float:
        """What is left of a weight after some time."""
        return 1.0 if np.isinf(self.forget) else float(np.exp(-seconds / self.forget))

    def add(self, samples: Samples, origin: float) -> None:
        """Takes at least one more sample, later than all before, of a motion that began at its origin, s."""
        memory = any(effect.memory for effect in self.model.effects)
        back, ahead = (EFFECTS.look_back, EFFECTS.look_ahead) if memory else (0, 0)
        self.last = float(samples["t"][-1])
        if not self.kept:
            self.began, self.origin = float(samples["t"][0]), origin
            self.kept = {name: values[:0] for name, values in samples.items()}
        every = {name: np.concatenate([self.kept[name], values]) for name, values in samples.items()}
        size, first = len(every["t"]), len(self.kept["t"]) - self.waiting
        ready = max(size - ahead, first)
        for begin in range(first, ready, EFFECTS.chunk):
            end, since = min(begin + EFFECTS.chunk, ready), max(begin - back, 0)
            around = {name: every[name][since : end + ahead] for name in ("t", "q", "dq", "ddq", "payload")}
            columns = self.model.columns(Motion(**around, origin=self.origin))[begin - since : end - since]
            before = {name: values[max(begin - 1, 0) : end] for name, values in every.items()}
            self._add(before, columns[:, :, self.coefficients.selected])
        self.kept = {name: values[max(ready - max(back, 1), 0) :] for name, values in every.items()}
        self.waiting = size - ready

    def _add(self, samples: Samples, columns: Array) -> None:
        """Adds samples with columns (N, n, r); one that was added before comes before the first, if there is one."""
        number = self.number + np.cumsum(self._begins(samples, first=len(samples["t"]) == len(columns)), axis=0)
        now = {name: values[-len(columns) :] for name, values in samples.items()}
        t, magnitude, sign, used = (now[name] for name in ("t", "magnitude", "sign", "used"))
        share, weight = self.fade(t[-1] - self.time), np.exp((t - t[-1]) / self.forget)
        for stretch in self.stretches.values() if share < 1.0 else ():
            stretch.fade(share)
        columns, square = np.sqrt(weight)[:, None, None] * columns, weight[:, None] * magnitude**2
        effort = np.sqrt(weight)[:, None] * sign * magnitude
        wrong = np.maximum(0.5 * (1.0 - np.abs(sign)), TUNING.least_doubt) * square
        for j, a, b in _runs(np.where(used, number, -1)):
            rows = columns[a:b, j]
            own = Stretch(rows.T @ rows, rows.T @ effort[a:b, j], t[a], t[b - 1])
            own.energy, own.doubt, own.count = square[a:b, j].sum(), wrong[a:b, j].sum(), b - a
            self._put(j, _MERGED if self.signed[j] else int(number[a, j]), own)
        unknown = (np.sqrt(used * (1.0 - sign**2))[:, :, None] * columns).swapaxes(0, 1)
        self.lost = share * self.lost + unknown.swapaxes(1, 2) @ unknown
        self.weight = share * self.weight + weight @ used
        steps = np.diff(t, prepend=self.time)
        steps = steps[steps <= TUNING.pause]
        self.steps, self.span = self.steps + len(steps), self.span + float(steps.sum())
        self.number, self.time = number[-1], float(t[-1])
        if len(self.stretches) > 2 * len(self.signed) * (self.most_individual + 2):  # now and then costs less
            self.condense()

    def _begins(self, samples: Samples, *, first: bool) -> Mask:
        """(N, n) whether a stretch begins at a sample; without the one that was added before, if there is one."""
        used, plus, direction = samples["used"], samples["sign"] >= 0.0, np.sign(samples["speed"])
        weak, silent = samples["magnitude"] <= TUNING.clearly * self.sigma, np.diff(samples["t"]) > TUNING.pause
        ends = ~used[:-1] | silent[:, None] | (plus[1:] != plus[:-1]) | (weak[:-1] & ~weak[1:])
        begins = used[1:] & (ends | (direction[1:] * direction[:-1] < 0.0))
        return np.vstack([used[:1], begins]) if first else begins

    def _put(self, joint: int, number: int, stretch: Stretch) -> None:
        if (joint, number) in self.stretches:
            self.stretches[joint, number].add(stretch)
        else:
            self.stretches[joint, number] = stretch

    def condense(self) -> None:
        """Merges the stretches of each joint but so many as are kept by themselves, those most in doubt.

        The last of each joint stays by itself too, for it may go on.
        """
        for joint, last in enumerate(self.number.tolist()):
            every = self.stretches.items()
            own = sorted((-one.doubt, number) for (j, number), one in every if j == joint and number != _MERGED)
            for _, number in own[self.most_individual :]:
                if number != last:
                    self._put(joint, _MERGED, self.stretches.pop((joint, number)))

    def normal_equations(self, weights: Array) -> tuple[list[tuple[int, int]], NormalEquations]:
        """Joint and number of each stretch, in this order, and their moments, rows over the noise (n,)."""
        keys = sorted(self.stretches)
        every = [self.stretches[key] for key in keys]
        joint = np.array([j for j, _ in keys], dtype=np.int64)
        normal_equations = NormalEquations(
            joint,
            self.signed[joint].astype(np.int64),
            Hessians.make(joint, np.array([one.hessian for one in every])),
            np.array([one.gradient for one in every]),
            np.array([one.energy for one in every]),
            np.array([one.count for one in every]),
        )
        return keys, normal_equations.scaled(weights)


def _runs(number: Integers) -> Iterator[tuple[int, int, int]]:
    """Joint, first sample and the one behind the last of every run of samples of one number (N, n); -1 is none."""
    for j, column in enumerate(number.T):
        bounds = np.flatnonzero(np.diff(column, prepend=column[0] - 1, append=column[-1] - 1)).tolist()
        for a, b in pairwise(bounds):
            if column[a] >= 0:
                yield j, a, b


# ---- Signs ----
@dataclass(frozen=True)
class TurnedStretch:
    """A stretch of constant sign that fits surely better with the other sign."""

    joint: int  # from 1
    start: float  # its first sample, s
    end: float  # its last sample, s
    n_samples: int  # in it
    cost: float  # by how much more its efforts cost with the sign that was taken, parameters as found (twice the nats)
    persistent: bool  # whether all assignments that come near the best one agree on its sign
    merged: bool  # whether it holds all stretches of the joint that are not kept, which can only be turned together


@dataclass(frozen=True)
class SignCheck:
    """The signs that were taken beside those that a search over all of a stream finds."""

    #: those whose sign is another, as good as certainly (99 to 1), the dearest first; near zero effort, and in a
    #: sample or three, signs may differ too
    stretches: tuple[TurnedStretch, ...]
    cost_taken: float  #: least cost in the cone with the signs that were taken, efforts in units of their noise
    cost: float  #: the same with the signs that were found
    certified: bool  #: whether no other signs of the stretches can cost less than those that were found
    n_stretches: int  #: how many were searched
    search: SearchResult  #: its result, +1 for the sign that was taken, -1 for the other

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


def check_signs(running: StreamMoments, weights: Array, search: Search) -> SignCheck:
    """Searches the signs of a stream's stretches, rows over the noise (n,), N m.

    Raises:
        SolverError: an optimisation failed.
    """
    running.condense()
    keys, normal_equations = running.normal_equations(weights)
    problem = SignProblem(normal_equations, running.model.cone, running.coefficients)
    result = search.find(problem)
    result = search.certify(replace(problem, earlier=result)).with_work_of([result])
    taken = problem.solver().prepared().solve_precisely(normal_equations.gradient.sum(axis=0))
    cost_taken = problem.energy + taken.cost
    cost = -4.0 * normal_equations.gradient @ problem.coefficients.project(result.theta)
    turned = np.flatnonzero((result.signs < 0) & (cost >= _SURELY) & (normal_equations.count > TUNING.outliers))
    turned = turned[np.argsort(-cost[turned], kind="stable")] if result.cost < cost_taken else turned[:0]
    listed = tuple(
        TurnedStretch(
            joint=keys[k][0] + 1,
            start=float(running.stretches[keys[k]].start),
            end=float(running.stretches[keys[k]].end),
            n_samples=int(normal_equations.count[k]),
            cost=float(cost[k]),
            persistent=result.persistent is not None and bool(result.persistent[k]),
            merged=keys[k][1] == _MERGED,
        )
        for k in turned.tolist()
    )
    return SignCheck(listed, cost_taken, result.cost, result.certified, len(result.signs), result)
