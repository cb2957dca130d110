"""From an identification to what there is to show of it."""

from __future__ import annotations

import json
from dataclasses import fields, replace

import numpy as np

from bayesid.findings.content import (
    AMBIGUOUS,
    MOST,
    Alternatives,
    CoefficientTable,
    Correlation,
    Findings,
    Samples,
    SegmentTable,
)
from bayesid.identification import Identification
from bayesid.motion import Array, Integers
from bayesid.noise import autocovariance
from bayesid.signals import signed_effort
from bayesid.tables import coefficient_rows, parameter_rows, plain, recorded_segments, summary
from bayesid.views import evenly

_LAGS = 0.5
"""s up to which the residual's autocorrelation is told."""
_NORMAL_95 = 1.959963984540054


def find(identification: Identification) -> Findings:
    """What there is to show of an identification."""
    robot = identification.model.robot
    sliding = [joint.prismatic for joint in robot.joints]
    samples = _samples(identification)
    shown = evenly(len(samples.t), MOST)
    return Findings(
        summary=json.loads(json.dumps(plain(summary(identification)))),
        effort_unit=tuple("N" if one else "N m" for one in sliding),
        position_unit=tuple("m" if one else "rad" for one in sliding),
        samples=_rows(samples, shown),
        segments=_segments(identification),
        correlation=_correlation(samples, identification.signals.rate),
        coefficients=_coefficients(identification),
        prior_parameters=tuple(
            str(row["name"]) for row in parameter_rows(identification) if row["decided_by"] == "prior"
        ),
        alternatives=_alternatives(identification),
        draws=_draws(identification),
    )


def _draws(identification: Identification) -> Array | None:
    if identification.posterior is None:
        return None
    from bayesid.posterior.inference_data import kept_coefficients  # ArviZ takes half a second to import

    return kept_coefficients(identification.posterior.draws)


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
    chosen = {
        one.name: value[rows] for one in fields(samples) if isinstance(value := getattr(samples, one.name), np.ndarray)
    }
    return replace(samples, **chosen, every=round(count / len(rows)))


def _segments(identification: Identification) -> SegmentTable:
    segments, signs, confidence = recorded_segments(identification)
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
    values = np.array([one / max(one[0], 1e-300) for one in of_joints])
    count = np.maximum(samples.used.sum(axis=0), 1)
    return Correlation(np.arange(values.shape[1]) / rate, values, _NORMAL_95 / np.sqrt(count))


def _coefficients(identification: Identification) -> CoefficientTable:
    rows = coefficient_rows(identification)

    def numbers(key: str) -> Array:
        return np.array([np.nan if row[key] == "" else row[key] for row in rows], dtype=float)

    def words(key: str) -> tuple[str, ...]:
        return tuple(str(row[key]) for row in rows)

    return CoefficientTable(
        name=words("name"),
        expression=words("expression"),
        unit=words("unit"),
        mean=numbers("mean"),
        sd=numbers("sd"),
        low=numbers("q2.5"),
        high=numbers("q97.5"),
        prior_sd=numbers("prior_sd"),
        nominal=numbers("nominal"),
        by_data=np.array([row["decided_by"] == "data" for row in rows]),
    )


def _alternatives(identification: Identification) -> Alternatives:
    search, found = identification.search, identification.searched
    t = identification.signals.motion.t - identification.signals.motion.origin
    branches = search.branches
    decided = np.ones((len(branches), len(search.signs)), dtype=bool) if search.decided is None else search.decided
    pairs = [
        (b, k) for b, one in enumerate(branches) for k in np.flatnonzero((one.signs != search.signs) & decided[b])
    ]
    branch, segment = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    mass = None if identification.posterior is None else identification.posterior.branch_mass
    return Alternatives(
        cost=np.array([one.cost for one in branches]),
        mass=np.full(len(branches), np.nan) if mass is None or len(mass) != len(branches) else mass,
        branch=branch,
        joint=found.joint[segment],
        start=t[found.start[segment]],
        end=t[found.end[segment] - 1],
    )
