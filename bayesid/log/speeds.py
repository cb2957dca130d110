"""Whether a log's velocities are those of its positions, and whether any robot is as fast: wrong units show in both."""

from __future__ import annotations

from math import pi

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError

_WINDOW = 20
"""Rows over which velocities are summed up before they are compared: noise and quantisation count little. 0.2 s at the
usual 100 Hz; not studied."""
_ALIKE = 0.9
"""Correlation from which on two signals show the same motion: real logs have 0.99 and more, other signals 0."""
_FACTOR = 2.0
"""Velocities that differ from the change of positions by more than this factor are in another unit: no two usual units
are closer (rev/s and rad/s 6.3, deg/s and rad/s 57)."""
_FASTEST = 60.0
"""rad/s; faster than any joint by its data sheet (the wrists of small arms have 10 to 20, delta robots 50)."""
_DEGREE = 180.0 / pi
_CLOSE = 0.03
"""How far a factor may be from that of a unit to name it. A round number."""


def check_speeds(t: Array, q: Array, source: str) -> None:
    """Refuses a log in which no robot could have moved so fast.

    Args:
        t: (N,) s, non-decreasing.
        q: (N, n) rad, or m.
        source: of the log, for messages.

    Raises:
        InputError: more than half of the joints, and two at least, are faster than any is.
    """
    span = _over_window(t)
    passes = span > 0.0
    speeds = (np.abs(_over_window(joint)[passes]) / span[passes] for joint in q.T)
    fast = np.array([np.quantile(speed, 0.9) > _FASTEST for speed in speeds])
    if fast.sum() > max(1, q.shape[1] // 2):
        remedy = "say the units of time and positions in the header, as in t[min] or q1[deg]"
        raise InputError(f"most joints are faster than {_FASTEST:g} rad/s", source, remedy)


def check_velocities(t: Array, q: Array, dq: Array, source: str) -> None:
    """Refuses velocities that are another multiple of the positions' change.

    Args:
        t: (N,) s, non-decreasing.
        q: (N, n) rad, or m.
        dq: (N, n) rad/s, or m/s.
        source: of the log, for messages.

    Raises:
        InputError: they are.
    """
    for j, (position, speed) in enumerate(zip(q.T, dq.T, strict=True), start=1):
        steps = 0.5 * (speed[1:] + speed[:-1]) * np.diff(t)
        change, velocity = _over_window(position), _over_window(np.append(0.0, np.cumsum(steps)))
        power, other, both = change @ change, velocity @ velocity, change @ velocity
        if power == 0.0 or abs(both) < _ALIKE * np.sqrt(power * other):
            continue
        factor = float(both / power)
        if not 1.0 / _FACTOR < factor < _FACTOR:
            said = f"the velocity of joint {j} is {factor:.3g} times the change of its position"
            raise InputError(said, source, _remedy(factor))


def _over_window(values: Array) -> Array:
    """How much values change within the window from each row on."""
    window = min(_WINDOW, len(values) - 1)
    change: Array = values[window:] - values[:-window]
    return change


def _remedy(factor: float) -> str:
    other = "or leave the velocities out"
    if abs(factor / _DEGREE - 1.0) < _CLOSE:
        return f"if velocities are in degrees/s, name them dq1[deg/s] and so on, {other}"
    if abs(factor * _DEGREE - 1.0) < _CLOSE:
        return f"if positions are in degrees, name them q1[deg] and so on, {other}"
    return f"say the units of time, positions and velocities in the header, as in t[ms] or dq1[rpm], {other}"
