"""What a log wants beyond the terms asked for: effects that its evidence and held-back blocks of it bear out.

Signs under the terms asked for come first. With them settled, effects are selected by their evidence, one after the
other, each predicting blocks of the log that had no say better than without it (`bayesid.fit.effects.forward`). Then
signs are searched under the completed model, and so on until nothing changes: the last search is what is certified.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from bayesid.arrays import Array
from bayesid.fit.effects.explanation import LN10
from bayesid.fit.effects.hypotheses import EffectKey
from bayesid.fit.effects.kinematics import KinematicTolerance
from bayesid.fit.effects.signed_log import SignedLog
from bayesid.fit.effects.unseen import find_nuisance
from bayesid.fit.effects.wanted import EnteredEffect, Wanted, what_is_wanted
from bayesid.fit.evidence import Evidence
from bayesid.fit.least_squares import POOR_FIT, fit_signed
from bayesid.log.segments import Cutting, Segments, find_segments
from bayesid.log.signals import Signals
from bayesid.model.model import Model
from bayesid.progress import SILENT, Progress
from bayesid.signs.averaging import AveragedSigns, evidence_gain, weight_against
from bayesid.signs.proposals import PoorJoint, propose
from bayesid.signs.search.protocol import Search
from bayesid.signs.settling import restored, settle_signs

_MOST_ROUNDS = 3
"""Selections, each under the signs that the one before it led to. A round number; not studied."""
_LIKELIER = 0.5
"""Weight from which on the completed model is the likelier one."""
_CHANGED = 1e-2
"""Share of the samples in motion whose sign must have changed for effects to be selected anew. A round number."""


@dataclass(frozen=True)
class Completion:
    """What the catalogue had to say.

    Attributes:
        effects: that entered the model, in the order in which they did.
        before: (n,) RMS error on held-back blocks of the log without them, N m.
        after: (n,) and with them.
        effort: (n,) RMS effort there, N m.
        uncertain: effects that did not enter, with their joints, but widen the uncertainty: to their likely size,
            relative to what is usual (of the geometry, to what was stated).
    """

    effects: tuple[EnteredEffect, ...]
    before: Array
    after: Array
    effort: Array
    uncertain: Mapping[str, float] = field(default_factory=dict)

    @property
    def keys(self) -> set[EffectKey]:
        """Effects and joints."""
        return {(effect.effect, effect.joints) for effect in self.effects}


@dataclass(frozen=True)
class CompletedSigns:
    """Signs under the completed model.

    Attributes:
        model: with sensors' distortions too.
        signals: the log without what the model says of its sensors.
        averaged: signs and fit.
        completion: what entered.
    """

    model: Model
    signals: Signals
    averaged: AveragedSigns
    completion: Completion


@dataclass(frozen=True)
class Completing:
    """How a model is completed.

    Attributes:
        enter: whether effects may enter the model; else they widen its uncertainty alone.
        kinematics: how far the robot's geometry may be from its table.
        cutting: how efforts are cut.
    """

    enter: bool
    kinematics: KinematicTolerance
    cutting: Cutting


def complete(
    averaged: AveragedSigns, segments: Segments, search: Search, how: Completing, progress: Progress = SILENT
) -> CompletedSigns:
    """Selects effects and settles signs in turn, until neither changes; what did not enter is summed out.

    Args:
        averaged: signs under the model asked for.
        segments: as they were before any search.
        search: how to search.
        how: what may enter, and what is believed of the geometry.
        progress: of the stages.

    Raises:
        SolverError: an optimisation failed.
    """
    proposed: tuple[EnteredEffect, ...] = ()
    if how.enter:
        averaged, proposed = _with_proposals(averaged, segments, search, progress)
    base, fit, probability = averaged.asked.evidence, averaged.fit, averaged.probability
    completed: CompletedSigns | None = None
    for _ in range(_MOST_ROUNDS):
        progress("completing the model", 0, 1)
        wanted = what_is_wanted(base, fit, probability, enter=how.enter)
        if completed is not None and wanted.keys == completed.completion.keys:
            break
        completed = _settled(wanted, base.signals, segments, search, how.cutting, progress)
        if completed is None or not _changed(base, probability, completed.averaged.probability):
            break
        probability = completed.averaged.probability
        fit = fit_signed(base, 2.0 * probability - 1.0)
    if completed is None or weight_against(completed.averaged.settled, averaged.asked) < _LIKELIER:
        nothing = Completion((), wanted.before.rms, wanted.before.rms, wanted.effort)
        completed = CompletedSigns(base.model, base.signals, averaged, nothing)
    summed_out = _summed_out(completed, wanted, how.kinematics)
    nuisance = summed_out.asked.evidence.nuisance
    uncertain = {} if nuisance is None else dict(zip(nuisance.names, nuisance.scales.tolist(), strict=True))
    effects = (*proposed, *completed.completion.effects)
    return replace(
        completed, averaged=summed_out, completion=replace(completed.completion, effects=effects, uncertain=uncertain)
    )


def _with_proposals(
    averaged: AveragedSigns, segments: Segments, search: Search, progress: Progress
) -> tuple[AveragedSigns, tuple[EnteredEffect, ...]]:
    """Signs, and effects that entered, where joints that the model explains poorly have had some proposed."""
    settled, entered = averaged.settled, list[EnteredEffect]()
    signals = settled.evidence.signals
    poor = settled.fit.relative_residual > POOR_FIT
    if not averaged.by_asked:
        return averaged, ()
    for joint in np.flatnonzero(poor & ~signals.signed)[::-1].tolist():  # from the tip, whose effects stay there
        if settled.fit.relative_residual[joint] <= POOR_FIT:
            continue
        log = SignedLog.of(settled.evidence, settled.fit, settled.probability)
        proposed = propose(log.data, PoorJoint.of(log, joint), log.library)
        if proposed is None:
            continue
        model = settled.model.extend(proposed.source)
        rival = settle_signs(model, signals, segments, search, progress.under(f"joint {joint + 1}"))
        if weight_against(rival, settled) > _LIKELIER:
            entered.append(EnteredEffect(proposed.source, 0.5 * evidence_gain(rival, settled) / LN10, ()))
            settled = rival
    return (AveragedSigns.alone(settled), tuple(entered)) if entered else (averaged, ())


def _summed_out(completed: CompletedSigns, wanted: Wanted, tolerance: KinematicTolerance) -> AveragedSigns:
    """The fit with all that did not enter, and the geometry, summed out."""
    averaged = completed.averaged
    evidence = averaged.asked.evidence
    entered = completed.completion.keys
    rest = [hypothesis for hypothesis in wanted.screened if hypothesis.key not in entered]
    nuisance = find_nuisance(evidence, averaged.fit, averaged.probability, rest, tolerance)
    evidence = replace(evidence, nuisance=nuisance, fitted=averaged.settled.evidence.fitted)
    fit = fit_signed(evidence, 2.0 * averaged.settled.probability - 1.0)
    asked = replace(averaged.asked, evidence=evidence, fit=fit)
    settled = asked if averaged.by_asked else averaged.settled
    return replace(averaged, asked=asked, settled=settled, fit=fit)


def _settled(
    wanted: Wanted, as_read: Signals, segments: Segments, search: Search, cutting: Cutting, progress: Progress
) -> CompletedSigns | None:
    """Signs under the completed model; None where nothing is wanted."""
    if not wanted.effects:
        return None
    model = wanted.extension.model
    signals = restored(model, as_read)
    if model.before_sensors is not model and model.before_sensors.distortions != model.distortions:
        segments = find_segments(signals, model.robot.actuators(signals.motion), cutting)
    settled = settle_signs(model.before_sensors, signals, segments, search, progress.under("completed model"))
    completion = Completion(wanted.effects, wanted.before.rms, wanted.after.rms, wanted.effort)
    return CompletedSigns(model, signals, AveragedSigns.alone(settled), completion)


def _changed(evidence: Evidence, before: Array, after: Array) -> bool:
    """Whether enough signs of samples in motion have changed."""
    different = ((before >= 0.5) != (after >= 0.5))[evidence.used]
    return bool(different.mean() > _CHANGED)
