"""Scores of effects: by how much each effect or set of effects, in its best form, improves a fit.

`best_forms` scores single effects with fixed error models. `assess` refits the error models for the best ones.
`refined` optimises nonlinear numbers between the library's values.

Adding effects one by one fails if a joint lacks two effects: the first added effect resembles their sum, and slow noise
explains the difference. So `joint_sets` multiplies all forms of a joint once, with the model's columns eliminated as
far as the earlier log allows. All pairs are tried, and larger sets by a beam search. With the products Q of a set's
columns, q those with the effort, c = y'y of the residual without them, and D the amplitudes' prior standard deviations,
all in units of the floor (:eq:`set-proposal`)::

    log p = - N log(s^2) / 2 - (c - q' (Q + s^2 D^-2)^-1 q) / (2 s^2) - log det(1 + D Q D / s^2) / 2,

with white noise of the likeliest scale s >= 1. This proposes sets; `regression.selection.regression` scores them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby

import numpy as np
import scipy
from scipy.special import log_ndtr, logsumexp

from bayesid.arrays import TINY, Array, Integers, Mask
from bayesid.regression.selection.error_model import ErrorModel, alike
from bayesid.regression.selection.fitted_effects import LN10, FittedEffects, Observations, Thresholds
from bayesid.regression.selection.hypotheses import EffectKey, Hypothesis, Library
from bayesid.regression.selection.regression import Effects, Regression, explain
from bayesid.regression.tuning import TUNING


@dataclass(frozen=True)
class Score:
    """An effect in its best form."""

    hypothesis: Hypothesis  #: the best form
    gain: float  #: log of the Bayes factor for adding it, averaged over its forms
    expected_gain: float  #: expected log of the Bayes factor at a usual amplitude
    spread: float = 0.0  #: change of the gain by averaging over its forms
    #: fall of a joint's mean squared residual, over that of its floor (or over a part of its residual, if larger);
    #: nan if the error models were not refitted
    improvement: float = np.nan
    #: (n,) mean squared residual with it, in units of the floor's; None if the error models were not refitted
    mean_square: Array | None = None

    @property
    def key(self) -> EffectKey:
        """Effect and joints."""
        return self.hypothesis.key

    @property
    def alone(self) -> Score:
        """A copy with its own arrays, which keeps no other forms in memory."""
        return replace(self, hypothesis=self.hypothesis.alone)

    def qualifies(self, thresholds: Thresholds) -> bool:
        """Whether Bayes factor and improvement reach the thresholds."""
        return self.gain > thresholds.log10_bayes_factor * LN10 and self.improvement > thresholds.improvement


def assess(fitted_effects: FittedEffects, library: Library) -> list[Score]:
    """Every effect of the library in its best form on top of a fit, best first; the best ones with refitted errors."""
    count = TUNING.rescored
    ordered = best_forms(Regression.of(fitted_effects), library)
    closer = [_closer(fitted_effects, score) for score in ordered[:count]]
    return sorted(closer, key=lambda score: -score.gain) + ordered[count:]


def best_forms(regression: Regression, library: Iterable[Sequence[Hypothesis]]) -> list[Score]:
    """Each effect in its best form on top of all effects of a regression, best first."""
    groups: dict[EffectKey, list[Score]] = {}
    names: dict[EffectKey, set[str]] = {}
    for group in library:
        if group:
            groups.setdefault(group[0].key, []).append(_best_form(regression, group))
            names.setdefault(group[0].key, set()).update(hypothesis.source.name for hypothesis in group)
    best = []
    for key, scores in groups.items():
        averaged = -float(np.log(len(names[key])))
        scores = [replace(score, gain=score.gain + averaged, spread=score.spread + averaged) for score in scores]
        best.append(max(scores, key=lambda score: score.gain))
    return sorted(best, key=lambda score: -score.gain)


def _best_form(regression: Regression, group: Sequence[Hypothesis]) -> Score:
    gains, expected = regression.screened([hypothesis.columns for hypothesis in group])
    place = int(np.argmax(gains))
    averaged = float(logsumexp(gains)) - float(np.log(len(group)))
    return Score(group[place], averaged, float(expected.max()), averaged - float(gains[place]))


def refined(
    data: Observations, effects: Sequence[Hypothesis], library: Library, joints: Collection[int] | None = None
) -> list[Hypothesis]:
    """Effects with nonlinear numbers at their best fit, each given all others.

    A number stays between its neighbours in the library. Only effects in some (0-based) joints are refined; None: all.
    """
    effects = list(effects)
    for k, effect in enumerate(effects):
        if joints is not None and effect.columns.joints.isdisjoint(joints):
            continue
        grid = _grid(effect, library)
        if grid is not None:
            effects[k] = _fitted(data, effect, effects[:k] + effects[k + 1 :], *grid)
    return effects


def _fitted(
    data: Observations, effect: Hypothesis, others: Sequence[Hypothesis], number: str, values: Sequence[float]
) -> Hypothesis:
    """One effect with its number optimised between two neighbouring values."""
    regression = Regression(data, others, explain(data, [*others, effect]).errors)

    def cost(value: float) -> float:
        return -float(regression.screened([effect.remade(number, value).columns])[0][0])

    now = effect.source.shape[number][0]
    bounds = max((v for v in values if v < now), default=now), min((v for v in values if v > now), default=now)
    best = scipy.optimize.minimize_scalar(
        cost, bounds=bounds, method="bounded", options={"maxiter": TUNING.number_evaluations}
    )
    return effect.remade(number, float(best.x)) if best.fun < cost(now) - TUNING.number_gain else effect


def _grid(effect: Hypothesis, library: Library) -> tuple[str, Sequence[float]] | None:
    """The nonlinear number of this form that the library varies, and its values."""
    alike = (
        h.source for group in library for h in group if h.key == effect.key and h.source.name == effect.source.name
    )
    forms = list(alike)
    for key in effect.source.fitted:
        tried = {tuple(form.shape[key]) for form in forms}
        if len(effect.source.shape[key]) == 1 and len(tried) > 2:
            return key, sorted(value for (value,) in tried)
    return None


def _closer(fitted_effects: FittedEffects, score: Score) -> Score:
    """The score with refitted error models, and the improvement of the fit."""
    data = replace(fitted_effects.data, reference=fitted_effects)
    regression = Regression(
        data, (*fitted_effects.effects, score.hypothesis), fitted_effects.errors, fitted_effects.uncertain
    )
    extended = regression.fitted_effects
    if not alike(extended.errors, fitted_effects.errors):
        extended = regression.weighed(extended.errors).fitted_effects
    before, after = fitted_effects.mean_square, extended.mean_square
    return replace(
        score,
        gain=extended.log_evidence - fitted_effects.log_evidence + score.spread,
        improvement=float(np.max(_improvement(before, after, data.thresholds))),
        mean_square=after,
    )


def _improvement(before: Array, after: Array, thresholds: Thresholds) -> Array:
    """(n,) relative fall of the mean squared residual; falls that are small against floor or residual count as zero."""
    return (before - after) / np.maximum(1.0, TUNING.improvement_of_rest / thresholds.improvement * before)


def plain_first(scores: Sequence[Score], data: Observations) -> list[Score]:
    """The scores, best first, but a standard effect before others of its joint that are little better.

    Only with an incomplete floor: no term describes real friction exactly, so a more complex effect that is slightly
    better need not be present, whatever its Bayes factor.
    """
    ordered: list[Score] = []
    for score in scores:
        place, unreliable = len(ordered), not all(data.reliable[j] for j in score.hypothesis.columns.joints)
        advances = unreliable and score.hypothesis.standard and score.qualifies(data.thresholds)
        while place and advances and _little_better(ordered[place - 1], score, data):
            place -= 1
        ordered.insert(place, score)
    return ordered


def _little_better(other: Score, standard: Score, data: Observations) -> bool:
    """Whether another effect of the same joints is not standard, has more numbers, and improves little more."""
    if other.hypothesis.standard or other.hypothesis.joints != standard.hypothesis.joints:
        return False
    numbers, least = (len(s.hypothesis.columns.sd) + len(s.hypothesis.source.fitted) for s in (other, standard))
    if numbers <= least or other.mean_square is None or standard.mean_square is None:
        return False
    if at_unreliable_floor(data, standard.mean_square)[list(standard.hypothesis.columns.joints)].all():
        return True
    improvement = _improvement(standard.mean_square, other.mean_square, data.thresholds)
    return bool(np.max(improvement) < data.thresholds.improvement)


def at_unreliable_floor(data: Observations, mean_square: Array) -> Mask:
    """(n,) whether a joint's mean squared residual, in units of the floor's, reaches an incomplete floor."""
    return ~data.reliable & (mean_square <= TUNING.at_unreliable_floor**2)


def joint_sets(
    data: Observations, joint: int, others: Effects, forms: Effects, log_prior: Callable[[Hypothesis], float]
) -> list[tuple[Hypothesis, ...]]:
    """The likeliest sets of one to three different effects of a (0-based) joint, each in its best forms.

    Each size is represented: on a coarse grid a small set scores too low, and another effect seems necessary.

    Args:
        data: the log.
        joint: 0-based.
        others: effects in every set.
        forms: forms that act in this joint only.
        log_prior: log prior probability of a form.
    """
    if not forms:
        return []
    data, here = data.in_joint(joint), [_in_joint(other, joint) for other in others]
    forms = sorted(forms, key=lambda form: len(form.columns.sd))
    priors, local = np.array([log_prior(form) for form in forms]), [_in_joint(form, joint) for form in forms]
    parts = [local[k : k + TUNING.forms_at_once] for k in range(0, len(local), TUNING.forms_at_once)]
    alone = [JointForms(data, here, part).scores(np.arange(len(part))[:, None]) for part in parts]
    kept = _spread(forms, np.concatenate(alone) + priors)
    best = JointForms(data, here, [local[k] for k in kept]).best(priors[kept])
    return [tuple(forms[kept[k]] for k in members) for members in best]


def _in_joint(effect: Hypothesis, joint: int) -> Hypothesis:
    return replace(effect, columns=effect.columns.in_joint(joint))


def _spread(forms: Sequence[Hypothesis], scores: Array) -> list[int]:
    """Indices of the forms of each effect that enter sets: the best, and some over the whole grid."""
    kept = list[int]()
    order = sorted(range(len(forms)), key=lambda k: forms[k].source.name)
    for _, group in groupby(order, key=lambda k: forms[k].source.name):
        some = list(group)
        best = sorted(some, key=lambda k: -scores[k])[: TUNING.forms_in_sets // 2]
        places = np.linspace(0, len(some) - 1, min(len(some), TUNING.forms_in_sets // 2)).astype(int)
        kept += sorted({*best, *(some[place] for place in places.tolist())})
    return kept


@dataclass(frozen=True, eq=False)
class JointForms:
    """Forms that act in a single joint, and the data that they explain beside other effects."""

    data: Observations
    others: Effects
    forms: Effects

    def best(self, priors: Array) -> list[tuple[int, ...]]:
        """The likeliest sets of different effects, some of each size, as indices of forms."""
        names = sorted({form.key for form in self.forms})
        owner = np.array([names.index(form.key) for form in self.forms], dtype=np.int64)
        found, sets = list[tuple[int, ...]](), np.arange(len(owner))[:, None]
        for size, count in enumerate(TUNING.proposed_sets, start=1):
            best = _best_each(owner[sets], self.scores(sets) + priors[sets].sum(axis=1))
            found += [tuple(sets[k].tolist()) for k in best[:count]]
            sets = _one_more(sets if size == 1 else sets[best[: TUNING.set_beam]], owner)
            if not len(sets):
                break
        return found

    def scores(self, sets: Integers) -> Array:
        """(K,) log p of K sets of k forms each (K, k), :eq:`set-proposal`."""
        return np.concatenate(
            [self._scores(part) for part in np.array_split(sets, -(-len(sets) // TUNING.sets_at_once))]
        )

    def _scores(self, sets: Integers) -> Array:
        products, with_effort, energy, sd, positive, count = self._products
        k, p = sets.shape[1], sd.shape[1]
        together = products[sets[:, :, None], :, sets[:, None, :], :]  # (K, k, k, p + 1, p + 1)
        gram_of_set = together[..., :p, :p].transpose(0, 1, 3, 2, 4).reshape(len(sets), k * p, k * p)
        slope = with_effort[sets][..., :p] - together[..., :p, p].sum(axis=2)
        energy = energy - 2.0 * with_effort[sets][..., p].sum(axis=1) + together[..., p, p].sum(axis=(1, 2))
        scale = sd[sets].reshape(len(sets), -1)
        scaled, slope = gram_of_set * scale[:, :, None] * scale[:, None, :], slope.reshape(len(sets), -1) * scale
        eye = np.eye(k * p)
        remainder = energy - (slope * np.linalg.solve(scaled + eye, slope[:, :, None])[:, :, 0]).sum(axis=1)
        noise = np.maximum(remainder / count, 1.0)[:, None, None]
        covariance = np.linalg.inv(scaled / noise + eye)
        noise = noise[:, 0, 0]
        mean = np.einsum("kij,kj->ki", covariance, slope) / noise[:, None]
        sides = np.log(2.0) + log_ndtr(mean / np.sqrt(np.maximum(np.diagonal(covariance, 0, 1, 2), TINY)))
        value = -0.5 * count * np.log(noise) - 0.5 * energy / noise + 0.5 * (mean * slope).sum(axis=1) / noise
        value += 0.5 * np.linalg.slogdet(covariance)[1]
        total: Array = value + (sides * positive[sets].reshape(len(sets), -1)).sum(axis=1)
        return total

    @cached_property
    def _products(self) -> tuple[Array, Array, float, Array, Mask, int]:
        """Products of columns and changes (F, p + 1, F, p + 1), with the effort (F, p + 1), its own; sd, signs; N."""
        white = ErrorModel(float(self.data.floor[0]), 0.0, TUNING.initial_time, self.data.rate)
        regression = Regression(self.data, (*self.others, *self.forms), [white])
        p = max(len(form.columns.sd) for form in self.forms)
        place = np.full((len(self.forms), p + 1), -1)  # the last index stands for missing columns
        sd, positive = np.ones((len(self.forms), p)), np.zeros((len(self.forms), p), dtype=bool)
        for k, form in enumerate(self.forms):
            inner, change = slice(0, len(form.columns.sd)), regression.change(form)
            place[k, inner], sd[k, inner], positive[k, inner] = (
                regression.place(form),
                form.columns.sd,
                form.columns.positive,
            )
            place[k, p : p + len(change)] = change
        gram, slope = regression.beyond(self.others)
        gram, slope = np.pad(gram, (0, 1)), np.append(slope, 0.0)
        energy, count = regression.misfit(self.others), int(self.data.used.sum())
        return gram[place[:, :, None, None], place], slope[place], energy, sd, positive, count


def _best_each(owners: Integers, scores: Array) -> list[int]:
    combination = np.sort(owners, axis=1)
    best = dict[tuple[int, ...], int]()
    for k in np.argsort(-scores, kind="stable").tolist():
        best.setdefault(tuple(combination[k].tolist()), k)
    return list(best.values())


def _one_more(sets: Integers, owner: Integers) -> Integers:
    every = np.arange(len(owner))
    grown = np.column_stack([np.repeat(sets, len(every), axis=0), np.tile(every, len(sets))])
    new = (owner[grown[:, :-1]] != owner[grown[:, -1:]]).all(axis=1)
    if sets.shape[1] == 1:  # each pair once
        new &= grown[:, 0] < grown[:, 1]
    return grown[new]
