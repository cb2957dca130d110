"""Which effects explain a log: the best one is added until none helps, and each is then weighed against its rivals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp

from bayesid import terms
from bayesid.discrepancy.evidence import LN10, Bench, Data, Explanation, Screen
from bayesid.discrepancy.hypotheses import Hypothesis, acts_on_all, effect_names
from bayesid.discrepancy.scores import (
    EQUIVALENT,
    THRESHOLD,
    Library,
    Score,
    assess,
    at_floor,
    explain_with,
    plain_first,
)
from bayesid.motion import Mask

_SURE = 12.0
"""Log10 from which on single joints' effects are added several at a time."""
_MOST = 40
_REFINED = 12
"""Evaluations in the search for a nonlinear number."""
_VISIBLE = 2.0 * LN10
"""Expected gain of a usual amplitude below which an effect cannot be tested."""
_NOTHING, _ELSE = 0.5, 0.1
"""Prior probabilities that nothing is missing, and that it is something else; the effects share the rest."""


@dataclass(frozen=True)
class Verdict:
    """An effect that was found, weighed against all that could stand in its place.

    Attributes:
        hypothesis: the form that was added.
        gain: log of the Bayes factor for it, given all others that were found.
        probability: of the effect in these joints, or one that is equivalent to it, among the catalogue, nothing
            missing and something else (:eq:`effect-probability`).
        nothing: probability that nothing is missing in its place.
        something_else: probability that it is something outside of the catalogue.
        rivals: scores of the alternatives, best first, itself included.
        equivalent: names of the effects that the log cannot tell from it.
    """

    hypothesis: Hypothesis
    gain: float
    probability: float
    nothing: float
    something_else: float
    rivals: tuple[Score, ...]
    equivalent: tuple[str, ...]


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
    data: Data,
    library: Library,
    chosen: Sequence[Hypothesis] = (),
    resettle: Callable[[Data, Sequence[Hypothesis], Explanation], Data] | None = None,
    allowed: Callable[[Hypothesis], bool] = lambda _: True,
) -> Selection:
    """Adds the best effects until none reaches the threshold.

    Args:
        data: the log.
        library: all hypotheses.
        chosen: effects that are added already.
        resettle: settles the signs once more after an effect was added.
        allowed: which hypotheses may be added.
    """
    found = list(chosen)
    bench, now = explain_with(data, found)
    before, first = now, None
    dropped: set[tuple[str, tuple[int, ...]]] = set()
    while len(found) < _MOST:
        done = at_floor(data.mean_square(now.residual), data.sharp)
        open_ = [
            [h for h in group if allowed(h) and (h.effect, h.joints) not in dropped and _may_come(h, done)]
            for group in library
        ]
        scores = assess(bench, now, open_, company=True)
        first = [one for one in scores if not one.company] if first is None else first
        best = _added_together([one for one in plain_first(scores, data.sharp) if one.counts], found)
        if not best:
            break
        found += [one for score in best for one in (refined(bench, now, score.hypothesis, library), *score.company)]
        bench, now = explain_with(data, found, now)
        if resettle is not None:
            data = resettle(data, found, now)
            bench, now = explain_with(data, found, now)
        touched = set().union(*(one.hypothesis.columns.joints for one in best))
        earlier = {(one.effect, one.joints) for one in found}
        found, bench, now = exchange(data, open_, found, now, touched)
        dropped |= earlier - {(one.effect, one.joints) for one in found}  # or it would come and go for ever
    found, now = _without_needless(data, found, now)
    return Selection(tuple(found), now, before, tuple(sorted(first or (), key=lambda one: -one.gain)))


def _without_needless(
    data: Data, found: list[Hypothesis], now: Explanation
) -> tuple[list[Hypothesis], Explanation]:
    """Leaves out what is no standard effect where its joints are at a blunt floor without it."""
    for one in list(found):
        joints = list(one.columns.joints)
        if one.source.name in terms.DEFAULT or any(data.sharp[j] for j in joints):
            continue
        others = [other for other in found if other is not one]
        _, without = explain_with(data, others, now)
        if at_floor(data.mean_square(without.residual), data.sharp)[joints].all():
            found, now = others, without
    return found, now


def _may_come(one: Hypothesis, done: Mask) -> bool:
    """Whether an effect is a standard one, or acts in a joint that is not at its floor."""
    return one.source.name in terms.DEFAULT or not all(done[j] for j in one.columns.joints)


def _added_together(scores: Sequence[Score], found: Sequence[Hypothesis]) -> list[Score]:
    """The best effect, and with it the clear ones of other joints if it acts in one joint alone."""
    taken = {(one.effect, one.joints) for one in found}
    scores = [one for one in scores if one.key not in taken]
    if not scores or not scores[0].hypothesis.joints:
        return list(scores[:1])
    together, joints = [scores[0]], set(scores[0].hypothesis.joints)
    for one in scores[1:]:
        if not one.hypothesis.joints:
            break  # what acts on the whole robot may explain the rest
        if one.gain > _SURE * LN10 and not joints & set(one.hypothesis.joints):
            together.append(one)
            joints |= set(one.hypothesis.joints)
    return together


def exchange(
    data: Data, library: Library, found: list[Hypothesis], now: Explanation, touched: set[int]
) -> tuple[list[Hypothesis], Bench, Explanation]:  # fmt: skip
    """Effects against their rivals, the others given: a better one takes its place, a needless one goes.

    Only effects that share a joint with another one and act on one of those `touched` by what was added last.
    """
    bench, now = explain_with(data, found, now)
    for one in list(found):
        joints = one.columns.joints
        if not joints & touched or not any(joints & other.columns.joints for other in found if other is not one):
            continue
        at = next(i for i, other in enumerate(found) if other is one)
        others = found[:at] + found[at + 1 :]
        bench, without = explain_with(data, others, now)
        taken = {(h.effect, h.joints) for h in others}
        rivals = [[h for h in group if (h.effect, h.joints) not in taken] for group in touching(library, one)]
        best = plain_first(assess(bench, without, rivals, 6), data.sharp)
        if best and best[0].counts:
            same = (best[0].hypothesis.source.name, best[0].hypothesis.joints) == (one.source.name, one.joints)
            best_form = one if same else refined(bench, without, best[0].hypothesis, library)
            found = [*found[:at], best_form, *found[at + 1 :]]
        else:
            found = others
        bench, now = explain_with(data, found, now)
    return found, bench, now


def refined(bench: Bench, now: Explanation, one: Hypothesis, library: Library) -> Hypothesis:
    """The hypothesis with its nonlinear number between the ones that the library holds, where it fits best.

    Args:
        bench: with the other effects.
        now: the explanation by these.
        one: of the library.
        library: all hypotheses.
    """
    group = next((group for group in library if any(other is one for other in group)), [])
    number = _varied(one, group)
    if number is None:
        return one
    values = sorted({other.source.shape[number][0] for other in group})
    at = values.index(one.source.shape[number][0])
    low, high = values[max(0, at - 1)], values[min(len(values) - 1, at + 1)]
    screen = Screen(bench, now.errors)

    def cost(value: float) -> float:
        return -float(screen.gain([one.remade(number, value).columns])[0][0])

    best = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"maxiter": _REFINED})
    return one.remade(number, float(best.x)) if best.fun < cost(values[at]) else one


def _varied(one: Hypothesis, group: Sequence[Hypothesis]) -> str | None:
    """The nonlinear number that the library varies for this form, the sides of others left out."""
    for key, value in one.source.shape.items():
        others = [other.source.shape[key] for other in group]
        if key != "joints" and len(value) == 1 and len({tuple(values) for values in others}) > 2:
            return key
    return None


def touching(library: Library, one: Hypothesis) -> list[list[Hypothesis]]:
    """The hypotheses that could stand in the place of another: those that act in one of its joints."""
    joints = one.columns.joints
    return [group for group in library if group and group[0].columns.joints & joints]


def weigh(data: Data, library: Library, selection: Selection, one: Hypothesis) -> Verdict:
    """An effect against all that could stand in its place, the others that were found given."""
    others = [other for other in selection.hypotheses if other is not one]
    bench, without = explain_with(data, others, selection.explanation)
    taken = {(h.effect, h.joints) for h in others}
    rivals = [[h for h in group if (h.effect, h.joints) not in taken] for group in touching(library, one)]
    scores = plain_first(assess(bench, without, rivals), data.sharp)
    own = next((s for s in scores if s.key == (one.effect, one.joints)), None)
    gain = selection.explanation.log_evidence - without.log_evidence if own is None else own.gain
    share = (1.0 - _NOTHING - _ELSE) / len(effect_names())
    places = max(1, data.effort.shape[1])
    logs = [s.gain + np.log(share / (places if s.hypothesis.joints else 1)) for s in scores]
    nothing = without.of_nothing - without.log_evidence + np.log(_NOTHING)
    total = float(logsumexp([*logs, nothing, np.log(_ELSE)]))
    close = {s.hypothesis.effect for s in scores if s.gain > gain - EQUIVALENT * LN10} - {one.effect}
    mine = [
        value
        for value, s in zip(logs, scores, strict=True)
        if s.key == (one.effect, one.joints) or s.hypothesis.effect in close
    ]
    return Verdict(
        hypothesis=one,
        gain=gain,
        probability=float(np.exp(logsumexp(mine) - total)) if mine else 0.0,
        nothing=float(np.exp(nothing - total)),
        something_else=float(np.exp(np.log(_ELSE) - total)),
        rivals=tuple(scores),
        equivalent=tuple(sorted(close)),
    )


def not_testable(scores: Sequence[Score], n_joints: int) -> list[tuple[str, tuple[int, ...]]]:
    """Effects and joints that this log could not show even if they were of a usual size.

    Args:
        scores: of all that could be tried.
        n_joints: of the robot; an effect that has no score in some joint could not be tried there.
    """
    tried = {one.key: one for one in scores}
    single = {(j,) for j in range(1, n_joints + 1)}
    places = {effect: {()} if acts_on_all(effect) else single for effect in effect_names()}
    untried = {(effect, joints) for effect, where in places.items() for joints in where} - set(tried)
    unseen = {key for key, one in tried.items() if one.visible < _VISIBLE and one.gain < THRESHOLD * LN10}
    return sorted(untried | unseen)
