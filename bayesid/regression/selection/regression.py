"""Regression of a log on a model's columns and on groups of columns, one group for each effect.

With known signs, the efforts of joint j are  e_j = Y_j beta + Z_j alpha + d_j + error  (:eq:`effects`). The error is
that of `error_model`, whitened by W_j. The earlier log gives the prior of beta (`bayesid.regression.knowledge`). alpha
is normal about zero with the sd of its effect, restricted to one sign if that is known. With A the matrix of both,
:eq:`evidence`::

    log p(e) = sum_j log p(W_j (e_j - d_j - A_j x)) - (x - x0)' L (x - x0) / 2 + log det(D) / 2 - log det(H) / 2 + c

at the best x, H = L + sum_j A_j' W_j' W_j A_j (MacKay 2003, chapter 28; exact for normal errors of given covariance).
The error's own parameters maximise the likelihood. If they exceed the noise floor, each joint costs log N.

All columns are whitened and multiplied once, fold by fold. The gain of a group given others then needs few operations
(:eq:`forward-gain`)::

    gain = q' (Q + L)^-1 q / 2 - log det(1 + L^-1 Q) / 2,   Q = G_cc - G_cS P G_Sc,   q = g_c - G_cS P g_S,

with G, g the products of whitened columns and efforts, P the inverse of G_SS with the prior of the set before, and L
the precisions of the group (Tipping and Faul 2003, for groups of columns). A fixed change d of an effect is a column
with amplitude one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr

from bayesid.arrays import TINY, Array, Integers
from bayesid.regression.knowledge import inverse_root
from bayesid.regression.selection.columns import NO_COLUMNS, Columns, by_fold, rows_of_blocks, together
from bayesid.regression.selection.cross_validation import CrossValidation
from bayesid.regression.selection.error_model import ErrorModel, alike, fit_error
from bayesid.regression.selection.fitted_effects import FittedEffects, JudgedJoint, Observations
from bayesid.regression.selection.hypotheses import Hypothesis
from bayesid.regression.tuning import TUNING

Effects = Sequence[Hypothesis]


class _Solved(NamedTuple):
    places: Integers  # (p,) of the columns used
    best: Array  # (m,) coefficients and amplitudes, one for changes, zero for unused columns
    root: Array  # (p, p) R with R'R = H^-1
    volume: float  # log det(H) / 2


@dataclass(frozen=True, eq=False)
class Regression:
    """A log, a model's columns and those of effects; prepared once, then evaluated for many sets of effects."""

    data: Observations  #: the log
    effects: Effects  #: the groups of columns, linear about their own numbers; sets are chosen from them
    errors: Sequence[ErrorModel]  #: of each joint; they weigh the samples
    uncertain: Columns = NO_COLUMNS  #: further columns of model error, in every set
    #: whether predictions of held-back blocks use these too: only the prior distinguishes an offset from a large error
    #: of the geometry, and predictions do not use it
    predicting: bool = True
    # by joint, cached: products with the shape of the error, columns of the effects, and their transposed filter
    _products: dict[int, tuple[object, Array]] = field(default_factory=dict, repr=False)
    _columns: dict[int, tuple[Integers, Array]] = field(default_factory=dict, repr=False)
    _pulled: dict[int, tuple[Integers, Array]] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def of(cls, fitted_effects: FittedEffects) -> Regression:
        """With the columns of a fit, samples weighed by the errors that it leaves."""
        return cls(fitted_effects.data, fitted_effects.effects, fitted_effects.errors, fitted_effects.uncertain)

    @cached_property
    def _ends(self) -> tuple[int, int]:
        """End of the model's columns, and of those in every set."""
        r = self.data.columns.shape[2]
        return r, r + len(self.uncertain.sd)

    @cached_property
    def _places(self) -> dict[int, tuple[Integers, Integers]]:
        """By effect id: indices of its columns, and of its change if any."""
        places, end = {}, self._ends[1]
        for effect in self.effects:
            columns = effect.columns
            indices = np.arange(end, end + len(columns.sd))
            change = np.arange(end + len(indices), end + len(indices) + bool(columns.shift))
            places[id(effect)], end = (indices, change), end + len(indices) + len(change)
        return places

    def place(self, effect: Hypothesis) -> Integers:
        """(p,) indices of an effect's columns."""
        return self._places[id(effect)][0]

    def change(self, effect: Hypothesis) -> Integers:
        """(1,) index of an effect's fixed change; empty if it has none."""
        return self._places[id(effect)][1]

    @cached_property
    def _known(self) -> tuple[Array, Array]:
        """(m, m) prior precision of coefficients and amplitudes, and (m,) its product with the mean."""
        (r, always), known = self._ends, self.data.information
        size = always + sum(len(amplitudes) + len(change) for amplitudes, change in self._places.values())
        diagonal = np.zeros(size)
        diagonal[r:always] = 1.0 / self.uncertain.sd**2
        for effect in self.effects:
            diagonal[self.place(effect)] = 1.0 / effect.columns.sd**2
        precision, weighted_mean = np.diag(diagonal), np.zeros(size)
        precision[:r, :r], weighted_mean[:r] = known.hessian, known.gradient
        return precision, weighted_mean

    def _shown(self, joint: int) -> tuple[Integers, Array]:
        """Indices (p,) and columns (N, p) of effects and changes that act in a joint."""
        if joint not in self._columns:
            index, parts = [np.zeros(0, dtype=np.int64)], [np.zeros((len(self.data.effort), 0))]
            for effect in self.effects:
                (amplitudes, change), columns = self._places[id(effect)], effect.columns
                if joint in columns.rows:
                    index.append(amplitudes)
                    parts.append(columns.rows[joint])
                if joint in columns.shift:
                    index.append(change)
                    parts.append(columns.shift[joint][:, None])
            self._columns[joint] = np.concatenate(index), np.asfortranarray(np.concatenate(parts, axis=1))
        return self._columns[joint]

    def _always(self, joint: int) -> Integers:
        r, always = self._ends
        beside = np.arange(r, always) if joint in self.uncertain.rows else np.zeros(0, dtype=np.int64)
        return np.concatenate([self.data.whitening.bare(joint)[0], beside])

    def _of_joint(self, joint: int) -> Array:
        """(folds, m + 1, m + 1) products of a joint's innovations, the effort's last."""
        error, used = self.errors[joint], self.data.used[:, joint]
        if joint in self._products and self._products[joint][0] == error.shape:
            return self._products[joint][1]
        size = len(self._known[1])
        index, columns = self._shown(joint)
        index, always = np.append(index, size), self._always(joint)
        white = error.whiten(np.column_stack([columns, self.data.effort[:, joint]]), used)
        of_always, products = self.data.whitening.always(joint, error, self.uncertain)
        across = by_fold(of_always, white, error.rate)
        every = np.zeros((TUNING.folds, size + 1, size + 1))
        every[:, always[:, None], always] = products
        every[:, always[:, None], index], every[:, index[:, None], always] = across, across.transpose(0, 2, 1)
        every[:, index[:, None], index] = by_fold(white, white, error.rate)
        self._products[joint] = error.shape, every
        return every

    @cached_property
    def _by_fold(self) -> Array:
        """(folds, m + 1, m + 1) weighted sums over all joints."""
        size = len(self._known[1]) + 1
        products = np.zeros((TUNING.folds, size, size))
        for j, error in enumerate(self.errors):
            products += error.scale**-2.0 * self._of_joint(j)
        return products

    @cached_property
    def _all(self) -> Array:
        return np.asarray(self._by_fold.sum(axis=0))

    @property
    def hessian(self) -> Array:
        """(m, m) G, products of the whitened columns of all joints and folds."""
        return self._all[:-1, :-1]

    @property
    def gradient(self) -> Array:
        """(m,) g, their products with the efforts."""
        return self._all[:-1, -1]

    def indices(self, chosen: Effects, *, uncertain: bool = True) -> Integers:
        """Indices of the columns in every set, with or without uncertain ones, and of those of some effects."""
        return np.concatenate(
            [np.arange(self._ends[int(uncertain)]), *(self.place(effect) for effect in chosen)]
        ).astype(int)

    def _solved(self, products: Array, chosen: Effects, *, uncertain: bool = True) -> _Solved:
        """Solution of the normal equations of a set, with changes subtracted."""
        (precision, weighted_mean), index = self._known, self.indices(chosen, uncertain=uncertain)
        changes = [change for effect in chosen for change in self.change(effect).tolist()]
        slope = products[:-1, -1] + weighted_mean - products[:-1, changes].sum(axis=1)
        root, volume = inverse_root(products[np.ix_(index, index)] + precision[np.ix_(index, index)])
        best = np.zeros(len(weighted_mean))
        best[index] = root.T @ (root @ slope[index])
        best[changes] = 1.0
        return _Solved(index, best, root, volume)

    def best(self, chosen: Effects) -> Array:
        """(m,) coefficients and amplitudes of a set, one for changes, zero for unused columns."""
        return self._solved(self._all, chosen).best

    def beyond(self, chosen: Effects) -> tuple[Array, Array]:
        """(m, m) products of all columns' residuals after a set, and (m,) those with the efforts' residuals."""
        found = self._solved(self._all, chosen)
        seen = self.hessian[:, found.places] @ found.root.T
        return self.hessian - seen @ seen.T, self.gradient - self.hessian @ found.best

    def gains(self, chosen: Effects, tried: Effects) -> Array:
        """Log Bayes factors of effects on top of a set (:eq:`forward-gain`)."""
        gram, slope = self.beyond(chosen)
        gains = np.empty(len(tried))
        for k, effect in enumerate(tried):
            columns = np.concatenate(self._places[id(effect)])
            gains[k] = integrated(gram[None, columns[:, None], columns], slope[None, columns], [effect.columns])[0][0]
        return gains

    def misfit(self, chosen: Effects) -> float:
        """Weighted squared residual of a set plus the misfit to the prior."""
        best, r = self.best(chosen), self._ends[0]
        squares = (self._residual_of(best) ** 2).sum(axis=0) @ np.array([error.scale**-2.0 for error in self.errors])
        of_prior = float(np.diag(self._known[0])[r:] @ best[r:] ** 2)
        return float(squares) + self.data.information.misfit(best[:r]) + of_prior

    def cross_validation(self, chosen: Effects) -> CrossValidation:
        """Every block predicted by a fit of a set to the other folds."""
        return self.held_back_each([chosen])[0]

    def held_back_each(self, sets: Sequence[Effects]) -> list[CrossValidation]:
        """The same for k sets."""
        fits = [
            np.stack([self._solved(products, some, uncertain=self.predicting).best for some in sets], axis=1)
            for products in self._all - self._by_fold
        ]
        blocks, used = rows_of_blocks(len(self.data.effort), self.data.rate), self.data.used
        residuals = (self._residual_each(fits[b % TUNING.folds], rows) for b, rows in enumerate(blocks))
        squares = np.stack([np.einsum("ijk,ijk->kj", some, some) for some in residuals], axis=1)
        counts = np.stack([used[rows].sum(axis=0) for rows in blocks])
        return [CrossValidation(of_set, counts) for of_set in squares]

    def residual(self, chosen: Effects) -> Array:
        """(N, n) residual of a set, N m."""
        return self._residual_of(self.best(chosen))

    def _residual_of(self, best: Array) -> Array:
        return np.asfortranarray(self._residual_each(best[:, None])[:, :, 0])

    def _residual_each(self, best: Array, rows: slice = slice(None)) -> Array:
        """(N', n, k) residuals of coefficients and amplitudes (m, k) on some rows, N m, zero where not used."""
        (r, always), counting = self._ends, np.asarray(best.any(axis=1))
        residual = np.repeat(self.data.effort[rows, :, None], best.shape[1], axis=2)
        for j in range(residual.shape[1]):
            parts = [self.data.whitening.bare(j), self._shown(j)]
            if j in self.uncertain.rows:
                parts.append((np.arange(r, always), self.uncertain.rows[j]))
            for index, columns in parts:
                counts = counting[index]
                some = columns[rows] if counts.all() else columns[rows][:, counts]
                residual[:, j] -= some @ best[index[counts]]
        return residual * self.data.used[rows, :, None]

    def weighed(self, errors: Sequence[ErrorModel]) -> Regression:
        """The same with samples weighed by other errors."""
        return replace(self, errors=errors)

    def weighed_by(self, chosen: Effects) -> Regression:
        """The same with samples weighed by the errors that a set leaves."""
        residual, used = self.residual(chosen), self.data.used
        return self.weighed(
            [fit_error(residual[:, j], used[:, j], self.data.rate)[0] for j in range(residual.shape[1])]
        )

    def with_forms(self, forms: Mapping[int, Hypothesis]) -> Regression:
        """The same with other forms of some effects, by the ids of the old ones."""
        if not forms:
            return self
        return replace(
            self, effects=[forms.get(id(effect), effect) for effect in self.effects], _products={}, _columns={}
        )

    @cached_property
    def _whole(self) -> _Solved:
        return self._solved(self._all, self.effects)

    @cached_property
    def fitted_effects(self) -> FittedEffects:
        """The fit of all effects, with its own error models."""
        index, best, root, volume = self._whole
        spread, amplitude = np.zeros_like(best), index >= self._ends[0]  # sd of coefficients without data overflows
        spread[index[amplitude]] = np.sqrt(np.sum(root[:, amplitude] ** 2, axis=0))
        places = [self.place(effect) for effect in self.effects]
        return FittedEffects(
            data=self.data,
            effects=tuple(self.effects),
            uncertain=self.uncertain,
            beta=best[: self._ends[0]],
            amplitudes=tuple(best[place] for place in places),
            sd=tuple(spread[place] for place in places),
            residual=self._residual,
            judged=self._judged(self._residual),
            log_prior=self._log_prior(best[index], spread[index]) - volume,
            root=root,
        )

    @cached_property
    def _residual(self) -> Array:
        return self._residual_of(self._whole.best)

    def _judged(self, residual: Array) -> tuple[JudgedJoint, ...]:
        """Residuals by joint; error models of the reference are kept where the same effects act."""
        before, acting = self.data.reference, set[int]()
        if before is not None:
            known, here = ({id(effect.columns): effect for effect in some} for some in (before.effects, self.effects))
            changed = (hypothesis for key, hypothesis in (known | here).items() if (key in known) != (key in here))
            acting = set[int]().union(*(hypothesis.columns.joints for hypothesis in changed))
        judged = []
        for j, (white, coloured) in enumerate(self.data.limits.tolist()):
            kept = None if before is None or j in acting else before.judged[j]
            judged.append(JudgedJoint(residual[:, j], self.data.used[:, j], self.data.rate, (white, coloured), kept))
        return tuple(judged)

    def _log_prior(self, best: Array, sd: Array) -> float:
        """Log prior density of coefficients and amplitudes: earlier log, normal priors of the effects, known signs."""
        r, columns = self._ends[0], [self.uncertain, *(effect.columns for effect in self.effects)]
        precision = np.concatenate([1.0 / part.sd**2 for part in columns])
        positive = np.concatenate([part.positive for part in columns])
        amplitudes = best[r:]
        misfit = self.data.information.misfit(best[:r]) + float(amplitudes @ (precision * amplitudes))
        sides = float(np.sum(np.log(2.0) + log_ndtr(amplitudes[positive] / sd[r:][positive])))
        return 0.5 * float(np.log(precision).sum()) - 0.5 * misfit + sides

    def screened(self, group: Sequence[Columns]) -> tuple[Array, Array]:
        """Gains in log evidence of k effects with p amplitudes each, in the same joints.

        Returns:
            (k,) gains, and (k,) expected gains at amplitudes of one prior standard deviation.
        """
        return integrated(*self.curvature(group), group)

    def curvature(self, group: Sequence[Columns]) -> tuple[Array, Array]:
        """(k, P, P) second and (k, P) first derivatives of k effects' gains by their amplitudes, at zero.

        All other columns are integrated out. A change is a last amplitude, if any of the effects has one.
        """
        index, _, root, _ = self._whole
        k, size = len(group), len(group[0].sd) + any(columns.shift for columns in group)
        across = np.zeros((k, size, len(self._known[1])))
        gram, slope = np.zeros((k, size, size)), np.zeros((k, size))
        for j in sorted(set[int]().union(*(columns.joints for columns in group))):
            error, weight = self.errors[j], self.errors[j].scale ** -2.0
            stack, kept = together(group, j)
            products, of_always = self.data.whitening.group(stack, j, error, self.uncertain, keep=kept)
            others, pulled = self._pulled_back(j)
            with_others, here = stack @ pulled, stack.shape[1]
            across[:, :here, self._always(j)] += weight * of_always
            across[:, :here, others] += weight * with_others[:, :, :-1]
            gram[:, :here, :here] += weight * products
            slope[:, :here] += weight * with_others[:, :, -1]
        seen = across[:, :, index] @ root.T
        return gram - seen @ seen.transpose(0, 2, 1), slope

    def _pulled_back(self, joint: int) -> tuple[Integers, Array]:
        """Indices (p,) of a joint's columns, and (N, p + 1) their transposed filter, which multiplies other columns.

        The last column is for products with the residual.
        """
        if joint not in self._pulled:
            error, used = self.errors[joint], self.data.used[:, joint]
            index, columns = self._shown(joint)
            white = error.whiten(np.column_stack([columns, self._residual[:, joint]]), used)
            self._pulled[joint] = index, self.data.whitening.pulled_back(white, joint, error)
        return self._pulled[joint]


def explain(
    data: Observations, effects: Effects, start: FittedEffects | None = None, uncertain: Columns = NO_COLUMNS
) -> FittedEffects:
    """Fit of some effects, with error models refitted from those of another fit or the reference."""
    begin = data.reference if start is None else start
    regression = Regression(data, effects, plain_errors(data) if begin is None else begin.errors, uncertain)
    for _ in range(TUNING.refits):
        regression = regression.weighed(regression.fitted_effects.errors)
        if alike(regression.errors, regression.fitted_effects.errors):
            break
    return regression.fitted_effects


def plain_errors(data: Observations) -> tuple[ErrorModel, ...]:
    """Error models of white noise at its limit, with the least coloured part."""
    share, time = TUNING.initial_coloured, TUNING.initial_time
    return tuple(ErrorModel(white, share * white, time, data.rate) for white in data.limits[:, 0])


def integrated(gram: Array, slope: Array, effects: Sequence[Columns]) -> tuple[Array, Array]:
    """Gains with the amplitudes integrated out over their priors, and expected gains at usual amplitudes.

    Args:
        gram: (k, P, P) second derivatives by the p amplitudes and that of a change; all others integrated out.
        slope: (k, P) first derivatives at zero.
        effects: k effects.
    """
    sd = np.stack([effect.sd for effect in effects])
    p = sd.shape[1]
    base = slope[:, p:].sum(axis=1) - 0.5 * gram[:, p:, p:].sum(axis=(1, 2))  # of changes
    if not p:
        return base, np.abs(base)
    gram, slope = gram[:, :p, :p], (slope[:, :p] - gram[:, :p, p:].sum(axis=2)) * sd
    scaled = gram * sd[:, :, None] * sd[:, None, :] + np.eye(p)
    covariance, log_det = np.linalg.inv(scaled), np.linalg.slogdet(scaled)[1]
    best = (covariance @ slope[:, :, None])[:, :, 0]
    spread = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), TINY))
    positive = np.stack([effect.positive for effect in effects])
    sides = np.sum(np.log(2.0) + log_ndtr(best / spread), axis=1, where=positive) if positive.any() else 0.0
    gain = base + 0.5 * np.sum(best * slope, axis=1) - 0.5 * log_det + sides
    return gain, 0.5 * (np.trace(scaled, axis1=1, axis2=2) - p) - 0.5 * log_det
