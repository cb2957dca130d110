"""Effects for joints that the model explains poorly, proposed before their signs are known.

Signs that were found under a poor model suit that model, and so hide what it lacks. So in such a joint every effect is
tried with signs of its own: from several starts, coefficients and signs are fitted in turn until neither changes, the
other joints' efforts holding the coefficients that they share. The effects whose residual is least, for the numbers
that they take, are proposed; a search under each decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array
from bayesid.fit.effects.hypotheses import Hypothesis
from bayesid.fit.effects.relevance import inverse_of
from bayesid.fit.effects.signed_log import SignedLog
from bayesid.model.effects import Effect

_MOST_TURNS = 40
"""Of coefficients and signs; a round number, a fit of 60 coefficients takes some ten."""
_LEAST_GAIN = 3.0
"""Nats by which an effect must do better than none to be proposed: the search that follows takes its time."""


@dataclass(frozen=True)
class _Rows:
    """One joint's samples under an effect.

    Attributes:
        columns: (M, m) of the model, those of the effect last.
        magnitude: (M,) |effort|, N m.
        known: (M,) the effort by the model so far, N m.
    """

    columns: Array
    magnitude: Array
    known: Array


@dataclass(frozen=True)
class PoorJoint:
    """One joint that is explained poorly, the others as they are.

    Attributes:
        log: on thinned rows.
        joint: 0-based.
        weight: sd of the joint's error, N m, its autocorrelation included.
        count: effective samples of the joint.
        hessian: (r, r) of the coefficients, by the other joints.
        gradient: (r,) the same.
    """

    log: SignedLog
    joint: int
    weight: float
    count: float
    hessian: Array
    gradient: Array

    @classmethod
    def of(cls, log: SignedLog, joint: int) -> PoorJoint:
        """A (0-based) joint of a log."""
        data, residual = log.data, log.fit.residual
        time = np.maximum(residual.autocorrelation / (log.evidence.signals.rate / data.rate), 1.0)
        weight = residual.sigma * np.sqrt(time)
        others = [j for j in range(len(weight)) if j != joint]
        columns, effort = data.columns / weight[:, None], data.effort / weight
        rows = columns[:, others].reshape(-1, columns.shape[2])
        return cls(
            log=log,
            joint=joint,
            weight=float(weight[joint]),
            count=float(data.used[:, joint].sum() / time[joint]),
            hessian=rows.T @ rows,
            gradient=rows.T @ effort[:, others].ravel(),
        )

    def rows(self) -> _Rows:
        """Without an effect."""
        used = self.log.data.used[:, self.joint]
        return _Rows(
            columns=self.log.data.columns[used, self.joint],
            magnitude=self.log.evidence.signals.magnitude[self.log.rows, self.joint][used],
            known=self.log.fit.predicted[self.log.rows, self.joint][used],
        )

    def rows_under(self, effect: Hypothesis) -> _Rows:
        """With a term's columns; with columns or readings as a distortion makes them."""
        plain, used = self.rows(), self.log.data.used[:, self.joint]
        if effect.source.linear:
            more = effect.columns.rows[self.joint][used]
            return _Rows(np.concatenate([plain.columns, more], axis=1), plain.magnitude, plain.known)
        evidence = self.log.evidence
        model = evidence.model.extend(effect.source)
        columns = model.columns(evidence.signals.motion[self.log.rows])[used, self.joint]
        magnitude, readable = (x[used, self.joint] for x in model.unread(evidence.signals.magnitude[self.log.rows]))
        columns = columns[:, evidence.coefficients.kept]
        return _Rows(columns[readable], magnitude[readable], plain.known[readable])


def propose(poor: PoorJoint, library: Sequence[Sequence[Hypothesis]]) -> list[Effect]:
    """The effects that explain a joint best, with signs of its own, best first; none where none is worth it.

    Judged by half the fall of the Bayesian information criterion, less the choice of the form.

    Args:
        poor: the joint.
        library: all hypotheses.
    """
    plain = poor.rows()
    if not len(plain.magnitude):
        return []
    rms = _least_rms(poor, plain)
    best: dict[str, tuple[float, Effect]] = {}
    for group in library:
        if group[0].columns.joints != {poor.joint} or (group[0].source.linear and not group[0].columns.rows):
            continue
        choice = float(np.log(len(group)))  # of the form
        for hypothesis in group:
            rows = poor.rows_under(hypothesis)
            readable = len(rows.magnitude) / len(plain.magnitude)  # the other samples are explained as without it
            more = rows.columns.shape[1] - plain.columns.shape[1]
            gain = poor.count * readable * float(np.log(rms / _least_rms(poor, rows)))
            gain -= 0.5 * more * float(np.log(poor.count)) + choice
            if gain > best.get(hypothesis.effect, (_LEAST_GAIN,))[0]:
                best[hypothesis.effect] = gain, hypothesis.source
    return [source for _, source in sorted(best.values(), key=lambda one: -one[0])]


def _least_rms(poor: PoorJoint, rows: _Rows) -> float:
    """What a joint's samples leave at least, N m, from the best of three starts."""
    by_others = rows.columns[:, : len(poor.gradient)] @ (inverse_of(poor.hessian) @ poor.gradient)
    starts = (np.where(value >= 0.0, 1.0, -1.0) for value in (rows.known, -rows.known, by_others))
    return min(_alternated(poor, rows, signs) for signs in starts)


def _alternated(poor: PoorJoint, rows: _Rows, signs: Array) -> float:
    """RMS residual, N m, once coefficients and signs (M,) have been fitted in turn."""
    r, columns = len(poor.gradient), rows.columns
    hessian = columns.T @ columns / poor.weight**2
    hessian[:r, :r] += poor.hessian
    inverse = inverse_of(hessian)
    for _ in range(_MOST_TURNS):
        gradient = columns.T @ (signs * rows.magnitude) / poor.weight**2
        gradient[:r] += poor.gradient
        predicted = columns @ (inverse @ gradient)
        nearest = np.where(predicted >= 0.0, 1.0, -1.0)
        if np.array_equal(nearest, signs):
            break
        signs = nearest
    return float(np.sqrt(np.mean((signs * rows.magnitude - predicted) ** 2)) + np.finfo(float).tiny)
