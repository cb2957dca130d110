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

PAYLOAD, FRICTION, GAIN, UNKNOWN = "payload", "friction", "gain", "unknown"
CONTACT = "contact"
_EXPLAINED = 0.5
"""Share of the misfit that a named kind explains at least. A round number; not studied."""
_RIDGE = 1e-6
"""Of a column's mean square: what this motion does not show stays at zero."""
_PASSES = 4
"""Fits of a candidate, each with the signs of the one before it. A round number; not studied."""


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


@dataclass(frozen=True)
class _Candidate:
    name: str
    joints: tuple[int, ...]
    columns: Array  # (W, n', p), of its joints
    main: int  # the column whose coefficient people read


def kind_of(look: Look, changed: Mask) -> Kind:
    """What a change that some joints (n,) show looks like."""
    joints = np.flatnonzero(changed).tolist()
    every = tuple(range(look.effort.shape[1]))
    misfit = np.array([_left(look, (j,), look.effort[:, [j]]) for j in every])
    body = _fitted(look, _Candidate(PAYLOAD, every, look.body, 3), misfit)
    own = [max((_fitted(look, one, misfit) for one in _of_joint(look, j)), key=lambda fit: fit[0]) for j in joints]
    together = sum(gain for gain, _ in own)
    if body[0] >= together and body[1].explained >= _EXPLAINED:
        return body[1]
    strongest = max(own, key=lambda fit: fit[0])[1]
    if strongest.explained < _EXPLAINED:
        return Kind(UNKNOWN, tuple(j + 1 for j in joints), None, strongest.explained)
    alike = tuple(sorted(k for _, kind in own if kind.name == strongest.name for k in kind.joints))
    return Kind(strongest.name, alike, strongest.amount, strongest.explained)


def _of_joint(look: Look, j: int) -> list[_Candidate]:
    friction = np.stack([look.direction[:, [j]], look.speed[:, [j]]], axis=2)
    return [_Candidate(FRICTION, (j,), friction, 0), _Candidate(GAIN, (j,), look.effort[:, [j], None], 0)]


def _fitted(look: Look, one: _Candidate, misfit: Array) -> tuple[float, Kind]:
    """By how much a candidate makes the window likelier, less what its freedom costs, and what it says."""
    joints, size = list(one.joints), one.columns.shape[2]
    effort, weight = look.effort[:, joints], look.weight[joints] / look.width[:, joints] ** 2
    rows = (np.sqrt(weight)[:, :, None] * one.columns).reshape(-1, size)
    normal = rows.T @ rows
    normal += np.diag(_RIDGE * np.diag(normal) + 1e-300)
    predicted, change = effort, np.zeros((size,), dtype=float)
    for _ in range(_PASSES):
        aim = (np.sqrt(weight) * (_nearest(look, joints, predicted) - effort)).ravel()
        change[:] = np.linalg.solve(normal, rows.T @ aim)
        predicted = effort + one.columns @ change
    before, left = float(misfit[joints].sum()), _left(look, one.joints, predicted)
    count = max(float((look.weight[joints] * np.isfinite(look.width[:, joints])).sum()), 1.0)
    kind = Kind(one.name, tuple(j + 1 for j in joints), float(change[one.main]), 1.0 - left / max(before, 1e-300))
    return 0.5 * (before - left - size * np.log(count)), kind


def _nearest(look: Look, joints: list[int], predicted: Array) -> Array:
    """(W, n') readings with the signs that suit efforts (W, n'), N m."""
    reading = look.reading[:, joints]
    return np.where(look.signed[joints], reading, np.where(predicted >= 0.0, 1.0, -1.0) * np.abs(reading))


def _left(look: Look, joints: tuple[int, ...], predicted: Array) -> float:
    """Sum of squares over effective samples that efforts (W, n') leave, N m."""
    those = list(joints)
    off = (_nearest(look, those, predicted) - predicted) / look.width[:, those]
    return float((look.weight[those] * off**2).sum())
