"""What a log wants beyond a model, its signs given: effects that evidence and held-back blocks of it bear out."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.effect import Effect
from bayesid.effects.model import Model
from bayesid.regression.evidence import Evidence
from bayesid.regression.knowledge import Knowledge
from bayesid.regression.least_squares import Fit
from bayesid.regression.selection.explanation import LN10, Explanation
from bayesid.regression.selection.extension import Extension, extend
from bayesid.regression.selection.forward import EQUIVALENT, Candidate, Products, Rules, select_forward
from bayesid.regression.selection.held_back import HeldBackErrors
from bayesid.regression.selection.hypotheses import EffectKey, Hypothesis
from bayesid.regression.selection.near_standstill import near_standstill
from bayesid.regression.selection.scores import explain_with
from bayesid.regression.selection.screening import Screening
from bayesid.regression.selection.signed_log import SignedLog

NEEDED = 12.0
"""Nats by which an effect enters a model: e^-12 times some 150 places a log leave 1e-3 false ones, even if the noise
model is off by a factor of two in nats. The prototypes of DESIGN.md 4."""
_MOST = 16
"""Effects that are added; a bound against endless loops."""
_SIGNIFICANT = 3.0
"""Standard deviations that one number of an effect must be from zero under the final fit: by chance one in 370 is."""
_SHORT_LIST = 60
"""Effects that are looked at again after the first of all looks, in their best form. A round number; not studied."""


@dataclass(frozen=True)
class EnteredEffect:
    """An effect that entered a model.

    Attributes:
        source: the term or distortion, as it was added.
        log10_bayes_factor: for it, given all others that entered.
        equivalent: effects that the log cannot tell from it.
        number_sd: standard deviations of its nonlinear numbers; empty where the log was not asked for them.
    """

    source: Effect
    log10_bayes_factor: float
    equivalent: tuple[str, ...]
    number_sd: tuple[float, ...] = ()

    @property
    def effect(self) -> str:
        """Name in the catalogue."""
        return self.source.effect

    @property
    def joints(self) -> tuple[int, ...]:
        """From 1, in which it acts; none named: on the whole robot."""
        return self.source.joints


def consistent_with_nothing(effect: EnteredEffect, model: Model, theta: Array, sd: Array) -> bool:
    """Whether none of an effect's numbers is three standard deviations from zero.

    Not where no number has one.

    Args:
        effect: of the model.
        model: with the effect.
        theta: (P,) parameters.
        sd: (P,) of them; NaN where a parameter is not decided by itself.
    """
    place = {parameter.name: k for k, parameter in enumerate(model.parameters)}
    own = [place[parameter.name] for parameter in effect.source.parameters(model.robot)]
    values = [*theta[own].tolist(), *(value for value, _ in effect.source.numbers(model.robot).values())]
    spreads = np.array([*sd[own].tolist(), *effect.number_sd])
    numbers = np.abs(values[: len(spreads)])
    known = np.isfinite(spreads)
    return bool(known.any() and np.all(numbers[known] < _SIGNIFICANT * spreads[known]))


@dataclass(frozen=True)
class Wanted:
    """What a log wants beyond a model, its signs given.

    Attributes:
        extension: the model with the effects.
        effects: in the order in which they were added.
        before: errors on held-back blocks without them.
        after: and with them.
        screened: the most promising effects of the catalogue, each in its best form.
        effort: (n,) RMS, N m.
    """

    extension: Extension
    effects: tuple[EnteredEffect, ...]
    before: HeldBackErrors
    after: HeldBackErrors
    screened: tuple[Hypothesis, ...]
    effort: Array

    @property
    def keys(self) -> set[EffectKey]:
        """Effects and joints."""
        return {(effect.effect, effect.joints) for effect in self.effects}


def what_is_wanted(
    evidence: Evidence, fit: Fit, probability: Array, start: Sequence[Effect] = (), *, enter: bool = True
) -> Wanted:
    """Effects that a log wants beyond a model.

    Args:
        evidence: the model, the log, and which samples count.
        fit: of the model to the log.
        probability: (N, n) P(sign = +) of every sample.
        start: effects with which the selection begins; each goes again if it is not worth it.
        enter: whether effects may enter.
    """
    case = SignedLog.of(evidence, fit, probability)
    regression, alone = explain_with(case.data, ())
    screened = case.screened(Screening(regression, alone.errors), _SHORT_LIST)
    begun = case.made(start)
    keys = frozenset(hypothesis.key for hypothesis in begun)
    tried = [*begun, *(hypothesis for hypothesis in screened if hypothesis.key not in keys)]
    products = Products(case.data, tried, list(alone.errors))
    return _selected(case, products, keys, _MOST if enter else 0)


def still_wanted(
    evidence: Evidence, fit: Fit, probability: Array, wanted: Wanted, without: Set[EffectKey] = frozenset()
) -> Wanted:
    """Those of the effects that are worth it too if nobody knows how dry friction turns round near standstill.

    Args:
        evidence: the model, the log, and which samples count.
        fit: of the model to the log.
        probability: (N, n) P(sign = +) of every sample, settled with the effects.
        wanted: the effects that were selected.
        without: effects that are left out.
    """
    kept = [effect.source for effect in wanted.effects if (effect.effect, effect.joints) not in without]
    left = borne_out(evidence, fit, probability, kept)
    equivalent = {(effect.effect, effect.joints): effect.equivalent for effect in wanted.effects}
    effects = (replace(effect, equivalent=equivalent[effect.effect, effect.joints]) for effect in left.effects)
    return replace(left, effects=tuple(effects), screened=wanted.screened)


def borne_out(evidence: Evidence, fit: Fit, probability: Array, effects: Sequence[Effect]) -> Wanted:
    """Those of some effects that a log's evidence and held-back blocks of it bear out, beside each other.

    That is what an effect must pass to stay in a model (`bayesid.signs.completion`), near standstill too.

    Args:
        evidence: the model without them, the log, and which samples count.
        fit: of the model to the log.
        probability: (N, n) P(sign = +) of every sample, settled with the effects.
        effects: terms and distortions.
    """
    case = SignedLog.of(evidence, fit, probability)
    _, alone = explain_with(case.data, ())
    begun = case.made(effects)
    motion = evidence.signals.motion[case.rows]
    uncertain = near_standstill(evidence.model, motion, case.rms_effort, case.data.used)
    products = Products(case.data, begun, list(alone.errors), uncertain)
    return _selected(case, products, frozenset(hypothesis.key for hypothesis in begun), 0)


def _selected(case: SignedLog, products: Products[Hypothesis], start: frozenset[EffectKey], most: int) -> Wanted:
    """The result of a forward selection from a start, with so many effects at most or, with none, of what stays."""
    evidence = case.evidence
    products, chosen = select_forward(products, Rules(NEEDED, most, case.sharpened), start)
    effects = [candidate.hypothesis for candidate in chosen]
    _, explanation = explain_with(case.data, effects)
    knowledge = Knowledge(evidence.model, case.fit.theta, np.zeros_like(case.data.information.hessian))
    return Wanted(
        extension=extend(knowledge, evidence.coefficients, effects, explanation),
        effects=tuple(_entered(products, chosen, explanation)),
        before=products.held_back(()),
        after=products.held_back(chosen),
        screened=tuple(products.hypotheses),
        effort=case.rms_effort,
    )


def _entered(
    products: Products[Hypothesis], chosen: Sequence[Candidate[Hypothesis]], explanation: Explanation
) -> list[EnteredEffect]:
    """The chosen effects, each weighed given the others, with what could stand in its place."""
    entered = []
    for k, candidate in enumerate(chosen):
        gain, equivalent = _weighed(products, candidate, [other for other in chosen if other is not candidate])
        source = candidate.hypothesis.source
        number_sd = () if source.linear else tuple(explanation.sd[k].tolist())
        entered.append(EnteredEffect(source.moved(explanation.amplitudes[k]), gain / LN10, equivalent, number_sd))
    return entered


def _weighed(
    products: Products[Hypothesis], candidate: Candidate[Hypothesis], others: Sequence[Candidate[Hypothesis]]
) -> tuple[float, tuple[str, ...]]:
    """Log Bayes factor of a candidate, given the others, and what could stand in its place."""
    taken = {candidate.hypothesis.key, *(other.hypothesis.key for other in others)}
    near_by = (c for c in products.candidates if c.hypothesis.columns.joints & candidate.hypothesis.columns.joints)
    rivals = [c for c in near_by if c.hypothesis.key not in taken]
    gain, *gains = products.gains(others, [candidate, *rivals]).tolist()
    near = {c.hypothesis.effect for c, g in zip(rivals, gains, strict=True) if g > gain - EQUIVALENT}
    return gain, tuple(sorted(near - {candidate.hypothesis.effect}))
