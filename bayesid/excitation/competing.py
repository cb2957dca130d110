"""Effects that a log cannot distinguish, and how well a motion distinguishes them.

Each hypothesis is the model without the effects in question, plus columns of one of them. Linear parameters are
marginalised. Of the forms with other nonlinear parameters, the best-fitting one counts, so the expected Bayes factor is
that of the worst case.
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
from bayesid.excitation.hypotheses import REMEDY, Changes
from bayesid.excitation.resolvability import information_of
from bayesid.excitation.tuning import TUNING
from bayesid.motion import Motion
from bayesid.regression.knowledge import inverse_of
from bayesid.regression.selection.fitted_effects import LN10
from bayesid.regression.selection.hypotheses import EffectKey, Hypothesis, hypotheses, maker

_RANK = 1e-6
"""A column is linearly independent of others if more than this share of its length lies outside their span."""


@dataclass(frozen=True)
class CompetingForm:
    """One form of a hypothesis, with fixed nonlinear parameters."""

    source: Effect  # term or distortion
    sd: Array  # (p,) prior sd of its amplitudes; last `TUNING.constant_sd` if it has a constant change
    mean: Array  # (p,) prior mean of its amplitudes
    columns: Integers  # (p,) indices of its columns among all

    @classmethod
    def of(cls, hypothesis: Hypothesis) -> CompetingForm:
        """Form of a hypothesis; `columns` is empty until `_placed`."""
        columns = hypothesis.columns
        shift = int(any(np.any(values) for values in columns.shift.values()))
        sd = np.concatenate([columns.sd, np.full(shift, TUNING.constant_sd)])
        mean = np.concatenate([np.zeros(len(columns.sd)), np.ones(shift)])
        return cls(hypothesis.source, sd, mean, np.zeros(0, dtype=np.int64))


@dataclass(frozen=True)
class CompetingModel:
    """A hypothesis: an effect in some joints."""

    key: EffectKey
    forms: tuple[CompetingForm, ...]  # with different nonlinear parameters; a form in the result comes first
    amplitudes: Array | None  # (p,) of the first form in the result; None if the result lacks the effect

    @property
    def name(self) -> str:
        """EFFECT:JOINT, as `--between` takes it."""
        effect, joints = self.key
        return ":".join([effect, *map(str, joints)])


@dataclass(frozen=True)
class CompetingEffects:
    """A class of competing hypotheses, and the result without them."""

    posterior: GaussianPosterior  # of the result without the effects in question
    competing: tuple[CompetingModel, ...]  # at least two
    recorded: Array  # (R, R) information of the earlier recording on all columns; zero if not given
    prior: Array  # (r, r) inverse covariance of the coefficients before it, or now if it is not given

    @property
    def pairs(self) -> list[tuple[CompetingModel, CompetingModel]]:
        """All ordered pairs: the true hypothesis and an alternative."""
        return [(a, b) for a in self.competing for b in self.competing if a is not b]

    def columns(self, motion: Motion) -> Array:
        """(N, n, R) columns of the coefficients, then of all forms."""
        base = self.posterior.columns(motion)
        effort = base @ self.posterior.mean
        scene, parts = self.posterior.model.scene(motion, self.posterior.theta, effort, np.abs(effort)), [base]
        for form in (form for model in self.competing for form in model.forms):
            shift, rows = form.source.change(scene)
            parts += [rows] if rows.shape[2] == len(form.columns) else [rows, shift[:, :, None]]
        return np.concatenate(parts, axis=2)

    @property
    def memory(self) -> bool:
        """Whether a row depends on other samples too."""
        return self.posterior.memory or any(form.source.memory for model in self.competing for form in model.forms)

    def objective(self, information: Array) -> float:
        """Minus the sum of expected log Bayes factors, nats, each limited to twice the decisive value.

        The limit keeps one pair from dominating the sum; the factor two allows for scatter of the measured value.
        """
        factors = expected_factors(self._beliefs, information)
        return -float(np.minimum(factors, 2.0 * TUNING.decisive * LN10).sum())

    def expected(self, information: Array) -> dict[tuple[str, str], float]:
        """Expected log Bayes factor, nats, of each true hypothesis against each alternative."""
        factors = expected_factors(self._beliefs, information).tolist()
        return {(a.name, b.name): value for (a, b), value in zip(self.pairs, factors, strict=True)}

    @cached_property
    def _beliefs(self) -> list[tuple[Belief, list[Belief]]]:
        """For each pair the true belief, and the beliefs of the alternative's forms, after the earlier recording."""
        truths = self._truths
        return [(truths[a.name], [self._after(form, truths[a.name]) for form in b.forms]) for a, b in self.pairs]

    @cached_property
    def _truths(self) -> dict[str, Belief]:
        """The true belief under each hypothesis, by name.

        If the result has one of the effects, the others are fitted to the efforts that it predicts.
        """
        pairs = [(model.forms[0], model.amplitudes) for model in self.competing if model.amplitudes is not None]
        found = pairs[0] if pairs else None
        truths = {}
        for model in self.competing:
            if model.amplitudes is None and found is not None:
                true = self._of(*found)
                fitted = (self._after(form, true) for form in model.forms)
                truths[model.name] = max(fitted, key=lambda belief: belief.fit)
            else:
                form = model.forms[len(model.forms) // 2]
                form = form if model.amplitudes is None else replace(model.forms[0], mean=model.amplitudes)
                truths[model.name] = self._after(form, self._of(form, form.mean))
        return truths

    def best_fit(self, form: CompetingForm, model: CompetingModel) -> float:
        """Best fit of a form of a hypothesis to the earlier recording if another hypothesis is true."""
        return max(self._after(form, self._truths[other.name]).fit for other in self.competing if other is not model)

    def _of(self, form: CompetingForm, amplitudes: Array) -> Belief:
        """Belief of a form before the earlier recording, with mean amplitudes (p,)."""
        columns = np.concatenate([np.arange(len(self.posterior)), form.columns])
        precision = scipy.linalg.block_diag(self.prior, np.diag(form.sd**-2.0))
        return Belief(columns, np.concatenate([self.posterior.mean, amplitudes]), precision)

    def _after(self, form: CompetingForm, true: Belief) -> Belief:
        """Belief of a form after the earlier recording, if the mean of another belief is true."""
        before = self._of(form, form.mean)
        of_prior = before.precision @ before.mean
        gradient = of_prior + self.recorded[np.ix_(before.columns, true.columns)] @ true.mean
        precision = before.precision + self.recorded[np.ix_(before.columns, before.columns)]
        mean = inverse_of(precision) @ gradient
        return Belief(before.columns, mean, precision, float(gradient @ mean - before.mean @ of_prior))


# ---- Hypotheses of a result ----
def make_competing(
    posterior: GaussianPosterior,
    keys: Sequence[EffectKey],
    earlier: Motion | None,
    reference: Motion,
    changed: Changes | None = None,
) -> CompetingEffects:
    """A class of two or more competing hypotheses, from a result.

    `earlier` is the motion of the result's log. Without it, forms are made on the `reference` motion. `changed` holds
    the hypotheses that change a term of the model. InputError if an effect has no form in its joints.
    """
    if len(set(keys)) < 2:
        remedy = "as in stribeck_friction:3,thermal_drift:3"
        raise InputError("needs two different hypotheses", field="between", remedy=remedy)
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
    effort = bare.columns(motion) @ bare.mean
    scene = bare.model.scene(motion, bare.theta, effort, np.abs(effort))
    actuators = bare.model.robot.actuators(motion)
    make = maker(bare.model, scene, np.abs(actuators.dq) > actuators.standstill_speed)
    competing = []
    for key in keys:
        in_result, amplitudes = found.get(key), steps.get(key)
        made = [] if in_result is None else [make(in_result[0])]
        made += [hypothesis for group in hypotheses(make, scene, effect=key[0], joints=key[1]) for hypothesis in group]
        forms = [CompetingForm.of(hypothesis) for hypothesis in made]
        if not forms:
            where = f"joint {', '.join(map(str, key[1]))}" if key[1] else "the whole robot"
            raise InputError(f"{key[0]!r} has no form in {where}", field="between", remedy=REMEDY)
        if in_result is not None:  # a term has parameters, a distortion only its constant change
            amplitudes = np.concatenate([in_result[1], forms[0].mean[len(in_result[1]) :]])
        competing.append(CompetingModel(key, tuple(forms), amplitudes))
    return _placed(len(bare), competing)


def _placed(place: int, competing: Sequence[CompetingModel]) -> tuple[CompetingModel, ...]:
    """With the columns of the forms in sequence, from an index on."""
    placed = []
    for model in competing:
        forms = []
        for form in model.forms:
            forms.append(replace(form, columns=np.arange(place, place + len(form.sd))))
            place += len(form.sd)
        placed.append(replace(model, forms=tuple(forms)))
    return tuple(placed)


def _unstepped(posterior: GaussianPosterior, steps: Sequence[Mapping[str, float]]) -> GaussianPosterior:
    """The result with parameters before their changes, the steps."""
    names = [parameter.name for parameter in posterior.model.parameters]
    theta, mean = posterior.theta.copy(), posterior.mean.copy()
    for name, step in (pair for changes in steps for pair in changes.items()):
        theta[names.index(name)] -= step
    mean[: len(posterior.coefficients)] += posterior.coefficients.project(theta - posterior.theta)
    return replace(posterior, theta=theta, mean=mean)


def _without_step(prior: Array, bare: GaussianPosterior, parameters: Sequence[str], sd: Array) -> Array:
    """The prior inverse covariance without the variance that a step of parameters of sd (p,) added.

    See `CoefficientPrior.widened`. At least 1 / `TUNING.earlier_sd` of each standard deviation remains.
    """
    names = [parameter.name for parameter in bare.model.parameters]
    step = np.zeros((len(bare), len(parameters)))
    step[: len(bare.coefficients)] = bare.coefficients.projection[:, [names.index(name) for name in parameters]]
    scaled = prior @ step * sd[: len(parameters)]
    shares, directions = _remaining(prior, scaled @ scaled.T)
    rows = prior @ directions
    return (rows / shares) @ rows.T


def _before(posterior: GaussianPosterior, bare: GaussianPosterior, earlier: Motion) -> Array:
    """(r, r) inverse covariance of the quantities before the earlier recording.

    The recording's information is subtracted from the present one; `TUNING.earlier_sd` limits the earlier standard
    deviation.
    """
    shares, directions = _remaining(posterior.precision, posterior.information(earlier))
    covariance = (directions / shares) @ directions.T
    if bare is not posterior:
        to_bare, r = _coefficient_map(posterior, bare.model), len(posterior.coefficients)
        covariance = to_bare @ covariance[:r, :r] @ to_bare.T
    return inverse_of(covariance)


def _remaining(matrix: Array, part: Array) -> tuple[Array, Array]:
    """Shares s (r,), limited below, and directions D (r, r): D' matrix D = 1, D' (matrix - part) D = diag(s)."""
    ridge = 1e-13 * np.diag(np.diag(matrix))  # against rounding
    shares, directions = scipy.linalg.eigh(part, matrix + ridge)
    return np.clip(1.0 - shares, 1.0 / TUNING.earlier_sd**2, 1.0), directions


def _coefficient_map(posterior: GaussianPosterior, model: Model) -> Array:
    """(r, R) matrix from coefficients to those of the same model without some terms."""
    names = [parameter.name for parameter in posterior.model.parameters]
    kept = [names.index(parameter.name) for parameter in model.parameters]
    projection: Array = base_coefficients(model).projection
    return projection @ np.linalg.pinv(posterior.coefficients.projection[:, kept])


def _without(
    posterior: GaussianPosterior, keys: Sequence[EffectKey]
) -> tuple[GaussianPosterior, dict[EffectKey, tuple[Effect, Array]]]:
    """The result without some effects, and those of them that it has, with their amplitudes."""
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
    base, to_bare = base_coefficients(bare_model), _coefficient_map(posterior, bare_model)
    r = len(posterior.coefficients)
    precision = inverse_of(to_bare @ posterior.covariance_now[:r, :r] @ to_bare.T)
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
    """Keeps the forms of each hypothesis that fit the earlier recording best; without one, evenly spaced forms."""
    r = len(made.posterior)
    chosen = [replace(model, forms=tuple(_chosen(made, model))) for model in made.competing]
    kept = np.concatenate([np.arange(r), *(form.columns for model in chosen for form in model.forms)])
    return replace(made, competing=_placed(r, chosen), recorded=made.recorded[np.ix_(kept, kept)])


def _chosen(made: CompetingEffects, model: CompetingModel) -> list[CompetingForm]:
    """At most `TUNING.most_forms` forms; a form in the result comes first."""
    forms, first = list(model.forms), int(model.amplitudes is not None)
    if len(forms) <= TUNING.most_forms:
        return forms
    if not made.recorded.any():
        return [forms[k] for k in np.unique(np.linspace(0, len(forms) - 1, TUNING.most_forms).astype(int))]
    fits = [made.best_fit(form, model) for form in forms[first:]]
    best = np.sort(np.argsort(fits)[::-1][: TUNING.most_forms - first]) + first
    return [*forms[:first], *(forms[k] for k in best)]


def indistinguishable(made: CompetingEffects, motion: Motion) -> list[tuple[str, str]]:
    """Pairs that no motion distinguishes: on an exciting motion, the columns of each span those of the other."""
    columns = made.columns(motion)
    rows = columns.reshape(-1, columns.shape[2])
    rows = rows / np.maximum(np.linalg.norm(rows, axis=0), TINY)
    base = rows[:, : len(made.posterior)]
    residual = rows - base @ np.linalg.lstsq(base, rows, rcond=None)[0]

    def in_span(form: CompetingForm, other: CompetingForm) -> bool:
        columns, others = residual[:, form.columns], residual[:, other.columns]
        outside = columns - others @ np.linalg.lstsq(others, columns, rcond=_RANK)[0]
        return bool(np.linalg.norm(outside, axis=0).max(initial=0.0) <= _RANK)

    def same_span(a: CompetingModel, b: CompetingModel) -> bool:
        return any(in_span(form, other) and in_span(other, form) for form in a.forms for other in b.forms)

    pairs = [(a, b) for k, a in enumerate(made.competing) for b in made.competing[k + 1 :]]
    return [(a.name, b.name) for a, b in pairs if same_span(a, b)]
