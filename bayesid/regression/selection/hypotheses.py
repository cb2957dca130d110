"""Hypotheses: every effect of the catalogue in every form, as columns on the log."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from bayesid.arrays import TINY, Array, Mask
from bayesid.effects import STANDARD, catalogue
from bayesid.effects.effect import Effect, Scene, effect_of
from bayesid.effects.friction import DryTerm
from bayesid.effects.model import Model
from bayesid.motion import Motion
from bayesid.regression.selection.columns import NO_COLUMNS, Columns, stacked
from bayesid.regression.tuning import TUNING

EffectKey = tuple[str, tuple[int, ...]]
"""Name of an effect, and its joints from 1."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A learned function with its uncertainty, for a figure."""

    variable: str  #: q4, dq5, ddq1, tau2 or t
    other: str  #: second variable of a function of two; empty otherwise
    turning: str  #: speed with whose direction it changes sign; empty if none
    x: Array  #: (g,) values of the variable over the range seen
    levels: Array  #: (k,) of the second variable, one curve each; a single one without it
    mean: Array  #: (k, g) N m
    sd: Array  #: (k, g) its standard deviation


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One form of an effect."""

    source: Effect  #: the term or distortion
    columns: Columns  #: its efforts on this log
    make: Callable[[Effect], Hypothesis] = field(repr=False, compare=False)  #: makes another form
    changes: tuple[str, ...] = ()  #: parameters of the model that would change, if it has the effect already
    curves: tuple[Curve, ...] = ()  #: functions of a learned effect

    @cached_property
    def effect(self) -> str:
        """Name of the effect, without its form."""
        return self.source.effect

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints from 1; empty: the whole robot."""
        return self.source.joints

    @cached_property
    def key(self) -> EffectKey:
        """Effect and joints, without the form."""
        return self.effect, self.joints

    @property
    def standard(self) -> bool:
        """Whether it belongs to the standard terms."""
        return self.source.name in STANDARD

    @property
    def beyond_numbers(self) -> bool:
        """Whether a distortion has more amplitudes than numbers, such as parameters that the model lacks."""
        return not self.source.linear and len(self.columns.sd) > sum(map(len, self.source.shape.values()))

    @property
    def alone(self) -> Hypothesis:
        """A copy with its own arrays, which keeps no other forms in memory."""
        return replace(self, columns=self.columns.alone)

    def remade(self, number: str, value: float) -> Hypothesis:
        """The same form with another nonlinear number."""
        numbers: dict[str, Any] = {number: (value,)}
        return self.make(replace(self.source, **numbers))


Library = Sequence[list[Hypothesis]]
"""Groups of forms with equal joints and numbers of amplitudes."""


def hypotheses(
    make: Callable[[Effect], Hypothesis],
    scene: Scene,
    *,
    effect: str | None = None,
    joints: tuple[int, ...] | None = None,
    refinements: bool = False,
) -> Iterator[list[Hypothesis]]:
    """Lists of forms with equal joints and numbers of amplitudes, for one call of `Regression.screened` each.

    From the whole catalogue, or of one effect and some joints (from 1) only. Distortions are linearised about the
    scene. `refinements` adds finer forms of standard terms.
    """
    for kind in catalogue.forms().values():
        name = effect_of(kind.name)
        if effect in (None, name) and (refinements or kind.name in STANDARD or name not in STANDARD):
            yield from _of_kind(kind, make, scene, joints)


def _of_kind(
    kind: type[Effect], make: Callable[[Effect], Hypothesis], scene: Scene, joints: tuple[int, ...] | None
) -> Iterator[list[Hypothesis]]:
    groups: dict[tuple[object, ...], list[Hypothesis]] = {}
    for source in kind.variants(scene):
        if joints in (None, source.joints):
            for hypothesis in _scaled(make(source)):
                columns = hypothesis.columns
                key = source.joints, len(columns.sd), tuple(sorted(columns.joints)), bool(columns.rows)
                groups.setdefault(key, []).append(hypothesis)
    for group in groups.values():
        together = stacked([hypothesis.columns for hypothesis in group])
        yield [replace(form, columns=columns) for form, columns in zip(group, together, strict=True)]


def maker(model: Model, scene: Scene, used: Mask) -> Callable[[Effect], Hypothesis]:
    """A function that makes the hypothesis of an effect, on a log with used samples (N, n)."""
    size = np.sqrt(np.sum((scene.measured * used) ** 2, axis=0) / np.maximum(used.sum(axis=0), 1))

    def make(source: Effect) -> Hypothesis:
        held = _held(source, model)
        source = source if held is None else held
        columns = _columns(source, scene, size, used, held is None)
        changes = () if held is None else tuple(parameter.name for parameter in source.parameters(scene.robot))
        return Hypothesis(source, columns, make, changes)

    return make


def _scaled(hypothesis: Hypothesis) -> list[Hypothesis]:
    """The hypothesis with each prior size of its effect; none if it has no effect on the log."""
    columns, typical = hypothesis.columns, np.atleast_2d(hypothesis.source.typical)
    if not columns.joints:
        return []
    sds = [np.broadcast_to(sd, columns.sd.shape) for sd in typical] if len(typical) > 1 else [columns.sd]
    return [replace(hypothesis, columns=replace(columns, sd=sd)) for sd in sds]


def _columns(source: Effect, scene: Scene, size: Array, used: Mask, new: bool) -> Columns:
    """Columns of a form; a change of an effect that the model has already (not `new`) may have either sign."""
    shifts, rows = source.change_by_joint(scene)
    shifts = {j: shift for j, shift in shifts.items() if j in rows or np.any(shift[used[:, j]])}
    if not rows and not shifts:
        return NO_COLUMNS
    if source.typical and rows:
        sd = np.broadcast_to(np.atleast_2d(source.typical)[0], next(iter(rows.values())).shape[1:]).copy()
    else:
        sd = usual_amplitudes(rows, size, used)
    positive = np.zeros(len(sd), dtype=bool)
    positive[source.cone(scene.robot).nonnegative] = new
    return Columns(rows, shifts, sd, positive)


def _held(source: Effect, model: Model) -> Effect | None:
    """The effect with the model's shape, if the model has all of its parameters already."""
    names = {parameter.name for parameter in model.parameters}
    if not {parameter.name for parameter in source.parameters(model.robot)} <= names:
        return None
    n = model.robot.n_joints
    for term in model.terms:
        if term.name == source.name and set(source.joints) <= {j + 1 for j in term.acting(n)}:
            return term.in_joints(source.joints, n) if source.joints else term
    return None


def usual_amplitudes(rows: Mapping[int, Array], size: Array, used: Mask) -> Array:
    """(p,) amplitudes at which each column has a usual effort in the joint where it is largest.

    Columns (N, p) by joint (0-based), with the joints' RMS efforts (n,), N m, over the used samples (N, n).
    """
    peaks = {j: np.abs(x.T.compress(used[:, j], axis=1)).max(axis=1, initial=0.0) for j, x in rows.items()}
    relative = [peak / max(size[j], TINY) for j, peak in peaks.items()]
    largest = np.max(relative, axis=0) if relative else np.zeros(0)
    return np.where(largest > 1e-12, TUNING.usual_effort / np.maximum(largest, TINY), 1.0)


def near_standstill(model: Model, motion: Motion, size: Array, used: Mask) -> Columns:
    """Error of a model's dry friction near reversals, where its shape is unknown.

    A term smooths the reversal as tanh(u' / v), with v the speed below which a log does not show the direction. A sharp
    reversal differs from it by tanh(k u' / v) - tanh(u' / v), up to one half at speeds about v. With little noise that
    is enough to imitate an effect at low speed (study `complete`, 8 bit). RMS efforts (n,), N m, over the used samples
    (N, n) give the amplitudes' prior.
    """
    columns = []
    for term in model.terms:
        if isinstance(term, DryTerm):
            at_once = replace(term, smoothing=tuple(speed / TUNING.sharper_turn for speed in term.smoothing))
            columns.append(at_once.columns(model.robot, motion) - term.columns(model.robot, motion))
    if not columns:
        return NO_COLUMNS
    turns = Columns.of_joints(np.concatenate(columns, axis=2))
    return replace(turns, sd=usual_amplitudes(turns.rows, size, used))
