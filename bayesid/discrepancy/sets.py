"""Sets of effects: each fitted with its own signs, with its evidence on the log and its errors on held-back data."""

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
"""Forms of a set's effects, with their joints."""


@dataclass(frozen=True)
class WeighedSet:
    """A set of effects and its probability."""

    effects: tuple[EffectKey, ...]  #: names and joints
    probability: float  #: given the log, among minimal sets that predict held-back data equally well

    def instead_of(self, key: EffectKey, chosen: WeighedSet) -> tuple[EffectKey, ...]:
        """Effects of this set in place of one of the chosen set; empty if this set has that effect too."""
        if key in self.effects:
            return ()
        return tuple(other for other in self.effects if other not in chosen.effects and set(other[1]) & set(key[1]))


@dataclass(frozen=True, eq=False)
class EffectSet:
    """Effects in the order in which they were added, and their fit to the log, with signs estimated under it."""

    case: Case
    fitted_effects: FittedEffects
    log_prior: float = 0.0

    @property
    def effects(self) -> tuple[Hypothesis, ...]:
        """In the order in which they were added."""
        return self.fitted_effects.effects

    @property
    def data(self) -> Observations:
        """The log with these signs."""
        return self.fitted_effects.data

    def without(self, *removed: Hypothesis) -> tuple[Hypothesis, ...]:
        """The effects without some."""
        return self.fitted_effects.without(*removed)

    def in_joint(self, joint: int) -> tuple[Hypothesis, ...]:
        """The effects that act in a (0-based) joint alone."""
        return tuple(effect for effect in self.effects if effect.columns.joints == {joint})

    @cached_property
    def keys(self) -> frozenset[EffectKey]:
        """Effects and joints, in any form."""
        return frozenset(effect.key for effect in self.effects)

    @cached_property
    def forms(self) -> Forms:
        """Forms and joints."""
        return frozenset(form_of(effect) for effect in self.effects)

    @property
    def predicted(self) -> Array:
        """(N, n) fitted efforts, N m."""
        return self.case.modelled.effort(self.fitted_effects)

    def explained(self, effects: Effects | None = None) -> FittedEffects:
        """A new fit of its log by given effects or its own, with possible geometry errors."""
        return explain(self.data, self.effects if effects is None else effects, None, self.case.uncertain)

    @cached_property
    def log_posterior(self) -> float:
        """Log evidence and prior, up to a constant, with possible geometry errors."""
        return self.log_evidence_of(self.effects) + self.log_prior

    def log_evidence_of(self, effects: Effects) -> float:
        """Log evidence of given effects, started from this fit, with possible geometry errors."""
        return explain(self.data, effects, self.fitted_effects, self.case.uncertain).log_evidence

    @cached_property
    def extension(self) -> Extension:
        """The extended model with feasible parameters; negative friction would predict too well.

        With a learned function the parameters stay those of the fit, as only its prior determines a function's shape.
        """
        learned = any(isinstance(effect.source, LearnedEffect) for effect in self.effects)
        if learned and not any(effect.beyond_numbers for effect in self.effects):
            return self.case.modelled.extended(self.fitted_effects)
        return self.refitted

    @cached_property
    def refitted(self) -> Extension:
        """The extended model with feasible parameters."""
        return self.case.refitted(self.case.modelled.extended(self.fitted_effects), self.predicted)

    @cached_property
    def cross_validation(self) -> Array:
        """(N, n) residual of the extended model on held-back data, N m; zero for samples that do not count."""
        return self._held_back(self.extension.theta)

    @property
    def cross_validation_errors(self) -> CrossValidation:
        """The same by blocks."""
        return self.case.cross_validation.errors(self.cross_validation)

    def cross_validation_without(self, term: Effect) -> Array:
        """(N, n) the same with a term set to zero and other parameters unchanged."""
        parts = [size * (other != term) for other, size in self.extension.model.parts(self.extension.theta)]
        return self._held_back(np.concatenate(parts))

    def _held_back(self, theta: Array) -> Array:
        case = self.case
        return case.cross_validation.trial.residual(
            case.cross_validation.effort(case.model, self.extension.model, theta)
        )


def form_of(effect: Hypothesis) -> EffectKey:
    """Name of an effect's form, and its joints."""
    return effect.source.name, effect.joints


def score(sets: Sequence[EffectSet]) -> None:
    """Computes the `cross_validation` of sets in several processes."""
    missing = [effect_set for effect_set in sets if "cross_validation" not in vars(effect_set)]
    residuals = in_parallel([partial(getattr, effect_set, "cross_validation") for effect_set in missing])
    for effect_set, residual in zip(missing, residuals, strict=True):
        vars(effect_set)["cross_validation"] = residual  # where the cached property keeps it


@dataclass(frozen=True, eq=False)
class EffectSets:
    """Fitted sets, and the most probable one of each combination of forms (`found`)."""

    case: Case
    library: Library
    found: dict[Forms, EffectSet] = field(default_factory=dict)
    _fits: dict[tuple[object, ...], tuple[EffectSet, object]] = field(default_factory=dict)

    def fit(
        self,
        effects: Effects,
        data: Observations,
        joints: Collection[int] | None = None,
        kept: Hypothesis | None = None,
    ) -> EffectSet:
        """Fits effects in their best forms and with their best numbers, and estimates the signs under them.

        Args:
            effects: the effects.
            data: the log with signs under similar effects.
            joints: (0-based) joints whose effects may change their form and numbers; by default all.
            kept: an effect that keeps its form, though not its numbers.
        """
        key = (*sorted(joints or ()), joints is None, id(kept), *(id(effect) for effect in effects))
        if key not in self._fits:
            alive = (*effects, kept)  # so that their ids stay unique
            effects = refined(data, self._in_best_forms(effects, data, joints, kept), self.library, joints)
            fitted_effects = self.case.modelled.sharpened(data, effects)
            data = replace(self.case.data_under(fitted_effects), reference=data.reference)
            fitted_effects = explain(data, fitted_effects.effects, fitted_effects)
            made = EffectSet(self.case, fitted_effects, sum(map(self.log_prior, fitted_effects.effects)))
            self._fits[key] = made, alive
            other = self.found.get(made.forms)
            if other is None or made.log_posterior > other.log_posterior:
                self.found[made.forms] = made
        return self._fits[key][0]

    def fewer(self, chosen: EffectSet) -> list[EffectSet]:
        """The sets without one of its effects, numbers and signs in its joints fitted again."""
        return [self.fit(chosen.without(effect), chosen.data, effect.columns.joints) for effect in chosen.effects]

    def anchored(self, chosen: EffectSet) -> EffectSet:
        """The set as a reference: sets with the same effects are compared under its error model."""
        anchor = explain(replace(chosen.data, reference=None), chosen.effects)
        return replace(
            chosen, fitted_effects=replace(chosen.fitted_effects, data=replace(chosen.data, reference=anchor))
        )

    @property
    def n_fitted(self) -> int:
        """Number of sets fitted so far."""
        return len(self._fits)

    def quick(self, effects: Effects, data: Observations) -> float:
        """Log posterior of effects in these forms and with these signs."""
        return explain(data, effects).log_evidence + sum(map(self.log_prior, effects))

    def log_prior(self, effect: Hypothesis) -> float:
        """Log prior odds of an effect in one form against no missing effect."""
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
        """Each effect in its most probable form beside the others.

        Distortions are compared with plain errors: wrong thresholds and lags leave residuals that resemble slow noise.
        """
        effects = list(effects)
        for k, effect in enumerate(effects):
            elsewhere = joints is not None and effect.columns.joints.isdisjoint(joints)
            if elsewhere or self._forms[effect.key] == 1:
                continue  # the number of a distortion is better than the library's
            others = explain(data, [*effects[:k], *effects[k + 1 :]])
            groups = self._forms_of(effect, effects, data)
            if effect is kept:
                groups = [group for group in groups if group[0].source.name == effect.source.name]
            errors = others.errors if effect.source.linear else plain_errors(data)
            best = best_forms(Regression.of(others).weighed(errors), groups)
            effects[k] = best[0].hypothesis if best else effect
        return effects

    def _forms_of(self, effect: Hypothesis, effects: Effects, data: Observations) -> Library:
        """The library's forms of an effect; those of a distortion about the effort by all effects."""
        if effect.source.linear:
            return [group for group in self.library if group[0].key == effect.key]
        modelled = self.case.modelled
        scene = modelled.scene(modelled.effort(explain(data, effects), distorted=False))
        return list(hypotheses(modelled.maker(scene), scene, effect=effect.effect, joints=effect.joints))


def weighed(smallest: Sequence[EffectSet], chosen: EffectSet) -> tuple[WeighedSet, ...]:
    """Sets and their probabilities, most probable first; sets of the same effects in other forms are one.

    The smallest sets come most probable first. The effects in which the first differs from the chosen set are added to
    all, or left out of all.
    """
    logs = np.array([effect_set.log_posterior for effect_set in smallest])
    probability: dict[frozenset[EffectKey], float] = {}
    for effect_set, share in zip(smallest, np.exp(logs - logsumexp(logs)).tolist(), strict=True):
        keys = (effect_set.keys - (smallest[0].keys - chosen.keys)) | (chosen.keys - smallest[0].keys)
        probability[keys] = probability.get(keys, 0.0) + share
    order = sorted(probability, key=lambda keys: -probability[keys])
    return tuple(WeighedSet(_in_order(keys, chosen), probability[keys]) for keys in order)


def _in_order(keys: frozenset[EffectKey], chosen: EffectSet) -> tuple[EffectKey, ...]:
    known = [effect.key for effect in chosen.effects if effect.key in keys]
    return (*known, *sorted(keys - set(known)))


def costs(sets: EffectSets, chosen: EffectSet) -> tuple[Cost, ...]:
    """Errors of a chosen set, and of the set without each effect, numbers and signs fitted again."""
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
