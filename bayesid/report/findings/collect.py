"""From an identification to what there is to show of it."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.identification.identification import Identification
from bayesid.identification.prediction import NORMAL_95
from bayesid.log.signals import signed_effort
from bayesid.regression.noise import autocovariance
from bayesid.report.findings.content import (
    AMBIGUOUS,
    MOST,
    Alternatives,
    CoefficientTable,
    Correlation,
    Findings,
    Samples,
    SegmentTable,
)
from bayesid.report.findings.summary import summarise
from bayesid.report.thinning import evenly

_LAGS = 0.5
"""s up to which the residual's autocorrelation is shown; a round number, not studied."""
_TINY = 1e-300
"""Keeps a division by nothing finite."""


def find_findings(identification: Identification) -> Findings:
    """What there is to show of an identification.

    Example:
        >>> findings = bayesid.find_findings(result)
        >>> int(findings.segments.ambiguous.sum()), len(findings.segments.sign)
        (0, 70)
    """
    sliding = [joint.prismatic for joint in identification.model.robot.joints]
    _, by_data = identification.parameter_sd
    samples = _samples(identification)
    shown = evenly(len(samples.t), MOST)
    return Findings(
        summary=summarise(identification),
        effort_unit=tuple("N" if slides else "N m" for slides in sliding),
        position_unit=tuple("m" if slides else "rad" for slides in sliding),
        samples=_rows(samples, shown),
        segments=_segments(identification),
        correlation=_correlation(samples, identification.signals.rate),
        coefficients=_coefficients(identification),
        prior_parameters=tuple(
            parameter.name for parameter, data in zip(identification.model.parameters, by_data, strict=True) if not data
        ),
        alternatives=_alternatives(identification),
        draws=_draws(identification),
    )


def _draws(identification: Identification) -> Array | None:
    return None if identification.posterior is None else identification.posterior.uncertain.kept_coefficients()


def _samples(identification: Identification) -> Samples:
    signals, motion = identification.signals, identification.signals.motion
    actuators = identification.model.robot.actuators(motion)
    predicted = identification.model.effort(motion, identification.theta)
    signs = identification.sample_signs
    moving = identification.segments.per_sample(identification.segments.moving, *predicted.shape) > 0
    recorded = identification.log.clock(motion.t)[0] >= 0  # the pause between joined logs is not
    return Samples(
        t=motion.t - motion.origin,
        position=actuators.q,
        velocity=actuators.dq,
        recorded=signals.raw_effort,
        signed=signed_effort(signals, signs),
        predicted=predicted,
        residual=signed_effort(signals, signs, filtered=False) - predicted,
        probability=identification.probability,
        used=moving & recorded[:, None],
        every=1,
    )


def _rows(samples: Samples, rows: Integers) -> Samples:
    count = len(samples.t)
    arrays = {entry.name: getattr(samples, entry.name)[rows] for entry in fields(samples) if entry.name != "every"}
    return replace(samples, **arrays, every=round(count / len(rows)))


def _segments(identification: Identification) -> SegmentTable:
    segments, signs, confidence = identification.recorded_segments
    t = identification.signals.motion.t - identification.signals.motion.origin
    last = len(t) - 1
    return SegmentTable(
        joint=segments.joint,
        start=t[segments.start],
        end=t[np.minimum(segments.end, last)],
        sign=signs,
        confidence=confidence,
        moving=segments.moving,
        ambiguous=confidence < AMBIGUOUS,
    )


def _correlation(samples: Samples, rate: float) -> Correlation:
    lags = max(2, int(_LAGS * rate))
    n = samples.residual.shape[1]
    of_joints = [autocovariance(samples.residual[:, j], samples.used[:, j], lags) for j in range(n)]
    values = np.array([covariance / max(covariance[0], _TINY) for covariance in of_joints])
    count = np.maximum(samples.used.sum(axis=0), 1)
    return Correlation(np.arange(values.shape[1]) / rate, values, NORMAL_95 / np.sqrt(count))


def _coefficients(identification: Identification) -> CoefficientTable:
    """The base coefficients with their uncertainty, by the posterior if there is one."""
    coefficients = identification.coefficients
    low, high = identification.interval_95
    prior_sd, by_data = identification.prior_sd
    return CoefficientTable(
        name=tuple(coefficients.names),
        expression=tuple(coefficients.expressions),
        unit=tuple(coefficients.units),
        mean=identification.beta,
        sd=identification.sd,
        low=low,
        high=high,
        prior_sd=np.where(np.isfinite(prior_sd), prior_sd, np.nan),
        nominal=identification.nominal_beta,
        by_data=by_data,
    )


def _alternatives(identification: Identification) -> Alternatives:
    search, segments = identification.search, identification.searched
    t = identification.signals.motion.t - identification.signals.motion.origin
    branches = search.branches
    decided = np.ones((len(branches), len(search.signs)), dtype=bool) if search.decided is None else search.decided
    pairs = [
        (b, k) for b, branch in enumerate(branches) for k in np.flatnonzero((branch.signs != search.signs) & decided[b])
    ]
    number, segment = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    mass = None if identification.posterior is None else identification.posterior.branch_mass
    return Alternatives(
        cost=np.array([branch.cost for branch in branches]),
        mass=np.full(len(branches), np.nan) if mass is None or len(mass) != len(branches) else mass,
        branch=number,
        joint=segments.joint[segment],
        start=t[segments.start[segment]],
        end=t[segments.end[segment] - 1],
    )
