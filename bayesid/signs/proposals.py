"""Proposals: effects that a poorly fitting model may lack, before signs are known.

Signs found under a poor model fit that model, and hide missing effects. So signs are fitted for every effect anew:
coefficients and signs in turn until neither changes. For an effect of one joint these are the joint's signs; the other
joints' efforts give a prior on the common coefficients. For an effect of the whole robot, and for parameters without
bounds, they are the signs of all joints. Effects with the smallest residual, penalised by the number of their
parameters, are proposed. A sign search under each of them decides.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects import catalogue
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.distortion import RobotDistortion, SensorDistortion
from bayesid.effects.effect import Effect
from bayesid.effects.model import Model
from bayesid.log.segments import Segments
from bayesid.parallel import in_parallel
from bayesid.regression.knowledge import inverse_of
from bayesid.regression.noise import times_of
from bayesid.regression.selection.detected import SignedLog
from bayesid.regression.selection.hypotheses import Hypothesis
from bayesid.signs.tuning import TUNING


@dataclass(frozen=True)
class _Rows:
    columns: Array  # (M, m) of the model, then those of the effect
    magnitude: Array  # (M,) |effort|, N m; as read where the sensor hides it
    visible: Mask  # (M,) whether the sensor shows it
    modelled: Array  # (M,) effort of the current model, N m
    place: Integers  # (M,) index among the log's thinned rows
    segment: Integers  # (M,) segment of the last search; -1 if it was not fitted


@dataclass(frozen=True)
class _Residual:
    rows: _Rows
    signs: Array  # (M,)
    residual: Array  # (M,) N m

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(self.residual**2)) + np.finfo(float).tiny)


@dataclass(frozen=True)
class Proposal:
    """Effects that a model may lack, and signs under them."""

    effects: tuple[Effect, ...]  # one effect, or one in each of some joints
    signs: Array  # (N, n) +1 or -1 of all samples; 0 for unused samples, NaN where a joint's signs do not change


@dataclass(frozen=True)
class PoorJoint:
    """A poorly explained joint; the other joints are fixed."""

    log: SignedLog
    joint: int  # 0-based
    segment: Integers  # (N', n) of the thinned rows; -1 if the last search did not fit them
    weight: float  # sd of the joint's error, N m, its autocorrelation included
    time: float  # autocorrelation time of the joint's error, thinned rows
    hessian: Array  # (r, r) of the coefficients, from the other joints
    gradient: Array  # (r,) the same

    @classmethod
    def of(cls, log: SignedLog, segments: Segments, joint: int) -> PoorJoint:
        """A (0-based) joint of a log whose segments were searched."""
        data, (weight, time) = log.data, _noise_of(log)
        others = [j for j in range(len(weight)) if j != joint]
        columns, effort = data.columns / weight[:, None], data.effort / weight
        rows = columns[:, others].reshape(-1, columns.shape[2])
        return cls(
            log=log,
            joint=joint,
            segment=_segment_of(log, segments),
            weight=float(weight[joint]),
            time=float(time[joint]),
            hessian=rows.T @ rows,
            gradient=rows.T @ effort[:, others].ravel(),
        )

    def rows(self) -> _Rows:
        """Rows without an effect."""
        used = self.log.data.used[:, self.joint]
        return _Rows(
            columns=self.log.data.columns[used, self.joint],
            magnitude=self.log.modelled.magnitude[:, self.joint][used],
            visible=np.ones(int(used.sum()), dtype=bool),
            modelled=self.log.fit.predicted[self.log.rows, self.joint][used],
            place=np.flatnonzero(used),
            segment=self.segment[used, self.joint],
        )

    def signs_of(self, rows: _Rows, signs: Array) -> Array:
        """(N, n) signs of all samples, from those of the joint's rows (M,)."""
        thinned = np.full(self.log.data.used.shape, np.nan)
        thinned[:, self.joint] = 0.0
        thinned[rows.place, self.joint] = signs
        return _of_samples(self.log, thinned)

    def rows_under(self, effect: Hypothesis) -> _Rows:
        """With a term's columns, or with columns and readings changed by a distortion."""
        plain, used = self.rows(), self.log.data.used[:, self.joint]
        if effect.source.linear:
            more = effect.columns.rows[self.joint][used]
            return replace(plain, columns=np.concatenate([plain.columns, more], axis=1))
        log_data = self.log.log_data
        model = log_data.model.extend(effect.source)
        columns = model.columns(self.log.modelled.motion)[used, self.joint]
        magnitude, visible = (x[used, self.joint] for x in model.invert_sensor(self.log.modelled.magnitude))
        magnitude = np.where(visible, magnitude, plain.magnitude)
        return replace(plain, columns=columns[:, log_data.coefficients.selected], magnitude=magnitude, visible=visible)

    def residual_of(self, rows: _Rows, signs: Array, predicted: Array, sensor: SensorDistortion | None) -> _Residual:
        """Residual of signs and predictions (M,), N m; where a sensor hides the effort, the reading is compared."""
        residual = signs * rows.magnitude - predicted
        if sensor is not None and not np.all(rows.visible):
            effort = np.zeros(self.log.data.used.shape)
            effort[rows.place, self.joint] = predicted
            read = np.abs(sensor.measured(effort)[rows.place, self.joint])
            residual = np.where(rows.visible, residual, rows.magnitude - read)
        return _Residual(rows, signs, residual)

    def effective(self, fit: _Residual) -> float:
        """Effective samples of the joint, by the shorter autocorrelation time of this residual and the one before."""
        used = self.log.data.used[:, [self.joint]]
        residual = np.zeros(used.shape)
        residual[fit.rows.place, 0] = fit.residual
        return len(fit.residual) / max(min(float(times_of(residual, used, self.log.data.rate)[0]), self.time), 1.0)


def propose(poor: PoorJoint, library: Sequence[Sequence[Hypothesis]]) -> list[Proposal]:
    """The best effects for a joint, each with its own signs, best first; empty if none gains enough.

    The gain is half the fall of the Bayesian information criterion, minus the log of the number of forms.
    """
    plain = poor.rows()
    if not len(plain.magnitude):
        return []
    groups = [group for group in library if group[0].columns.joints == {poor.joint}]
    groups = [group for group in groups if not group[0].source.linear or group[0].columns.rows]
    without = _alternated(poor, plain)
    best: dict[str, tuple[float, Proposal]] = {}
    for found in in_parallel([partial(_best_form, poor, without, group) for group in groups]):
        if found is not None and found[0] > best.get(found[1].effects[0].effect, (TUNING.proposal_gain,))[0]:
            best[found[1].effects[0].effect] = found
    return [proposal for _, proposal in sorted(best.values(), key=lambda gain_and_proposal: -gain_and_proposal[0])]


def _best_form(poor: PoorJoint, without: _Residual, group: Sequence[Hypothesis]) -> tuple[float, Proposal] | None:
    """The form of the largest gain, in nats, minus the log of the number of forms; None for an empty group."""
    fits = []
    for hypothesis in group:
        sensor = hypothesis.source if isinstance(hypothesis.source, SensorDistortion) else None
        fits.append(_alternated(poor, poor.rows_under(hypothesis), sensor))
    if not fits:
        return None
    best = min(range(len(fits)), key=lambda k: fits[k].rms)
    fit, count = fits[best], poor.effective(fits[best])
    more = fit.rows.columns.shape[1] - without.rows.columns.shape[1]
    gain = count * float(np.log(without.rms / fit.rms)) - 0.5 * more * float(np.log(count)) - float(np.log(len(group)))
    return gain, Proposal((group[best].source,), poor.signs_of(fit.rows, fit.signs))


def _alternated(poor: PoorJoint, rows: _Rows, sensor: SensorDistortion | None = None) -> _Residual:
    """The fit of least residual to a joint: coefficients and signs in turn, from the best of four starts."""
    r, visible = len(poor.gradient), rows.visible
    columns, magnitude = rows.columns[visible] / poor.weight, rows.magnitude[visible] / poor.weight
    fit = AlternatingFit(columns, magnitude, poor.hessian, poor.gradient)
    by_others = rows.columns[visible, :r] @ (inverse_of(poor.hessian) @ poor.gradient)
    modelled, segment = rows.modelled[visible], rows.segment[visible]
    starts = [np.where(start >= 0.0, 1.0, -1.0) for start in (modelled, -modelled, by_others)]
    best = None
    for start in (*starts, fit.flipped(starts[0], segment, segment >= 0)):
        found, _, beta = fit.from_signs(start)
        predicted = rows.columns @ beta
        signs = np.where(predicted >= 0.0, 1.0, -1.0)
        signs[visible] = found
        residual = poor.residual_of(rows, signs, predicted, sensor)
        best = residual if best is None or residual.rms < best.rms else best
    assert best is not None  # there are starts
    return best


class AlternatingFit:
    """Unbounded coefficients and signs, fitted in turn.

    Args:
        columns: (M, m) in units of the noise.
        magnitude: (M,) |effort| in units of the noise.
        hessian: (r, r) information of other rows on the first r coefficients.
        gradient: (r,) the same.
    """

    def __init__(self, columns: Array, magnitude: Array, hessian: Array, gradient: Array) -> None:
        r, m = len(gradient), columns.shape[1]
        whole = columns.T @ columns
        whole[:r, :r] += hessian
        self._inverse, self._others = inverse_of(whole), np.zeros(m)
        self._others[:r] = gradient
        self._columns, self._gradients = columns, columns * magnitude[:, None]

    def from_signs(self, signs: Array, fixed: Mask | None = None) -> tuple[Array, Array, Array]:
        """(M,) signs, (M,) predictions and (m,) coefficients, from signs (M,) of which some are fixed (M,)."""
        for _ in range(TUNING.proposal_rounds):
            beta = self._inverse @ (self._others + signs @ self._gradients)
            predicted = self._columns @ beta
            nearest = np.where(predicted >= 0.0, 1.0, -1.0)
            nearest = nearest if fixed is None else np.where(fixed, signs, nearest)
            if np.array_equal(nearest, signs):
                break
            signs = nearest
        return signs, predicted, beta

    def flipped(self, signs: Array, segment: Integers, doubted: Mask) -> Array:
        """(M,) better signs: whole segments are flipped one by one while the cost falls.

        Signs of segments are a binary quadratic problem, and the search ends in a local optimum. So it starts from many
        random signs of the doubtful segments. Rows of segment -1 (M,) do not change.

        Args:
            signs: (M,) first signs.
            segment: (M,) segment of each row.
            doubted: (M,) whether the row's segment starts with random signs; the others start with theirs.
        """
        names, place = np.unique(segment, return_inverse=True)
        gradients = np.zeros((len(names), len(self._others)))
        np.add.at(gradients, place, signs[:, None] * self._gradients)
        fixed, gradients = gradients[names < 0].sum(axis=0), gradients[names >= 0]
        if not len(gradients):
            return signs
        quadratic = gradients @ self._inverse @ gradients.T
        linear, diagonal = gradients @ (self._inverse @ (self._others + fixed)), np.diag(quadratic)
        random = np.isin(names[names >= 0], segment[doubted])
        flipped = np.random.default_rng(0).choice([-1.0, 1.0], size=(TUNING.sign_starts, len(gradients)))
        flipped[:, ~random], flipped[0] = 1.0, 1.0
        slope, going = flipped @ quadratic + linear, np.arange(len(flipped))
        while len(going):
            gain = diagonal - flipped[going] * slope[going]
            best = np.argmax(gain, axis=1)
            improves = gain[np.arange(len(going)), best] > TUNING.least_flip_gain
            going, best = going[improves], best[improves]
            flipped[going, best] *= -1.0
            slope[going] += 2.0 * flipped[going, best][:, None] * quadratic[best]
        least = flipped[np.argmax(np.sum(flipped * (slope + linear), axis=1))]
        of_names = np.ones(len(names))
        of_names[names >= 0] = least
        return signs * of_names[place]


@dataclass(frozen=True)
class _SignFit:
    signs: Array  # (N', n) of thinned rows; 0 for unused rows
    rms: Array  # (n,) RMS residual, N m
    beta: Array  # (r,) coefficients


@dataclass(frozen=True)
class _Form:
    columns: Array  # (N', n, r)
    names: list[str]  # of the r coefficients
    bounded: list[list[int]]  # of each joint, the coefficients with a bound


@dataclass(frozen=True)
class PoorRobot:
    """All joints of a log, for effects in several joints."""

    log: SignedLog
    segments: Segments  # of the last search
    poor: Mask  # (n,) joints with a poor fit

    def without_bounds(self) -> Proposal | None:
        """Lifts the bounds that an unbounded fit violates; None if that gains too little.

        Without bounds a joint's signs and their flip have equal cost; the remaining bounds decide. Joints that violate
        them are flipped together, and in a second trial one by one if the fit is about as good. The better trial is
        used.
        """
        model = self.log.log_data.model
        joints = range(1, model.robot.n_joints + 1)
        lifting = [kind(joints=(j,)) for kind in catalogue.forms().values() if kind.frees for j in joints]
        lifting = [effect for effect in lifting if effect not in model.effects]
        form = self._form(model, {name for effect in lifting for name in effect.freed(model.robot)})
        predicted = self.log.fit.predicted[self.log.rows]
        before = self._rms(np.where(predicted >= 0.0, 1.0, -1.0), predicted)
        first, best = self._fit_from(form, predicted), None
        for fit in (self._flipped_together(form, first), self._flipped_one_by_one(form, first)):
            value = dict(zip(form.names, fit.beta.tolist(), strict=True))
            needed = [
                effect for effect in lifting if all(value.get(name, 0.0) < 0.0 for name in effect.freed(model.robot))
            ]
            gain = self._gain(before, fit.rms) - 0.5 * len(needed) * float(np.log(self._count.sum()))
            if needed and gain > (TUNING.proposal_gain if best is None else best[0]):
                best = gain, Proposal(tuple(needed), _of_samples(self.log, fit.signs))
        return None if best is None else best[1]

    def propose(self) -> list[Proposal]:
        """Effects of the whole robot that improve the fit, each with its best guess, best first.

        The number of parameters is penalised after the search, as there are few such effects.
        """
        model, found = self.log.log_data.model, []
        before = self._fit_under(model).rms
        for kind in catalogue.forms().values():
            guesses = [] if kind.name in {effect.name for effect in model.effects} else list(kind.guesses(model.robot))
            fits = in_parallel([partial(self._fit_under, model.extend(guess)) for guess in guesses])
            gains = [self._gain(before, fit.rms) for fit in fits]
            if not guesses:
                continue
            best = int(np.argmax(gains))
            effect, fit = self._sharpened(guesses[best], fits[best])
            if (gain := self._gain(before, fit.rms)) > TUNING.proposal_gain:
                found.append((gain, Proposal((effect,), _of_samples(self.log, fit.signs))))
        return [proposal for _, proposal in sorted(found, key=lambda gain_and_proposal: -gain_and_proposal[0])]

    def _fit_under(self, model: Model) -> _SignFit:
        """From the current signs, and from the best ones of all segments of poorly explained joints."""
        form, predicted = self._form(model), self.log.fit.predicted[self.log.rows]
        fit = self._fit_from(form, predicted)
        other = self._fit_from(form, self._segments_flipped(form, fit))
        return self._flipped_one_by_one(form, other if self._gain(fit.rms, other.rms) > 0.0 else fit)

    def _sharpened(self, effect: Effect, fit: _SignFit) -> tuple[Effect, _SignFit]:
        """An effect with its numbers optimised under the signs of its guess, by Gauss-Newton, and the new signs."""
        if not isinstance(effect, RobotDistortion):
            return effect, fit
        model, used = self.log.log_data.model, self.log.data.used
        weight, magnitude = _noise_of(self.log)[0], self.log.modelled.magnitude
        count = sum(len(getattr(effect, key)) for key, number in effect.number_fields().items() if number.tuned)
        for _ in range(TUNING.sharpened_rounds):
            form, steps = self._form(model.extend(effect)), effect.step * np.eye(count)
            moved = [self._form(model.extend(effect.moved(step))) for step in steps]
            if any(other.names != form.names for other in moved) or len(form.names) != len(fit.beta):
                break  # numbers at which other coefficients are identifiable
            slopes = [(there.columns - form.columns) @ fit.beta / effect.step for there in moved]
            columns = np.concatenate([form.columns, np.stack(slopes, axis=2)], axis=2) / weight[:, None]
            rows, target = columns[used], (fit.signs * magnitude / weight)[used]
            best = inverse_of(rows.T @ rows) @ (rows.T @ target)
            better = effect.moved(best[-len(steps) :])
            other = self._fit_from(self._form(model.extend(better)), fit.signs)
            if self._gain(fit.rms, other.rms) <= 0.0:
                break
            effect, fit = better, other
        return effect, fit

    def _flipped_together(self, form: _Form, fit: _SignFit) -> _SignFit:
        for _ in form.bounded:
            if not np.any(flipped := self._wrong_sides(form, fit)):
                break
            fit = self._fit_from(form, np.where(flipped, -fit.signs, fit.signs))
        return fit

    def _flipped_one_by_one(self, form: _Form, fit: _SignFit) -> _SignFit:
        for _ in form.bounded:
            before = fit
            for j in range(len(form.bounded)):
                if self._wrong_sides(form, fit)[j]:
                    signs = np.where(np.arange(len(form.bounded)) == j, -fit.signs, fit.signs)
                    other = self._fit_from(form, signs)
                    fit = other if self._gain(fit.rms, other.rms) > -TUNING.proposal_gain else fit
            if fit is before:
                break
        return fit

    def _wrong_sides(self, form: _Form, fit: _SignFit) -> Mask:
        """(n,) unsigned joints whose bounded parameters have a negative sum."""
        columns, beta = np.abs(form.columns), fit.beta
        sides = [np.sum(beta[indices] * columns[:, j, indices].sum(axis=0)) for j, indices in enumerate(form.bounded)]
        return (np.array(sides) < 0.0) & ~self.log.log_data.signals.signed

    def _form(self, model: Model, free: Set[str] = frozenset()) -> _Form:
        coefficients, joints = base_coefficients(model), range(1, model.robot.n_joints + 1)
        names = list(coefficients.names)
        bounded = [model.parameters[k] for k in model.cone.nonnegative]
        kept = [[names.index(p.name) for p in bounded if p.joint == j and p.name in set(names) - free] for j in joints]
        return _Form(model.columns(self.log.modelled.motion)[:, :, coefficients.selected], names, kept)

    @cached_property
    def _count(self) -> Array:
        count: Array = self.log.data.used.sum(axis=0) / _noise_of(self.log)[1]
        return count

    def _gain(self, before: Array, after: Array) -> float:
        """Gain in log-likelihood, nats, from the joints' residual RMS `before` (n,) to `after` (n,)."""
        return float(self._count @ np.log(before / after))

    def _fit_from(self, form: _Form, predicted: Array) -> _SignFit:
        """Coefficients and signs in turn, from the signs of predictions (N', n)."""
        used, signals = self.log.data.used, self.log.log_data.signals
        start = np.where(np.where(signals.signed, signals.raw_effort[self.log.rows], predicted) >= 0.0, 1.0, -1.0)
        signs = np.zeros(used.shape)
        known = np.broadcast_to(signals.signed, used.shape)[used]
        signs[used], _, beta = self._alternating_fit(form).from_signs(start[used], known)
        return _SignFit(signs, self._rms(signs, form.columns @ beta), beta)

    def _segments_flipped(self, form: _Form, fit: _SignFit) -> Array:
        """(N', n) the best signs of whole segments; those of poorly explained joints start at random."""
        used, signals = self.log.data.used, self.log.log_data.signals
        segment = np.where(signals.signed, -1, _segment_of(self.log, self.segments))
        doubted = np.broadcast_to(self.poor, used.shape)
        signs = fit.signs.copy()
        signs[used] = self._alternating_fit(form).flipped(signs[used], segment[used], doubted[used])
        return signs

    def _alternating_fit(self, form: _Form) -> AlternatingFit:
        used, weight, r = self.log.data.used, _noise_of(self.log)[0], form.columns.shape[2]
        rows, magnitude = (form.columns / weight[:, None])[used], (self.log.modelled.magnitude / weight)[used]
        return AlternatingFit(rows, magnitude, np.zeros((r, r)), np.zeros(r))

    def _rms(self, signs: Array, predicted: Array) -> Array:
        used = self.log.data.used
        residual = np.where(used, signs * self.log.modelled.magnitude - predicted, 0.0)
        rms: Array = np.sqrt((residual**2).sum(axis=0) / np.maximum(used.sum(axis=0), 1)) + np.finfo(float).tiny
        return rms


def _noise_of(log: SignedLog) -> tuple[Array, Array]:
    """(n,) sd of each joint's error, N m, with autocorrelation; and (n,) the autocorrelation time, thinned rows."""
    log_data, predicted = log.log_data, log.fit.predicted
    time = times_of(log_data.signals.nearest(predicted) - predicted, log_data.used, log_data.signals.rate)
    time = np.maximum(time / (log_data.signals.rate / log.data.rate), 1.0)
    return log.fit.residual.sigma * np.sqrt(time), time


def _segment_of(log: SignedLog, segments: Segments) -> Integers:
    """(N', n) segments of the thinned rows; -1 if not fitted."""
    fitted = segments[segments.fitted]
    numbered = fitted.per_sample(np.arange(1, len(fitted) + 1), *log.log_data.used.shape)
    return numbered[log.rows].astype(np.int64) - 1


def _of_samples(log: SignedLog, thinned: Array) -> Array:
    """(N, n) signs of all samples from thinned rows (N', n): that of the nearest row."""
    samples = np.arange(len(log.log_data.signals.motion))
    after = np.clip(np.searchsorted(log.rows, samples), 1, len(log.rows) - 1)
    earlier = samples - log.rows[after - 1] < log.rows[after] - samples
    nearest: Array = thinned[np.where(earlier, after - 1, after)]
    return nearest
