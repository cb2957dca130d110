"""Contacts, which are short, and changes of the robot, which last.

A contact is an external torque above its threshold. Each joint is tested for a change separately, by cumulative sums of
the log likelihood ratio of residuals with `Tuning.wider` times their expected sd (Page 1954)::

    S <- max(0, S + (z^2 / 2 (1 - 1 / w^2) - log w) / tau),

z the residual over its sd, and tau the samples that count as one. S reaches h by chance once in e^h such samples, at
most (Lorden 1971): h follows from the false alarms an hour that are accepted. A sum that has
reached it, having grown for `Tuning.lasting` and often enough, is a change; a short push does not last so long. The
change is classified by least squares. Each candidate is a few columns: first moments and mass of a body on the flange
for all joints, direction of motion and speed for friction of a joint, the model's effort for its gain. Signs are chosen
anew under each candidate. The candidate with the best Bayesian information criterion on effective samples is named, if
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
_SQUARE, _SIZE = 0.5 * (1.0 - 1.0 / TUNING.wider**2), float(np.log(TUNING.wider))
"""Weight of z^2 in the increment of a sum, and its constant decrement."""
_SHOWS = float(np.sqrt(_SIZE / _SQUARE))
"""Smallest z at which a sum grows."""


@dataclass
class Sums:
    """State of the tests of n joints."""

    sums: Array  # (n,) S
    since: Array  # (n,) s of motion since S was zero
    shown: Array  # (n,) s of that time in which S grew
    began: Array  # (n,) when S left zero, s
    pushed: Mask  # (n,) whether an external torque is beyond its threshold
    beyond: Mask  # (n,) the same at the last sample alone, which may be an outlier

    @classmethod
    def begin(cls, n: int) -> Sums:
        """Before the first sample."""
        return cls(*np.zeros((4, n)), *np.zeros((2, n), dtype=bool))


@dataclass(frozen=True)
class ChangeTest:
    """The tests with their thresholds."""

    noise: Noise  # of the model's residual, N m
    rate: float  # of the samples, Hz
    false_alarms: float  # an hour, of the whole robot: contacts and changes each

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
        """(n,) share of an effective sample that a sample of a joint is."""
        slow = (self.noise.coloured / self.noise.sigma) ** 2
        seconds = (1.0 - slow) / self.rate + slow * 2.0 * self.noise.correlation
        return np.minimum(1.0 / (np.maximum(seconds, TUNING.shortest) * self.rate), 1.0)

    @cached_property
    def width_square(self) -> Array:
        """(n,) variance of the residual on another motion, (N m)^2."""
        return np.asarray((TUNING.other_motion * self.noise.sigma) ** 2)

    def add(self, state: Sums, t: float, step: float, z: Array, moving: Mask) -> Mask:
        """(n,) which joints have changed, by one more sample at t, a step (s) after the one before.

        Residuals z (n,) are divided by their sd; joints at standstill do not count. The state is updated in place.
        """
        size = np.abs(z)
        if max(size.tolist()) <= _SHOWS and not any(state.sums.tolist()):
            return np.zeros_like(moving)
        size = np.minimum(size, TUNING.largest)
        ratio = np.minimum((_SQUARE * size * size - _SIZE) * self.weight, self._most) * moving
        sums = np.minimum(np.maximum(state.sums + ratio, 0.0), TUNING.highest * self.limit)
        state.began = np.where(state.sums == 0.0, t, state.began)
        state.since = np.where(sums == 0.0, 0.0, state.since + step * moving)
        state.shown = np.where(sums == 0.0, 0.0, state.shown + step * (ratio > 0.0))
        state.sums = sums
        changed: Mask = (sums >= self.limit) & (state.shown >= np.maximum(TUNING.lasting, TUNING.often * state.since))
        return changed

    def forget(self, state: Sums, joints: Mask) -> None:
        """Resets the sums of some joints (n,)."""
        state.sums, state.since, state.shown = np.where(joints, 0.0, [state.sums, state.since, state.shown])

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
class Look:
    """W samples of a window in which something has changed."""

    reading: Array  # (W, n) |effort|, or the effort of signed joints, N m
    effort: Array  # (W, n) the model's, N m
    width: Array  # (W, n) sd of the residual, N m; inf where a sample does not count
    body: Array  # (W, n, 4) columns of first moments and mass of a body on the flange, N m per kg m and kg
    direction: Array  # (W, n) smoothed direction of motion of the actuators
    speed: Array  # (W, n) theirs, rad/s
    signed: Mask  # (n,) whether a joint's effort is signed
    weight: Array  # (n,) share of an effective sample that one of a joint is

    @classmethod
    def of(cls, rows: Array, signed: Mask, weight: Array) -> Look:
        """Of rows (W, 9 n) of its first six parts, one after the other."""
        n = len(signed)
        reading, effort, width, body, direction, speed = np.split(rows, n * np.array([1, 2, 3, 7, 8]), axis=1)
        return cls(reading, effort, width, body.reshape(-1, n, 4), direction, speed, signed, weight)


@dataclass(frozen=True)
class Kind:
    """Classification of a change."""

    name: str  # payload, friction, gain or unknown
    joints: tuple[int, ...]  # (from 1) that are affected
    amount: float | None  # kg of a payload, N m of dry friction, or share of a gain, by which they grew; None: unknown
    explained: float  # share of the misfit


def kind_of(look: Look, changed: Mask) -> Kind:
    """Classifies a change in some joints (n,)."""
    joints = np.flatnonzero(changed).tolist()
    gain, payload = _fitted(look, PAYLOAD, list(range(len(changed))), look.body, 3)
    own = []
    for j in joints:
        friction = np.stack([look.direction[:, [j]], look.speed[:, [j]]], axis=2)
        tried = _fitted(look, FRICTION, [j], friction, 0), _fitted(look, GAIN, [j], look.effort[:, [j], None], 0)
        own.append(max(tried, key=itemgetter(0)))
    strongest = max(own, key=itemgetter(0))[1]
    if gain >= sum(one for one, _ in own) and payload.explained >= TUNING.explained:
        return payload
    if strongest.explained < TUNING.explained:
        return Kind(UNKNOWN, tuple(j + 1 for j in joints), None, strongest.explained)
    return replace(strongest, joints=tuple(k for _, kind in own if kind.name == strongest.name for k in kind.joints))


def _fitted(look: Look, name: str, joints: list[int], columns: Array, main: int) -> tuple[float, Kind]:
    """Log likelihood gain of a candidate minus the BIC penalty, and the classification.

    It acts on some 0-based joints by columns (W, n', p); the coefficient of the main one is reported.
    """
    effort, size = look.effort[:, joints], columns.shape[2]
    root = np.sqrt(look.weight[joints]) / look.width[:, joints]
    rows = (root[:, :, None] * columns).reshape(-1, size)
    solver = inverse_of(rows.T @ rows) @ rows.T  # coefficients that this motion does not excite stay zero
    predicted, change = effort, np.zeros(size)
    for _ in range(TUNING.passes):
        change = solver @ (root * (_nearest(look, joints, predicted) - effort)).ravel()
        predicted = effort + columns @ change
    before, left = (float(((root * (_nearest(look, joints, one) - one)) ** 2).sum()) for one in (effort, predicted))
    count = max(float((look.weight[joints] * np.isfinite(look.width[:, joints])).sum()), 1.0)
    kind = Kind(name, tuple(j + 1 for j in joints), float(change[main]), 1.0 - left / max(before, TINY))
    return 0.5 * (before - left - size * np.log(count)), kind


def _nearest(look: Look, joints: list[int], predicted: Array) -> Array:
    reading = look.reading[:, joints]
    return np.where(look.signed[joints], reading, np.copysign(reading, predicted))


@dataclass
class Ring:
    """Ring buffer: the newest rows of a table, each a time, s, and values."""

    rows: Array  # (R, C) the oldest at `count` modulo R; nan where there is none
    count: int = 0  # rows so far

    @classmethod
    def of(cls, rate: float, width: int) -> Ring:
        """Empty, for `TUNING.remembered` seconds at a rate, Hz."""
        size = min(TUNING.most_remembered, int(TUNING.remembered * rate) + 1)
        return cls(np.full((max(8, size), 1 + width), np.nan))

    def add(self, t: float, *parts: Array) -> None:
        """Adds a row: a time, s, and values one after the other."""
        row = np.concatenate([[t], *(part.ravel() for part in parts)])
        self.rows[self.count % len(self.rows), : len(row)] = row
        self.count += 1

    def since(self, start: float) -> Array:
        """(R', C) the rows from a time, s, on, in order."""
        rows = np.roll(self.rows, -(self.count % len(self.rows)), axis=0)
        return rows[rows[:, 0] >= start]


# ---- Alarms ----
UNITS = {PAYLOAD: "kg", FRICTION: "N m", GAIN: "1"}
"""Of the amounts."""


@dataclass(frozen=True)
class Alarm:
    """A detected contact or change."""

    time: float  #: when it began, s
    #: (from 1) of a contact the outermost affected, of a change the one with the largest sum
    joint: int
    kind: str  #: contact, payload, friction, gain or unknown
    joints: tuple[int, ...]  #: all that are affected
    raised: float  #: when it was detected, s
    duration: float | None = None  #: s, of a contact that has ended; otherwise None
    #: by how much payload, dry friction or gain have grown, kg, N m or a share; the largest external torque of a
    #: contact, N m; None if unknown
    amount: float | None = None
    explained: float | None = None  #: share of the misfit that the kind explains; None of a contact

    def as_dict(self) -> dict[str, object]:
        """Its entry in alarms.json."""
        return {**asdict(self), "joints": list(self.joints), "unit": UNITS.get(self.kind, "N m")}


@dataclass
class Alarms:
    """State: alarms raised, the contact that goes on, and joints affected by a change."""

    held: Mask  # (n,) joints affected by a known change
    calm: Array  # (n,) s of motion without misfit in them
    before: list[Alarm] = field(default_factory=list)  # on a clock that was set back since: times are not comparable
    raised: list[Alarm] = field(default_factory=list)  # the last ones, without contacts that became a change
    contact: Alarm | None = None  # the one that goes on
    latest: Alarm | None = None  # the latest change
    look_again: float = np.inf  # when it is classified again, s, from more samples

    @classmethod
    def begin(cls, n: int) -> Alarms:
        """Before the first sample."""
        return cls(np.zeros(n, dtype=bool), np.zeros(n))

    @property
    def all(self) -> tuple[Alarm, ...]:
        """Oldest first, the last `TUNING.kept_alarms`."""
        return (*self.before, *self.raised)[-TUNING.kept_alarms :]

    def set_back(self) -> None:
        """Ends contact and classification after the clock was set back; affected joints stay affected."""
        self.before, self.raised = [*self.all], []
        self.contact, self.latest, self.look_again = None, None, np.inf

    def touch(self, t: float, pushed: Mask, external: Array) -> Alarm | None:
        """The contact that begins now, s, if one does: joints (n,) are pushed by external torques (n,), N m."""
        if not some(pushed & ~self.held):
            if self.contact is not None and t - self.contact.time - (self.contact.duration or 0.0) > TUNING.flicker:
                self.contact = None
            return None
        those = np.flatnonzero(pushed & ~self.held)
        size = float(np.abs(external[those]).max())
        if self.contact is None:
            self.contact = Alarm(t, int(those[-1]) + 1, CONTACT, tuple((those + 1).tolist()), t, 0.0, size)
            self._add(self.contact)
            return self.contact
        joints = tuple(sorted({*self.contact.joints, *(those + 1).tolist()}))
        grown = max(size, self.contact.amount or 0.0)
        going = replace(self.contact, joint=joints[-1], joints=joints, duration=t - self.contact.time, amount=grown)
        self.raised[self._place(self.contact)] = going
        self.contact = going
        return None

    def change(self, t: float, began: float, kind: Kind, changed: Mask, sums: Array) -> Alarm:
        """Raises a change, which replaces contacts of its joints since its onset.

        Detected at time t, s; onset `began`, s: the first sum left zero. Joints (n,) are affected, with sums (n,).
        """
        those = np.full_like(changed, True) if kind.name == PAYLOAD else changed
        self.raised = [one for one in self.raised if not _within(one, began, those)]
        self.contact = None if self.contact is None or _within(self.contact, began, those) else self.contact
        alarm = _of_kind(Alarm(began, 0, kind.name, (), t), kind, changed, sums)
        self.held = self.held | changed | (kind.name == PAYLOAD)
        self.calm = np.where(self.held, 0.0, self.calm)
        self.latest, self.look_again = alarm, began + TUNING.again * (t - began)
        self._add(alarm)
        return alarm

    def touched(self, since: float, joints: Mask) -> bool:
        """Whether a contact of some joints (n,) has begun since a time, s."""
        return any(_within(one, since, joints) for one in self.raised)

    def look(self, t: float, kind: Kind, changed: Mask, sums: Array) -> None:
        """Classifies the latest change again, from more samples."""
        assert self.latest is not None
        better = _of_kind(self.latest, kind, changed, sums)
        if self.latest in self.raised:
            self.raised[self._place(self.latest)] = better
        self.held = self.held | (kind.name == PAYLOAD)
        again = better.time + TUNING.again * (t - better.time)
        self.latest, self.look_again = better, again if again < better.time + TUNING.longest else np.inf

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
    """An alarm with the classification of a change in joints (n,) with sums (n,)."""
    shown = kind.joints if kind.name != PAYLOAD else tuple((np.flatnonzero(changed) + 1).tolist())
    joint = max(shown, key=lambda j: sums[j - 1])
    return replace(alarm, joint=joint, kind=kind.name, joints=shown, amount=kind.amount, explained=kind.explained)


def _within(alarm: Alarm, began: float, joints: Mask) -> bool:
    """Whether an alarm is a contact of some joints (n,) that ended after the onset, s."""
    felt = bool(joints[[j - 1 for j in alarm.joints]].any())
    return alarm.kind == CONTACT and felt and alarm.time + (alarm.duration or 0.0) >= began
