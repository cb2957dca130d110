"""Forward selection of the effects that explain a log: the best one is added until none helps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from scipy.optimize import minimize_scalar

from bayesid.arrays import Mask
from bayesid.fit.effects.explanation import LN10, Explanation, Observations, Regression
from bayesid.fit.effects.hypotheses import EffectKey, Hypothesis
from bayesid.fit.effects.scores import Library, Score, assess, at_blunt_floor, explain_with, plain_first
from bayesid.fit.effects.screening import Screening

_EVALUATIONS = 12
"""In the search for a nonlinear number: golden sections narrow its bracket to a hundredth or better."""


@dataclass(frozen=True)
class Selection:
    """What explains a log best.

    Attributes:
        hypotheses: in the order they were added.
        explanation: by all of them.
        before: without any.
        scores: of the whole catalogue, before anything was added.
    """

    hypotheses: tuple[Hypothesis, ...]
    explanation: Explanation
    before: Explanation
    scores: tuple[Score, ...]


def select(
    data: Observations,
    library: Library,
    start: Sequence[Hypothesis] = (),
    settle: Callable[[Sequence[Hypothesis], Explanation], Observations] | None = None,
    allowed: Callable[[Hypothesis], bool] = lambda _: True,
) -> Selection:
    """Adds the best effects until none reaches the thresholds.

    Args:
        data: the log.
        library: all hypotheses.
        start: effects that are added already.
        settle: the log with its signs settled once more, after an effect was added.
        allowed: which hypotheses may be added.
    """
    effects = list(start)
    regression, explanation = explain_with(data, effects)
    before, first = explanation, None
    dropped: set[EffectKey] = set()
    while len(effects) < data.thresholds.max_effects:
        done = at_blunt_floor(data, data.mean_square(explanation.residual))
        candidates = [
            [h for h in group if allowed(h) and h.key not in dropped and (h.standard or not _all(done, h))]
            for group in library
        ]
        scores = assess(regression, explanation, candidates, companions=True)
        first = [score for score in scores if not score.companions] if first is None else first
        entering = _entering(data, scores, effects)
        if not entering:
            break
        for score in entering:
            effects += [refined(regression, explanation, score.hypothesis, library), *score.companions]
        regression, explanation = explain_with(data, effects, explanation)
        if settle is not None:
            data = settle(effects, explanation)
            regression, explanation = explain_with(data, effects, explanation)
        changed = set().union(*(score.hypothesis.columns.joints for score in entering))
        keys = {effect.key for effect in effects}
        effects, regression, explanation = exchange(data, candidates, effects, explanation, changed)
        dropped |= keys - {effect.key for effect in effects}  # or it would come and go for ever
    effects, explanation = _without_needless(data, effects, explanation)
    ranked = sorted(first or (), key=lambda score: -score.gain)
    return Selection(tuple(effects), explanation, before, tuple(ranked))


def _all(joints: Mask, hypothesis: Hypothesis) -> bool:
    """Whether a mask (n,) of joints holds in all in which a hypothesis acts."""
    return all(joints[j] for j in hypothesis.columns.joints)


def _without_needless(
    data: Observations, effects: list[Hypothesis], explanation: Explanation
) -> tuple[list[Hypothesis], Explanation]:
    """Leaves out what is no standard effect where its joints are at a blunt floor without it."""
    for effect in list(effects):
        if effect.standard or any(data.sharp[j] for j in effect.columns.joints):
            continue
        others = [other for other in effects if other is not effect]
        _, without = explain_with(data, others, explanation)
        if _all(at_blunt_floor(data, data.mean_square(without.residual)), effect):
            effects, explanation = others, without
    return effects, explanation


def _entering(data: Observations, scores: Sequence[Score], effects: Sequence[Hypothesis]) -> list[Score]:
    """The best effect that qualifies, and with it the clear ones of other joints if it acts in one joint alone."""
    present = {effect.key for effect in effects}
    ranked = [s for s in plain_first(scores, data) if s.qualifies(data.thresholds) and s.key not in present]
    if not ranked or not ranked[0].hypothesis.joints:
        return ranked[:1]
    entering, joints = [ranked[0]], set(ranked[0].hypothesis.joints)
    for score in ranked[1:]:
        if not score.hypothesis.joints:
            break  # what acts on the whole robot may explain the rest
        if score.gain > data.thresholds.clear * LN10 and not joints & set(score.hypothesis.joints):
            entering.append(score)
            joints |= set(score.hypothesis.joints)
    return entering


# ---------------------------------------------------------------------------------------------------------------
# Against rivals
# ---------------------------------------------------------------------------------------------------------------
def rivals_of(library: Library, hypothesis: Hypothesis, others: Sequence[Hypothesis]) -> list[list[Hypothesis]]:
    """What could stand in the place of a hypothesis: all that acts in one of its joints, others' effects left out."""
    joints, taken = hypothesis.columns.joints, {other.key for other in others}
    groups = [group for group in library if group and group[0].columns.joints & joints]
    return [[rival for rival in group if rival.key not in taken] for group in groups]


def exchange(
    data: Observations, library: Library, effects: list[Hypothesis], explanation: Explanation, changed: set[int]
) -> tuple[list[Hypothesis], Regression, Explanation]:
    """Effects against their rivals, the others given: a better one takes its place, a needless one goes.

    Only effects that share a joint with another one and act on one of those `changed` by what was added last.
    """
    regression, explanation = explain_with(data, effects, explanation)
    for effect in list(effects):
        place = next(i for i, other in enumerate(effects) if other is effect)
        others = effects[:place] + effects[place + 1 :]
        joints = effect.columns.joints
        if not joints & changed or not any(joints & other.columns.joints for other in others):
            continue
        regression, without = explain_with(data, others, explanation)
        rivals = rivals_of(library, effect, others)
        short_list = data.thresholds.exchange_short_list
        best = plain_first(assess(regression, without, rivals, short_list), data)[:1]
        effects = others
        if best and best[0].qualifies(data.thresholds):
            winner = best[0].hypothesis
            same = (winner.source.name, winner.joints) == (effect.source.name, effect.joints)
            winner = effect if same else refined(regression, without, winner, library)
            effects = [*others[:place], winner, *others[place:]]
        regression, explanation = explain_with(data, effects, explanation)
    return effects, regression, explanation


# ---------------------------------------------------------------------------------------------------------------
# Nonlinear numbers
# ---------------------------------------------------------------------------------------------------------------
def refined(regression: Regression, explanation: Explanation, hypothesis: Hypothesis, library: Library) -> Hypothesis:
    """The hypothesis with its nonlinear number between the ones that the library holds, where it fits best.

    Args:
        regression: with the other effects.
        explanation: by these.
        hypothesis: of the library.
        library: all hypotheses.
    """
    group = next((group for group in library if any(other is hypothesis for other in group)), [])
    number = _varied(hypothesis, group)
    if number is None:
        return hypothesis
    values = sorted({other.source.shape[number][0] for other in group})
    place = values.index(hypothesis.source.shape[number][0])
    bounds = values[max(0, place - 1)], values[min(len(values) - 1, place + 1)]
    screening = Screening(regression, explanation.errors)

    def cost(value: float) -> float:
        return -float(screening.gains([hypothesis.remade(number, value).columns])[0][0])

    best = minimize_scalar(cost, bounds=bounds, method="bounded", options={"maxiter": _EVALUATIONS})
    return hypothesis.remade(number, float(best.x)) if best.fun < cost(values[place]) else hypothesis


def _varied(hypothesis: Hypothesis, group: Sequence[Hypothesis]) -> str | None:
    """The nonlinear number that the library varies for this form, the sides of others left out."""
    for key in hypothesis.source.sought:
        tried = {tuple(other.source.shape[key]) for other in group}
        if len(hypothesis.source.shape[key]) == 1 and len(tried) > 2:
            return key
    return None
