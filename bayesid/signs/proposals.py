"""Effects that a model which explains a joint poorly may lack, proposed before signs are known.

Signs that were found under a poor model suit that model, and so hide what it lacks. So every effect is tried with signs
of its own: coefficients and signs are fitted in turn until neither changes. An effect of one joint is tried with the
signs of that joint, the other joints' efforts holding the coefficients that they share; one of the whole robot, and
parameters that may be negative, with the signs of all joints. The effects whose residual is least, for the numbers that
they take, are proposed; a search under each decides.
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
    columns: Array  # (M, m) of the model, those of the effect last
    magnitude: Array  # (M,) |effort|, N m; what a sensor hides, as it was read
    shown: Mask  # (M,) whether the sensor shows it
    known: Array  # (M,) the effort by the model so far, N m
    place: Integers  # (M,) which of the log's thinned rows they are
    segment: Integers  # (M,) of the search so far; -1 where it fitted none


@dataclass(frozen=True)
class _Left:
    """What a fit leaves of a joint's efforts."""

    rows: _Rows
    signs: Array  # (M,)
    residual: Array  # (M,) N m

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(self.residual**2)) + np.finfo(float).tiny)


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
    segment: Integers  # (N', n) of the thinned rows; -1 where the search so far fitted none
    weight: float  # sd of the joint's error, N m, its autocorrelation included
    time: float  # autocorrelation time of the joint's error, thinned rows
    hessian: Array  # (r, r) of the coefficients, by the other joints
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
        """Without an effect."""
        used = self.log.data.used[:, self.joint]
        return _Rows(
            columns=self.log.data.columns[used, self.joint],
            magnitude=self.log.modelled.magnitude[:, self.joint][used],
            shown=np.ones(int(used.sum()), dtype=bool),
            known=self.log.fit.predicted[self.log.rows, self.joint][used],
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
        """With a term's columns; with columns or readings as a distortion makes them."""
        plain, used = self.rows(), self.log.data.used[:, self.joint]
        if effect.source.linear:
            more = effect.columns.rows[self.joint][used]
            return replace(plain, columns=np.concatenate([plain.columns, more], axis=1))
        log_data = self.log.log_data
        model = log_data.model.extend(effect.source)
        columns = model.columns(self.log.modelled.motion)[used, self.joint]
        magnitude, shown = (x[used, self.joint] for x in model.invert_sensor(self.log.modelled.magnitude))
        magnitude = np.where(shown, magnitude, plain.magnitude)
        return replace(plain, columns=columns[:, log_data.coefficients.selected], magnitude=magnitude, shown=shown)

    def left(self, rows: _Rows, signs: Array, predicted: Array, sensor: SensorDistortion | None) -> _Left:
        """Of signs and predictions (M,), N m: what a sensor hides answers for what is read of it."""
        residual = signs * rows.magnitude - predicted
        if sensor is not None and not np.all(rows.shown):
            effort = np.zeros(self.log.data.used.shape)
            effort[rows.place, self.joint] = predicted
            read = np.abs(sensor.measured(effort)[rows.place, self.joint])
            residual = np.where(rows.shown, residual, rows.magnitude - read)
        return _Left(rows, signs, residual)

    def effective(self, left: _Left) -> float:
        """Samples of the joint that count, by the shorter autocorrelation time of what is left and of before."""
        used = self.log.data.used[:, [self.joint]]
        residual = np.zeros(used.shape)
        residual[left.rows.place, 0] = left.residual
        return len(left.residual) / max(min(float(times_of(residual, used, self.log.data.rate)[0]), self.time), 1.0)


def propose(poor: PoorJoint, library: Sequence[Sequence[Hypothesis]]) -> list[Proposal]:
    """The effects that explain a joint best, with signs of its own, best first; none where none is worth it.

    Judged by half the fall of the Bayesian information criterion, less the choice of the form.
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
    return [proposal for _, proposal in sorted(best.values(), key=lambda one: -one[0])]


def _best_form(poor: PoorJoint, without: _Left, group: Sequence[Hypothesis]) -> tuple[float, Proposal] | None:
    """The form of an effect that gains most, in nats, less the choice of the form; None of an empty group."""
    fits = []
    for hypothesis in group:
        sensor = hypothesis.source if isinstance(hypothesis.source, SensorDistortion) else None
        fits.append(_alternated(poor, poor.rows_under(hypothesis), sensor))
    if not fits:
        return None
    best = min(range(len(fits)), key=lambda k: fits[k].rms)
    left, count = fits[best], poor.effective(fits[best])
    more = left.rows.columns.shape[1] - without.rows.columns.shape[1]
    gain = count * float(np.log(without.rms / left.rms)) - 0.5 * more * float(np.log(count)) - float(np.log(len(group)))
    return gain, Proposal((group[best].source,), poor.signs_of(left.rows, left.signs))


def _alternated(poor: PoorJoint, rows: _Rows, sensor: SensorDistortion | None = None) -> _Left:
    """The fit that leaves least of a joint's samples: coefficients and signs in turn, from the best of four starts."""
    r, shown = len(poor.gradient), rows.shown
    columns, magnitude = rows.columns[shown] / poor.weight, rows.magnitude[shown] / poor.weight
    fit = InTurn(columns, magnitude, poor.hessian, poor.gradient)
    by_others = rows.columns[shown, :r] @ (inverse_of(poor.hessian) @ poor.gradient)
    known, segment = rows.known[shown], rows.segment[shown]
    starts = [np.where(start >= 0.0, 1.0, -1.0) for start in (known, -known, by_others)]
    best = None
    for start in (*starts, fit.flipped(starts[0], segment, segment >= 0)):
        found, _, beta = fit.from_signs(start)
        predicted = rows.columns @ beta
        signs = np.where(predicted >= 0.0, 1.0, -1.0)
        signs[shown] = found
        left = poor.left(rows, signs, predicted, sensor)
        best = left if best is None or left.rms < best.rms else best
    assert best is not None  # there are starts
    return best


class InTurn:
    """Coefficients without bounds and signs, fitted in turn.

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

    def flipped(self, signs: Array, segment: Integers, doubted: Mask) -> Array:
        """(M,) signs whose segments cost least: whole segments are turned one by one while the cost falls.

        Signs of segments are a binary quadratic problem (DESIGN.md 3); such a search ends in a local optimum, so it
        begins from many random signs of the segments in doubt. Rows of segment -1 (M,) stay as they are.

        Args:
            signs: (M,) to begin with.
            segment: (M,) which segment each row is of.
            doubted: (M,) whether the row's segment may have any sign; others may turn, but begin as they are.
        """
        names, place = np.unique(segment, return_inverse=True)
        turning = np.zeros((len(names), len(self._others)))
        np.add.at(turning, place, signs[:, None] * self._turning)
        fixed, turning = turning[names < 0].sum(axis=0), turning[names >= 0]
        if not len(turning):
            return signs
        quadratic = turning @ self._inverse @ turning.T
        linear, own = turning @ (self._inverse @ (self._others + fixed)), np.diag(quadratic)
        random = np.isin(names[names >= 0], segment[doubted])
        flipped = np.random.default_rng(0).choice([-1.0, 1.0], size=(TUNING.sign_starts, len(turning)))
        flipped[:, ~random], flipped[0] = 1.0, 1.0
        pull, going = flipped @ quadratic + linear, np.arange(len(flipped))
        while len(going):
            gain = own - flipped[going] * pull[going]
            best = np.argmax(gain, axis=1)
            worth = gain[np.arange(len(going)), best] > TUNING.least_turn
            going, best = going[worth], best[worth]
            flipped[going, best] *= -1.0
            pull[going] += 2.0 * flipped[going, best][:, None] * quadratic[best]
        least = flipped[np.argmax(np.sum(flipped * (pull + linear), axis=1))]
        of_names = np.ones(len(names))
        of_names[names >= 0] = least
        return signs * of_names[place]


@dataclass(frozen=True)
class _Settled:
    """Signs and coefficients of all joints, fitted in turn."""

    signs: Array  # (N', n) of thinned rows; 0 where nothing counts
    left: Array  # (n,) RMS of what is left, N m
    beta: Array  # (r,) coefficients


@dataclass(frozen=True)
class _Form:
    """A model of the whole robot, on thinned rows."""

    columns: Array  # (N', n, r)
    names: list[str]  # of the r coefficients
    bounded: list[list[int]]  # of each joint, the coefficients that a bound holds


@dataclass(frozen=True)
class PoorRobot:
    """All joints of a log, for what acts in several of them."""

    log: SignedLog
    segments: Segments  # that were searched
    poor: Mask  # (n,) joints that are explained poorly

    def without_bounds(self) -> Proposal | None:
        """The terms that lift the bounds which a fit without any violates; None if that gains too little.

        Of the two sides of a joint, its signs and all of them turned round, only the bounds of the other parameters of
        the joint tell: the one that keeps them is taken. Joints are turned all at once, as long as the other bounds
        want it, or one by one, if that explains the log about as well; what explains it best counts.
        """
        model = self.log.log_data.model
        joints = range(1, model.robot.n_joints + 1)
        lifting = [kind(joints=(j,)) for kind in catalogue.forms().values() if kind.frees for j in joints]
        lifting = [effect for effect in lifting if effect not in model.effects]
        form = self._form(model, {name for effect in lifting for name in effect.freed(model.robot)})
        predicted = self.log.fit.predicted[self.log.rows]
        before = self._rms(np.where(predicted >= 0.0, 1.0, -1.0), predicted)
        begun, best = self._settled(form, predicted), None
        for sign_solution in (self._turned_together(form, begun), self._turned_one_by_one(form, begun)):
            value = dict(zip(form.names, sign_solution.beta.tolist(), strict=True))
            needed = [one for one in lifting if all(value.get(name, 0.0) < 0.0 for name in one.freed(model.robot))]
            gain = self._gain(before, sign_solution.left) - 0.5 * len(needed) * float(np.log(self._count.sum()))
            if needed and gain > (TUNING.proposal_gain if best is None else best[0]):
                best = gain, Proposal(tuple(needed), _of_samples(self.log, sign_solution.signs))
        return None if best is None else best[1]

    def propose(self) -> list[Proposal]:
        """Effects of the whole robot, each in its best guess, best first; none that explains no more than none.

        What their numbers cost is weighed after the search: there are few such effects.
        """
        model, found = self.log.log_data.model, []
        before = self._settled_under(model).left
        for kind in catalogue.forms().values():
            guesses = [] if kind.name in {one.name for one in model.effects} else list(kind.guesses(model.robot))
            fits = in_parallel([partial(self._settled_under, model.extend(guess)) for guess in guesses])
            gains = [self._gain(before, fit.left) for fit in fits]
            if not guesses:
                continue
            best = int(np.argmax(gains))
            effect, fit = self._sharpened(guesses[best], fits[best])
            if (gain := self._gain(before, fit.left)) > TUNING.proposal_gain:
                found.append((gain, Proposal((effect,), _of_samples(self.log, fit.signs))))
        return [proposal for _, proposal in sorted(found, key=lambda one: -one[0])]

    def _settled_under(self, model: Model) -> _Settled:
        """From the signs so far, and from the best ones of all segments of the joints that are explained poorly."""
        form, predicted = self._form(model), self.log.fit.predicted[self.log.rows]
        sign_solution = self._settled(form, predicted)
        other = self._settled(form, self._segments_turned(form, sign_solution))
        return self._turned_one_by_one(
            form, other if self._gain(sign_solution.left, other.left) > 0.0 else sign_solution
        )

    def _sharpened(self, effect: Effect, sign_solution: _Settled) -> tuple[Effect, _Settled]:
        """An effect with the numbers that suit the signs under its guess best, by Gauss-Newton, and signs under it."""
        if not isinstance(effect, RobotDistortion):
            return effect, sign_solution
        model, used = self.log.log_data.model, self.log.data.used
        weight, magnitude = _noise_of(self.log)[0], self.log.modelled.magnitude
        count = sum(len(getattr(effect, key)) for key, number in effect.number_fields().items() if number.tuned)
        for _ in range(TUNING.sharpened_rounds):
            form, steps = self._form(model.extend(effect)), effect.step * np.eye(count)
            moved = [self._form(model.extend(effect.moved(step))) for step in steps]
            if any(one.names != form.names for one in moved) or len(form.names) != len(sign_solution.beta):
                break  # numbers at which the log shows other coefficients
            slopes = [(there.columns - form.columns) @ sign_solution.beta / effect.step for there in moved]
            columns = np.concatenate([form.columns, np.stack(slopes, axis=2)], axis=2) / weight[:, None]
            rows, target = columns[used], (sign_solution.signs * magnitude / weight)[used]
            best = inverse_of(rows.T @ rows) @ (rows.T @ target)
            better = effect.moved(best[-len(steps) :])
            other = self._settled(self._form(model.extend(better)), sign_solution.signs)
            if self._gain(sign_solution.left, other.left) <= 0.0:
                break
            effect, sign_solution = better, other
        return effect, sign_solution

    def _turned_together(self, form: _Form, sign_solution: _Settled) -> _Settled:
        for _ in form.bounded:
            if not np.any(flipped := self._wrong_sides(form, sign_solution)):
                break
            sign_solution = self._settled(form, np.where(flipped, -sign_solution.signs, sign_solution.signs))
        return sign_solution

    def _turned_one_by_one(self, form: _Form, sign_solution: _Settled) -> _Settled:
        for _ in form.bounded:
            before = sign_solution
            for j in range(len(form.bounded)):
                if self._wrong_sides(form, sign_solution)[j]:
                    signs = np.where(np.arange(len(form.bounded)) == j, -sign_solution.signs, sign_solution.signs)
                    other = self._settled(form, signs)
                    sign_solution = (
                        other if self._gain(sign_solution.left, other.left) > -TUNING.proposal_gain else sign_solution
                    )
            if sign_solution is before:
                break
        return sign_solution

    def _wrong_sides(self, form: _Form, sign_solution: _Settled) -> Mask:
        """(n,) joints of unknown sign whose bounded parameters are negative in sum."""
        columns, beta = np.abs(form.columns), sign_solution.beta
        sides = [np.sum(beta[own] * columns[:, j, own].sum(axis=0)) for j, own in enumerate(form.bounded)]
        return (np.array(sides) < 0.0) & ~self.log.log_data.signals.signed

    def _form(self, model: Model, free: Set[str] = frozenset()) -> _Form:
        """A model whose parameters of some names may have any sign."""
        coefficients, joints = base_coefficients(model), range(1, model.robot.n_joints + 1)
        names = list(coefficients.names)
        bounded = [model.parameters[k] for k in model.cone.nonnegative]
        kept = [[names.index(p.name) for p in bounded if p.joint == j and p.name in set(names) - free] for j in joints]
        return _Form(model.columns(self.log.modelled.motion)[:, :, coefficients.selected], names, kept)

    @cached_property
    def _count(self) -> Array:
        count: Array = self.log.data.used.sum(axis=0) / _noise_of(self.log)[1]
        return count

    def _gain(self, before: Array, left: Array) -> float:
        """Nats by which a joint's residual RMS left (n,) is likelier than the one before."""
        return float(self._count @ np.log(before / left))

    def _settled(self, form: _Form, begun: Array) -> _Settled:
        """Coefficients and signs in turn, from signs (N', n)."""
        used, signals = self.log.data.used, self.log.log_data.signals
        start = np.where(np.where(signals.signed, signals.raw_effort[self.log.rows], begun) >= 0.0, 1.0, -1.0)
        signs = np.zeros(used.shape)
        known = np.broadcast_to(signals.signed, used.shape)[used]
        signs[used], _, beta = self._in_turn(form).from_signs(start[used], known)
        return _Settled(signs, self._rms(signs, form.columns @ beta), beta)

    def _segments_turned(self, form: _Form, sign_solution: _Settled) -> Array:
        """(N', n) the best signs of whole segments, where those of joints that are explained poorly are in doubt."""
        used, signals = self.log.data.used, self.log.log_data.signals
        segment = np.where(signals.signed, -1, _segment_of(self.log, self.segments))
        doubted = np.broadcast_to(self.poor, used.shape)
        signs = sign_solution.signs.copy()
        signs[used] = self._in_turn(form).flipped(signs[used], segment[used], doubted[used])
        return signs

    def _in_turn(self, form: _Form) -> InTurn:
        used, weight, r = self.log.data.used, _noise_of(self.log)[0], form.columns.shape[2]
        rows, magnitude = (form.columns / weight[:, None])[used], (self.log.modelled.magnitude / weight)[used]
        return InTurn(rows, magnitude, np.zeros((r, r)), np.zeros(r))

    def _rms(self, signs: Array, predicted: Array) -> Array:
        used = self.log.data.used
        residual = np.where(used, signs * self.log.modelled.magnitude - predicted, 0.0)
        rms: Array = np.sqrt((residual**2).sum(axis=0) / np.maximum(used.sum(axis=0), 1)) + np.finfo(float).tiny
        return rms


def _noise_of(log: SignedLog) -> tuple[Array, Array]:
    """(n,) sd of each joint's error, N m, its autocorrelation included; and (n,) that, in thinned rows."""
    log_data, predicted = log.log_data, log.fit.predicted
    time = times_of(log_data.signals.nearest(predicted) - predicted, log_data.used, log_data.signals.rate)
    time = np.maximum(time / (log_data.signals.rate / log.data.rate), 1.0)
    return log.fit.residual.sigma * np.sqrt(time), time


def _segment_of(log: SignedLog, segments: Segments) -> Integers:
    """(N', n) of the thinned rows; -1 where none is fitted."""
    fitted = segments[segments.fitted]
    numbered = fitted.per_sample(np.arange(1, len(fitted) + 1), *log.log_data.used.shape)
    return numbered[log.rows].astype(np.int64) - 1


def _of_samples(log: SignedLog, thinned: Array) -> Array:
    """(N, n) signs of all samples from those of thinned rows (N', n): each sample's is that of the nearest row."""
    samples = np.arange(len(log.log_data.signals.motion))
    after = np.clip(np.searchsorted(log.rows, samples), 1, len(log.rows) - 1)
    earlier = samples - log.rows[after - 1] < log.rows[after] - samples
    nearest: Array = thinned[np.where(earlier, after - 1, after)]
    return nearest
