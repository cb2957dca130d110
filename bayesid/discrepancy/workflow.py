"""Comparison of a model with a log: select missing effects, add them, identify again, and compute the gaps."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.discrepancy.case import Case, Excess, NoiseFloor, Trial, divide, make_trial, shortened, where_it_shows
from bayesid.discrepancy.log_checks import check_columns, check_holdout, check_log, check_same_robot, check_unseen
from bayesid.discrepancy.numbers import with_numbers
from bayesid.discrepancy.selection import GROWN, HELD_BACK, ON_LOG, Selection, select_effects
from bayesid.discrepancy.sets import WeighedSet
from bayesid.discrepancy.timeline import missing_preexisting
from bayesid.discrepancy.tuning import TUNING
from bayesid.effects.bodies import Payload
from bayesid.effects.coefficients import base_coefficients
from bayesid.errors import InputError, SolverError
from bayesid.identification.identification import Identification
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.identification.options import Preprocessing, call_of, call_of_log
from bayesid.identification.payload import BRIEF, PayloadEstimate, identify_payload
from bayesid.identification.pipeline import QUICK, identify_again
from bayesid.log.log import Log
from bayesid.log.reading import LogSource, as_log
from bayesid.log.signals import prepare
from bayesid.number_text import percent
from bayesid.parallel import one_blas_thread
from bayesid.posterior.sampler import Sampling
from bayesid.progress import SILENT, Progress, Show
from bayesid.regression.selection.added_effect import AddedEffect, not_testable
from bayesid.regression.selection.cross_validation import CrossValidation
from bayesid.regression.selection.fitted_effects import FittedEffects, Thresholds
from bayesid.regression.selection.hypotheses import EffectKey
from bayesid.regression.selection.scores import Score, assess
from bayesid.signs.search.protocol import Search


@dataclass(frozen=True)
class Discrepancy:
    """What a model lacks to explain a log.

    Attributes:
        status: "no_discrepancy", "explained", "partly_explained" (effects were found, but joints stay unexplained) or
            "unexplained".
        where: where the residual of the earlier model exceeds the floor, its parameters adapted within their
            uncertainty.
        added: added effects, in this order.
        before: (n,) gap of the earlier model on held-back data, RMS, N m.
        after: (n,) gap of the extended model on the same data.
        floor: noise floor.
        holdout: name of the held-back data.
        unexplained: joint (from 1) and ratio of its residual to the floor, on the log or else on held-back data.
        unexplained_on: such a joint to the data that show it (see `bayesid.discrepancy.selection.ON_LOG`).
        scores: scores of the whole catalogue, before effects were added.
        refused: effects with enough evidence on the log that do not improve the prediction of held-back data.
        not_testable: effect and joints that this log cannot show.
        identification: identification of the extended model from the log.
        trial: the log, or stretches of a long one, without held-back samples.
        cross_validation: the held-back data.
        predicted_before: (N, n) efforts of the earlier model, N m.
        predicted_after: (N, n) efforts of the extended model, N m.
        warnings: warnings in words.
        thresholds: thresholds of the selection.
        seconds: wall time.
        sets: alternative sets of effects and their probabilities, best first.
        preexisting: non-standard effects of the earlier model that this log confirms alone.

    Example:
        >>> found.status, [(effect.effect, effect.joints) for effect in found.added]
        ('no_discrepancy', [])
    """

    status: str
    where: tuple[Excess, ...]
    added: tuple[AddedEffect, ...]
    before: Array
    after: Array
    floor: NoiseFloor
    holdout: str
    unexplained: tuple[tuple[int, float], ...]
    unexplained_on: Mapping[int, tuple[str, ...]]
    scores: tuple[Score, ...]
    refused: tuple[AddedEffect, ...]
    not_testable: tuple[EffectKey, ...]
    identification: Identification
    trial: Trial
    cross_validation: Trial
    predicted_before: Array
    predicted_after: Array
    warnings: tuple[str, ...]
    thresholds: Thresholds
    seconds: float
    sets: tuple[WeighedSet, ...] = ()
    preexisting: tuple[EffectKey, ...] = ()

    def __repr__(self) -> str:
        gaps = zip(self.before, self.after, self.floor.rms, strict=True)
        joints = [f"{j:>5}   {a:>8.4g}   {b:>8.4g}   {c:>8.4g}" for j, (a, b, c) in enumerate(gaps, start=1)]
        added = [" ".join([effect.effect, *map(str, effect.joints)]) for effect in self.added]
        unexplained = [f"joint {j} ({ratio:.2f} x floor)" for j, ratio in self.unexplained]
        lines = [
            f"Discrepancy from {self.identification.log.source}: {self.status.replace('_', ' ')}",
            f"added        {', '.join(added) or 'nothing'}",
            f"unexplained  {', '.join(unexplained) or 'nothing'}",
            f"gap on {self.holdout}, RMS in N m:",
            "joint     before      after      floor",
            *joints,
            f"warnings     {len(self.warnings) or 'none'}",
            "next         .added, .identification, bayesid.save(this, folder)",
        ]
        return "\n  ".join(lines)

    @property
    def vetoed(self) -> tuple[EffectKey, ...]:
        """Refused effects and their joints."""
        return tuple(effect.hypothesis.key for effect in self.refused)


@one_blas_thread
def explain_log(
    earlier: IdentifiedModel | Identification,
    log: LogSource,
    holdout: LogSource | None = None,
    *,
    search: Search = QUICK,
    posterior: Sampling | bool = True,
    preprocessing: Preprocessing = Preprocessing(),
    progress: Progress | Show = SILENT,
    thresholds: Thresholds = Thresholds(),
) -> Discrepancy:
    """Finds what a model lacks to explain a log; arguments and errors are those of `bayesid.find_discrepancy`."""
    progress = Progress.of(progress)
    began = time.perf_counter()
    model, cutoff = earlier.knowledge.model, preprocessing.cutoff
    known = earlier.identified if isinstance(earlier, Identification) else earlier
    log = as_log(log, model.robot, known.reading)
    later = None if holdout is None else as_log(holdout, model.robot, known.reading)
    check_log(model.robot, log)
    for unseen in (log, *([] if later is None else [later])):
        check_unseen(known, unseen)
    trial = shortened(make_trial(model, prepare(log, cutoff)))
    if later is not None:
        check_holdout(model.robot, log, later)
    selecting, cross_validation = divide(model, log, later, trial, cutoff)
    coefficients = base_coefficients(model)
    case = Case(earlier.knowledge, coefficients, earlier.noise, selecting, cross_validation, search, thresholds)
    check_columns(partial(model.effort, theta=earlier.knowledge.theta), selecting, log)
    check_same_robot(case.before, selecting, log)
    selection = select_effects(case, progress)
    extension = case.modelled.extended(selection.chosen.fitted_effects)
    again = identify_again(
        extension.model,
        log,
        extension.knowledge,
        extension.theta,
        search=search,
        posterior=posterior,
        preprocessing=preprocessing,
        progress=progress,
    )
    again = _with_origin(again, known, log, later)
    body = None
    if any(isinstance(effect.hypothesis.source, Payload) for effect in selection.added):
        body = _body(known, log, search, posterior, preprocessing, progress)
    return replace(_discrepancy(case, selection, again, body), seconds=time.perf_counter() - began)


def _body(
    known: IdentifiedModel,
    log: Log,
    search: Search,
    posterior: Sampling | bool,
    preprocessing: Preprocessing,
    progress: Progress,
) -> PayloadEstimate | None:
    """The payload by `identify_payload`, so that both report the same numbers; None if that fails."""
    brief = (
        replace(BRIEF, rng=posterior.seed, time_limit=posterior.time_limit)
        if isinstance(posterior, Sampling)
        else BRIEF
    )
    try:
        read = identify_payload(
            known, log, search=search, posterior=brief, preprocessing=preprocessing, progress=progress
        )
    except (InputError, SolverError):
        return None
    return read if read.body.shown else None


def _with_origin(again: Identification, known: IdentifiedModel, log: Log, later: Log | None) -> Identification:
    scored = [] if later is None else [f"holdout={call_of_log(later)}"]
    return replace(
        again,
        logs=again.logs | known.logs,
        gains=known.gains,
        provenance=replace(again.provenance, call=call_of("find_discrepancy", "earlier", call_of_log(log), *scored)),
    )


# ---- The result ----
def _discrepancy(case: Case, selection: Selection, again: Identification, body: PayloadEstimate | None) -> Discrepancy:
    trial, scoring = case.trial, case.cross_validation.trial
    scores = assess(selection.before, selection.library)
    before, after = _gaps(case, selection, again)
    predicted = again.model.effort(trial.signals.motion, again.theta)
    floor, on_log = case.floor(predicted), case.unexplained(selection.chosen.fitted_effects, predicted)
    ratios, shown_on = _unexplained(on_log, before, after, floor)
    added = with_numbers(case, selection, again, body)
    return Discrepancy(
        status=_status(bool(added), bool(ratios)),
        where=tuple(_where(case, selection.before, floor)),
        added=tuple(effect.alone for effect in added),
        sets=selection.sets,
        before=before.rms,
        after=after.rms,
        floor=floor,
        holdout=case.cross_validation.name,
        unexplained=ratios,
        unexplained_on=shown_on,
        scores=tuple(score.alone for score in scores),
        refused=tuple(effect.alone for effect in selection.refused),
        not_testable=tuple(not_testable(scores, len(floor.rms), case.thresholds)),
        identification=again,
        trial=trial,
        cross_validation=scoring,
        predicted_before=case.before,
        predicted_after=predicted,
        warnings=(*_warnings(case, floor, selection.stopped), *again.warnings),
        thresholds=case.thresholds,
        seconds=np.nan,
        preexisting=missing_preexisting(case.model, again),
    )


def _status(found: bool, unexplained: bool) -> str:
    if unexplained:
        return "partly_explained" if found else "unexplained"
    return "explained" if found else "no_discrepancy"


def _unexplained(
    on_log: Mapping[int, float], before: CrossValidation, after: CrossValidation, floor: NoiseFloor
) -> tuple[tuple[tuple[int, float], ...], dict[int, tuple[str, ...]]]:
    """Unexplained joints (from 1) with the ratio of their residual to the floor, and the data that show it.

    `before` and `after` are the errors of the earlier and the extended model on held-back data.
    """
    above = floor.exceeded(after.rms) & after.surely_above(floor.rms)
    grown = after.surely_grown(before) & (after.rms > floor.rms)
    by_data = {ON_LOG: set(on_log), HELD_BACK: _joints(above), GROWN: _joints(grown)}
    joints = sorted(set().union(*by_data.values()))
    ratios = tuple((j, on_log.get(j, float(after.rms[j - 1] / floor.rms[j - 1]))) for j in joints)
    return ratios, {j: tuple(name for name, shown in by_data.items() if j in shown) for j in joints}


def _joints(mask: Mask) -> set[int]:
    return set((np.flatnonzero(mask) + 1).tolist())


def _gaps(case: Case, selection: Selection, again: Identification) -> tuple[CrossValidation, CrossValidation]:
    """Errors of the earlier and the extended model on held-back data."""
    theta = again.theta
    if not case.cross_validation.another_log:  # the final fit used the held-back blocks too
        theta = selection.chosen.refitted.theta
    scoring = case.cross_validation.trial
    motion = scoring.signals.motion
    efforts = case.model.effort(motion, case.knowledge.theta), again.model.effort(motion, theta)
    before, after = (case.cross_validation.errors(scoring.residual(effort)) for effort in efforts)
    return before, after


def _where(case: Case, fitted_effects: FittedEffects, floor: NoiseFloor) -> list[Excess]:
    """Where the residual of the adapted earlier model exceeds the floor."""
    predicted, trial = case.modelled.effort(fitted_effects), case.trial
    above = np.flatnonzero(floor.exceeded(trial.gap(predicted))).tolist()
    return where_it_shows(trial, trial.residual(predicted), predicted, floor.rms, above)


def _warnings(case: Case, floor: NoiseFloor, stopped: bool) -> list[str]:
    warnings = []
    if not case.knowledge.precision.any():
        warnings.append(
            "the uncertainty of the model's parameters is unknown: effects that resemble them cannot be detected"
        )
    unreliable = np.flatnonzero(~floor.reliable).tolist()
    if unreliable:
        joints = ", ".join(str(j + 1) for j in unreliable)
        effort = f"{percent(TUNING.good_fit, 0)} of this log's RMS effort"
        residual = f"the earlier model's residual on its own log, before filtering, is above {effort}"
        source = f"the noise floor is taken from this log ({floor.origin[unreliable[0]]})"
        warnings.append(f"{residual} in joint{'s' * (len(unreliable) > 1)} {joints}: {source}")
    if stopped:
        limit = f"the search for sets of effects stopped after {TUNING.most_sets} sets"
        warnings.append(f"{limit}: others may explain the log equally well")
    return warnings
