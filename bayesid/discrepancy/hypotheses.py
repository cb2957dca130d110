"""What could be missing: every effect of the catalogue in every form, as columns on the log at hand."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from bayesid import distortions, terms
from bayesid.discrepancy.evidence import Columns
from bayesid.distortions.base import Distortion
from bayesid.model import Model
from bayesid.motion import Array, Mask
from bayesid.terms.base import Scene, Term

_USUAL = 0.3
"""Prior standard deviation of an effect's largest effort, as a share of the joint's RMS effort."""
_BODY = np.array([0.03] * 6 + [0.15] * 3 + [1.0])
"""Prior standard deviations of the ten parameters of a body of 1 kg, kg m^2, kg m and kg."""
_OF_ALL = ("base_tilt", "delay")
_MASSES = (0.1, 0.5, 3.0)
"""kg, tried for a payload."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One form of an effect.

    Attributes:
        source: the term or distortion that it would add.
        columns: what it would do to this log.
        make: makes a hypothesis of another form.
        changes: names of parameters of the model that would change, where the model has the effect already.
    """

    source: Term | Distortion
    columns: Columns
    make: Callable[[Term | Distortion], Hypothesis] = field(repr=False, compare=False)
    changes: tuple[str, ...] = ()

    @property
    def effect(self) -> str:
        """Name in the catalogue of effects, whatever the form."""
        return self.source.name.split(".")[0]

    def remade(self, number: str, value: float) -> Hypothesis:
        """The same form with another nonlinear number."""
        return self.make(replace(self.source, **{number: (value,)}))  # type: ignore[type-var]

    @property
    def joints(self) -> tuple[int, ...]:
        """From 1; none named: it acts on the whole robot."""
        return self.source.joints


def effect_names() -> list[str]:
    """All effects of the catalogue."""
    names = [name.split(".")[0] for name in (*terms.CATALOGUE, *distortions.CATALOGUE)]
    return sorted(set(names) - {terms.RigidBody.name})


def kind_of(effect: str) -> type[Term] | type[Distortion]:
    """The class of an effect's main form."""
    if effect in distortions.CATALOGUE:
        return distortions.CATALOGUE[effect]
    return terms.CATALOGUE[effect]


def acts_on_all(effect: str) -> bool:
    """Whether an effect is the whole robot's, or may be."""
    return not issubclass(kind_of(effect), terms.ActuatorTerm | Distortion) or effect in _OF_ALL


def hypotheses(model: Model, scene: Scene, used: Mask) -> Iterator[list[Hypothesis]]:
    """Lists of forms that act in the same joints with as many amplitudes, for one call of `Screen.gain` each.

    Args:
        model: as it is.
        scene: the log.
        used: (N, n) samples that count.
    """
    size = np.sqrt(np.sum((scene.measured * used) ** 2, axis=0) / np.maximum(used.sum(axis=0), 1))

    def make(source: Term | Distortion) -> Hypothesis:
        if isinstance(source, Distortion):
            return _of_distortion(source, scene, used, make)
        return _of_term(source, model, scene, size, used, make)

    for kind in (*terms.CATALOGUE.values(), *distortions.CATALOGUE.values()):
        groups: dict[tuple[object, ...], list[Hypothesis]] = {}
        for source in kind.variants(scene):
            for one in _sized(make(source)):
                key = source.joints, len(one.columns.sd), tuple(sorted(one.columns.joints)), bool(one.columns.rows)
                groups.setdefault(key, []).append(one)
        yield from groups.values()


def _sized(one: Hypothesis) -> list[Hypothesis]:
    """A body with the priors of several masses; everything else as it is, and nothing if it would leave no trace."""
    if not one.columns.joints:
        return []
    if not np.array_equal(one.columns.sd, _BODY):
        return [one]
    return [replace(one, columns=replace(one.columns, sd=mass * _BODY)) for mass in _MASSES]


_Make = Callable[[Term | Distortion], Hypothesis]


def _of_term(source: Term, model: Model, scene: Scene, size: Array, used: Mask, make: _Make) -> Hypothesis:
    held = _held(source, model)
    source = source if held is None else held
    columns = source.columns(scene.robot, scene.motion)
    cone, named = source.cone(scene.robot), [j - 1 for j in source.joints]
    rows = {j: columns[:, j] for j in named or range(scene.robot.n_joints) if np.any(columns[:, j])}
    sd = _BODY if len(cone.bodies) else _sizes(rows, size, used)
    positive = np.zeros(cone.size, dtype=bool)
    positive[cone.nonnegative] = held is None  # a change of what is there already may go either way
    changes = () if held is None else tuple(parameter.name for parameter in source.parameters(scene.robot))
    return Hypothesis(source, Columns(rows, {}, sd, positive), make, changes)


def _held(source: Term, model: Model) -> Term | None:
    """The term itself if all parameters that it would add are the model's already; with the model's shape."""
    names = {parameter.name for parameter in model.parameters}
    if not {parameter.name for parameter in source.parameters(model.robot)} <= names:
        return None
    for term in model.terms:
        if term.name == source.name and set(source.joints or (0,)) <= set(_acting(term, model)):
            return _part(term, source, model)
    return None


def _acting(term: Term, model: Model) -> tuple[int, ...]:
    return term.joints or (0, *range(1, model.robot.n_joints + 1))


def _part(term: Term, source: Term, model: Model) -> Term:
    """The model's term, in the joints of another one only."""
    if not source.joints:
        return term
    own = list(term.joints or range(1, model.robot.n_joints + 1))
    chosen = [own.index(j) for j in source.joints]
    shape = {
        key: [values[i] for i in chosen] if len(values) == len(own) else values
        for key, values in term.shape.items()
        if key != "joints"
    }
    return terms.make_term(term.name, {**shape, "joints": source.joints})


def _sizes(rows: dict[int, Array], size: Array, used: Mask) -> Array:
    """(p,) amplitudes whose largest effort is usual for the joint in which it is largest."""
    relative = [np.abs(one[used[:, j]]).max(axis=0, initial=0.0) / max(size[j], 1e-300) for j, one in rows.items()]
    largest = np.max(relative, axis=0) if relative else np.zeros(0)
    return np.where(largest > 0.0, _USUAL / np.maximum(largest, 1e-300), 1.0)


def _of_distortion(source: Distortion, scene: Scene, used: Mask, make: _Make) -> Hypothesis:
    shift, columns = source.change(scene)
    acting = [j for j in range(scene.robot.n_joints) if np.any(columns[:, j]) or np.any(shift[used[:, j], j])]
    rows = {j: columns[:, j] for j in acting} if columns.shape[2] else {}
    shifts = {j: shift[:, j] for j in acting if np.any(shift[:, j])}
    typical = np.array(source.typical, dtype=float) if columns.shape[2] else np.zeros(0)
    sd = np.broadcast_to(typical, columns.shape[2:]).copy()
    return Hypothesis(source, Columns(rows, shifts, sd, np.zeros(len(sd), dtype=bool)), make)
