"""Terms of the dynamic model: tau = sum over terms of Y_term(motion) theta_term.

Everything downstream uses columns and cones alone, not the physics of a term.
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
            InputError: the term has numbers that only a comparison with a log can show.
        """
        numbers = cls.number_fields()
        if missing := [key for key, number in numbers.items() if number.of_motion is None]:
            message = f"{cls.name} needs a log to determine {', '.join(missing)}"
            raise InputError(message, field="terms", remedy="find it with `bayesid discrepancy`")
        shape: Any = {key: tuple(one.of_motion(actuators).tolist()) for key, one in numbers.items() if one.of_motion}
        return cls(**shape)

    @property
    def payloads(self) -> tuple[str, ...]:
        """Labels of the payloads in whose rows alone it acts; of most terms none."""
        return ()

    @property
    def places(self) -> Mapping[str, tuple[str, ...]]:
        """Where exported files keep its parameters: by the format (urdf, mjcf), one key for each one of a joint."""
        return {}

    def export_remark(self, last_link: str) -> str:
        """What an exported file says of it at its head, given the last link's name there."""
        return ""

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(N, n, p) columns Y: actuator efforts, N m, per unit of each parameter."""
        raise NotImplementedError

    def effort(self, robot: Robot, motion: Motion, theta: Array) -> Array:
        """(N, n) efforts by its parameters theta (p,), N m, where columns need not be made."""
        effort: Array = self.columns(robot, motion) @ theta
        return effort

    def link_parameters(self, robot: Robot, theta: Array) -> Array:
        """(n, 10) what its parameters theta (p,) add to those of the links."""
        return np.zeros((robot.n_joints, 10))

    def change(self, scene: Scene) -> tuple[Array, Array]:
        return np.zeros(scene.effort.shape), self.columns(scene.robot, scene.motion)


class ActuatorTerm(Term):
    """Base of the effects that act in each actuator by itself: `coefficients` and `unit_efforts` say which."""

    coefficients: ClassVar[tuple[Coefficient, ...]]
    """The k parameters of an actuator."""

    def unit_efforts(self, actuators: Motion) -> Array | Sequence[Array]:
        """(N, m) effort that its m actuators supply per unit of the parameter, from their motion; k of them, in order.

        Of actuators (u = C q), not joints: a coupled wrist needs no special case.
        """
        raise NotImplementedError

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        numbers = cls.number_fields()
        for j, motion in enumerate(scene.each, start=1):
            tried = [(one.tried or one.of_motion or _untold)(motion) for one in numbers.values()]
            for values in product(*tried):
                shape: Any = {key: (float(value),) for key, value in zip(numbers, values, strict=True)}
                yield cls(joints=(j,), **shape)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return tuple(one.of_joint(robot, j) for j in self.acting(robot.n_joints) for one in self.coefficients)

    def cone(self, robot: Robot) -> Cone:
        signs = [one.nonnegative for one in self.coefficients] * len(self.acting(robot.n_joints))
        return replace(Cone.free(len(signs)), nonnegative=np.flatnonzero(signs))

    @property
    def adds_to(self) -> Mapping[str, str]:
        return {one.symbol: one.adds_to for one in self.coefficients if one.adds_to}

    @property
    def places(self) -> Mapping[str, tuple[str, ...]]:
        places = {form: tuple(getattr(one, form) for one in self.coefficients) for form in ("urdf", "mjcf")}
        return {form: keys for form, keys in places.items() if all(keys)}

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(N, n, m k) columns of its m actuators: k in an actuator's own row."""
        own, acting = self.own_columns(robot, motion), self.acting(robot.n_joints)
        columns = np.zeros((len(motion), robot.n_joints, len(acting), own.shape[2]))
        columns[:, acting, np.arange(len(acting))] = own
        return columns.reshape(len(motion), robot.n_joints, -1)

    def effort(self, robot: Robot, motion: Motion, theta: Array) -> Array:
        own = self.own_columns(robot, motion)
        efforts = (own * theta.reshape(-1, own.shape[2])).sum(axis=2)
        if not self.joints:
            return efforts
        every = np.zeros((len(motion), robot.n_joints))
        every[:, self.acting(robot.n_joints)] = efforts
        return every

    def own_columns(self, robot: Robot, motion: Motion, own: Motion | None = None) -> Array:
        """(N, m, k) the same without the rows of other actuators; of `own`, the motion of its actuators, if known."""
        if own is None:
            own = robot.actuators(motion)
            own = own.joints(self.acting(robot.n_joints)) if self.joints else own
        efforts = self.unit_efforts(own)
        return efforts[:, :, None] if isinstance(efforts, np.ndarray) else np.stack(efforts, axis=2)

    def change_by_joint(self, scene: Scene) -> tuple[dict[int, Array], dict[int, Array]]:
        """Of one actuator, without the rows of others; of several as usual."""
        if len(self.acting(scene.robot.n_joints)) > 1:
            return super().change_by_joint(scene)
        (joint,) = self.acting(scene.robot.n_joints)
        own = self.own_columns(scene.robot, scene.motion, scene.each[joint])[:, 0]
        return {}, {joint: own} if np.any(own) else {}


def _untold(actuators: Motion) -> Array:
    raise NotImplementedError("a number needs `tried` or `of_motion`, or the effect `variants` of its own")


class WholeRobotTerm(Term):
    """Base of the effects that are the whole robot's."""

    acts_on = "robot"

    @classmethod
    def variants(cls, scene: Scene) -> Iterable[Self]:
        """One; none of what no model lacks."""
        return (cls(),) if cls.can_be_missing else ()
