"""The workflow: compare a model with a log, name what is missing, add it, identify again, and show the gap shrink."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from bayesid import terms
from bayesid.coefficients import BaseCoefficients, base_coefficients
from bayesid.discrepancy.checks import check_holdout, check_log, check_same_robot
from bayesid.discrepancy.compare import Excess, Floor, Trial, make_trial, noise_floor, where_it_shows
from bayesid.discrepancy.evidence import LN10, Data, Explanation
from bayesid.discrepancy.extension import Extension, extend, moved
from bayesid.discrepancy.hypotheses import Hypothesis, hypotheses
from bayesid.discrepancy.selection import (
    THRESHOLD,
    WORTH,
    Score,
    Selection,
    Verdict,
    explain_with,
    not_testable,
    select,
    weigh,
)
from bayesid.distortions.base import Distortion
from bayesid.fit import fit_signed
from bayesid.identification import Identification, identify_again
from bayesid.knowledge import Information, Knowledge
from bayesid.log import Log, read_log
from bayesid.model import Model
from bayesid.motion import Array, Mask
from bayesid.noise import Noise
from bayesid.posterior.sampler import SamplerOptions
from bayesid.robot import Robot
from bayesid.segments import find_segments
from bayesid.sign_model import restored, settle_signs
from bayesid.signals import prepare
from bayesid.signs import Progress, SearchOptions
from bayesid.terms.base import Scene

_BLOCKS, _HELD_BACK = 8, (2, 5)
"""Without a holdout log these of so many equal stretches of the log are held back."""
_BETTER = 2.0
"""Standard errors by which an effect must shrink the squared residuals of data that it has not seen."""
_STRETCHES = 24
"""Over which this standard error is taken."""
_VETOES = 4
"""Effects that fail on unseen data before the search for others is given up."""
_ABOVE, _ABOVE_BLUNT = 1.25, 1.6
"""Residual over floor from which on a joint is not explained: where the floor holds what lasts of the noise, or not."""
_OWED = 0.75
"""Share of a joint's excess that its effects must explain, where some of it stays unexplained."""
_ROUNDS = 3
_SETTLINGS = 2
_HASTE = 2.0
"""s for the proof of signs that are only a beginning."""


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
        where: where the model before exceeds the floor.
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
        trial: the log.
        predicted_before: (N, n) by the model as it was, N m.
        predicted_after: (N, n) by the extended model, N m.
        warnings: what the user should know.
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
    predicted_before: Array
    predicted_after: Array
    warnings: tuple[str, ...]


@threadpool_limits.wrap(limits=1, user_api="blas")
def find_discrepancy(
    knowledge: Knowledge,
    noise: Noise,
    log: Log | str | Path,
    holdout: Log | str | Path | None = None,
    cutoff: float | None = None,
    search_budget: float = 3.0,
    sampling: SamplerOptions | None = None,
    progress: Progress | None = None,
) -> Discrepancy:
    """Finds what a model lacks to explain a log.

    Args:
        knowledge: the model, its parameters, and how well they are known.
        noise: of the efforts of the log that the model was identified from.
        log: a log of the same robot.
        holdout: another one, to score by; without it stretches of the log are held back.
        cutoff: of the motion's low-pass, Hz; from the data by default.
        search_budget: seconds for the proof of the signs under the extended model.
        sampling: of the extended model's posterior; none by default.
        progress: called as progress(stage, done, total).

    Raises:
        InputError: a log is of another robot, too short, too still, or the holdout is the log.
        SolverError: an optimisation failed.
    """
    log = log if isinstance(log, Log) else read_log(log)
    later = None if holdout is None else holdout if isinstance(holdout, Log) else read_log(holdout)
    model = knowledge.model
    check_log(model.robot, log)
    trial = make_trial(model, prepare(log, cutoff))
    unseen = _unseen(model, log, later, trial, cutoff)
    case = _Case(knowledge, base_coefficients(model), noise, trial, unseen)
    check_same_robot(case.before, trial, log)
    chosen = _Choice(case, progress).run()
    again = identify_again(
        chosen.extension.model, log, chosen.extension.knowledge, chosen.extension.theta, cutoff,
        SearchOptions(budget=search_budget), sampling, progress=progress,
    )  # fmt: skip
    return _discrepancy(case, chosen, again)


# ---------------------------------------------------------------------------------------------------------------
# Data that choose, and data that score
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Unseen:
    """Data that choose nothing: another log, or stretches of the log.

    Attributes:
        trial: they are part of.
        used: (N, n) of its samples.
        name: for people.
    """

    trial: Trial
    used: Mask
    name: str


def _unseen(model: Model, log: Log, later: Log | None, trial: Trial, cutoff: float | None) -> _Unseen:
    if later is not None:
        check_holdout(model.robot, log, later)
        other = make_trial(model, prepare(later, cutoff))
        return _Unseen(other, other.used, later.source)
    block = np.minimum(np.arange(len(trial.used)) * _BLOCKS // len(trial.used), _BLOCKS - 1)
    held = np.isin(block, _HELD_BACK)[:, None]
    named = f"stretches {' and '.join(str(k + 1) for k in _HELD_BACK)} of {_BLOCKS} of {log.source}"
    return _Unseen(trial, trial.used & held, named)


@dataclass(frozen=True)
class _Case:
    """What stays the same while effects are chosen."""

    knowledge: Knowledge
    coefficients: BaseCoefficients
    noise: Noise
    trial: Trial
    unseen: _Unseen

    @property
    def model(self) -> Model:
        """As it was."""
        return self.knowledge.model

    @cached_property
    def columns(self) -> Array:
        """(N, n, r) of the base coefficients."""
        return self.model.columns(self.trial.signals.motion)[:, :, self.coefficients.kept]

    @cached_property
    def information(self) -> Information:
        """What is known of them."""
        return self.knowledge.information(self.model, self.coefficients)

    @cached_property
    def before(self) -> Array:
        """(N, n) the model's efforts, N m."""
        return self.model.effort(self.trial.signals.motion, self.knowledge.theta)

    @cached_property
    def choosing(self) -> Mask:
        """(N, n) samples that choose."""
        own = self.unseen.trial is self.trial
        return self.trial.used & ~self.unseen.used if own else self.trial.used

    def data(self, predicted: Array, probability: Array | None = None) -> Data:
        """The log with its signs settled under a prediction (N, n), N m, unless their probabilities (N, n) are given."""
        probability = self.trial.probability(predicted) if probability is None else probability
        expected = (2.0 * probability - 1.0) * self.trial.magnitude
        expected = np.where(self.trial.signals.signed, self.trial.signals.raw_effort, expected)
        floor = self.floor(predicted)
        return Data(
            columns=self.columns * self.choosing[:, :, None],
            effort=expected * self.choosing,
            used=self.choosing,
            information=self.information,
            floor=floor.rms,
            limits=floor.limits,
            rate=self.trial.signals.rate,
        )

    def floor(self, predicted: Array) -> Floor:
        """The noise floor, as far as this prediction shows it."""
        residual = np.where(self.trial.used, self.trial.nearest(predicted) - predicted, 0.0)
        return noise_floor(self.trial, residual, self.noise)

    def predicted(self, chosen: Sequence[Hypothesis], explanation: Explanation) -> Array:
        """(N, n) efforts of an explanation, N m."""
        effort = self.columns @ explanation.beta
        for one, amplitude in zip(chosen, explanation.amplitudes, strict=True):
            for j, rows in one.columns.rows.items():
                effort[:, j] += rows @ amplitude
            for j, shift in one.columns.shift.items():
                effort[:, j] += shift
        return effort

    def refitted(self, extension: Extension, predicted: Array) -> Extension:
        """The extended model with feasible parameters, from the samples that choose and what was known before."""
        model, knowledge = extension.model.before_sensors, extension.knowledge
        coefficients = knowledge.coefficients(model)
        signals = restored(extension.model, self.trial.signals)
        signs = 2.0 * self.trial.probability(predicted) - 1.0
        known = knowledge.information(model, coefficients)
        fit = fit_signed(model, coefficients, signals, signs, self.choosing & signals.measured, known)
        return replace(extension, theta=fit.theta)

    def scene(self, predicted: Array) -> Scene:
        """What effects may look at."""
        theta, motion = self.knowledge.theta, self.trial.signals.motion

        def effort_with(robot: Robot) -> Array:
            return replace(self.model, robot=robot).effort(motion, theta)

        links = theta[: 10 * self.model.robot.n_joints]
        return Scene(
            self.model.robot, motion, self.trial.actuators, predicted, self.trial.magnitude, links, effort_with
        )


# ---------------------------------------------------------------------------------------------------------------
# Choosing
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Chosen:
    selection: Selection
    data: Data
    library: list[list[Hypothesis]]
    extension: Extension
    vetoed: tuple[tuple[str, tuple[int, ...]], ...]


@dataclass
class _Choice:
    """Chooses effects on some data and checks each on others."""

    case: _Case
    progress: Progress | None
    vetoed: set[tuple[str, tuple[int, ...]]] = field(default_factory=set)
    closed: set[int] = field(default_factory=set)

    def run(self) -> _Chosen:
        """Effects that explain the log and survive on unseen data."""
        case = self.case
        data, library = self._begin()
        kept: list[Hypothesis] = []
        scores: tuple[Score, ...] | None = None
        for done in range(_VETOES + 1):
            self._tell(done)
            selection = select(data, library, kept, self._resettle, self._allowed)
            scores = selection.scores if scores is None else scores
            data = self._resettle(data, selection.hypotheses, selection.explanation)
            worse = self._fails(data, selection.hypotheses)
            if worse is None:
                break
            self.vetoed.add((worse.effect, worse.joints))
            self.closed |= worse.columns.joints & set(self._unexplained(selection))
            kept = [one for one in selection.hypotheses if one is not worse]
            kept = kept[: selection.hypotheses.index(worse)] if worse.columns.joints <= self.closed else kept
        data, selection = self._without_makeshifts(data, selection)
        hypotheses_, explanation = self._sharpened(data, selection.hypotheses)
        selection = replace(selection, hypotheses=tuple(hypotheses_), explanation=explanation, scores=scores or ())
        extension = extend(case.knowledge, case.coefficients, hypotheses_, explanation)
        return _Chosen(selection, data, library, extension, tuple(sorted(self.vetoed)))

    def _without_makeshifts(self, data: Data, selection: Selection) -> tuple[Data, Selection]:
        """Leaves out effects of joints that stay unexplained, unless they explain most of what was to be explained."""
        for joint in self._unexplained(selection):
            here = [one for one in selection.hypotheses if one.columns.joints == {joint}]
            used = self.case.unseen.used[:, joint]
            others = [one for one in selection.hypotheses if one not in here]
            _, without = explain_with(data, others, selection.explanation)
            before = np.mean(self._left(others, without)[used, joint] ** 2)
            after = np.mean(self._left(selection.hypotheses, selection.explanation)[used, joint] ** 2)
            if here and before - after < _OWED * (before - data.floor[joint] ** 2):
                self.vetoed |= {(one.effect, one.joints) for one in here}
                data = self._resettle(data, others, without)
                selection = replace(selection, hypotheses=tuple(others), explanation=explain_with(data, others)[1])
        return data, selection

    def _begin(self) -> tuple[Data, list[list[Hypothesis]]]:
        """Signs settled under the model, its parameters moved as far as the earlier log allows."""
        case, predicted = self.case, self.case.before
        for _ in range(_SETTLINGS):
            _, now = explain_with(case.data(predicted), ())
            predicted = case.predicted((), now)
        library = list(hypotheses(case.model, case.scene(predicted), case.choosing))
        return case.data(predicted, self._second_opinion(predicted)), library

    def _second_opinion(self, predicted: Array) -> Array | None:
        """P(sign = +) by a search under all standard effects, where the model is too poor to settle signs."""
        case = self.case
        missing = [name for name in terms.DEFAULT if name not in {term.name for term in case.model.terms}]
        if case.floor(predicted).sharp.all() or not missing or case.trial.signals.signed.all():
            return None
        model = case.model.before_sensors
        for term in terms.make_terms(missing, model.robot, case.trial.signals.motion):
            model = model.extend(term)
        segments = find_segments(case.trial.signals, case.trial.actuators)
        return settle_signs(model, case.trial.signals, segments, SearchOptions(budget=_HASTE)).probability

    def _resettle(self, data: Data, found: Sequence[Hypothesis], now: Explanation) -> Data:
        return self.case.data(self.case.predicted(found, now))

    def _allowed(self, one: Hypothesis) -> bool:
        return (one.effect, one.joints) not in self.vetoed and not one.columns.joints <= self.closed

    def _unexplained(self, selection: Selection) -> list[int]:
        """(0-based) joints whose residual these effects leave above the floor."""
        predicted = self.case.predicted(selection.hypotheses, selection.explanation)
        floor = self.case.floor(predicted)
        return [joint - 1 for joint, _ in _unexplained(self.case.trial, predicted, floor, selection.explanation)]

    def _fails(self, data: Data, found: Sequence[Hypothesis]) -> Hypothesis | None:
        """The first effect that does not help on unseen data, given those before it."""
        case, unseen = self.case, self.case.unseen
        _, now = explain_with(data, ())
        left = self._left((), now)
        for count in range(1, len(found) + 1):
            _, now = explain_with(data, found[:count], now)
            after = self._left(found[:count], now)
            acts = sorted(found[count - 1].columns.joints)
            standard = found[count - 1].source.name in terms.DEFAULT
            if not _survives(left[:, acts], after[:, acts], unseen.used[:, acts], data.floor[acts], standard):
                return found[count - 1]
            left = after
        return None

    def _left(self, found: Sequence[Hypothesis], now: Explanation) -> Array:
        """(N, n) residuals on unseen data, N m."""
        case, trial = self.case, self.case.unseen.trial
        extension = extend(case.knowledge, case.coefficients, found, now)
        if any(isinstance(one.source, Distortion) and one.source.reveals for one in found):
            extension = case.refitted(extension, case.predicted(found, now))
        predicted = extension.model.effort(trial.signals.motion, extension.theta)
        return trial.nearest(predicted) - predicted

    def _sharpened(self, data: Data, found: Sequence[Hypothesis]) -> tuple[list[Hypothesis], Explanation]:
        """Distortions made exact about the numbers that were found."""
        found = list(found)
        _, now = explain_with(data, found)
        for _ in range(_ROUNDS if any(isinstance(one.source, Distortion) for one in found) else 0):
            shifted = moved(found, now)
            scene = self.case.scene(self.case.columns @ now.beta + self._terms_effort(found, now))
            found = [_relinearised(one, scene) for one in shifted]
            _, now = explain_with(data, found, now)
        return found, now

    def _terms_effort(self, found: Sequence[Hypothesis], now: Explanation) -> Array:
        """(N, n) efforts of the terms among the effects, N m."""
        effort = np.zeros(self.case.before.shape)
        for one, amplitude in zip(found, now.amplitudes, strict=True):
            if not isinstance(one.source, Distortion):
                for j, rows in one.columns.rows.items():
                    effort[:, j] += rows @ amplitude
        return effort

    def _tell(self, done: int) -> None:
        if self.progress is not None:
            self.progress("naming effects", done, _VETOES + 1)


def _relinearised(one: Hypothesis, scene: Scene) -> Hypothesis:
    if not isinstance(one.source, Distortion):
        return one
    shift, columns = one.source.change(scene)
    acting = sorted(one.columns.joints)
    rows = {j: columns[:, j] for j in acting} if columns.shape[2] else {}
    return replace(one, columns=replace(one.columns, rows=rows, shift={j: shift[:, j] for j in acting}))


def _survives(before: Array, after: Array, used: Mask, floor: Array, standard: bool) -> bool:
    """Whether unseen data bear an effect out, by the fall of their squared residuals in units of the noise floor's.

    In sum over its joints they must fall by more than twice the standard error (over stretches of the log), and in one
    of them by half of what an effect must be worth to be chosen at all. What every robot has need only do no harm.
    """
    fall = (before**2 - after**2) * used / floor**2
    seen = used.any(axis=1)
    blocks = np.array([block.sum() for block in np.array_split(fall[seen].sum(axis=1), _STRETCHES)])
    error = blocks.std() / np.sqrt(len(blocks))
    if standard:
        return bool(blocks.mean() > -error)
    worth = fall.sum(axis=0) / np.maximum(used.sum(axis=0), 1)
    return bool(blocks.mean() > _BETTER * error and worth.max() > 0.5 * WORTH)


# ---------------------------------------------------------------------------------------------------------------
# The result
# ---------------------------------------------------------------------------------------------------------------
def _discrepancy(case: _Case, chosen: _Chosen, again: Identification) -> Discrepancy:
    unseen, trial = case.unseen, case.trial
    motion = unseen.trial.signals.motion
    extended, theta = again.model, again.theta
    if unseen.trial is trial:  # those stretches must not have had a say
        theta = case.refitted(chosen.extension, extended.effort(motion, again.theta)).theta
    before = unseen.trial.gap(case.model.effort(motion, case.knowledge.theta), unseen.used)
    after = unseen.trial.gap(extended.effort(motion, theta), unseen.used)
    after_here = extended.effort(trial.signals.motion, again.theta)
    floor = case.floor(after_here)
    unexplained = _unexplained(trial, after_here, floor, chosen.selection.explanation)
    data, library = chosen.data, chosen.library
    verdicts = [weigh(data, library, chosen.selection, one) for one in chosen.selection.hypotheses]
    found = tuple(
        Found(verdict, verdict.hypothesis.joints, _numbers(verdict.hypothesis, chosen.selection.explanation, i))
        for i, verdict in enumerate(verdicts)
    )
    residual = np.where(trial.used, trial.nearest(case.before) - case.before, 0.0)
    above = [j for j in range(len(before)) if _exceeds(trial.gap(case.before)[j], floor, j)]
    status = "unexplained" if unexplained else "explained" if found else "no_discrepancy"
    return Discrepancy(
        status=status,
        where=tuple(where_it_shows(trial, residual, case.before, floor.rms, above)),
        found=found,
        before=before,
        after=after,
        floor=floor,
        holdout=unseen.name,
        unexplained=unexplained,
        scores=chosen.selection.scores,
        vetoed=chosen.vetoed,
        not_testable=tuple(not_testable(chosen.selection.scores)),
        identification=again,
        trial=trial,
        predicted_before=case.before,
        predicted_after=after_here,
        warnings=again.warnings,
    )


def _exceeds(gap: float, floor: Floor, joint: int) -> bool:
    return bool(gap > (_ABOVE if floor.sharp[joint] else _ABOVE_BLUNT) * floor.rms[joint])


def _unexplained(trial: Trial, predicted: Array, floor: Floor, now: Explanation) -> tuple[tuple[int, float], ...]:
    gap = trial.gap(predicted)
    sure = now.anything - now.noise > THRESHOLD * LN10
    return tuple(
        (j + 1, float(gap[j] / floor.rms[j])) for j in range(len(gap)) if sure[j] and _exceeds(gap[j], floor, j)
    )


def _numbers(one: Hypothesis, explanation: Explanation, index: int) -> dict[str, tuple[float, float, str]]:
    """Name to value, standard deviation and unit."""
    amplitude, sd = explanation.amplitudes[index], explanation.sd[index]
    if isinstance(one.source, Distortion):
        values = one.source.numbers
        spread = sd if len(sd) == len(values) else np.full(len(values), np.nan)
        return {name: (value, float(s), unit) for (name, (value, unit)), s in zip(values.items(), spread, strict=True)}
    return {}
