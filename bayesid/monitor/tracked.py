"""What a tracker knows of every joint at an instant, what it remembers, and the figures of a stream as a whole."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from bayesid.arrays import Array, Integers, Mask
from bayesid.errors import InputError
from bayesid.monitor.changes import Alarm, Alarms, Ring, Sums
from bayesid.monitor.motion_estimate import MotionWindow
from bayesid.monitor.running_model import Observed
from bayesid.signs.filtering import Belief

MOVING, REST, UNKNOWN = "moving", "rest", "unknown"
"""States of a joint: at rest nobody knows friction's direction; unknown while there is too little to go by, or since
the joint has changed."""


@dataclass(frozen=True)
class Tracked:
    """What is known of n joints at an instant.

    Attributes:
        t: the instant, s: that of the oldest sample that is still waited for, which is the tracker's lag before the
            newest one. At first, and after a gap, it stays that of the first sample for as long as it must be waited
            for, and of a record that says nothing it is the sample of which nothing is known; nan before any sample
            could be used. It never goes back, unless the clock was set back.
        probability: (n,) P(sign = +) of the effort; 0 or 1 where it is signed, 0.5 where nothing is known.
        effort: (n,) the reading with its likelier sign, N m; nan where there is none.
        effort_sd: (n,) sd of the effort about that, N m: by the doubt about its sign, and the sensor's noise.
        predicted: (n,) the model's effort, N m; nan before there are enough samples.
        predicted_sd: (n,) its sd, N m: by parameters and motion.
        residual: (n,) effort - predicted, N m.
        external: (n,) external torque of each joint by the momentum observer, N m; nan while it is not known.
        threshold: (n,) beyond which it is one, N m; inf while that is not known.
        state: (n,) of each joint: "moving", "rest" or "unknown".
        contact: joints (from 1) whose external torque is beyond the threshold.
        alarms: that this sample has raised.
        q: (n,) positions as estimated, rad.
        dq: (n,) velocities, rad/s.
        ddq: (n,) accelerations, rad/s^2.
        fresh: False if the sample brought nothing: it was late, repeated or not a number.

    Example:
        >>> tracker = bayesid.SignTracker(bayesid.load_model("result"), rate=50.0)
        >>> for t, q, effort in zip(log.t, log.q, log.effort):
        ...     now = tracker.update(t, q, effort)
        >>> now.state
        ('moving', 'moving', 'moving')
    """

    t: float
    probability: Array
    effort: Array
    effort_sd: Array
    predicted: Array
    predicted_sd: Array
    residual: Array
    external: Array
    threshold: Array
    state: tuple[str, ...]
    contact: tuple[int, ...]
    alarms: tuple[Alarm, ...]
    q: Array
    dq: Array
    ddq: Array
    fresh: bool = True


def signed_joints(signed: Sequence[bool] | Mask | None, n: int) -> Mask:
    """(n,) joints whose efforts have signs, none by default; InputError where it is not one for each."""
    mask = np.zeros(n, dtype=bool) if signed is None else np.asarray(signed, dtype=bool)
    if mask.shape != (n,):
        raise InputError(f"values of shape {mask.shape}", "signed", f"give one for each of the {n} joints")
    return mask


@dataclass
class Counts:
    """What became of the samples."""

    updates: int = 0  # that were taken
    repeated: int = 0  # with the time of the sample before: left out
    late: int = 0  # with an earlier time: left out
    missing: int = 0  # without a finite time, position or velocity: left out
    unread: int = 0  # efforts of single joints that were no numbers: their signs are the model's
    gaps: int = 0  # pauses after which the tracker began anew
    set_back: int = 0  # times that the clock was set back, after which it did so too


@dataclass
class TrackerState:
    """All that a tracker remembers: numbers and arrays, to be copied, pickled and handed to another tracker."""

    motion: MotionWindow  # the samples of the window
    observed: Observed  # the momentum and its observer
    sums: Sums  # of the tests for changes
    alarms: Alarms  # what was raised
    log: Ring  # the last seconds: q, effort, dq, nan where not measured
    looks: Ring  # what they looked like to the model now and then: parts of `bayesid.monitor.changes.Look`
    top_speed: Array  # (n,) highest speeds of the actuators so far, rad/s
    sd: Array  # (n,) of the model's effort by its parameters, N m
    origin: float  # when the stream began, s
    looked: float = np.nan  # time of the instant looked at last, s
    at_rest: Array | None = None  # (n,) size of static friction, N m; None before the first instant
    belief: Belief | None = None  # about the model's error; None before the first instant
    readings: list[tuple[float, Array]] = field(default_factory=list)  # efforts of the newest samples, with their times
    memory: dict[object, tuple[Array, Array]] = field(default_factory=dict)  # states of effects with a memory
    waiting: list[tuple[Tracked, Array, Mask]] = field(default_factory=list)  # without signs, readings, joints held
    late: tuple[int, float] = (0, np.inf)  # late samples in a row that went up, how many and the last, s
    counts: Counts = field(default_factory=Counts)  # what became of the samples
    latest: Tracked | None = None  # what was known last


_FIRST, _STEP, _BINS = 1e-6, math.log(1.01), 2000
"""s of the first bin of the update times, log of the ratio of two bins, and how many: up to minutes, to 1 %."""


@dataclass
class UpdateTimes:
    """How long updates took, as a histogram."""

    counts: Integers = field(default_factory=lambda: np.zeros(_BINS, dtype=np.int64))

    def add(self, seconds: float) -> None:
        """One update more."""
        place = int(math.log(max(seconds, _FIRST) / _FIRST) / _STEP)
        self.counts[min(place, _BINS - 1)] += 1

    def quantile(self, share: float) -> float:
        """s, to 1 %; nan where there was no update."""
        total = self.counts.sum()
        place = int(np.searchsorted(np.cumsum(self.counts), share * total))
        return _FIRST * math.exp(_STEP * (place + 0.5)) if total else math.nan


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

    def add(self, now: Tracked) -> None:
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


def looked_at(now: Tracked) -> bool:
    """Whether an update has brought an instant of which something is known."""
    return now.fresh and bool(np.isfinite(now.predicted).all())
