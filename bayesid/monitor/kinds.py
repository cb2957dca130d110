"""Which change of a robot the last seconds look like: payload, friction, gain, or nothing that is known.

Each candidate is a few columns: the first moments and mass of a body on the flange, for all joints; the direction of
motion and the speed, for friction of a joint; the model's effort itself, for its gain. Least squares to the window, its
signs chosen anew under each candidate, says how much of the misfit a candidate explains. The one with the best Bayesian
information criterion on effective samples is named, if it leaves little of the misfit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.monitor.tuning import TUNING

PAYLOAD, FRICTION, GAIN, UNKNOWN = "payload", "friction", "gain", "unknown"
CONTACT = "contact"


@dataclass(frozen=True)
class Look:
    """W samples of a window in which something has changed.

    Attributes:
        reading: (W, n) |effort|, or the effort of signed joints, N m.
        effort: (W, n) the model's, N m.
        width: (W, n) sd of the residual, N m; inf where a sample does not count.
        body: (W, n, 4) columns of first moments and mass of a body on the flange, N m per kg m and kg.
        direction: (W, n) smoothed direction of motion of the actuators.
        speed: (W, n) theirs, rad/s.
        signed: (n,) whether a joint's effort is signed.
        weight: (n,) share of an effective sample that one of a joint is.
    """

    reading: Array
    effort: Array
    width: Array
    body: Array
    direction: Array
    speed: Array
    signed: Mask
    weight: Array


@dataclass(frozen=True)
class Kind:
    """What a change looks like.

    Attributes:
        name: payload, friction, gain or unknown.
        joints: (from 1) in which it shows.
        amount: kg of a payload, N m of dry friction, or the share of a gain, by which they grew; None if unknown.
        explained: share of the misfit.
    """

    name: str
    joints: tuple[int, ...]
    amount: float | None
    explained: float


def kind_of(look: Look, changed: Mask) -> Kind:
    """What a change that some joints (n,) show looks like."""
    joints = np.flatnonzero(changed).tolist()
    every = tuple(range(look.effort.shape[1]))
    misfit = np.array([_left(look, (j,), look.effort[:, [j]]) for j in every])
    body = _fitted(look, misfit, PAYLOAD, every, look.body, 3)
    own = [max(_of_joint(look, misfit, j), key=lambda fit: fit[0]) for j in joints]
    together = sum(gain for gain, _ in own)
    if body[0] >= together and body[1].explained >= TUNING.explained:
        return body[1]
    strongest = max(own, key=lambda fit: fit[0])[1]
    if strongest.explained < TUNING.explained:
        return Kind(UNKNOWN, tuple(j + 1 for j in joints), None, strongest.explained)
    alike = tuple(sorted(k for _, kind in own if kind.name == strongest.name for k in kind.joints))
    return Kind(strongest.name, alike, strongest.amount, strongest.explained)


def _of_joint(look: Look, misfit: Array, j: int) -> list[tuple[float, Kind]]:
    friction = np.stack([look.direction[:, [j]], look.speed[:, [j]]], axis=2)
    of_gain = look.effort[:, [j], None]
    return [_fitted(look, misfit, FRICTION, (j,), friction, 0), _fitted(look, misfit, GAIN, (j,), of_gain, 0)]


def _fitted(look: Look, misfit: Array, name: str, of: tuple[int, ...], columns: Array, main: int) -> tuple[float, Kind]:
    """By how much a candidate makes the window likelier, less what its freedom costs, and what it says.

    Args:
        look: the window.
        misfit: (n,) of the model.
        name: of the candidate.
        of: its n' joints (0-based).
        columns: (W, n', p) of these.
        main: the column whose coefficient people read.
    """
    joints, size = list(of), columns.shape[2]
    effort, weight = look.effort[:, joints], look.weight[joints] / look.width[:, joints] ** 2
    rows = (np.sqrt(weight)[:, :, None] * columns).reshape(-1, size)
    normal = rows.T @ rows
    normal += np.diag(1e-6 * np.diag(normal) + 1e-300)  # what this motion does not show stays at zero
    predicted, change = effort, np.zeros((size,), dtype=float)
    for _ in range(TUNING.passes):
        aim = (np.sqrt(weight) * (_nearest(look, joints, predicted) - effort)).ravel()
        change[:] = np.linalg.solve(normal, rows.T @ aim)
        predicted = effort + columns @ change
    before, left = float(misfit[joints].sum()), _left(look, of, predicted)
    count = max(float((look.weight[joints] * np.isfinite(look.width[:, joints])).sum()), 1.0)
    kind = Kind(name, tuple(j + 1 for j in joints), float(change[main]), 1.0 - left / max(before, 1e-300))
    return 0.5 * (before - left - size * np.log(count)), kind


def _nearest(look: Look, joints: list[int], predicted: Array) -> Array:
    reading = look.reading[:, joints]
    return np.where(look.signed[joints], reading, np.where(predicted >= 0.0, 1.0, -1.0) * np.abs(reading))


def _left(look: Look, joints: tuple[int, ...], predicted: Array) -> float:
    """Sum of squares over effective samples that efforts (W, n') leave, N m."""
    those = list(joints)
    off = (_nearest(look, those, predicted) - predicted) / look.width[:, those]
    return float((look.weight[those] * off**2).sum())


# ---------------------------------------------------------------------------------------------------------------
# The last seconds
# ---------------------------------------------------------------------------------------------------------------
@dataclass
class Ring:
    """The newest rows of a table.

    Attributes:
        rows: (R, C) the oldest at `count` modulo R.
        count: rows so far.
    """

    rows: Array
    count: int = 0

    @classmethod
    def of(cls, seconds: float, rate: float, width: int) -> Ring:
        """Empty, for so many seconds at a rate, Hz."""
        return cls(np.full((max(8, min(TUNING.most_remembered, int(seconds * rate) + 1)), width), np.nan))

    def add(self, t: float, *parts: Array) -> None:
        """One more row: an instant, s, and parts one after the other."""
        row, start = self.rows[self.count % len(self.rows)], 1
        row[0] = t
        for part in parts:
            row[start : start + part.size] = part.ravel()
            start += part.size
        self.count += 1

    def newest(self) -> Array:
        """(R', C) the rows in their order."""
        if self.count <= len(self.rows):
            return self.rows[: self.count]
        at = self.count % len(self.rows)
        return np.concatenate([self.rows[at:], self.rows[:at]])


@dataclass
class Recent:
    """What was recorded, and what it looked like to the model now and then.

    Attributes:
        log: rows t, q, effort, dq, nan where not measured.
        looks: rows t, reading, effort, width, body, direction, speed (see `bayesid.monitor.kinds.Look`).
    """

    log: Ring
    looks: Ring

    @classmethod
    def begin(cls, n: int, rate: float, look_rate: float) -> Recent:
        """Before the first sample."""
        return cls(Ring.of(TUNING.remembered, rate, 1 + 3 * n), Ring.of(TUNING.remembered, look_rate, 1 + 9 * n))

    def look(self, since: float, signed: Mask, weight: Array) -> Look:
        """What was seen since an instant, s."""
        n = len(signed)
        rows = self.looks.newest()
        rows = rows[rows[:, 0] >= since]
        reading, effort, width, body, direction, speed = np.split(rows[:, 1:], n * np.array([1, 2, 3, 7, 8]), axis=1)
        return Look(reading, effort, width, body.reshape(-1, n, 4), direction, speed, signed, weight)
