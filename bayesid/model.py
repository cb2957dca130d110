"""A dynamic model: a robot, the sum of terms that makes its actuator efforts, and what distorts them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce

import numpy as np

from bayesid.distortions.base import Distortion
from bayesid.motion import Array, Mask, Motion
from bayesid.robot import Robot
from bayesid.terms.base import Cone, Parameter, Term

CHUNK = 4096
"""Samples whose columns are in memory at once."""
_LOOK_BACK, _LOOK_AHEAD = 4096, 16
"""Samples around a chunk that effects with a memory see."""


@dataclass(frozen=True)
class Model:
    """efforts = D(Y(motion) theta), theta in a cone (:eq:`model`); D is the identity without distortions.

    Attributes:
        robot: the robot.
        terms: the terms; their parameters are stacked in this order.
        distortions: of rows first, of readings last; each acts on what those of its kind before it have made.
    """

    robot: Robot
    terms: tuple[Term, ...]
    distortions: tuple[Distortion, ...] = ()

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
        return replace(self, terms=(*self.terms, term))

    def distort(self, distortion: Distortion) -> Model:
        """A new model with one more distortion."""
        return replace(self, distortions=(*self.distortions, distortion))

    @property
    def before_sensors(self) -> Model:
        """The model of the efforts themselves, without what sensors make of them."""
        return replace(self, distortions=tuple(one for one in self.distortions if not one.of_sensor))

    def columns(self, motion: Motion) -> Array:
        """(N, n, P) columns of all terms, rows distorted, N m per unit of each parameter."""
        rows: Callable[[Robot, Motion], Array] = self._plain_columns
        for distortion in self.distortions:
            rows = partial(distortion.columns, rows)
        return rows(self.robot, motion)

    def chunks(self, motion: Motion) -> Iterator[tuple[slice, Array]]:
        """Rows and their columns, at most CHUNK samples at a time; effects with a memory see some samples around."""
        memory = any(term.memory for term in self.terms) or any(one.memory for one in self.distortions)
        for start in range(0, len(motion), CHUNK):
            rows = slice(start, min(start + CHUNK, len(motion)))
            first = max(0, start - _LOOK_BACK) if memory else start
            last = min(len(motion), rows.stop + _LOOK_AHEAD) if memory else rows.stop
            yield rows, self.columns(motion[first:last])[start - first : rows.stop - first]

    def effort(self, motion: Motion, theta: Array) -> Array:
        """(N, n) actuator efforts as they are read, N m, of the parameters theta (P,)."""
        return self.read(np.concatenate([columns @ theta for _, columns in self.chunks(motion)]))

    def read(self, effort: Array) -> Array:
        """(N, n) what sensors read of efforts (N, n), N m."""
        return reduce(lambda read, distortion: distortion.measured(read), self.distortions, effort)

    def unread(self, magnitude: Array) -> tuple[Array, Mask]:
        """(N, n) absolute efforts before the sensors' doing, N m, and (N, n) where the readings tell them."""
        told = np.ones(magnitude.shape, dtype=bool)
        for distortion in reversed(self.distortions):
            magnitude, tells = distortion.restored(magnitude)
            told &= tells
        return magnitude, told

    def _plain_columns(self, robot: Robot, motion: Motion) -> Array:
        return np.concatenate([term.columns(robot, motion) for term in self.terms], axis=2)
