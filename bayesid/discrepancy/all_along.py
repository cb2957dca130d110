"""Change against deficiency: which effects a later log shows that an earlier one has shown as well, or could not have.

An effect beyond the terms asked for was missing all along if both logs bear it out by themselves, evidence and
held-back blocks both, near standstill too: what an effect must pass to enter a model in the first place. Where a log
does not, it may have been too short or too still to show the effect, or the effect is not there. The size in the other
log tells: with a the amplitudes here, C their covariance and b the size there,

    log p(log | b) - log p(log | 0) = a' C^-1 b - b' C^-1 b / 2

is decisive against the effect, or the log cannot tell.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from bayesid.arrays import Array
from bayesid.effects import STANDARD
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.effect import Effect
from bayesid.effects.model import Model
from bayesid.identification.identification import Identification
from bayesid.regression.evidence import Evidence
from bayesid.regression.least_squares import fit_signed
from bayesid.regression.selection.explanation import LN10
from bayesid.regression.selection.hypotheses import EffectKey
from bayesid.regression.selection.wanted import borne_out
from bayesid.signs.settling import restored

DECISIVE = 2.0
"""Log10 of a likelihood ratio from which on a log speaks for or against an effect of a given size (Jeffreys 1961,
appendix B)."""
SHOWN, ABSENT, OPEN = "shown", "absent", "cannot tell"
"""What a log says of an effect."""


@dataclass(frozen=True)
class Standing:
    """What a log says of an effect.

    Attributes:
        says: `SHOWN`, `ABSENT` or `OPEN`.
        log10_bayes_factor: for the effect beside all others, where the log bears it out; NaN elsewhere.
        log10_ratio: for its size in the other log against none; NaN where that cannot be said.
    """

    says: str
    log10_bayes_factor: float = np.nan
    log10_ratio: float = np.nan


def key_of(effect: Effect) -> EffectKey:
    """Effect and joints, whatever the form."""
    return effect.effect, effect.joints


def without(model: Model, keys: Sequence[EffectKey]) -> Model:
    """A model without some effects."""
    kept = [effect for effect in model.effects if key_of(effect) not in keys]
    return reduce(Model.extend, kept, Model(model.robot, ()))


def shown_by(run: Identification, effects: Sequence[Effect]) -> dict[EffectKey, float]:
    """Those of some effects that a log bears out by itself, beside the rest of its model, with log10 Bayes factors.

    Args:
        run: from that log.
        effects: beyond the terms asked for.

    Raises:
        SolverError: an optimisation failed.
    """
    if not effects:
        return {}
    evidence = _evidence(run, without(run.model, [key_of(effect) for effect in effects]))
    fit = fit_signed(evidence, 2.0 * run.probability - 1.0)
    wanted = borne_out(evidence, fit, run.probability, effects)
    return {(effect.effect, effect.joints): effect.log10_bayes_factor for effect in wanted.effects}


def missing_all_along(model: Model, again: Identification) -> tuple[EffectKey, ...]:
    """Effects beyond the standard terms that an earlier model has and a later log bears out by itself as well.

    Args:
        model: the earlier one, completed by what its log has shown.
        again: from the later log, of that model with what it lacked.

    Raises:
        SolverError: an optimisation failed.
    """
    beyond = [one for one in model.effects if (one.joints or one.name not in STANDARD) and not one.needs_earlier]
    shown = shown_by(again, [one for one in again.model.effects if key_of(one) in {key_of(other) for other in beyond}])
    return tuple(key_of(one) for one in beyond if key_of(one) in shown)


def standing(
    run: Identification, effect: Effect, borne_out: Mapping[EffectKey, float], other: Identification
) -> Standing:
    """What a log says of an effect that another log has shown.

    Args:
        run: from this log by itself.
        effect: with its numbers in the other log.
        borne_out: what `shown_by` says of this log.
        other: from the other log by itself, of a model with the effect.

    Raises:
        SolverError: an optimisation failed.
    """
    linear = bool(effect.parameters(run.model.robot))
    ratio = _of_amplitudes(run, effect, other) if linear else _of_distortion(run, effect)
    if key_of(effect) in borne_out:
        return Standing(SHOWN, borne_out[key_of(effect)], ratio)
    return Standing(ABSENT if ratio <= -DECISIVE else OPEN, np.nan, ratio)


def _of_amplitudes(run: Identification, effect: Effect, other: Identification) -> float:
    """log10 p(log | amplitudes in the other log) - log10 p(log | none); NaN where either log does not show them."""
    own = [parameter.name for parameter in effect.parameters(run.model.robot)]
    names = [name for name in own if name in run.coefficients.names and name in other.coefficients.names]
    here, there = ([side.coefficients.names.index(name) for name in names] for side in (run, other))
    covariance = run.fit.covariance[np.ix_(here, here)]
    if not names or not np.isfinite(covariance).all() or not np.isfinite(other.fit.sd[there]).all():
        return np.nan
    size = other.fit.beta[there]
    weighed: Array = np.linalg.pinv(covariance, hermitian=True) @ size
    return float(run.fit.beta[here] @ weighed - 0.5 * size @ weighed) / LN10


def _of_distortion(run: Identification, effect: Effect) -> float:
    """The same of an effect with numbers instead of amplitudes, from the residuals with it and without it."""
    plain = without(run.model, [key_of(effect)])
    fits, counts = [], []
    for model in (plain, plain.extend(effect)):
        evidence = _evidence(run, model)
        fits.append(fit_signed(evidence, 2.0 * run.probability - 1.0))
        counts.append(evidence.used.sum(axis=0))
    time = np.maximum(*(fit.residual.autocorrelation for fit in fits))
    gain = np.log(fits[0].residual.sigma / fits[1].residual.sigma)
    return float(np.minimum(*counts) / time @ gain) / LN10


def _evidence(run: Identification, model: Model) -> Evidence:
    """The log of an identification, as another model is to explain it."""
    rows, signals = model.before_sensors, restored(model, run.signals)
    moving, fitted = (
        run.segments.per_sample(which, *run.probability.shape) > 0
        for which in (run.segments.moving, run.segments.fitted)
    )
    return Evidence(rows, base_coefficients(rows), signals, moving, fitted & signals.measured)
