"""Effects without a name: where the catalogue leaves a joint above the noise floor, a function is learned."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from bayesid.discrepancy.sets import EffectSet
from bayesid.discrepancy.tuning import TUNING
from bayesid.effects.learned_effect import LearnedEffect
from bayesid.regression.selection.cross_validation import CrossValidation, confirms
from bayesid.regression.selection.hypotheses import Hypothesis
from bayesid.regression.selection.learned import Finder, Learned
from bayesid.regression.selection.regression import Effects, explain


def learn_effects(
    state: EffectSet, log_prior: Callable[[Hypothesis], float]
) -> tuple[EffectSet, list[tuple[EffectSet, Hypothesis]]]:
    """Functions for all joints that stay above the floor, and those that held-back data do not bear out.

    Where effects of the catalogue act in such a joint they may be stand-ins: a function is learned beside them and, if
    none helps, in their place. Those without which held-back data are predicted better, surely, are refused. Several
    effects of the catalogue that reach the floor in a joint together may be stand-ins too, for one function that is
    likelier than all of them. The prior is of an effect of the catalogue to be missing, over nothing to be missing in
    its place.
    """
    refused: list[tuple[EffectSet, Hypothesis]] = []
    for joint in _left(state):
        learned, gone = _in_joint(state, joint)
        own = state.in_joint(joint - 1)
        if own and (learned is state or joint in _left(learned)):
            others = state.without(*own)
            alone, gone_too = _in_joint(_settled(others, state), joint)
            before, after = learned.cross_validation_errors, alone.cross_validation_errors
            if confirms(after, before, {joint - 1}, state.case.thresholds.held_back_improvement):
                nothing = len(alone.effects) == len(others)
                learned, gone = alone, [*((state, effect) for effect in own if nothing), *gone_too]
            elif learned is state:
                gone = gone or gone_too
        state, refused = learned, refused + gone
    for joint in _of_several(state):
        state = _by_one_function(state, joint, log_prior)
    return state, refused


def _of_several(state: EffectSet) -> list[int]:
    """Joints (from 1) in which several effects of the catalogue act alone, and none without a name."""
    own = [next(iter(effect.columns.joints)) + 1 for effect in state.effects if len(effect.columns.joints) == 1]
    learned = {joint for effect in state.effects if isinstance(effect.source, LearnedEffect) for joint in effect.joints}
    return sorted(joint for joint, count in Counter(own).items() if count > 1 and joint not in learned)


def _by_one_function(state: EffectSet, joint: int, log_prior: Callable[[Hypothesis], float]) -> EffectSet:
    """One function in the place of several effects in a joint (from 1), where it is likelier and predicts as well.

    A function that explains less than half of what they do, before its signs are settled, is not looked at closely.
    """
    needed, limits, own = state.case.needed, state.case.thresholds, state.in_joint(joint - 1)
    others = state.without(*own)
    bare = _settled(others, state)
    finder, evidence = _finder(bare, joint), _log_evidence(state)
    least = max(needed, TUNING.near_best * (evidence - _log_evidence(bare)))
    ranked = finder.ranked(bare.explained())
    grown = _borne_out(finder, bare, [one for one in ranked if one.gain > least], needed)
    if grown is None:
        return state
    function = grown[1]
    prior = np.log(limits.something_else / limits.nothing_missing / state.data.used.shape[1]) - function.price
    gain = _log_evidence(grown[0]) + prior - evidence - sum(map(log_prior, own))
    by_one = _merged(finder, grown[0], [function])
    if gain < needed or confirms(
        state.cross_validation_errors, by_one.cross_validation_errors, {joint - 1}, limits.held_back_improvement
    ):
        return state
    return by_one


def _log_evidence(state: EffectSet) -> float:
    """Of a set, judged by what it leaves itself."""
    own = replace(state.fitted_effects, data=replace(state.data, reference=None))
    return replace(state, fitted_effects=own).log_evidence_of(state.effects)


def _left(state: EffectSet) -> list[int]:
    """Joints (from 1) whose residual is surely above a sharp floor, on the log or on held-back data, worst first."""
    case, predicted, unseen = state.case, state.predicted, state.cross_validation_errors
    floor, gap, on_log = (
        case.floor(predicted),
        case.trial.gap(predicted),
        case.unexplained(state.fitted_effects, predicted),
    )
    cross_validation = unseen.surely_above(floor.rms) & floor.exceeded(unseen.rms)
    ratio = np.maximum(gap, unseen.rms) / floor.rms
    return [int(j) + 1 for j in np.argsort(-ratio) if floor.sharp[j] and (j + 1 in on_log or cross_validation[j])]


def _in_joint(state: EffectSet, joint: int) -> tuple[EffectSet, list[tuple[EffectSet, Hypothesis]]]:
    """A learned effect in a joint (from 1), if held-back data bear it out."""
    found: list[Learned] = []
    passed: list[Learned] = []
    needed, now, finder = state.case.needed, state, _finder(state, joint)
    while len(found) < TUNING.most_functions and not (found and _is_noise(now, joint, needed)):
        ranked = finder.ranked(now.explained())
        passed = [learned for learned in ranked if learned.gain > needed]
        grown = _borne_out(finder, now, passed, needed)
        if grown is None:
            break
        now, found = _fitted_again(finder, grown[0], [*found, grown[1]], needed)
    if not found:
        return state, [(_settled((*now.effects, one.hypothesis), now), one.hypothesis) for one in passed[:1]]
    merged = _merged(finder, now, found)
    if not _explains_most(state, merged, joint):
        return state, [(merged, merged.effects[-1])]
    return _without_stand_ins(merged, merged.effects[-1], needed), []


def _explains_most(before: EffectSet, after: EffectSet, joint: int) -> bool:
    """Whether a function explains most of what held-back data show in a joint (from 1): else it is a stand-in itself.

    Of a table that is off, say: any effect of a joint that stays above the floor is kept by the same share.
    """
    without, rest = (one.cross_validation_errors.rms[joint - 1] ** 2 for one in (before, after))
    excess = without - before.data.floor[joint - 1] ** 2
    return bool(without - rest >= TUNING.explained_share * excess)


def _finder(state: EffectSet, joint: int) -> Finder:
    scene = state.case.modelled.scene(state.predicted)
    return Finder(scene, state.case.trial.used, joint, state.case.modelled.maker(scene))


def _merged(finder: Finder, state: EffectSet, found: Sequence[Learned]) -> EffectSet:
    """The set with some of its functions as one effect, the last."""
    number = 1 + sum(isinstance(term, LearnedEffect) and finder.joint in term.joints for term in state.case.model.terms)
    merged = finder.merged(found, [state.fitted_effects.amplitude_of(one.hypothesis) for one in found], number)
    return _settled((*_others(state, found), merged), state)


def _without_stand_ins(state: EffectSet, learned: Hypothesis, needed: float) -> EffectSet:
    """Without the effects of the same joint that the learned one makes needless, the most needless first."""
    while own := [e for e in state.effects if e is not learned and e.columns.joints == learned.columns.joints]:
        whole, sets = state.log_evidence_of(state.effects), [state.without(one) for one in own]
        without = [state.log_evidence_of(some) for some in sets]
        most = int(np.argmax(without))
        if whole - without[most] > needed:
            break
        state = _settled(sets[most], state)
    return state


def _is_noise(state: EffectSet, joint: int, needed: float) -> bool:
    more = state.fitted_effects.free_evidence - state.fitted_effects.noise_evidence
    return bool(more[joint - 1] <= needed)


def _borne_out(
    finder: Finder, state: EffectSet, passed: Sequence[Learned], needed: float
) -> tuple[EffectSet, Learned] | None:
    """The best of some functions, its form chosen again by what it leaves, if held-back data bear it out.

    One that goes on beyond the range seen, and fails, is tried once more as a smooth function; so are others that the
    log cannot tell from it.
    """
    if not passed:
        return None
    before = state.cross_validation_errors
    first, _ = _best_of(state, passed)
    for bounded in (False, True):
        errors = first.fitted_effects.errors
        ranked = finder.ranked(first.explained(state.effects), errors, bounded=bounded)
        again = [learned for learned in ranked if learned.gain > needed]
        if not again:
            break
        more, one = _best_of(first, again, state.effects)
        if _helps(more, before, one.hypothesis):
            return more, one
    return None


def _helps(state: EffectSet, before: CrossValidation, learned: Hypothesis) -> bool:
    """Whether held-back data confirm a function by itself, without changes of the other parameters.

    What only the log shows pulls at these. A function lets them go, and may do nothing where the held-back data are.
    """
    after, joints = state.cross_validation_errors, learned.columns.joints
    without = state.case.cross_validation.errors(state.held_back_less(learned.source))
    least = state.case.thresholds.held_back_improvement
    return all(confirms(after, other, joints, least) for other in (before, without))


def _best_of(
    state: EffectSet, functions: Sequence[Learned], effects: Effects | None = None
) -> tuple[EffectSet, Learned]:
    """The function that explains the log best once signs are settled under each: wrong signs hide what is there.

    They stand beside `effects`; by default beside those of the state.
    """
    beside = state.effects if effects is None else effects
    tried = []
    for one in (one for one in functions if one.gain > TUNING.near_best * functions[0].gain):
        settled = _settled((*beside, one.hypothesis), state)
        tried.append((_settled(settled.effects, settled), one))
    return max(tried, key=lambda pair: pair[0].fitted_effects.log_evidence)


def _fitted_again(
    finder: Finder, state: EffectSet, found: list[Learned], needed: float
) -> tuple[EffectSet, list[Learned]]:
    """Each function chosen again beside the others, now that they are known; what is needless goes."""
    for one in list(found) if len(found) > 1 else []:
        others, errors = _others(state, [one]), state.fitted_effects.errors
        best = next(iter(finder.ranked(state.explained(others), errors)), None)
        if best is not None and best.gain > needed and best.form.variables != one.form.variables:
            state = _settled((*others, best.hypothesis), state)
            found = [best if other is one else other for other in found]
    return _without_needless(state, found, needed)


def _others(state: EffectSet, gone: Sequence[Learned]) -> tuple[Hypothesis, ...]:
    return state.without(*(one.hypothesis for one in gone))


def _without_needless(state: EffectSet, found: list[Learned], needed: float) -> tuple[EffectSet, list[Learned]]:
    """Without the functions that later ones have made needless, the most needless first."""
    while len(found) > 1:
        evidence = [explain(state.data, _others(state, [one]), state.fitted_effects).log_evidence for one in found]
        most = int(np.argmax(evidence))
        if state.fitted_effects.log_evidence - evidence[most] > needed:
            break
        state = _settled(_others(state, [found[most]]), state)
        found = [one for one in found if one is not found[most]]
    return state, found


def _settled(effects: Effects, state: EffectSet) -> EffectSet:
    fitted_effects = explain(state.data, effects)
    return EffectSet(state.case, explain(state.case.settled(fitted_effects), effects, fitted_effects))
