"""Learned effects: functions of joints that the catalogue leaves above the noise floor."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from bayesid.discrepancy.sets import EffectSet
from bayesid.discrepancy.tuning import TUNING
from bayesid.effects.learned_effect import LearnedEffect
from bayesid.progress import Steps, no_steps
from bayesid.regression.selection.cross_validation import CrossValidation, confirms
from bayesid.regression.selection.hypotheses import Hypothesis
from bayesid.regression.selection.learned import Finder, Learned
from bayesid.regression.selection.regression import Effects, explain


def learn_effects(
    state: EffectSet, log_prior: Callable[[Hypothesis], float], steps: Steps = no_steps
) -> tuple[EffectSet, list[tuple[EffectSet, Hypothesis]]]:
    """Adds functions in joints that stay above the floor; also returns those that held-back data do not confirm.

    Effects of the catalogue in such a joint may be substitutes for an effect outside the catalogue. A function is
    learned beside them and, if none helps, in their place; effects without which the prediction of held-back data is
    significantly better are refused. Several effects in a joint at the floor may also be substitutes: one function
    replaces them if it is more probable. `log_prior` is the log prior odds of an effect of the catalogue.
    `steps` counts joints.
    """
    refused: list[tuple[EffectSet, Hypothesis]] = []
    joints = _above_floor(state)
    for done, joint in enumerate(joints):
        steps(done, len(joints))
        learned, rejected = _in_joint(state, joint)
        of_joint = state.in_joint(joint - 1)
        if of_joint and (learned is state or joint in _above_floor(learned)):
            others = state.without(*of_joint)
            alone, rejected_alone = _in_joint(_refit(others, state), joint)
            before, after = learned.cross_validation_errors, alone.cross_validation_errors
            if confirms(after, before, {joint - 1}, state.case.thresholds.held_back_improvement):
                none_learned = len(alone.effects) == len(others)
                learned, rejected = alone, [*((state, effect) for effect in of_joint if none_learned), *rejected_alone]
            elif learned is state:
                rejected = rejected or rejected_alone
        state, refused = learned, refused + rejected
    for joint in _with_several(state):
        state = _by_one_function(state, joint, log_prior)
    return state, refused


def _with_several(state: EffectSet) -> list[int]:
    """Joints (from 1) with several effects of the catalogue that act in it alone, and without a learned one."""
    joints = [next(iter(effect.columns.joints)) + 1 for effect in state.effects if len(effect.columns.joints) == 1]
    learned = {joint for effect in state.effects if isinstance(effect.source, LearnedEffect) for joint in effect.joints}
    return sorted(joint for joint, count in Counter(joints).items() if count > 1 and joint not in learned)


def _by_one_function(state: EffectSet, joint: int, log_prior: Callable[[Hypothesis], float]) -> EffectSet:
    """One function in place of several effects in a joint (from 1), if it is more probable and predicts as well.

    Functions that explain less than half of what the effects explain, before signs are estimated again, are not tried.
    """
    needed, limits, of_joint = state.case.needed, state.case.thresholds, state.in_joint(joint - 1)
    bare = _refit(state.without(*of_joint), state)
    finder, evidence = _finder(bare, joint), _log_evidence(state)
    least = max(needed, TUNING.near_best * (evidence - _log_evidence(bare)))
    ranked = finder.ranked(bare.explained())
    found = _best_confirmed(finder, bare, [function for function in ranked if function.gain > least], needed)
    if found is None:
        return state
    extended, function = found
    prior = np.log(limits.something_else / limits.nothing_missing / state.data.used.shape[1]) - function.price
    gain = _log_evidence(extended) + prior - evidence - sum(map(log_prior, of_joint))
    by_one = _merged(finder, extended, [function])
    if gain < needed or confirms(
        state.cross_validation_errors, by_one.cross_validation_errors, {joint - 1}, limits.held_back_improvement
    ):
        return state
    return by_one


def _log_evidence(state: EffectSet) -> float:
    """Log evidence of a set under the error model of its own residual."""
    fitted = replace(state.fitted_effects, data=replace(state.data, reference=None))
    return replace(state, fitted_effects=fitted).log_evidence_of(state.effects)


def _above_floor(state: EffectSet) -> list[int]:
    """Joints (from 1) with a residual significantly above a reliable floor, on the log or held-back, worst first."""
    case, predicted, unseen = state.case, state.predicted, state.cross_validation_errors
    floor, gap, on_log = (
        case.floor(predicted),
        case.trial.gap(predicted),
        case.unexplained(state.fitted_effects, predicted),
    )
    cross_validation = unseen.surely_above(floor.rms) & floor.exceeded(unseen.rms)
    ratio = np.maximum(gap, unseen.rms) / floor.rms
    return [int(j) + 1 for j in np.argsort(-ratio) if floor.reliable[j] and (j + 1 in on_log or cross_validation[j])]


def _in_joint(state: EffectSet, joint: int) -> tuple[EffectSet, list[tuple[EffectSet, Hypothesis]]]:
    """A learned effect in a joint (from 1), if held-back data confirm it; else the effect that they reject."""
    found: list[Learned] = []
    passed: list[Learned] = []
    needed, now, finder = state.case.needed, state, _finder(state, joint)
    while len(found) < TUNING.most_functions and not (found and _is_noise(now, joint, needed)):
        ranked = finder.ranked(now.explained())
        passed = [learned for learned in ranked if learned.gain > needed]
        confirmed = _best_confirmed(finder, now, passed, needed)
        if confirmed is None:
            break
        now, found = _fitted_again(finder, confirmed[0], [*found, confirmed[1]], needed)
    if not found:
        rejected = [function.hypothesis for function in passed[:1]]
        return state, [(_refit((*now.effects, function), now), function) for function in rejected]
    merged = _merged(finder, now, found)
    if not _explains_most(state, merged, joint):
        return state, [(merged, merged.effects[-1])]
    return _without_unnecessary(merged, merged.effects[-1], needed), []


def _explains_most(without: EffectSet, with_function: EffectSet, joint: int) -> bool:
    """Whether a function explains most of the excess on held-back data in a joint (from 1).

    Otherwise it is a substitute for another error, such as that of the robot's table. Effects of the catalogue need the
    same share.
    """
    before, after = (state.cross_validation_errors.rms[joint - 1] ** 2 for state in (without, with_function))
    excess = before - without.data.floor[joint - 1] ** 2
    return bool(before - after >= TUNING.explained_share * excess)


def _finder(state: EffectSet, joint: int) -> Finder:
    scene = state.case.modelled.scene(state.predicted)
    return Finder(scene, state.case.trial.used, joint, state.case.modelled.maker(scene))


def _merged(finder: Finder, state: EffectSet, found: Sequence[Learned]) -> EffectSet:
    """The set with given functions merged into one effect, its last."""
    number = 1 + sum(isinstance(term, LearnedEffect) and finder.joint in term.joints for term in state.case.model.terms)
    amplitudes = [state.fitted_effects.amplitude_of(function.hypothesis) for function in found]
    merged = finder.merged(found, amplitudes, number)
    return _refit((*_others(state, found), merged), state)


def _without_unnecessary(state: EffectSet, learned: Hypothesis, needed: float) -> EffectSet:
    """Without effects of the same joint that are unnecessary beside the learned one, the least necessary first."""
    while others := [e for e in state.effects if e is not learned and e.columns.joints == learned.columns.joints]:
        whole, sets = state.log_evidence_of(state.effects), [state.without(effect) for effect in others]
        without = [state.log_evidence_of(effects) for effects in sets]
        least = int(np.argmax(without))
        if whole - without[least] > needed:
            break
        state = _refit(sets[least], state)
    return state


def _is_noise(state: EffectSet, joint: int, needed: float) -> bool:
    excess = state.fitted_effects.free_evidence - state.fitted_effects.noise_evidence
    return bool(excess[joint - 1] <= needed)


def _best_confirmed(
    finder: Finder, state: EffectSet, functions: Sequence[Learned], needed: float
) -> tuple[EffectSet, Learned] | None:
    """The best of given functions, its form chosen again under its own errors, if held-back data confirm it.

    If it extrapolates and fails, smooth functions that the log cannot distinguish from it are tried too.
    """
    if not functions:
        return None
    before = state.cross_validation_errors
    first, _ = _best_of(state, functions)
    for bounded in (False, True):
        errors = first.fitted_effects.errors
        ranked = finder.ranked(first.explained(state.effects), errors, bounded=bounded)
        again = [learned for learned in ranked if learned.gain > needed]
        if not again:
            break
        extended, function = _best_of(first, again, state.effects)
        if _confirmed_alone(extended, before, function.hypothesis):
            return extended, function
    return None


def _confirmed_alone(state: EffectSet, before: CrossValidation, learned: Hypothesis) -> bool:
    """Whether held-back data confirm a function itself, and not only the changes of other parameters beside it."""
    after, joints = state.cross_validation_errors, learned.columns.joints
    without = state.case.cross_validation.errors(state.cross_validation_without(learned.source))
    least = state.case.thresholds.held_back_improvement
    return all(confirms(after, other, joints, least) for other in (before, without))


def _best_of(
    state: EffectSet, functions: Sequence[Learned], effects: Effects | None = None
) -> tuple[EffectSet, Learned]:
    """The function that explains the log best with signs estimated under it, beside `effects` (default: the state's).

    Under wrong signs its gain is underestimated.
    """
    beside = state.effects if effects is None else effects
    tried = []
    for function in (each for each in functions if each.gain > TUNING.near_best * functions[0].gain):
        refit = _refit((*beside, function.hypothesis), state)
        tried.append((_refit(refit.effects, refit), function))
    return max(tried, key=lambda pair: pair[0].fitted_effects.log_evidence)


def _fitted_again(
    finder: Finder, state: EffectSet, found: list[Learned], needed: float
) -> tuple[EffectSet, list[Learned]]:
    """Each function chosen again beside the others, and without unnecessary ones."""
    for function in list(found) if len(found) > 1 else []:
        others, errors = _others(state, [function]), state.fitted_effects.errors
        best = next(iter(finder.ranked(state.explained(others), errors)), None)
        if best is not None and best.gain > needed and best.form.variables != function.form.variables:
            state = _refit((*others, best.hypothesis), state)
            found = [best if other is function else other for other in found]
    return _fewer_functions(state, found, needed)


def _others(state: EffectSet, removed: Sequence[Learned]) -> tuple[Hypothesis, ...]:
    return state.without(*(function.hypothesis for function in removed))


def _fewer_functions(state: EffectSet, found: list[Learned], needed: float) -> tuple[EffectSet, list[Learned]]:
    """Without functions that later ones have made unnecessary, the least necessary first."""
    while len(found) > 1:
        others = [_others(state, [function]) for function in found]
        evidence = [explain(state.data, effects, state.fitted_effects).log_evidence for effects in others]
        least = int(np.argmax(evidence))
        if state.fitted_effects.log_evidence - evidence[least] > needed:
            break
        state = _refit(others[least], state)
        found = [function for function in found if function is not found[least]]
    return state, found


def _refit(effects: Effects, state: EffectSet) -> EffectSet:
    """Fits effects, and estimates signs under them."""
    fitted_effects = explain(state.data, effects)
    return EffectSet(state.case, explain(state.case.data_under(fitted_effects), effects, fitted_effects))
