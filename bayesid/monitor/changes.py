"""What changes while the robot runs: contacts, which are short, and changes of the robot, which last.

A contact is an external torque beyond its threshold. A change is tested for in each joint by itself, by cumulative sums
of the log likelihood ratio of residuals that are `Tuning.wider` times as wide as they should be (Page 1954)::

    S <- max(0, S + (z^2 / 2 (1 - 1 / w^2) - log w) / tau),

z the residual over its sd, and tau the samples that count as one. S reaches h by chance once in e^h such samples, at
most (Lorden 1971): h follows from the false alarms an hour that are accepted. A sum that has reached it, having grown
for `Tuning.lasting` and often enough, is a change; what pushes for a moment does not last so long. Which kind of change
it looks like is then said by least squares (`bayesid.monitor.kinds`).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.special import ndtri

from bayesid.arrays import Array, Mask, some
from bayesid.monitor.kinds import CONTACT, PAYLOAD, Kind
from bayesid.monitor.tuning import TUNING
from bayesid.regression.noise import Noise

_SQUARE, _SIZE = 0.5 * (1.0 - 1.0 / TUNING.wider**2), float(np.log(TUNING.wider))
"""What z^2 adds to a sum, and what each sample takes from it."""
_SHOWS = float(np.sqrt(_SIZE / _SQUARE))
"""z from which on a sum grows."""


@dataclass
class Sums:
    """State of the tests.

    Attributes:
        sums: (n,) S.
        since: (n,) s of motion since S was zero.
        shown: (n,) s of that in which S grew.
        began: (n,) when S left zero, s.
        pushed: (n,) whether an external torque is beyond its threshold.
        beyond: (n,) whether it was so at the last sample: a single one may be an outlier.
    """

    sums: Array
    since: Array
    shown: Array
    began: Array
    pushed: Mask
    beyond: Mask

    @classmethod
    def begin(cls, n: int) -> Sums:
        """Before the first sample."""
        return cls(*np.zeros((4, n)), *np.zeros((2, n), dtype=bool))


@dataclass(frozen=True)
class ChangeTest:
    """The tests, made ready.

    Attributes:
        noise: of the model's residual, N m.
        rate: of the samples, Hz.
        false_alarms: an hour, of the whole robot: contacts and changes each.
    """

    noise: Noise
    rate: float
    false_alarms: float

    @cached_property
    def lasting_square(self) -> Array:
        """(n,) variance of what the model lacks on another motion, (N m)^2."""
        return np.asarray((TUNING.other_motion * self.noise.coloured) ** 2)

    @cached_property
    def deviations(self) -> float:
        """Standard deviations of its threshold beyond which an external torque counts.

        An observer of gain K has about K independent values a second.
        """
        values = 3600.0 * TUNING.observer * len(self.noise.white)
        return float(-ndtri(0.5 * min(0.5, self.false_alarms / values)))

    @cached_property
    def limit(self) -> float:
        """Of a sum, h."""
        return float(np.log(3600.0 * (self.rate * self.weight).sum() / self.false_alarms))

    @cached_property
    def weight(self) -> Array:
        """(n,) share of an effective sample that a sample of a joint is."""
        slow = (self.noise.coloured / self.noise.sigma) ** 2
        seconds = (1.0 - slow) / self.rate + slow * 2.0 * self.noise.correlation
        return np.minimum(1.0 / (np.maximum(seconds, TUNING.shortest) * self.rate), 1.0)

    def width(self, doubt: Array) -> Array:
        """(n,) sd of the residual on another motion, N m, with what else is in doubt (n,) about it."""
        width: Array = np.sqrt(self.width_square + doubt * doubt)
        return width

    @cached_property
    def width_square(self) -> Array:
        """(n,) variance of the residual on another motion, (N m)^2."""
        return np.asarray((TUNING.other_motion * self.noise.sigma) ** 2)

    def add(self, state: Sums, t: float, step: float, z: Array, moving: Mask) -> Mask:
        """(n,) which joints have changed, by one more sample; those at standstill say nothing.

        Args:
            state: is changed.
            t: the instant, s.
            step: since the sample before, s.
            z: (n,) residuals over their width.
            moving: (n,) False at standstill.
        """
        size = np.abs(z)
        if max(size.tolist()) <= _SHOWS and not any(state.sums.tolist()):
            return self._none
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
        """Begins anew in some joints (n,): what shows again lasts."""
        state.sums, state.since, state.shown = (
            np.where(joints, 0.0, part) for part in (state.sums, state.since, state.shown)
        )

    @cached_property
    def _most(self) -> float:
        """That a sample adds to a sum: a push, which shows for twice its length, must not reach the limit."""
        return self.limit / (TUNING.reached * self.rate)

    @cached_property
    def _none(self) -> Mask:
        return np.zeros(len(self.noise.white), dtype=bool)

    def push(self, state: Sums, external: Array, threshold: Array) -> Mask:
        """(n,) which joints feel an external torque (n,), N m."""
        size = np.abs(external)
        beyond = size > threshold
        state.pushed = (beyond & state.beyond) | (state.pushed & (size > TUNING.release * threshold))
        state.beyond = beyond
        return state.pushed


# ---------------------------------------------------------------------------------------------------------------
# Alarms
# ---------------------------------------------------------------------------------------------------------------
UNITS = {PAYLOAD: "kg", "friction": "N m", "gain": "1"}
"""Of the amounts."""


@dataclass(frozen=True)
class Alarm:
    """Something that has happened.

    Attributes:
        time: when it began, s.
        joint: (from 1) the outermost that feels a contact, for it lies beyond; of a change the one that shows it most.
        kind: contact, payload, friction, gain or unknown.
        joints: all that show it.
        raised: when it was said, s.
        duration: s, of a contact that is over; None of what lasts.
        amount: by how much payload, dry friction or gain have grown, kg, N m or a share; the largest external torque of
            a contact, N m; None where nothing is known.
        explained: share of the misfit that the kind explains; None of a contact.

    Example:
        >>> bayesid.Alarm(time=3.2, joint=2, kind="payload", joints=(2, 3), raised=4.1, amount=2.8).kind
        'payload'
    """

    time: float
    joint: int
    kind: str
    joints: tuple[int, ...]
    raised: float
    duration: float | None = None
    amount: float | None = None
    explained: float | None = None

    def as_dict(self) -> dict[str, object]:
        """What alarms.json holds of it."""
        return {**asdict(self), "joints": list(self.joints), "unit": UNITS.get(self.kind, "N m")}


@dataclass
class Alarms:
    """State: what was raised, what goes on, and which joints a change has hold of.

    Attributes:
        before: those by a clock that was set back since, whose times say nothing beside the others.
        raised: the last ones, oldest first; a contact that became a change is not among them.
        contact: the one that goes on.
        held: (n,) joints of whose misfit a change is known.
        calm: (n,) s of motion in which they have shown none.
        latest: the latest change.
        look_again: when it is looked at again, s: what it is shows better the longer it has lasted.
    """

    held: Mask
    calm: Array
    before: list[Alarm] = field(default_factory=list)
    raised: list[Alarm] = field(default_factory=list)
    contact: Alarm | None = None
    latest: Alarm | None = None
    look_again: float = np.inf

    @classmethod
    def begin(cls, n: int) -> Alarms:
        """Before the first sample."""
        return cls(np.zeros(n, dtype=bool), np.zeros(n))

    @property
    def all(self) -> tuple[Alarm, ...]:
        """Oldest first, as many as are remembered."""
        return (*self.before, *self.raised)[-TUNING.kept_alarms :]

    def set_back(self) -> None:
        """The clock was set back: nothing goes on by it; joints that a change has hold of stay held."""
        self.before, self.raised = [*self.all], []
        self.contact, self.latest, self.look_again = None, None, np.inf

    def touch(self, t: float, pushed: Mask, external: Array) -> Alarm | None:
        """The contact that begins with this sample, if one does.

        Args:
            t: the instant, s.
            pushed: (n,) joints beyond their threshold.
            external: (n,) external torques, N m.
        """
        if not some(pushed) or not some(pushed & ~self.held):
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
        """A change, in whose place no contact of its joints since it began stands any more.

        Args:
            t: the instant, s.
            began: when its first joint left the usual, s.
            kind: what it looks like.
            changed: (n,) joints that show it.
            sums: (n,) how clearly.
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
        """Whether a contact of some joints (n,) has begun since an instant, s."""
        return any(_within(one, since, joints) for one in self.raised)

    def look(self, t: float, kind: Kind, changed: Mask, sums: Array) -> None:
        """Says of the latest change what a longer look at it shows."""
        assert self.latest is not None
        better = _of_kind(self.latest, kind, changed, sums)
        if self.latest in self.raised:
            self.raised[self._place(self.latest)] = better
        self.held = self.held | (kind.name == PAYLOAD)
        again = better.time + TUNING.again * (t - better.time)
        self.latest, self.look_again = better, again if again < better.time + TUNING.longest else np.inf

    def release(self, step: float, sums: Array, moving: Mask) -> None:
        """Lets go of joints that have been as usual for long enough."""
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
    """An alarm as what a change looks like, shown by joints (n,), and how clearly (n,)."""
    shown = kind.joints if kind.name != PAYLOAD else tuple((np.flatnonzero(changed) + 1).tolist())
    joint = max(shown, key=lambda j: sums[j - 1])
    return replace(alarm, joint=joint, kind=kind.name, joints=shown, amount=kind.amount, explained=kind.explained)


def _within(alarm: Alarm, began: float, joints: Mask) -> bool:
    """Whether an alarm is a contact of some joints (n,) that lasted up to an instant, s, or began since."""
    felt = bool(joints[[j - 1 for j in alarm.joints]].any())
    return alarm.kind == CONTACT and felt and alarm.time + (alarm.duration or 0.0) >= began
