"""What a term of the dynamic model is.

tau = sum over terms of Y_term(motion) theta_term. Everything downstream works on columns and cones alone; it never asks
which physics a column stands for. A new effect is a new file beside this one; `bayesid.terms.CATALOGUE` finds it there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from typing import ClassVar, Protocol, Self, runtime_checkable

import numpy as np

from bayesid.errors import InputError
from bayesid.inertia import PSEUDO_INERTIA_BASIS
from bayesid.motion import Array, Integers, Motion
from bayesid.robot import Robot


@dataclass(frozen=True)
class Parameter:
    """One parameter of a term: its name (unique in a model), unit, and 1-based joint or link."""

    name: str
    unit: str
    joint: int


@dataclass(frozen=True)
class Cone:
    """Where parameters may lie: some nonnegative, some blocks of ten with a positive semidefinite pseudo-inertia.

    Attributes:
        size: number of parameters; those not mentioned below are free.
        nonnegative: indices of the parameters that must be >= 0.
        bodies: (b, 10) indices of the blocks that are a body's parameters (`bayesid.inertia`).
    """

    size: int
    nonnegative: Integers
    bodies: Integers

    @classmethod
    def free(cls, size: int) -> Cone:
        """No constraint."""
        return cls(size, np.empty(0, dtype=np.int64), np.empty((0, 10), dtype=np.int64))

    @classmethod
    def orthant(cls, size: int) -> Cone:
        """Every parameter nonnegative."""
        return cls(size, np.arange(size), np.empty((0, 10), dtype=np.int64))

    @classmethod
    def rigid_bodies(cls, count: int) -> Cone:
        """`count` bodies of ten parameters each."""
        return cls(10 * count, np.empty(0, dtype=np.int64), np.arange(10 * count).reshape(count, 10))

    def __add__(self, other: Cone) -> Cone:
        """The product cone, `other`'s parameters after this one's."""
        return Cone(
            self.size + other.size,
            np.concatenate([self.nonnegative, other.nonnegative + self.size]),
            np.concatenate([self.bodies, other.bodies + self.size]),
        )

    def pseudo_inertias(self, theta: Array) -> Array:
        """(b, 4, 4) pseudo-inertias of the bodies in theta (size,)."""
        return np.einsum("bk,kij->bij", theta[self.bodies], PSEUDO_INERTIA_BASIS)

    def smallest_eigenvalues(self, theta: Array) -> Array:
        """(b,) smallest eigenvalue of each body's pseudo-inertia (mixed units, as usual; its sign is what counts)."""
        return np.asarray(np.linalg.eigvalsh(self.pseudo_inertias(theta))[:, 0], dtype=np.float64)

    def contains(self, theta: Array, tolerance: float = 0.0) -> bool:
        """Whether theta (size,) lies in the cone, up to `tolerance`."""
        return bool(
            np.all(theta[self.nonnegative] >= -tolerance) and np.all(self.smallest_eigenvalues(theta) >= -tolerance)
        )


@dataclass(frozen=True)
class Scene:
    """What an effect may look at to say in which forms it could be hidden in a log.

    Attributes:
        robot: the robot.
        motion: N samples of its joints.
        actuators: the same in actuator coordinates.
        effort: (N, n) the current model's effort, N m.
        measured: (N, n) absolute values of the measured efforts, N m.
        links: (10 n,) the current model's link parameters.
        effort_with: the current model's effort (N, n) of a robot that is mounted otherwise.
    """

    robot: Robot
    motion: Motion
    actuators: Motion
    effort: Array
    measured: Array
    links: Array
    effort_with: Callable[[Robot], Array]


@runtime_checkable
class Term(Protocol):
    """One physical effect that is linear in its parameters."""

    name: ClassVar[str]
    """In the catalogue; a second form of the same effect is named effect.form."""
    physics: ClassVar[str]
    """One sentence: what happens."""
    reference: ClassVar[str]
    """Where the equation comes from."""
    variable: ClassVar[str]
    """Over what the effect shows best: velocity, position, acceleration, load or time."""
    told_by: ClassVar[str]
    """The motion that tells it from others."""
    memory: ClassVar[bool]
    """Whether a row depends on earlier instants too."""

    @property
    def shape(self) -> Mapping[str, list[float]]:
        """The nonlinear numbers that the columns depend on (a Stribeck velocity); what model.toml keeps of the term."""

    @property
    def joints(self) -> tuple[int, ...]:
        """The actuators (from 1) in which it acts; none named: in all."""

    @classmethod
    def variants(cls, scene: Scene) -> Iterable[Self]:
        """The forms in which the effect may be hidden in a log: joint by joint, and over its nonlinear numbers."""

    def check(self, n_joints: int) -> None:
        """Raises ValueError if the term's numbers do not suit a robot of n joints."""

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """The p parameters, in the order of the columns."""

    def cone(self, robot: Robot) -> Cone:
        """The cone of the p parameters."""

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(N, n, p) columns Y: actuator efforts, N m, per unit of each parameter."""


@dataclass(frozen=True, kw_only=True)
class ActuatorTerm:
    """Base of the effects that act in each actuator by itself.

    A subclass is a frozen dataclass; its fields are its shape, tuples with one number an actuator.

    Args:
        joints: the actuators (from 1) in which it acts; all of them if empty.
    """

    joints: tuple[int, ...] = ()

    name: ClassVar[str]
    physics: ClassVar[str]
    reference: ClassVar[str]
    variable: ClassVar[str]
    told_by: ClassVar[str]
    symbols: ClassVar[tuple[str, ...]]
    """Of the k parameters of an actuator."""
    units: ClassVar[tuple[tuple[str, str], ...]]
    """Of each parameter: in a joint that turns, and in one that slides."""
    shape_units: ClassVar[Mapping[str, str]] = {}
    """Of the nonlinear numbers that people want to know."""
    nonnegative: ClassVar[bool] = False
    memory: ClassVar[bool] = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", tuple(int(j) for j in self.joints))

    @classmethod
    def for_motion(cls, actuators: Motion) -> Self:
        """The term in all actuators for a log with this motion.

        Raises:
            InputError: the term has a shape that only a comparison with a log can tell.
        """
        if any(one.name != "joints" for one in fields(cls)):
            said, remedy = f"{cls.name} has a shape of its own", "have `bayesid discrepancy` find it"
            raise InputError(said, "--terms", remedy)
        return cls()

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

    @property
    def shape(self) -> Mapping[str, list[float]]:
        """The fields of the dataclass; `joints` only if they are named."""
        values = {one.name: list(getattr(self, one.name)) for one in fields(self)}
        return {key: value for key, value in values.items() if key != "joints" or value}

    def check(self, n_joints: int) -> None:
        """One number of each shape an actuator."""
        own = self.own(n_joints)
        if len(set(own)) < len(own) or not all(0 <= j < n_joints for j in own):
            raise ValueError(f"joints {list(self.joints)} are not joints of the robot")
        for key, values in self.shape.items():
            if key != "joints" and len(values) != len(own):
                raise ValueError(f"{key} has {len(values)} numbers for {len(own)} joints")

    def own(self, n_joints: int) -> list[int]:
        """The (0-based) actuators in which it acts."""
        return [j - 1 for j in self.joints] or list(range(n_joints))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """As many an actuator as it has symbols, actuator by actuator."""
        return tuple(
            Parameter(f"{symbol}{j + 1}", unit[robot.joints[j].prismatic], j + 1)
            for j in self.own(robot.n_joints)
            for symbol, unit in zip(self.symbols, self.units, strict=True)
        )

    def cone(self, robot: Robot) -> Cone:
        """Free or nonnegative, all alike."""
        size = len(self.own(robot.n_joints)) * len(self.symbols)
        return Cone.orthant(size) if self.nonnegative else Cone.free(size)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(N, n, m k) columns of its m actuators: k in an actuator's own row."""
        own, k = self.own(robot.n_joints), len(self.symbols)
        effect = self.effect(robot.actuators(motion).joints(own))
        effect = effect[:, :, None] if effect.ndim == 2 else effect
        columns = np.zeros((len(motion), robot.n_joints, len(own) * k))
        for i, j in enumerate(own):
            columns[:, j, i * k : (i + 1) * k] = effect[:, i]
        return columns

    def effect(self, actuators: Motion) -> Array:
        """(N, m) or (N, m, k) effort per unit of each parameter, from the motion of the term's own m actuators."""
        raise NotImplementedError


class WholeRobotTerm:
    """Base of the effects that are the whole robot's: no joints, no nonlinear numbers."""

    memory: ClassVar[bool] = False

    @classmethod
    def for_motion(cls, actuators: Motion) -> Self:
        """The same for every log."""
        return cls()

    @classmethod
    def variants(cls, scene: Scene) -> Iterable[Self]:
        """One."""
        return (cls(),)

    @property
    def joints(self) -> tuple[int, ...]:
        """It acts on all of them."""
        return ()

    @property
    def shape(self) -> Mapping[str, list[float]]:
        """No nonlinear numbers."""
        return {}

    def check(self, n_joints: int) -> None:
        """Suits every robot."""
