"""A learned effect: a sum of smooth functions of one, two or three variables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import astuple
from functools import cache, cached_property
from math import prod
from typing import Any, Self

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.axes import Axis, Component, Family, Quantity
from bayesid.effects.effect import Numbers, Phrase, Scene, number
from bayesid.effects.formula import Description, described
from bayesid.effects.parameters import Parameter, unit_of
from bayesid.effects.term import Term
from bayesid.motion import Motion
from bayesid.robot import Robot


def values_of(robot: Robot, motion: Motion, links: Sequence[float] | Array) -> Callable[[Axis], Array]:
    """The values (N,) of an axis' variable in a motion: positions and speeds are those of actuators.

    Args:
        robot: the robot.
        motion: N samples of its joints.
        links: (10 n,) parameters of the rigid bodies that make the load; may be empty if no variable is a load.
    """
    actuators = robot.actuators(motion)
    load = cache(lambda: robot.inverse_dynamics(motion, np.array(links)))

    def values(axis: Axis) -> Array:
        if axis.quantity is Quantity.TIME:
            return actuators.t - actuators.origin
        moving = {Quantity.POSITION: "q", Quantity.VELOCITY: "dq", Quantity.ACCELERATION: "ddq"}.get(axis.quantity)
        return (getattr(actuators, moving) if moving else load())[:, axis.joint - 1]

    return values


class LearnedEffect(Term):
    """A sum of functions, found in one joint of a log and linear in their amplitudes.

    A function is a product of functions of its variables. Outside the log's range it is constant; a single power only
    beyond another half range; periodic functions continue.

    Args:
        joints: its joint.
        functions: of each function the numbers of its axes, in the order of `bayesid.effects.axes.Axis`, and the rows
            of its weights, as `bayesid.effects.axes.Component` has them.
        links: (10 n,) parameters of the rigid bodies that make the load, or none if no variable is a load.
        number: (1,) counts the learned effects of the joint, from 1.
    """

    functions: tuple[tuple[tuple[Numbers, ...], tuple[Numbers, ...]], ...] = number(given=True)
    links: Numbers = number(given=True, default=())
    number: Numbers = number(given=True, default=(1.0,))

    name = "learned_effect"
    shown_by = "moving through all values of its variables, one of them at a time"
    phrase = Phrase("{who} needs a learned function.", "a learned function")
    can_be_missing = False

    @classmethod
    def of(cls, joint: int, components: Sequence[Component], links: Sequence[float] = (), number: int = 1) -> Self:
        """The effect of some functions in a joint (from 1)."""
        functions: Any = tuple(
            (tuple(tuple(map(float, astuple(axis))) for axis in part.axes), tuple(map(tuple, part.weights.tolist())))
            for part in components
        )
        loaded = any(axis.quantity is Quantity.LOAD for component in components for axis in component.axes)
        return cls(joints=(joint,), number=(number,), functions=functions, links=tuple(links) if loaded else ())

    @classmethod
    def variants(cls, scene: Scene) -> Iterable[Self]:
        """None: it is not tried by name."""
        return ()

    @cached_property
    def components(self) -> tuple[Component, ...]:
        return tuple(Component(tuple(map(_axis, axes)), np.array(weights)) for axes, weights in self.functions)

    @property
    def _counts(self) -> list[int]:
        return [component.weights.shape[1] for component in self.components]

    def in_joints(self, joints: tuple[int, ...], n_joints: int) -> Self:
        return self

    def check(self, n_joints: int) -> None:
        if len(self.joints) != 1 or not 1 <= self.joints[0] <= n_joints:
            raise ValueError(f"joints {list(self.joints)} are not joints of the robot")
        axes = [axis for component in self.components for axis in component.axes]
        self._expect("number", 1)
        self._expect("links", 10 * n_joints * any(axis.quantity is Quantity.LOAD for axis in axes))
        for axis in axes:
            if not 0 <= axis.joint <= n_joints or axis.high <= axis.low or axis.order < 0 or axis.count < 1:
                raise ValueError(f"a variable of {self.name} cannot be used")
        for component in self.components:
            size = prod(axis.count for axis in component.axes)
            if component.weights.ndim != 2 or len(component.weights) != size:
                raise ValueError(f"weights {component.weights.shape}, expected {size} rows")

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """The amplitudes, in the unit of the effort; columns had an RMS of 1 in the log of origin."""
        (joint,), number = self.joints, int(self.number[0])
        unit = unit_of(robot, joint - 1, "N m")
        names = [f"learned{number}_{k}_{joint}" for k in range(1, sum(self._counts) + 1)]
        return tuple(Parameter(name, unit, joint) for name in names)

    def description(self, robot: Robot, theta: Array) -> Description:
        parts = zip(self.components, np.split(theta, np.cumsum(self._counts)[:-1]), strict=True)
        amplitudes = [component.weights @ values for component, values in parts]
        return described(self.joints[0], self.components, amplitudes, unit_of(robot, self.joints[0] - 1, "N m"))

    def columns(self, robot: Robot, motion: Motion) -> Array:
        columns = np.zeros((len(motion), robot.n_joints, sum(self._counts)))
        columns[:, self.joints[0] - 1] = self.own_columns(values_of(robot, motion, self.links))
        return columns

    def own_columns(self, values: Callable[[Axis], Array]) -> Array:
        """(N, p) the same in the joint alone, from the (N,) values of each axis' variable."""
        return np.column_stack([component.columns(values) for component in self.components])

    def change_by_joint(self, scene: Scene) -> tuple[dict[int, Array], dict[int, Array]]:
        return {}, {self.joints[0] - 1: self.own_columns(values_of(scene.robot, scene.motion, self.links))}


def _axis(numbers: Numbers) -> Axis:
    quantity, joint, family, low, high, order, count = numbers
    return Axis(Quantity(int(quantity)), int(joint), Family(int(family)), low, high, order, int(count))
