"""The selection of effects: on some of the data, each validated on the data that are held back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.discrepancy.case import Case
from bayesid.discrepancy.compare import NoiseFloor, Trial
from bayesid.fit.effects.explanation import LN10, Explanation, Observations
from bayesid.fit.effects.extension import Extension, extend
from bayesid.fit.effects.hypotheses import EffectKey, Hypothesis, hypotheses
from bayesid.fit.effects.relinearisation import sharpened
from bayesid.fit.effects.scores import Library, explain_with
from bayesid.fit.effects.selection import Selection, select
from bayesid.fit.effects.thresholds import Thresholds
from bayesid.progress import SILENT, Progress

_SETTLINGS = 2
"""Times that signs and coefficients take turns before effects are looked for; a round number, not studied."""


@dataclass(frozen=True)
class ValidatedSelection:
    """Effects that explain a log and are borne out by held-back data.

    Attributes:
        selection: these effects and their explanation.
        data: that they were selected on, signs settled under them.
        library: all hypotheses.
        extension: the extended model.
        vetoed: effect and joints that held-back data did not bear out.
    """

    selection: Selection
    data: Observations
    library: Library
    extension: Extension
    vetoed: tuple[EffectKey, ...]


@dataclass(frozen=True)
class Vetoes:
    """What held-back data have ruled out.

    Attributes:
        effects: that are not borne out.
        joints: (0-based) in which nothing further is added.
    """

    effects: frozenset[EffectKey] = frozenset()
    joints: frozenset[int] = frozenset()

    def allow(self, hypothesis: Hypothesis) -> bool:
        """Whether a hypothesis may be added."""
        return hypothesis.key not in self.effects and not hypothesis.columns.joints <= self.joints

    def against(self, *effects: Hypothesis, joints: set[int] | frozenset[int] = frozenset()) -> Vetoes:
        """More of them."""
        return Vetoes(self.effects | {effect.key for effect in effects}, self.joints | joints)


def select_validated(case: Case, progress: Progress = SILENT) -> ValidatedSelection:
    """Effects that explain the log and are borne out by the data that are held back."""
    data, library = _begin(case)
    first = select(data, library, (), case.settled)
    data, selection, vetoes = _borne_out(case, data, library, first, progress)
    data, selection, vetoes = _without_stand_ins(case, data, selection, vetoes)
    effects, explanation = sharpened(data, selection.hypotheses, case.columns, case.scene)
    selection = replace(first, hypotheses=tuple(effects), explanation=explanation)
    extension = extend(case.knowledge, case.coefficients, effects, explanation)
    return ValidatedSelection(selection, data, library, extension, tuple(sorted(vetoes.effects)))


def _begin(case: Case) -> tuple[Observations, list[list[Hypothesis]]]:
    """Signs settled under the model, its parameters moved as far as the earlier log allows."""
    predicted = case.before
    for _ in range(_SETTLINGS):
        _, explanation = explain_with(case.data(predicted), ())
        predicted = case.predicted((), explanation)
    library = list(hypotheses(case.model, case.scene(predicted), case.trial.used))
    refit = case.standard_refit
    return case.data(predicted, None if refit is None else refit.probability), library


def _borne_out(
    case: Case, data: Observations, library: Library, selection: Selection, progress: Progress
) -> tuple[Observations, Selection, Vetoes]:
    """Selects again, without what held-back data do not bear out, until they bear all of it out."""
    vetoes, most = Vetoes(), case.thresholds.max_vetoes
    for done in range(most):
        progress("naming effects", done, most + 1)
        data = case.settled(selection.hypotheses, selection.explanation)
        failed = _failed(case, data, selection.hypotheses)
        if failed is None:
            return data, selection, vetoes
        joints = failed.columns.joints
        vetoes = vetoes.against(failed, joints=joints & set(_unexplained_joints(case, selection)))
        kept = [effect for effect in selection.hypotheses if effect is not failed]
        if joints <= vetoes.joints:
            kept = kept[: selection.hypotheses.index(failed)]
        selection = select(data, library, kept, case.settled, vetoes.allow)
    while (failed := _failed(case, data, selection.hypotheses)) is not None:  # no more is added, what fails goes
        vetoes = vetoes.against(failed)
        kept = [effect for effect in selection.hypotheses if effect is not failed]
        selection = replace(selection, hypotheses=tuple(kept), explanation=explain_with(data, kept)[1])
    return data, selection, vetoes


def _without_stand_ins(
    case: Case, data: Observations, selection: Selection, vetoes: Vetoes
) -> tuple[Observations, Selection, Vetoes]:
    """Leaves out effects of joints that stay unexplained, unless they explain most of what was to be explained."""
    for joint in _unexplained_joints(case, selection):
        of_joint = [effect for effect in selection.hypotheses if effect.columns.joints == {joint}]
        others = [effect for effect in selection.hypotheses if effect not in of_joint]
        used = case.held_back.trial.used[:, joint]
        _, without = explain_with(data, others, selection.explanation)
        before = np.mean(_held_back_residual(case, others, without)[used, joint] ** 2)
        residual = _held_back_residual(case, selection.hypotheses, selection.explanation)
        after = np.mean(residual[used, joint] ** 2)
        if of_joint and before - after < case.thresholds.explained_share * (before - data.floor[joint] ** 2):
            vetoes = vetoes.against(*of_joint)
            data = case.settled(others, without)
            selection = replace(selection, hypotheses=tuple(others), explanation=explain_with(data, others)[1])
    return data, selection, vetoes


def _unexplained_joints(case: Case, selection: Selection) -> list[int]:
    """(0-based) joints whose residual these effects leave above the floor."""
    predicted = case.predicted(selection.hypotheses, selection.explanation)
    ratios = unexplained(case.trial, predicted, case.floor(predicted), selection.explanation, case.thresholds)
    return [joint - 1 for joint, _ in ratios]


def unexplained(
    trial: Trial, predicted: Array, floor: NoiseFloor, explanation: Explanation, thresholds: Thresholds
) -> tuple[tuple[int, float], ...]:
    """Joint (from 1) and ratio to the floor, of those whose residual is surely above it."""
    gap = trial.gap(predicted)
    sure = explanation.free_evidence - explanation.noise_evidence > thresholds.log10_bayes_factor * LN10
    above = np.flatnonzero(sure & floor.exceeded(gap, thresholds)).tolist()
    return tuple((j + 1, float(gap[j] / floor.rms[j])) for j in above)


# ---------------------------------------------------------------------------------------------------------------
# Held-back data
# ---------------------------------------------------------------------------------------------------------------
def _failed(case: Case, data: Observations, effects: Sequence[Hypothesis]) -> Hypothesis | None:
    """The first effect that does not help on held-back data, given those before it."""
    used = case.held_back.trial.used
    _, explanation = explain_with(data, ())
    before = _held_back_residual(case, (), explanation)
    for count, effect in enumerate(effects, start=1):
        _, explanation = explain_with(data, effects[:count], explanation)
        after = _held_back_residual(case, effects[:count], explanation)
        acts = sorted(effect.columns.joints)
        fall = (before[:, acts] ** 2 - after[:, acts] ** 2) * used[:, acts] / data.floor[acts] ** 2
        if not _helps(fall, used[:, acts], effect.standard, case.thresholds):
            return effect
        before = after
    return None


def _held_back_residual(case: Case, effects: Sequence[Hypothesis], explanation: Explanation) -> Array:
    """(N, n) residuals on held-back data, N m."""
    trial = case.held_back.trial
    extension = extend(case.knowledge, case.coefficients, effects, explanation)
    if any(effect.source.reveals for effect in effects):
        extension = case.refitted(extension, case.predicted(effects, explanation))
    predicted = extension.model.effort(trial.signals.motion, extension.theta)
    return trial.nearest(predicted) - predicted


def _helps(fall: Array, used: Mask, standard: bool, thresholds: Thresholds) -> bool:
    """Whether held-back data bear an effect out.

    Over blocks of the log it must help more than it harms, by the factor of the thresholds, and in one of its joints it
    must improve the fit by a share of what it takes to be added at all. What every robot has need only do no harm.

    Args:
        fall: (N, m) of the squared residuals in its joints, in units of the noise floor's.
        used: (N, m) samples that count.
        standard: whether every robot has it.
        thresholds: that decide.
    """
    in_order = fall[used.any(axis=1)].sum(axis=1)
    blocks = np.array([block.sum() for block in np.array_split(in_order, thresholds.blocks)])
    helps, harms = float(np.maximum(blocks, 0.0).sum()), float(np.maximum(-blocks, 0.0).sum())
    if standard:
        return helps - harms > -float(blocks.std()) * np.sqrt(len(blocks))
    improvement = fall.sum(axis=0) / np.maximum(used.sum(axis=0), 1)
    needed = thresholds.held_back_improvement * thresholds.improvement
    return helps > thresholds.helps_over_harms * harms and bool(improvement.max() > needed)
