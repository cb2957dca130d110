"""Signs, torques and changes while the robot runs: one update a sample, no thread and no clock of its own."""

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
from bayesid.monitor.changes import Alarm, Alarms, ChangeTest, Kind, Look, Ring, Sums, kind_of
from bayesid.monitor.motion_estimate import LocalMotion, MotionWindow
from bayesid.monitor.running_model import AtInstant, Observed, RunningModel
from bayesid.monitor.tuning import TUNING
from bayesid.motion import STANDSTILL, Instant
from bayesid.signs.filtering import Belief, SignFilter

MOVING, REST, UNKNOWN = "moving", "rest", "unknown"
"""States of a joint: the direction of friction is unknown at rest; "unknown": too few samples, or a change."""


@dataclass(frozen=True)
class TrackedSample:
    """What is known of n joints at an instant."""

    #: the instant, s: that of the oldest sample that is still waited for, which is the tracker's lag before the newest
    #: one. At first, and after a gap, it stays that of the first sample until the lag has passed. It is nan before any
    #: sample could be used. It never decreases, unless the clock was set back.
    t: float
    probability: Array  #: (n,) P(sign = +) of the effort; 0 or 1 where it is signed, 0.5 where nothing is known
    effort: Array  #: (n,) the reading with its likelier sign, N m; nan where there is none
    effort_sd: Array  #: (n,) sd of the effort about that, N m: from its uncertain sign and the sensor's noise
    predicted: Array  #: (n,) the model's effort, N m; nan before there are enough samples
    predicted_sd: Array  #: (n,) its sd, N m: by parameters and motion
    residual: Array  #: (n,) effort - predicted, N m
    external: Array  #: (n,) external torque of each joint by the momentum observer, N m; nan while it is not known
    threshold: Array  #: (n,) beyond which it is one, N m; inf while that is not known
    state: tuple[str, ...]  #: (n,) of each joint: "moving", "rest" or "unknown"
    contact: tuple[int, ...]  #: joints (from 1) whose external torque is beyond the threshold
    alarms: tuple[Alarm, ...]  #: that this sample has raised
    q: Array  #: (n,) positions as estimated, rad
    dq: Array  #: (n,) velocities, rad/s
    ddq: Array  #: (n,) accelerations, rad/s^2
    fresh: bool = True  #: False if the sample brought nothing: it was late, repeated or not a number

    @property
    def known(self) -> bool:
        """Whether an update has brought an instant of which something is known."""
        return self.fresh and bool(np.isfinite(self.predicted).all())


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
    """The whole state of a tracker: numbers and arrays, to be copied, pickled and handed to another tracker."""

    motion: MotionWindow  # the samples of the window
    observed: Observed  # the momentum and its observer
    sums: Sums  # of the tests for changes
    alarms: Alarms  # what was raised
    log: Ring  # the last seconds: q, measured dq and ddq, effort
    looks: Ring  # subsampled inputs of the classification: parts of `bayesid.monitor.changes.Look`
    top_speed: Array  # (n,) highest speeds of the actuators so far, rad/s
    sd: Array  # (n,) of the model's effort by its parameters, N m
    origin: float  # when the stream began, s
    looked: float = np.nan  # time of the last instant evaluated, s
    at_rest: Array | None = None  # (n,) size of static friction, N m; None before the first instant
    belief: Belief | None = None  # about the model's error; None before the first instant
    readings: list[tuple[float, Array]] = field(default_factory=list)  # efforts of the newest samples, with their times
    memory: dict[object, tuple[Array, Array]] = field(default_factory=dict)  # states of effects with a memory
    waiting: list[tuple[TrackedSample, Array, Mask]] = field(
        default_factory=list
    )  # without signs, readings, joints held
    late: tuple[int, float] = (0, np.inf)  # late samples in a row that went up, how many and the last, s
    counts: Counts = field(default_factory=Counts)  # what became of the samples
    latest: TrackedSample | None = None  # what was known last


class SignTracker:
    """Reads the signs of |effort| as the robot runs, by an identified model.

    One `update` a sample. The joints' velocities and accelerations are those of a polynomial through the samples of the
    last 0.12 s (`bayesid.monitor.motion_estimate`); signs come from filtering the model's error
    (`bayesid.signs.filtering`), external torques from the momentum (`bayesid.monitor.running_model`), alarms from tests
    with a stated rate of false ones (`bayesid.monitor.changes`). There is no thread, no clock and nothing that grows.

    Args:
        model: an identification, or its model as `bayesid.load` gives it.
        rate: of the samples, Hz; they may jitter, be late or be missing. One that is more than five times too high
            makes a gap of every step, and nothing is known: `counts.gaps` then grows with `counts.updates`.
        lag: s that the caller can wait: an instant is judged with the samples up to so much later. Half of it lets the
            motion be seen from both sides, half the signs.
        signed: (n,) joints whose effort is signed; by default none, and absolute values are taken.
        payload: label of what the flange carries, if the model knows payloads.
        false_alarms: contacts, and changes, an hour that are accepted where nothing happens and the model's error is
            twice what it was on the log that it was identified from, at most.

    Raises:
        InputError: the model, the rate, the lag, the rate of false alarms, the label or `signed` cannot be used.

    Example:
        >>> tracker = bayesid.SignTracker(bayesid.load("result"), rate=50.0, lag=0.05)
        >>> seen = [tracker.update(t, q, e) for t, q, e in zip(log.t, log.q, log.effort)]
        >>> seen[-1].probability.shape, tracker.counts.updates == len(log)
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
        waited = round(lag * rate)
        self._behind, self._sign_wait = waited - waited // 2, waited // 2
        self._running = RunningModel(self._identified, payload)
        self._test = ChangeTest(self._identified.noise, self.rate, false_alarms)
        self._look_stride = max(1, round(self.rate / TUNING.looks))
        self._filter: SignFilter | None = None
        self._state: TrackerState | None = None
        # what is made once is made before the first sample
        ready = self._running.instant(0.0, *np.zeros((3, self.n_joints)))
        self._identified.spread.sd(self._running.model.columns(ready))
        self._running.at(ready)

    def __repr__(self) -> str:
        seen = f"{self.counts.updates} samples, {len(self.alarms)} alarms"
        return f"SignTracker of {self._identified.model.robot.name} at {self.rate:g} Hz, {self.lag:g} s behind: {seen}"

    @property
    def lag(self) -> float:
        """By how much the instants lie behind the newest sample, s."""
        return (self._behind + self._sign_wait) / self.rate

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """What was raised, the last thousand; a contact that turned out to be a change is not among them."""
        return () if self._state is None else self._state.alarms.all

    @property
    def counts(self) -> Counts:
        """What became of the samples."""
        return Counts() if self._state is None else replace(self._state.counts)

    def state(self) -> TrackerState | None:
        """A copy of the tracker's state; None before the first sample."""
        return deepcopy(self._state)

    def restore(self, state: TrackerState | None) -> None:
        """Goes on from a state, to the digit, in a tracker that was made with the same arguments.

        Raises:
            InputError: the state is of another robot, rate or lag.
        """
        if state is not None:
            fresh = self._begin(state.origin, state.motion.velocities, state.motion.accelerations)
            shapes = [(one.motion.values.shape, one.log.rows.shape) for one in (state, fresh)]
            if shapes[0] != shapes[1] or len(state.readings) > self._behind + 1:
                remedy = "make the tracker with the model, rate and lag that the state is of"
                raise InputError("a state of another robot, rate or lag", "state", remedy)
        self._filter = None if state is None or state.at_rest is None else self._filter_of(state.at_rest)
        self._state = deepcopy(state)

    def window(self, since: float = -np.inf) -> Log:
        """The samples since an instant, s, of the last 20 s, whose efforts were all read: for `find_discrepancy`.

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
        """What is known after one more sample, of the instant `lag` before it.

        A sample that is late, repeated or not a number is counted, left out, and answered by what was known before
        (`TrackedSample.fresh` is False). An effort of one joint that is nan leaves that joint's sign to the model.
        After a gap of more than five periods the tracker begins anew, but for tests and alarms. Five late samples in a
        row whose times go up are no longer late: the clock was set back, and what was timed by it is forgotten too, but
        for the alarms that were raised.

        Args:
            t: instant of the sample, s, on a clock of the caller's.
            q: (n,) positions, rad (m).
            effort: (n,) efforts, N m; their absolute values are taken where they are not signed.
            dq: (n,) measured velocities, rad/s, in all samples or in none.
            ddq: (n,) accelerations, rad/s^2, in all samples or in none.

        Raises:
            InputError: the numbers of joints do not suit the model, or velocities are there in some samples only.
        """
        parts = [part for part in (q, dq, ddq) if part is not None]
        arrays = [np.asarray(part, dtype=float).ravel() for part in parts]
        values = arrays[0] if len(arrays) == 1 else np.concatenate(arrays)
        reading = np.array(effort, dtype=float).ravel()
        if self._state is None:
            self._state = self._begin(float(t), dq is not None, ddq is not None)
        state = self._state
        if values.size != state.motion.values.shape[1] or reading.size != self.n_joints:
            raise self._misfit(state, values.size, reading.size)
        if not self._taken(state, t, values):
            latest = self._nothing(np.nan) if state.latest is None else state.latest
            return replace(latest, fresh=False, alarms=())
        state.motion.add(float(t), values)
        reading = np.where(self.signed, reading, np.abs(reading))
        if isnan(reading @ reading):
            state.counts.unread += int(np.isnan(reading).sum())
        state.readings.append((float(t), reading))
        del state.readings[: -self._behind - 1]
        state.log.add(t, values, reading)
        local = state.motion.fit()
        if local is None or len(state.readings) <= self._behind or state.readings[0][0] < local.t - local.scale:
            state.latest = self._nothing(state.readings[0][0])
        else:
            state.latest = self._look(state, local, *state.readings[0])
        return state.latest

    def _look(self, state: TrackerState, local: LocalMotion, t: float, reading: Array) -> TrackedSample:
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
        found, now = self._filter.update(state.belief, size, here.effort, np.sqrt(by_motion), moving)
        if state.counts.updates % self._look_stride == 0 or not some(state.sd > 0.0):
            columns = running.model.columns(instant)
            state.sd = self._identified.spread.sd(columns)[0]
            width = np.sqrt(self._test.width_square + state.sd * state.sd + by_motion)
            width = np.where(moving & ~np.isnan(reading), width, np.inf)
            direction = np.tanh(speeds / np.maximum(running.standstill, STANDSTILL * state.top_speed + 1e-12))
            body = columns[0][:, running.body]
            state.looks.add(t, np.nan_to_num(reading), here.effort, width, body, direction, speeds)
        square = state.sd * state.sd + by_motion
        near_rest = 2.0 * state.at_rest * running.doubt_near_rest(speeds)
        known = np.where(self.signed, reading, np.copysign(size, now - 0.5))
        known = np.where(np.isnan(reading), here.effort, known)
        unknown = self._nothing(t)
        limit = self._observe(state, t, known, here, square, near_rest) if local.full else unknown.threshold
        width = np.sqrt(self._test.width_square + square + near_rest * near_rest)
        alarms, contact = self._alarms(state, t, (known - here.effort) / width, limit, moving)
        state.looked, held = t, state.alarms.held
        joints = zip(held.tolist(), moving.tolist(), strict=True)
        without_signs = replace(
            unknown,
            predicted=here.effort,
            predicted_sd=np.sqrt(square),
            external=state.observed.external if local.full else unknown.external,
            threshold=limit,
            state=tuple([UNKNOWN if changed else MOVING if moves else REST for changed, moves in joints]),
            contact=contact,
            q=q,
            dq=dq,
            ddq=ddq,
        )
        state.waiting.append((without_signs, reading, held))
        if found is None:
            return replace(self._nothing(state.waiting[0][0].t), alarms=alarms)
        return replace(self._with_signs(*state.waiting.pop(0), found), alarms=alarms)

    def _with_signs(self, record: TrackedSample, reading: Array, held: Mask, probability: Array) -> TrackedSample:
        """A record with P(sign = +) (n,), pulled towards 0.5 where a change has made the model invalid."""
        probability = np.where(held, 0.5 + TUNING.trust * (probability - 0.5), probability)
        probability = np.where(self.signed & ~np.isnan(reading), reading >= 0.0, probability)
        effort = np.copysign(reading, probability - 0.5)
        wrong = 4.0 * reading * reading * np.minimum(probability, 1.0 - probability)
        sd, residual = np.sqrt(wrong + self._noise.white**2), effort - record.predicted
        return replace(record, probability=probability, effort=effort, effort_sd=sd, residual=residual)

    def _observe(
        self, state: TrackerState, t: float, known: Array, here: AtInstant, square: Array, near_rest: Array
    ) -> Array:
        """(n,) threshold of the external torque, N m, after one more sample with signed efforts (n,)."""
        lasting, white, bounded = np.sqrt(self._test.lasting_square + square), self._noise.white, near_rest
        if self._running.model.robot.transmission is not None:  # of actuators
            to_joints = self._running.to_joints
            lasting, white = (np.sqrt((to_joints * to_joints) @ (sd * sd)) for sd in (lasting, white))
            bounded, known = np.abs(to_joints) @ bounded, to_joints @ known
        step = 0.0 if isnan(state.looked) else t - state.looked  # without a momentum before it counts for nothing
        state.observed.add(step, here.momentum, known + here.driving, (lasting, white, bounded))
        return state.observed.threshold(self._test.deviations)

    def _alarms(
        self, state: TrackerState, t: float, z: Array, threshold: Array, moving: Mask
    ) -> tuple[tuple[Alarm, ...], tuple[int, ...]]:
        """What one more sample raises, and the joints (from 1) that feel a contact."""
        step, test, alarms = (0.0 if isnan(state.looked) else t - state.looked), self._test, state.alarms
        changed = test.add(state.sums, t, step, z, moving)
        pushed = test.push(state.sums, state.observed.external, threshold)
        raised = []
        fresh = changed & ~alarms.held
        if some(fresh):
            began = float(state.sums.began[fresh].min())
            kind = self._kind(state, began, fresh)
            if kind.name == UNKNOWN and alarms.touched(began, fresh):  # a transient of a push
                test.forget(state.sums, fresh)
            else:
                raised.append(alarms.change(t, began, kind, fresh, state.sums.sums))
        elif t >= alarms.look_again and alarms.latest is not None and some(changed):
            alarms.look(t, self._kind(state, alarms.latest.time, changed), changed, state.sums.sums)
        contact = alarms.touch(t, pushed, state.observed.external)
        alarms.release(step, state.sums.sums, moving)
        felt = () if alarms.contact is None else tuple((np.flatnonzero(pushed & ~alarms.held) + 1).tolist())
        return (*raised, *([] if contact is None else [contact])), felt

    def _kind(self, state: TrackerState, since: float, changed: Mask) -> Kind:
        weight = np.minimum(self._test.weight * self._look_stride, 1.0)
        return kind_of(Look.of(state.looks.since(since)[:, 1:], self.signed, weight), changed)

    def _instant(
        self, state: TrackerState, local: LocalMotion, t: float, motion: tuple[Array, Array, Array]
    ) -> Instant:
        q, dq, ddq = (part[None] for part in motion)

        def past(lag: float) -> tuple[Array, Array, Array]:
            return local.at(t - lag)

        return Instant(np.array([t]), q, dq, ddq, state.origin, self._running.label, past, state.memory)

    def _taken(self, state: TrackerState, t: float, values: Array) -> bool:
        """Whether a sample can be used; counts what it is."""
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
        """Whether a sample before the newest is one more of those by which a clock was set back."""
        number, last = state.late
        if t != last:
            state.late = (number + 1 if t > last else 1), t
        return state.late[0] >= TUNING.set_back

    def _forget_times(self, state: TrackerState, ahead: float) -> None:
        """Resets what was timed by the clock, which has moved by `ahead`, s; raised alarms stay."""
        state.origin += ahead  # what warms up with time goes on
        state.sums = Sums.begin(self.n_joints)
        state.log, state.looks = self._rings(state.motion)
        state.alarms.set_back()

    def _rings(self, motion: MotionWindow) -> tuple[Ring, Ring]:
        width = self.n_joints + motion.values.shape[1]
        return Ring.of(self.rate, width), Ring.of(self.rate / self._look_stride, 9 * self.n_joints)

    def _forget(self, state: TrackerState) -> None:
        """Begins anew after a gap; tests and alarms stay."""
        state.motion.empty()
        state.belief, state.looked = None, np.nan
        state.readings.clear()
        state.waiting.clear()
        state.memory.clear()
        state.observed = Observed.begin(self.n_joints)

    def _begin(self, t: float, velocities: bool, accelerations: bool) -> TrackerState:
        n, span = self.n_joints, max(TUNING.span, TUNING.fewest_periods / self.rate, 2.0 * self.lag)
        motion, nothing = MotionWindow(n, span, self.rate, velocities, accelerations), np.zeros(n)
        rings = self._rings(motion)
        return TrackerState(
            motion, Observed.begin(n), Sums.begin(n), Alarms.begin(n), *rings, nothing, nothing, origin=t
        )

    def _filter_of(self, at_rest: Array) -> SignFilter:
        return SignFilter.of(self._noise, at_rest, self.rate, self._sign_wait)

    def _nothing(self, t: float) -> TrackedSample:
        """What is known without a motion, of the oldest sample that is waited for: its instant, s."""
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

    def _misfit(self, state: TrackerState, values: int, readings: int) -> InputError:
        parts = ["q", *["dq"] * state.motion.velocities, *["ddq"] * state.motion.accelerations]
        seen = f"{readings} efforts and {values} numbers of the motion"
        n = self.n_joints
        expected = f"give {n} efforts and {n} numbers each of {', '.join(parts)}, as in the first sample"
        return InputError(seen, "update", expected)


def _check(identified: IdentifiedModel, rate: float, lag: float, payload: str, false_alarms: float) -> None:
    if not (np.isfinite(rate) and 1.0 <= rate <= TUNING.fastest):
        raise InputError(f"a rate of {rate:g} Hz", "rate", f"give the samples' rate in Hz, 1 to {TUNING.fastest:g}")
    if not (np.isfinite(lag) and 0.0 <= lag <= 1.0):
        raise InputError(f"a lag of {lag:g} s", field="lag", remedy="give 0 to 1, in seconds")
    if not 0.0 < false_alarms <= TUNING.most_alarms:
        remedy = f"give more than 0, and {TUNING.most_alarms:g} at most"
        raise InputError(f"{false_alarms:g} false alarms an hour", field="false_alarms", remedy=remedy)
    if payload and payload not in identified.model.payloads:
        remedy = f"give one of its payloads: {', '.join(identified.model.payloads) or 'none'}"
        raise InputError(f"the model has no payload {payload!r}", field="payload", remedy=remedy)
