"""Hypotheses that a motion is to distinguish: named by the user, or equivalent in a discrepancy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from bayesid.discrepancy.numbers import CHANGE_OF
from bayesid.effects import catalogue
from bayesid.effects.catalogue import main_forms
from bayesid.errors import InputError
from bayesid.regression.selection.added_effect import AddedEffect
from bayesid.regression.selection.hypotheses import EffectKey

REMEDY = "give effects with their joints, as in stribeck_friction:3,thermal_drift:3 (docs/discrepancy.md has all)"
Changes = Mapping[EffectKey, Mapping[str, float]]
"""Hypotheses that change parameters of a term, with the change of each parameter if the result has it."""
Classes = tuple[tuple[EffectKey, ...], ...]
"""Classes of hypotheses; those of one class are to be distinguished."""


@dataclass(frozen=True)
class Hypotheses:
    """Classes of effects to be distinguished, and which of them are changes of a term."""

    classes: Classes = ()
    changed: Changes = field(default_factory=dict)


def hypotheses_of(names: Sequence[str]) -> Hypotheses:
    """One class by its names, as in ("stribeck_friction:3", "thermal_drift:3"); none if there are no names."""
    return Hypotheses((tuple(map(parse_key, names)),) if names else ())


def hypotheses_after(found: Sequence[AddedEffect], classes: Classes, *, equivalents: bool) -> Hypotheses:
    """Hypotheses of a discrepancy; without `classes`, its equivalent effects if `equivalents` is true."""
    changed: dict[EffectKey, dict[str, float]]
    changed = {score.key: {} for added in found for score in added.competing if score.hypothesis.changes}
    for added in found:
        if names := added.hypothesis.changes:
            changed[added.hypothesis.key] = {name: added.parameters[f"{CHANGE_OF}{name}"][0] for name in names}
    if equivalents and not classes:
        classes = equivalent_classes([(added.effect, added.joints, _equivalents(added)) for added in found])
    return Hypotheses(classes, changed)


def _equivalents(added: AddedEffect) -> dict[str, tuple[int, ...] | None]:
    joints = {score.hypothesis.effect: score.key[1] for score in reversed(added.competing)}  # the best of each name
    return {name: joints.get(name) for name in added.equivalent}


def equivalent_classes(found: Sequence[tuple[str, tuple[int, ...], Mapping[str, tuple[int, ...] | None]]]) -> Classes:
    """Classes of hypotheses that a log could not distinguish, from effects, their joints and equivalent effects.

    None for the joints of an equivalent means the same joints, or the whole robot for effects that act on it.
    """
    whole = {name for name, kind in main_forms().items() if kind.acts_on == "robot"}

    def key(effect: str, joints: tuple[int, ...] | None, default: tuple[int, ...]) -> EffectKey:
        return effect, joints if joints is not None else () if effect in whole else default

    return tuple(
        ((effect, joints), *(key(name, where, joints) for name, where in others.items()))
        for effect, joints, others in found
        if others
    )


def parse_key(text: str) -> EffectKey:
    """An effect and its joints, from a name as `stribeck_friction:3`."""
    effect, *joints = text.strip().split(":")
    if effect not in {kind.name.split(".")[0] for kind in catalogue.forms().values()}:
        raise InputError(f"{effect!r} is not an effect of the catalogue", field="between", remedy=REMEDY)
    try:
        return effect, tuple(int(joint) for joint in joints if joint)
    except ValueError:
        raise InputError(f"{text!r}: joints are whole numbers", field="between", remedy=REMEDY) from None
