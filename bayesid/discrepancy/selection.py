"""Selection of effects: by evidence on part of the data, confirmed by held-back data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from operator import attrgetter

import numpy as np
from scipy.special import logsumexp

from bayesid.discrepancy.case import Case
from bayesid.discrepancy.learned_functions import learn_effects
from bayesid.discrepancy.sets import EffectSet, EffectSets, Forms, WeighedSet, costs, form_of, score, weighed
from bayesid.discrepancy.tuning import TUNING
from bayesid.progress import SILENT, Progress, Steps, no_steps
from bayesid.regression.selection.added_effect import AddedEffect, Cost, preexisting, was_there, weigh
from bayesid.regression.selection.cross_validation import confirms, log_density, surely_better
from bayesid.regression.selection.error_model import ErrorModel
from bayesid.regression.selection.fitted_effects import LN10, FittedEffects, Observations
from bayesid.regression.selection.forward import select_forward
from bayesid.regression.selection.hypotheses import EffectKey, Hypothesis, Library, hypotheses
from bayesid.regression.selection.regression import Regression, explain
from bayesid.regression.selection.scores import at_unreliable_floor, best_forms, joint_sets, refined
from bayesid.regression.tuning import TUNING as REGRESSION

ON_LOG, HELD_BACK, GROWN = "log", "held-back data", "gap grew on held-back data"
"""Data that show an unexplained joint: residual above the floor on the log, or on held-back data; or one above it on
held-back data that grew when the model was identified again."""
_LOG_POSTERIOR = attrgetter("log_posterior")


@dataclass(frozen=True)
class Selection:
    """Effects that explain a log and are confirmed by held-back data."""

    chosen: EffectSet  #: the effects, in the order in which they were added
    before: FittedEffects  #: fit to the log without effects
    library: Library  #: all hypotheses
    #: minimal sets that predict held-back data equally well, most probable first, which is the chosen one
    sets: tuple[WeighedSet, ...]
    stopped: bool  #: whether the search stopped at its limit
    #: effects with enough evidence that held-back data do not confirm, or that explain too little; each with its set
    rejected: tuple[tuple[EffectSet, Hypothesis], ...]
    costs: tuple[Cost, ...]  #: cost of ignoring each effect

    @property
    def added(self) -> list[AddedEffect]:
        """The effects, with their probabilities over all sets and their alternatives in probable ones."""
        chosen, added = self.sets[0], []
        least = chosen.probability / TUNING.equivalent_odds
        probable = [other for other in self.sets if other.probability > least]
        for hypothesis in self.chosen.effects:
            effect, (name, joints) = self._weighed(self.chosen, hypothesis), hypothesis.key
            replacing = [key for other in probable for key in other.instead_of(hypothesis.key, chosen)]
            others = {effect_name for effect_name, where in replacing if where == joints}
            equivalent = tuple(sorted({*effect.equivalent, *others} - {name}))
            included = sum(other.probability for other in self.sets if hypothesis.key in other.effects)
            added.append(replace(effect, included=included, equivalent=equivalent))
        return added

    @property
    def refused(self) -> list[AddedEffect]:
        """The rejected effects; learned functions with a description."""
        refused, robot = [], self.chosen.case.model.robot
        for among, effect in self.rejected:
            amplitude, _ = among.fitted_effects.amplitude_of(effect)
            description = effect.source.description(robot, amplitude)
            refused.append(replace(self._weighed(among, effect), description=description))
        return refused

    def _weighed(self, among: EffectSet, effect: Hypothesis) -> AddedEffect:
        return weigh(among.fitted_effects, self.library, effect, among.case.uncertain)


def select_effects(case: Case, progress: Progress = SILENT) -> Selection:
    """Selects effects that explain the log and are confirmed by held-back data."""
    with progress.stage("effects: candidates"):
        data, library = _begin(case)
        before = explain(data, ())
    old = preexisting(before, library)
    library = [group for group in library if group and group[0].key not in old]
    nothing = EffectSet(case, before)
    sets = EffectSets(case, library, {nothing.forms: nothing})
    reliable = bool(data.reliable.all())
    best, unconfirmed = (
        (_most_probable(sets, nothing, progress), []) if reliable else _only_confirmed(sets, nothing, progress)
    )
    stopped = reliable and sets.n_fitted > TUNING.most_sets
    minimal = _confirmed_sets(sets, best, progress) if reliable else [best]
    with progress.stage("effects: learned functions") as steps:
        chosen, not_learned = learn_effects(_without_substitutes(sets, minimal[0]), sets.log_prior, steps)
    with progress.stage("effects: cost of each"):
        cost = costs(sets, chosen)
    passed = [*unconfirmed, *((among, effect) for among in (best, minimal[0]) for effect in among.effects)]
    rejected = {effect.key: (among, effect) for among, effect in passed if effect.key not in chosen.keys}
    return Selection(
        chosen=chosen,
        before=before,
        library=library,
        sets=weighed(minimal, chosen),
        stopped=stopped,
        rejected=(*(rejected[key] for key in sorted(rejected)), *not_learned),
        costs=cost,
    )


def _begin(case: Case) -> tuple[Observations, Library]:
    """The log with signs of the earlier model, its parameters adapted within their uncertainty, and all hypotheses."""
    predicted = case.before
    for _ in range(TUNING.alternations):
        predicted = case.modelled.effort(explain(case.data(predicted), ()))
    scene = case.modelled.scene(predicted)
    library = list(hypotheses(case.modelled.maker(scene), scene))
    refit = case.standard_refit
    return case.data(predicted, None if refit is None else refit.probability), library


# ---- On the log ----
def _most_probable(sets: EffectSets, nothing: EffectSet, progress: Progress) -> EffectSet:
    """The most probable set, starting from forward selection and from effects of the whole robot."""
    with progress.stage("effects: one by one"):
        chosen = _one_by_one(sets, nothing)
    with progress.stage("effects: sets, joint by joint") as steps:
        best = _improved(sets, chosen, steps)
    with progress.stage("effects: of several joints") as steps:
        several = _of_several_joints(sets, nothing)
        for done, effect in enumerate(several, start=1):
            if effect.key not in best.keys and sets.n_fitted <= TUNING.most_sets:
                tried = [sets.fit([*others, effect], best.data) for others in ((), best.effects)]
                other = polished(sets, max(tried, key=_LOG_POSTERIOR))
                best = _improved(sets, other) if other.log_posterior > best.log_posterior else best
            steps(done, len(several))
    return best


def _one_by_one(sets: EffectSets, chosen: EffectSet, excluded: Collection[EffectKey] = ()) -> EffectSet:
    """Forward selection; signs and numbers are fitted again after each pass, until nothing changes.

    If the earlier model was poor and the floor therefore uncertain, standard effects come first. Other effects are not
    tried in joints where these reach the floor, as real friction never fits a term exactly.
    """
    case, limits = sets.case, sets.case.thresholds
    seen = [chosen.keys]
    standard = not chosen.data.reliable.all() and not chosen.effects
    while True:
        errors, others = _ranked(sets, chosen, standard)
        others = [effect for effect in others if effect.key not in excluded]
        tried = [*chosen.effects, *others[: REGRESSION.short_list]]
        regression = Regression(chosen.data, tried, errors, case.uncertain, predicting=False)
        _, found = select_forward(
            regression, needed=case.needed, most=limits.max_effects, sharpen=case.modelled.sharper, start=chosen.keys
        )
        chosen = sets.fit(refined(chosen.data, found, sets.library), chosen.data, ())
        if not standard and chosen.keys in seen:
            return chosen
        seen.append(chosen.keys)
        standard = False


def _ranked(sets: EffectSets, chosen: EffectSet, standard: bool) -> tuple[Sequence[ErrorModel], list[Hypothesis]]:
    """All effects that may be added to a set, best first; only standard ones if so requested or near the floor."""
    regression = Regression.of(explain(chosen.data, chosen.effects, chosen.fitted_effects))
    closed = ~chosen.data.reliable if standard else at_unreliable_floor(chosen.data, chosen.fitted_effects.mean_square)
    allowed = [
        [h for h in group if h.standard or not all(closed[j] for j in h.columns.joints)]
        for group in sets.library
        if group[0].key not in chosen.keys
    ]
    scores = best_forms(regression, allowed)
    return regression.errors, [score.hypothesis for score in scores]


def _improved(sets: EffectSets, best: EffectSet, steps: Steps = no_steps) -> EffectSet:
    """The most probable set after searching whole sets of effects joint by joint, until none is better.

    `steps` counts fitted sets, of the largest number.
    """
    searches = Counter[int]()
    done = set[tuple[int, Forms]]()  # searched joints, with the effects elsewhere
    while True:
        joints = [j for j in _to_search(sets.case, best) if searches[j] < TUNING.searches_per_joint]
        pending = [search for search in ((j, _elsewhere(best, j)) for j in joints) if search not in done]
        if not pending or sets.n_fitted > TUNING.most_sets:
            return polished(sets, best)
        done.add(pending[0])
        steps(sets.n_fitted, TUNING.most_sets)
        joint = pending[0][0]
        searches[joint] += 1
        best = _improved_in(sets, sets.anchored(best), joint)


def _elsewhere(chosen: EffectSet, joint: int) -> Forms:
    return frozenset(map(form_of, chosen.without(*chosen.in_joint(joint))))


def _to_search(case: Case, chosen: EffectSet) -> list[int]:
    """Joints (from 0) above the floor, or with effects of several parameters, worst first."""
    ratio = np.sqrt(chosen.fitted_effects.mean_square)
    parameters = Counter[int]()
    for effect in chosen.effects:
        if len(effect.columns.joints) == 1:
            parameters.update({joint: len(effect.columns.sd) for joint in effect.columns.joints})
    above = {j for j, x in enumerate(ratio.tolist()) if x > REGRESSION.above_floor}
    several = {j for j, count in parameters.items() if count > TUNING.few_parameters}
    return sorted((j for j in above | several if chosen.data.reliable[j]), key=lambda j: -ratio[j])


def _improved_in(sets: EffectSets, best: EffectSet, joint: int) -> EffectSet:
    """The most probable set with other effects in one joint.

    Distortions are linearised about a prediction. If no set comes near the floor, each distortion is fitted alone first
    and other effects are searched beside it.
    """
    forms = [form for group in sets.library for form in group if form.columns.joints == {joint}]
    others = best.without(*best.in_joint(joint))
    tried = [best, *_with_sets_of(sets, others, best, joint, forms)]
    best = max(tried, key=_LOG_POSTERIOR)
    if _mean_square(best, joint) > REGRESSION.above_unreliable_floor**2:
        linear = [form for form in forms if form.source.linear]
        distortions = {form.source.name: form for form in forms if not form.source.linear}.values()
        bases = [sets.fit([*others, effect], best.data, {joint}, effect) for effect in distortions]
        for base in sorted(bases, key=lambda base: _mean_square(base, joint))[: TUNING.bases]:
            tried += [base, *_with_sets_of(sets, base.effects, base, joint, linear)]
    return max(tried, key=_LOG_POSTERIOR)


def _mean_square(chosen: EffectSet, joint: int) -> float:
    """Mean square residual of a joint, over that of the floor."""
    return float(chosen.fitted_effects.mean_square[joint])


def _with_sets_of(
    sets: EffectSets, others: Sequence[Hypothesis], chosen: EffectSet, joint: int, forms: Sequence[Hypothesis]
) -> list[EffectSet]:
    """`others` with sets of effects in one joint, the most probable few fitted fully."""
    data = chosen.data
    by_size: dict[int, list[tuple[float, tuple[Hypothesis, ...]]]] = {}
    for effects in joint_sets(data, joint, others, forms, sets.log_prior):
        by_size.setdefault(len(effects), []).append((sets.quick([*others, *effects], data), effects))
    best = [sorted(of_size, key=lambda pair: -pair[0])[: TUNING.sets_per_size] for of_size in by_size.values()]
    return [sets.fit([*others, *effects], data, {joint}) for of_size in best for _, effects in of_size]


def polished(sets: EffectSets, best: EffectSet) -> EffectSet:
    """The set with better forms and without unnecessary effects, as long as that makes it more probable.

    Forms are tried once only, as the reference changes with the set and the iteration might not end.
    """
    seen = set[Forms]()
    while best.effects and best.forms not in seen:
        seen.add(best.forms)
        best = sets.anchored(best)
        better = sets.fit(best.effects, best.data)
        fewer = max(sets.fewer(best), key=_LOG_POSTERIOR)
        if fewer.log_posterior > max(better.log_posterior, best.log_posterior) - sets.case.needed:
            best = fewer
        elif better.log_posterior > best.log_posterior + TUNING.noticed:
            best = better
    return best


def _of_several_joints(sets: EffectSets, nothing: EffectSet) -> list[Hypothesis]:
    """Effects that may explain residuals in several joints, best first."""
    regression = Regression.of(explain(nothing.data, (), nothing.fitted_effects))
    groups = [group for group in sets.library if len(group[0].columns.joints) > 1]
    scores = best_forms(regression, groups)
    return [score.hypothesis for score in scores[: TUNING.alternatives] if score.gain > sets.case.needed]


# ---- On held-back data ----
def _confirmed_sets(sets: EffectSets, chosen: EffectSet, progress: Progress) -> list[EffectSet]:
    """Minimal sets that predict held-back data equally well, most probable first.

    Sets without an effect of the chosen one, or with an alternative in its place, are fitted too. Each effect of a set
    needs evidence on the log beside the others.
    """
    seen, minimal = set[Forms](), [chosen]
    while chosen.forms not in seen and len(seen) < TUNING.rounds:
        seen.add(chosen.forms)
        with progress.stage("effects: alternatives") as steps:
            _fit_alternatives(sets, chosen, steps)
        with progress.stage("effects: held-back data"):
            minimal = minimal_sets(sets)
        chosen = minimal[0]
    return minimal


def _only_confirmed(
    sets: EffectSets, nothing: EffectSet, progress: Progress
) -> tuple[EffectSet, list[tuple[EffectSet, Hypothesis]]]:
    """Forward selection without effects that held-back data do not confirm, and these effects.

    Used if the floor is uncertain because the earlier model was poor. Sets are not compared then, as complex effects
    fit real friction slightly better than the missing effect.
    """
    chosen, unconfirmed = nothing, list[tuple[EffectSet, Hypothesis]]()
    while True:
        if len(unconfirmed) < TUNING.most_unconfirmed:
            with progress.stage("effects: one by one"):
                chosen = _one_by_one(sets, chosen, {effect.key for _, effect in unconfirmed})
        with progress.stage("effects: held-back data"):
            effect = _unconfirmed(sets, chosen)
        if effect is None:
            return chosen, unconfirmed
        unconfirmed.append((chosen, effect))
        chosen = sets.fit(chosen.without(effect), chosen.data, ())


def _unconfirmed(sets: EffectSets, chosen: EffectSet) -> Hypothesis | None:
    """The last effect that held-back data do not confirm beside the others."""
    least = sets.case.thresholds.held_back_improvement
    for effect in reversed(chosen.effects):
        fewer = sets.fit(chosen.without(effect), chosen.data, ())
        if not confirms(chosen.cross_validation_errors, fewer.cross_validation_errors, effect.columns.joints, least):
            return effect
    return None


def _fit_alternatives(sets: EffectSets, chosen: EffectSet, steps: Steps) -> None:
    """Fits sets without an effect of the chosen one, or with an alternative to one or two of its effects."""
    chosen = sets.anchored(chosen)
    sets.fewer(chosen)
    pairs = [(a, b) for a, b in combinations(chosen.effects, 2) if a.columns.joints == b.columns.joints]
    removed = [*((effect,) for effect in chosen.effects), *pairs]
    for done, replaced in enumerate(removed, start=1):
        for other in _alternatives(sets, chosen, replaced):
            sets.fit([*chosen.without(*replaced), other], chosen.data, other.columns.joints, other)
        steps(done, len(removed))


def minimal_sets(sets: EffectSets) -> list[EffectSet]:
    """Minimal sets that predict held-back data as well as the best one within the error, most probable first.

    The sd of the errors is the smallest residual of any set, at least the floor.
    """
    candidates = [candidate for candidate in sets.found.values() if not _unnecessary(sets, candidate)]
    score(candidates)
    cross_validation, limits = sets.case.cross_validation, sets.case.thresholds
    trial, residuals = cross_validation.trial, [candidate.cross_validation for candidate in candidates]
    floors = [candidate.data.floor for candidate in candidates]
    sd = np.min(np.maximum([trial.rms(residual) for residual in residuals], floors), axis=0)
    used = trial.used
    density = [cross_validation.by_block(log_density(residual, used, sd)) for residual in residuals]
    best = max(density, key=lambda of_blocks: float(of_blocks.sum()))
    least = 0.5 * limits.held_back_improvement * float(used.sum(axis=0).max())
    pairs = zip(candidates, density, strict=True)
    equal = [candidate for candidate, of_blocks in pairs if not surely_better(best, of_blocks, least)]
    minimal = [candidate for candidate in equal if not any(other.keys < candidate.keys for other in equal)]
    by_keys: dict[frozenset[EffectKey], list[float]] = {}
    for candidate in minimal:
        by_keys.setdefault(candidate.keys, []).append(candidate.log_posterior)
    over_forms = {keys: float(logsumexp(logs)) for keys, logs in by_keys.items()}
    return sorted(minimal, key=lambda candidate: (-over_forms[candidate.keys], -candidate.log_posterior))


def _unnecessary(sets: EffectSets, chosen: EffectSet) -> bool:
    """Whether a fitted set without one of the effects is about as probable, or the effect existed before."""
    for effect in chosen.effects:
        fewer = sets.found.get(chosen.forms - {form_of(effect)})
        if fewer is None:
            continue
        if fewer.log_posterior > chosen.log_posterior - sets.case.needed:
            return True
        if effect.source.of_table and was_there(chosen.fitted_effects, fewer.fitted_effects):
            return True
    return False


def _alternatives(sets: EffectSets, chosen: EffectSet, replaced: tuple[Hypothesis, ...]) -> list[Hypothesis]:
    """Alternatives to one or two effects: other effects or forms with a similar gain."""
    regression = Regression.of(explain(chosen.data, chosen.without(*replaced), chosen.fitted_effects))
    keys = {effect.key for effect in replaced}
    joints, forms = replaced[0].columns.joints, set(map(form_of, replaced))
    by_form: dict[EffectKey, list[list[Hypothesis]]] = {}
    for group in sets.library:
        if group[0].columns.joints & joints and group[0].key not in chosen.keys - keys:
            by_form.setdefault(form_of(group[0]), []).append(group)
    scores = {form: best_forms(regression, groups)[0] for form, groups in by_form.items()}
    gain = max((scores[form].gain for form in forms & set(scores)), default=np.inf)
    competing = sorted((scores[form] for form in set(scores) - forms), key=lambda score: -score.gain)
    return [score.hypothesis for score in competing[: TUNING.alternatives] if score.gain > gain - TUNING.nearly * LN10]


# ---- Unexplained joints ----
def _without_substitutes(sets: EffectSets, chosen: EffectSet) -> EffectSet:
    """The set without effects of unexplained joints, unless they explain most of the excess."""
    case = sets.case
    for joint in case.unexplained(chosen.fitted_effects, chosen.predicted):
        of_joint = chosen.in_joint(joint - 1)
        others = sets.fit(chosen.without(*of_joint), chosen.data, ())
        before, after = (
            case.cross_validation.trial.rms(effects.cross_validation)[joint - 1] ** 2 for effects in (others, chosen)
        )
        if of_joint and before - after < TUNING.explained_share * (before - chosen.data.floor[joint - 1] ** 2):
            chosen = others
    return chosen
