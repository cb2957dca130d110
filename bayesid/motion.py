"""A robot's motion: joint positions, velocities and accelerations over time."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace

import numpy as np

from bayesid.arrays import Array, Integers, Labels, Mask, frozen
from bayesid.errors import InputError, printable

STANDSTILL = 0.01
"""Share of its highest speed below which an actuator stands still: friction's direction is then
unknown. A round number; not studied."""
_LABEL = re.compile(r"[A-Za-z0-9_]{1,40}")
_SLOWEST = 1e-6
"""rad/s; an actuator that is never faster stands still all the time: far below what an encoder resolves."""


def unlabelled() -> Labels:
    """The label of a flange that carries nothing."""
    return np.array("")


def check_label(label: object) -> str:
    """The label of a payload, which becomes a part of names.

    Raises:
        InputError: it holds something else than letters, digits and underscores.

    Example:
        >>> check_label("tool1")
        'tool1'
    """
    if not isinstance(label, str) or not _LABEL.fullmatch(label):
        remedy = "give letters (a to z), digits and underscores, 40 at most, as in tool1"
        raise InputError(f"{printable(str(label))[:60]!r} is no label of a payload", "payload", remedy)
    return label


def labels(values: object, rows: int) -> Labels:
    """(rows,) read-only labels of payloads, of as many or of one for all.

    Raises:
        ValueError: they are of another number of rows.
    """
    return np.broadcast_to(np.asarray(values, dtype=np.str_), (rows,))


@dataclass(frozen=True)
class Motion:
    """Positions, velocities and accelerations of n joints at N instants.

    Attributes:
        t: (N,) time, s.
        q: (N, n) joint positions, rad (m for a prismatic joint).
        dq: (N, n) joint velocities, rad/s.
        ddq: (N, n) joint accelerations, rad/s^2.
        origin: when the recording began, s; the first instant, unless this is a part of a longer motion.
        payload: (N,) label of what the flange carries, or one for all; empty where it carries nothing, as by default.
    """

    t: Array
    q: Array
    dq: Array
    ddq: Array
    origin: float = np.nan
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
        """(n,) highest speed of each joint, rad/s; of one that never moves the slowest that is told from standstill."""
        return np.maximum(np.abs(self.dq).max(axis=0), _SLOWEST)

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
