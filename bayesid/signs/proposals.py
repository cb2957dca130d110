"""Effects for joints that the model explains poorly, proposed before their signs are known.

Signs that were found under a poor model suit that model, and so hide what it lacks. So in such a joint every effect is
tried with signs of its own: from several starts, coefficients and signs are fitted in turn until neither changes, the
other joints' efforts holding the coefficients that they share. The effects whose residual is least, for the numbers
that they take, are proposed; a search under each decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.effects.effect import Effect
from bayesid.parallel import in_parallel
from bayesid.regression.knowledge import inverse_of
from bayesid.regression.selection.hypotheses import Hypothesis
from bayesid.regression.selection.wanted import SignedLog
from bayesid.signs.tuning import TUNING


@dataclass(frozen=True)
class _Rows:
    columns: Array  # (M, m) of the model, those of the effect last
    magnitude: Array  # (M,) |effort|, N m
    known: Array  # (M,) the effort by the model so far, N m
    place: Integers  # (M,) which of the log's thinned rows they are


@dataclass(frozen=True)
class Proposal:
    """An effect for a joint."""

    effect: Effect  # term or distortion
    signs: Array  # (N,) +1 or -1 of the joint's samples under it; 0 where nothing counts


@dataclass(frozen=True)
class PoorJoint:
    """One joint that is explained poorly, the others as they are."""

    log: SignedLog
    joint: int  # 0-based
    weight: float  # sd of the joint's error, N m, its autocorrelation included
    count: float  # effective samples of the joint
    hessian: Array  # (r, r) of the coefficients, by the other joints
    gradient: Array  # (r,) the same

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
            magnitude=self.log.modelled.magnitude[:, self.joint][used],
            known=self.log.fit.predicted[self.log.rows, self.joint][used],
            place=np.flatnonzero(used),
        )

    def of_samples(self, rows: _Rows, signs: Array) -> Array:
        """(N,) signs of all samples from those of rows (M,): each sample's is that of the nearest thinned row."""
        thinned = np.zeros(len(self.log.rows))
        thinned[rows.place] = signs
        samples = np.arange(len(self.log.evidence.signals.motion))
        after = np.clip(np.searchsorted(self.log.rows, samples), 1, len(self.log.rows) - 1)
        earlier = samples - self.log.rows[after - 1] < self.log.rows[after] - samples
        nearest: Array = thinned[np.where(earlier, after - 1, after)]
        return nearest

    def rows_under(self, effect: Hypothesis) -> _Rows:
        """With a term's columns; with columns or readings as a distortion makes them."""
        plain, used = self.rows(), self.log.data.used[:, self.joint]
        if effect.source.linear:
            more = effect.columns.rows[self.joint][used]
            return replace(plain, columns=np.concatenate([plain.columns, more], axis=1))
        evidence = self.log.evidence
        model = evidence.model.extend(effect.source)
        columns = model.columns(self.log.modelled.motion)[used, self.joint]
        magnitude, readable = (x[used, self.joint] for x in model.unread(self.log.modelled.magnitude))
        columns = columns[:, evidence.coefficients.kept]
        return _Rows(columns[readable], magnitude[readable], plain.known[readable], plain.place[readable])


def propose(poor: PoorJoint, library: Sequence[Sequence[Hypothesis]]) -> list[Proposal]:
    """The effects that explain a joint best, with signs of its own, best first; none where none is worth it.

    Judged by half the fall of the Bayesian information criterion, less the choice of the form.
    """
    plain = poor.rows()
    if not len(plain.magnitude):
        return []
    groups = [group for group in library if group[0].columns.joints == {poor.joint}]
    groups = [group for group in groups if not group[0].source.linear or group[0].columns.rows]
    rms = _alternated(poor, plain)[0]
    best: dict[str, tuple[float, Proposal]] = {}
    for found in in_parallel([partial(_best_form, poor, plain, rms, group) for group in groups]):
        if found is not None and found[0] > best.get(found[1].effect.effect, (TUNING.proposal_gain,))[0]:
            best[found[1].effect.effect] = found
    return [proposal for _, proposal in sorted(best.values(), key=lambda one: -one[0])]


def _best_form(poor: PoorJoint, plain: _Rows, rms: float, group: Sequence[Hypothesis]) -> tuple[float, Proposal] | None:
    """The form of an effect that gains most, in nats, less the choice of the form; None of an empty group.

    Without the effect the joint's rows `plain` leave `rms`, N m.
    """
    best = None
    for hypothesis in group:
        rows = poor.rows_under(hypothesis)
        readable = len(rows.magnitude) / len(plain.magnitude)  # the other samples are explained as without it
        least, signs = _alternated(poor, rows)
        gain = poor.count * readable * float(np.log(rms / least))
        gain -= 0.5 * (rows.columns.shape[1] - plain.columns.shape[1]) * float(np.log(poor.count))
        gain -= float(np.log(len(group)))
        if best is None or gain > best[0]:
            best = gain, Proposal(hypothesis.source, poor.of_samples(rows, signs))
    return best


def _alternated(poor: PoorJoint, rows: _Rows) -> tuple[float, Array]:
    """What a joint's samples leave at least, N m, and (M,) their signs then: fitted in turn, from the best of three."""
    r, columns = len(poor.gradient), rows.columns
    hessian = columns.T @ columns / poor.weight**2
    hessian[:r, :r] += poor.hessian
    inverse = inverse_of(hessian)
    others = np.zeros(columns.shape[1])
    others[:r] = poor.gradient
    reach = columns @ inverse  # (M, m) what a unit of the gradient adds to each prediction
    base, turning = reach @ others, columns * rows.magnitude[:, None] / poor.weight**2
    best = np.inf, rows.known
    for start in (rows.known, -rows.known, columns[:, :r] @ (inverse_of(poor.hessian) @ poor.gradient)):
        signs = np.where(start >= 0.0, 1.0, -1.0)
        for _ in range(TUNING.proposal_rounds):
            predicted = base + reach @ (signs @ turning)
            nearest = np.where(predicted >= 0.0, 1.0, -1.0)
            if np.array_equal(nearest, signs):
                break
            signs = nearest
        rms = float(np.sqrt(np.mean((signs * rows.magnitude - predicted) ** 2)) + np.finfo(float).tiny)
        best = min(best, (rms, signs), key=lambda found: found[0])
    return best
