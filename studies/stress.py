"""Robots and motions that are less informative than usual: moves from point to point, slow pendulums, no gravity.

Robots are those of `bayesid.studies.blind`, or built with its classes. A motion is a function from times (M,) to
positions, velocities and accelerations (M, n).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.studies.discrepancy import generator

Motion = Callable[[Array], tuple[Array, Array, Array]]
_MOVE = (0.8, 2.0)
"""s, duration of a move from point to point."""
_REST = (0.4, 1.6)
"""s, between two moves."""
_STEP = (0.15, 1.5)
"""rad, of a joint in one move."""
_REACH = 2.0
"""rad, to either side, as in the generator."""
_RAMP = 0.25
"""Share of a move in which a trapezoidal speed rises, and in which it falls."""
_SLOW = (0.05, 0.6)
"""rad/s, of a pendulum's slow swing: signs are ambiguous at the slow end, and determined by inertia at the fast end."""
_SINE = (0.2, 2.0)
"""rad/s, of a pure sine."""
_SWING = 0.3
"""rad, of both."""
_SECOND = 0.15
"""Share of the faster sine of a swing."""
_CRAWL = 0.02
"""rad/s, of a pendulum with ambiguous signs at any noise of the study."""
_LENGTHS = {"pendulum": 0.0, "lever": 0.5}
"""m, of the links of single joints: with a length the prior knows on which side the mass is."""
_UPRIGHT = [{"a": a, "alpha": 0.0, "d": 0.0, "theta": 0.0} for a in (0.4, 0.35, 0.2)]
"""Table of an arm with vertical axes."""


# ---------------------------------------------------------------------------------------------------------------
# Robots
# ---------------------------------------------------------------------------------------------------------------
def bare_robot(rng: np.random.Generator, kind: str) -> Any:
    """A robot without friction, offsets and rotors.

    Args:
        rng: random numbers.
        kind: "kr5" or "random", as in the generator; "pendulum" or "lever", with a horizontal axis; or "upright", with
            three vertical axes.
    """
    blind = generator("complete")
    if kind in _LENGTHS:
        return _pendulum(rng, _LENGTHS[kind])
    if kind == "upright":
        masses = np.array([6.0, 4.0, 1.5]) * rng.uniform(0.8, 1.25, 3)
        return _robot(blind.GRAVITY.tolist(), _UPRIGHT, blind.random_links(rng, _UPRIGHT, masses))
    return blind.bare_robot(rng, kind)


def _pendulum(rng: np.random.Generator, length: float) -> Any:
    """3 kg about 0.3 m from the axis, hanging or standing within 0.3 rad; `length` (m) of the link in its table."""
    blind = generator("complete")
    theta = rng.choice([-0.5, 0.5]) * np.pi + rng.uniform(-0.3, 0.3)
    joint = {"a": length, "alpha": 0.0, "d": 0.0, "theta": float(theta)}
    inertia = blind.spread_inertia(3.0, np.diag(rng.uniform(0.05, 0.15, 3) ** 2))
    centre = np.array([0.3 - length, *rng.uniform(-0.03, 0.03, 2)])
    return _robot([0.0, -9.81, 0.0], [joint], (blind.Body(3.0, centre, inertia),))


def _robot(gravity: list[float], joints: list[dict[str, float]], links: tuple[Any, ...]) -> Any:
    table = {"name": "robot", "convention": "standard", "gravity": gravity, "joints": joints}
    none = np.zeros(len(links))
    return generator("complete").Robot(table, links, none, none, none, none)


def without_some(robot: Any, rng: np.random.Generator) -> Any:
    """The robot with at least one joint without rotor inertia, and at least one without viscous friction."""
    absent = rng.random((2, robot.n)) < 0.5
    absent[[0, 1], rng.integers(robot.n, size=2)] = True
    return replace(robot, rotor=np.where(absent[0], 0.0, robot.rotor), viscous=np.where(absent[1], 0.0, robot.viscous))


# ---------------------------------------------------------------------------------------------------------------
# Motions
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class PointToPoint:
    """Moves between rests, all joints at once.

    Attributes:
        points: (K + 1, n) rad.
        start: (K,) of each move, s.
        duration: (K,) s.
        smooth: least jerk; else the speed is a trapezoid.
    """

    points: Array
    start: Array
    duration: Array
    smooth: bool

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """Positions, speeds and accelerations (M, n)."""
        k = np.clip(np.searchsorted(self.start, t, side="right") - 1, 0, len(self.start) - 1)
        duration = self.duration[k][:, None]
        x = np.clip((t - self.start[k])[:, None] / duration, 0.0, 1.0)
        share, slope, bend = _quintic(x) if self.smooth else _trapezoid(x)
        step = self.points[k + 1] - self.points[k]
        return self.points[k] + step * share, step * slope / duration, step * bend / duration**2

    def resting(self, t: Array) -> Mask:
        """(M,) whether all joints rest."""
        k = np.clip(np.searchsorted(self.start, t, side="right") - 1, 0, len(self.start) - 1)
        resting: Mask = (t < self.start[0]) | (t > self.start[k] + self.duration[k])
        return resting


def _quintic(x: Array) -> tuple[Array, Array, Array]:
    """Least jerk, and its two derivatives (Flash and Hogan 1985)."""
    return x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2, 60 * x * (1 - x) * (1 - 2 * x)


def _trapezoid(x: Array) -> tuple[Array, Array, Array]:
    """Constant acceleration, constant speed, constant deceleration."""
    top = 1.0 / (1.0 - _RAMP)
    rising, falling = x < _RAMP, x > 1.0 - _RAMP
    share = np.where(
        rising, 0.5 * top / _RAMP * x**2, np.where(falling, 1 - 0.5 * top / _RAMP * (1 - x) ** 2, top * (x - _RAMP / 2))
    )
    slope = top * np.minimum(1.0, np.minimum(x, 1.0 - x) / _RAMP)
    inside = (x > 0.0) & (x < 1.0)
    return share, slope, top / _RAMP * inside * (rising.astype(float) - falling)


def point_to_point(rng: np.random.Generator, n: int) -> PointToPoint:
    """Moves of n joints, and rests, for the whole of the generator's time."""
    times = generator("complete").times()
    count = int(np.ceil((times[-1] - times[0]) / (_MOVE[0] + _REST[0])))
    duration, rest = rng.uniform(*_MOVE, count), rng.uniform(*_REST, count)
    start = times[0] + np.cumsum(rest + np.append(0.0, duration[:-1]))
    points = [rng.uniform(-1.0, 1.0, n)]
    for _ in range(count):
        step = rng.choice([-1.0, 1.0], n) * rng.uniform(*_STEP, n)
        outside = np.abs(points[-1] + step) > _REACH
        points.append(points[-1] + np.where(outside, -step, step))
    return PointToPoint(np.array(points), start, duration, bool(rng.random() < 0.5))


def held(robot: Any, motion: PointToPoint, t: Array, rng: np.random.Generator) -> Array:
    """(M, n) torque of dry friction at rest: in each rest a random share of it, of either sign."""
    k = np.searchsorted(motion.start, t, side="right")
    shares = rng.uniform(-1.0, 1.0, (len(motion.start) + 1, robot.n))
    torque: Array = motion.resting(t)[:, None] * shares[k] * robot.coulomb
    return torque


def one_sine(rng: np.random.Generator, n: int) -> Motion:
    """A pure sine, in which inertia and gravity have almost the same effect."""
    return _swing(rng, n, rng.uniform(*_SINE), 0.0)


def swing(rng: np.random.Generator, n: int) -> Motion:
    """A slow motion, in which gravity dominates."""
    return _swing(rng, n, float(np.exp(rng.uniform(*np.log(_SLOW)))), _SECOND)


def crawl(rng: np.random.Generator, n: int) -> Motion:
    """A very slow motion, in which only gravity matters."""
    return _swing(rng, n, _CRAWL, _SECOND)


def _swing(rng: np.random.Generator, n: int, speed: float, second: float) -> Motion:
    """Two sines of frequencies 1 : 2.3, `second` being the share of the faster one in the amplitude."""
    blind, none = generator("complete"), np.zeros((n, 5))
    frequency, sine = none.copy(), none.copy()
    frequency[:, :2] = speed / (2.0 * np.pi) * np.array([1.0, 2.3])
    sine[:, :2] = _SWING * np.array([1.0 - second, second])
    return blind.Series(frequency, none, sine, rng.uniform(-0.1, 0.1, n), None)


MOTIONS: Mapping[str, Callable[[np.random.Generator, int], Motion]] = {
    "point to point": point_to_point,
    "one sine": one_sine,
    "swing": swing,
    "crawl": crawl,
}
"""Motions in addition to the generator's own."""
