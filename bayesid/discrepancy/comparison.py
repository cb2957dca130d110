"""Several logs of one robot, one after the other: what has changed, what the model lacked all along, and what moved.

The first log makes the earlier model, completed by what that log shows beyond the terms asked for. Each later log is
compared with it (`bayesid.discrepancy.workflow`). Then one common model, of all terms that any log has shown, is
identified on each log by itself: what a log says there of an effect tells a change from a deficiency
and its parameters make the time line (`bayesid.discrepancy.timeline`).
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
    Standing,
    Timeline,
    key_of,
    make_timeline,
    shown_by,
    standing,
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
from bayesid.regression.stated import Says
from bayesid.robot import Robot, check_joints, load_robot
from bayesid.signs.search.certified import Certified
from bayesid.signs.search.protocol import Search

CHANGED, ALL_ALONG, GONE, UNDECIDED = "changed", "preexisting", "gone", "undecided"
"""What became of an effect: it has come, or another size, since the first log; it was missing from the terms all along;
the first log shows it and the last one that can tell does not; or the other logs cannot tell."""


@dataclass(frozen=True)
class EffectHistory:
    """An effect beyond the terms asked for, over K logs."""

    effect: Effect  #: term or distortion, with the numbers of the log that showed it first
    became: str  #: `CHANGED`, `ALL_ALONG`, `GONE` or `UNDECIDED`
    #: (K,) what each log says of it by itself; empty of what only a comparison can show (a change of what the first
    #: model has, a payload, a gain)
    by_log: tuple[Standing, ...]
    #: by comparison with the first log, log by log (from 1) of those that showed it so
    found: Mapping[int, AddedEffect]

    def __repr__(self) -> str:
        where = f"joint {', '.join(map(str, self.joints))}" if self.joints else "the whole robot"
        return f"EffectHistory {self.name}, {where}: {self.became.replace('_', ' ')}"

    @property
    def name(self) -> str:
        """In the catalogue."""
        return self.effect.effect

    @property
    def joints(self) -> tuple[int, ...]:
        """From 1, in which it acts; none named: on the whole robot."""
        return self.effect.joints


@dataclass(frozen=True)
class ChangeReport:
    """What several logs of one robot show one after the other.

    Attributes:
        logs: K, as they were given; the first made the earlier model.
        dates: when they were recorded, and what that is taken from.
        earlier: the identification from the first log, completed.
        found: (K - 1,) what it lacks to explain each later log.
        runs: (K,) the common model identified on each log by itself.
        effects: what became of each effect beyond the terms asked for.
        timeline: the parameters of the common model.
        warnings: what the user should know.
        seconds: of wall time.

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
        def named(became: str) -> str:
            texts = [" ".join([history.name, *map(str, history.joints)]) for history in self.of(became)]
            return ", ".join(texts) or "nothing"

        line = self.timeline
        moved = [line.tracked[c].name for c in np.flatnonzero(line.moved.any(axis=0)).tolist()]
        lines = [
            f"ChangeReport of {self.earlier.model.robot.name}: {len(self.logs)} logs by {self.dates.basis}",
            f"changed since the first  {named(CHANGED)}",
            f"missing all along        {named(ALL_ALONG)}",
            f"gone since the first     {named(GONE)}",
            f"cannot be told           {named(UNDECIDED)}",
            f"parameters that moved    {', '.join(moved) or 'none'} (of {len(self.timeline.tracked)})",
            f"warnings                 {len(self.warnings) or 'none'}",
            "go on with               .of('changed'), .timeline, .found[-1], bayesid.save(this, folder)",
        ]
        return "\n  ".join(lines)

    def of(self, became: str) -> tuple[EffectHistory, ...]:
        """The effects of which that became: "changed", "preexisting", "gone" or "undecided"."""
        return tuple(history for history in self.effects if history.became == became)


@one_blas_thread
def compare_logs(  # noqa: PLR0913  a robot, logs, terms, what is stated, and four groups of options by their names
    robot: Robot | str | Path,
    logs: Sequence[LogSource],
    terms: Iterable[str | Term] = STANDARD,
    holdout: LogSource | None = None,
    *,
    constraints: Says | str | Path | None = None,
    search: Search = Certified(),
    posterior: Sampling | bool = True,
    preprocessing: Preprocessing = Preprocessing(),
    progress: Progress | Show = SILENT,
) -> ChangeReport:
    """Compares logs of one robot, one after the other: what has changed since the first, what was missing all along.

    Args:
        robot: a robot, or a name or file that `bayesid.load_robot` takes.
        logs: two or more, the earliest first, or anything that `bayesid.read_log` reads.
        terms: names of the catalogue, or terms of your own: what effects are beyond.
        holdout: one more log of the robot as it was in the last one, to score that comparison by.
        constraints: as of `identify`; they hold for every log, but those on the last link not where it has a payload.
        search: how signs are searched in the first log; in later ones, which that one helps to settle, briefly.
        posterior: how those of the first model and of the last log's extended model are sampled, or whether they are.
        preprocessing: how the logs are made ready.
        progress: called as progress(stage, done, total) at the start, during and at the end of each stage.

    Raises:
        InputError: there are fewer than two logs, one comes twice, or one is of another robot or cannot be used.
        SolverError: an optimisation failed.
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
    runs = _alone(earlier, found, read, preprocessing, headings)
    timeline = make_timeline(runs, [False, *(_payload(one) is not None for one in found)])
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
    """Short names of logs, each another one: of their files or, where these are alike, with their folders."""
    paths = [Path(log.source) for log in logs]
    names = [path.name for path in paths]
    if len(set(names)) < len(names):
        names = ["/".join(path.parts[-2:]) for path in paths]
    return tuple(names) if len(set(names)) == len(names) else tuple(f"log {k}" for k in range(1, len(logs) + 1))


def _check(robot: Robot, logs: Sequence[Log]) -> None:
    if len(logs) < 2:
        where = logs[0].source if logs else "logs"
        raise InputError("is one log; a comparison takes two or more", where, "give a later log of the robot too")
    for log in logs:
        check_joints(robot, log.n_joints, log.source)
    for one, other in combinations(logs, 2):
        if hashes(one) & hashes(other):
            raise InputError(f"holds the same recording as {one.source}", other.source, "give every log once")


def _warnings(dates: Dates, timeline: Timeline) -> list[str]:
    warnings = []
    if not dates.ascending:
        warnings.append(
            f"the logs do not come in the order of their dates ({', '.join(dates.texts)}, from {dates.basis}): the "
            "first that was given is taken for the earlier one"
        )
    if timeline.factor > TUNING.scatter:
        warnings.append(
            f"the typical parameter of the time line differs by {timeline.factor:.1f} times what its standard "
            "deviation says: much has changed, or the model lacks what nothing here names"
        )
    return warnings


# ---------------------------------------------------------------------------------------------------------------
# The common model on each log by itself
# ---------------------------------------------------------------------------------------------------------------
def _alone(
    earlier: Identification,
    found: Sequence[Discrepancy],
    logs: Sequence[Log],
    preprocessing: Preprocessing,
    headings: Sequence[Progress],
) -> list[Identification]:
    """All terms that any log has shown by itself, and each log's own distortions, identified on each log by itself.

    What only a comparison can show stays out: a payload, which its log's links then hold, but for the load that they
    are for friction, and for what is stated of the last link. A gain is one of its log's distortions. What a comparison
    has added and its log by itself does not bear out stays out as well. Dry friction turns round as it does for each
    log: below a speed that is too slow for it.
    """
    new = [_new(one) for one in found]
    terms = {key_of(one): one for effects in new for one in effects if isinstance(one, Term)}
    shared = (*earlier.model.terms, *terms.values())
    runs = []
    for k, log in enumerate(logs):
        if k == 0 and not terms:
            runs.append(earlier)
            continue
        told = earlier if k == 0 else found[k - 1].identification
        body = None if k == 0 else _payload(found[k - 1])
        kept = () if k == 0 else new[k - 1]
        held = [one for one in told.model.distortions if one in earlier.model.distortions or one.needs_earlier]
        distortions = [*held, *(one for one in kept if isinstance(one, Distortion))]
        speed = told.model.robot.actuators(told.signals.motion).standstill_speed
        own = tuple(_turning_below(_carrying(term, body), speed) for term in shared)
        stated = _stated(earlier.model, loaded=body is not None)
        model = reduce(Model.extend, distortions, Model(earlier.model.robot, own, constraints=stated))
        theta = _values(model, told)
        runs.append(identify_again(model, log, None, theta, preprocessing=preprocessing, progress=headings[k]))
    return runs


def _stated(model: Model, *, loaded: bool) -> Constraints | None:
    """What is stated of a robot, whose last link may hold a payload besides."""
    stated, robot = model.constraints, model.robot
    if stated is None or not loaded:
        return stated
    return stated.sparing([one.name for one in RigidBody().parameters(robot) if one.joint == robot.n_joints])


def _new(found: Discrepancy) -> list[Effect]:
    effects = [_as_added(one, found) for one in found.added if _tellable(one)]
    shown = shown_by(found.identification, effects)
    return [effect for effect in effects if key_of(effect) in shown]


def _turning_below(term: Term, speed: Array) -> Term:
    """A term of dry friction that turns round below the speeds (n,) that are too slow for a log to show it."""
    if not isinstance(term, DryTerm):
        return term
    return replace(term, smoothing=tuple(speed[term.acting(len(speed))].tolist()))


def _payload(found: Discrepancy) -> Array | None:
    """(10,) parameters of a body that has come to the last link; None where none has."""
    model, theta = found.identification.model, found.identification.theta
    return next((values for term, values in model.parts(theta) if term.of_links and term.needs_earlier), None)


def _carrying(term: Term, body: Array | None) -> Term:
    """A term whose load is that of the links, which may carry a body now."""
    if body is None or not term.shape.get("links"):
        return term
    links = np.array(term.shape["links"])
    links[-10:] += body
    return of_shape(type(term), {**term.shape, "links": links.tolist()})


def _values(model: Model, told: Identification) -> Array:
    values = {p.name: value for p, value in zip(told.model.parameters, told.theta, strict=True)}
    return np.array([values.get(parameter.name, 0.0) for parameter in model.parameters])


# ---------------------------------------------------------------------------------------------------------------
# What became of each effect
# ---------------------------------------------------------------------------------------------------------------
def _histories(
    earlier: Identification, found: Sequence[Discrepancy], runs: Sequence[Identification], timeline: Timeline
) -> tuple[EffectHistory, ...]:
    first = _of_first(earlier, runs)
    gone = {key_of(history.effect) for history in first if history.became == GONE}
    later = _of_later(found, runs, timeline)
    return (*first, *(history for history in later if key_of(history.effect) not in gone))


def _of_first(earlier: Identification, runs: Sequence[Identification]) -> list[EffectHistory]:
    """Effects that completed the first model: there all along, or gone."""
    entered = () if earlier.model_selection is None else earlier.model_selection.effects
    effects = [effect.source for effect in entered]
    confirmed = [shown_by(run, effects) for run in runs[1:]]
    histories = []
    for one in entered:
        later = [standing(run, one.source, shown, runs[0]) for run, shown in zip(runs[1:], confirmed, strict=True)]
        told = [what.says for what in later if what.says != OPEN]
        became = UNDECIDED if not told else ALL_ALONG if told[-1] == SHOWN else GONE
        first = Standing(SHOWN, one.log10_bayes_factor)
        histories.append(EffectHistory(one.source, became, (first, *later), {}))
    return histories


def _of_later(found: Sequence[Discrepancy], runs: Sequence[Identification], timeline: Timeline) -> list[EffectHistory]:
    """Effects that comparisons with the first model have added: new, or what the first log could not tell."""
    added: dict[object, dict[int, AddedEffect]] = {}
    for k, one in enumerate(found, start=1):
        for effect in one.added:
            added.setdefault((effect.hypothesis.key, bool(effect.hypothesis.changes)), {})[k] = effect
    first = {key: next(iter(by_log.items())) for key, by_log in added.items()}
    sources = {key: _as_added(effect, found[k - 1]) for key, (k, effect) in first.items()}
    followed = {key: one for key, one in sources.items() if _tellable(first[key][1]) and _followed(one, runs)}
    confirmed = [shown_by(run, list(followed.values())) for run in runs]
    histories = []
    for key, by_log in added.items():
        (k, effect), source = first[key], sources[key]
        if key in followed:
            says = tuple(standing(run, source, shown, runs[k]) for run, shown in zip(runs, confirmed, strict=True))
            histories.append(EffectHistory(source, _of_new(says), says, by_log))
        else:
            became = UNDECIDED if _tellable(effect) else _of_change(by_log, timeline)
            histories.append(EffectHistory(source, became, (), by_log))
    return histories


def _followed(effect: Effect, runs: Sequence[Identification]) -> bool:
    return any(key_of(one) == key_of(effect) for run in runs for one in run.model.effects)


def _of_new(says: Sequence[Standing]) -> str:
    """Of an effect that the first model lacks and a later log shows: new, if the first log could have shown it."""
    later = [what.says for what in says[1:]]
    return UNDECIDED if SHOWN not in later else {SHOWN: ALL_ALONG, ABSENT: CHANGED, OPEN: UNDECIDED}[says[0].says]


def _of_change(by_log: Mapping[int, AddedEffect], timeline: Timeline) -> str:
    """Of what comparisons call another size: undecided where the time line follows it and does not bear it out.

    A comparison holds all else at what the first log says; a log by itself holds nothing.
    """
    names = [one.name for one in timeline.tracked]
    changes = {name for effect in by_log.values() for name in effect.hypothesis.changes}
    places = [names.index(name) for name in changes if name in names]
    tested = [bool(timeline.moved[:, c].any()) for c in places if np.isfinite(timeline.p[:, c]).any()]
    return CHANGED if any(tested) or not tested else UNDECIDED


def _tellable(effect: AddedEffect) -> bool:
    return not effect.hypothesis.changes and not effect.hypothesis.source.needs_earlier


def _as_added(effect: AddedEffect, found: Discrepancy) -> Effect:
    same = [one for one in found.identification.model.effects if key_of(one) == effect.hypothesis.key]
    return same[-1] if same else effect.hypothesis.source
