"""A robot's motion: joint positions, velocities and accelerations over time."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from bayesid.arrays import Array, Integers, Labels, Mask, frozen
from bayesid.errors import InputError, printable

STANDSTILL = 0.01
"""Share of an actuator's highest speed that counts as standstill: friction's direction is then unknown. Halved or
doubled, fewer signs of KR300's log are right."""
_LABEL = re.compile(r"[A-Za-z0-9_]{1,40}")
SLOWEST = 1e-6  # rad/s, far below an encoder's resolution; an actuator that is never faster counts as at rest


def unlabelled() -> Labels:
    """The label of a flange that carries nothing."""
    return np.array("")


def check_label(label: object) -> str:
    """The label of a payload, which becomes a part of names; InputError unless letters, digits and underscores."""
    if not isinstance(label, str) or not _LABEL.fullmatch(label):
        remedy = "give letters (a to z), digits and underscores, 40 at most, as in tool1"
        raise InputError(f"{printable(str(label))[:60]!r} is not a valid label of a payload", "payload", remedy)
    return label


def labels(values: object, rows: int) -> Labels:
    """(rows,) read-only labels of payloads, of as many or of one for all; ValueError if of another number of rows."""
    return np.broadcast_to(np.asarray(values, dtype=np.str_), (rows,))


@dataclass(frozen=True)
class Motion:
    """Positions, velocities and accelerations of n joints at N instants."""

    t: Array  #: (N,) time, s
    q: Array  #: (N, n) joint positions, rad (m for a prismatic joint)
    dq: Array  #: (N, n) joint velocities, rad/s
    ddq: Array  #: (N, n) joint accelerations, rad/s^2
    origin: float = np.nan  #: when the recording began, s; the first instant, unless this is a part of a longer motion
    #: (N,) label of what the flange carries, or one for all; empty where it carries nothing, as by default
    payload: Labels = field(default_factory=unlabelled)

    def __post_init__(self) -> None:
        q = frozen(self.q, (None, None), "q")
        object.__setattr__(self, "q", q)
        object.__setattr__(self, "t", frozen(self.t, (q.shape[0],), "t"))
        object.__setattr__(self, "dq", frozen(self.dq, q.shape, "dq"))
        object.__setattr__(self, "ddq", frozen(self.ddq, q.shape, "ddq"))
        object.__setattr__(self, "payload", labels(self.payload, q.shape[0]))
        if np.isnan(self.origin):
            object.__setattr__(self, "origin", float(self.t[0]) if len(self.t) else 0.0)

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        span = f", {self.t[0]:.6g} to {self.t[-1]:.6g} s" if len(self) else ""
        return f"Motion: {len(self)} instants of {self.n_joints} joints{span}"

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return self.q.shape[1]

    @property
    def top_speed(self) -> Array:
        """(n,) highest speed of each joint, rad/s, at least `SLOWEST`."""
        return np.maximum(np.abs(self.dq).max(axis=0), SLOWEST)

    @property
    def standstill_speed(self) -> Array:
        """(n,) speed below which each joint counts as standing still, rad/s."""
        return STANDSTILL * self.top_speed

    def __getitem__(self, rows: slice | Integers | Mask) -> Motion:
        q, dq, ddq = self.q[rows], self.dq[rows], self.ddq[rows]
        return Motion(self.t[rows], q, dq, ddq, self.origin, self.payload[rows])

    def joints(self, chosen: list[int]) -> Motion:
        """The motion of some (0-based) joints alone."""
        return replace(self, q=self.q[:, chosen], dq=self.dq[:, chosen], ddq=self.ddq[:, chosen])

    def ago(self, lag: float) -> Motion:
        """The motion `lag` seconds ago; before its beginning it is continued by its first cubic."""
        if lag == 0.0 or len(self) < 2:
            return self
        at = self.t - lag
        q, dq, ddq = (scipy.interpolate.CubicSpline(self.t, values)(at) for values in (self.q, self.dq, self.ddq))
        return replace(self, t=at, q=q, dq=dq, ddq=ddq)

    def earlier(self, key: object) -> tuple[Array, Array] | None:
        """(m,) positions one instant before the first and (m, ..) states that an effect kept there; of a log none."""
        return None

    def keep(self, key: object, q: Array, state: Array) -> None:
        """Keeps what `earlier` gives at the next instant; of a log nothing."""


class Instant(Motion):
    """One instant of a running motion: arrays are not checked, and effects keep their states between instants."""

    #: gives positions, velocities and accelerations, each (n,), so many seconds ago
    past: Callable[[float], tuple[Array, Array, Array]] | None
    memory: dict[object, tuple[Array, Array]] | None  #: states of effects by key; None where nothing is to be kept

    def __init__(
        self,
        t: Array,
        q: Array,
        dq: Array,
        ddq: Array,
        origin: float,
        payload: Labels,
        past: Callable[[float], tuple[Array, Array, Array]] | None = None,
        memory: dict[object, tuple[Array, Array]] | None = None,
    ) -> None:
        values = self.__dict__  # a frozen dataclass takes as long to make as a product of matrices
        values["t"], values["q"], values["dq"], values["ddq"] = t, q, dq, ddq
        values["origin"], values["payload"], values["past"], values["memory"] = origin, payload, past, memory

    def joints(self, chosen: list[int]) -> Motion:
        """As views where possible."""
        if len(chosen) == self.q.shape[1] and chosen == [*range(len(chosen))]:
            return self
        index = slice(chosen[0], chosen[0] + 1) if len(chosen) == 1 else chosen  # a view costs a tenth of a copy
        q, dq, ddq = self.q[:, index], self.dq[:, index], self.ddq[:, index]
        return Instant(self.t, q, dq, ddq, self.origin, self.payload, self.past, self.memory)

    def ago(self, lag: float) -> Motion:
        """Likewise; effects keep a separate state for it."""
        if lag == 0.0 or self.past is None:
            return self
        q, dq, ddq = (values[None] for values in self.past(lag))
        return Instant(self.t - lag, q, dq, ddq, self.origin, self.payload, None, self.memory)

    def earlier(self, key: object) -> tuple[Array, Array] | None:
        """(m,) positions one instant ago and (m, ..) states that an effect kept there; None at the first instant."""
        return None if self.memory is None else self.memory.get((key, self.past is None))

    def keep(self, key: object, q: Array, state: Array) -> None:
        """Keeps what `earlier` gives at the next instant."""
        if self.memory is not None:
            self.memory[key, self.past is None] = (q, state)
