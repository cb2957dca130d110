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
"""Share of an actuator's highest speed that counts as standstill, with unknown direction of friction. Halved or
doubled, fewer signs of KR300's log are right (`ablation`)."""
_LABEL = re.compile(r"[A-Za-z0-9_]{1,40}")
SLOWEST = 1e-6  # rad/s, far below an encoder's resolution; a slower actuator is at rest


def unlabelled() -> Labels:
    """The label of an empty flange."""
    return np.array("")


def check_label(label: object) -> str:
    """The label of a payload; InputError unless it has only letters, digits and underscores."""
    if not isinstance(label, str) or not _LABEL.fullmatch(label):
        remedy = "give letters (a to z), digits and underscores, 40 at most, as in tool1"
        raise InputError(f"{printable(str(label))[:60]!r} is not a valid label of a payload", "payload", remedy)
    return label


def labels(values: object, rows: int) -> Labels:
    """(rows,) read-only labels of payloads, from one label or one per row; ValueError for another number."""
    return np.broadcast_to(np.asarray(values, dtype=np.str_), (rows,))


@dataclass(frozen=True)
class Motion:
    """Positions, velocities and accelerations of n joints at N instants."""

    t: Array  #: (N,) time, s
    q: Array  #: (N, n) joint positions, rad (m for a prismatic joint)
    dq: Array  #: (N, n) joint velocities, rad/s
    ddq: Array  #: (N, n) joint accelerations, rad/s^2
    origin: float = np.nan  #: start of the recording, s; by default the first instant
    #: (N,) label of the payload, or one label for all rows; empty without a payload
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
        """The motion of some (0-based) joints."""
        return replace(self, q=self.q[:, chosen], dq=self.dq[:, chosen], ddq=self.ddq[:, chosen])

    def ago(self, lag: float) -> Motion:
        """The motion `lag` seconds ago; before its beginning it is extrapolated by its first cubic."""
        if lag == 0.0 or len(self) < 2:
            return self
        at = self.t - lag
        q, dq, ddq = (scipy.interpolate.CubicSpline(self.t, values)(at) for values in (self.q, self.dq, self.ddq))
        return replace(self, t=at, q=q, dq=dq, ddq=ddq)

    def earlier(self, key: object) -> tuple[Array, Array] | None:
        """(m,) positions and (m, ..) states that an effect kept at the previous instant; None for a log."""
        return None

    def keep(self, key: object, q: Array, state: Array) -> None:
        """Stores positions and states for `earlier` at the next instant; does nothing for a log."""


class Instant(Motion):
    """One instant of a running motion: arrays are not checked, and effects keep their states between instants."""

    #: gives positions, velocities and accelerations, each (n,), so many seconds ago
    past: Callable[[float], tuple[Array, Array, Array]] | None
    memory: dict[object, tuple[Array, Array]] | None  #: states of effects by key; None to keep none

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
        values = self.__dict__  # the constructor of a frozen dataclass is slow
        values["t"], values["q"], values["dq"], values["ddq"] = t, q, dq, ddq
        values["origin"], values["payload"], values["past"], values["memory"] = origin, payload, past, memory

    def joints(self, chosen: list[int]) -> Motion:
        """The same, as views if possible."""
        if len(chosen) == self.q.shape[1] and chosen == [*range(len(chosen))]:
            return self
        index = slice(chosen[0], chosen[0] + 1) if len(chosen) == 1 else chosen  # a view costs a tenth of a copy
        q, dq, ddq = self.q[:, index], self.dq[:, index], self.ddq[:, index]
        return Instant(self.t, q, dq, ddq, self.origin, self.payload, self.past, self.memory)

    def ago(self, lag: float) -> Motion:
        """The same; effects keep a separate state for it."""
        if lag == 0.0 or self.past is None:
            return self
        q, dq, ddq = (values[None] for values in self.past(lag))
        return Instant(self.t - lag, q, dq, ddq, self.origin, self.payload, None, self.memory)

    def earlier(self, key: object) -> tuple[Array, Array] | None:
        """The same; None at the first instant."""
        return None if self.memory is None else self.memory.get((key, self.past is None))

    def keep(self, key: object, q: Array, state: Array) -> None:
        """Stores positions and states for `earlier`."""
        if self.memory is not None:
            self.memory[key, self.past is None] = (q, state)
