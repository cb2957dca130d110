"""A recording replayed as a stream, row by row as it was logged, and how it agrees with the smoothing of all of it."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from bayesid.arrays import Array, Integers, Mask
from bayesid.errors import InputError
from bayesid.identification.identification import SURE
from bayesid.identification.prediction import Validation
from bayesid.log.log import Log
from bayesid.monitor.changes import Alarm
from bayesid.monitor.tracker import REST, Counts, SignTracker, TrackedSample
from bayesid.monitor.tuning import TUNING
from bayesid.parallel import one_blas_thread
from bayesid.progress import SILENT, Progress


class UpdateTimes(deque[float]):
    """s that the last updates took, `TUNING.timed` at most."""

    def __init__(self) -> None:
        super().__init__(maxlen=TUNING.timed)

    def quantile(self, share: float) -> float:
        """S; nan where there was no update."""
        return float(np.quantile(self, share)) if self else np.nan


@dataclass
class StreamFigures:
    """Of n joints."""

    moving: Integers  # (n,) instants in motion
    squares: Array  # (n,) sum of the squared residuals in motion, (N m)^2
    # (n,) largest external torque over its threshold so far, of two samples in a row the lesser, as the test of a
    # contact takes it (`bayesid.monitor.changes`); nan while none is known
    pushed: Array
    instants: int = 0  # that were looked at
    times: UpdateTimes = field(default_factory=UpdateTimes)  # of the updates
    last: Array | None = None  # (n,) external torque over its threshold in the last sample; nan where it was not known

    @classmethod
    def of_joints(cls, n: int) -> StreamFigures:
        """Before the first sample."""
        return cls(np.zeros(n, dtype=np.int64), np.zeros(n), np.full(n, np.nan))

    def add(self, now: TrackedSample) -> None:
        """One instant more that was looked at."""
        self.instants += 1
        counts = np.array([state != REST for state in now.state]) & np.isfinite(now.residual)
        self.moving += counts
        self.squares += np.where(counts, now.residual, 0.0) ** 2
        ratio = np.where(np.isfinite(now.threshold), np.abs(now.external) / now.threshold, np.nan)
        if self.last is not None:
            self.pushed = np.fmax(self.pushed, np.minimum(ratio, self.last))
        self.last = ratio

    @property
    def rms(self) -> Array:
        """(n,) RMS of the residuals in motion, N m; nan of joints that never moved."""
        return np.where(self.moving > 0, np.sqrt(self.squares / np.maximum(self.moving, 1)), np.nan)


@dataclass(frozen=True)
class Replay:
    """What the tracker knew of each of M instants, no later than its lag."""

    t: Array  # (M,) s
    probability: Array  # (M, n) P(sign = +)
    effort: Array  # (M, n) readings with their likelier signs, N m; nan where there was none
    predicted: Array  # (M, n) the model's efforts, N m
    predicted_sd: Array  # (M, n) their sd, N m
    external: Array  # (M, n) external torques, N m
    threshold: Array  # (M, n) beyond which they are some, N m
    alarms: tuple[Alarm, ...]  # as they stood at the end
    counts: Counts  # what became of the rows
    figures: StreamFigures  # of the stream as a whole
    lag: float  # s
    rate: float  # Hz


def timed(
    tracker: SignTracker, figures: StreamFigures, t: float, q: Array, effort: Array, dq: Array | None
) -> TrackedSample:
    """One update, counted among a stream's figures."""
    began = time.perf_counter()
    now = tracker.update(t, q, effort, dq)
    if now.fresh:
        figures.times.append(time.perf_counter() - began)
    if now.known:
        figures.add(now)
    return now


def contradicts(rate: float, step: float) -> bool:
    """Whether a tracker's rate, Hz, is not that of rows that are typically so far apart, s."""
    return step > 0.0 and not 1.0 / TUNING.farthest <= rate * step <= TUNING.farthest


@one_blas_thread
def replay(tracker: SignTracker, log: Log, progress: Progress = SILENT) -> Replay:
    """Feeds a log to a tracker that has seen nothing yet.

    Args:
        tracker: of the log's robot.
        log: its rows go in as they are: with repeated instants and gaps, and not at an even rate.
        progress: of the rows.

    Raises:
        InputError: the tracker's rate contradicts the log.
    """
    if contradicts(tracker.rate, log.period):
        said = f"the log has rows at {1.0 / log.period:.4g} Hz, not at {tracker.rate:g} Hz"
        remedy = f"leave it out, or give at most {TUNING.farthest:g} times more or less"
        raise InputError(said, field="rate", remedy=remedy)
    figures, seen, rows = StreamFigures.of_joints(log.n_joints), 0, len(log)
    names = "probability", "effort", "predicted", "predicted_sd", "external", "threshold"
    t, told = np.empty(rows), np.empty((len(names), rows, log.n_joints))
    with progress.stage("track") as steps:
        for k in range(rows):
            if k % 1000 == 0:
                steps(k, rows)
            velocity = None if log.dq is None else log.dq[k]
            now = timed(tracker, figures, float(log.t[k]), log.q[k], log.effort[k], velocity)
            if now.known:
                t[seen], told[:, seen] = now.t, [getattr(now, name) for name in names]
                seen += 1
    parts = dict(zip(names, told[:, :seen], strict=True))
    whole = {name: getattr(tracker, name) for name in ("alarms", "counts", "lag", "rate")}
    return Replay(t[:seen], **parts, **whole, figures=figures)


@dataclass(frozen=True)
class Agreement:
    """Of the signs of a stream with others, in samples of n joints that are in motion; of signed joints none count."""

    samples: Array  # (n,) that count
    alike: Array  # (n,) of them those whose sign is the same
    sure: Array  # (n,) those of whose sign the stream was sure to 99 %
    sure_alike: Array  # (n,) those that are both

    @classmethod
    def of(cls, probability: Array, positive: Mask, counts: Mask) -> Agreement:
        """Of probabilities (M, n) with signs (M, n) that are plus where they are True, where samples (M, n) count."""
        alike = ((probability >= 0.5) == positive) & counts
        sure = (np.maximum(probability, 1.0 - probability) >= SURE) & counts
        return cls(*(part.sum(axis=0).astype(float) for part in (counts, alike, sure, alike & sure)))

    @property
    def by_joint(self) -> Array:
        """(n,) share that is alike; nan where none count."""
        return _share(self.alike, self.samples)

    @property
    def sure_by_joint(self) -> Array:
        """(n,) share of which the stream was sure."""
        return _share(self.sure, self.samples)

    @property
    def share(self) -> float:
        """Of all joints that is alike."""
        return float(_share(self.alike.sum(), self.samples.sum()))

    @property
    def sure_share(self) -> float:
        """Of all joints of which the stream was sure."""
        return float(_share(self.sure.sum(), self.samples.sum()))

    @property
    def share_of_sure(self) -> float:
        """Of those of which the stream was sure that is alike."""
        return float(_share(self.sure_alike.sum(), self.sure.sum()))


def _share(some: Array, of: Array) -> Array:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(of > 0.0, some / of, np.nan))


def agreement(streamed: Replay, offline: Validation) -> Agreement:
    """Of a stream's signs with those that the smoothing of the whole log finds by the same model."""
    nearest, moving = _in_motion(streamed, offline)
    counts = moving & ~offline.log.signed & np.isfinite(streamed.effort)
    return Agreement.of(streamed.probability, offline.probability[nearest] >= 0.5, counts)


def known_signs(unsigned: Replay, offline: Validation) -> Agreement:
    """Of the signs of a stream that was fed absolute values with those that the log has, of its signed joints."""
    log = offline.log
    _, moving = _in_motion(unsigned, offline)
    rows = np.searchsorted(log.t, unsigned.t - 0.5 * np.finfo(float).eps * np.abs(unsigned.t))
    effort = log.effort[np.minimum(rows, len(log) - 1)]
    return Agreement.of(unsigned.probability, effort >= 0.0, moving & log.signed & (effort != 0.0))


def _in_motion(streamed: Replay, offline: Validation) -> tuple[Array, Mask]:
    """(M,) places on the smoothing's grid of a stream's instants, and (M, n) whether the joints move there."""
    signals, segments = offline.signals, offline.segments
    moving = segments.per_sample(segments.moving, *signals.effort.shape) > 0
    nearest = np.rint((streamed.t - signals.motion.t[0]) * signals.rate).astype(int)
    nearest = np.clip(nearest, 0, len(moving) - 1)
    return nearest, moving[nearest]
