"""Scores: how much each effect of the catalogue, in its best form, would add to an explanation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from bayesid.arrays import Array, Mask
from bayesid.effects.effect import Effect
from bayesid.regression.selection.columns import NO_COLUMNS, Columns
from bayesid.regression.selection.error_model import ErrorModel, alike
from bayesid.regression.selection.explanation import LN10, Explanation, Observations, Regression
from bayesid.regression.selection.hypotheses import EffectKey, Hypothesis, Library
from bayesid.regression.selection.screening import Screening
from bayesid.regression.selection.thresholds import Thresholds

_SETTLINGS = 2
"""Times that an explanation is found again with the error models it has left; a round number, not studied."""
_INITIAL_COLOURED, _INITIAL_CORRELATION = 0.05, 0.1
"""Coloured part over the white one, and s, of the error model to begin with; it weighs the first fit alone."""


@dataclass(frozen=True)
class Score:
    """An effect in its best form.

    Attributes:
        hypothesis: this form.
        gain: log of the Bayes factor for adding it, averaged over its forms.
        expected_gain: log of the Bayes factor to be expected of a usual amplitude.
        improvement: fall of a joint's mean squared residual, in units of the noise floor's or, where much more is left,
            of a part of that; nan where no closer look was had.
        mean_square: (n,) mean squared residual with it, in units of the floor's; None where no closer look was had.
    """

    hypothesis: Hypothesis
    gain: float
    expected_gain: float
    improvement: float = np.nan
    mean_square: Array | None = None

    @property
    def n_parameters(self) -> int:
        """Numbers that it takes: amplitudes, and nonlinear ones."""
        return len(self.hypothesis.columns.sd) + len(self.hypothesis.source.sought)

    @property
    def standard(self) -> bool:
        """Whether every robot has it, more or less."""
        return self.hypothesis.standard

    @property
    def key(self) -> EffectKey:
        """Effect and joints."""
        return self.hypothesis.key

    @property
    def alone(self) -> Score:
        """The same, without the columns of other forms in memory."""
        return replace(self, hypothesis=self.hypothesis.alone)

    def qualifies(self, thresholds: Thresholds) -> bool:
        """Whether it is certain enough, and large enough to be worth a term."""
        return self.gain > thresholds.log10_bayes_factor * LN10 and self.improvement > thresholds.improvement


def explain_with(
    data: Observations, effects: Sequence[Hypothesis], start: Explanation | None = None, uncertain: Columns = NO_COLUMNS
) -> tuple[Regression, Explanation]:
    """The explanation by some effects, error models found with it.

    Args:
        data: what is explained.
        effects: by which.
        start: an explanation whose error models are those to begin with.
        uncertain: columns that the model may be wrong by beside; if any, theirs are the first amplitudes.
    """
    beside = [uncertain] if len(uncertain.sd) else []
    regression = Regression(data, [*beside, *(effect.columns for effect in effects)])
    explanation = regression.explain(initial_errors(data) if start is None else start.errors)
    errors = None
    for _ in range(_SETTLINGS):
        if errors is not None and alike(errors, explanation.errors):
            break
        errors = explanation.errors
        explanation = regression.explain(errors)
    return regression, explanation


def initial_errors(data: Observations) -> tuple[ErrorModel, ...]:
    """Error models to begin with: those of the reference, or white noise at its limit."""
    return plain_errors(data) if data.reference is None else data.reference.errors


def plain_errors(data: Observations) -> tuple[ErrorModel, ...]:
    """Error models of what is nothing but white noise at its limit, or little more."""
    return tuple(
        ErrorModel(white, _INITIAL_COLOURED * white, _INITIAL_CORRELATION, data.rate) for white in data.limits[:, 0]
    )


# ---------------------------------------------------------------------------------------------------------------
# Of all effects
# ---------------------------------------------------------------------------------------------------------------
def assess(regression: Regression, explanation: Explanation, library: Library) -> list[Score]:
    """Every effect in its best form, best first: by a quick look all of them, by a closer one the most promising.

    Args:
        regression: with the effects that are added already.
        explanation: by these.
        library: all hypotheses.
    """
    count = regression.data.thresholds.close_looks
    screening = Screening(regression, explanation.errors)
    ordered = best_forms(screening, library)
    closer = [_closer(regression, explanation, score, spread) for score, spread in ordered[:count]]
    return sorted(closer, key=lambda score: -score.gain) + [score for score, _ in ordered[count:]]


def best_forms(screening: Screening, library: Library) -> list[tuple[Score, float]]:
    """Each effect in its best form, best first, and what averaging over its forms has changed of its gain."""
    groups = [BestOfGroup.of(screening, group) for group in library if group]
    tops = [group[best.place] for group, best in zip(filter(None, library), groups, strict=True)]
    return [
        (Score(tops[k], groups[k].gain + spread, groups[k].expected_gain), spread) for k, spread in best_groups(groups)
    ]


@dataclass(frozen=True)
class BestOfGroup:
    """The best of some forms of an effect that act in the same joints with as many amplitudes, without its columns.

    Attributes:
        source: the term or distortion.
        key: effect and joints.
        sd: (p,) prior standard deviations of its amplitudes.
        place: among the forms.
        gain: log of the Bayes factor for adding it.
        spread: what averaging over the forms changes of that.
        expected_gain: largest log of the Bayes factor to be expected of a usual amplitude.
        names: of all the forms.
    """

    source: Effect
    key: EffectKey
    sd: Array
    place: int
    gain: float
    spread: float
    expected_gain: float
    names: frozenset[str]

    @classmethod
    def of(cls, screening: Screening, group: Sequence[Hypothesis]) -> BestOfGroup:
        """Of one form or more."""
        gains, expected = screening.gains([hypothesis.columns for hypothesis in group])
        place = int(np.argmax(gains))
        gain, best = float(gains[place]), group[place]
        spread = float(logsumexp(gains)) - gain - float(np.log(len(group)))
        names = frozenset(hypothesis.source.name for hypothesis in group)
        return cls(best.source, best.key, best.columns.sd, place, gain, spread, float(expected.max()), names)


def best_groups(groups: Sequence[BestOfGroup]) -> list[tuple[int, float]]:
    """For each effect the group that holds its best form, best first, and what averaging over all changes of its gain.

    Groups by their places.
    """
    names: dict[EffectKey, set[str]] = {}
    for group in groups:
        names.setdefault(group.key, set()).update(group.names)
    spread = [group.spread - float(np.log(len(names[group.key]))) for group in groups]
    gain = [group.gain + change for group, change in zip(groups, spread, strict=True)]
    best: dict[EffectKey, int] = {}
    for k, group in enumerate(groups):
        if group.key not in best or gain[k] > gain[best[group.key]]:
            best[group.key] = k
    return [(k, spread[k]) for k in sorted(best.values(), key=lambda k: -gain[k])]


def _closer(regression: Regression, explanation: Explanation, score: Score, spread: float) -> Score:
    """The score with its own error models, and by how much the effect improves the fit."""
    data = regression.data
    extended = regression.settle(explanation, score.hypothesis.columns)
    before, after = data.mean_square(explanation.residual), data.mean_square(extended.residual)
    return replace(
        score,
        gain=extended.log_evidence - explanation.log_evidence + spread,
        improvement=float(np.max(_improvement(before, after, data.thresholds))),
        mean_square=after,
    )


def _improvement(before: Array, after: Array, thresholds: Thresholds) -> Array:
    """(n,) fall of the mean squared residual, in units that leave out what is small beside the floor or the rest."""
    return (before - after) / np.maximum(1.0, thresholds.improvement_of_rest / thresholds.improvement * before)


# ---------------------------------------------------------------------------------------------------------------
# Over a blunt floor
# ---------------------------------------------------------------------------------------------------------------
def plain_first(scores: Sequence[Score], data: Observations) -> list[Score]:
    """The scores, best first, but a standard effect before others of its joint that leave hardly less than it does.

    Only where the floor is not sharp, for the earlier model was a poor one there: the friction of a real joint is never
    exactly what a term says, and an elaborate effect that fits it a little better, or better than the floor asks for,
    is not what is missing, however certain the little is.
    """
    ordered: list[Score] = []
    for score in scores:
        place, blunt = len(ordered), not all(data.sharp[j] for j in score.hypothesis.columns.joints)
        advances = blunt and score.standard and score.qualifies(data.thresholds)
        while place and advances and _hardly_better(ordered[place - 1], score, data):
            place -= 1
        ordered.insert(place, score)
    return ordered


def _hardly_better(other: Score, standard: Score, data: Observations) -> bool:
    """Whether another effect of the same joints is no standard one, takes more numbers, and improves little more."""
    if other.standard or other.hypothesis.joints != standard.hypothesis.joints:
        return False
    if other.n_parameters <= standard.n_parameters or other.mean_square is None or standard.mean_square is None:
        return False
    if at_blunt_floor(data, standard.mean_square)[list(standard.hypothesis.columns.joints)].all():
        return True
    improvement = _improvement(standard.mean_square, other.mean_square, data.thresholds)
    return bool(np.max(improvement) < data.thresholds.improvement)


def at_blunt_floor(data: Observations, mean_square: Array) -> Mask:
    """(n,) whether a joint's residual, in units of the floor's mean square, is as small as a blunt floor asks for."""
    return ~data.sharp & (mean_square <= data.thresholds.at_blunt_floor**2)
