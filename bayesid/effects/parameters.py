"""Parameters of a model and of an actuator, and the cone in which they may lie."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.effects.constraints import Constraints
from bayesid.effects.plane import Plane
from bayesid.robot import Robot
from bayesid.robot.inertia import PSEUDO_INERTIA_BASIS


@dataclass(frozen=True)
class Parameter:
    """One parameter of a term: its name (unique in a model), unit, and 1-based joint or link."""

    name: str
    unit: str
    joint: int


@dataclass(frozen=True)
class Coefficient:
    """One of the parameters that an effect has in each actuator.

    Attributes:
        symbol: unique name without the joint; after a digit it ends in `_`.
        unit: in a revolute joint; in a prismatic one N m becomes N, and rad m.
        nonnegative: whether it cannot be negative.
        adds_to: symbol of the parameter of another effect that it adds to, where a model has it.
        urdf: key under which a URDF keeps it, if any.
        mjcf: the same in an MJCF.
    """

    symbol: str
    unit: str
    nonnegative: bool = False
    adds_to: str = ""
    urdf: str = ""
    mjcf: str = ""

    def of_joint(self, robot: Robot, joint: int) -> Parameter:
        """The parameter of a (0-based) joint."""
        return Parameter(f"{self.symbol}{joint + 1}", unit_of(robot, joint, self.unit), joint + 1)


def unit_of(robot: Robot, joint: int, unit: str) -> str:
    """The unit for a (0-based) joint, given that for a revolute joint."""
    sliding = robot.joints[joint].prismatic
    return unit.replace("N m", "N").replace("kg m^2", "kg").replace("rad", "m") if sliding else unit


@dataclass(frozen=True)
class Cone:
    """Where parameters may lie: some nonnegative, some blocks of ten with a positive semidefinite pseudo-inertia.

    Attributes:
        size: number of parameters; those not mentioned below are free.
        nonnegative: indices of the parameters that must be >= 0.
        bodies: (b, 10) indices of the blocks that are a body's parameters (`bayesid.robot.inertia`).
        stated: further constraints on the parameters, or None. With them the set is not a cone: scaling may leave it.
    """

    size: int
    nonnegative: Integers
    bodies: Integers
    stated: Constraints | None = None

    @classmethod
    def free(cls, size: int) -> Cone:
        return cls(size, np.empty(0, dtype=np.int64), np.empty((0, 10), dtype=np.int64))

    @classmethod
    def orthant(cls, size: int) -> Cone:
        return cls(size, np.arange(size), np.empty((0, 10), dtype=np.int64))

    @classmethod
    def rigid_bodies(cls, count: int) -> Cone:
        """`count` bodies of ten parameters each."""
        return cls(10 * count, np.empty(0, dtype=np.int64), np.arange(10 * count).reshape(count, 10))

    def __add__(self, other: Cone) -> Cone:
        """The product cone, `other`'s parameters after this one's; without stated constraints."""
        return Cone(
            self.size + other.size,
            np.concatenate([self.nonnegative, other.nonnegative + self.size]),
            np.concatenate([self.bodies, other.bodies + self.size]),
        )

    def plane(self, sizes: Array | None = None) -> Plane:
        """The plane of the stated equalities, in units of sizes (size,) if given."""
        return Plane.whole(self.size) if self.stated is None else self.stated.plane(sizes)

    def pseudo_inertias(self, theta: Array) -> Array:
        """(b, 4, 4) pseudo-inertias of the bodies in theta (size,)."""
        return np.einsum("bk,kij->bij", theta[self.bodies], PSEUDO_INERTIA_BASIS)

    def smallest_eigenvalues(self, theta: Array) -> Array:
        """(b,) smallest eigenvalue of each body's pseudo-inertia (mixed units, as usual; its sign is what counts)."""
        return np.asarray(np.linalg.eigvalsh(self.pseudo_inertias(theta))[:, 0], dtype=np.float64)

    def contains(self, theta: Array, tolerance: float = 0.0) -> bool:
        """Whether theta (size,) lies in the cone and satisfies what is stated, up to `tolerance`."""
        return bool(
            np.all(theta[self.nonnegative] >= -tolerance)
            and np.all(self.smallest_eigenvalues(theta) >= -tolerance)
            and (self.stated is None or self.stated.contains(theta, tolerance))
        )
