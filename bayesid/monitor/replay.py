"""A log replayed as a stream, row by row, and the agreement of its signs with the smoothing of the whole log."""

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
    """Computing times of the last updates, s, `TUNING.timed` at most."""

    def __init__(self) -> None:
        super().__init__(maxlen=TUNING.timed)

    def quantile(self, share: float) -> float:
        """A quantile, s; nan without updates."""
        return float(np.quantile(self, share)) if self else np.nan


@dataclass
class StreamFigures:
    """Statistics of a stream of n joints."""

    moving: Integers  # (n,) samples in motion
    squares: Array  # (n,) sum of the squared residuals in motion, (N m)^2
    # (n,) largest external torque over its threshold that two successive samples reached, as in the test of a contact
    # (`bayesid.monitor.changes`); nan if unknown
    pushed: Array
    effort: Array  # (n,) largest |effort|, N m; nan if unknown
    threshold: Array  # (n,) smallest threshold of a contact, N m; nan if unknown
    instants: int = 0  # known samples
    times: UpdateTimes = field(default_factory=UpdateTimes)  # computing times of the updates
    last: Array | None = None  # (n,) external torque over its threshold in the last sample; nan if unknown

    @classmethod
    def of_joints(cls, n: int) -> StreamFigures:
        """Before the first sample."""
        return cls(np.zeros(n, dtype=np.int64), np.zeros(n), *np.full((3, n), np.nan))

    def add(self, now: TrackedSample) -> None:
        """Adds a known sample."""
        self.instants += 1
        counts = np.array([state != REST for state in now.state]) & np.isfinite(now.residual)
        self.moving += counts
        self.squares += np.where(counts, now.residual, 0.0) ** 2
        ratio = np.where(np.isfinite(now.threshold), np.abs(now.external) / now.threshold, np.nan)
        self.effort = np.fmax(self.effort, np.abs(now.effort))
        self.threshold = np.fmin(self.threshold, np.where(np.isfinite(now.threshold), now.threshold, np.nan))
        if self.last is not None:
            self.pushed = np.fmax(self.pushed, np.minimum(ratio, self.last))
        self.last = ratio

    @property
    def blind(self) -> Integers:
        """0-based joints whose threshold is always above their largest effort."""
        return np.flatnonzero(self.threshold > self.effort)

    @property
    def rms(self) -> Array:
        """(n,) RMS of the residuals in motion, N m; nan for joints that never moved."""
        return np.where(self.moving > 0, np.sqrt(self.squares / np.maximum(self.moving, 1)), np.nan)


@dataclass(frozen=True)
class Replay:
    """The tracker's answers for M samples, with its delay."""

    t: Array  # (M,) s
    probability: Array  # (M, n) P(sign = +)
    effort: Array  # (M, n) readings with their more probable signs, N m; nan without a reading
    predicted: Array  # (M, n) the model's efforts, N m
    predicted_sd: Array  # (M, n) their sd, N m
    external: Array  # (M, n) external torques, N m
    threshold: Array  # (M, n) thresholds of a contact, N m
    alarms: tuple[Alarm, ...]  # at the end
    counts: Counts  # of rows, by what happened to them
    figures: StreamFigures  # statistics of the whole stream
    lag: float  # s
    rate: float  # Hz


def timed(
    tracker: SignTracker, figures: StreamFigures, t: float, q: Array, effort: Array, dq: Array | None
) -> TrackedSample:
    """One update, added to a stream's statistics."""
    began = time.perf_counter()
    now = tracker.update(t, q, effort, dq)
    if now.fresh:
        figures.times.append(time.perf_counter() - began)
    if now.known:
        figures.add(now)
    return now


def contradicts(rate: float, step: float) -> bool:
    """Whether a tracker's rate, Hz, is far from that of rows with a typical step, s."""
    return step > 0.0 and not 1.0 / TUNING.farthest <= rate * step <= TUNING.farthest


@one_blas_thread
def replay(tracker: SignTracker, log: Log, progress: Progress = SILENT) -> Replay:
    """Feeds a log to a new tracker.

    Args:
        tracker: of the log's robot, without samples.
        log: its rows are used as they are: with repeated times, gaps and an uneven rate.
        progress: of the rows.

    Raises:
        InputError: the tracker's rate contradicts the log.
    """
    if contradicts(tracker.rate, log.period):
        problem = f"the log has rows at {1.0 / log.period:.4g} Hz, not at {tracker.rate:g} Hz"
        remedy = f"leave it out, or give at most {TUNING.farthest:g} times more or less"
        raise InputError(problem, field="rate", remedy=remedy)
    figures, count, rows = StreamFigures.of_joints(log.n_joints), 0, len(log)
    names = "probability", "effort", "predicted", "predicted_sd", "external", "threshold"
    t, values = np.empty(rows), np.empty((len(names), rows, log.n_joints))
    with progress.stage("track") as steps:
        for k in range(rows):
            if k % 1000 == 0:
                steps(k, rows)
            velocity = None if log.dq is None else log.dq[k]
            now = timed(tracker, figures, float(log.t[k]), log.q[k], log.effort[k], velocity)
            if now.known:
                t[count], values[:, count] = now.t, [getattr(now, name) for name in names]
                count += 1
    parts = dict(zip(names, values[:, :count], strict=True))
    whole = {name: getattr(tracker, name) for name in ("alarms", "counts", "lag", "rate")}
    return Replay(t[:count], **parts, **whole, figures=figures)


@dataclass(frozen=True)
class Agreement:
    """Agreement of the signs of a stream with other signs, in samples in motion of the unsigned joints of n."""

    samples: Array  # (n,) compared samples
    alike: Array  # (n,) samples with the same sign
    sure: Array  # (n,) samples whose sign is at least 99 % certain in the stream
    sure_alike: Array  # (n,) samples that are both

    @classmethod
    def of(cls, probability: Array, positive: Mask, counts: Mask) -> Agreement:
        """Compares probabilities (M, n) with signs (M, n), True for +, in samples (M, n) that count."""
        alike = ((probability >= 0.5) == positive) & counts
        sure = (np.maximum(probability, 1.0 - probability) >= SURE) & counts
        return cls(*(part.sum(axis=0).astype(float) for part in (counts, alike, sure, alike & sure)))

    @property
    def by_joint(self) -> Array:
        """(n,) share with the same sign; nan without samples."""
        return _share(self.alike, self.samples)

    @property
    def sure_by_joint(self) -> Array:
        """(n,) share of certain signs."""
        return _share(self.sure, self.samples)

    @property
    def share(self) -> float:
        """Share with the same sign, over all joints."""
        return float(_share(self.alike.sum(), self.samples.sum()))

    @property
    def sure_share(self) -> float:
        """Share of certain signs, over all joints."""
        return float(_share(self.sure.sum(), self.samples.sum()))

    @property
    def share_of_sure(self) -> float:
        """Share of certain signs that agree, over all joints."""
        return float(_share(self.sure_alike.sum(), self.sure.sum()))


def _share(part: Array, whole: Array) -> Array:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(whole > 0.0, part / whole, np.nan))


def agreement(streamed: Replay, offline: Validation) -> Agreement:
    """Agreement with the signs by smoothing the whole log under the same model."""
    nearest, moving = _in_motion(streamed, offline)
    counts = moving & ~offline.log.signed & np.isfinite(streamed.effort)
    return Agreement.of(streamed.probability, offline.probability[nearest] >= 0.5, counts)


def known_signs(unsigned: Replay, offline: Validation) -> Agreement:
    """Agreement of a stream of absolute values with the signs of the log's signed joints."""
    log = offline.log
    _, moving = _in_motion(unsigned, offline)
    rows = np.searchsorted(log.t, unsigned.t - 0.5 * np.finfo(float).eps * np.abs(unsigned.t))
    effort = log.effort[np.minimum(rows, len(log) - 1)]
    return Agreement.of(unsigned.probability, effort >= 0.0, moving & log.signed & (effort != 0.0))


def _in_motion(streamed: Replay, offline: Validation) -> tuple[Array, Mask]:
    """(M,) indices of a stream's samples in the smoothing, and (M, n) whether the joints move there."""
    signals, segments = offline.signals, offline.segments
    moving = segments.per_sample(segments.moving, *signals.effort.shape) > 0
    nearest = np.rint((streamed.t - signals.motion.t[0]) * signals.rate).astype(int)
    nearest = np.clip(nearest, 0, len(moving) - 1)
    return nearest, moving[nearest]
