"""The robot's geometry, off its table: always there a little, and not of the catalogue."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Effect
from bayesid.effects.kinematic_errors import is_distal, shift, turn, with_joint, with_link
from bayesid.motion import Motion
from bayesid.parallel import in_parallel
from bayesid.regression.knowledge import KinematicTolerance
from bayesid.robot import Robot

KINEMATICS: tuple[str, tuple[int, ...]] = ("kinematics", ())
"""Where effects are named: the robot's geometry."""
_STEP = 1e-5
"""m and rad, of the central differences: their error is its square, and rounding 1e-10 of the effort."""
_Move = Callable[[Array, float], Array]
"""A step along or about an axis (3,), as a matrix (4, 4)."""


class Geometry(Effect):
    """The effect itself, for a hypothesis."""

    name = KINEMATICS[0]


def kinematic_columns(
    robot: Robot, motion: Motion, links: Array, tolerance: KinematicTolerance, *, known: bool = False
) -> Array:
    """(N, n, k) efforts of one standard deviation of each place and direction of the robot's geometry, N m.

    Those are of each joint, along the axes of its frame; in the standard convention, where a link's frame stands at the
    next joint and its parameters (10 n,) are about that, of the base, and the numbers d, theta, a and alpha of each
    row. Where base and parameters are known by another log of the robot, they do not go along.
    """

    def column(move: _Move, axis: Array, moved: Callable[[Array], Robot], sd: float) -> Array:
        there, back = (moved(move(axis, step)).inverse_dynamics(motion, links) for step in (_STEP, -_STEP))
        return sd * (there - back) / (2.0 * _STEP)

    sds: dict[_Move, float] = {shift: tolerance.length, turn: tolerance.angle}
    places = [place for place in _displacements(robot, known=known) if sds[place[0]] > 0.0]
    columns = in_parallel([partial(column, *place, sds[place[0]]) for place in places])
    return np.stack(columns, axis=2) if columns else np.zeros((len(motion), robot.n_joints, 0))


def _displacements(robot: Robot, *, known: bool) -> Iterator[tuple[_Move, Array, Callable[[Array], Robot]]]:
    """Shifts and turns, their axes, and the robot of which one part is moved so."""
    distal = not known and is_distal(robot)
    for i in range(1 if known else 0, 1 if distal else robot.n_joints):
        for move in (shift, turn):
            for axis in np.eye(3):
                yield move, axis, partial(with_joint, robot, i)
    for i in range(robot.n_joints if distal else 0):
        for axis, first in ((robot.joints[i].axis, True), (np.array([1.0, 0.0, 0.0]), False)):
            for move in (shift, turn):
                yield move, axis, partial(with_link, robot, i, first=first)
