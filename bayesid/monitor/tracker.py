"""Signs, external torques and changes while the robot runs: one update per sample, without threads or a clock."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from math import isfinite, isnan
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bayesid.arrays import Array, Mask, some
from bayesid.errors import InputError
from bayesid.identification.identification import Identification, identified_of
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.log.log import Log
from bayesid.monitor.changes import Alarm, Alarms, ChangeTest, Kind, Ring, Sums, Window, kind_of
from bayesid.monitor.motion_estimate import LocalMotion, MotionWindow
from bayesid.monitor.running_model import ModelAtInstant, MomentumObserver, RunningModel
from bayesid.monitor.tuning import TUNING
from bayesid.motion import STANDSTILL, Instant
from bayesid.signs.filtering import Belief, SignFilter

MOVING, REST, UNKNOWN = "moving", "rest", "unknown"
"""States of a joint: the direction of friction is unknown at rest; "unknown": too few samples, or a change."""


@dataclass(frozen=True)
class TrackedSample:
    """The state of n joints at one time."""

    #: time, s: that of the sample `lag` before the newest one. At first, and after a gap, it stays that of the first
    #: sample until the lag has passed. It is nan before the first valid sample. It never decreases, except after a
    #: clock reset.
    t: float
    probability: Array  #: (n,) P(sign = +) of the effort; 0 or 1 if it is signed, 0.5 if nothing is known
    effort: Array  #: (n,) reading with its more probable sign, N m; nan without a reading
    effort_sd: Array  #: (n,) its sd, from the uncertain sign and the sensor's noise, N m
    predicted: Array  #: (n,) the model's effort, N m; nan before there are enough samples
    predicted_sd: Array  #: (n,) its sd, from parameters and motion, N m
    residual: Array  #: (n,) effort - predicted, N m
    external: Array  #: (n,) external torque of each joint by the momentum observer, N m; nan if unknown
    threshold: Array  #: (n,) threshold of a contact, N m; inf if unknown
    state: tuple[str, ...]  #: (n,) of each joint: "moving", "rest" or "unknown"
    contact: tuple[int, ...]  #: joints (from 1) whose external torque is above the threshold
    alarms: tuple[Alarm, ...]  #: raised by this sample
    q: Array  #: (n,) estimated positions, rad
    dq: Array  #: (n,) velocities, rad/s
    ddq: Array  #: (n,) accelerations, rad/s^2
    fresh: bool = True  #: False if the sample was late, repeated or not finite, and therefore left out

    @property
    def known(self) -> bool:
        """Whether the sample was used and its values are known."""
        return self.fresh and bool(np.isfinite(self.predicted).all())


def signed_joints(signed: Sequence[bool] | Mask | None, n: int) -> Mask:
    """(n,) joints whose efforts have signs, none by default; InputError for a wrong number of values."""
    mask = np.zeros(n, dtype=bool) if signed is None else np.asarray(signed, dtype=bool)
    if mask.shape != (n,):
        raise InputError(f"values of shape {mask.shape}", "signed", f"give one for each of the {n} joints")
    return mask


@dataclass
class Counts:
    """Numbers of samples, by what happened to them."""

    updates: int = 0  # used
    repeated: int = 0  # left out: the time of the previous sample
    late: int = 0  # left out: an earlier time
    missing: int = 0  # left out: time, position or velocity is not finite
    unread: int = 0  # efforts of single joints that are nan: their signs are the model's
    gaps: int = 0  # pauses, after which the tracker restarts
    set_back: int = 0  # clock resets, after which it restarts too


@dataclass
class TrackerState:
    """State of a tracker: numbers and arrays that can be copied, pickled and given to another tracker."""

    motion: MotionWindow  # samples of the window
    observer: MomentumObserver  # of the external torques
    sums: Sums  # of the tests for changes
    alarms: Alarms  # alarms raised
    log: Ring  # the last seconds: q, measured dq and ddq, effort
    inputs: Ring  # subsampled inputs of the classification: fields of `bayesid.monitor.changes.Window`
    top_speed: Array  # (n,) highest speeds of the actuators so far, rad/s
    sd: Array  # (n,) sd of the model's effort by its parameters, N m
    origin: float  # when the stream began, s
    evaluated: float = np.nan  # last time at which the model was evaluated, s
    at_rest: Array | None = None  # (n,) size of static friction, N m; None before the first evaluation
    belief: Belief | None = None  # state of the sign filter; None before the first evaluation
    readings: list[tuple[float, Array]] = field(default_factory=list)  # efforts of the newest samples, with their times
    memory: dict[object, tuple[Array, Array]] = field(default_factory=dict)  # states of effects with a memory
    # samples without signs yet, their readings and the joints affected by a change
    waiting: list[tuple[TrackedSample, Array, Mask]] = field(default_factory=list)
    late: tuple[int, float] = (0, np.inf)  # number of successive late samples with increasing times, and the last, s
    counts: Counts = field(default_factory=Counts)
    latest: TrackedSample | None = None  # the last answer


class SignTracker:
    """Estimates the signs of |effort| while the robot runs, with an identified model.

    Call `update` once per sample. Velocities and accelerations are those of a polynomial through the samples of the
    last 0.12 s (`bayesid.monitor.motion_estimate`). Signs come from a filter of the model's error
    (`bayesid.signs.filtering`), external torques from a momentum observer (`bayesid.monitor.running_model`), alarms
    from tests with a given rate of false alarms (`bayesid.monitor.changes`). The state has a bounded size.

    Args:
        model: an identification, or its model as `bayesid.load` gives it.
        rate: sampling rate, Hz; samples may jitter, be late or be missing. If it is more than five times too high,
            every step is a gap, and signs stay unknown: `counts.gaps` then grows with `counts.updates`.
        lag: output delay, s, that allows smoothing: half of it for the motion, half for the signs.
        signed: (n,) joints whose effort is signed; by default none, and absolute values are used.
        payload: label of the payload on the flange, if the model knows payloads.
        false_alarms: accepted false contacts per hour, and false changes per hour. The rates hold if the model's error
            is at most twice that on the log of its identification.

    Raises:
        InputError: the model, the rate, the lag, the rate of false alarms, the label or `signed` is invalid.

    Example:
        >>> tracker = bayesid.SignTracker(bayesid.load("result"), rate=50.0, lag=0.05)
        >>> samples = [tracker.update(t, q, e) for t, q, e in zip(log.t, log.q, log.effort)]
        >>> samples[-1].probability.shape, tracker.counts.updates == len(log)
        ((3,), True)
    """

    def __init__(
        self,
        model: IdentifiedModel | Identification,
        rate: float,
        lag: float = 0.0,
        signed: Sequence[bool] | None = None,
        *,
        payload: str = "",
        false_alarms: float = 0.01,
    ) -> None:
        self._identified = identified_of(model, "model")
        self.n_joints = self._identified.model.robot.n_joints
        _check(self._identified, rate, lag, payload, false_alarms)
        self.rate, self.signed = float(rate), signed_joints(signed, self.n_joints)
        self._noise = self._identified.noise
        delay = round(lag * rate)
        self._motion_delay, self._sign_delay = delay - delay // 2, delay // 2  # samples
        self._running = RunningModel(self._identified, payload)
        self._test = ChangeTest(self._identified.noise, self.rate, false_alarms)
        self._columns_stride = max(1, round(self.rate / TUNING.columns_rate))
        self._filter: SignFilter | None = None
        self._state: TrackerState | None = None
        # fills caches before the first sample
        instant = self._running.instant(0.0, *np.zeros((3, self.n_joints)))
        self._identified.spread.sd(self._running.model.columns(instant))
        self._running.at(instant)

    def __repr__(self) -> str:
        count = f"{self.counts.updates} samples, {len(self.alarms)} alarms"
        return f"SignTracker of {self._identified.model.robot.name} at {self.rate:g} Hz, delay {self.lag:g} s: {count}"

    @property
    def lag(self) -> float:
        """Delay of the answers after the newest sample, s."""
        return (self._motion_delay + self._sign_delay) / self.rate

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """The last thousand alarms, without contacts that turned out to be changes."""
        return () if self._state is None else self._state.alarms.all

    @property
    def counts(self) -> Counts:
        """Numbers of samples, by what happened to them."""
        return Counts() if self._state is None else replace(self._state.counts)

    def state(self) -> TrackerState | None:
        """A copy of the tracker's state; None before the first sample."""
        return deepcopy(self._state)

    def restore(self, state: TrackerState | None) -> None:
        """Continues exactly from the state of a tracker with the same arguments.

        Raises:
            InputError: the state is of another robot, rate or lag.
        """
        if state is not None:
            fresh = self._begin(state.origin, state.motion.velocities, state.motion.accelerations)
            shapes = [(each.motion.values.shape, each.log.rows.shape) for each in (state, fresh)]
            if shapes[0] != shapes[1] or len(state.readings) > self._motion_delay + 1:
                remedy = "make the tracker with the model, rate and lag of the state"
                raise InputError("a state of another robot, rate or lag", "state", remedy)
        self._filter = None if state is None or state.at_rest is None else self._filter_of(state.at_rest)
        self._state = deepcopy(state)

    def window(self, since: float = -np.inf) -> Log:
        """A log for `find_discrepancy`: the samples since a time, s, at most of the last 20 s, with all efforts.

        Raises:
            InputError: there are none.
        """
        n, rows = self.n_joints, np.empty((0, 1)) if self._state is None else self._state.log.since(since)
        rows = rows[~np.isnan(rows[:, -n:]).any(axis=1)]  # a missing effort is not zero
        if self._state is None or not len(rows):
            raise InputError("no samples to make a log of", "window", "update the tracker first")
        dq = rows[:, 1 + n : 1 + 2 * n] if self._state.motion.velocities else None
        return Log(rows[:, 0], rows[:, 1 : 1 + n], rows[:, -n:], self.signed, dq, source="stream")

    def update(
        self, t: float, q: ArrayLike, effort: ArrayLike, dq: ArrayLike | None = None, ddq: ArrayLike | None = None
    ) -> TrackedSample:
        """Adds a sample; the answer is about the time `lag` before it.

        A sample that is late, repeated or not finite is counted and left out; the previous answer is repeated with
        `TrackedSample.fresh` False. If the effort of a joint is nan, its sign is the model's. After a gap of more than
        five periods the tracker restarts, except for tests and alarms. Five successive late samples with increasing
        times are a clock reset: the tests restart too, and only the alarms stay.

        Args:
            t: time of the sample, s, by the caller's clock.
            q: (n,) positions, rad (m).
            effort: (n,) efforts, N m; in unsigned joints their absolute values are used.
            dq: (n,) measured velocities, rad/s, in all samples or in none.
            ddq: (n,) accelerations, rad/s^2, in all samples or in none.

        Raises:
            InputError: the numbers of joints do not match the model, or velocities come in some samples only.
        """
        parts = [part for part in (q, dq, ddq) if part is not None]
        arrays = [np.asarray(part, dtype=float).ravel() for part in parts]
        values = arrays[0] if len(arrays) == 1 else np.concatenate(arrays)
        reading = np.array(effort, dtype=float).ravel()
        if self._state is None:
            self._state = self._begin(float(t), dq is not None, ddq is not None)
        state = self._state
        if values.size != state.motion.values.shape[1] or reading.size != self.n_joints:
            raise self._wrong_sizes(state, values.size, reading.size)
        if not self._accepted(state, t, values):
            latest = self._unknown(np.nan) if state.latest is None else state.latest
            return replace(latest, fresh=False, alarms=())
        state.motion.add(float(t), values)
        reading = np.where(self.signed, reading, np.abs(reading))
        if isnan(reading @ reading):
            state.counts.unread += int(np.isnan(reading).sum())
        state.readings.append((float(t), reading))
        del state.readings[: -self._motion_delay - 1]
        state.log.add(t, values, reading)
        local = state.motion.fit()
        if local is None or len(state.readings) <= self._motion_delay or state.readings[0][0] < local.t - local.scale:
            state.latest = self._unknown(state.readings[0][0])
        else:
            state.latest = self._answer(state, local, *state.readings[0])
        return state.latest

    def _answer(self, state: TrackerState, local: LocalMotion, t: float, reading: Array) -> TrackedSample:
        motion = q, dq, ddq = local.at(t)
        running, instant = self._running, self._instant(state, local, t, motion)
        here, speeds = running.at(instant), running.actuator_speeds(dq)
        if state.at_rest is None:
            state.at_rest = running.dry_friction(q)
            self._filter = self._filter_of(state.at_rest)
        assert self._filter is not None
        if state.belief is None:
            state.belief = self._filter.begin()
        by_motion = (here.inertia * here.inertia) @ local.variance_of_acceleration(t)
        size, fast = np.abs(reading), np.abs(speeds)
        state.top_speed = np.maximum(state.top_speed, fast)
        moving = fast > running.resting_speeds(state.top_speed)
        delayed, now = self._filter.update(state.belief, size, here.effort, np.sqrt(by_motion), moving)
        if state.counts.updates % self._columns_stride == 0 or not some(state.sd > 0.0):
            columns = running.model.columns(instant)
            state.sd = self._identified.spread.sd(columns)[0]
            width = np.sqrt(self._test.width_square + state.sd * state.sd + by_motion)
            width = np.where(moving & ~np.isnan(reading), width, np.inf)
            direction = np.tanh(speeds / np.maximum(running.standstill, STANDSTILL * state.top_speed + 1e-12))
            body = columns[0][:, running.body]
            state.inputs.add(t, np.nan_to_num(reading), here.effort, width, body, direction, speeds)
        square = state.sd * state.sd + by_motion
        near_rest = 2.0 * state.at_rest * running.doubt_near_rest(speeds)
        effort = np.where(self.signed, reading, np.copysign(size, now - 0.5))
        effort = np.where(np.isnan(reading), here.effort, effort)
        unknown = self._unknown(t)
        limit = self._observe(state, t, effort, here, square, near_rest) if local.full else unknown.threshold
        width = np.sqrt(self._test.width_square + square + near_rest * near_rest)
        alarms, contact = self._alarms(state, t, (effort - here.effort) / width, limit, moving)
        state.evaluated, held = t, state.alarms.held
        joints = zip(held.tolist(), moving.tolist(), strict=True)
        without_signs = replace(
            unknown,
            predicted=here.effort,
            predicted_sd=np.sqrt(square),
            external=state.observer.external if local.full else unknown.external,
            threshold=limit,
            state=tuple([UNKNOWN if changed else MOVING if moves else REST for changed, moves in joints]),
            contact=contact,
            q=q,
            dq=dq,
            ddq=ddq,
        )
        state.waiting.append((without_signs, reading, held))
        if delayed is None:
            return replace(self._unknown(state.waiting[0][0].t), alarms=alarms)
        return replace(self._with_signs(*state.waiting.pop(0), delayed), alarms=alarms)

    def _with_signs(self, record: TrackedSample, reading: Array, held: Mask, probability: Array) -> TrackedSample:
        """A record with P(sign = +) (n,), closer to 0.5 in joints that have changed since the identification."""
        probability = np.where(held, 0.5 + TUNING.trust * (probability - 0.5), probability)
        probability = np.where(self.signed & ~np.isnan(reading), reading >= 0.0, probability)
        effort = np.copysign(reading, probability - 0.5)
        wrong = 4.0 * reading * reading * np.minimum(probability, 1.0 - probability)
        sd, residual = np.sqrt(wrong + self._noise.white**2), effort - record.predicted
        return replace(record, probability=probability, effort=effort, effort_sd=sd, residual=residual)

    def _observe(
        self, state: TrackerState, t: float, effort: Array, here: ModelAtInstant, square: Array, near_rest: Array
    ) -> Array:
        """(n,) threshold of the external torque, N m, after one more sample with signed efforts (n,)."""
        lasting, white, bounded = np.sqrt(self._test.lasting_square + square), self._noise.white, near_rest
        if self._running.model.robot.transmission is not None:  # from actuators to joints
            to_joints = self._running.to_joints
            lasting, white = (np.sqrt((to_joints * to_joints) @ (sd * sd)) for sd in (lasting, white))
            bounded, effort = np.abs(to_joints) @ bounded, to_joints @ effort
        step = 0.0 if isnan(state.evaluated) else t - state.evaluated
        state.observer.add(step, here.momentum, effort + here.driving, (lasting, white, bounded))
        return state.observer.threshold(self._test.deviations)

    def _alarms(
        self, state: TrackerState, t: float, z: Array, threshold: Array, moving: Mask
    ) -> tuple[tuple[Alarm, ...], tuple[int, ...]]:
        """Alarms that one more sample raises, and joints (from 1) in contact."""
        step, test, alarms = (0.0 if isnan(state.evaluated) else t - state.evaluated), self._test, state.alarms
        changed = test.add(state.sums, t, step, z, moving)
        pushed = test.push(state.sums, state.observer.external, threshold)
        raised = []
        fresh = changed & ~alarms.held
        if some(fresh):
            began = float(state.sums.began[fresh].min())
            kind = self._kind(state, began, fresh)
            if kind.name == UNKNOWN and alarms.touched(began, fresh):  # a transient after a push
                test.forget(state.sums, fresh)
            else:
                raised.append(alarms.change(t, began, kind, fresh, state.sums.sums))
        elif t >= alarms.classify_again and alarms.latest is not None and some(changed):
            alarms.reclassify(t, self._kind(state, alarms.latest.time, changed), changed, state.sums.sums)
        contact = alarms.touch(t, pushed, state.observer.external)
        alarms.release(step, state.sums.sums, moving)
        touched = () if alarms.contact is None else tuple((np.flatnonzero(pushed & ~alarms.held) + 1).tolist())
        return (*raised, *([] if contact is None else [contact])), touched

    def _kind(self, state: TrackerState, since: float, changed: Mask) -> Kind:
        weight = np.minimum(self._test.weight * self._columns_stride, 1.0)
        return kind_of(Window.of(state.inputs.since(since)[:, 1:], self.signed, weight), changed)

    def _instant(
        self, state: TrackerState, local: LocalMotion, t: float, motion: tuple[Array, Array, Array]
    ) -> Instant:
        q, dq, ddq = (part[None] for part in motion)

        def past(lag: float) -> tuple[Array, Array, Array]:
            return local.at(t - lag)

        return Instant(np.array([t]), q, dq, ddq, state.origin, self._running.label, past, state.memory)

    def _accepted(self, state: TrackerState, t: float, values: Array) -> bool:
        """Whether a sample is used; updates the counts."""
        counts = state.counts
        if not isfinite(t + values @ values):
            counts.missing += 1
            return False
        ahead = t - state.motion.t[-1] if state.motion.count else np.inf
        if ahead == 0.0:
            counts.repeated += 1
            return False
        if ahead < 0.0:
            if not self._set_back(state, t):
                counts.late += 1
                return False
            counts.set_back += 1
            self._forget(state)
            self._forget_times(state, ahead)
        elif state.motion.count and ahead > TUNING.gap / self.rate:
            counts.gaps += 1
            self._forget(state)
        state.late = 0, np.inf
        counts.updates += 1
        return True

    def _set_back(self, state: TrackerState, t: float) -> bool:
        """Whether a late sample shows that the clock was reset."""
        number, last = state.late
        if t != last:
            state.late = (number + 1 if t > last else 1), t
        return state.late[0] >= TUNING.set_back

    def _forget_times(self, state: TrackerState, ahead: float) -> None:
        """Resets all times after the clock has moved by `ahead`, s; raised alarms stay."""
        state.origin += ahead  # effects of warming up continue
        state.sums = Sums.begin(self.n_joints)
        state.log, state.inputs = self._rings(state.motion)
        state.alarms.set_back()

    def _rings(self, motion: MotionWindow) -> tuple[Ring, Ring]:
        width = self.n_joints + motion.values.shape[1]
        return Ring.of(self.rate, width), Ring.of(self.rate / self._columns_stride, 9 * self.n_joints)

    def _forget(self, state: TrackerState) -> None:
        """Restarts after a gap; tests and alarms stay."""
        state.motion.empty()
        state.belief, state.evaluated = None, np.nan
        state.readings.clear()
        state.waiting.clear()
        state.memory.clear()
        state.observer = MomentumObserver.begin(self.n_joints)

    def _begin(self, t: float, velocities: bool, accelerations: bool) -> TrackerState:
        n, span = self.n_joints, max(TUNING.span, TUNING.fewest_periods / self.rate, 2.0 * self.lag)
        motion, zero = MotionWindow(n, span, self.rate, velocities, accelerations), np.zeros(n)
        rings = self._rings(motion)
        return TrackerState(
            motion, MomentumObserver.begin(n), Sums.begin(n), Alarms.begin(n), *rings, zero, zero, origin=t
        )

    def _filter_of(self, at_rest: Array) -> SignFilter:
        return SignFilter.of(self._noise, at_rest, self.rate, self._sign_delay)

    def _unknown(self, t: float) -> TrackedSample:
        """An answer without values, of a time, s."""
        names = ("effort", "effort_sd", "predicted", "predicted_sd", "residual", "external", "q", "dq", "ddq")
        unknown: dict[str, Any] = dict.fromkeys(names, np.full(self.n_joints, np.nan))
        return TrackedSample(
            t=t,
            probability=np.full(self.n_joints, 0.5),
            threshold=np.full(self.n_joints, np.inf),
            state=(UNKNOWN,) * self.n_joints,
            contact=(),
            alarms=(),
            **unknown,
        )

    def _wrong_sizes(self, state: TrackerState, values: int, readings: int) -> InputError:
        parts = ["q", *["dq"] * state.motion.velocities, *["ddq"] * state.motion.accelerations]
        problem, n = f"{readings} efforts and {values} numbers of the motion", self.n_joints
        remedy = f"give {n} efforts and {n} numbers each of {', '.join(parts)}, as in the first sample"
        return InputError(problem, "update", remedy)


def _check(identified: IdentifiedModel, rate: float, lag: float, payload: str, false_alarms: float) -> None:
    if not (np.isfinite(rate) and 1.0 <= rate <= TUNING.fastest):
        raise InputError(f"a rate of {rate:g} Hz", "rate", f"give the sampling rate in Hz, 1 to {TUNING.fastest:g}")
    if not (np.isfinite(lag) and 0.0 <= lag <= 1.0):
        raise InputError(f"a lag of {lag:g} s", field="lag", remedy="give 0 to 1, in seconds")
    if not 0.0 < false_alarms <= TUNING.most_alarms:
        remedy = f"give more than 0, and {TUNING.most_alarms:g} at most"
        raise InputError(f"{false_alarms:g} false alarms per hour", field="false_alarms", remedy=remedy)
    if payload and payload not in identified.model.payloads:
        remedy = f"give one of its payloads: {', '.join(identified.model.payloads) or 'none'}"
        raise InputError(f"the model has no payload {payload!r}", field="payload", remedy=remedy)
