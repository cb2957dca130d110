"""The selection of effects: on some of the data, each borne out by the data that are held back."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.discrepancy.case import Case
from bayesid.discrepancy.compare import NoiseFloor, Trial
from bayesid.fit.effects.added_effect import AddedEffect, weigh
from bayesid.fit.effects.error_model import ErrorModel
from bayesid.fit.effects.explanation import LN10, Explanation, Observations
from bayesid.fit.effects.extension import Extension, extend
from bayesid.fit.effects.forward import Candidate, Products, Rules, select_forward
from bayesid.fit.effects.held_back import HeldBackErrors, bears_out
from bayesid.fit.effects.hypotheses import EffectKey, Hypothesis, hypotheses
from bayesid.fit.effects.refinement import refined
from bayesid.fit.effects.relinearisation import sharpened
from bayesid.fit.effects.scores import Library, Score, assess, at_blunt_floor, best_forms, explain_with
from bayesid.fit.effects.screening import Screening
from bayesid.fit.effects.thresholds import Thresholds
from bayesid.process import in_parallel
from bayesid.progress import SILENT, Progress

_SETTLINGS = 2
"""Times that signs and coefficients take turns before effects are looked for; a round number, not studied."""

ON_LOG, HELD_BACK, GROWN = "log", "held-back data", "gap grew on held-back data"
"""Which data say that a joint stays unexplained: its residual on the log is above the floor, or that on held-back data;
or identifying the model again has made it larger there."""


@dataclass(frozen=True)
class _Chosen:
    """Effects, the explanation by them, and the log with its signs settled under it."""

    effects: tuple[Hypothesis, ...]
    explanation: Explanation
    data: Observations

    @property
    def keys(self) -> set[EffectKey]:
        """Effects and joints."""
        return {effect.key for effect in self.effects}

    def weighed(self, case: Case, library: Library, effect: Hypothesis) -> AddedEffect:
        """One of the effects against all that could stand in its place."""
        return weigh(self.data, library, self.effects, self.explanation, effect, case.uncertain)

    def without(self, *gone: Hypothesis) -> tuple[Hypothesis, ...]:
        """The effects but some."""
        return tuple(effect for effect in self.effects if all(effect is not other for other in gone))


@dataclass(frozen=True)
class Selection:
    """Effects that explain a log and are borne out by held-back data.

    Attributes:
        hypotheses: in the order in which they were added.
        explanation: by all of them.
        before: without any, and
        data_before: the data that it explains.
        data: that they were selected on, signs settled under them.
        library: all hypotheses.
        extension: the extended model.
        rejected: effects that had passed by their evidence, but that held-back data did not bear out or that were no
            more than stand-ins; each with the set that it was chosen in.
    """

    hypotheses: tuple[Hypothesis, ...]
    explanation: Explanation
    before: Explanation
    data_before: Observations
    data: Observations
    library: Library
    extension: Extension
    rejected: tuple[tuple[_Chosen, Hypothesis], ...]

    def weighed(self, case: Case) -> Weighed:
        """Its effects, and those that were rejected, against all that could stand in their places."""
        chosen = _Chosen(self.hypotheses, self.explanation, self.data)
        those = [*((chosen, effect) for effect in self.hypotheses), *self.rejected]
        weigh_all: list[Callable[[], Any]] = [partial(some.weighed, case, self.library, one) for some, one in those]
        known = [*_parts(self.library), *self.hypotheses, *(effect for _, effect in self.rejected)]
        scores, *weighed = in_parallel([self._scores, *weigh_all], known=known)
        added = len(self.hypotheses)
        return Weighed(tuple(scores), tuple(weighed[:added]), tuple(weighed[added:]))

    def _scores(self) -> list[Score]:
        """Of the whole catalogue, before anything was added."""
        regression, before = explain_with(self.data_before, ())
        return assess(regression, before, self.library)


@dataclass(frozen=True)
class Weighed:
    """What the choice was between.

    Attributes:
        scores: of the whole catalogue, before anything was added.
        added: the effects of the selection.
        refused: those that were rejected, each as it was weighed when it was chosen.
    """

    scores: tuple[Score, ...]
    added: tuple[AddedEffect, ...]
    refused: tuple[AddedEffect, ...]


@dataclass(frozen=True, eq=False)
class _Sets:
    """Sets of effects that come up again and again, once for every effect that fails: each is settled and ranked once.

    Attributes:
        case: what stays the same.
        library: all hypotheses.
        settled_sets: by the ids of their effects.
        rankings: by the id of a set, and which joints are closed.
    """

    case: Case
    library: Library
    settled_sets: dict[tuple[int, ...], _Chosen] = field(default_factory=dict)
    rankings: dict[tuple[int, bytes], _Ranking] = field(default_factory=dict)

    def settled(self, effects: Sequence[Hypothesis], data: Observations) -> _Chosen:
        """Some effects, signs settled under them, from data that are settled under nearly the same."""
        key = tuple(id(effect) for effect in effects)
        if key not in self.settled_sets:
            _, explanation = explain_with(data, effects)
            data = self.case.settled(effects, explanation)
            _, explanation = explain_with(data, effects, explanation)
            self.settled_sets[key] = _Chosen(tuple(effects), explanation, data)
        return self.settled_sets[key]

    def ranked(self, chosen: _Chosen, closed: Mask) -> _Ranking:
        """All other effects on top of a set: the standard ones alone in joints that are closed (n,)."""
        key = id(chosen), closed.tobytes()
        if key not in self.rankings:
            regression, explanation = explain_with(chosen.data, chosen.effects, chosen.explanation)
            allowed = [
                [h for h in group if h.standard or not all(closed[j] for j in h.columns.joints)]
                for group in self.library
                if group[0].key not in chosen.keys
            ]
            scores = best_forms(Screening(regression, explanation.errors), allowed)
            self.rankings[key] = _Ranking(chosen, explanation.errors, [score.hypothesis for score, _ in scores])
        return self.rankings[key]


@dataclass(frozen=True)
class _Ranking:
    """Other effects on top of a set, in their best forms, best first, and the errors that they were judged by."""

    chosen: _Chosen
    errors: tuple[ErrorModel, ...]
    effects: list[Hypothesis]


def select_effects(case: Case, progress: Progress = SILENT) -> Selection:
    """Effects that explain the log and are borne out by the data that are held back."""
    data, library = _begin(case)
    _, before = explain_with(data, ())
    chosen, rejected = _Chosen((), before, data), dict[EffectKey, tuple[_Chosen, Hypothesis]]()
    sets, most = _Sets(case, library), case.thresholds.max_vetoes
    for done in range(most + 1):
        progress("naming effects", done, most + 1)
        chosen = _selected(sets, chosen, set(rejected))
        failed = _failed(case, chosen)
        if failed is None:
            break
        rejected[failed.key] = chosen, failed
        chosen = sets.settled(chosen.without(failed), chosen.data)
    else:  # no more is added, what fails goes
        while (failed := _failed(case, chosen)) is not None:
            rejected[failed.key] = chosen, failed
            chosen = sets.settled(chosen.without(failed), chosen.data)
    chosen, stand_ins = _without_stand_ins(sets, chosen)
    effects, explanation = sharpened(chosen.data, chosen.effects, case.columns, case.scene)
    return Selection(
        hypotheses=tuple(effects),
        explanation=explanation,
        before=before,
        data_before=data,
        data=chosen.data,
        library=library,
        extension=extend(case.knowledge, case.coefficients, effects, explanation),
        rejected=tuple((rejected | stand_ins)[key] for key in sorted(rejected | stand_ins)),
    )


def _begin(case: Case) -> tuple[Observations, Library]:
    """Signs settled under the model, its parameters moved as far as the earlier log allows."""
    predicted = case.before
    for _ in range(_SETTLINGS):
        _, explanation = explain_with(case.data(predicted), ())
        predicted = case.predicted((), explanation)
    library = list(hypotheses(case.model, case.scene(predicted), case.trial.used))
    refit = case.standard_refit
    return case.data(predicted, None if refit is None else refit.probability), library


def _parts(library: Library) -> list[object]:
    """Hypotheses, and what makes others."""
    together = [hypothesis for group in library for hypothesis in group]
    return [*together, *{id(hypothesis.make): hypothesis.make for hypothesis in together}.values()]


# ---------------------------------------------------------------------------------------------------------------
# On the log
# ---------------------------------------------------------------------------------------------------------------
def _selected(sets: _Sets, chosen: _Chosen, vetoed: set[EffectKey]) -> _Chosen:
    """Selected by evidence, the signs settled and the numbers refined under what was found, until no more is found.

    Where the floor is blunt, for the earlier model was a poor one, standard effects come first, and nothing else where
    they reach it: the friction of a real joint is never exactly what a term says.
    """
    case, limits = sets.case, sets.case.thresholds
    rules = Rules(limits.log10_bayes_factor * LN10, limits.max_effects, partial(_sharper, case))
    seen = [chosen.keys]
    standard = not chosen.data.sharp.all() and not chosen.effects
    while True:
        done = at_blunt_floor(chosen.data, chosen.data.mean_square(chosen.explanation.residual))
        ranking = sets.ranked(chosen, ~chosen.data.sharp if standard else done)
        others = [effect for effect in ranking.effects if effect.key not in vetoed][: limits.short_list]
        tried = [*chosen.effects, *others]
        products = Products(chosen.data, tried, list(ranking.errors), case.uncertain, predicting=False)
        _, found = select_forward(products, rules, frozenset(chosen.keys))
        effects = refined(chosen.data, [candidate.hypothesis for candidate in found], sets.library)
        chosen = sets.settled(effects, chosen.data)
        if not standard and chosen.keys in seen:
            return chosen
        seen.append(chosen.keys)
        standard = False


def _sharper(
    case: Case, products: Products[Hypothesis], found: Sequence[Candidate[Hypothesis]]
) -> Mapping[int, Hypothesis]:
    """Distortions about the numbers that were found, by the ids of their old forms: they are linear near these."""
    effects = [candidate.hypothesis for candidate in found]
    if all(effect.source.linear for effect in effects):
        return {}
    new = sharpened(products.data, effects, case.columns, case.scene)[0]
    return {id(old): form for old, form in zip(effects, new, strict=True)}


# ---------------------------------------------------------------------------------------------------------------
# On held-back data
# ---------------------------------------------------------------------------------------------------------------
def _failed(case: Case, chosen: _Chosen) -> Hypothesis | None:
    """The last effect that does not help on held-back data, beside the others."""
    after = _held_back(case, chosen.effects, chosen.explanation)
    for effect in reversed(chosen.effects):
        others = chosen.without(effect)
        _, explanation = explain_with(chosen.data, others, chosen.explanation)
        before = _held_back(case, others, explanation)
        if not bears_out(after, before, effect.columns.joints, case.thresholds.held_back_improvement):
            return effect
    return None


def _held_back(case: Case, effects: Sequence[Hypothesis], explanation: Explanation) -> HeldBackErrors:
    """Errors on blocks of the held-back data."""
    extension = extend(case.knowledge, case.coefficients, effects, explanation)
    if any(effect.source.reveals for effect in effects):
        extension = case.refitted(extension, case.predicted(effects, explanation))
    return case.held_back.errors(case.held_back.effort(case.model, extension.model, extension.theta))


# ---------------------------------------------------------------------------------------------------------------
# What stays unexplained
# ---------------------------------------------------------------------------------------------------------------
def _without_stand_ins(sets: _Sets, chosen: _Chosen) -> tuple[_Chosen, dict[EffectKey, tuple[_Chosen, Hypothesis]]]:
    """Leaves out effects of joints that stay unexplained, unless they explain most of what was to be explained."""
    gone, case = dict[EffectKey, tuple[_Chosen, Hypothesis]](), sets.case
    predicted = case.predicted(chosen.effects, chosen.explanation)
    for joint, _ in unexplained(case.trial, predicted, case.floor(predicted), chosen.explanation, case.thresholds):
        of_joint = [effect for effect in chosen.effects if effect.columns.joints == {joint - 1}]
        others = chosen.without(*of_joint)
        _, without = explain_with(chosen.data, others, chosen.explanation)
        before = _held_back(case, others, without).rms[joint - 1] ** 2
        after = _held_back(case, chosen.effects, chosen.explanation).rms[joint - 1] ** 2
        if of_joint and before - after < case.thresholds.explained_share * (before - chosen.data.floor[joint - 1] ** 2):
            gone |= {effect.key: (chosen, effect) for effect in of_joint}
            chosen = sets.settled(others, chosen.data)
    return chosen, gone


def unexplained(
    trial: Trial, predicted: Array, floor: NoiseFloor, explanation: Explanation, thresholds: Thresholds
) -> tuple[tuple[int, float], ...]:
    """Joint (from 1) and ratio to the floor, of those whose residual is surely above it on the log."""
    gap = trial.gap(predicted)
    sure = explanation.free_evidence - explanation.noise_evidence > thresholds.log10_bayes_factor * LN10
    above = np.flatnonzero(sure & floor.exceeded(gap, thresholds)).tolist()
    return tuple((j + 1, float(gap[j] / floor.rms[j])) for j in above)


def unexplained_anywhere(
    on_log: Sequence[tuple[int, float]],
    before: HeldBackErrors,
    after: HeldBackErrors,
    floor: NoiseFloor,
    thresholds: Thresholds,
) -> tuple[tuple[tuple[int, float], ...], dict[int, tuple[str, ...]]]:
    """Joint (from 1) and ratio to the floor of those that stay unexplained, and by joint which data say so.

    Args:
        on_log: those on the log; their ratio is kept.
        before: errors of the model as it was on held-back data, and
        after: of the extended one.
        floor: of the noise.
        thresholds: that decide.
    """
    ratio = dict(on_log)
    above = floor.exceeded(after.rms, thresholds) & after.surely_above(floor.rms)
    said = {ON_LOG: set(ratio), HELD_BACK: _joints(above), GROWN: _joints(after.surely_grown(before))}
    joints = sorted(set().union(*said.values()))
    ratios = tuple((j, ratio.get(j, float(after.rms[j - 1] / floor.rms[j - 1]))) for j in joints)
    return ratios, {j: tuple(name for name, which in said.items() if j in which) for j in joints}


def _joints(which: Mask) -> set[int]:
    """From 1, of a mask (n,)."""
    return set((np.flatnonzero(which) + 1).tolist())
