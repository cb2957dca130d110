"""Hypotheses that a log cannot distinguish, and how well a motion distinguishes them: expected Bayes factors.

Each hypothesis is the model without the effects in question, plus columns of one of them. Linear parameters are
marginalised. Of the forms with other nonlinear parameters, the one that fits best counts, so the expected Bayes factor
is that of the worst case.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from bayesid.arrays import TINY, Array, Integers
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.effect import Effect
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.excitation.bayes_factors import Belief, expected_factors
from bayesid.excitation.gaussian_posterior import GaussianPosterior
from bayesid.excitation.hypotheses import EXAMPLE, Changes
from bayesid.excitation.resolvability import information_of
from bayesid.excitation.tuning import TUNING
from bayesid.motion import Motion
from bayesid.regression.knowledge import inverse_of
from bayesid.regression.selection.fitted_effects import LN10
from bayesid.regression.selection.hypotheses import EffectKey, Hypothesis, hypotheses, maker

_RANK = 1e-6
"""Share of a column's length outside the span of others, above which it is linearly independent of them."""


@dataclass(frozen=True)
class CompetingForm:
    """One form of a hypothesis."""

    source: Effect  # term or distortion
    sd: Array  # (p,) of its amplitudes beforehand; `TUNING.constant_sd` of a change without amplitude, which comes last
    mean: Array  # (p,) of them beforehand
    columns: Integers  # (p,) places of its columns among all

    @classmethod
    def of(cls, hypothesis: Hypothesis) -> CompetingForm:
        """Its columns have no place yet."""
        columns = hypothesis.columns
        shift = int(any(np.any(values) for values in columns.shift.values()))
        sd = np.concatenate([columns.sd, np.full(shift, TUNING.constant_sd)])
        mean = np.concatenate([np.zeros(len(columns.sd)), np.ones(shift)])
        return cls(hypothesis.source, sd, mean, np.zeros(0, dtype=np.int64))


@dataclass(frozen=True)
class CompetingModel:
    """A hypothesis."""

    key: EffectKey
    forms: tuple[CompetingForm, ...]  # with different nonlinear parameters; the one in the result comes first
    amplitudes_found: Array | None  # (p,) amplitudes of its first form in the result; None where the result lacks it

    @property
    def name(self) -> str:
        """As `--between` takes it."""
        effect, joints = self.key
        return ":".join([effect, *map(str, joints)])


@dataclass(frozen=True)
class CompetingEffects:
    """A class of competing hypotheses, and the result without them."""

    posterior: GaussianPosterior  # the result without the effects in question
    competing: tuple[CompetingModel, ...]  # at least two
    recorded: Array  # (R, R) information of the earlier recording on all columns; zero if not given
    prior: Array  # (r, r) inverse covariance of the coefficients before it, or now if it is not given

    @property
    def pairs(self) -> list[tuple[CompetingModel, CompetingModel]]:
        """The true one first."""
        return [(a, b) for a in self.competing for b in self.competing if a is not b]

    def columns(self, motion: Motion) -> Array:
        """(N, n, R) those of the coefficients, then those of all forms."""
        base = self.posterior.columns(motion)
        effort = base @ self.posterior.mean
        scene, parts = self.posterior.model.scene(motion, self.posterior.theta, effort, np.abs(effort)), [base]
        for form in (form for model in self.competing for form in model.forms):
            shift, rows = form.source.change(scene)
            parts += [rows] if rows.shape[2] == len(form.columns) else [rows, shift[:, :, None]]
        return np.concatenate(parts, axis=2)

    @property
    def memory(self) -> bool:
        """Whether a row depends on other instants too."""
        return self.posterior.memory or any(form.source.memory for model in self.competing for form in model.forms)

    def objective(self, information: Array) -> float:
        """Minus the sum of expected log Bayes factors, nats, each limited to twice the decisive value.

        The limit keeps one pair from outweighing the others; the factor two allows for scatter.
        """
        factors = expected_factors(self._beliefs, information)
        return -float(np.minimum(factors, 2.0 * TUNING.decisive * LN10).sum())

    def expected(self, information: Array) -> dict[tuple[str, str], float]:
        """Expected log Bayes factor, nats, of each hypothesis if it is true, against each other."""
        factors = expected_factors(self._beliefs, information).tolist()
        return {(a.name, b.name): value for (a, b), value in zip(self.pairs, factors, strict=True)}

    @cached_property
    def _beliefs(self) -> list[tuple[Belief, list[Belief]]]:
        """Of each pair, the true belief, and those of the alternative's forms after the earlier recording."""
        truths = self._truths
        return [(truths[a.name], [self._after(form, truths[a.name]) for form in b.forms]) for a, b in self.pairs]

    @cached_property
    def _truths(self) -> dict[str, Belief]:
        """The true belief under each hypothesis, by name.

        Where the result includes one of them, each other one is fitted to the efforts which that one predicts.
        """
        found = next(
            (
                (model.forms[0], model.amplitudes_found)
                for model in self.competing
                if model.amplitudes_found is not None
            ),
            None,
        )
        truths = {}
        for model in self.competing:
            if model.amplitudes_found is None and found is not None:
                seen = self._of(*found)
                truths[model.name] = max((self._after(form, seen) for form in model.forms), key=lambda one: one.fit)
            else:
                form = model.forms[len(model.forms) // 2]
                form = form if model.amplitudes_found is None else replace(model.forms[0], mean=model.amplitudes_found)
                truths[model.name] = self._after(form, self._of(form, form.mean))
        return truths

    def best_fit(self, form: CompetingForm, model: CompetingModel) -> float:
        """How well a form of a hypothesis fits the earlier recording where one of the others is true."""
        return max(self._after(form, self._truths[one.name]).fit for one in self.competing if one is not model)

    def _of(self, form: CompetingForm, amplitudes: Array) -> Belief:
        """A form before the earlier recording, about some amplitudes (p,)."""
        columns = np.concatenate([np.arange(len(self.posterior)), form.columns])
        precision = scipy.linalg.block_diag(self.prior, np.diag(form.sd**-2.0))
        return Belief(columns, np.concatenate([self.posterior.mean, amplitudes]), precision)

    def _after(self, form: CompetingForm, true: Belief) -> Belief:
        """A form after the earlier recording, in which the means of another belief were true."""
        before = self._of(form, form.mean)
        pull = before.precision @ before.mean
        seen = pull + self.recorded[np.ix_(before.columns, true.columns)] @ true.mean
        precision = before.precision + self.recorded[np.ix_(before.columns, before.columns)]
        mean = inverse_of(precision) @ seen
        return Belief(before.columns, mean, precision, float(seen @ mean - before.mean @ pull))


# ---- How they come from a result ----
def make_competing(
    posterior: GaussianPosterior,
    keys: Sequence[EffectKey],
    earlier: Motion | None,
    reference: Motion,
    changed: Changes | None = None,
) -> CompetingEffects:
    """Hypotheses of a result.

    Args:
        posterior: of the result.
        keys: effects and joints (from 1), two or more.
        earlier: N instants of the motion of the result's log, evenly thinned; None if not given.
        reference: a motion on which forms are made if the earlier one is not given.
        changed: those of them that change a term which the model already had.

    Raises:
        InputError: an effect is not in the catalogue, or has no form in these joints.
    """
    if len(set(keys)) < 2:
        remedy = "as in stribeck_friction:3,thermal_drift:3"
        raise InputError("takes two different hypotheses", field="between", remedy=remedy)
    changed = {key: step for key, step in (changed or {}).items() if key in keys}
    steps = {key: np.array(list(step.values())) for key, step in changed.items() if step}
    bare, found = _without(posterior, [key for key in keys if key not in changed])
    prior = bare.precision if earlier is None else _before(posterior, bare, earlier)
    bare = _unstepped(bare.undelayed, [changed[key] for key in steps])
    competing = _competing(bare, keys, found, steps, reference if earlier is None else earlier)
    size = competing[-1].forms[-1].columns[-1] + 1
    made = CompetingEffects(bare, competing, np.zeros((size, size)), prior)
    if earlier is not None:
        for model in competing:
            if model.key in steps:
                prior = _without_step(prior, bare, list(changed[model.key]), model.forms[0].sd)
        recorded = information_of(made.columns(earlier), bare.weights(earlier))
        made = replace(made, recorded=recorded, prior=prior)
    return _best_fitting(made)


def _competing(
    bare: GaussianPosterior,
    keys: Sequence[EffectKey],
    found: Mapping[EffectKey, tuple[Effect, Array]],
    steps: Mapping[EffectKey, Array],
    motion: Motion,
) -> tuple[CompetingModel, ...]:
    """Every form of each hypothesis on a motion."""
    effort = bare.columns(motion) @ bare.mean
    scene = bare.model.scene(motion, bare.theta, effort, np.abs(effort))
    actuators = bare.model.robot.actuators(motion)
    make = maker(bare.model, scene, np.abs(actuators.dq) > actuators.standstill_speed)
    competing = []
    for key in keys:
        amplitudes_found, amplitudes = found.get(key), steps.get(key)
        made = [] if amplitudes_found is None else [make(amplitudes_found[0])]
        made += [one for group in hypotheses(make, scene, effect=key[0], joints=key[1]) for one in group]
        forms = [CompetingForm.of(one) for one in made]
        if not forms:
            where = f"joint {', '.join(map(str, key[1]))}" if key[1] else "the whole robot"
            raise InputError(f"{key[0]!r} has no form in {where}", field="between", remedy=EXAMPLE)
        if amplitudes_found is not None:  # a term's parameters, or nothing beside the change that a distortion is
            amplitudes = np.concatenate([amplitudes_found[1], forms[0].mean[len(amplitudes_found[1]) :]])
        competing.append(CompetingModel(key, tuple(forms), amplitudes))
    return _placed(len(bare), competing)


def _placed(place: int, competing: Sequence[CompetingModel]) -> tuple[CompetingModel, ...]:
    """With the columns of one form behind those of the other."""
    placed = []
    for model in competing:
        forms = []
        for form in model.forms:
            forms.append(replace(form, columns=np.arange(place, place + len(form.sd))))
            place += len(form.sd)
        placed.append(replace(model, forms=tuple(forms)))
    return tuple(placed)


def _unstepped(posterior: GaussianPosterior, steps: Sequence[Mapping[str, float]]) -> GaussianPosterior:
    """The result with parameters as they were before they made some steps."""
    names = [parameter.name for parameter in posterior.model.parameters]
    theta, mean = posterior.theta.copy(), posterior.mean.copy()
    for name, step in (pair for one in steps for pair in one.items()):
        theta[names.index(name)] -= step
    mean[: len(posterior.coefficients)] += posterior.coefficients.project(theta - posterior.theta)
    return replace(posterior, theta=theta, mean=mean)


def _without_step(prior: Array, bare: GaussianPosterior, parameters: Sequence[str], sd: Array) -> Array:
    """The inverse covariance before, without the step of sd (p,) of parameters (`CoefficientPrior.widened`).

    Where that is all that was uncertain of a coefficient, a `TUNING.earlier_sd`th of its standard deviation is left.
    """
    names = [parameter.name for parameter in bare.model.parameters]
    step = np.zeros((len(bare), len(parameters)))
    step[: len(bare.coefficients)] = bare.coefficients.projection[:, [names.index(name) for name in parameters]]
    pulled = prior @ step * sd[: len(parameters)]
    left, directions = _left(prior, pulled @ pulled.T)
    across = prior @ directions
    return (across / left) @ across.T


def _before(posterior: GaussianPosterior, bare: GaussianPosterior, earlier: Motion) -> Array:
    """(r, r) inverse covariance of the quantities before the earlier recording, by what is known beside it.

    The recording's information is subtracted from the present one; `TUNING.earlier_sd` limits the earlier standard
    deviation.
    """
    left, directions = _left(posterior.precision, posterior.information(earlier))
    covariance = (directions / left) @ directions.T
    if bare is not posterior:
        turn, r = _turn(posterior, bare.model), len(posterior.coefficients)
        covariance = turn @ covariance[:r, :r] @ turn.T
    return inverse_of(covariance)


def _left(matrix: Array, part: Array) -> tuple[Array, Array]:
    """(r,) shares of a positive matrix that a part of it leaves, and (r, r) directions D of them: D' matrix D = 1."""
    ridge = 1e-13 * np.diag(np.diag(matrix))  # against rounding
    shares, directions = scipy.linalg.eigh(part, matrix + ridge)
    return np.clip(1.0 - shares, 1.0 / TUNING.earlier_sd**2, 1.0), directions


def _turn(posterior: GaussianPosterior, model: Model) -> Array:
    """(r, R) what takes coefficients to those of the same model without some terms."""
    names = [parameter.name for parameter in posterior.model.parameters]
    kept = [names.index(parameter.name) for parameter in model.parameters]
    turn: Array = base_coefficients(model).projection @ np.linalg.pinv(posterior.coefficients.projection[:, kept])
    return turn


def _without(
    posterior: GaussianPosterior, keys: Sequence[EffectKey]
) -> tuple[GaussianPosterior, dict[EffectKey, tuple[Effect, Array]]]:
    """The result without some effects, and those that it has: the effect and its amplitudes."""
    model = posterior.model
    places = [*model.places, *(slice(0, 0) for _ in model.distortions)]
    found, kept = dict[EffectKey, tuple[Effect, Array]](), list[slice]()
    bare_model = Model(model.robot, (), ())
    for effect, place in zip(model.effects, places, strict=True):
        if (effect.effect, effect.joints) in keys:
            found[effect.effect, effect.joints] = effect, posterior.theta[place]
        else:
            bare_model = bare_model.extend(effect)
            kept.append(place)
    if not found:
        return posterior, found
    theta = np.concatenate([posterior.theta[place] for place in kept])
    base, turn, r = base_coefficients(bare_model), _turn(posterior, bare_model), len(posterior.coefficients)
    precision = inverse_of(turn @ posterior.covariance_now[:r, :r] @ turn.T)
    bare = replace(
        posterior,
        model=bare_model,
        coefficients=base,
        theta=theta,
        names=base.names,
        units=base.units,
        mean=base.project(theta),
        precision=precision,
        model_error_covariance=np.zeros_like(precision),
        gains=np.empty(0, dtype=np.int64),
    )
    return bare, found


def _best_fitting(made: CompetingEffects) -> CompetingEffects:
    """The forms of each hypothesis that fit the earlier recording best; without one, evenly spaced forms."""
    r, chosen = len(made.posterior), [replace(one, forms=tuple(_chosen(made, one))) for one in made.competing]
    kept = np.concatenate([np.arange(r), *(form.columns for model in chosen for form in model.forms)])
    return replace(made, competing=_placed(r, chosen), recorded=made.recorded[np.ix_(kept, kept)])


def _chosen(made: CompetingEffects, model: CompetingModel) -> list[CompetingForm]:
    """At most `TUNING.most_forms` forms; the one in the result comes first."""
    forms, first = list(model.forms), int(model.amplitudes_found is not None)
    if len(forms) <= TUNING.most_forms:
        return forms
    if not made.recorded.any():
        return [forms[k] for k in np.unique(np.linspace(0, len(forms) - 1, TUNING.most_forms).astype(int))]
    fits = [made.best_fit(form, model) for form in forms[first:]]
    best = np.sort(np.argsort(fits)[::-1][: TUNING.most_forms - first]) + first
    return [*forms[:first], *(forms[k] for k in best)]


def indistinguishable(made: CompetingEffects, motion: Motion) -> list[tuple[str, str]]:
    """Pairs that no motion distinguishes: on a rich one, the columns of each span those of the other."""
    columns = made.columns(motion)
    rows = columns.reshape(-1, columns.shape[2])
    rows = rows / np.maximum(np.linalg.norm(rows, axis=0), TINY)
    base = rows[:, : len(made.posterior)]
    beside = rows - base @ np.linalg.lstsq(base, rows, rcond=None)[0]  # what the coefficients leave of each column

    def among(one: CompetingForm, other: CompetingForm) -> bool:
        wanted, others = beside[:, one.columns], beside[:, other.columns]
        left = wanted - others @ np.linalg.lstsq(others, wanted, rcond=_RANK)[0]
        return bool(np.linalg.norm(left, axis=0).max(initial=0.0) <= _RANK)

    def alike(a: CompetingModel, b: CompetingModel) -> bool:
        return any(among(one, other) and among(other, one) for one in a.forms for other in b.forms)

    pairs = [(a, b) for k, a in enumerate(made.competing) for b in made.competing[k + 1 :]]
    return [(a.name, b.name) for a, b in pairs if alike(a, b)]
