"""Contacts, which are short, and changes of the robot, which last.

A contact is an external torque above its threshold. Each joint is tested for a change separately, by cumulative sums of
the log likelihood ratio of residuals with w = `Tuning.wider` times their expected sd (Page 1954)::

    S <- max(0, S + (z^2 / 2 (1 - 1 / w^2) - log w) / tau),

z the residual over its sd, and tau its correlation time in samples. S reaches h by chance at most once in e^h effective
samples (Lorden 1971): h follows from the accepted rate of false alarms. A change is a sum that has reached h, and has
grown for longer than a push lasts (`Tuning.lasting`, `Tuning.often`).

A change is classified by least squares. Each candidate is a few columns: first moments and mass of a body on the flange
for all joints, direction of motion and speed for friction of a joint, the model's effort for its gain. Signs are chosen
again under each candidate. The candidate with the best Bayesian information criterion on effective samples is named, if
it explains most of the misfit.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from operator import itemgetter

import numpy as np
from scipy.special import ndtri

from bayesid.arrays import TINY, Array, Mask, some
from bayesid.monitor.tuning import TUNING
from bayesid.regression.knowledge import inverse_of
from bayesid.regression.noise import Noise

PAYLOAD, FRICTION, GAIN, UNKNOWN = "payload", "friction", "gain", "unknown"
CONTACT = "contact"
_SQUARE_WEIGHT, _DECREMENT = 0.5 * (1.0 - 1.0 / TUNING.wider**2), float(np.log(TUNING.wider))
"""Weight of z^2 in the increment of a sum, and its constant decrement."""
_LEAST_GROWING = float(np.sqrt(_DECREMENT / _SQUARE_WEIGHT))
"""Smallest |z| at which a sum grows."""


@dataclass
class Sums:
    """State of the tests of n joints."""

    sums: Array  # (n,) S
    since: Array  # (n,) time of motion since S was zero, s
    grown: Array  # (n,) part of that time in which S grew, s
    began: Array  # (n,) time at which S left zero, s
    pushed: Mask  # (n,) whether the external torque is above its threshold
    beyond: Mask  # (n,) the same for the last sample alone, which may be an outlier

    @classmethod
    def begin(cls, n: int) -> Sums:
        """Before the first sample."""
        return cls(*np.zeros((4, n)), *np.zeros((2, n), dtype=bool))


@dataclass(frozen=True)
class ChangeTest:
    """The tests with their thresholds."""

    noise: Noise  # of the model's residual, N m
    rate: float  # of the samples, Hz
    false_alarms: float  # per hour, of the whole robot; the same for contacts and for changes

    @cached_property
    def lasting_square(self) -> Array:
        """(n,) variance of the model error on another motion, (N m)^2."""
        return np.asarray((TUNING.other_motion * self.noise.coloured) ** 2)

    @cached_property
    def deviations(self) -> float:
        """Threshold of an external torque, in standard deviations.

        An observer of gain K has about K independent values a second.
        """
        values = 3600.0 * TUNING.observer * len(self.noise.white)
        return float(-ndtri(0.5 * min(0.5, self.false_alarms / values)))

    @cached_property
    def limit(self) -> float:
        """Threshold h of a sum."""
        return float(np.log(3600.0 * (self.rate * self.weight).sum() / self.false_alarms))

    @cached_property
    def weight(self) -> Array:
        """(n,) effective samples per sample."""
        slow = (self.noise.coloured / self.noise.sigma) ** 2
        seconds = (1.0 - slow) / self.rate + slow * 2.0 * self.noise.correlation
        return np.minimum(1.0 / (np.maximum(seconds, TUNING.shortest) * self.rate), 1.0)

    @cached_property
    def width_square(self) -> Array:
        """(n,) variance of the residual on another motion, (N m)^2."""
        return np.asarray((TUNING.other_motion * self.noise.sigma) ** 2)

    def add(self, state: Sums, t: float, step: float, z: Array, moving: Mask) -> Mask:
        """(n,) which joints have changed, after one more sample at t, a step (s) after the previous one.

        Residuals z (n,) are divided by their sd; joints at standstill do not count. The state is updated in place.
        """
        deviation = np.abs(z)
        if max(deviation.tolist()) <= _LEAST_GROWING and not any(state.sums.tolist()):
            return np.zeros_like(moving)
        deviation = np.minimum(deviation, TUNING.largest)
        ratio = np.minimum((_SQUARE_WEIGHT * deviation * deviation - _DECREMENT) * self.weight, self._most) * moving
        sums = np.minimum(np.maximum(state.sums + ratio, 0.0), TUNING.highest * self.limit)
        state.began = np.where(state.sums == 0.0, t, state.began)
        state.since = np.where(sums == 0.0, 0.0, state.since + step * moving)
        state.grown = np.where(sums == 0.0, 0.0, state.grown + step * (ratio > 0.0))
        state.sums = sums
        changed: Mask = (sums >= self.limit) & (state.grown >= np.maximum(TUNING.lasting, TUNING.often * state.since))
        return changed

    def forget(self, state: Sums, joints: Mask) -> None:
        """Resets the sums of some joints (n,)."""
        state.sums, state.since, state.grown = np.where(joints, 0.0, [state.sums, state.since, state.grown])

    @cached_property
    def _most(self) -> float:
        """Largest increment of a sum by one sample: a push, smoothed to twice its length, stays below the limit."""
        return self.limit / (TUNING.reached * self.rate)

    def push(self, state: Sums, external: Array, threshold: Array) -> Mask:
        """(n,) joints whose external torque (n,), N m, is above its threshold (n,)."""
        size = np.abs(external)
        beyond = size > threshold
        state.pushed = (beyond & state.beyond) | (state.pushed & (size > TUNING.release * threshold))
        state.beyond = beyond
        return state.pushed


# ---- Classification ----
@dataclass(frozen=True)
class Window:
    """W samples since the onset of a change."""

    reading: Array  # (W, n) |effort|, or the effort of signed joints, N m
    effort: Array  # (W, n) the model's, N m
    width: Array  # (W, n) sd of the residual, N m; inf where a sample does not count
    body: Array  # (W, n, 4) columns of first moments and mass of a body on the flange, N m per kg m and kg
    direction: Array  # (W, n) smoothed direction of motion of the actuators
    speed: Array  # (W, n) of the actuators, rad/s
    signed: Mask  # (n,) whether a joint's effort is signed
    weight: Array  # (n,) effective samples per sample

    @classmethod
    def of(cls, rows: Array, signed: Mask, weight: Array) -> Window:
        """From rows (W, 9 n) with the first six fields side by side."""
        n = len(signed)
        reading, effort, width, body, direction, speed = np.split(rows, n * np.array([1, 2, 3, 7, 8]), axis=1)
        return cls(reading, effort, width, body.reshape(-1, n, 4), direction, speed, signed, weight)


@dataclass(frozen=True)
class Kind:
    """Classification of a change."""

    name: str  # payload, friction, gain or unknown
    joints: tuple[int, ...]  # affected joints (from 1)
    amount: float | None  # increase: kg of a payload, N m of dry friction, share of a gain; None if unknown
    explained: float  # share of the misfit


def kind_of(window: Window, changed: Mask) -> Kind:
    """Classifies a change in some joints (n,)."""
    joints = np.flatnonzero(changed).tolist()
    score, payload = _fitted(window, PAYLOAD, list(range(len(changed))), window.body, 3)
    by_joint = []
    for j in joints:
        friction = np.stack([window.direction[:, [j]], window.speed[:, [j]]], axis=2)
        of_friction = _fitted(window, FRICTION, [j], friction, 0)
        of_gain = _fitted(window, GAIN, [j], window.effort[:, [j], None], 0)
        by_joint.append(max(of_friction, of_gain, key=itemgetter(0)))
    best = max(by_joint, key=itemgetter(0))[1]
    if score >= sum(of_joint for of_joint, _ in by_joint) and payload.explained >= TUNING.explained:
        return payload
    if best.explained < TUNING.explained:
        return Kind(UNKNOWN, tuple(j + 1 for j in joints), None, best.explained)
    return replace(best, joints=tuple(k for _, kind in by_joint if kind.name == best.name for k in kind.joints))


def _fitted(window: Window, name: str, joints: list[int], columns: Array, main: int) -> tuple[float, Kind]:
    """Log likelihood gain of a candidate minus the BIC penalty, and the classification.

    It acts on some 0-based joints by columns (W, n', p); the coefficient of the main column is the amount.
    """
    effort, size = window.effort[:, joints], columns.shape[2]
    root = np.sqrt(window.weight[joints]) / window.width[:, joints]
    rows = (root[:, :, None] * columns).reshape(-1, size)
    solver = inverse_of(rows.T @ rows) @ rows.T  # coefficients that this motion does not excite stay zero
    predicted, change = effort, np.zeros(size)
    for _ in range(TUNING.passes):
        change = solver @ (root * (_nearest(window, joints, predicted) - effort)).ravel()
        predicted = effort + columns @ change
    before, after = (
        float(((root * (_nearest(window, joints, model) - model)) ** 2).sum()) for model in (effort, predicted)
    )
    count = max(float((window.weight[joints] * np.isfinite(window.width[:, joints])).sum()), 1.0)
    kind = Kind(name, tuple(j + 1 for j in joints), float(change[main]), 1.0 - after / max(before, TINY))
    return 0.5 * (before - after - size * np.log(count)), kind


def _nearest(window: Window, joints: list[int], predicted: Array) -> Array:
    reading = window.reading[:, joints]
    return np.where(window.signed[joints], reading, np.copysign(reading, predicted))


@dataclass
class Ring:
    """Ring buffer: the newest rows of a table, each a time, s, and values."""

    rows: Array  # (R, C) the oldest at `count` modulo R; nan where there is none
    count: int = 0  # rows so far

    @classmethod
    def of(cls, rate: float, width: int) -> Ring:
        """An empty buffer for `TUNING.remembered` seconds at a rate, Hz."""
        size = min(TUNING.most_remembered, int(TUNING.remembered * rate) + 1)
        return cls(np.full((max(8, size), 1 + width), np.nan))

    def add(self, t: float, *parts: Array) -> None:
        """Adds a row: a time, s, and flattened values."""
        row = np.concatenate([[t], *(part.ravel() for part in parts)])
        self.rows[self.count % len(self.rows), : len(row)] = row
        self.count += 1

    def since(self, start: float) -> Array:
        """(R', C) the rows from a time, s, in order."""
        rows = np.roll(self.rows, -(self.count % len(self.rows)), axis=0)
        return rows[rows[:, 0] >= start]


# ---- Alarms ----
UNITS = {PAYLOAD: "kg", FRICTION: "N m", GAIN: "1"}
"""Of the amounts."""


@dataclass(frozen=True)
class Alarm:
    """A detected contact or change."""

    time: float  #: when it began, s
    joint: int  #: (from 1) the outermost affected by a contact; of a change the one with the largest sum
    kind: str  #: contact, payload, friction, gain or unknown
    joints: tuple[int, ...]  #: all affected joints (from 1)
    raised: float  #: when it was detected, s
    duration: float | None = None  #: s, of a contact that has ended; otherwise None
    #: increase of payload, dry friction or gain: kg, N m or a share; of a contact the largest external torque, N m;
    #: None if unknown
    amount: float | None = None
    explained: float | None = None  #: share of the misfit that the kind explains; None of a contact

    def as_dict(self) -> dict[str, object]:
        """Its entry in alarms.json."""
        return {**asdict(self), "joints": list(self.joints), "unit": UNITS.get(self.kind, "N m")}


@dataclass
class Alarms:
    """State: alarms raised, the current contact, and joints affected by a change."""

    held: Mask  # (n,) joints affected by a known change
    calm: Array  # (n,) time of motion without misfit in these, s
    before: list[Alarm] = field(default_factory=list)  # alarms before the last clock reset, whose times differ
    raised: list[Alarm] = field(default_factory=list)  # later alarms, without contacts that became a change
    contact: Alarm | None = None  # the current contact
    latest: Alarm | None = None  # the latest change
    classify_again: float = np.inf  # time at which it is classified again, s

    @classmethod
    def begin(cls, n: int) -> Alarms:
        """Before the first sample."""
        return cls(np.zeros(n, dtype=bool), np.zeros(n))

    @property
    def all(self) -> tuple[Alarm, ...]:
        """Oldest first, the last `TUNING.kept_alarms`."""
        return (*self.before, *self.raised)[-TUNING.kept_alarms :]

    def set_back(self) -> None:
        """Ends contact and classification after a clock reset; affected joints stay affected."""
        self.before, self.raised = [*self.all], []
        self.contact, self.latest, self.classify_again = None, None, np.inf

    def touch(self, t: float, pushed: Mask, external: Array) -> Alarm | None:
        """The contact, if one begins now, s: joints (n,) are pushed by external torques (n,), N m."""
        if not some(pushed & ~self.held):
            if self.contact is not None and t - self.contact.time - (self.contact.duration or 0.0) > TUNING.flicker:
                self.contact = None
            return None
        touched = np.flatnonzero(pushed & ~self.held)
        size = float(np.abs(external[touched]).max())
        if self.contact is None:
            self.contact = Alarm(t, int(touched[-1]) + 1, CONTACT, tuple((touched + 1).tolist()), t, 0.0, size)
            self._add(self.contact)
            return self.contact
        joints = tuple(sorted({*self.contact.joints, *(touched + 1).tolist()}))
        size = max(size, self.contact.amount or 0.0)
        longer = replace(self.contact, joint=joints[-1], joints=joints, duration=t - self.contact.time, amount=size)
        self.raised[self._place(self.contact)] = longer
        self.contact = longer
        return None

    def change(self, t: float, began: float, kind: Kind, changed: Mask, sums: Array) -> Alarm:
        """Raises a change detected at time t, s; it replaces contacts of its joints since its onset.

        The onset `began`, s, is when the first sum left zero. Joints (n,) are affected, with sums (n,).
        """
        affected = np.full_like(changed, True) if kind.name == PAYLOAD else changed
        self.raised = [alarm for alarm in self.raised if not _within(alarm, began, affected)]
        self.contact = None if self.contact is None or _within(self.contact, began, affected) else self.contact
        alarm = _of_kind(Alarm(began, 0, kind.name, (), t), kind, changed, sums)
        self.held = self.held | changed | (kind.name == PAYLOAD)
        self.calm = np.where(self.held, 0.0, self.calm)
        self.latest, self.classify_again = alarm, began + TUNING.again * (t - began)
        self._add(alarm)
        return alarm

    def touched(self, since: float, joints: Mask) -> bool:
        """Whether a contact of some joints (n,) has begun since a time, s."""
        return any(_within(alarm, since, joints) for alarm in self.raised)

    def reclassify(self, t: float, kind: Kind, changed: Mask, sums: Array) -> None:
        """Classifies the latest change again, from more samples."""
        assert self.latest is not None
        better = _of_kind(self.latest, kind, changed, sums)
        if self.latest in self.raised:
            self.raised[self._place(self.latest)] = better
        self.held = self.held | (kind.name == PAYLOAD)
        again = better.time + TUNING.again * (t - better.time)
        self.latest, self.classify_again = better, again if again < better.time + TUNING.longest else np.inf

    def release(self, step: float, sums: Array, moving: Mask) -> None:
        """Releases joints without misfit for `TUNING.calm`."""
        if not some(self.held):
            return
        calm = self.held & (sums == 0.0)
        self.calm = np.where(calm, self.calm + step * moving, 0.0)
        self.held = self.held & (self.calm < TUNING.calm)

    def _add(self, alarm: Alarm) -> None:
        self.raised.append(alarm)
        del self.raised[: -TUNING.kept_alarms]

    def _place(self, alarm: Alarm) -> int:
        return len(self.raised) - 1 - self.raised[::-1].index(alarm)


def _of_kind(alarm: Alarm, kind: Kind, changed: Mask, sums: Array) -> Alarm:
    joints = kind.joints if kind.name != PAYLOAD else tuple((np.flatnonzero(changed) + 1).tolist())
    joint = max(joints, key=lambda j: sums[j - 1])
    return replace(alarm, joint=joint, kind=kind.name, joints=joints, amount=kind.amount, explained=kind.explained)


def _within(alarm: Alarm, began: float, joints: Mask) -> bool:
    """Whether an alarm is a contact of some joints (n,) that ended after the onset, s."""
    shared = bool(joints[[j - 1 for j in alarm.joints]].any())
    return alarm.kind == CONTACT and shared and alarm.time + (alarm.duration or 0.0) >= began
