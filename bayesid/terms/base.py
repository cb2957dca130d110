"""What a term of the dynamic model is.

tau = sum over terms of Y_term(motion) theta_term. Everything downstream works on columns and cones alone; it never asks
which physics a column stands for. A new effect is a new file beside this one and an entry in `bayesid.terms.CATALOGUE`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol, Self, runtime_checkable

import numpy as np

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


@runtime_checkable
class Term(Protocol):
    """One physical effect that is linear in its parameters."""

    @property
    def name(self) -> str:
        """The effect's name in the catalogue."""

    @property
    def physics(self) -> str:
        """One sentence: what happens, and where the equation comes from."""

    @property
    def shape(self) -> Mapping[str, list[float]]:
        """The nonlinear numbers that the columns depend on (a Stribeck velocity); what model.toml keeps of the term."""

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """The p parameters, in the order of the columns."""

    def cone(self, robot: Robot) -> Cone:
        """The cone of the p parameters."""

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(N, n, p) columns Y: actuator efforts, N m, per unit of each parameter."""


class ActuatorTerm:
    """Base of the effects that act in each actuator by itself, with one parameter each: diagonal columns."""

    name: ClassVar[str]
    physics: ClassVar[str]
    symbol: ClassVar[str]
    units: ClassVar[tuple[str, str]]  # of a joint that turns, of one that slides
    nonnegative: ClassVar[bool] = False

    @classmethod
    def for_motion(cls, actuators: Motion) -> Self:
        """The term for a log with this motion of its actuators; a subclass with a shape takes it from there."""
        return cls()

    @property
    def shape(self) -> Mapping[str, list[float]]:
        """No nonlinear numbers, unless a subclass has some."""
        return {}

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """One parameter an actuator."""
        joints = enumerate(robot.joints, start=1)
        return tuple(Parameter(f"{self.symbol}{j}", self.units[joint.prismatic], j) for j, joint in joints)

    def cone(self, robot: Robot) -> Cone:
        """Free or nonnegative, all alike."""
        return Cone.orthant(robot.n_joints) if self.nonnegative else Cone.free(robot.n_joints)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(N, n, n) diagonal columns, `effect` on the diagonal."""
        actuators = robot.actuators(motion)
        n = robot.n_joints
        columns = np.zeros((len(motion), n, n))
        columns[:, np.arange(n), np.arange(n)] = self.effect(actuators)
        return columns

    def effect(self, actuators: Motion) -> Array:
        """(N, n) effort per unit of each actuator's parameter, from the motion in actuator coordinates."""
        raise NotImplementedError
