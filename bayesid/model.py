"""A dynamic model: a robot and the sum of terms that makes its actuator efforts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np

from bayesid.motion import Array, Motion
from bayesid.robot import Robot
from bayesid.terms.base import Cone, Parameter, Term

CHUNK = 4096
"""Samples whose columns are in memory at once."""


@dataclass(frozen=True)
class Model:
    """efforts = Y(motion) theta, theta in a cone.

    Attributes:
        robot: the robot.
        terms: the terms; their parameters are stacked in this order.
    """

    robot: Robot
    terms: tuple[Term, ...]

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The P parameters of all terms."""
        return tuple(parameter for term in self.terms for parameter in term.parameters(self.robot))

    @cached_property
    def cone(self) -> Cone:
        """The product of the terms' cones."""
        return reduce(lambda total, term: total + term.cone(self.robot), self.terms, Cone.free(0))

    def extend(self, term: Term) -> Model:
        """A new model with one more term."""
        return Model(self.robot, (*self.terms, term))

    def columns(self, motion: Motion) -> Array:
        """(N, n, P) columns of all terms, N m per unit of each parameter."""
        return np.concatenate([term.columns(self.robot, motion) for term in self.terms], axis=2)

    def chunks(self, motion: Motion) -> Iterator[tuple[slice, Array]]:
        """Rows and their columns, at most CHUNK samples at a time."""
        for start in range(0, len(motion), CHUNK):
            rows = slice(start, min(start + CHUNK, len(motion)))
            yield rows, self.columns(motion[rows])

    def effort(self, motion: Motion, theta: Array) -> Array:
        """(N, n) actuator efforts, N m, of the parameters theta (P,)."""
        return np.concatenate([columns @ theta for _, columns in self.chunks(motion)])
