"""Effects that a log shows beyond a model, with known signs: the evidence and held-back blocks must confirm them.

The search uses thinned rows of a `SignedLog`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain

import numpy as np
import scipy

from bayesid.arrays import Array, Integers
from bayesid.effects import catalogue
from bayesid.effects.effect import Effect, Scene, effect_of
from bayesid.effects.model import Model
from bayesid.log.signals import Signals
from bayesid.parallel import in_parallel
from bayesid.regression.knowledge import CoefficientPrior
from bayesid.regression.least_squares import Fit
from bayesid.regression.log_data import LogData
from bayesid.regression.selection.cross_validation import CrossValidation
from bayesid.regression.selection.fitted_effects import LN10, FittedEffects, Observations
from bayesid.regression.selection.forward import select_forward
from bayesid.regression.selection.hypotheses import EffectKey, Hypothesis, hypotheses, near_standstill
from bayesid.regression.selection.modelled_log import Extension, ModelledLog, about
from bayesid.regression.selection.regression import Effects, Regression, explain
from bayesid.regression.selection.scores import best_forms
from bayesid.regression.tuning import TUNING


@dataclass(frozen=True)
class EnteredEffect:
    """An effect that was added to a model."""

    source: Effect  #: the term or distortion
    log10_bayes_factor: float  #: for it, given all other added effects
    equivalent: tuple[str, ...]  #: effects that the log cannot distinguish from it
    number_sd: tuple[float, ...] = ()  #: sd of its nonlinear numbers; empty if not computed

    @property
    def key(self) -> EffectKey:
        """Effect and joints."""
        return self.effect, self.joints

    @property
    def effect(self) -> str:
        """Name in the catalogue."""
        return self.source.effect

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints from 1 in which it acts; empty: the whole robot."""
        return self.source.joints


def consistent_with_nothing(effect: EnteredEffect, model: Model, theta: Array, covariance: Array) -> bool:
    """Whether an effect may be zero: each number within three standard deviations of zero, and a Wald test of all.

    Parameters (P,) and covariance (P, P) are of the model with the effect, NaN where a parameter is not identifiable.
    An effect without identifiable numbers counts as nonzero.
    """
    place = {parameter.name: k for k, parameter in enumerate(model.parameters)}
    indices = [place[parameter.name] for parameter in effect.source.parameters(model.robot)]
    numbers = [value for value, _ in effect.source.numbers(model.robot).values()][: len(effect.number_sd)]
    values = np.array([*theta[indices].tolist(), *numbers])
    spread = scipy.linalg.block_diag(
        covariance[np.ix_(indices, indices)], np.diag(effect.number_sd[: len(numbers)]) ** 2
    )
    known = np.isfinite(np.diag(spread))
    if not known.any():
        return False
    sd = np.sqrt(np.diag(spread)[known])
    scaled = values[known] / sd
    correlation = spread[np.ix_(known, known)] / np.outer(sd, sd)
    distance = float(scaled @ np.linalg.pinv(correlation, hermitian=True) @ scaled)
    far = scipy.stats.chi2.isf(2.0 * scipy.stats.norm.sf(TUNING.significant), len(scaled))
    return bool(np.abs(scaled).max() < TUNING.significant and distance < far)


@dataclass(frozen=True)
class DetectedEffects:
    """The effects that a log shows beyond a model, with known signs."""

    extension: Extension  #: the model with the effects
    effects: tuple[EnteredEffect, ...]  #: in the order in which they were added
    before: CrossValidation  #: on blocks of the log, without them
    after: CrossValidation  #: and with them
    screened: tuple[Hypothesis, ...]  #: the most promising effects of the catalogue, each in its best form
    effort: Array  #: (n,) RMS, N m

    @property
    def keys(self) -> set[EffectKey]:
        """Effects and joints."""
        return {effect.key for effect in self.effects}


def detect_effects(
    log_data: LogData, fit: Fit, probability: Array, start: Sequence[Effect] = (), *, enter: bool = True
) -> DetectedEffects:
    """Effects that a log, with P(sign = +) (N, n), shows beyond a model fitted to it.

    The selection starts from `start` and removes those that are not confirmed. `enter` allows further effects.
    """
    case = SignedLog.of(log_data, fit, probability)
    alone = explain(case.data, ())
    screened = case.screened(Regression.of(alone), TUNING.short_list)
    first = case.made(start)
    keys = frozenset(hypothesis.key for hypothesis in first)
    tried = [*first, *(hypothesis for hypothesis in screened if hypothesis.key not in keys)]
    return _selected(case, Regression(case.data, tried, alone.errors), keys, TUNING.most_effects if enter else 0)


def still_detected(
    log_data: LogData, fit: Fit, probability: Array, detected: DetectedEffects, without: Set[EffectKey] = frozenset()
) -> DetectedEffects:
    """The detected effects that remain if the shape of dry friction near standstill is unknown.

    The probability (N, n) is P(sign = +), found with the effects; those in `without` are removed.
    """
    kept = [effect.source for effect in detected.effects if effect.key not in without]
    remaining = confirmed(log_data, fit, probability, kept)
    equivalent = {effect.key: effect.equivalent for effect in detected.effects}
    effects = (replace(effect, equivalent=equivalent[effect.key]) for effect in remaining.effects)
    return replace(remaining, effects=tuple(effects), screened=detected.screened)


def confirmed(log_data: LogData, fit: Fit, probability: Array, effects: Sequence[Effect]) -> DetectedEffects:
    """Those of some effects that the evidence and held-back blocks of a log confirm, given each other.

    An effect must pass this to stay in a model (`bayesid.signs.model_selection`), near standstill too. `log_data` is of
    the model without them; the probability (N, n) is P(sign = +), found with them.
    """
    case = SignedLog.of(log_data, fit, probability)
    hypotheses = case.made(effects)
    uncertain = near_standstill(log_data.model, case.modelled.motion, case.rms_effort, case.data.used)
    regression = Regression(case.data, hypotheses, explain(case.data, ()).errors, uncertain)
    return _selected(case, regression, frozenset(hypothesis.key for hypothesis in hypotheses), 0)


def _selected(case: SignedLog, regression: Regression, start: frozenset[EffectKey], most: int) -> DetectedEffects:
    """The result of forward selection from `start` with at most `most` effects; none: only removal."""
    regression, chosen = select_forward(
        regression, needed=TUNING.needed, most=most, sharpen=case.sharpened, start=start
    )
    fitted_effects = explain(case.data, chosen)
    return DetectedEffects(
        extension=case.modelled.extended(fitted_effects),
        effects=tuple(_entered(regression, fitted_effects)),
        before=regression.cross_validation(()),
        after=regression.cross_validation(chosen),
        screened=tuple(regression.effects),
        effort=case.rms_effort,
    )


def _entered(regression: Regression, fitted_effects: FittedEffects) -> list[EnteredEffect]:
    """Each effect with its Bayes factor given the others, and its equivalents."""
    entered, taken = [], {effect.key for effect in fitted_effects.effects}
    for k, effect in enumerate(fitted_effects.effects):
        near_by = (other for other in regression.effects if other.columns.joints & effect.columns.joints)
        rivals = [other for other in near_by if other.key not in taken]
        gain, *gains = regression.gains(fitted_effects.without(effect), [effect, *rivals]).tolist()
        near = {other.effect for other, g in zip(rivals, gains, strict=True) if g > gain - LN10}
        source = effect.source
        equivalent = tuple(sorted(near - {source.effect}))
        number_sd = () if source.linear else tuple(fitted_effects.sd[k].tolist())
        entered.append(EnteredEffect(source.moved(fitted_effects.amplitudes[k]), gain / LN10, equivalent, number_sd))
    return entered


@dataclass(frozen=True)
class SignedLog:
    """A log with known signs and a fitted model, on thinned rows."""

    log_data: LogData
    fit: Fit
    rows: Integers
    modelled: ModelledLog
    data: Observations

    @classmethod
    def of(cls, log_data: LogData, fit: Fit, probability: Array) -> SignedLog:
        """With efforts in their expected signs, from P(sign = +) (N, n)."""
        signals, (rows, rate) = log_data.signals, thinned(log_data.signals)
        r, floor = len(log_data.coefficients), fit.residual
        knowledge = CoefficientPrior(log_data.model, fit.theta, np.zeros((r, r)))
        motion, magnitude, used = signals.motion[rows], signals.magnitude[rows], log_data.used[rows]
        modelled = ModelledLog(knowledge, log_data.coefficients, motion, magnitude, used, rate)
        data = modelled.observed(
            np.where(signals.signed, signals.raw_effort, (2.0 * probability - 1.0) * signals.magnitude)[rows],
            floor=floor.sigma,
            reliable=np.ones(len(floor.sigma), dtype=bool),
            limits=np.stack([floor.white, floor.coloured], axis=1),
        )
        return cls(log_data, fit, rows, modelled, data)

    @property
    def rms_effort(self) -> Array:
        """(n,) RMS effort, N m."""
        used = self.data.used
        return np.sqrt((self.data.effort**2).sum(axis=0) / np.maximum(used.sum(axis=0), 1))

    def sharpened(self, regression: Regression, chosen: Effects) -> Mapping[int, Hypothesis]:
        """Distortions linearised near the current fit, by the ids of their old forms.

        Chosen ones are linearised about their own numbers; all others too if the model's effort has changed enough.
        """
        forms: dict[int, Hypothesis] = {}
        best, r = regression.best(chosen), len(self.log_data.coefficients)
        beta, parts = best[:r], [(effect, best[regression.place(effect)]) for effect in chosen]
        if not all(effect.source.linear for effect in chosen):
            fitted_effects = self.modelled.sharpened(self.data, chosen)
            forms = {id(old): new for old, new in zip(chosen, fitted_effects.effects, strict=True)}
            beta, parts = fitted_effects.beta, fitted_effects.parts
        effort = self.modelled.effort_of(beta, parts, distorted=False)
        change = np.where(self.data.used, effort - self.fit.predicted[self.rows], 0.0)
        rms = np.sqrt((change**2).sum(axis=0) / np.maximum(self.data.used.sum(axis=0), 1))
        if np.any(rms > TUNING.moved_effort * self.rms_effort):
            others = [h for h in regression.effects if not h.source.linear and all(h is not e for e in chosen)]
            forms |= {id(old): new for old, new in zip(others, about(others, self.modelled.scene(effort)), strict=True)}
        return forms

    def made(self, effects: Sequence[Effect]) -> list[Hypothesis]:
        """Hypotheses of effects on the log, without ineffective ones; distortions last."""
        made = (self._make(effect) for effect in effects)
        return sorted((h for h in made if h.columns.joints), key=lambda hypothesis: not hypothesis.source.linear)

    def library(self, joint: int) -> list[list[Hypothesis]]:
        """All forms in a (0-based) joint that the log can resolve and distinguish from the model's parameters."""
        return list(self._tellable(joints=(joint + 1,)))

    def screened(self, regression: Regression, most: int) -> list[Hypothesis]:
        """The most promising effects of the library, each in its best form, best first."""
        effects = dict.fromkeys(effect_of(name) for name in catalogue.forms())
        tasks = [partial(self._best_forms, regression, effect) for effect in effects]
        best = sorted(chain(*in_parallel(tasks)), key=lambda form: -form[0])[:most]
        made = [(self._make(source), sd) for _, source, sd in best]
        return [replace(form, columns=replace(form.columns, sd=sd)) for form, sd in made]

    def _best_forms(self, regression: Regression, effect: str) -> list[tuple[float, Effect, Array]]:
        """Gain, source and prior sd of the best form of an effect in each place; small, to pass between processes."""
        scores = best_forms(regression, self._tellable(effect=effect))
        return [(score.gain, score.hypothesis.source, score.hypothesis.columns.sd) for score in scores]

    def _tellable(
        self, *, effect: str | None = None, joints: tuple[int, ...] | None = None
    ) -> Iterator[list[Hypothesis]]:
        for group in hypotheses(self._make, self._scene, effect=effect, joints=joints, refinements=True):
            if testable := [form for form in group if _testable(form, self._scene)]:
                yield testable

    @cached_property
    def _scene(self) -> Scene:
        return self.modelled.scene(self.fit.predicted[self.rows])

    @cached_property
    def _make(self) -> Callable[[Effect], Hypothesis]:
        return self.modelled.maker(self._scene)


def _testable(hypothesis: Hypothesis, scene: Scene) -> bool:
    new = not hypothesis.changes and not hypothesis.source.needs_earlier
    return new and hypothesis.source.resolved(scene)


def thinned(signals: Signals) -> tuple[Integers, float]:
    """Evenly spaced rows of a log, in stretches of a very long one, and their rate, Hz."""
    count = len(signals.motion)
    step = min(-(-count // TUNING.thinned_samples), max(1, int(signals.rate / TUNING.slowest_rate)))
    rows = np.arange(0, count, step)
    if len(rows) > 2 * TUNING.thinned_samples:
        length = TUNING.thinned_samples // TUNING.stretches
        starts = np.linspace(0, len(rows) - length, TUNING.stretches).astype(int)
        rows = np.concatenate([rows[start : start + length] for start in starts])
    return rows, signals.rate / step
