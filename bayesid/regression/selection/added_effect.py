"""An effect that was added, weighed against all that could stand in its place; and what a log could not show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import logsumexp

from bayesid.effects.catalogue import main_forms
from bayesid.effects.formula import Description
from bayesid.regression.selection.columns import NO_COLUMNS, Columns
from bayesid.regression.selection.fitted_effects import LN10, FittedEffects, Observations, Thresholds
from bayesid.regression.selection.hypotheses import EffectKey, Hypothesis, Library
from bayesid.regression.selection.regression import explain
from bayesid.regression.selection.scores import Score, assess, plain_first

Quantity = tuple[float, float, str]
"""Value, standard deviation (NaN where none is known) and unit."""


@dataclass(frozen=True)
class AddedEffect:
    """An effect that was added, weighed against all that could stand in its place."""

    hypothesis: Hypothesis  #: the form that was added
    gain: float  #: log of the Bayes factor for it, given all others that were added
    #: of the effect in these joints, or one that is equivalent to it, among the catalogue, nothing missing and
    #: something else (:eq:`effect-probability`)
    probability: float
    nothing_missing: float  #: probability that nothing is missing in its place
    something_else: float  #: probability that it is something outside of the catalogue
    competing: tuple[Score, ...]  #: the alternatives, best first, itself included
    equivalent: tuple[str, ...]  #: names of the effects that the log cannot tell from it
    included: float = 1.0  #: probability of it over all sets that are weighed (`bayesid.discrepancy.sets.WeighedSet`)
    #: of an error of the robot's table, those of other joints' rows that the log cannot tell from it
    elsewhere: tuple[EffectKey, ...] = ()
    #: by their names; of what the earlier model has too, the new value and the change
    parameters: dict[str, Quantity] = field(default_factory=dict)
    readable: dict[str, Quantity] = field(default_factory=dict)  #: what people read in their place, by its names
    description: Description | None = None  #: of an effect without a name: its variables, formula and families
    size: EffortSize | None = None  #: how large its effort is on held-back data; None while that is not known
    cost: Cost | None = None  #: what the error there is without it; None likewise

    def __repr__(self) -> str:
        where = f"joint {', '.join(map(str, self.joints))}" if self.joints else "the whole robot"
        log_data = f"log10 of the Bayes factor {self.log10_bayes_factor:.3g}, probability {self.probability:.3g}"
        return f"AddedEffect {self.effect}, {where}: {log_data}; go on with .parameters, .readable, .rivals"

    @property
    def alone(self) -> AddedEffect:
        """The same, without the columns of other forms in memory."""
        return replace(self, hypothesis=self.hypothesis.alone, competing=tuple(score.alone for score in self.competing))

    @property
    def log10_bayes_factor(self) -> float:
        """For it, given all others that were added."""
        return float(self.gain / LN10)

    @property
    def variables(self) -> tuple[str, ...]:
        """What an effect without a name depends on, such as q4, dq5, tau5 or t; empty of others."""
        return () if self.description is None else self.description.variables

    @property
    def formula(self) -> str:
        """Of an effect without a name; empty of others."""
        return "" if self.description is None else self.description.formula

    @property
    def effect(self) -> str:
        """Name in the catalogue."""
        return self.hypothesis.effect

    @property
    def joints(self) -> tuple[int, ...]:
        """From 1, in which it acts; none named: on the whole robot."""
        return self.hypothesis.joints


def weigh(
    fitted_effects: FittedEffects, library: Library, effect: Hypothesis, uncertain: Columns = NO_COLUMNS
) -> AddedEffect:
    """An effect of an explanation against all in the library that could stand in its place, the other effects given.

    One without a name is what was outside of the catalogue: it shares that prior. `uncertain` are columns that the
    model may be wrong by beside.
    """
    data, others = fitted_effects.data, fitted_effects.without(effect)
    limits, without = data.thresholds, explain(data, others, fitted_effects, uncertain)
    scores = plain_first(assess(without, _rivals(library, effect, others)), data)
    scored = next((score.gain for score in scores if score.key == effect.key), -np.inf)
    as_added = explain(data, fitted_effects.effects, fitted_effects, uncertain).log_evidence - without.log_evidence
    gain = max(scored, as_added)  # averaged over the library's forms, or of the form that was refined
    share = (1.0 - limits.nothing_missing - limits.something_else) / len(main_forms())
    places = max(1, data.effort.shape[1])
    scores = [replace(one, gain=gain) if one.key == effect.key else one for one in scores]
    logs = [s.gain + np.log(share / (places if s.hypothesis.joints else 1)) for s in scores]
    nothing = without.log_evidence_as_noise - without.log_evidence + np.log(limits.nothing_missing)
    unnamed = [] if effect.source.can_be_missing else [gain + np.log(limits.something_else)]
    total = float(logsumexp([*logs, *unnamed, nothing, np.log(limits.something_else)]))
    level = scored if scored > 0.0 else gain  # others are in the library's forms too
    alike = {s.key: s for s in scores if s.gain > level - limits.equivalent * LN10}
    rows = {key for key, score in alike.items() if score.hypothesis.source.of_table}
    elsewhere = {key for key in rows if effect.source.of_table and key[1] != effect.joints}
    equivalent = {name for name, _ in set(alike) - elsewhere} - {effect.effect}
    class_logs = [
        value
        for value, score in zip(logs, scores, strict=True)
        if score.key in {effect.key, *elsewhere} or score.hypothesis.effect in equivalent
    ] + unnamed
    return AddedEffect(
        hypothesis=effect,
        gain=gain,
        probability=float(np.exp(logsumexp(class_logs) - total)) if class_logs else 0.0,
        nothing_missing=float(np.exp(nothing - total)),
        something_else=float(np.exp(np.log(limits.something_else) - total)),
        competing=tuple(scores),
        equivalent=tuple(sorted(equivalent)),
        elsewhere=tuple(sorted(elsewhere)),
    )


def _rivals(library: Library, effect: Hypothesis, others: Sequence[Hypothesis]) -> list[list[Hypothesis]]:
    """What could stand in the place of an effect: all that acts in one of its joints, others' effects left out."""
    joints, taken = effect.columns.joints, {other.key for other in others}
    groups = [group for group in library if group and group[0].columns.joints & joints]
    return [[rival for rival in group if rival.key not in taken] for group in groups]


def not_testable(scores: Sequence[Score], n_joints: int, thresholds: Thresholds = Thresholds()) -> list[EffectKey]:
    """Effects and joints that this log could not show even if they were of a usual size.

    An effect that has no score in one of the n joints could not be tried there.
    """
    tried = {score.key: score for score in scores}
    single = {(j,) for j in range(1, n_joints + 1)}
    places = {
        effect: {()} if form.acts_on != "joint" else single for effect, form in main_forms().items() if not form.frees
    }
    untried = {(effect, joints) for effect, where in places.items() for joints in where} - set(tried)
    testable, needed = thresholds.testable * LN10, thresholds.log10_bayes_factor * LN10
    invisible = {key for key, score in tried.items() if score.expected_gain < testable and score.gain < needed}
    return sorted(untried | invisible)


RATED, LARGEST_READING = "rated effort", "largest effort in this log"
"""What an effect's largest effort is held against: the first where the robot's file tells it, else the second."""


@dataclass(frozen=True)
class EffortSize:
    """How large an effect's own effort is on held-back data, in the joint where that is largest."""

    joint: int  #: from 1
    rms: float  #: N m
    largest: float  #: absolute value, N m
    reference: float  #: effort that the largest is held against, N m
    of: str  #: what that is, `RATED` or `LARGEST_READING`

    @property
    def share(self) -> float:
        """Of the reference that the largest effort is; NaN where the reference is zero."""
        return _ratio(self.largest, self.reference)


@dataclass(frozen=True)
class Cost:
    """What the error of the efforts on held-back data is without an effect, in the joint where that matters most.

    Of those that it acts in: where the mean squared error rises most, as a share of the mean squared effort, so that
    units do not matter.
    """

    joint: int  #: from 1
    before: float  #: RMS error without the effect, all others kept and their numbers found anew, N m
    after: float  #: RMS error with it, N m
    effort: float  #: RMS effort of the joint there, N m

    @property
    def share_before(self) -> float:
        """Error without the effect over the joint's effort; NaN where that is zero."""
        return _ratio(self.before, self.effort)

    @property
    def share_after(self) -> float:
        """Error with it over the joint's effort; NaN where that is zero."""
        return _ratio(self.after, self.effort)


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole > 0.0 else np.nan


def preexisting(without: FittedEffects, library: Library) -> frozenset[EffectKey]:
    """Errors of the table that cannot have come since the earlier log: they do not show above the noise floor.

    The floor holds what the earlier model left of its own log. An error that was there already is a part of it, however
    well it explains what this log leaves; one that is new adds to it, most of all in the joint where it is largest.
    `without` is the explanation by the model alone.
    """
    data, limits = without.data, without.data.thresholds
    most = np.where(data.sharp, limits.above_floor, limits.above_blunt_floor)
    above = without.mean_square > most**2
    return frozenset(h.key for group in library for h in group if h.source.of_table and not above[_strongest(data, h)])


def was_there(with_it: FittedEffects, without: FittedEffects) -> bool:
    """Whether the earlier log speaks against an error of the table, as surely as an effect must be found.

    A model that was bent by the error fits it badly: its coefficients have to move far from what that log showed. Those
    of a model that was right then stay, and without the error they would have to move.
    """
    data = with_it.data
    against = 0.5 * (data.information.misfit(with_it.beta) - data.information.misfit(without.beta))
    return against > data.thresholds.log10_bayes_factor * LN10


def _strongest(data: Observations, hypothesis: Hypothesis) -> int:
    """The (0-based) joint in which an effect is largest beside the noise."""
    rows, used = hypothesis.columns.rows, data.used
    size = {j: float(np.mean(x[used[:, j]] ** 2)) / data.floor[j] ** 2 for j, x in rows.items() if used[:, j].any()}
    return max(size, key=lambda j: size[j]) if size else 0
