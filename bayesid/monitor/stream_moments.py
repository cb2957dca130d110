"""Moments of a stream: recursive least squares with forgetting, and segments whose signs can be searched again.

A sample of age dt has the weight exp(-dt / forget) (exponentially weighted least squares, Ljung 1999, section 11.2).
The moments are the sums of `bayesid.regression.normal_equations`, with the given signs; the chunks of a stream add up.
Some segments of each joint are kept separately, so that their signs can be searched again; the others are merged, so
memory does not grow with the stream.

A segment ends where the given sign changes, where the actuator stops or reverses, and where |effort| rises out of the
noise around zero, in which its sign may have changed. All this depends on two neighbouring samples only, so it does not
matter how the stream is cut into chunks.
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
"""Number of a joint's merged segments, and of all segments of a signed joint."""
_CERTAIN = 2.0 * float(np.log(99.0))
"""Cost, twice the nats, from which a sign is certain: odds of 99 to 1, as `bayesid.identification.SURE`."""
Samples = dict[str, NDArray[Any]]
"""N samples of a stream: t, q, dq, ddq and payload of the motion; (N, n) the actuators' speed, rad/s, the magnitude
|effort|, N m, its expected sign, -1 to +1, and whether it is used."""


@dataclass
class StreamSegment:
    """Weighted moments of a segment, or of merged ones: N m, with the given sign."""

    hessian: Array  # (r, r)
    gradient: Array  # (r,)
    start: float = np.inf  # s
    end: float = -np.inf  # last sample, s
    energy: float = 0.0
    doubt: float = 0.0  # expected energy of samples whose sign is wrong, (N m)^2
    count: int = 0  # samples

    def add(self, other: StreamSegment) -> None:
        """Merges another segment into this one."""
        self.start, self.end = min(self.start, other.start), max(self.end, other.end)
        for name in ("hessian", "gradient", "energy", "doubt", "count"):
            setattr(self, name, getattr(self, name) + getattr(other, name))

    def fade(self, share: float) -> None:
        """Multiplies the weight by a share."""
        for name in ("hessian", "gradient", "energy", "doubt"):
            setattr(self, name, share * getattr(self, name))


@dataclass
class StreamMoments:
    """State of the moments of n joints and r coefficients."""

    model: Model  # robot, terms and distortions
    coefficients: BaseCoefficients  # its base coefficients
    sigma: Array  # (n,) sd of the noise, N m
    forget: float  # time constant, s; inf to forget nothing
    signed: Mask  # (n,) joints whose efforts have signs
    most_individual: int  # segments of each joint that are kept separately
    segments: dict[tuple[int, int], StreamSegment] = field(default_factory=dict)  # by joint and number in it
    lost: Array = field(init=False)  # (n, r, r) sums of (1 - (E s)^2) y' y: information lost to uncertain signs
    weight: Array = field(init=False)  # (n,) sums of the samples' weights
    number: Integers = field(init=False)  # (n,) of each joint's last segment, from 1
    time: float = -np.inf  # of the last sample added, s
    began: float = np.nan  # time of the first sample, s
    origin: float = np.nan  # when the motion began, s
    steps: int = 0  # from one sample to the next, without pauses
    span: float = 0.0  # their sum, s
    kept: Samples = field(default_factory=dict)  # samples that later columns depend on, and waiting ones
    waiting: int = 0  # samples whose columns depend on later ones
    top_speed: Array = field(init=False)  # (n,) highest speed of each actuator so far, rad/s
    last: float = -np.inf  # time of the last sample received, s

    def __post_init__(self) -> None:
        n, r = len(self.sigma), len(self.coefficients)
        self.lost, self.number = np.zeros((n, r, r)), np.zeros(n, dtype=np.int64)
        self.weight, self.top_speed = np.zeros((2, n))

    def fade(self, seconds: float) -> float:
        """Share of a weight that remains after some time, s."""
        return 1.0 if np.isinf(self.forget) else float(np.exp(-seconds / self.forget))

    def add(self, samples: Samples, origin: float) -> None:
        """Adds one or more samples, later than all before, of a motion that began at its origin, s."""
        memory = any(effect.memory for effect in self.model.effects)
        back, ahead = (EFFECTS.look_back, EFFECTS.look_ahead) if memory else (0, 0)
        self.last = float(samples["t"][-1])
        if not self.kept:
            self.began, self.origin = float(samples["t"][0]), origin
            self.kept = {name: values[:0] for name, values in samples.items()}
        joined = {name: np.concatenate([self.kept[name], values]) for name, values in samples.items()}
        size, first = len(joined["t"]), len(self.kept["t"]) - self.waiting
        ready = max(size - ahead, first)
        for begin in range(first, ready, EFFECTS.chunk):
            end, since = min(begin + EFFECTS.chunk, ready), max(begin - back, 0)
            around = {name: joined[name][since : end + ahead] for name in ("t", "q", "dq", "ddq", "payload")}
            columns = self.model.columns(Motion(**around, origin=self.origin))[begin - since : end - since]
            before = {name: values[max(begin - 1, 0) : end] for name, values in joined.items()}
            self._add(before, columns[:, :, self.coefficients.selected])
        self.kept = {name: values[max(ready - max(back, 1), 0) :] for name, values in joined.items()}
        self.waiting = size - ready

    def _add(self, samples: Samples, columns: Array) -> None:
        """Adds samples with columns (N, n, r); the sample before them comes first, if there is one."""
        number = self.number + np.cumsum(self._begins(samples, first=len(samples["t"]) == len(columns)), axis=0)
        now = {name: values[-len(columns) :] for name, values in samples.items()}
        t, magnitude, sign, used = (now[name] for name in ("t", "magnitude", "sign", "used"))
        share, weight = self.fade(t[-1] - self.time), np.exp((t - t[-1]) / self.forget)
        for segment in self.segments.values() if share < 1.0 else ():
            segment.fade(share)
        columns, square = np.sqrt(weight)[:, None, None] * columns, weight[:, None] * magnitude**2
        effort = np.sqrt(weight)[:, None] * sign * magnitude
        wrong = np.maximum(0.5 * (1.0 - np.abs(sign)), TUNING.least_doubt) * square
        for j, a, b in _runs(np.where(used, number, -1)):
            rows = columns[a:b, j]
            segment = StreamSegment(rows.T @ rows, rows.T @ effort[a:b, j], t[a], t[b - 1])
            segment.energy, segment.doubt, segment.count = square[a:b, j].sum(), wrong[a:b, j].sum(), b - a
            self._put(j, _MERGED if self.signed[j] else int(number[a, j]), segment)
        uncertain = (np.sqrt(used * (1.0 - sign**2))[:, :, None] * columns).swapaxes(0, 1)
        self.lost = share * self.lost + uncertain.swapaxes(1, 2) @ uncertain
        self.weight = share * self.weight + weight @ used
        steps = np.diff(t, prepend=self.time)
        steps = steps[steps <= TUNING.pause]
        self.steps, self.span = self.steps + len(steps), self.span + float(steps.sum())
        self.number, self.time = number[-1], float(t[-1])
        if len(self.segments) > 2 * len(self.signed) * (self.most_individual + 2):  # not for every chunk, for speed
            self.merge()

    def _begins(self, samples: Samples, *, first: bool) -> Mask:
        """(N, n) whether a segment begins at a sample; without the sample before them, if there is one."""
        used, plus, direction = samples["used"], samples["sign"] >= 0.0, np.sign(samples["speed"])
        weak, paused = samples["magnitude"] <= TUNING.clearly * self.sigma, np.diff(samples["t"]) > TUNING.pause
        ends = ~used[:-1] | paused[:, None] | (plus[1:] != plus[:-1]) | (weak[:-1] & ~weak[1:])
        begins = used[1:] & (ends | (direction[1:] * direction[:-1] < 0.0))
        return np.vstack([used[:1], begins]) if first else begins

    def _put(self, joint: int, number: int, segment: StreamSegment) -> None:
        if (joint, number) in self.segments:
            self.segments[joint, number].add(segment)
        else:
            self.segments[joint, number] = segment

    def merge(self) -> None:
        """Merges segments of each joint, except the most uncertain ones and the last one, which may continue."""
        for joint, last in enumerate(self.number.tolist()):
            separate = [number for j, number in self.segments if j == joint and number != _MERGED]
            separate.sort(key=lambda number: (-self.segments[joint, number].doubt, number))
            for number in separate[self.most_individual :]:
                if number != last:
                    self._put(joint, _MERGED, self.segments.pop((joint, number)))

    def normal_equations(self, weights: Array) -> tuple[list[tuple[int, int]], NormalEquations]:
        """Joint and number of each segment, in this order, and their moments, rows over the noise (n,)."""
        keys = sorted(self.segments)
        segments = [self.segments[key] for key in keys]
        joint = np.array([j for j, _ in keys], dtype=np.int64)
        normal_equations = NormalEquations(
            joint,
            self.signed[joint].astype(np.int64),
            Hessians.make(joint, np.array([segment.hessian for segment in segments])),
            np.array([segment.gradient for segment in segments]),
            np.array([segment.energy for segment in segments]),
            np.array([segment.count for segment in segments]),
        )
        return keys, normal_equations.scaled(weights)


def _runs(number: Integers) -> Iterator[tuple[int, int, int]]:
    """Joint, first sample and end of each run of equal numbers (N, n); not of -1."""
    for j, column in enumerate(number.T):
        bounds = np.flatnonzero(np.diff(column, prepend=column[0] - 1, append=column[-1] - 1)).tolist()
        for a, b in pairwise(bounds):
            if column[a] >= 0:
                yield j, a, b


# ---- Signs ----
@dataclass(frozen=True)
class FlippedSegment:
    """A segment that fits better with the other sign, with odds of at least 99 to 1."""

    joint: int  # from 1
    start: float  # first sample, s
    end: float  # last sample, s
    n_samples: int
    cost: float  # additional cost with the sign used, under the parameters found (twice the nats)
    persistent: bool  # whether its sign is the same in all assignments near the best one
    merged: bool  # whether it is all merged segments of the joint, which only flip together


@dataclass(frozen=True)
class SignCheck:
    """Comparison of the signs used with the best ones of a search over the whole stream."""

    #: flipped segments, that of the highest cost first; segments near zero effort or of at most three samples are left
    #: out
    segments: tuple[FlippedSegment, ...]
    cost_used: float  #: least cost in the cone with the signs used, efforts in units of their noise
    cost: float  #: least cost with the signs found
    certified: bool  #: whether no assignment of the segments costs less than the one found
    n_segments: int  #: number of segments searched
    search: SearchResult  #: +1 for the sign used, -1 for the other

    @property
    def differ(self) -> bool:
        """Whether the signs found differ from those used."""
        return bool(self.segments)

    def __repr__(self) -> str:
        flipped = f"{len(self.segments)} of {self.n_segments} segments fit better with the other sign"
        how = "proven" if self.certified else "not proven"
        lines = [f"SignCheck: {flipped}, {how}; cost {self.cost:.6g}, with the signs used {self.cost_used:.6g}"]
        for segment in self.segments:
            lines.append(f"joint {segment.joint}, {segment.start:.6g} to {segment.end:.6g} s: {segment.cost:.3g}")
        return "\n  ".join(lines)


def check_signs(moments: StreamMoments, weights: Array, search: Search) -> SignCheck:
    """Searches the signs of a stream's segments, rows over the noise (n,), N m.

    Raises:
        SolverError: an optimisation failed.
    """
    moments.merge()
    keys, normal_equations = moments.normal_equations(weights)
    problem = SignProblem(normal_equations, moments.model.cone, moments.coefficients)
    result = search.find(problem)
    result = search.certify(replace(problem, earlier=result)).with_work_of([result])
    used = problem.solver().prepared().solve_precisely(normal_equations.gradient.sum(axis=0))
    cost_used = problem.energy + used.cost
    cost = -4.0 * normal_equations.gradient @ problem.coefficients.project(result.theta)
    flipped = np.flatnonzero((result.signs < 0) & (cost >= _CERTAIN) & (normal_equations.count > TUNING.outliers))
    flipped = flipped[np.argsort(-cost[flipped], kind="stable")] if result.cost < cost_used else flipped[:0]
    segments = tuple(
        FlippedSegment(
            joint=keys[k][0] + 1,
            start=float(moments.segments[keys[k]].start),
            end=float(moments.segments[keys[k]].end),
            n_samples=int(normal_equations.count[k]),
            cost=float(cost[k]),
            persistent=result.persistent is not None and bool(result.persistent[k]),
            merged=keys[k][1] == _MERGED,
        )
        for k in flipped.tolist()
    )
    return SignCheck(segments, cost_used, result.cost, result.certified, len(result.signs), result)
