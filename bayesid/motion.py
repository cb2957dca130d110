"""A robot's motion: joint positions, velocities and accelerations over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array, Integers, Mask, frozen

STANDSTILL = 0.01
"""Share of its highest speed below which an actuator stands still: friction's direction is then
unknown. A round number; not studied."""
_SLOWEST = 1e-6
"""rad/s; an actuator that is never faster stands still all the time: far below what an encoder resolves."""


@dataclass(frozen=True)
class Motion:
    """Positions, velocities and accelerations of n joints at N instants.

    Attributes:
        t: (N,) time, s.
        q: (N, n) joint positions, rad (m for a prismatic joint).
        dq: (N, n) joint velocities, rad/s.
        ddq: (N, n) joint accelerations, rad/s^2.
        origin: when the recording began, s; the first instant, unless this is a part of a longer motion.
    """

    t: Array
    q: Array
    dq: Array
    ddq: Array
    origin: float = np.nan

    def __post_init__(self) -> None:
        q = frozen(self.q, (None, None), "q")
        object.__setattr__(self, "q", q)
        object.__setattr__(self, "t", frozen(self.t, (q.shape[0],), "t"))
        object.__setattr__(self, "dq", frozen(self.dq, q.shape, "dq"))
        object.__setattr__(self, "ddq", frozen(self.ddq, q.shape, "ddq"))
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
        return Motion(self.t[rows], self.q[rows], self.dq[rows], self.ddq[rows], self.origin)

    def joints(self, chosen: list[int]) -> Motion:
        """The motion of some (0-based) joints alone."""
        return Motion(self.t, self.q[:, chosen], self.dq[:, chosen], self.ddq[:, chosen], self.origin)
