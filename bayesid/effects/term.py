"""What a term of the dynamic model is.

tau = sum over terms of Y_term(motion) theta_term. Everything downstream works on columns and cones alone; it never asks
which physics a column stands for.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Self

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.effects.effect import Effect, Scene
from bayesid.effects.parameters import Cone, Parameter
from bayesid.errors import InputError
from bayesid.motion import Motion
from bayesid.robot import Robot


@dataclass(frozen=True, kw_only=True)
class Term(Effect):
    """An effect that is linear in its parameters."""

    of_links: ClassVar[bool] = False
    """Whether its parameters are inertial ones that add to those of links."""
    links_remark: ClassVar[str] = ""
    """What an exported file says of it at its head; {last} is the last link."""
    places: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    """Where exported files keep its parameters: by the format (urdf, mjcf), one key for each parameter of a joint."""

    @classmethod
    def for_motion(cls, actuators: Motion) -> Self:
        """The term in all actuators, for a log with this motion.

        Raises:
            InputError: the term has numbers that only a comparison with a log can show.
        """
        shape = cls.shape_of_motion(actuators)
        if missing := [field.name for field in fields(cls) if field.name not in ("joints", *shape)]:
            message = f"{cls.name} has numbers that no motion shows ({', '.join(missing)})"
            raise InputError(message, field="terms", remedy="have `bayesid discrepancy` find it")
        arguments: dict[str, Any] = dict(shape)
        return cls(**arguments)

    @property
    def payloads(self) -> tuple[str, ...]:
        """Labels of the payloads in whose rows alone it acts; of most terms none."""
        return ()

    @classmethod
    def shape_of_motion(cls, actuators: Motion) -> Mapping[str, tuple[float, ...]]:
        """The nonlinear numbers that a motion shows, by field, one an actuator."""
        return {}

    def cone(self, robot: Robot) -> Cone:
        """The cone of the p parameters."""
        raise NotImplementedError

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(N, n, p) columns Y: actuator efforts, N m, per unit of each parameter."""
        raise NotImplementedError

    def fill(self, columns: Array, robot: Robot, motion: Motion) -> None:
        """Writes `columns` into zeros (N, n, p)."""
        columns[:] = self.columns(robot, motion)

    def effort(self, robot: Robot, motion: Motion, theta: Array) -> Array:
        """(N, n) efforts by its parameters theta (p,), N m, where columns need not be made."""
        effort: Array = self.columns(robot, motion) @ theta
        return effort

    def link_parameters(self, robot: Robot, theta: Array) -> Array:
        """(n, 10) what its parameters theta (p,) add to those of the links."""
        return np.zeros((robot.n_joints, 10))

    def one_sided(self, robot: Robot) -> Integers:
        """Indices of the parameters that cannot be negative."""
        return self.cone(robot).nonnegative

    def change(self, scene: Scene) -> tuple[Array, Array]:
        """No change by itself, and the columns."""
        return np.zeros(scene.effort.shape), self.columns(scene.robot, scene.motion)


@dataclass(frozen=True, kw_only=True)
class ActuatorTerm(Term):
    """Base of the effects that act in each actuator by itself."""

    symbols: ClassVar[tuple[str, ...]]
    """Of the k parameters of an actuator."""
    units: ClassVar[tuple[tuple[str, str], ...]]
    """Of each parameter: in a joint that turns, and in one that slides."""
    nonnegative: ClassVar[bool] = False

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """In each actuator by itself, over its shapes."""
        for j in range(1, scene.robot.n_joints + 1):
            for shape in cls.shapes(scene, j - 1):
                yield cls(joints=(j,), **{key: (value,) for key, value in shape.items()})

    @classmethod
    def shapes(cls, scene: Scene, joint: int) -> Iterable[Mapping[str, float]]:
        """Shapes worth trying in a (0-based) joint: one, without numbers, unless a subclass has some."""
        return ({},)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """As many an actuator as it has symbols, actuator by actuator."""
        return tuple(
            Parameter(f"{symbol}{j + 1}", unit[robot.joints[j].prismatic], j + 1)
            for j in self.acting(robot.n_joints)
            for symbol, unit in zip(self.symbols, self.units, strict=True)
        )

    def cone(self, robot: Robot) -> Cone:
        """Free or nonnegative, all alike."""
        size = len(self.acting(robot.n_joints)) * len(self.symbols)
        return Cone.orthant(size) if self.nonnegative else Cone.free(size)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(N, n, m k) columns of its m actuators: k in an actuator's own row."""
        columns = np.zeros((len(motion), robot.n_joints, len(self.acting(robot.n_joints)) * len(self.symbols)))
        self.fill(columns, robot, motion)
        return columns

    def fill(self, columns: Array, robot: Robot, motion: Motion) -> None:
        """Writes them into zeros."""
        own = self.own_columns(robot, motion)
        k = own.shape[2]
        for i, j in enumerate(self.acting(robot.n_joints)):
            columns[:, j, i * k : (i + 1) * k] = own[:, i]

    def effort(self, robot: Robot, motion: Motion, theta: Array) -> Array:
        """(N, n) efforts: each actuator's own columns."""
        own = self.own_columns(robot, motion)
        k = own.shape[2]
        efforts = own[:, :, 0] * theta if k == 1 else (own * theta.reshape(-1, k)).sum(axis=2)
        if not self.joints:
            return efforts
        every = np.zeros((len(motion), robot.n_joints))
        every[:, self.acting(robot.n_joints)] = efforts
        return every

    def own_columns(self, robot: Robot, motion: Motion) -> Array:
        """(N, m, k) the same without the rows of other actuators."""
        actuators = robot.actuators(motion)
        return self._of_each(actuators.joints(self.acting(robot.n_joints)) if self.joints else actuators)

    def own_columns_in(self, scene: Scene, joint: int) -> Array:
        """(N, k) the same in one (0-based) actuator of a scene, the only one in which it acts."""
        return self._of_each(scene.actuator(joint))[:, 0]

    def _of_each(self, actuators: Motion) -> Array:
        """(N, m, k) efforts, whichever shape they are given in."""
        efforts = self.unit_efforts(actuators)
        return efforts[:, :, None] if efforts.ndim == 2 else efforts

    def change_by_joint(self, scene: Scene) -> tuple[dict[int, Array], dict[int, Array]]:
        """Of one actuator, without the rows of others; of several as usual."""
        if len(self.acting(scene.robot.n_joints)) > 1:
            return super().change_by_joint(scene)
        (joint,) = self.acting(scene.robot.n_joints)
        own = self.own_columns_in(scene, joint)
        return {}, {joint: own} if np.any(own) else {}

    def unit_efforts(self, actuators: Motion) -> Array:
        """(N, m) or (N, m, k) effort per unit of each parameter, from the motion of the term's own m actuators."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class WholeRobotTerm(Term):
    """Base of the effects that are the whole robot's."""

    by_joint: ClassVar[bool] = False
    whole_robot: ClassVar[bool] = True

    @classmethod
    def variants(cls, scene: Scene) -> Iterable[Self]:
        """One."""
        return (cls(),)
