"""Comparison of several logs of one robot: effects that changed, effects that were always missing, moved parameters.

The first log gives the earlier model, with the effects detected in it. Each later log is compared with this model
(`bayesid.discrepancy.workflow`). Then a common model with the terms shown by any log is identified from each log alone.
This separates changes from effects that were always missing, and gives the time line of the parameters
(`bayesid.discrepancy.timeline`).
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import combinations
from pathlib import Path

import numpy as np

from bayesid.arrays import Array
from bayesid.discrepancy.timeline import (
    ABSENT,
    OPEN,
    SHOWN,
    LogEvidence,
    Timeline,
    key_of,
    log_evidence,
    make_timeline,
    shown_by,
)
from bayesid.discrepancy.tuning import TUNING
from bayesid.discrepancy.workflow import Discrepancy, explain_log
from bayesid.effects import STANDARD, Distortion, Term
from bayesid.effects.bodies import RigidBody
from bayesid.effects.catalogue import of_shape
from bayesid.effects.constraints import Constraints
from bayesid.effects.effect import Effect
from bayesid.effects.friction import DryTerm
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.identification.identification import Identification
from bayesid.identification.options import Preprocessing, hashes
from bayesid.identification.pipeline import identify, identify_again
from bayesid.log.dates import Dates, dates_of
from bayesid.log.log import Log, check_exact_gains
from bayesid.log.reading import LogSource, as_log
from bayesid.parallel import one_blas_thread
from bayesid.posterior.sampler import Sampling
from bayesid.progress import SILENT, Progress, Show
from bayesid.regression.selection.added_effect import AddedEffect
from bayesid.regression.stated import ConstraintFunction
from bayesid.robot import Robot, check_joints, load_robot
from bayesid.signs.search.certified import Certified
from bayesid.signs.search.protocol import Search

CHANGED, PREEXISTING, GONE, UNDECIDED = "changed", "preexisting", "gone", "undecided"
"""Status of an effect: new or of another size since the first log; present in all logs but missing from the terms;
shown by the first log and excluded by the last decisive one; or not decided by the other logs."""


@dataclass(frozen=True)
class EffectHistory:
    """An effect that is not among the given terms, over K logs."""

    effect: Effect  #: term or distortion, with the numbers of the first log that shows it
    status: str  #: `CHANGED`, `PREEXISTING`, `GONE` or `UNDECIDED`
    #: (K,) evidence of each log alone; empty if only a comparison can show the effect (a changed parameter, a payload,
    #: a gain)
    by_log: tuple[LogEvidence, ...]
    #: index of a log to the effect found by comparing it with the first log
    found: Mapping[int, AddedEffect]

    def __repr__(self) -> str:
        where = f"joint {', '.join(map(str, self.joints))}" if self.joints else "the whole robot"
        return f"EffectHistory {self.name}, {where}: {self.status}"

    @property
    def name(self) -> str:
        """Name in the catalogue."""
        return self.effect.effect

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints (from 1) in which it acts; empty if it acts on the whole robot."""
        return self.effect.joints


@dataclass(frozen=True)
class ChangeReport:
    """Comparison of several logs of one robot.

    Attributes:
        logs: K logs as given; the first gives the earlier model.
        dates: dates of recording and their source.
        earlier: identification from the first log.
        found: (K - 1,) what this model lacks to explain each later log.
        runs: (K,) the common model identified from each log alone.
        effects: history of each effect that is not among the given terms.
        timeline: parameters of the common model.
        warnings: warnings in words.
        seconds: wall time.

    Example:
        >>> both = bayesid.find_discrepancy(robot, [log, other_log], terms=terms, posterior=False)
        >>> [history.name for history in both.of("changed")], both.timeline.value.shape
        ([], (2, 21))
    """

    logs: tuple[Log, ...]
    dates: Dates
    earlier: Identification
    found: tuple[Discrepancy, ...]
    runs: tuple[Identification, ...]
    effects: tuple[EffectHistory, ...]
    timeline: Timeline
    warnings: tuple[str, ...]
    seconds: float

    def __repr__(self) -> str:
        def named(status: str) -> str:
            texts = [" ".join([history.name, *map(str, history.joints)]) for history in self.of(status)]
            return ", ".join(texts) or "nothing"

        line = self.timeline
        moved = [line.tracked[c].name for c in np.flatnonzero(line.moved.any(axis=0)).tolist()]
        lines = [
            f"ChangeReport of {self.earlier.model.robot.name}: {len(self.logs)} logs by {self.dates.basis}",
            f"changed since the first  {named(CHANGED)}",
            f"missing in all logs      {named(PREEXISTING)}",
            f"gone since the first     {named(GONE)}",
            f"not decided              {named(UNDECIDED)}",
            f"changed parameters       {', '.join(moved) or 'none'} (of {len(self.timeline.tracked)})",
            f"warnings                 {len(self.warnings) or 'none'}",
            "next                     .of('changed'), .timeline, .found[-1], bayesid.save(this, folder)",
        ]
        return "\n  ".join(lines)

    def of(self, status: str) -> tuple[EffectHistory, ...]:
        """The effects with this status: "changed", "preexisting", "gone" or "undecided"."""
        return tuple(history for history in self.effects if history.status == status)


@one_blas_thread
def compare_logs(  # noqa: PLR0913  a robot, logs, terms, what is stated, and four groups of options by their names
    robot: Robot | str | Path,
    logs: Sequence[LogSource],
    terms: Iterable[str | Term] = STANDARD,
    holdout: LogSource | None = None,
    *,
    constraints: ConstraintFunction | str | Path | None = None,
    search: Search = Certified(),
    posterior: Sampling | bool = True,
    preprocessing: Preprocessing = Preprocessing(),
    progress: Progress | Show = SILENT,
) -> ChangeReport:
    """Compares logs of one robot: changes since the first log, and effects missing in all logs.

    Arguments and errors are those of `bayesid.find_discrepancy`. Posteriors are sampled for the first and the last log
    alone.
    """
    progress = Progress.of(progress)
    began = time.perf_counter()
    robot = robot if isinstance(robot, Robot) else load_robot(robot)
    read = [as_log(log, robot) for log in logs]
    later = None if holdout is None else as_log(holdout, robot)
    for log in read:
        check_exact_gains(log)
    _check(robot, read)
    dates = dates_of(read)
    headings = [progress.under(name) for name in names_of(read)]
    earlier = identify(
        robot,
        read[0],
        terms,
        constraints=constraints,
        search=search,
        posterior=posterior,
        preprocessing=preprocessing,
        anyway=True,
        progress=headings[0],
    )
    found = [
        explain_log(
            earlier,
            log,
            later if log is read[-1] else None,
            posterior=posterior if log is read[-1] else False,
            preprocessing=preprocessing,
            progress=heading,
        )
        for log, heading in zip(read[1:], headings[1:], strict=True)
    ]
    runs = _identify_alone(earlier, found, read, preprocessing, headings)
    timeline = make_timeline(runs, [False, *(_payload(discrepancy) is not None for discrepancy in found)])
    return ChangeReport(
        logs=tuple(read),
        dates=dates,
        earlier=earlier,
        found=tuple(found),
        runs=tuple(runs),
        effects=_histories(earlier, found, runs, timeline),
        timeline=timeline,
        warnings=(*_warnings(dates, timeline), *found[-1].warnings),
        seconds=time.perf_counter() - began,
    )


def names_of(logs: Sequence[Log]) -> tuple[str, ...]:
    """Distinct short names of logs: file names, with folders if necessary."""
    paths = [Path(log.source) for log in logs]
    names = [path.name for path in paths]
    if len(set(names)) < len(names):
        names = ["/".join(path.parts[-2:]) for path in paths]
    return tuple(names) if len(set(names)) == len(names) else tuple(f"log {k}" for k in range(1, len(logs) + 1))


def _check(robot: Robot, logs: Sequence[Log]) -> None:
    if len(logs) < 2:
        where = logs[0].source if logs else "logs"
        raise InputError("is one log, but a comparison needs two or more", where, "give a later log of the robot too")
    for log in logs:
        check_joints(robot, log.n_joints, log.source)
    for log, other in combinations(logs, 2):
        if hashes(log) & hashes(other):
            raise InputError(f"has the same recording as {log.source}", other.source, "give every log once")


def _warnings(dates: Dates, timeline: Timeline) -> list[str]:
    warnings = []
    if not dates.ascending:
        warnings.append(
            f"the logs are not in the order of their dates ({', '.join(dates.texts)}, from {dates.basis}): the first "
            "given log is used as the earlier one"
        )
    if timeline.factor > TUNING.scatter:
        warnings.append(
            f"parameters of the time line change {timeline.factor:.1f} times as much as expected from their standard "
            "deviations (median): many parameters changed, or an effect is missing that was not found"
        )
    return warnings


# ---- The common model on each log alone ----
def _identify_alone(
    earlier: Identification,
    found: Sequence[Discrepancy],
    logs: Sequence[Log],
    preprocessing: Preprocessing,
    headings: Sequence[Progress],
) -> list[Identification]:
    """Identifies a common model from each log alone: terms that any log shows alone, and each log's distortions.

    A payload is left out, as a single log cannot separate it from the last link. It still counts as load of friction,
    and constraints on the last link are removed. Effects that a comparison added but the log alone does not confirm are
    left out too. The speed below which dry friction is smoothed is that of each log.
    """
    new = [_confirmed_alone(discrepancy) for discrepancy in found]
    terms = {key_of(term): term for effects in new for term in effects if isinstance(term, Term)}
    shared = (*earlier.model.terms, *terms.values())
    runs = []
    for k, log in enumerate(logs):
        if k == 0 and not terms:
            runs.append(earlier)
            continue
        start = earlier if k == 0 else found[k - 1].identification
        body = None if k == 0 else _payload(found[k - 1])
        added = () if k == 0 else new[k - 1]
        fixed = earlier.model.distortions
        kept = [effect for effect in start.model.distortions if effect in fixed or effect.needs_earlier]
        distortions = [*kept, *(effect for effect in added if isinstance(effect, Distortion))]
        speed = start.model.robot.actuators(start.signals.motion).standstill_speed
        of_log = tuple(_smoothed_below(_loaded_by(term, body), speed) for term in shared)
        constraints = _constraints(earlier.model, loaded=body is not None)
        model = reduce(Model.extend, distortions, Model(earlier.model.robot, of_log, constraints=constraints))
        theta = _values(model, start)
        runs.append(identify_again(model, log, None, theta, preprocessing=preprocessing, progress=headings[k]))
    return runs


def _constraints(model: Model, *, loaded: bool) -> Constraints | None:
    """Constraints on a robot; without those on the last link if it carries a payload."""
    constraints, robot = model.constraints, model.robot
    if constraints is None or not loaded:
        return constraints
    parameters = RigidBody().parameters(robot)
    return constraints.not_involving([parameter.name for parameter in parameters if parameter.joint == robot.n_joints])


def _confirmed_alone(found: Discrepancy) -> list[Effect]:
    effects = [_as_added(effect, found) for effect in found.added if _visible_alone(effect)]
    shown = shown_by(found.identification, effects)
    return [effect for effect in effects if key_of(effect) in shown]


def _smoothed_below(term: Term, speed: Array) -> Term:
    if not isinstance(term, DryTerm):
        return term
    return replace(term, smoothing=tuple(speed[term.acting(len(speed))].tolist()))


def _payload(found: Discrepancy) -> Array | None:
    """(10,) parameters of a new body on the last link, if any."""
    model, theta = found.identification.model, found.identification.theta
    return next((values for term, values in model.parts(theta) if term.of_links and term.needs_earlier), None)


def _loaded_by(term: Term, body: Array | None) -> Term:
    if body is None or not term.shape.get("links"):
        return term
    links = np.array(term.shape["links"])
    links[-10:] += body
    return of_shape(type(term), {**term.shape, "links": links.tolist()})


def _values(model: Model, start: Identification) -> Array:
    values = {p.name: value for p, value in zip(start.model.parameters, start.theta, strict=True)}
    return np.array([values.get(parameter.name, 0.0) for parameter in model.parameters])


# ---- Histories of effects ----
def _histories(
    earlier: Identification, found: Sequence[Discrepancy], runs: Sequence[Identification], timeline: Timeline
) -> tuple[EffectHistory, ...]:
    first = _of_first(earlier, runs)
    gone = {key_of(history.effect) for history in first if history.status == GONE}
    later = _of_later(found, runs, timeline)
    return (*first, *(history for history in later if key_of(history.effect) not in gone))


def _of_first(earlier: Identification, runs: Sequence[Identification]) -> list[EffectHistory]:
    """Histories of effects detected in the first log."""
    detected = () if earlier.model_selection is None else earlier.model_selection.effects
    effects = [effect.source for effect in detected]
    later_runs = [(run, shown_by(run, effects)) for run in runs[1:]]
    histories = []
    for effect in detected:
        later = [log_evidence(run, effect.source, shown, runs[0]) for run, shown in later_runs]
        decisive = [evidence.says for evidence in later if evidence.says != OPEN]
        status = UNDECIDED if not decisive else PREEXISTING if decisive[-1] == SHOWN else GONE
        first = LogEvidence(SHOWN, effect.log10_bayes_factor)
        histories.append(EffectHistory(effect.source, status, (first, *later), {}))
    return histories


def _of_later(found: Sequence[Discrepancy], runs: Sequence[Identification], timeline: Timeline) -> list[EffectHistory]:
    """Histories of effects that comparisons with the first model added."""
    added: dict[object, dict[int, AddedEffect]] = {}
    for k, discrepancy in enumerate(found, start=1):
        for effect in discrepancy.added:
            added.setdefault((effect.hypothesis.key, bool(effect.hypothesis.changes)), {})[k] = effect
    first = {key: next(iter(by_log.items())) for key, by_log in added.items()}
    sources = {key: _as_added(effect, found[k - 1]) for key, (k, effect) in first.items()}
    visible = {key: effect for key, effect in sources.items() if _visible_alone(first[key][1])}
    followed = {key: effect for key, effect in visible.items() if _in_models(effect, runs)}
    confirmed = [shown_by(run, list(followed.values())) for run in runs]
    histories = []
    for key, by_log in added.items():
        (k, effect), source = first[key], sources[key]
        if key in followed:
            pairs = zip(runs, confirmed, strict=True)
            evidence = tuple(log_evidence(run, source, shown, runs[k]) for run, shown in pairs)
            histories.append(EffectHistory(source, _of_new(evidence), evidence, by_log))
        else:
            status = UNDECIDED if _visible_alone(effect) else _of_change(by_log, timeline)
            histories.append(EffectHistory(source, status, (), by_log))
    return histories


def _in_models(effect: Effect, runs: Sequence[Identification]) -> bool:
    return any(key_of(other) == key_of(effect) for run in runs for other in run.model.effects)


def _of_new(evidence: Sequence[LogEvidence]) -> str:
    """Status of an effect that a later log shows: new if the first log excludes it."""
    if SHOWN not in [of_log.says for of_log in evidence[1:]]:
        return UNDECIDED
    return {SHOWN: PREEXISTING, ABSENT: CHANGED, OPEN: UNDECIDED}[evidence[0].says]


def _of_change(by_log: Mapping[int, AddedEffect], timeline: Timeline) -> str:
    """Status of a changed parameter: undecided if the time line includes it and shows no change."""
    names = [parameter.name for parameter in timeline.tracked]
    changes = {name for effect in by_log.values() for name in effect.hypothesis.changes}
    places = [names.index(name) for name in changes if name in names]
    tested = [bool(timeline.moved[:, c].any()) for c in places if np.isfinite(timeline.p[:, c]).any()]
    return CHANGED if any(tested) or not tested else UNDECIDED


def _visible_alone(effect: AddedEffect) -> bool:
    return not effect.hypothesis.changes and not effect.hypothesis.source.needs_earlier


def _as_added(effect: AddedEffect, found: Discrepancy) -> Effect:
    same = [other for other in found.identification.model.effects if key_of(other) == effect.hypothesis.key]
    return same[-1] if same else effect.hypothesis.source
