"""Scores: how much each effect of the catalogue, in its best form, would add to an explanation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.special import logsumexp

from bayesid import terms
from bayesid.discrepancy.error_model import ErrorModel
from bayesid.discrepancy.evidence import LN10, Bench, Columns, Data, Explanation, Screen
from bayesid.discrepancy.hypotheses import Hypothesis
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
_SHORT_LIST = 10
_GIVEN = ("joints", "smoothing", "links")
"""Of a term's shape, what no log is asked for."""
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
