"""Which effects explain a log: the best one is added until none helps, and each is then weighed against its rivals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp

from bayesid import terms
from bayesid.discrepancy.error_model import ErrorModel
from bayesid.discrepancy.evidence import LN10, Bench, Columns, Data, Explanation, Screen
from bayesid.discrepancy.hypotheses import Hypothesis, acts_on_all, effect_names
from bayesid.motion import Array, Mask

THRESHOLD = 2.0
"""Log10 of the Bayes factor that an effect needs to be added."""
WORTH = 0.05
"""Share of the noise floor's mean square by which an effect must lower a joint's residual to be added."""
SHARE = 0.1
"""And by this share of what is left."""
AT_FLOOR = 1.15
"""Residual over a blunt floor at which nothing but standard effects is looked for any more."""
EQUIVALENT = 1.0
"""Log10 of the Bayes factor below which two effects are not told apart."""
_SURE = 12.0
"""Log10 from which on single joints' effects are added several at a time."""
_SHORT_LIST = 10
_MOST = 40
_GIVEN = ("joints", "smoothing", "links")
"""Of a term's shape, what no log is asked for."""
_REFINED = 12
"""Evaluations in the search for a nonlinear number."""
_VISIBLE = 2.0 * LN10
"""Expected gain of a usual amplitude below which an effect cannot be tested."""
_NOTHING, _ELSE = 0.5, 0.1
"""Prior probabilities that nothing is missing, and that it is something else; the effects share the rest."""

Library = Sequence[list[Hypothesis]]


@dataclass(frozen=True)
class Score:
    """An effect in its best form.

    Attributes:
        hypothesis: this form.
        gain: log of the Bayes factor for adding it, averaged over its forms.
        visible: log of the Bayes factor to be expected of a usual amplitude.
        worth: fall of a joint's mean squared residual, in units of the noise floor's or, where much more is left, of a
            part of that; nan where no closer look was had.
        left: (n,) mean squared residual that it leaves, in units of the floor's; None where no closer look was had.
        company: other standard effects of the same joint that come with it.
    """

    hypothesis: Hypothesis
    gain: float
    visible: float
    worth: float = np.nan
    left: Array | None = None
    company: tuple[Hypothesis, ...] = ()

    @property
    def counts(self) -> bool:
        """Whether it is certain enough, and large enough to be worth a term."""
        return self.gain > THRESHOLD * LN10 and self.worth > WORTH

    @property
    def size(self) -> int:
        """Numbers that it takes."""
        free = sum(len(one.columns.sd) for one in (self.hypothesis, *self.company))
        return free + sum(key not in _GIVEN for key in self.hypothesis.source.shape)

    @property
    def standard(self) -> bool:
        """Whether every robot has it, more or less."""
        return self.hypothesis.source.name in terms.DEFAULT

    @property
    def key(self) -> tuple[str, tuple[int, ...]]:
        """Effect and joints."""
        return self.hypothesis.effect, self.hypothesis.joints


@dataclass(frozen=True)
class Verdict:
    """An effect that was found, weighed against all that could stand in its place.

    Attributes:
        hypothesis: the form that was added.
        gain: log of the Bayes factor for it, given all others that were found.
        probability: of the effect in these joints, or one that is equivalent to it, among the catalogue, nothing
            missing and something else.
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


def explain_with(
    data: Data, chosen: Sequence[Hypothesis], start: Explanation | None = None
) -> tuple[Bench, Explanation]:
    """The explanation by some effects, error models found with it."""
    bench = Bench(data, [one.columns for one in chosen])
    errors = bench_errors(data) if start is None else start.errors
    now = bench.explain(errors)
    for _ in range(2):
        now = bench.explain(now.errors)
    return bench, now


def bench_errors(data: Data) -> tuple[ErrorModel, ...]:
    """Error models to begin with: white noise at its limit."""
    return tuple(ErrorModel(white, 0.05 * white, 0.1, data.rate) for white in data.limits[:, 0])


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


def assess(
    bench: Bench, now: Explanation, library: Library, short_list: int = _SHORT_LIST, company: bool = False
) -> list[Score]:
    """Every effect in its best form, best first: by a quick look all of them, by a closer one the most promising.

    Args:
        bench: with the effects that are added already.
        now: the explanation by these.
        library: all hypotheses.
        short_list: how many are looked at closely.
        company: whether standard effects of one joint may come together.
    """
    screen = Screen(bench, now.errors)
    forms: dict[tuple[str, tuple[int, ...]], set[str]] = {}
    for one in (one for group in library for one in group):
        forms.setdefault((one.effect, one.joints), set()).add(one.source.name)
    best: dict[tuple[str, tuple[int, ...]], tuple[Score, float]] = {}
    for group in library:
        if not group:
            continue
        gains, visible = screen.gain([one.columns for one in group])
        top = int(np.argmax(gains))
        key = group[top].effect, group[top].joints
        spread = float(logsumexp(gains)) - float(gains[top]) - np.log(len(group)) - np.log(len(forms[key]))
        score = Score(group[top], float(gains[top]) + spread, float(visible.max()))
        if key not in best or score.gain > best[key][0].gain:
            best[key] = score, spread
    ordered = sorted(best.values(), key=lambda one: -one[0].gain)
    closely = [(score, spread) for score, spread in ordered[:short_list]]
    if company:
        closely += [(score, 0.0) for score in _companies(screen, [score for score, _ in ordered])]
    looked_at = [_closer(bench, now, score, spread) for score, spread in closely]
    return sorted(looked_at, key=lambda one: -one.gain) + [score for score, _ in ordered[short_list:]]


def _closer(bench: Bench, now: Explanation, score: Score, spread: float) -> Score:
    """The score with its own error models, and what the effect is worth."""
    then = bench.settle(now, together([score.hypothesis, *score.company]))
    left = bench.data.mean_square(now.residual)
    after = bench.data.mean_square(then.residual)
    worth = float(np.max(_worth(left, after)))
    return replace(score, gain=then.log_evidence - now.log_evidence + spread, worth=worth, left=after)


def _worth(before: Array, after: Array) -> Array:
    """(n,) fall of the mean squared residual, in units that leave out what is small beside the floor or the rest."""
    return (before - after) / np.maximum(1.0, SHARE / WORTH * before)


def plain_first(scores: Sequence[Score], sharp: Mask) -> list[Score]:
    """The scores, best first, but a standard effect before others of its joint that leave hardly less than it does.

    Only where the floor is not sharp (n,), for the earlier model was a poor one there: the friction of a real joint is
    never exactly what a term says, and an elaborate effect that fits it a little better, or better than the floor asks
    for, is not what is missing, however certain the little is.
    """
    ordered: list[Score] = []
    for one in scores:
        at, blunt = len(ordered), not all(sharp[j] for j in one.hypothesis.columns.joints)
        while at and blunt and one.standard and one.counts and _hardly_better(ordered[at - 1], one, sharp):
            at -= 1
        ordered.insert(at, one)
    return ordered


def _hardly_better(other: Score, standard: Score, sharp: Mask) -> bool:
    """Whether another effect of the same joints is no standard one, takes more numbers, and is worth little more."""
    if other.standard or other.hypothesis.joints != standard.hypothesis.joints:
        return False
    if other.size <= standard.size or other.left is None or standard.left is None:
        return False
    joints = list(standard.hypothesis.columns.joints)
    enough = bool(at_floor(standard.left, sharp)[joints].all())
    return enough or bool(np.max(_worth(standard.left, other.left)) < WORTH)


def at_floor(mean_square: Array, sharp: Mask) -> Mask:
    """(n,) whether a joint's residual, in units of the floor's mean square, is as small as a blunt floor asks for."""
    return ~sharp & (mean_square <= AT_FLOOR**2)


def _companies(screen: Screen, scores: Sequence[Score]) -> list[Score]:
    """Standard effects of one joint that explain more together than any effect does there alone.

    Friction comes as Coulomb's and as viscous friction: as long as one of them is missing, neither explains much, and
    whatever resembles their sum would be taken for it.
    """
    found = []
    for joint in {score.hypothesis.joints for score in scores if len(score.hypothesis.joints) == 1}:
        here = [score for score in scores if score.hypothesis.joints == joint]
        standard = [score.hypothesis for score in here if score.hypothesis.source.name in terms.DEFAULT]
        groups = [list(group) for size in range(2, len(standard) + 1) for group in combinations(standard, size)]
        gains = [float(screen.gain([together(group)])[0][0]) for group in groups]
        alone = max((score.gain for score in here if score.standard), default=0.0)
        if gains and max(gains) > alone + EQUIVALENT * LN10:
            best = groups[int(np.argmax(gains))]
            first, *others = [score.hypothesis for score in here if any(score.hypothesis is one for one in best)]
            found.append(Score(first, max(gains), np.inf, company=tuple(others)))
    return found


def together(group: Sequence[Hypothesis]) -> Columns:
    """Several effects as one."""
    if len(group) == 1:
        return group[0].columns
    sizes = [len(one.columns.sd) for one in group]
    joints = set().union(*(one.columns.rows for one in group))
    rows = {}
    for j in joints:
        count = next(len(one.columns.rows[j]) for one in group if j in one.columns.rows)
        parts = [one.columns.rows.get(j, np.zeros((count, size))) for one, size in zip(group, sizes, strict=True)]
        rows[j] = np.concatenate(parts, axis=1)
    return Columns(
        rows=rows,
        shift={},
        sd=np.concatenate([one.columns.sd for one in group]),
        positive=np.concatenate([one.columns.positive for one in group]),
    )


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
