"""Effects that a model which explains a joint poorly may lack, proposed before signs are known.

Signs that were found under a poor model suit that model, and so hide what it lacks. So every effect is tried with signs
of its own: coefficients and signs are fitted in turn until neither changes. An effect of one joint is tried with the
signs of that joint, the other joints' efforts holding the coefficients that they share; one of the whole robot, and
parameters that may be negative, with the signs of all joints. The effects whose residual is least, for the numbers that
they take, are proposed; a search under each decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects import catalogue
from bayesid.effects.coefficients import base_coefficients
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
    """What a model may lack, with signs under it."""

    effects: tuple[Effect, ...]  # one, or one in each of some joints
    signs: Array  # (N, n) +1 or -1 of all samples; 0 where nothing counts, NaN where a joint's signs stay as they are


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
        data, (weight, time) = log.data, _noise_of(log)
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

    def signs_of(self, rows: _Rows, signs: Array) -> Array:
        """(N, n) signs of all samples, from those of the joint's rows (M,)."""
        thinned = np.full(self.log.data.used.shape, np.nan)
        thinned[:, self.joint] = 0.0
        thinned[rows.place, self.joint] = signs
        return _of_samples(self.log, thinned)

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
        if found is not None and found[0] > best.get(found[1].effects[0].effect, (TUNING.proposal_gain,))[0]:
            best[found[1].effects[0].effect] = found
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
            best = gain, Proposal((hypothesis.source,), poor.signs_of(rows, signs))
    return best


def _alternated(poor: PoorJoint, rows: _Rows) -> tuple[float, Array]:
    """What a joint's samples leave at least, N m, and (M,) their signs then: fitted in turn, from the best of three."""
    r = len(poor.gradient)
    fit = _InTurn(rows.columns / poor.weight, rows.magnitude / poor.weight, poor.hessian, poor.gradient)
    best = np.inf, rows.known
    for start in (rows.known, -rows.known, rows.columns[:, :r] @ (inverse_of(poor.hessian) @ poor.gradient)):
        signs, predicted, _ = fit.from_signs(np.where(start >= 0.0, 1.0, -1.0))
        rms = float(np.sqrt(np.mean((signs * rows.magnitude - poor.weight * predicted) ** 2)) + np.finfo(float).tiny)
        best = min(best, (rms, signs), key=lambda found: found[0])
    return best


class _InTurn:
    """Coefficients and signs, fitted in turn.

    Args:
        columns: (M, m) in units of the noise.
        magnitude: (M,) |effort| in units of the noise.
        hessian: (r, r) what other rows say of the first r coefficients.
        gradient: (r,) the same.
    """

    def __init__(self, columns: Array, magnitude: Array, hessian: Array, gradient: Array) -> None:
        r, m = len(gradient), columns.shape[1]
        whole = columns.T @ columns
        whole[:r, :r] += hessian
        self._inverse, self._others = inverse_of(whole), np.zeros(m)
        self._others[:r] = gradient
        self._columns, self._turning = columns, columns * magnitude[:, None]

    def from_signs(self, signs: Array, fixed: Mask | None = None) -> tuple[Array, Array, Array]:
        """(M,) signs, (M,) predictions and (m,) coefficients, from signs (M,) of which some are fixed (M,)."""
        for _ in range(TUNING.proposal_rounds):
            beta = self._inverse @ (self._others + signs @ self._turning)
            predicted = self._columns @ beta
            nearest = np.where(predicted >= 0.0, 1.0, -1.0)
            nearest = nearest if fixed is None else np.where(fixed, signs, nearest)
            if np.array_equal(nearest, signs):
                break
            signs = nearest
        return signs, predicted, beta


@dataclass(frozen=True)
class _Settled:
    """Signs and coefficients of all joints, fitted in turn."""

    signs: Array  # (N', n) of thinned rows; 0 where nothing counts
    left: Array  # (n,) RMS of what is left, N m
    beta: Array  # (r,) coefficients


@dataclass(frozen=True)
class PoorRobot:
    """All joints of a log, for what acts in several of them."""

    log: SignedLog

    def without_bounds(self) -> Proposal | None:
        """The terms that lift the bounds which a fit without any violates; None if that gains too little.

        Of the two sides of a joint, its signs and all of them turned round, only the bounds of the other parameters of
        the joint tell: the one that keeps them is taken. Joints are turned all at once, as long as the other bounds
        want it, or one by one, if that explains the log about as well; what explains it best counts.
        """
        model, names = self.log.evidence.model, list(self.log.evidence.coefficients.names)
        joints = range(1, model.robot.n_joints + 1)
        lifting = [kind(joints=(j,)) for kind in catalogue.forms().values() if kind.frees for j in joints]
        lifting = [effect for effect in lifting if effect not in model.effects]
        free = {name for effect in lifting for name in effect.freed(model.robot)}
        bounded = [model.parameters[k] for k in model.cone.nonnegative]
        kept = [[names.index(p.name) for p in bounded if p.joint == j and p.name in set(names) - free] for j in joints]
        predicted = self.log.fit.predicted[self.log.rows]
        before = self._rms(np.where(predicted >= 0.0, 1.0, -1.0), predicted)
        begun, best = self._settled(self.log.modelled.columns), None
        for settled in (self._turned_together(begun, kept), self._turned_one_by_one(begun, kept)):
            value = dict(zip(names, settled.beta.tolist(), strict=True))
            needed = [one for one in lifting if all(value.get(name, 0.0) < 0.0 for name in one.freed(model.robot))]
            gain = self._gain(before, settled.left) - 0.5 * len(needed) * float(np.log(self._count.sum()))
            if needed and gain > (TUNING.proposal_gain if best is None else best[0]):
                best = gain, Proposal(tuple(needed), _of_samples(self.log, settled.signs))
        return None if best is None else best[1]

    def _turned_together(self, settled: _Settled, kept: Sequence[list[int]]) -> _Settled:
        for _ in kept:
            if not np.any(turned := self._wrong_sides(settled, kept)):
                break
            settled = self._settled(self.log.modelled.columns, np.where(turned, -settled.signs, settled.signs))
        return settled

    def _turned_one_by_one(self, settled: _Settled, kept: Sequence[list[int]]) -> _Settled:
        for _ in kept:
            before = settled
            for j in range(len(kept)):
                if self._wrong_sides(settled, kept)[j]:
                    signs = np.where(np.arange(len(kept)) == j, -settled.signs, settled.signs)
                    other = self._settled(self.log.modelled.columns, signs)
                    settled = other if self._gain(settled.left, other.left) > -TUNING.proposal_gain else settled
            if settled is before:
                break
        return settled

    def _wrong_sides(self, settled: _Settled, kept: Sequence[list[int]]) -> Mask:
        """(n,) joints of unknown sign whose bounded parameters, the coefficients kept, are negative in sum."""
        columns, beta = np.abs(self.log.modelled.columns), settled.beta
        sides = [np.sum(beta[own] * columns[:, j, own].sum(axis=0)) for j, own in enumerate(kept)]
        return (np.array(sides) < 0.0) & ~self.log.evidence.signals.signed

    def propose(self) -> list[Proposal]:
        """Effects of the whole robot, each in its best guess, best first; none that explains no more than none.

        What their numbers cost is weighed after the search: there are few such effects.
        """
        model, found = self.log.evidence.model, []
        before = self._settled(self.log.modelled.columns).left
        for kind in catalogue.forms().values():
            guesses = [] if kind.name in {one.name for one in model.effects} else list(kind.guesses(model.robot))
            fits = in_parallel([partial(self._settled_with, guess) for guess in guesses])
            gains = [self._gain(before, fit.left) for fit in fits]
            if max(gains, default=0.0) > TUNING.proposal_gain:
                best = int(np.argmax(gains))
                found.append((gains[best], Proposal((guesses[best],), _of_samples(self.log, fits[best].signs))))
        return [proposal for _, proposal in sorted(found, key=lambda one: -one[0])]

    @cached_property
    def _count(self) -> Array:
        count: Array = self.log.data.used.sum(axis=0) / _noise_of(self.log)[1]
        return count

    def _gain(self, before: Array, left: Array) -> float:
        """Nats by which a joint's residual RMS left (n,) is likelier than the one before."""
        return float(self._count @ np.log(before / left))

    def _settled_with(self, effect: Effect) -> _Settled:
        model = self.log.evidence.model.extend(effect)
        return self._settled(model.columns(self.log.modelled.motion)[:, :, base_coefficients(model).kept])

    def _settled(self, columns: Array, begun: Array | None = None) -> _Settled:
        """Under columns (N', n, r), from signs (N', n), by default those of the model's fit."""
        log, used, signals = self.log, self.log.data.used, self.log.evidence.signals
        begun = log.fit.predicted[log.rows] if begun is None else begun
        start = np.where(np.where(signals.signed, signals.raw_effort[log.rows], begun) >= 0.0, 1.0, -1.0)
        weight, r = _noise_of(log)[0], columns.shape[2]
        rows, magnitude = (columns / weight[:, None])[used], (log.modelled.magnitude / weight)[used]
        in_turn = _InTurn(rows, magnitude, np.zeros((r, r)), np.zeros(r))
        signs = np.zeros(used.shape)
        signs[used], _, beta = in_turn.from_signs(start[used], np.broadcast_to(signals.signed, used.shape)[used])
        return _Settled(signs, self._rms(signs, columns @ beta), beta)

    def _rms(self, signs: Array, predicted: Array) -> Array:
        used = self.log.data.used
        residual = np.where(used, signs * self.log.modelled.magnitude - predicted, 0.0)
        rms: Array = np.sqrt((residual**2).sum(axis=0) / np.maximum(used.sum(axis=0), 1)) + np.finfo(float).tiny
        return rms


def _noise_of(log: SignedLog) -> tuple[Array, Array]:
    """(n,) sd of each joint's error, N m, its autocorrelation included; and (n,) that, in thinned rows."""
    residual = log.fit.residual
    time = np.maximum(residual.autocorrelation / (log.evidence.signals.rate / log.data.rate), 1.0)
    return residual.sigma * np.sqrt(time), time


def _of_samples(log: SignedLog, thinned: Array) -> Array:
    """(N, n) signs of all samples from those of thinned rows (N', n): each sample's is that of the nearest row."""
    samples = np.arange(len(log.evidence.signals.motion))
    after = np.clip(np.searchsorted(log.rows, samples), 1, len(log.rows) - 1)
    earlier = samples - log.rows[after - 1] < log.rows[after] - samples
    nearest: Array = thinned[np.where(earlier, after - 1, after)]
    return nearest
