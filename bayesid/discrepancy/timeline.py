"""Evidence of each of several logs alone: for effects, and for parameters, which form a time line.

An effect was missing in all logs if each log alone confirms it by model selection. If a log does not, the effect is
absent, or the log is too short or too slow to show it. The effect's size in another log decides. Let `a` be the
amplitudes in this log, C their covariance, and b the amplitudes in the other log. The effect is absent if

    log p(log | b) - log p(log | 0) = a' C^-1 b - b' C^-1 b / 2

is decisive against it.

A parameter's change since the first log is given in standard deviations of the difference of independent
identifications. These include coloured noise, by effective samples, and effects that the model may lack
(:eq:`nuisance-spread`). A single log cannot separate a payload from the last link; the difference of two logs can. With
d the difference of the coefficients, C its covariance and P the columns of a body on the last link::

    payload = (P' C^-1 P)^-1 P' C^-1 d,   rest = d - P payload,   Cov(rest) = C - P (P' C^-1 P)^-1 P'.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from scipy.special import ndtr, ndtri

from bayesid.arrays import Array, Mask
from bayesid.discrepancy.tuning import TUNING
from bayesid.effects import STANDARD, RigidBody
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.effect import Effect
from bayesid.effects.model import Model
from bayesid.identification.identification import Identification
from bayesid.regression.knowledge import RIDGE
from bayesid.regression.least_squares import fit_signed
from bayesid.regression.log_data import LogData
from bayesid.regression.selection.detected import confirmed
from bayesid.regression.selection.fitted_effects import LN10
from bayesid.regression.selection.hypotheses import EffectKey
from bayesid.signs.sign_solution import restored

PAYLOAD = "payload mass"
"""Name of the payload's parameter."""
SHOWN, ABSENT, OPEN = "shown", "absent", "cannot tell"
"""Evidence of a log about an effect."""


# ---- Effects ----
@dataclass(frozen=True)
class LogEvidence:
    """Evidence of a log about an effect."""

    says: str  #: `SHOWN`, `ABSENT` or `OPEN`
    log10_bayes_factor: float = np.nan  #: for the effect beside all others; NaN if not confirmed
    log10_ratio: float = np.nan  #: likelihood ratio of its size in the other log against zero; NaN if unknown


def key_of(effect: Effect) -> EffectKey:
    """Effect and joints, independent of the form."""
    return effect.effect, effect.joints


def without(model: Model, keys: Sequence[EffectKey]) -> Model:
    """A model without some effects."""
    kept = [effect for effect in model.effects if key_of(effect) not in keys]
    return reduce(Model.extend, kept, Model(model.robot, (), constraints=model.constraints))


def shown_by(run: Identification, effects: Sequence[Effect]) -> dict[EffectKey, float]:
    """Effects that a run's log confirms alone, beside the other effects, with their log10 Bayes factors."""
    if not effects:
        return {}
    log_data = _log_data(run, without(run.model, [key_of(effect) for effect in effects]))
    fit = fit_signed(log_data, 2.0 * run.probability - 1.0)
    found = confirmed(log_data, fit, run.probability, effects)
    return {(effect.effect, effect.joints): effect.log10_bayes_factor for effect in found.effects}


def missing_preexisting(model: Model, again: Identification) -> tuple[EffectKey, ...]:
    """Non-standard effects of an earlier model that a later log confirms alone."""
    extra = [effect for effect in model.effects if effect.joints or effect.name not in STANDARD]
    beyond = [key_of(effect) for effect in extra if not effect.needs_earlier]
    shown = shown_by(again, [effect for effect in again.model.effects if key_of(effect) in beyond])
    return tuple(key for key in beyond if key in shown)


def log_evidence(
    run: Identification, effect: Effect, confirmed: Mapping[EffectKey, float], other: Identification
) -> LogEvidence:
    """Evidence of a log about an effect with its numbers in another log; `confirmed` is the result of `shown_by`."""
    linear = bool(effect.parameters(run.model.robot))
    ratio = _of_amplitudes(run, effect, other) if linear else _of_distortion(run, effect)
    if key_of(effect) in confirmed:
        return LogEvidence(SHOWN, confirmed[key_of(effect)], ratio)
    return LogEvidence(ABSENT if ratio <= -TUNING.decisive else OPEN, np.nan, ratio)


def _of_amplitudes(run: Identification, effect: Effect, other: Identification) -> float:
    """log10 p(log | amplitudes in the other log) - log10 p(log | none); NaN if either log does not show them."""
    names = [parameter.name for parameter in effect.parameters(run.model.robot)]
    names = [name for name in names if name in run.coefficients.names and name in other.coefficients.names]
    here, there = ([side.coefficients.names.index(name) for name in names] for side in (run, other))
    covariance = run.fit.covariance[np.ix_(here, here)]
    if not names or not np.isfinite(covariance).all() or not np.isfinite(other.fit.sd[there]).all():
        return np.nan
    size = other.fit.beta[there]
    weighed: Array = np.linalg.pinv(covariance, hermitian=True) @ size
    return float(run.fit.beta[here] @ weighed - 0.5 * size @ weighed) / LN10


def _of_distortion(run: Identification, effect: Effect) -> float:
    """The same for a distortion, from the residuals with it and without it."""
    plain = without(run.model, [key_of(effect)])
    fits, counts = [], []
    for model in (plain, plain.extend(effect)):
        log_data = _log_data(run, model)
        fits.append(fit_signed(log_data, 2.0 * run.probability - 1.0))
        counts.append(log_data.used.sum(axis=0))
    time = np.maximum(*(fit.residual.autocorrelation for fit in fits))
    gain = np.log(fits[0].residual.sigma / fits[1].residual.sigma)
    return float(np.minimum(*counts) / time @ gain) / LN10


def _log_data(run: Identification, model: Model) -> LogData:
    rows, signals = model.before_sensors, restored(model, run.signals)
    moving, fitted = (
        run.segments.per_sample(which, *run.probability.shape) > 0
        for which in (run.segments.moving, run.segments.fitted)
    )
    return LogData(rows, base_coefficients(rows), signals, moving, fitted & signals.measured)


# ---- Parameters ----
@dataclass(frozen=True)
class TrackedParameter:
    """A coefficient of the time line."""

    name: str  #: its leading parameter
    expression: str  #: sum of parameters
    unit: str
    effect: str  #: catalogue name of the form of its leading parameter
    joint: int  #: from 1

    @property
    def plain(self) -> bool:
        """Whether it is a single parameter."""
        return self.expression == self.name


@dataclass(frozen=True)
class Timeline:
    """C coefficients of one model over K logs, each identified alone; NaN if not identifiable from a log.

    Attributes:
        tracked: (C,) names and units.
        value: (K, C) estimates.
        sd: (K, C) standard deviations; inf if not identifiable.
        change: (K, C) change since the first log, without that of a payload.
        change_sd: (K, C) standard deviations of the changes, from both logs; NaN for the first log.
        of_payload: (K, C) contribution of a new payload; 0 without one.
        p: (K, C) p values of the changes after Holm's correction for all tests; NaN if not tested.

    Example:
        >>> line = bayesid.find_discrepancy(robot, [log, other_log], terms=terms, posterior=False).timeline
        >>> line.value.shape == (2, len(line.tracked))
        True
    """

    tracked: tuple[TrackedParameter, ...]
    value: Array
    sd: Array
    change: Array
    change_sd: Array
    of_payload: Array
    p: Array

    @property
    def z(self) -> Array:
        """(K, C) changes in standard deviations."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.change / self.change_sd)

    @property
    def moved(self) -> Mask:
        """(K, C) whether a coefficient has changed since the first log: p below `Tuning.level`."""
        with np.errstate(invalid="ignore"):
            return np.asarray(self.p < TUNING.level)

    @property
    def n_tested(self) -> int:
        """Number of changes that were tested."""
        return int(np.isfinite(self.p).sum())

    @property
    def factor(self) -> float:
        """Median |z| over that of a normal distribution; 1 if the standard deviations are right, NaN without tests."""
        z = np.abs(self.z[np.isfinite(self.p)])
        return float(np.median(z) / ndtri(0.75)) if len(z) else np.nan


def make_timeline(runs: Sequence[Identification], loaded: Sequence[bool]) -> Timeline:
    """The time line of K identifications of one model, each from its own log; (K,) `loaded`: with a new payload.

    Least-squares estimates are used, as the prior of a posterior would pull all logs to the same values.
    """
    first = runs[0]
    tracked = _tracked(first)
    places = [_places(tracked, run) for run in runs]
    pairs = list(zip(runs, places, strict=True))
    value = np.stack([np.where(place >= 0, run.fit.beta[place], np.nan) for run, place in pairs])
    sd = np.stack([np.where(place >= 0, run.fit.sd[place], np.inf) for run, place in pairs])
    change, change_sd, of_payload = np.zeros_like(value), np.full_like(value, np.nan), np.zeros_like(value)
    masses = [(0.0, 0.0)]
    for k in range(1, len(runs)):
        known = np.isfinite(sd[0]) & np.isfinite(sd[k])
        both = ((first, places[0][known]), (runs[k], places[k][known]))
        covariance = np.sum([run.fit.covariance[np.ix_(place, place)] for run, place in both], axis=0)
        difference = value[k] - value[0]
        columns = _last_link(first)[places[0][known]] if loaded[k] else np.zeros((int(known.sum()), 0))
        result = without_payload(difference[known], covariance, columns)
        change[k] = np.where(known, 0.0, np.nan)
        change[k, known], change_sd[k, known], of_payload[k, known] = result.change, result.sd, result.of_payload
        masses.append(result.mass)
    line = Timeline(tracked, value, sd, change, change_sd, of_payload, np.full_like(value, np.nan))
    line = _with_payload(line, masses, loaded) if any(loaded) else line
    return replace(line, p=_corrected(line))


@dataclass(frozen=True)
class PayloadFit:
    """Differences of m coefficients after a payload is fitted."""

    change: Array  # (m,) not explained by the payload
    sd: Array  # (m,) standard deviations of these; NaN if a payload explains any difference
    of_payload: Array  # (m,) explained by the payload
    mass: tuple[float, float]  # kg, and its standard deviation; NaN without columns


def without_payload(difference: Array, covariance: Array, columns: Array) -> PayloadFit:
    """Removes a body on the last link from differences of coefficients, by generalised least squares.

    Args:
        difference: (m,) differences.
        covariance: (m, m) of these.
        columns: (m, 10) by which a body's parameters, the mass last, add to them; or (m, 0). Coefficients with zero
            columns do not affect the fit, as they may have changed for other reasons.
    """
    variance, none = np.diag(covariance), np.zeros_like(difference)
    touched = np.any(columns != 0.0, axis=1) & (variance > 0.0)  # without coefficients fixed by an equality
    if not touched.any():
        return PayloadFit(difference, np.sqrt(variance), none, (np.nan, np.nan))
    scale = 1.0 / np.sqrt(variance[touched])
    values, vectors = np.linalg.eigh(scale[:, None] * covariance[np.ix_(touched, touched)] * scale)
    free = values > RIDGE * values[-1]
    white = (vectors[:, free] / np.sqrt(values[free])).T * scale
    rows = white @ columns[touched]
    size = np.linalg.norm(rows, axis=0)
    size[size == 0.0] = 1.0
    inverse = np.linalg.pinv(rows / size) / size[:, None]
    body, spread = inverse @ (white @ difference[touched]), inverse @ inverse.T
    remaining = variance - np.einsum("ip,pq,iq->i", columns, spread, columns)
    sd = np.where(remaining > 1e-6 * variance, np.sqrt(np.maximum(remaining, 0.0)), np.nan)
    mass = (float(body[-1]), float(np.sqrt(spread[-1, -1]))) if spread[-1, -1] > 0.0 else (np.nan, np.nan)
    return PayloadFit(difference - columns @ body, sd, columns @ body, mass)


def _corrected(line: Timeline) -> Array:
    p = np.full_like(line.value, np.nan)
    tested = np.isfinite(line.z)
    tested[0] = False
    p[tested] = holm(2.0 * ndtr(-np.abs(line.z[tested])))
    return p


def holm(p: Array) -> Array:
    """(m,) p values corrected for m tests, which bounds the probability of any false positive.

    Valid for dependent tests, which share the first log's errors (S. Holm, "A simple sequentially rejective multiple
    test procedure", Scandinavian Journal of Statistics 6, 65, 1979).
    """
    order, m = np.argsort(p, kind="stable"), len(p)
    corrected = np.empty(m)
    corrected[order] = np.minimum(np.maximum.accumulate((m - np.arange(m)) * p[order]), 1.0)
    return corrected


def _with_payload(line: Timeline, masses: Sequence[tuple[float, float]], loaded: Sequence[bool]) -> Timeline:
    """With the payload's mass beyond that of the first log as one more parameter."""
    mass, sd = (np.array(column)[:, None] for column in zip(*masses, strict=True))
    with_body = np.array(loaded)[:, None]
    value, change_sd = np.where(with_body, mass, np.nan), np.where(with_body, sd, np.nan)
    sd = np.where(with_body, sd, np.inf)
    value[0], sd[0] = 0.0, 0.0
    columns = (value, sd, value, change_sd, np.zeros_like(mass), np.full_like(mass, np.nan))
    known = (line.value, line.sd, line.change, line.change_sd, line.of_payload, line.p)
    tracked = (*line.tracked, TrackedParameter(PAYLOAD, PAYLOAD, "kg", "payload", 0))
    return Timeline(tracked, *(np.hstack(pair) for pair in zip(known, columns, strict=True)))


def _tracked(run: Identification) -> tuple[TrackedParameter, ...]:
    model, table = run.model, run.coefficients
    owners = [(term.name, p.joint) for term in model.terms for p in term.parameters(model.robot)]
    rows = zip(table.names, table.expressions, table.units, table.selected.tolist(), strict=True)
    return tuple(TrackedParameter(name, text, unit, *owners[place]) for name, text, unit, place in rows)


def _places(tracked: Sequence[TrackedParameter], run: Identification) -> Array:
    """(C,) indices of the parameters in an identification; -1 if it lacks one."""
    keys = list(zip(run.coefficients.names, run.coefficients.expressions, strict=True))
    tracked_keys = [(parameter.name, parameter.expression) for parameter in tracked]
    return np.array([keys.index(key) if key in keys else -1 for key in tracked_keys])


def _last_link(run: Identification) -> Array:
    """(r, 10) by which the parameters of the last link, or of a payload, add to the coefficients."""
    last = 0
    for term in run.model.terms:
        last += len(term.parameters(run.model.robot))
        if term.name == RigidBody.name:
            break
    return run.coefficients.projection[:, last - 10 : last]
