"""Sets of effects: each settled with signs of its own, weighed by the log, and scored by held-back data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from scipy.special import logsumexp

from bayesid.arrays import TINY, Array
from bayesid.discrepancy.case import Case
from bayesid.effects.catalogue import main_forms
from bayesid.effects.effect import Effect
from bayesid.effects.learned_effect import LearnedEffect
from bayesid.parallel import in_parallel
from bayesid.regression.selection.added_effect import Cost
from bayesid.regression.selection.cross_validation import CrossValidation
from bayesid.regression.selection.fitted_effects import FittedEffects, Observations
from bayesid.regression.selection.hypotheses import EffectKey, Hypothesis, Library, hypotheses
from bayesid.regression.selection.modelled_log import Extension
from bayesid.regression.selection.regression import Effects, Regression, explain, plain_errors
from bayesid.regression.selection.scores import best_forms, refined

Forms = frozenset[EffectKey]
"""Names of the forms of a set's effects, and their joints."""


@dataclass(frozen=True)
class WeighedSet:
    """A set of effects and how probable it is."""

    effects: tuple[EffectKey, ...]  #: names and joints
    #: given the log, among sets that predict held-back data as well as any, and no part of which does
    probability: float

    def without(self, key: EffectKey, chosen: WeighedSet) -> tuple[EffectKey, ...]:
        """What stands in the place of one effect of a chosen set; nothing where that is here as well."""
        if key in self.effects:
            return ()
        return tuple(other for other in self.effects if other not in chosen.effects and set(other[1]) & set(key[1]))


@dataclass(frozen=True, eq=False)
class EffectSet:
    """Effects in the order in which they were added, and the explanation by them of the log, signs settled under it."""

    case: Case
    fitted_effects: FittedEffects
    log_prior: float = 0.0

    @property
    def effects(self) -> tuple[Hypothesis, ...]:
        """In the order in which they were added."""
        return self.fitted_effects.effects

    @property
    def data(self) -> Observations:
        """The log, its signs settled."""
        return self.fitted_effects.data

    def without(self, *gone: Hypothesis) -> tuple[Hypothesis, ...]:
        """The effects but some."""
        return self.fitted_effects.without(*gone)

    def in_joint(self, joint: int) -> tuple[Hypothesis, ...]:
        """The effects that act in a (0-based) joint alone."""
        return tuple(effect for effect in self.effects if effect.columns.joints == {joint})

    @cached_property
    def keys(self) -> frozenset[EffectKey]:
        """Effects and joints, whatever the form."""
        return frozenset(effect.key for effect in self.effects)

    @cached_property
    def forms(self) -> Forms:
        """Names of the forms, and their joints."""
        return frozenset(form_of(effect) for effect in self.effects)

    @property
    def predicted(self) -> Array:
        """(N, n) efforts of the explanation, N m."""
        return self.case.modelled.effort(self.fitted_effects)

    def explained(self, effects: Effects | None = None) -> FittedEffects:
        """Its log by some effects or its own, from scratch, beside what the geometry may be wrong by in any case."""
        return explain(self.data, self.effects if effects is None else effects, None, self.case.uncertain)

    @cached_property
    def log_posterior(self) -> float:
        """Log evidence and prior, up to a constant: beside what the geometry may be wrong by in any case."""
        return self.log_evidence_of(self.effects) + self.log_prior

    def log_evidence_of(self, effects: Effects) -> float:
        """Of some effects, from this explanation on, beside what the geometry may be wrong by."""
        return explain(self.data, effects, self.fitted_effects, self.case.uncertain).log_evidence

    @cached_property
    def extension(self) -> Extension:
        """The model with them, its parameters feasible: friction that is negative predicts what no model of it will.

        With a learned function they stay those of the explanation: only its prior holds a function's shape.
        """
        learned = any(isinstance(effect.source, LearnedEffect) for effect in self.effects)
        if learned and not any(effect.beyond_numbers for effect in self.effects):
            return self.case.modelled.extended(self.fitted_effects)
        return self.refitted

    @cached_property
    def refitted(self) -> Extension:
        """The model with them and feasible parameters."""
        return self.case.refitted(self.case.modelled.extended(self.fitted_effects), self.predicted)

    @cached_property
    def cross_validation(self) -> Array:
        """(N, n) what the model with them leaves of the held-back data, N m, zero where they do not count."""
        return self._held_back(self.extension.theta)

    @property
    def cross_validation_errors(self) -> CrossValidation:
        """The same by blocks."""
        return self.case.cross_validation.errors(self.cross_validation)

    def held_back_less(self, term: Effect) -> Array:
        """(N, n) the same with a term of it at zero, all else as it is."""
        parts = [amplitudes * (one != term) for one, amplitudes in self.extension.model.parts(self.extension.theta)]
        return self._held_back(np.concatenate(parts))

    def _held_back(self, theta: Array) -> Array:
        case = self.case
        return case.cross_validation.trial.residual(
            case.cross_validation.effort(case.model, self.extension.model, theta)
        )


def form_of(effect: Hypothesis) -> EffectKey:
    """Name of an effect's form, and its joints."""
    return effect.source.name, effect.joints


def score(some: Sequence[EffectSet]) -> None:
    """Makes ready what sets leave of the held-back data, in several processes: each is fitted again, in the cone."""
    left = [one for one in some if "cross_validation" not in vars(one)]
    for one, residual in zip(
        left, in_parallel([partial(getattr, one, "cross_validation") for one in left]), strict=True
    ):
        vars(one)["cross_validation"] = residual  # as a cached property keeps it


@dataclass(frozen=True, eq=False)
class EffectSets:
    """Sets that were looked at: of the same forms (`found`) with different numbers the likeliest."""

    case: Case
    library: Library
    found: dict[Forms, EffectSet] = field(default_factory=dict)
    _settled: dict[tuple[object, ...], tuple[EffectSet, object]] = field(default_factory=dict)

    def settled(
        self,
        effects: Effects,
        data: Observations,
        joints: Collection[int] | None = None,
        kept: Hypothesis | None = None,
    ) -> EffectSet:
        """Effects in their best forms, with their best numbers, signs settled under them; the data under nearly these.

        Effects that act in none of some (0-based) joints keep their forms and numbers; by default none does. The form
        of the one that is kept stays while its numbers may change.
        """
        key = (*sorted(joints or ()), joints is None, id(kept), *(id(effect) for effect in effects))
        if key not in self._settled:
            asked = (*effects, kept)  # lest others take their ids
            effects = refined(data, self._in_best_forms(effects, data, joints, kept), self.library, joints)
            fitted_effects = self.case.modelled.sharpened(data, effects)
            data = replace(self.case.settled(fitted_effects), reference=data.reference)
            fitted_effects = explain(data, fitted_effects.effects, fitted_effects)
            made = EffectSet(self.case, fitted_effects, sum(map(self.log_prior, fitted_effects.effects)))
            self._settled[key] = made, asked
            other = self.found.get(made.forms)
            if other is None or made.log_posterior > other.log_posterior:
                self.found[made.forms] = made
        return self._settled[key][0]

    def fewer(self, chosen: EffectSet) -> list[EffectSet]:
        """A set without each of its effects, numbers and signs in their joints found anew."""
        return [self.settled(chosen.without(one), chosen.data, one.columns.joints) for one in chosen.effects]

    def anchored(self, chosen: EffectSet) -> EffectSet:
        """A set that others are compared with: where they have the same effects, what is left is judged alike."""
        anchor = explain(replace(chosen.data, reference=None), chosen.effects)
        return replace(
            chosen, fitted_effects=replace(chosen.fitted_effects, data=replace(chosen.data, reference=anchor))
        )

    @property
    def looked_at(self) -> int:
        """Sets that were settled so far."""
        return len(self._settled)

    def quick(self, effects: Effects, data: Observations) -> float:
        """Log posterior of effects in these forms, with signs as they are."""
        return explain(data, effects).log_evidence + sum(map(self.log_prior, effects))

    def log_prior(self, effect: Hypothesis) -> float:
        """Of an effect in one form to be missing, over nothing to be missing in its place."""
        limits = self.case.thresholds
        share = (1.0 - limits.nothing_missing - limits.something_else) / len(main_forms())
        places = self.case.trial.used.shape[1] if effect.joints else 1
        return float(np.log(share / places / limits.nothing_missing / max(self._forms[effect.key], 1)))

    @cached_property
    def _forms(self) -> Counter[EffectKey]:
        return Counter(form.key for group in self.library for form in group)

    def _in_best_forms(
        self, effects: Effects, data: Observations, joints: Collection[int] | None, kept: Hypothesis | None
    ) -> list[Hypothesis]:
        """Each effect in the form that is likeliest beside the others.

        A distortion in the one that explains most: thresholds and lags that are far off leave what looks like slow
        noise, which they are then judged by.
        """
        effects = list(effects)
        for k, effect in enumerate(effects):
            elsewhere = joints is not None and effect.columns.joints.isdisjoint(joints)
            if elsewhere or self._forms[effect.key] == 1:
                continue  # there is no other, and a distortion's number is better than the library's
            others = explain(data, [*effects[:k], *effects[k + 1 :]])
            groups = self._forms_of(effect, effects, data)
            if effect is kept:
                groups = [group for group in groups if group[0].source.name == effect.source.name]
            errors = others.errors if effect.source.linear else plain_errors(data)
            best = best_forms(Regression.of(others).weighed(errors), groups)
            effects[k] = best[0].hypothesis if best else effect
        return effects

    def _forms_of(self, effect: Hypothesis, effects: Effects, data: Observations) -> Library:
        """The library's forms of an effect; of a distortion those about what all effects together make."""
        if effect.source.linear:
            return [group for group in self.library if group[0].key == effect.key]
        modelled = self.case.modelled
        scene = modelled.scene(modelled.effort(explain(data, effects), distorted=False))
        return list(hypotheses(modelled.maker(scene), scene, effect=effect.effect, joints=effect.joints))


def weighed(smallest: Sequence[EffectSet], chosen: EffectSet) -> tuple[WeighedSet, ...]:
    """Sets and their probabilities, those of the same effects in other forms as one; likeliest first.

    The smallest sets come likeliest first; what was added to the first or left out of it, until it became the chosen
    one, was so of all.
    """
    logs = np.array([one.log_posterior for one in smallest])
    probability: dict[frozenset[EffectKey], float] = {}
    for one, share in zip(smallest, np.exp(logs - logsumexp(logs)).tolist(), strict=True):
        keys = (one.keys - (smallest[0].keys - chosen.keys)) | (chosen.keys - smallest[0].keys)
        probability[keys] = probability.get(keys, 0.0) + share
    order = sorted(probability, key=lambda keys: -probability[keys])
    return tuple(WeighedSet(_in_order(keys, chosen), probability[keys]) for keys in order)


def _in_order(keys: frozenset[EffectKey], chosen: EffectSet) -> tuple[EffectKey, ...]:
    known = [effect.key for effect in chosen.effects if effect.key in keys]
    return (*known, *sorted(keys - set(known)))


def costs(sets: EffectSets, chosen: EffectSet) -> tuple[Cost, ...]:
    """Of each effect of a chosen set: of the set without it, numbers and signs found anew, and of the set itself."""
    trial, without = sets.case.cross_validation.trial, sets.fewer(chosen)
    score([chosen, *without])
    after, effort = trial.rms(chosen.cross_validation), trial.rms(np.where(trial.used, trial.magnitude, 0.0))
    found = []
    for effect, fewer in zip(chosen.effects, without, strict=True):
        before = trial.rms(fewer.cross_validation)
        rise = (before**2 - after**2) / np.maximum(effort**2, TINY)
        joint = max(sorted(effect.columns.joints), key=lambda j: float(rise[j]))
        found.append(Cost(joint + 1, float(before[joint]), float(after[joint]), float(effort[joint])))
    return tuple(found)
