"""An added effect compared with its alternatives, and effects that a log cannot show."""

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
from bayesid.regression.tuning import TUNING

Quantity = tuple[float, float, str]
"""Value, standard deviation (NaN where none is known) and unit."""


@dataclass(frozen=True)
class AddedEffect:
    """An added effect, compared with its alternatives."""

    hypothesis: Hypothesis  #: the form that was added
    gain: float  #: log of the Bayes factor for it, given all other added effects
    #: of the effect in these joints, or an equivalent one, among the catalogue, "nothing missing" and "something else"
    #: (:eq:`effect-probability`)
    probability: float
    nothing_missing: float  #: probability that nothing is missing
    something_else: float  #: probability of an effect outside of the catalogue
    competing: tuple[Score, ...]  #: the alternatives with the effect itself, best first
    equivalent: tuple[str, ...]  #: names of the effects that the log cannot distinguish from it
    included: float = 1.0  #: its probability over all weighed sets (`bayesid.discrepancy.sets.WeighedSet`)
    #: of an error of the robot's table: errors of other joints' rows that the log cannot distinguish from it
    elsewhere: tuple[EffectKey, ...] = ()
    #: by name; of a parameter that the earlier model has too, the new value and the change
    parameters: dict[str, Quantity] = field(default_factory=dict)
    readable: dict[str, Quantity] = field(default_factory=dict)  #: derived physical quantities, by name
    description: Description | None = None  #: of a learned effect: its variables, formula and families
    size: EffortSize | None = None  #: its effort on held-back data; None until computed
    cost: Cost | None = None  #: the error on held-back data without it; None until computed

    def __repr__(self) -> str:
        where = f"joint {', '.join(map(str, self.joints))}" if self.joints else "the whole robot"
        log_data = f"log10 of the Bayes factor {self.log10_bayes_factor:.3g}, probability {self.probability:.3g}"
        return f"AddedEffect {self.effect}, {where}: {log_data}; next: .parameters, .readable, .competing"

    @property
    def alone(self) -> AddedEffect:
        """A copy with its own arrays, which keeps no other forms in memory."""
        return replace(self, hypothesis=self.hypothesis.alone, competing=tuple(score.alone for score in self.competing))

    @property
    def log10_bayes_factor(self) -> float:
        """Bayes factor for it, given all other added effects."""
        return float(self.gain / LN10)

    @property
    def variables(self) -> tuple[str, ...]:
        """Variables of a learned effect, such as q4, dq5, tau5 or t; empty for others."""
        return () if self.description is None else self.description.variables

    @property
    def formula(self) -> str:
        """Formula of a learned effect; empty for others."""
        return "" if self.description is None else self.description.formula

    @property
    def effect(self) -> str:
        """Name in the catalogue."""
        return self.hypothesis.effect

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints from 1 in which it acts; empty: the whole robot."""
        return self.hypothesis.joints


def weigh(
    fitted_effects: FittedEffects, library: Library, effect: Hypothesis, uncertain: Columns = NO_COLUMNS
) -> AddedEffect:
    """Compares an added effect with all alternatives in the library, given the other effects.

    A learned effect takes the prior of "something else". `uncertain` are further columns of model error.
    """
    data, others = fitted_effects.data, fitted_effects.without(effect)
    limits, without = data.thresholds, explain(data, others, fitted_effects, uncertain)
    scores = plain_first(assess(without, _rivals(library, effect, others)), data)
    scored = next((score.gain for score in scores if score.key == effect.key), -np.inf)
    as_added = explain(data, fitted_effects.effects, fitted_effects, uncertain).log_evidence - without.log_evidence
    gain = max(scored, as_added)  # averaged over the library's forms, or that of the refined form
    share = (1.0 - limits.nothing_missing - limits.something_else) / len(main_forms())
    places = max(1, data.effort.shape[1])
    scores = [replace(score, gain=gain) if score.key == effect.key else score for score in scores]
    logs = [s.gain + np.log(share / (places if s.hypothesis.joints else 1)) for s in scores]
    nothing = without.log_evidence_as_noise - without.log_evidence + np.log(limits.nothing_missing)
    learned = [] if effect.source.can_be_missing else [gain + np.log(limits.something_else)]
    total = float(logsumexp([*logs, *learned, nothing, np.log(limits.something_else)]))
    level = scored if scored > 0.0 else gain  # alternatives are in the library's forms too
    alike = {s.key: s for s in scores if s.gain > level - limits.equivalent * LN10}
    rows = {key for key, score in alike.items() if score.hypothesis.source.of_table}
    elsewhere = {key for key in rows if effect.source.of_table and key[1] != effect.joints}
    equivalent = {name for name, _ in set(alike) - elsewhere} - {effect.effect}
    class_logs = [
        value
        for value, score in zip(logs, scores, strict=True)
        if score.key in {effect.key, *elsewhere} or score.hypothesis.effect in equivalent
    ] + learned
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
    """Alternatives to an effect: all that act in one of its joints, except the other added effects."""
    joints, taken = effect.columns.joints, {other.key for other in others}
    groups = [group for group in library if group and group[0].columns.joints & joints]
    return [[rival for rival in group if rival.key not in taken] for group in groups]


def not_testable(scores: Sequence[Score], n_joints: int, thresholds: Thresholds = Thresholds()) -> list[EffectKey]:
    """Effects and joints that this log could not show even at a usual size.

    An effect without a score in one of the n joints could not be tested there.
    """
    tried = {score.key: score for score in scores}
    single = {(j,) for j in range(1, n_joints + 1)}
    places = {
        effect: {()} if form.acts_on != "joint" else single for effect, form in main_forms().items() if not form.frees
    }
    untried = {(effect, joints) for effect, where in places.items() for joints in where} - set(tried)
    testable, needed = TUNING.testable * LN10, thresholds.log10_bayes_factor * LN10
    invisible = {key for key, score in tried.items() if score.expected_gain < testable and score.gain < needed}
    return sorted(untried | invisible)


RATED, LARGEST_READING = "rated effort", "largest effort in this log"
"""Reference of an effect's largest effort: the first if the robot's file states it, else the second."""


@dataclass(frozen=True)
class EffortSize:
    """Size of an effect's effort on held-back data, in the joint where it is largest."""

    joint: int  #: from 1
    rms: float  #: N m
    largest: float  #: absolute value, N m
    reference: float  #: effort to compare it with, N m
    of: str  #: `RATED` or `LARGEST_READING`

    @property
    def share(self) -> float:
        """The largest effort over the reference; NaN if the reference is zero."""
        return _ratio(self.largest, self.reference)


@dataclass(frozen=True)
class Cost:
    """Error of the efforts on held-back data with and without an effect, in the joint where it matters most.

    That is the joint in which the mean squared error rises most, relative to the mean squared effort.
    """

    joint: int  #: from 1
    before: float  #: RMS error without the effect, all others refitted, N m
    after: float  #: RMS error with it, N m
    effort: float  #: RMS effort of the joint there, N m

    @property
    def share_before(self) -> float:
        """Error without the effect over the joint's effort; NaN if that is zero."""
        return _ratio(self.before, self.effort)

    @property
    def share_after(self) -> float:
        """Error with it over the joint's effort; NaN if that is zero."""
        return _ratio(self.after, self.effort)


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole > 0.0 else np.nan


def preexisting(without: FittedEffects, library: Library) -> frozenset[EffectKey]:
    """Errors of the robot's table that are not new since the earlier log: they stay below the noise floor.

    The floor includes the earlier model's residual on its own log, and with it an old error. A new error adds to it,
    most in the joint where it is largest. `without` is the fit by the model alone.
    """
    data = without.data
    most = np.where(data.reliable, TUNING.above_floor, TUNING.above_unreliable_floor)
    above = without.mean_square > most**2
    return frozenset(h.key for group in library for h in group if h.source.of_table and not above[_strongest(data, h)])


def was_there(with_it: FittedEffects, without: FittedEffects) -> bool:
    """Whether the earlier log contradicts an error of the table, with the Bayes factor needed to add an effect.

    If the error is new, it must not move the earlier coefficients; if it is old, leaving it out moves them. The misfit
    to the earlier log with and without it decides.
    """
    data = with_it.data
    against = 0.5 * (data.information.misfit(with_it.beta) - data.information.misfit(without.beta))
    return against > data.thresholds.log10_bayes_factor * LN10


def _strongest(data: Observations, hypothesis: Hypothesis) -> int:
    """The 0-based joint in which an effect is largest relative to the noise."""
    rows, used = hypothesis.columns.rows, data.used
    size = {j: float(np.mean(x[used[:, j]] ** 2)) / data.floor[j] ** 2 for j, x in rows.items() if used[:, j].any()}
    return max(size, key=lambda j: size[j]) if size else 0
