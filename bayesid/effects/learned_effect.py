"""An effect without a name, learned from a log: a sum of smooth functions of one, two or three variables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple
from functools import cache, cached_property, partial
from typing import Any, Self

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.axes import Axis, Component, Family, Quantity
from bayesid.effects.effect import Numbers, Phrase, Scene, number
from bayesid.effects.formula import Description, described
from bayesid.effects.parameters import Parameter
from bayesid.effects.term import Term
from bayesid.motion import Motion
from bayesid.robot import Robot

_given = partial(number, given=True)


def values_of(robot: Robot, motion: Motion, links: Sequence[float] | Array) -> Callable[[Axis], Array]:
    """The values (N,) of an axis' variable in a motion: positions and speeds are those of actuators.

    Args:
        robot: the robot.
        motion: N samples of its joints.
        links: (10 n,) parameters of the rigid bodies that make the load; may be empty where no variable is a load.
    """
    actuators = robot.actuators(motion)
    load = cache(lambda: robot.inverse_dynamics(motion, np.array(links)))

    def values(axis: Axis) -> Array:
        if axis.quantity is Quantity.TIME:
            return actuators.t - actuators.origin
        moving = {Quantity.POSITION: "q", Quantity.VELOCITY: "dq", Quantity.ACCELERATION: "ddq"}.get(axis.quantity)
        return (getattr(actuators, moving) if moving else load())[:, axis.joint - 1]

    return values


_OF_AXES = ("component", "quantity", "of_joint", "family", "low", "high", "order", "count")


class LearnedEffect(Term):
    """A sum of functions that a log has shown in one joint, linear in their amplitudes.

    A function is a product of functions of its variables (`effects.axes`). Beyond the range that the log has seen
    smooth functions and sums of powers stay as they are at its end; one power, or a straight line, goes on by half of
    the range, then it stays; waves go on.

    Args:
        joints: the one in which it acts.
        number: of the learned effect in this joint: a model may have learned twice.
        component: (a,) to which of the functions (from 0) each of a axes belongs.
        quantity, of_joint, family, low, high, order, count: (a,) of each axis, as `bayesid.effects.axes.Axis` has them.
        kept: (c,) number of columns of each of the c functions.
        weights: of the products' combinations that these are, one function after the other, row by row.
        links: (10 n,) parameters of the rigid bodies that make the load, or none where no variable is a load.
    """

    number: Numbers = _given(default=(1.0,))
    component: Numbers = _given()
    quantity: Numbers = _given()
    of_joint: Numbers = _given()
    family: Numbers = _given()
    low: Numbers = _given()
    high: Numbers = _given()
    order: Numbers = _given()
    count: Numbers = _given()
    kept: Numbers = _given()
    weights: Numbers = _given()
    links: Numbers = _given(default=())

    name = "learned_effect"
    shown_by = "moving through all values of its variables, one of them at a time"
    phrase = Phrase("{who} needs an effect without a name.", "an effect without a name")
    can_be_missing = False

    @classmethod
    def of(cls, joint: int, components: Sequence[Component], links: Sequence[float] = (), number: int = 1) -> Self:
        """The effect of some functions in a joint (from 1)."""
        rows = [(k, *astuple(axis)) for k, one in enumerate(components) for axis in one.axes]
        columns = zip(*rows, strict=True)
        numbers: Any = {key: tuple(map(float, column)) for key, column in zip(_OF_AXES, columns, strict=True)}
        return cls(
            joints=(joint,),
            number=(float(number),),
            **numbers,
            kept=tuple(float(one.weights.shape[1]) for one in components),
            weights=tuple(np.concatenate([one.weights.ravel() for one in components]).tolist()),
            links=tuple(links) if float(Quantity.LOAD) in numbers["quantity"] else (),
        )

    @classmethod
    def variants(cls, scene: Scene) -> Iterable[Self]:
        """None: what has no name is not tried by name."""
        return ()

    @cached_property
    def components(self) -> tuple[Component, ...]:
        """The functions."""
        kept = [int(one) for one in self.kept]
        sizes = [int(np.prod([axis.count for axis in axes])) * one for axes, one in zip(self._axes, kept, strict=True)]
        weights = np.split(np.array(self.weights), np.cumsum(sizes)[:-1])
        each = zip(self._axes, weights, kept, strict=True)
        return tuple(Component(axes, part.reshape(-1, one)) for axes, part, one in each)

    @property
    def _axes(self) -> list[tuple[Axis, ...]]:
        """Of each of the functions."""
        axes: list[list[Axis]] = [[] for _ in range(int(max(self.component)) + 1)]
        of_axes = [getattr(self, key) for key in _OF_AXES]
        for at, quantity, joint, family, low, high, order, count in zip(*of_axes, strict=True):
            axis = Axis(Quantity(int(quantity)), int(joint), Family(int(family)), low, high, order, int(count))
            axes[int(at)].append(axis)
        return [tuple(some) for some in axes]

    def in_joints(self, joints: tuple[int, ...], n_joints: int) -> Self:
        """Itself: it acts in one joint."""
        return self

    def check(self, n_joints: int) -> None:
        """One joint, variables of joints that there are, and as many numbers as the functions have."""
        axes = int(np.median([len(getattr(self, key)) for key in _OF_AXES]))
        expected = {"joints": 1, "number": 1, **dict.fromkeys(_OF_AXES, axes)}
        self._expect(expected | {"links": 10 * n_joints * (Quantity.LOAD in self.quantity)})
        self._expect({"kept": int(max(self.component)) + 1})
        sizes = [int(np.prod([axis.count for axis in axes])) for axes in self._axes]
        self._expect({"weights": sum(size * int(kept) for size, kept in zip(sizes, self.kept, strict=True))})
        if not 1 <= self.joints[0] <= n_joints or min(sizes) < 1 or min(self.kept) < 1:
            raise ValueError(f"joints {list(self.joints)} are not joints of the robot")
        for axis in (axis for axes in self._axes for axis in axes):
            if not 0 <= axis.joint <= n_joints or axis.high <= axis.low or axis.order < 0 or axis.count < 1:
                raise ValueError(f"a variable of {self.name} cannot be used")

    def _expect(self, sizes: Mapping[str, int]) -> None:
        for key, size in sizes.items():
            if len(getattr(self, key)) != size:
                raise ValueError(f"{key} has {len(getattr(self, key))} numbers, expected {size}")

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """The amplitudes, in the unit of the effort: RMS of a column where it was learned."""
        (joint,), number = self.joints, int(self.number[0])
        unit = "N" if robot.joints[joint - 1].prismatic else "N m"
        count = int(sum(self.kept))
        return tuple(Parameter(f"learned{number}_{k}_{joint}", unit, joint) for k in range(1, count + 1))

    def description(self, robot: Robot, theta: Array) -> Description:
        """Its variables, formula and families."""
        unit = self.parameters(robot)[0].unit
        bounds = np.cumsum([int(kept) for kept in self.kept])[:-1]
        amplitudes = [c.weights @ part for c, part in zip(self.components, np.split(theta, bounds), strict=True)]
        return described(self.joints[0], self.components, amplitudes, unit)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(N, n, p) combinations of the products, in the row of the joint."""
        columns = np.zeros((len(motion), robot.n_joints, int(sum(self.kept))))
        columns[:, self.joints[0] - 1] = self.own_columns(values_of(robot, motion, self.links))
        return columns

    def own_columns(self, values: Callable[[Axis], Array]) -> Array:
        """(N, p) the same in the joint alone, from the (N,) values of each axis' variable."""
        return np.column_stack([component.columns(values) for component in self.components])

    def change_by_joint(self, scene: Scene) -> tuple[dict[int, Array], dict[int, Array]]:
        """Of the joint."""
        return {}, {self.joints[0] - 1: self.own_columns(values_of(scene.robot, scene.motion, self.links))}
