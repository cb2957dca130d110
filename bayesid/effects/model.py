"""A dynamic model: a robot, a sum of terms for its actuator efforts, and distortions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce
from itertools import pairwise
from weakref import ref

import numpy as np

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects.constraints import Constraints
from bayesid.effects.distortion import Distortion, Rows, SensorDistortion
from bayesid.effects.effect import Effect, Scene
from bayesid.effects.parameters import Cone, Parameter
from bayesid.effects.term import Term
from bayesid.effects.tuning import TUNING
from bayesid.motion import Motion
from bayesid.parallel import in_parallel, processors
from bayesid.robot import Robot


@dataclass(frozen=True)
class SparseColumns:
    """(N, n, P) columns without the zero columns of each joint, which are about half."""

    size: int  # P
    sparsity: tuple[Integers, ...]  # per joint, (m,) indices of its nonzero columns, ascending
    values: tuple[Array, ...]  # per joint, (N, m) these columns

    @classmethod
    def of(cls, columns: Array) -> SparseColumns:
        """From dense columns (N, n, P)."""
        sparsity = tuple(np.flatnonzero(some) for some in np.any(columns != 0.0, axis=0))
        values = tuple(np.ascontiguousarray(columns[:, j, nonzero]) for j, nonzero in enumerate(sparsity))
        return cls(columns.shape[2], sparsity, values)

    def __len__(self) -> int:
        return len(self.values[0])

    @property
    def nbytes(self) -> int:
        """Memory of the values, bytes."""
        return sum(values.nbytes for values in self.values)

    @property
    def dense(self) -> Array:
        """(N, n, P) columns as a new array."""
        dense = np.zeros((len(self), len(self.values), self.size))
        for j, (nonzero, values) in enumerate(zip(self.sparsity, self.values, strict=True)):
            dense[:, j, nonzero] = values
        return dense

    def of_joint(self, joint: int, columns: Integers) -> Array:
        """(N, k) columns of a joint by ascending indices that include all its nonzero columns."""
        values = self.values[joint]
        if np.array_equal(columns, self.sparsity[joint]):
            return values
        some = np.zeros((len(self), len(columns)))
        some[:, np.searchsorted(columns, self.sparsity[joint])] = values
        return some

    def chosen(self, columns: Integers) -> SparseColumns:
        """Some of the P columns, in ascending order."""
        place = np.full(self.size, -1)
        place[columns] = np.arange(len(columns))
        sparsity, values = [], []
        for nonzero, block in zip(self.sparsity, self.values, strict=True):
            inside = place[nonzero] >= 0
            sparsity.append(place[nonzero[inside]])
            values.append(block if inside.all() else np.ascontiguousarray(block[:, inside]))
        return SparseColumns(len(columns), tuple(sparsity), tuple(values))


@dataclass(frozen=True)
class Model:
    """efforts = D(Y(motion) theta), theta in a cone (:eq:`model`); D is the identity without distortions.

    Attributes:
        robot: the robot.
        terms: the terms; their parameters are stacked in this order.
        distortions: of rows first, of readings last; each acts on the result of the previous one of its kind.
        constraints: stated constraints on the parameters, or None.

    Example:
        >>> model = bayesid.Model.of(robot, ["rigid_body", "coulomb_friction"], motion)
        >>> theta = bayesid.random_parameters(model, rng=0)
        >>> model.effort(motion, theta).shape
        (201, 3)
    """

    robot: Robot
    terms: tuple[Term, ...]
    distortions: tuple[Distortion, ...] = ()
    constraints: Constraints | None = None

    @classmethod
    def of(cls, robot: Robot, terms: Iterable[str | Term], motion: Motion) -> Model:
        """A model of a robot from names of the catalogue, or your own terms.

        Args:
            robot: the robot.
            terms: names or terms; the numbers of named terms are taken from the motion.
            motion: N samples of the robot's joints.

        Raises:
            InputError: a name is not in the catalogue, a term comes twice, must be fitted to a log, or does not suit
                the robot.

        Example:
            >>> from bayesid.effects.springs import JointSpring
            >>> spring = JointSpring(joints=(2,))
            >>> [term.name for term in bayesid.Model.of(robot, ["rigid_body", spring], motion).terms]
            ['rigid_body', 'joint_spring']
        """
        from bayesid.effects import catalogue  # which imports every module of effects

        return cls(robot, catalogue.make_terms(terms, robot, motion))

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The P parameters of all terms."""
        return tuple(parameter for term in self.terms for parameter in term.parameters(self.robot))

    @cached_property
    def cone(self) -> Cone:
        """The product of the terms' cones, without the bounds that a term lifts, cut by the constraints."""
        cone = reduce(lambda total, term: total + term.cone(self.robot), self.terms, Cone.free(0))
        freed = {name for term in self.terms for name in term.freed(self.robot)}
        bounded = [k for k in cone.nonnegative.tolist() if self.parameters[k].name not in freed]
        names = [parameter.name for parameter in self.parameters]
        stated = None if self.constraints is None else self.constraints.of(names)
        return replace(cone, nonnegative=np.array(bounded, dtype=np.int64), stated=stated)

    def extend(self, effect: Effect) -> Model:
        """A new model with one more effect, the last of the terms or of the distortions."""
        if isinstance(effect, Term):
            return replace(self, terms=(*self.terms, effect))
        if isinstance(effect, Distortion):
            return replace(self, distortions=(*self.distortions, effect))
        raise TypeError(f"{effect.name} is neither a term nor a distortion")

    @property
    def effects(self) -> tuple[Effect, ...]:
        return (*self.terms, *self.distortions)

    @property
    def payloads(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(label for term in self.terms for label in term.payloads))

    @property
    def before_sensors(self) -> Model:
        """The model without sensor distortions."""
        return replace(self, distortions=tuple(d for d in self.distortions if not isinstance(d, SensorDistortion)))

    @property
    def undelayed(self) -> Model:
        """The model without delays."""
        return replace(self, distortions=tuple(d for d in self.distortions if d.late is None))

    @property
    def lag(self) -> float:
        """Delay of the efforts of all joints, s."""
        return sum(distortion.late or 0.0 for distortion in self.distortions if not distortion.joints)

    def parts(self, theta: Array) -> list[tuple[Term, Array]]:
        """The terms, each with its own part of theta (P,)."""
        return [(term, theta[place]) for term, place in zip(self.terms, self.places, strict=True)]

    def links(self, theta: Array) -> Array:
        """(n, 10) link parameters with payloads, from theta (P,); zero without rigid bodies."""
        parts = (term.link_parameters(self.robot, values) for term, values in self.parts(theta))
        return sum(parts, np.zeros((self.robot.n_joints, 10)))

    def scene(self, motion: Motion, theta: Array, effort: Array, measured: Array) -> Scene:
        """Input for the effects to try on a log of N samples, by the model with parameters theta (P,).

        The model's effort and the measured absolute efforts are (N, n), N m.
        """

        def effort_with(robot: Robot, motion: Motion) -> Array:
            return replace(self, robot=robot).effort(motion, theta)

        actuators, links = self.robot.actuators(motion), self.links(theta).ravel()
        return Scene(self.robot, motion, actuators, effort, measured, links, effort_with)

    def columns(self, motion: Motion) -> Array:
        """(N, n, P) columns of all terms, rows distorted, N m per unit of each parameter."""
        return self._distorted(self._plain_columns)(self.robot, motion)

    def chunks(self, motion: Motion) -> Iterator[tuple[slice, Array]]:
        """Rows and their columns, some thousand samples at a time; effects with a memory see some samples around."""
        return ((rows, columns.dense) for rows, columns in self.sparse_chunks(motion))

    def sparse_chunks(self, motion: Motion) -> Iterator[tuple[slice, SparseColumns]]:
        """The same with sparse columns; cached for one motion if they fit into memory."""
        if self._cache.motion() is motion:
            yield from self._cache.chunks
            return
        self.forget()
        chunks: list[tuple[slice, SparseColumns]] = []
        free_bytes = TUNING.cached_bytes
        for rows, columns in self._computed_chunks(motion):
            free_bytes -= columns.nbytes
            chunks = [*chunks, (rows, columns)] if free_bytes >= 0 else []
            yield rows, columns
        if chunks:
            self._cache.motion, self._cache.chunks = ref(motion), chunks

    def forget(self) -> None:
        """Clears the cache of columns."""
        vars(self).pop("_cache", None)

    @cached_property
    def _cache(self) -> _Cache:
        return _Cache()

    def _computed_chunks(self, motion: Motion) -> Iterator[tuple[slice, SparseColumns]]:
        chunks = [slice(start, min(start + TUNING.chunk, len(motion))) for start in range(0, len(motion), TUNING.chunk)]
        for k in range(0, len(chunks), TUNING.chunks_together):
            some = chunks[k : k + TUNING.chunks_together]
            if len(some) <= processors():  # forking would take longer
                yield from ((rows, self._chunk(motion, rows)) for rows in some)
            else:
                yield from zip(some, in_parallel([partial(self._chunk, motion, rows) for rows in some]), strict=True)

    def _chunk(self, motion: Motion, rows: slice) -> SparseColumns:
        memory = any(effect.memory for effect in self.effects)
        first = max(0, rows.start - TUNING.look_back) if memory else rows.start
        last = min(len(motion), rows.stop + TUNING.look_ahead) if memory else rows.stop
        return SparseColumns.of(self.columns(motion[first:last])[rows.start - first : rows.stop - first])

    def effort(self, motion: Motion, theta: Array) -> Array:
        """(N, n) actuator efforts as they are read, N m, of the parameters theta (P,); (N, n, K) of K of them (P, K).

        Example:
            >>> effort = model.effort(motion, theta)
            >>> effort.shape  # N m
            (201, 3)
        """
        effort = np.concatenate([columns @ theta for _, columns in self.chunks(motion)])
        return self.read(effort) if theta.ndim == 1 else np.stack([*map(self.read, np.moveaxis(effort, 2, 0))], axis=2)

    def effort_at(self, motion: Motion, theta: Array) -> Array:
        """(N, n) `effort` of a few instants, N m, computed without columns, which is much faster."""
        parts = self.parts(theta)

        def efforts(robot: Robot, motion: Motion) -> Array:
            each = [term.effort(robot, motion, values) for term, values in parts]
            return sum(each[1:], each[0])[:, :, None]

        effort = self._distorted(efforts)(self.robot, motion)[:, :, 0]
        return self.read(effort) if self.distortions else effort

    def to_urdf(self, theta: Array) -> str:
        """URDF text of the robot with the link and friction parameters of theta (P,); masses must be positive.

        URDF's link frame is its joint's frame, so links given in another frame (standard Denavit-Hartenberg) are moved
        there. Joints are called joint1..jointn, links link1..linkn, from base to tip. What URDF has no place for is
        listed in a comment.

        Raises:
            ValueError: theta has another shape, the model no rigid bodies, or a link no positive mass.

        Example:
            >>> result.model.to_urdf(result.theta).splitlines()[1]
            '<robot name="arm">'
        """
        from bayesid.export import urdf

        return urdf(self, theta)

    def to_mjcf(self, theta: Array) -> str:
        """MJCF text, for MuJoCo: bodies, friction, rotor inertia, springs, gravity and motors; as `to_urdf`.

        Motors are called motor1..motorn; a motor's control is its effort as in `effort`, N m. MuJoCo counts joints
        depth first, which on a robot with branches may be another order.

        Raises:
            ValueError: as of `to_urdf`.

        Example:
            >>> result.model.to_mjcf(result.theta).splitlines()[1]
            '<mujoco model="arm">'
        """
        from bayesid.export import mjcf

        return mjcf(self, theta)

    def _distorted(self, rows: Rows) -> Rows:
        for distortion in self.distortions:
            rows = partial(distortion.columns, rows)
        return rows

    def read(self, effort: Array) -> Array:
        """(N, n) readings of efforts (N, n), N m."""
        return reduce(lambda read, distortion: distortion.measured(read), self.distortions, effort)

    def invert_sensor(self, magnitude: Array) -> tuple[Array, Mask]:
        """(N, n) absolute efforts before sensor errors, N m, and (N, n) where readings determine them."""
        valid = np.ones(magnitude.shape, dtype=bool)
        for distortion in reversed(self.distortions):
            magnitude, valid_here = distortion.restored(magnitude)
            valid &= valid_here
        return magnitude, valid

    def _plain_columns(self, robot: Robot, motion: Motion) -> Array:
        columns = np.zeros((len(motion), robot.n_joints, len(self.parameters)))
        for term, place in zip(self.terms, self.places, strict=True):
            columns[:, :, place] = term.columns(robot, motion)
        return columns

    @cached_property
    def places(self) -> tuple[slice, ...]:
        """Where the parameters of each term lie among all."""
        ends = np.cumsum([0, *(len(term.parameters(self.robot)) for term in self.terms)]).tolist()
        return tuple(slice(start, end) for start, end in pairwise(ends))


class _Cache:
    """Cache of the columns of one motion; pickles start empty."""

    def __init__(self) -> None:
        self.motion: Callable[[], Motion | None] = lambda: None
        self.chunks: list[tuple[slice, SparseColumns]] = []

    def __reduce__(self) -> tuple[type[_Cache], tuple[()]]:
        return _Cache, ()
