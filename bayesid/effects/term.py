"""Terms of the dynamic model: tau = sum over terms of Y_term(motion) theta_term.

Other code uses only the columns and cones of a term, not its physics.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, ClassVar, Self

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Effect, Scene
from bayesid.effects.parameters import Coefficient, Cone, Parameter
from bayesid.errors import InputError
from bayesid.motion import Motion
from bayesid.robot import Robot


class Term(Effect):
    """An effect that is linear in its parameters."""

    linear = True
    of_links: ClassVar[bool] = False
    """Whether its parameters are inertial ones that add to those of links."""

    @classmethod
    def for_motion(cls, actuators: Motion) -> Self:
        """The term in all actuators, for a log with this motion.

        Raises:
            InputError: the term has numbers that must be fitted to a log.
        """
        numbers = cls.number_fields()
        if missing := [key for key, number in numbers.items() if number.of_motion is None]:
            message = f"{cls.name} needs a log to determine {', '.join(missing)}"
            raise InputError(message, field="terms", remedy="find it with `bayesid discrepancy`")
        shape: Any = {
            key: tuple(number.of_motion(actuators).tolist()) for key, number in numbers.items() if number.of_motion
        }
        return cls(**shape)

    @property
    def payloads(self) -> tuple[str, ...]:
        """Labels of the payloads in whose rows it acts; empty for most terms."""
        return ()

    @property
    def places(self) -> Mapping[str, tuple[str, ...]]:
        """Keys of a joint's parameters in exported files, by format (urdf, mjcf)."""
        return {}

    def export_remark(self, last_link: str) -> str:
        """Comment at the head of an exported file, given the last link's name."""
        return ""

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(N, n, p) columns Y: actuator efforts, N m, per unit of each parameter."""
        raise NotImplementedError

    def effort(self, robot: Robot, motion: Motion, theta: Array) -> Array:
        """(N, n) efforts by its parameters theta (p,), N m."""
        effort: Array = self.columns(robot, motion) @ theta
        return effort

    def link_parameters(self, robot: Robot, theta: Array) -> Array:
        """(n, 10) contribution of its parameters theta (p,) to those of the links."""
        return np.zeros((robot.n_joints, 10))

    def change(self, scene: Scene) -> tuple[Array, Array]:
        return np.zeros(scene.effort.shape), self.columns(scene.robot, scene.motion)


class ActuatorTerm(Term):
    """Base of effects that act in single actuators, as `coefficients` and `unit_efforts` define."""

    coefficients: ClassVar[tuple[Coefficient, ...]]
    """The k parameters of an actuator."""

    def unit_efforts(self, actuators: Motion) -> Array | Sequence[Array]:
        """(N, m) efforts of its m actuators per unit of the parameter, from their motion; k arrays for k parameters.

        Actuators (u = C q), not joints: a coupled wrist needs no special case.
        """
        raise NotImplementedError

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        numbers = cls.number_fields()
        for j, motion in enumerate(scene.each, start=1):
            tried = [(number.tried or number.of_motion or _no_values)(motion) for number in numbers.values()]
            for values in product(*tried):
                shape: Any = {key: (float(value),) for key, value in zip(numbers, values, strict=True)}
                yield cls(joints=(j,), **shape)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return tuple(
            coefficient.of_joint(robot, j) for j in self.acting(robot.n_joints) for coefficient in self.coefficients
        )

    def cone(self, robot: Robot) -> Cone:
        signs = [coefficient.nonnegative for coefficient in self.coefficients] * len(self.acting(robot.n_joints))
        return replace(Cone.free(len(signs)), nonnegative=np.flatnonzero(signs))

    @property
    def adds_to(self) -> Mapping[str, str]:
        return {coefficient.symbol: coefficient.adds_to for coefficient in self.coefficients if coefficient.adds_to}

    @property
    def places(self) -> Mapping[str, tuple[str, ...]]:
        places = {
            form: tuple(getattr(coefficient, form) for coefficient in self.coefficients) for form in ("urdf", "mjcf")
        }
        return {form: keys for form, keys in places.items() if all(keys)}

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(N, n, m k) columns of its m actuators: k in an actuator's own row."""
        values, acting = self.own_columns(robot, motion), self.acting(robot.n_joints)
        columns = np.zeros((len(motion), robot.n_joints, len(acting), values.shape[2]))
        columns[:, acting, np.arange(len(acting))] = values
        return columns.reshape(len(motion), robot.n_joints, -1)

    def effort(self, robot: Robot, motion: Motion, theta: Array) -> Array:
        values = self.own_columns(robot, motion)
        efforts = (values * theta.reshape(-1, values.shape[2])).sum(axis=2)
        if not self.joints:
            return efforts
        every = np.zeros((len(motion), robot.n_joints))
        every[:, self.acting(robot.n_joints)] = efforts
        return every

    def own_columns(self, robot: Robot, motion: Motion, actuators: Motion | None = None) -> Array:
        """(N, m, k) columns of its m actuators in their own rows, from their motion if given."""
        if actuators is None:
            actuators = robot.actuators(motion)
            actuators = actuators.joints(self.acting(robot.n_joints)) if self.joints else actuators
        efforts = self.unit_efforts(actuators)
        return efforts[:, :, None] if isinstance(efforts, np.ndarray) else np.stack(efforts, axis=2)

    def change_by_joint(self, scene: Scene) -> tuple[dict[int, Array], dict[int, Array]]:
        """For a single actuator, computed without the rows of others."""
        if len(self.acting(scene.robot.n_joints)) > 1:
            return super().change_by_joint(scene)
        (joint,) = self.acting(scene.robot.n_joints)
        columns = self.own_columns(scene.robot, scene.motion, scene.each[joint])[:, 0]
        return {}, {joint: columns} if np.any(columns) else {}


def _no_values(actuators: Motion) -> Array:
    raise NotImplementedError("a number needs `tried` or `of_motion`, or the effect `variants` of its own")


class WholeRobotTerm(Term):
    """Base of effects of the whole robot."""

    acts_on = "robot"

    @classmethod
    def variants(cls, scene: Scene) -> Iterable[Self]:
        """One form, or none if every model has the effect."""
        return (cls(),) if cls.can_be_missing else ()
