"""Base class of all effects: terms of the model, and distortions of its rows and readings.

Other code uses the columns, names and phrases of an effect, never its class. A new effect is one new class in
`bayesid/effects` (docs/extending.md).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Literal, Self, dataclass_transform

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.formula import Description
from bayesid.effects.parameters import Cone, Parameter, unit_of
from bayesid.motion import Motion
from bayesid.robot import Robot

Numbers = tuple[float, ...]


@dataclass(frozen=True)
class Number:
    """Properties of a nonlinear parameter of an effect; by default there is one per actuator."""

    unit: str = ""  # in a revolute joint; empty if the number is not reported
    name: str = ""  # in reports, without the joint; by default the field's name
    of_motion: Callable[[Motion], Array] | None = None  # (m,) values from the motion of m actuators
    tried: Callable[[Motion], Iterable[float]] | None = None  # candidates for one actuator, from its motion
    given: bool = False  # whether the model sets it: it is not fitted to a log, and `check` validates its size
    tuned: bool = False  # whether the first amplitudes of the effect are changes of these numbers
    count: int = 0  # how many there are, if not one per actuator

    @property
    def fixed(self) -> bool:
        """Whether the model or the motion sets it, so that it is not fitted to a log."""
        return self.given or (self.of_motion is not None and self.tried is None)


def number(unit: str = "", *, default: Any = dataclasses.MISSING, **about: Any) -> Any:
    """A field for a nonlinear number of an effect; the other arguments are those of `Number`."""
    return dataclasses.field(default=default, metadata={"number": Number(unit, **about)})


@dataclass(frozen=True)
class Scene:
    """Input from which an effect derives the forms to try on a log."""

    robot: Robot
    motion: Motion  # N samples of its joints
    actuators: Motion  # the same in actuator coordinates
    effort: Array  # (N, n) the current model's effort, N m
    measured: Array  # (N, n) absolute values of the measured efforts, N m
    links: Array  # (10 n,) the current model's link parameters, with payloads
    effort_with: Callable[[Robot, Motion], Array]
    """(N, n) effort, N m, of the current model without newly found effects, for another robot or motion."""

    @cached_property
    def each(self) -> list[Motion]:
        """The motion of each actuator alone."""
        return [self.actuators.joints([j]) for j in range(self.actuators.n_joints)]

    @cached_property
    def nominal_effort(self) -> Array:
        """(N, n) `effort_with` for the given robot and motion, N m."""
        return self.effort_with(self.robot, self.motion)

    @cached_property
    def link_effort(self) -> Array:
        """(N, n) effort of the links alone, N m."""
        return self.robot.inverse_dynamics(self.motion, self.links)


@dataclass(frozen=True)
class ReadableUnit:
    """Conversion of a number for reports: factor * (value - neutral), in another unit."""

    unit: str
    factor: float = 1.0
    neutral: float = 0.0


@dataclass(frozen=True)
class Phrase:
    """Text for one form of an effect.

    Attributes:
        sentence: statement of the effect; {who} is the joint, {whose} its genitive, other braces hold parameters, named
            without the joint.
        noun: with its article; by default that of the effect's main form.
        size: the number whose sign selects `sentence` or `opposite`, or whose change alone is reported.
        opposite: sentence for a negative size, given as an absolute value.
        detail: one more sentence; braces hold names of `Effect.readable`.
        brief: the noun with its main numbers, by the same names; by default the noun.
        units: of numbers that are reported in another unit than the model's.
    """

    sentence: str = ""
    noun: str = ""
    size: str = ""
    opposite: str = ""
    detail: str = ""
    brief: str = ""
    units: Mapping[str, ReadableUnit] = dataclasses.field(default_factory=dict)


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(number,))
@dataclass(frozen=True, kw_only=True)
class Effect:
    """One form of a physical effect; each subclass is a frozen dataclass, its fields are made by `number`.

    A class sets the attributes below; all but the first two have defaults. Its docstring holds the equation, one
    sentence of physics and the source.

    Args:
        joints: the actuators (from 1) in which it acts; all of them if empty.
    """

    joints: tuple[int, ...] = ()

    name: ClassVar[str]
    """In the catalogue; a second form of the same effect is named effect.form."""
    shown_by: ClassVar[str]
    """A motion that distinguishes it from other effects."""
    phrase: ClassVar[Phrase] = Phrase()
    """Text for reports; by default made of its name and numbers."""
    linear: ClassVar[bool]
    """Whether it is a term: the efforts are linear in its amplitudes."""
    acts_on: ClassVar[Literal["joint", "robot", "either"]] = "joint"
    """Where it is searched and reported; with "robot" it acts in all joints."""
    memory: ClassVar[bool] = False
    """Whether a row depends on other time steps."""
    can_be_missing: ClassVar[bool] = True
    """Whether a model may lack it."""
    needs_earlier: ClassVar[bool] = False
    """Whether it can be separated from the model's own parameters only with an earlier log."""
    of_table: ClassVar[bool] = False
    """Whether it is an error of the robot's table; errors of other rows may look the same."""
    typical: ClassVar[Numbers | tuple[Numbers, ...]] = ()
    """Prior standard deviations of the amplitudes, one for all or one each; several such priors are tried in turn.
    If empty, a usual share of the effort."""

    frees: ClassVar[tuple[str, ...]] = ()
    """Symbols of other terms' nonnegative parameters that may be negative in the actuators in which it acts."""

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True, kw_only=True)(cls)

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", tuple(int(j) for j in self.joints))

    @classmethod
    def number_fields(cls) -> Mapping[str, Number]:
        """Its nonlinear numbers by field."""
        return {field.name: field.metadata["number"] for field in dataclasses.fields(cls) if "number" in field.metadata}

    @property
    def effect(self) -> str:
        """Name of the effect, whatever its form."""
        return effect_of(self.name)

    @property
    def shape(self) -> Mapping[str, list[Any]]:
        """The fields by name, what model.toml keeps; `joints` only if they are named."""
        named = {"joints": list(self.joints)} if self.joints else {}
        return {**named, **{key: list(getattr(self, key)) for key in self.number_fields()}}

    @property
    def fitted(self) -> tuple[str, ...]:
        """The fields whose numbers are fitted to a log."""
        return tuple(key for key, number in self.number_fields().items() if not number.fixed)

    def acting(self, n_joints: int) -> list[int]:
        """The (0-based) actuators in which it acts."""
        return [j - 1 for j in self.joints] or list(range(n_joints))

    def check(self, n_joints: int) -> None:
        """Raises ValueError if its joints and numbers do not suit a robot of n joints."""
        acting = self.acting(n_joints)
        if len(set(acting)) < len(acting) or not all(0 <= j < n_joints for j in acting):
            raise ValueError(f"joints {list(self.joints)} are not joints of the robot")
        for key, number in self.number_fields().items():
            if not number.given:
                self._expect(key, number.count or len(acting))
        if self.joints and self.acts_on == "robot":
            raise ValueError(f"{self.name} acts in all joints")

    def _expect(self, key: str, size: int) -> None:
        if len(getattr(self, key)) != size:
            raise ValueError(f"{key} has {len(getattr(self, key))} numbers, expected {size}")

    def in_joints(self, joints: tuple[int, ...], n_joints: int) -> Self:
        """The same effect with its own numbers, in some of its joints only."""
        acting = self.acting(n_joints)
        chosen = [acting.index(j - 1) for j in joints]
        per_actuator = [key for key, number in self.number_fields().items() if not (number.count or number.given)]
        kept: Any = {key: tuple(getattr(self, key)[i] for i in chosen) for key in per_actuator}
        return replace(self, joints=joints, **kept)

    def numbers(self, robot: Robot) -> Mapping[str, tuple[float, str]]:
        """Name, with the joint, to value and unit of the nonlinear numbers to report."""
        reported = {}
        for key, number in self.number_fields().items():
            places = range(number.count) if number.count else self.acting(robot.n_joints)
            for j, value in zip(places, getattr(self, key), strict=True) if number.unit else ():
                unit = number.unit if number.count else unit_of(robot, j, number.unit)
                reported[f"{number.name or key}{j + 1}"] = float(value), unit
        return reported

    @classmethod
    def variants(cls, scene: Scene) -> Iterable[Self]:
        """The forms to try on a log: joint by joint, over a grid of its nonlinear numbers."""
        raise NotImplementedError

    @classmethod
    def guesses(cls, robot: Robot) -> Iterable[Self]:
        """Forms to try on the whole robot while signs are unknown; none by default."""
        return ()

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """The parameters that it adds to a model."""
        return ()

    def freed(self, robot: Robot) -> tuple[str, ...]:
        """Names of other terms' parameters that may be negative because of it."""
        return tuple(f"{symbol}{j + 1}" for symbol in self.frees for j in self.acting(robot.n_joints))

    def cone(self, robot: Robot) -> Cone:
        """The cone of these p parameters; free by default."""
        return Cone.free(len(self.parameters(robot)))

    @property
    def adds_to(self) -> Mapping[str, str]:
        """Symbols of its parameters to those of another effect's that they add to, joint by joint."""
        return {}

    def readable(self, values: Array) -> Mapping[str, tuple[Array, str]]:
        """Quantities to report instead of its parameters (..., p): name to (...) values and unit; empty by default."""
        return {}

    def description(self, robot: Robot, theta: Array) -> Description | None:
        """Description of a learned effect with parameters theta (p,); None for other effects."""
        return None

    def change(self, scene: Scene) -> tuple[Array, Array]:
        """(N, n) change of the scene's effort, N m, and its derivatives (N, n, p) by the p amplitudes."""
        raise NotImplementedError

    def change_by_joint(self, scene: Scene) -> tuple[dict[int, Array], dict[int, Array]]:
        """The same for the (0-based) joints that it acts on: (N,) change if any, (N, p) derivatives."""
        shift, columns = self.change(scene)
        acting = [j for j in range(scene.robot.n_joints) if np.any(columns[:, j]) or np.any(shift[:, j])]
        shifts = {j: shift[:, j] for j in acting if np.any(shift[:, j])}
        return shifts, {j: columns[:, j] for j in acting} if columns.shape[2] else {}

    def resolved(self, scene: Scene) -> bool:
        """Whether a log's sampling is fine enough to distinguish this form from simpler ones."""
        return True

    def moved(self, step: Array) -> Self:
        """The effect with its own numbers changed by the first entries of the amplitudes step (p,)."""
        tuned = {key: np.array(getattr(self, key)) for key, number in self.number_fields().items() if number.tuned}
        changed: Any = {key: tuple((values + step[: len(values)]).tolist()) for key, values in tuned.items()}
        return replace(self, **changed)


def effect_of(name: str) -> str:
    """Name of the effect of a form."""
    return name.split(".")[0]
