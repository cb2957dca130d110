"""Effects for joints that the model explains poorly, proposed before their signs are known.

Signs that were found under a poor model suit that model, and so hide what it lacks. So in such a joint every effect is
tried with signs of its own: from several starts, coefficients and signs are fitted in turn until neither changes, the
other joints' efforts holding the coefficients that they share. The effect whose residual is least, for the numbers that
it takes, is proposed; a search under it decides.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.fit.effects.explanation import Observations
from bayesid.fit.effects.hypotheses import Hypothesis
from bayesid.fit.effects.relevance import inverse_of
from bayesid.fit.effects.signed_log import SignedLog

_MOST_TURNS = 40
"""Of coefficients and signs; a round number, a fit of 60 coefficients takes some ten."""
_MOST_FORMS = 30
"""Forms of an effect in one joint, beyond which it is not tried: waves of 400 lengths explain anything."""
_LEAST_GAIN = 3.0
"""Nats by which an effect must do better than none to be proposed: the search that follows takes its time."""


@dataclass(frozen=True)
class PoorJoint:
    """One joint that is explained poorly, the others as they are.

    Attributes:
        joint: 0-based.
        magnitude: (N,) |effort|, N m.
        prediction: (N,) of the model so far, N m.
        weight: sd of the error, N m, its autocorrelation included.
        count: effective samples.
        hessian: (r, r) of the coefficients, by the other joints.
        gradient: (r,) the same.
    """

    joint: int
    magnitude: Array
    prediction: Array
    weight: float
    count: float
    hessian: Array
    gradient: Array

    @classmethod
    def of(cls, log: SignedLog, joint: int) -> PoorJoint:
        """A (0-based) joint of a log."""
        signals, data, residual = log.evidence.signals, log.data, log.fit.residual
        time = np.maximum(residual.autocorrelation / (signals.rate / data.rate), 1.0)
        weight = residual.sigma * np.sqrt(time)
        others = [j for j in range(len(weight)) if j != joint]
        columns, effort = data.columns / weight[:, None], data.effort / weight
        rows = columns[:, others].reshape(-1, columns.shape[2])
        return cls(
            joint=joint,
            magnitude=signals.magnitude[log.rows, joint],
            prediction=log.fit.predicted[log.rows, joint],
            weight=float(weight[joint]),
            count=float(data.used[:, joint].sum() / time[joint]),
            hessian=rows.T @ rows,
            gradient=rows.T @ effort[:, others].ravel(),
        )


def propose(data: Observations, poor: PoorJoint, library: Sequence[Sequence[Hypothesis]]) -> Hypothesis | None:
    """The effect that explains a joint best, with signs of its own; None where none is worth it.

    Args:
        data: the log.
        poor: the joint.
        library: all hypotheses.
    """
    used = data.used[:, poor.joint]
    columns = data.columns[used, poor.joint]
    best, least = None, _least_cost(poor, columns, used) - _LEAST_GAIN
    for hypothesis in _of_joint(library, poor.joint):
        rows = hypothesis.columns.rows[poor.joint][used]
        cost = _least_cost(poor, np.concatenate([columns, rows], axis=1), used)
        if cost < least:
            best, least = hypothesis, cost
    return best


def _of_joint(library: Sequence[Sequence[Hypothesis]], joint: int) -> Iterator[Hypothesis]:
    for group in library:
        if group[0].columns.joints == {joint} and len(group) <= _MOST_FORMS and joint in group[0].columns.rows:
            yield from (hypothesis for hypothesis in group if hypothesis.source.linear)


def _least_cost(poor: PoorJoint, columns: Array, used: Mask) -> float:
    """Half the Bayesian information criterion of columns (M, m), from the best of three starts."""
    effort, known = poor.magnitude[used], poor.prediction[used]
    by_others = columns[:, : len(poor.gradient)] @ (inverse_of(poor.hessian) @ poor.gradient)
    starts = (np.where(value >= 0.0, 1.0, -1.0) for value in (known, -known, by_others))
    rms = min(_alternated(poor, columns, effort, signs) for signs in starts)
    return poor.count * float(np.log(rms)) + 0.5 * columns.shape[1] * float(np.log(poor.count))


def _alternated(poor: PoorJoint, columns: Array, effort: Array, signs: Array) -> float:
    """RMS residual, N m, once coefficients and signs (M,) have been fitted in turn."""
    r = len(poor.gradient)
    hessian = columns.T @ columns / poor.weight**2
    hessian[:r, :r] += poor.hessian
    inverse = inverse_of(hessian)
    for _ in range(_MOST_TURNS):
        gradient = columns.T @ (signs * effort) / poor.weight**2
        gradient[:r] += poor.gradient
        predicted = columns @ (inverse @ gradient)
        nearest = np.where(predicted >= 0.0, 1.0, -1.0)
        if np.array_equal(nearest, signs):
            break
        signs = nearest
    return float(np.sqrt(np.mean((signs * effort - predicted) ** 2)) + np.finfo(float).tiny)
