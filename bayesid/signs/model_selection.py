"""Model selection: effects beyond the requested terms that a log's evidence and held-back blocks confirm.

The signs under the requested terms come first. With these signs, forward selection by evidence adds effects that
predict held-back blocks better (`regression.selection.forward`). Then the signs are searched under the completed model,
and so on until nothing changes. The last search is the certified one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from copy import copy
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import islice

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects.effect import Effect
from bayesid.effects.model import Model
from bayesid.log.segments import Segmentation, Segments, find_segments
from bayesid.log.signals import Signals
from bayesid.progress import SILENT, Progress
from bayesid.regression.knowledge import KinematicTolerance
from bayesid.regression.least_squares import Fit, fit_signed, widened
from bayesid.regression.log_data import LogData
from bayesid.regression.selection.detected import (
    DetectedEffects,
    EnteredEffect,
    SignedLog,
    confirmed,
    consistent_with_nothing,
    detect_effects,
    still_detected,
)
from bayesid.regression.selection.fitted_effects import LN10
from bayesid.regression.selection.hypotheses import EffectKey
from bayesid.regression.selection.modelled_log import KINEMATICS
from bayesid.regression.selection.nuisance_scales import TooNarrow, find_nuisance_scales, geometry_far_off, too_narrow
from bayesid.regression.tuning import TUNING as REGRESSION
from bayesid.signs.averaging import AveragedSigns, evidence_gain, weight_against
from bayesid.signs.proposals import PoorJoint, PoorRobot, Proposal, propose
from bayesid.signs.search.protocol import Search
from bayesid.signs.sign_solution import Reading, SignSolution, find_signs, restored
from bayesid.signs.tuning import TUNING

_PROPOSING = "proposals for what the model explains poorly"
"""Stage that proposes models, each with a search."""


@dataclass(frozen=True)
class ModelSelection:
    """Result of model selection."""

    effects: tuple[EnteredEffect, ...]  #: added to the model, in this order
    before: Array  #: (n,) RMS error on held-back blocks without them, N m
    after: Array  #: (n,) the same with them
    effort: Array  #: (n,) RMS effort of these blocks, N m
    may_enter: bool = True  #: whether effects were allowed to enter
    #: effects outside of the model, with their joints, that widen the uncertainty: likely over usual size (of the
    #: geometry, over its tolerance)
    uncertain: Mapping[str, float] = field(default_factory=dict)
    too_narrow: tuple[TooNarrow, ...] = ()  #: coefficients with too narrow intervals, because of confounded effects


@dataclass(frozen=True)
class CompletedSigns:
    """Signs under the completed model."""

    model: Model  # with distortions of sensors
    averaged: AveragedSigns  # signs and fit
    model_selection: ModelSelection | None  # None if not requested
    # the same without some effects, and without those that fail without them
    without: Callable[[Set[EffectKey]], CompletedSigns] | None = None

    @property
    def signals(self) -> Signals:
        """The log corrected for the sensors' distortions."""
        return self.averaged.requested.log_data.signals

    def consistent_with_nothing(self, theta: Array, covariance: Array) -> set[EffectKey]:
        """Effects to leave out: the half with less evidence of those that may be zero.

        From the model's parameters (P,) and covariance (P, P), NaN where one is not identifiable.
        """
        effects = () if self.model_selection is None else self.model_selection.effects
        return _least_half(
            [e for e in effects if consistent_with_nothing(e, self.averaged.requested.model, theta, covariance)]
        )


@dataclass(frozen=True)
class Completing:
    """Options of model selection."""

    enter: bool  # whether effects may enter the model; otherwise they only widen its uncertainty
    kinematics: KinematicTolerance  # tolerance of the robot's geometry
    segmentation: Segmentation  # how efforts are cut into segments


@dataclass(frozen=True)
class _SignsUnder:
    """Signs under one model; the signals are corrected for the sensors' distortions."""

    model: Model
    sign_solution: SignSolution


@dataclass(frozen=True)
class _Searching:
    """Common inputs of all searches: the log as read, the first segments, and the search."""

    as_read: Signals
    segments: Segments
    search: Search
    segmentation: Segmentation

    def under(self, model: Model, start: SignSolution, progress: Progress, also: Sequence[Array] = ()) -> _SignsUnder:
        """Signs under a model, starting from those under another model, and from further ones (N, n)."""
        signals, segments = restored(model, self.as_read), self.segments
        if model.before_sensors is not model and model.before_sensors.distortions != model.distortions:
            segments = find_segments(signals, model.robot.actuators(signals.motion), self.segmentation)
        found = find_signs(model.before_sensors, signals, segments, self.search, progress, start=start, also=also)
        return _SignsUnder(model, replace(found, reading=Reading(model, self.as_read)))


def complete(
    averaged: AveragedSigns, segments: Segments, search: Search, how: Completing, progress: Progress = SILENT
) -> CompletedSigns:
    """Selects effects and signs in turn until neither changes; the other effects are marginalised.

    Segments are those before any search. No effect enters if the search allows only the requested model.

    Raises:
        SolverError: an optimisation failed.
    """
    searching = _Searching(averaged.requested.log_data.signals, segments, search, how.segmentation)
    plain = _SignsUnder(averaged.requested.model, averaged.requested)
    may_enter, lifted = how.enter and search.any_model, tuple[EnteredEffect, ...]()
    while may_enter and (free := _with_bounds_lifted(plain, searching, progress)) is not plain:
        lifted = (*lifted, *_lifting(free, plain))
        plain, averaged = free, AveragedSigns.alone(free.sign_solution)
    first = plain if averaged.by_requested else replace(plain, sign_solution=averaged.sign_solution)
    rounds = _Rounds(plain, first, averaged.fit, averaged.probability)
    rounds.go_through(searching, enter=may_enter, progress=progress)
    if may_enter and (free := _with_bounds_lifted(rounds.signs, searching, progress)) is not rounds.signs:
        more = _lifting(free, rounds.signs)
        model = reduce(Model.extend, (effect.source for effect in more), plain.model)
        first = plain = searching.under(model, free.sign_solution, progress.under("negative parameters allowed"))
        lifted, averaged = (*lifted, *more), AveragedSigns.alone(plain.sign_solution)
        rounds = _Rounds.under(plain, free)
        rounds.go_through(searching, enter=True, progress=progress)
    rounds.check(searching, progress)
    rounds.search_once_more(searching, progress)

    def made(rounds: _Rounds) -> CompletedSigns:
        def without(effects: Set[EffectKey]) -> CompletedSigns:
            reduced = copy(rounds)
            reduced.leave_out(effects, searching, progress)
            return made(reduced)

        effects, detected = rounds.effects, rounds.detected
        sign_solution, entered = rounds.averaged(averaged, first), {effect.key for effect in effects}
        with progress.stage("model error"):
            summed_out, narrow = _summed_out(sign_solution, entered, detected, how.kinematics)
        after, sizes = detected.after if effects else detected.before, _sizes(summed_out)
        model_selection = ModelSelection(
            (*lifted, *effects), detected.before.rms, after.rms, detected.effort, may_enter, sizes, narrow
        )
        completed = CompletedSigns(rounds.completed.model, summed_out, model_selection, without)
        spread = summed_out.fit.parameter_covariance(summed_out.requested.log_data.coefficients.projection)
        least = completed.consistent_with_nothing(summed_out.fit.theta, spread)
        return without(least) if least else completed

    return made(rounds)


def _lifting(free: _SignsUnder, plain: _SignsUnder) -> list[EnteredEffect]:
    gain = 0.5 * evidence_gain(free.sign_solution, plain.sign_solution) / LN10
    return [EnteredEffect(effect, gain, ()) for effect in free.model.effects if effect not in plain.model.effects]


def _least_half(effects: Sequence[EnteredEffect]) -> set[EffectKey]:
    """The half with less evidence, at least one; the others may be clear without them."""
    ordered = sorted(effects, key=lambda effect: effect.log10_bayes_factor)
    return {effect.key for effect in ordered[: -(-len(ordered) // 2)]}


@dataclass
class _Rounds:
    plain: _SignsUnder  # under the requested model
    signs: _SignsUnder  # under the likeliest model so far, which may have effects that are not confirmed
    fit: Fit  # fit of the requested model to these signs
    probability: Array  # (N, n) of these signs
    completed: _SignsUnder = field(init=False)  # under the likeliest model of confirmed effects
    detected: DetectedEffects = field(init=False)  # effects of the completed model, if it has any
    _last: DetectedEffects | None = None
    _flipped: bool = False
    _tried: dict[int, float] = field(default_factory=dict)  # residual of joints at their last failed proposals

    def __post_init__(self) -> None:
        self.completed = self.plain

    @classmethod
    def under(cls, plain: _SignsUnder, signs: _SignsUnder) -> _Rounds:
        """Starts from signs under a richer model."""
        probability = signs.sign_solution.probability
        return cls(plain, signs, fit_signed(plain.sign_solution.log_data, 2.0 * probability - 1.0), probability)

    def go_through(self, searching: _Searching, *, enter: bool, progress: Progress) -> None:
        """Rounds until nothing changes."""
        for _ in range(TUNING.completion_rounds):
            if not self.one_round(searching, enter=enter, progress=progress):
                break

    @property
    def effects(self) -> tuple[EnteredEffect, ...]:
        """Effects of the completed model."""
        return () if self.completed is self.plain else self.detected.effects

    def averaged(self, plain: AveragedSigns, first: _SignsUnder) -> AveragedSigns:
        """Averages the completed with the likeliest model, given the results before any effect."""
        signs = self.signs if _is_better(self.signs, self.plain) else first
        if self.completed is self.plain and signs is first:
            return plain
        if self.completed is signs:
            return AveragedSigns.alone(signs.sign_solution)
        return AveragedSigns.of(self.completed.sign_solution, signs.sign_solution)

    def one_round(self, searching: _Searching, *, enter: bool, progress: Progress) -> bool:
        """One round; whether another one may change the result."""
        if enter and (better := _with_proposals(self.signs, self._tried, searching, progress)) is not self.signs:
            self._follow(better)
        start = [effect for effect in self.signs.model.effects if effect not in self.plain.model.effects]
        log_data = self.plain.sign_solution.log_data
        with progress.stage("model selection"):
            detected = detect_effects(log_data, self.fit, self.probability, [] if self._flipped else start, enter=enter)
            detected = self._by_all_signs(detected)
        before, self._last = self._last, detected
        if before is None:
            self.detected = detected
        if detected.keys == (set() if before is None else before.keys):
            return False
        candidate = searching.under(
            detected.extension.model, self.signs.sign_solution, progress.under("with added effects")
        )
        if (
            _is_better(candidate, self.plain)
            and weight_against(candidate.sign_solution, self.completed.sign_solution) >= 0.5
        ):
            self.completed, self.detected = candidate, detected
        if weight_against(candidate.sign_solution, self.signs.sign_solution) < 0.5:
            return False
        changed = _changed(self.plain.sign_solution.log_data, self.probability, candidate.sign_solution.probability)
        self._follow(candidate)
        return changed or bool(_poor(candidate.sign_solution).any())

    def check(self, searching: _Searching, progress: Progress) -> None:
        """Removes effects that an unknown shape of friction near standstill would explain too."""
        if self.completed is self.plain:
            return
        with progress.stage("check of the selected model"):
            detected = still_detected(self.plain.sign_solution.log_data, self.fit, self.probability, self.detected)
        if detected.keys != self.detected.keys:
            self._reduced(detected, searching, progress)

    def search_once_more(self, searching: _Searching, progress: Progress) -> None:
        """Repeats the search under the likeliest model, whose first search had fewer starts."""
        last = self.signs
        if last is self.plain or last.sign_solution.signs.search.certified:
            return
        self.signs = searching.under(last.model, last.sign_solution, progress.under("likeliest model"))
        if self.completed is last:
            self.completed = self.signs

    def leave_out(self, effects: Set[EffectKey], searching: _Searching, progress: Progress) -> None:
        """Removes effects, and those that fail without them."""
        log_data = self.plain.sign_solution.log_data
        self._reduced(still_detected(log_data, self.fit, self.probability, self.detected, effects), searching, progress)

    def _reduced(self, detected: DetectedEffects, searching: _Searching, progress: Progress) -> None:
        """Completes the model with fewer effects; signs are updated if few of them change."""
        candidate = self.plain
        if detected.keys:
            reduced = searching.under(
                detected.extension.model, self.signs.sign_solution, progress.under("with added effects")
            )
            candidate = reduced if _is_better(reduced, self.plain) else self.plain
        if self.signs is self.completed and not _changed(
            self.plain.sign_solution.log_data, self.probability, candidate.sign_solution.probability
        ):
            self.signs = candidate
        self.completed, self.detected = candidate, detected

    def _by_all_signs(self, detected: DetectedEffects) -> DetectedEffects:
        """Removes effects that another possible assignment of signs does not confirm."""
        log_data, sources = self.plain.sign_solution.log_data, [effect.source for effect in detected.effects]
        keys = detected.keys
        for other in self.signs.sign_solution.alternatives if sources else ():
            fit = fit_signed(log_data, 2.0 * other.probability - 1.0)
            keys = keys & confirmed(log_data, fit, other.probability, sources).keys
        if keys == detected.keys:
            return detected
        return still_detected(log_data, self.fit, self.probability, detected, detected.keys - keys)

    def _follow(self, candidate: _SignsUnder) -> None:
        self._flipped = _joint_flipped(
            self.plain.sign_solution.log_data, self.probability, candidate.sign_solution.probability
        )
        self.signs, self.probability = candidate, candidate.sign_solution.probability
        self.fit = fit_signed(self.plain.sign_solution.log_data, 2.0 * self.probability - 1.0)


def _is_better(completed: _SignsUnder, plain: _SignsUnder) -> bool:
    """Whether a completed model with its own signs is decisively likelier (Jeffreys 1961, appendix B).

    Effects are selected with the signs of the smaller model, and the gain may differ with their own signs. In half of
    the Panda log (study `complete`) a joint flipped for less.
    """
    return 0.5 * evidence_gain(completed.sign_solution, plain.sign_solution) > 2.0 * LN10


def _poor(sign_solution: SignSolution) -> Mask:
    return (sign_solution.fit.relative_residual > REGRESSION.poor_fit) & ~sign_solution.log_data.signals.signed


def _with_bounds_lifted(plain: _SignsUnder, searching: _Searching, progress: Progress) -> _SignsUnder:
    """Signs under a model without bounds on some parameters, if evidence supports it; else unchanged.

    Parameters that are not clearly negative keep their bounds.
    """
    with progress.stage(_PROPOSING):
        proposal = _poor_robot(plain).without_bounds()
    while proposal is not None:
        lifted = _best_of(plain, [proposal], searching, progress.under("negative parameters allowed"))
        kept = tuple(effect for effect in proposal.effects if _clearly_negative(effect, lifted.sign_solution))
        if lifted is plain or kept == proposal.effects:
            return lifted
        proposal = replace(proposal, effects=kept) if kept else None
    return plain


def _clearly_negative(effect: Effect, sign_solution: SignSolution) -> bool:
    names = [parameter.name for parameter in sign_solution.model.parameters]
    sd = sign_solution.fit.parameter_sd(sign_solution.log_data.coefficients.projection)
    indices = [names.index(name) for name in effect.freed(sign_solution.model.robot)]
    return bool(np.all(sign_solution.fit.theta[indices] < -REGRESSION.significant * sd[indices]))


def _with_proposals(
    candidate: _SignsUnder, tried: dict[int, float], searching: _Searching, progress: Progress
) -> _SignsUnder:
    """Signs under the model with effects proposed for poorly explained joints, if better; else unchanged.

    A joint without success is tried again only when its residual has changed.
    """
    if _poor(candidate.sign_solution).any():
        with progress.stage(_PROPOSING):
            proposals = _poor_robot(candidate).propose()
        candidate = _best_of(candidate, proposals, searching, progress, needed=TUNING.needed_of_robot)
    for joint in np.flatnonzero(_poor(candidate.sign_solution))[
        ::-1
    ].tolist():  # from the tip, whose effects act on few joints
        for _ in range(TUNING.most_proposed):
            residual = float(candidate.sign_solution.fit.relative_residual[joint])
            if abs(residual / tried.get(joint, np.inf) - 1.0) < TUNING.explained_alike:
                break
            better = _with_proposal(candidate, joint, searching, progress.under(f"joint {joint + 1}"))
            if better is candidate:
                tried[joint] = residual
                break
            candidate = better
    return candidate


def _with_proposal(candidate: _SignsUnder, joint: int, searching: _Searching, progress: Progress) -> _SignsUnder:
    if not _poor(candidate.sign_solution)[joint]:
        return candidate
    with progress.stage(_PROPOSING):
        log, known = _signed_log(candidate), {_key(effect) for effect in candidate.model.effects}
        poor = PoorJoint.of(log, candidate.sign_solution.signs.segments, joint)
        proposed = (
            proposal for proposal in propose(poor, log.library(joint)) if _key(proposal.effects[0]) not in known
        )
        proposals = list(islice(proposed, TUNING.most_rivals))
    return _best_of(candidate, proposals, searching, progress)


def _best_of(
    candidate: _SignsUnder,
    proposals: Sequence[Proposal],
    searching: _Searching,
    progress: Progress,
    *,
    needed: float = REGRESSION.needed,
) -> _SignsUnder:
    """Signs under the best proposed model, if its evidence exceeds `needed` nats; else unchanged."""
    sign_solution, rivals = candidate.sign_solution, []
    for proposal in proposals:
        signs = np.where(np.isnan(proposal.signs), 2.0 * sign_solution.probability - 1.0, proposal.signs)
        model = reduce(Model.extend, proposal.effects, candidate.model)
        rivals.append(searching.under(model, sign_solution, progress, [signs]))
    gains = {0.5 * evidence_gain(rival.sign_solution, sign_solution): rival for rival in rivals}
    return gains[max(gains)] if max(gains, default=0.0) > needed else candidate


def _poor_robot(candidate: _SignsUnder) -> PoorRobot:
    return PoorRobot(_signed_log(candidate), candidate.sign_solution.signs.segments, _poor(candidate.sign_solution))


def _signed_log(candidate: _SignsUnder) -> SignedLog:
    return SignedLog.of(
        candidate.sign_solution.log_data, candidate.sign_solution.fit, candidate.sign_solution.probability
    )


def _key(effect: Effect) -> EffectKey:
    return effect.effect, effect.joints


def _summed_out(
    averaged: AveragedSigns, entered: Set[EffectKey], detected: DetectedEffects, tolerance: KinematicTolerance
) -> tuple[AveragedSigns, tuple[TooNarrow, ...]]:
    """The fit with the remaining effects and the geometry marginalised, and intervals that stay too narrow."""
    log_data, fit = averaged.requested.log_data, averaged.fit
    others = [hypothesis for hypothesis in detected.screened if hypothesis.key not in entered]
    nuisance_scales = find_nuisance_scales(log_data, fit, averaged.probability, others, tolerance)
    log_data = replace(log_data, nuisance=nuisance_scales.nuisance, fitted=averaged.sign_solution.log_data.fitted)
    if nuisance_scales.nuisance is not None:
        fit = widened(fit, log_data, 2.0 * averaged.sign_solution.probability - 1.0)
    requested = replace(averaged.requested, log_data=log_data, fit=fit)
    sign_solution = requested if averaged.by_requested else averaged.sign_solution
    summed_out = replace(averaged, requested=requested, sign_solution=sign_solution, fit=fit)
    names, geometry = log_data.coefficients.names, _sizes(summed_out).get(KINEMATICS[0], 0.0)
    bodies = np.zeros(log_data.model.cone.size, dtype=bool)
    for body in log_data.model.cone.bodies:
        bodies[body] = True
    of_links = np.any(log_data.coefficients.projection[:, bodies] != 0.0, axis=1)
    off = nuisance_scales.by_geometry
    narrow = () if off is None else geometry_far_off(geometry, off, names, averaged.fit.sd)
    return summed_out, (*narrow, *too_narrow(nuisance_scales.confounded, names, fit.sd, of_links))


def _sizes(averaged: AveragedSigns) -> dict[str, float]:
    nuisance = averaged.requested.log_data.nuisance
    return {} if nuisance is None else dict(zip(nuisance.names, nuisance.scales.tolist(), strict=True))


def _joint_flipped(log_data: LogData, before: Array, after: Array) -> bool:
    energy = np.where(log_data.used, log_data.signals.effort**2, 0.0)
    flipped = np.where((before >= 0.5) != (after >= 0.5), energy, 0.0).sum(axis=0)
    return bool(np.any(flipped > 0.5 * energy.sum(axis=0)))


def _changed(log_data: LogData, before: Array, after: Array) -> bool:
    different = ((before >= 0.5) != (after >= 0.5))[log_data.used]
    return bool(different.mean() > TUNING.signs_changed)
