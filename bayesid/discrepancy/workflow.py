"""The workflow: compare a model with a log, name what is missing, add it, identify again, and show the gap shrink."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from threadpoolctl import threadpool_limits

from bayesid.coefficients import base_coefficients
from bayesid.discrepancy.case import Case, divide
from bayesid.discrepancy.checks import check_log, check_same_robot
from bayesid.discrepancy.choice import Choice, Chosen, exceeds, unexplained
from bayesid.discrepancy.compare import GOOD, Excess, Floor, Trial, make_trial, shortened, where_it_shows
from bayesid.discrepancy.hypotheses import Hypothesis
from bayesid.discrepancy.scores import Score
from bayesid.discrepancy.selection import Verdict, not_testable, weigh
from bayesid.distortions.base import Distortion
from bayesid.identification import Identification, identify_again
from bayesid.knowledge import Knowledge
from bayesid.log import Log, read_log
from bayesid.motion import Array
from bayesid.noise import Noise
from bayesid.posterior.sampler import SamplerOptions
from bayesid.signals import prepare
from bayesid.signs import Progress, SearchOptions


class Earlier(Protocol):
    """What an earlier log has left: an `Identification` or a `StoredModel`."""

    @property
    def knowledge(self) -> Knowledge:
        """The model, its parameters, and how well they are known."""

    @property
    def noise(self) -> Noise:
        """Of the efforts of that log."""


@dataclass(frozen=True)
class Found:
    """An effect that was added.

    Attributes:
        verdict: what speaks for it.
        joints: from 1, in which it acts; none named: on the whole robot.
        parameters: name to value, standard deviation and unit.
    """

    verdict: Verdict
    joints: tuple[int, ...]
    parameters: dict[str, tuple[float, float, str]]

    @property
    def effect(self) -> str:
        """Name in the catalogue."""
        return self.verdict.hypothesis.effect


@dataclass(frozen=True)
class Discrepancy:
    """What a model lacks to explain a log.

    Attributes:
        status: "no_discrepancy", "explained" or "unexplained".
        where: where the model before exceeds the floor, its parameters moved as far as the earlier log allows.
        found: effects that were added, in this order.
        before: (n,) gap of the model as it was, on data that chose nothing, RMS in N m.
        after: (n,) gap of the extended model on them.
        floor: their noise floor.
        holdout: which data these are.
        unexplained: joint (from 1) and ratio of what is left to the floor.
        scores: of the whole catalogue, before anything was added.
        vetoed: effects that would have been added but made the fit to unseen data no better.
        not_testable: effect and joints that this log could not show.
        identification: of the extended model on the log.
        trial: the log, stretches of it if it is long; without the held-back ones among the used samples.
        unseen: the data that scored.
        predicted_before: (N, n) by the model as it was, N m.
        predicted_after: (N, n) by the extended model, N m.
        warnings: what the user should know.
        seconds: of wall time.
    """

    status: str
    where: tuple[Excess, ...]
    found: tuple[Found, ...]
    before: Array
    after: Array
    floor: Floor
    holdout: str
    unexplained: tuple[tuple[int, float], ...]
    scores: tuple[Score, ...]
    vetoed: tuple[tuple[str, tuple[int, ...]], ...]
    not_testable: tuple[tuple[str, tuple[int, ...]], ...]
    identification: Identification
    trial: Trial
    unseen: Trial
    predicted_before: Array
    predicted_after: Array
    warnings: tuple[str, ...]
    seconds: float


@threadpool_limits.wrap(limits=1, user_api="blas")
def find_discrepancy(
    earlier: Earlier,
    log: Log | str | Path,
    holdout: Log | str | Path | None = None,
    cutoff: float | None = None,
    search_budget: float = 3.0,
    posterior: bool = True,
    posterior_budget: float = 60.0,
    seed: int = 0,
    progress: Progress | None = None,
    repeatable: bool = False,
) -> Discrepancy:
    """Finds what a model lacks to explain a log.

    Args:
        earlier: an identification of the robot, or a stored one: the model, what is known of it, and its noise.
        log: a log of the same robot.
        holdout: another one, to score by; without it stretches of the log are held back.
        cutoff: of the motion's low-pass, Hz; from the data by default.
        search_budget: seconds for the proof of the signs under the extended model.
        posterior: whether to sample that of the extended model.
        posterior_budget: seconds that sampling may take.
        seed: of the sampling.
        progress: called as progress(stage, done, total).
        repeatable: whether the same seed is to give the same result on a busy machine too (see `identify`).

    Raises:
        InputError: a log is of another robot, too short, too still, or the holdout is the log.
        SolverError: an optimisation failed.
    """
    began = time.perf_counter()
    log = log if isinstance(log, Log) else read_log(log)
    later = None if holdout is None else holdout if isinstance(holdout, Log) else read_log(holdout)
    model = earlier.knowledge.model
    check_log(model.robot, log)
    trial = shortened(make_trial(model, prepare(log, cutoff)))
    choosing, unseen = divide(model, log, later, trial, cutoff)
    case = Case(earlier.knowledge, base_coefficients(model), earlier.noise, choosing, unseen, repeatable)
    check_same_robot(case.before, choosing, log)
    chosen = Choice(case, progress).run()
    again = identify_again(
        chosen.extension.model, log, chosen.extension.knowledge, chosen.extension.theta, cutoff,
        SearchOptions(budget=search_budget, repeatable=repeatable),
        SamplerOptions(budget=posterior_budget, seed=seed, repeatable=repeatable) if posterior else None,
        progress=progress,
    )  # fmt: skip
    return replace(_discrepancy(case, chosen, again), seconds=time.perf_counter() - began)


# ---------------------------------------------------------------------------------------------------------------
# The result
# ---------------------------------------------------------------------------------------------------------------
def _discrepancy(case: Case, chosen: Chosen, again: Identification) -> Discrepancy:
    unseen, trial = case.unseen, case.trial
    motion = unseen.trial.signals.motion
    extended, theta = again.model, again.theta
    if not unseen.apart:  # those stretches must not have had a say
        predicted = case.predicted(chosen.selection.hypotheses, chosen.selection.explanation)
        theta = case.refitted(chosen.extension, predicted).theta
    before = unseen.trial.gap(case.model.effort(motion, case.knowledge.theta))
    after = unseen.trial.gap(extended.effort(motion, theta))
    after_here = extended.effort(trial.signals.motion, again.theta)
    floor = case.floor(after_here)
    left = unexplained(trial, after_here, floor, chosen.selection.explanation)
    data, library = chosen.data, chosen.library
    verdicts = [weigh(data, library, chosen.selection, one) for one in chosen.selection.hypotheses]
    found = tuple(
        Found(verdict, verdict.hypothesis.joints, _numbers(case, verdict.hypothesis, sd, again))
        for verdict, sd in zip(verdicts, chosen.selection.explanation.sd, strict=True)
    )
    as_known = case.predicted((), chosen.selection.before)  # as far as the earlier log allows, the model gives way
    residual = np.where(trial.used, trial.nearest(as_known) - as_known, 0.0)
    above = [j for j in range(len(before)) if exceeds(trial.gap(as_known)[j], floor, j)]
    status = "unexplained" if left else "explained" if found else "no_discrepancy"
    return Discrepancy(
        status=status,
        where=tuple(where_it_shows(trial, residual, as_known, floor.rms, above)),
        found=found,
        before=before,
        after=after,
        floor=floor,
        holdout=unseen.name,
        unexplained=left,
        scores=chosen.selection.scores,
        vetoed=chosen.vetoed,
        not_testable=tuple(not_testable(chosen.selection.scores, len(before))),
        identification=again,
        trial=trial,
        unseen=unseen.trial,
        predicted_before=case.before,
        predicted_after=after_here,
        warnings=(*_warnings(case, floor), *again.warnings),
        seconds=np.nan,
    )


def _warnings(case: Case, floor: Floor) -> list[str]:
    """What the comparison itself has to say."""
    found = []
    if not case.knowledge.precision.any():
        found.append("nothing is known of how certain the model's parameters are: effects that resemble them go unseen")
    blunt = [str(j + 1) for j in np.flatnonzero(~floor.sharp)]
    if blunt:
        said = f"the model left over {GOOD:.0%} of the effort of joint {', '.join(blunt)} in its own log"
        found.append(f"{said}: there the noise floor is taken from this log ({floor.origin[int(blunt[0]) - 1]})")
    return found


def _numbers(case: Case, one: Hypothesis, sd: Array, again: Identification) -> dict[str, tuple[float, float, str]]:
    """Name to value, standard deviation (NaN where none is known) and unit: parameters, then nonlinear numbers."""
    if isinstance(one.source, Distortion):
        values = one.source.numbers
        spread = sd[: len(values)] if len(sd) >= len(values) else np.full(len(values), np.nan)
        return {name: (value, float(s), unit) for (name, (value, unit)), s in zip(values.items(), spread, strict=True)}
    names = [parameter.name for parameter in again.model.parameters]
    earlier = {p.name: value for p, value in zip(case.model.parameters, case.knowledge.theta, strict=True)}
    spread, _ = again.parameter_sd
    found: dict[str, tuple[float, float, str]] = {}
    for parameter in one.source.parameters(case.model.robot):
        k = names.index(parameter.name)
        found[parameter.name] = (float(again.theta[k]), float(spread[k]), parameter.unit)
        if parameter.name in one.changes:
            change = float(again.theta[k]) - float(earlier[parameter.name])
            found[f"change of {parameter.name}"] = (change, float(spread[k]), parameter.unit)
    for key, unit in getattr(one.source, "shape_units", {}).items():
        for joint, value in zip(one.joints, one.source.shape[key], strict=True):
            found[f"{key}{joint}"] = (float(value), np.nan, unit)
    return found
