"""Alarms: contacts as they begin, changes once they have lasted, and which contact was the beginning of a change."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace

import numpy as np

from bayesid.arrays import Array, Mask, some
from bayesid.monitor.kinds import CONTACT, PAYLOAD, Kind

_FLICKER = 0.1
"""s after which a contact that has ended is another one when it comes back. A round number; not studied."""
_CALM = 2.0
"""s of motion without a misfit after which a change is over. A round number; not studied."""
_AGAIN, _LONGEST = 2.0, 20.0
"""A change is looked at again when it has lasted so many times as long, up to so many s: what is remembered."""
_KEPT = 1000
"""Alarms that are remembered: a stream may last for weeks."""
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
        """What alarms.json holds of it.

        Example:
            >>> bayesid.Alarm(time=3.2, joint=2, kind="contact", joints=(1, 2), raised=3.2).as_dict()["joints"]
            [1, 2]
        """
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
        return (*self.before, *self.raised)[-_KEPT:]

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
            if self.contact is not None and t - self.contact.time - (self.contact.duration or 0.0) > _FLICKER:
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
        self.latest, self.look_again = alarm, began + _AGAIN * (t - began)
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
        again = better.time + _AGAIN * (t - better.time)
        self.latest, self.look_again = better, again if again < better.time + _LONGEST else np.inf

    def release(self, step: float, sums: Array, moving: Mask) -> None:
        """Lets go of joints that have been as usual for long enough."""
        if not some(self.held):
            return
        calm = self.held & (sums == 0.0)
        self.calm = np.where(calm, self.calm + step * moving, 0.0)
        self.held = self.held & (self.calm < _CALM)

    def _add(self, alarm: Alarm) -> None:
        self.raised.append(alarm)
        del self.raised[:-_KEPT]

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
