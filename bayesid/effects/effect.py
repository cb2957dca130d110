"""What all effects share, be they terms of the model's sum or distortions of its rows and readings.

Everything downstream asks an effect for its columns, names, phrases and places and never which effect it is, so a new
effect is a new file in `bayesid/effects` and nothing else.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.effects.formula import Description
from bayesid.effects.parameters import Parameter
from bayesid.motion import Motion
from bayesid.robot import Joint, Robot


@dataclass(frozen=True)
class Scene:
    """What an effect may look at to say in which forms it could be hidden in a log.

    Attributes:
        robot: the robot.
        motion: N samples of its joints.
        actuators: the same in actuator coordinates.
        effort: (N, n) the current model's effort, N m.
        measured: (N, n) absolute values of the measured efforts, N m.
        links: (10 n,) the current model's link parameters, with what the links carry.
        effort_with: the effort (N, n), N m, of the current model without effects that were found since, of a robot that
            is built or mounted otherwise, or moves otherwise.
    """

    robot: Robot
    motion: Motion
    actuators: Motion
    effort: Array
    measured: Array
    links: Array
    effort_with: Callable[[Robot, Motion], Array]

    def actuator(self, joint: int) -> Motion:
        """The motion of one (0-based) actuator alone."""
        return self._each[joint]

    @cached_property
    def effort_as_told(self) -> Array:
        """(N, n) the same effort of the robot and the motion as they are told, N m."""
        return self.effort_with(self.robot, self.motion)

    @cached_property
    def link_effort(self) -> Array:
        """(N, n) effort of the links alone, N m."""
        return self.robot.inverse_dynamics(self.motion, self.links)

    @cached_property
    def _each(self) -> list[Motion]:
        return [self.actuators.joints([j]) for j in range(self.actuators.n_joints)]


@dataclass(frozen=True)
class ReadableUnit:
    """How people read a number: factor * (value - neutral), in a unit of theirs."""

    unit: str
    factor: float = 1.0
    neutral: float = 0.0


@dataclass(frozen=True)
class Phrase:
    """How to speak of one form of an effect.

    Attributes:
        sentence: says that it is there; {who} is the joint, {whose} its genitive, other braces hold parameters, without
            the joint in their names.
        noun: with its article; a form without one has that of the effect's main form.
        size: the number whose sign decides between the sentence and the opposite, or whose change alone is reported.
        opposite: for a negative size, which is then given without its sign.
        detail: one more sentence, of what `Effect.readable` gives, names in braces.
        brief: the noun with the numbers that matter most, of the same names; by default the noun.
        units: of the numbers that people read in another unit than the model's.
    """

    sentence: str = ""
    noun: str = ""
    size: str = ""
    opposite: str = ""
    detail: str = ""
    brief: str = ""
    units: Mapping[str, ReadableUnit] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Effect:
    """One form of a physical effect; a subclass is a frozen dataclass whose fields are tuples, one number an actuator.

    Args:
        joints: the actuators (from 1) in which it acts; all of them if empty.
    """

    joints: tuple[int, ...] = ()

    name: ClassVar[str]
    """In the catalogue; a second form of the same effect is named effect.form."""
    physics: ClassVar[str]
    """One sentence: what happens."""
    reference: ClassVar[str]
    """Where the equation comes from."""
    variable: ClassVar[str]
    """Over what the effect shows best: velocity, position, acceleration, load or time."""
    shown_by: ClassVar[str]
    """The motion that shows it, and no other effect."""
    phrase: ClassVar[Phrase] = Phrase()
    """How people speak of it; without one, by its name and numbers."""
    memory: ClassVar[bool] = False
    """Whether a row depends on other instants too."""
    by_joint: ClassVar[bool] = True
    """Whether it can act in some of the joints alone."""
    whole_robot: ClassVar[bool] = False
    """Whether it is sought in the whole robot at once, and so is said of the robot where a log cannot show it."""
    can_be_missing: ClassVar[bool] = True
    """Whether a model may lack it."""
    linear: ClassVar[bool] = True
    """Whether the efforts are linear in its amplitudes wherever it is looked at."""
    of_effort: ClassVar[bool] = False
    """Whether what it does depends on the whole effort, with that of the terms beside it."""
    reveals: ClassVar[bool] = False
    """Whether its rows show parameters of other effects that no log without it could show."""
    adds_to: ClassVar[Mapping[str, str]] = {}
    """Symbols of its parameters to those of another effect's that they add to, joint by joint, where a model has it."""
    needs_earlier: ClassVar[bool] = False
    """Whether only what an earlier log has shown tells it from the model's own parameters."""
    refines: ClassVar[bool] = False
    """Whether it is but a finer form of a standard term: completes a model, but is nothing that could be missing."""
    of_sensor: ClassVar[bool] = False
    """Whether it changes what is read of the efforts, not what makes them."""
    of_clock: ClassVar[bool] = False
    """Whether it changes only when they are read."""
    of_table: ClassVar[bool] = False
    """Whether it is an error of the robot's table, which one of another row may look like."""
    shape_units: ClassVar[Mapping[str, str]] = {}
    """Of the fields with nonlinear numbers that people want to know."""
    given: ClassVar[tuple[str, ...]] = ()
    """Fields whose numbers come with the motion or the model; no log is asked for them."""
    words: ClassVar[tuple[str, ...]] = ()
    """Fields that hold words in the place of numbers; they are given too."""
    counts: ClassVar[Mapping[str, int]] = {}
    """Numbers in a field, where they are not one an actuator."""
    amplitudes: ClassVar[str] = ""
    """The field, if any, whose numbers its first amplitudes change."""
    typical: ClassVar[tuple[float, ...]] = ()
    """Prior standard deviations of the amplitudes, one for all or one each; if empty, a usual share of the effort."""
    typical_scales: ClassVar[tuple[float, ...]] = (1.0,)
    """Factors of `typical`, each of which is tried."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", tuple(int(j) for j in self.joints))

    @property
    def effect(self) -> str:
        """Name of the effect, whatever its form."""
        return effect_of(self.name)

    @property
    def shape(self) -> Mapping[str, list[Any]]:
        """The fields by name, what model.toml keeps; `joints` only if they are named."""
        values = {entry.name: list(getattr(self, entry.name)) for entry in fields(self)}
        return {key: value for key, value in values.items() if key != "joints" or value}

    @property
    def sought(self) -> tuple[str, ...]:
        """The fields whose numbers only a comparison with a log can show."""
        return tuple(key for key in self.shape if key not in ("joints", *self.given, *self.words))

    def acting(self, n_joints: int) -> list[int]:
        """The (0-based) actuators in which it acts."""
        return [j - 1 for j in self.joints] or list(range(n_joints))

    def check(self, n_joints: int) -> None:
        """Raises ValueError if its joints and numbers do not suit a robot of n joints."""
        acting = self.acting(n_joints)
        if len(set(acting)) < len(acting) or not all(0 <= j < n_joints for j in acting):
            raise ValueError(f"joints {list(self.joints)} are not joints of the robot")
        for key, values in self.shape.items():
            expected = self.counts.get(key, len(acting))
            if key != "joints" and len(values) != expected:
                raise ValueError(f"{key} has {len(values)} numbers, expected {expected}")
        if self.joints and not self.by_joint:
            raise ValueError(f"{self.name} acts in all joints")

    def in_joints(self, joints: tuple[int, ...], n_joints: int) -> Self:
        """The same effect with its own numbers, in some of its joints only."""
        acting = self.acting(n_joints)
        chosen = [acting.index(j - 1) for j in joints]
        shape = {key: tuple(values) for key, values in self.shape.items() if key != "joints"}
        one_each = {key: len(values) == len(acting) and key not in self.counts for key, values in shape.items()}
        kept = {key: tuple(v[i] for i in chosen) if one_each[key] else v for key, v in shape.items()}
        return type(self)(joints=joints, **kept)

    def numbers(self, robot: Robot) -> Mapping[str, tuple[float, str]]:
        """Name, with the joint, to value and unit of the nonlinear numbers that people want to know."""
        acting = self.acting(robot.n_joints)
        return {
            f"{key}{j + 1}": (float(value), _unit_in(robot.joints[j], unit))
            for key, unit in self.shape_units.items()
            for j, value in zip(acting, getattr(self, key), strict=True)
        }

    @classmethod
    def variants(cls, scene: Scene) -> Iterable[Self]:
        """The forms in which it may be hidden in a log: joint by joint, and over its nonlinear numbers."""
        raise NotImplementedError

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """The parameters that it adds to a model."""
        return ()

    def readable(self, values: Array) -> Mapping[str, tuple[Array, str]]:
        """What people read in place of its parameters (..., p): name to (...) values and unit; by default nothing."""
        return {}

    def description(self, robot: Robot, theta: Array) -> Description | None:
        """Words for an effect without a name, with parameters theta (p,); None of those that have one."""
        return None

    def one_sided(self, robot: Robot) -> Integers:
        """Indices of the amplitudes that cannot be negative."""
        return np.empty(0, dtype=np.int64)

    def change(self, scene: Scene) -> tuple[Array, Array]:
        """(N, n) change of the scene's effort, N m, and its derivatives (N, n, p) by the p amplitudes."""
        raise NotImplementedError

    def change_by_joint(self, scene: Scene) -> tuple[dict[int, Array], dict[int, Array]]:
        """The same for the (0-based) joints that it acts on: (N,) change where there is one, (N, p) derivatives."""
        shift, columns = self.change(scene)
        acting = [j for j in range(scene.robot.n_joints) if np.any(columns[:, j]) or np.any(shift[:, j])]
        shifts = {j: shift[:, j] for j in acting if np.any(shift[:, j])}
        return shifts, {j: columns[:, j] for j in acting} if columns.shape[2] else {}

    def resolved(self, scene: Scene) -> bool:
        """Whether a log's samples lie close enough to tell this form from simpler ones."""
        return True

    def moved(self, step: Array) -> Self:
        """The effect with its own numbers changed by the first entries of the amplitudes step (p,)."""
        if not self.amplitudes:
            return self
        values = np.array(getattr(self, self.amplitudes))
        changed: Any = {self.amplitudes: tuple((values + step[: len(values)]).tolist())}
        return replace(self, **changed)


def effect_of(name: str) -> str:
    """Name of the effect of which a name in the catalogue is a form."""
    return name.split(".")[0]


def named_classes(package: str, folders: Iterable[str]) -> dict[str, Any]:
    """Name to class, of all classes in the modules of a package that set a `name` themselves.

    Args:
        package: its full name, as in sys.modules.
        folders: in which its modules are, its `__path__`.
    """
    classes = {}
    for info in pkgutil.iter_modules(folders):
        module = importlib.import_module(f"{package}.{info.name}")
        for value in vars(module).values():
            if inspect.isclass(value) and value.__module__ == module.__name__ and "name" in vars(value):
                classes[vars(value)["name"]] = value
    return classes


def _unit_in(joint: Joint, unit: str) -> str:
    """A unit of a joint that turns, for a joint that may slide."""
    return unit.replace("N m", "N").replace("rad", "m") if joint.prismatic else unit
