"""Sets of effects that could be missing in one joint together, proposed by least squares over all forms at once.

One effect after the other goes wrong where two are missing: the first to be taken is what resembles the sum, and slow
noise stands for what is left. Here all forms that act in a joint alone are multiplied once, the model's columns taken
out as far as the earlier log allows. Pairs are tried exhaustively, larger sets by a beam. With the products Q of a
set's columns, q those with the effort, c = y'y what is left without them, D the amplitudes' prior standard deviations,
all in units of the floor (:eq:`set-proposal`)::

    log p = - N log(s^2) / 2 - (c - q' (Q + s^2 D^-2)^-1 q) / (2 s^2) - log det(1 + D Q D / s^2) / 2,

with white noise of the scale s >= 1 that is likeliest. This proposes; `regression.selection.explanation` weighs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby

import numpy as np
from scipy.special import log_ndtr

from bayesid.arrays import Array, Integers, Mask
from bayesid.regression.selection.columns import Columns
from bayesid.regression.selection.explanation import Observations
from bayesid.regression.selection.hypotheses import Hypothesis
from bayesid.regression.selection.relevance import inverse_of

_EACH = (3, 5, 4)
"""Sets of one, two and three effects that are proposed; round numbers."""
_BEAM = 24
"""Sets of different effects that larger ones are made of; a round number."""
_FORMS = 12
"""Forms of one effect that take part in sets: half of them those that explain most by themselves, half spread evenly
over its grid, for what explains most beside another effect is not known before. A round number."""
_SCORED = 16
"""Forms that are multiplied together where each is scored alone; a round number."""
_AT_ONCE = 4096
"""Sets whose products are in memory at once; a round number."""
_TINY = 1e-300
"""Guard of a root."""


def joint_sets(
    data: Observations,
    joint: int,
    others: Sequence[Columns],
    forms: Sequence[Hypothesis],
    log_prior: Callable[[Hypothesis], float],
) -> list[tuple[Hypothesis, ...]]:
    """The likeliest sets of one to three different effects, each in its best forms: some of each size.

    Of each size, for a grid that is coarse lets a set of few effects look worse than it is, and one more seem needed.

    Args:
        data: the log.
        joint: 0-based.
        others: what is added in any case.
        forms: that act in this joint alone.
        log_prior: of a form to be there.
    """
    if not forms:
        return []
    forms = sorted(forms, key=lambda form: len(form.columns.sd))
    priors = np.array([log_prior(form) for form in forms])
    parts = [forms[k : k + _SCORED] for k in range(0, len(forms), _SCORED)]
    alone = [JointForms(data, joint, others, part).scores(np.arange(len(part))[:, None]) for part in parts]
    kept = _spread(forms, np.concatenate(alone) + priors)
    return JointForms(data, joint, others, [forms[k] for k in kept]).best(priors[kept])


def _spread(forms: Sequence[Hypothesis], scores: Array) -> list[int]:
    """Indices of the forms of each kind that take part: the best, and some over the whole grid."""
    kept = list[int]()
    order = sorted(range(len(forms)), key=lambda k: forms[k].source.name)
    for _, group in groupby(order, key=lambda k: forms[k].source.name):
        some = list(group)
        best = sorted(some, key=lambda k: -scores[k])[: _FORMS // 2]
        places = np.linspace(0, len(some) - 1, min(len(some), _FORMS // 2)).astype(int)
        kept += sorted({*best, *(some[place] for place in places.tolist())})
    return kept


@dataclass(frozen=True, eq=False)
class JointForms:
    """Forms that act in one joint alone, and what they are to explain there.

    Attributes:
        data: the log.
        joint: 0-based.
        others: what is added in any case.
        forms: F of them.
    """

    data: Observations
    joint: int
    others: Sequence[Columns]
    forms: Sequence[Hypothesis]

    def best(self, priors: Array) -> list[tuple[Hypothesis, ...]]:
        """The likeliest sets of different effects, some of each size."""
        names = sorted({form.key for form in self.forms})
        owner = np.array([names.index(form.key) for form in self.forms], dtype=np.int64)
        found, sets = list[tuple[int, ...]](), np.arange(len(owner))[:, None]
        for size, count in enumerate(_EACH, start=1):
            best = _best_each(owner[sets], self.scores(sets) + priors[sets].sum(axis=1))
            found += [tuple(sets[k].tolist()) for k in best[:count]]
            sets = _one_more(sets if size == 1 else sets[best[:_BEAM]], owner)
            if not len(sets):
                break
        return [tuple(self.forms[k] for k in members) for members in found]

    def scores(self, sets: Integers) -> Array:
        """(K,) log p of K sets of k forms each (K, k), :eq:`set-proposal`."""
        return np.concatenate([self._scores(part) for part in np.array_split(sets, -(-len(sets) // _AT_ONCE))])

    def _scores(self, sets: Integers) -> Array:
        products, with_effort, left, sd, positive, count = self._products
        k, p = sets.shape[1], sd.shape[1]
        together = products[sets[:, :, None], :, sets[:, None, :], :]  # (K, k, k, p + 1, p + 1)
        own = together[..., :p, :p].transpose(0, 1, 3, 2, 4).reshape(len(sets), k * p, k * p)
        slope = with_effort[sets][..., :p] - together[..., :p, p].sum(axis=2)
        left = left - 2.0 * with_effort[sets][..., p].sum(axis=1) + together[..., p, p].sum(axis=(1, 2))
        scale = sd[sets].reshape(len(sets), -1)
        scaled, slope = own * scale[:, :, None] * scale[:, None, :], slope.reshape(len(sets), -1) * scale
        eye = np.eye(k * p)
        rest = left - _explained(scaled + eye, slope)
        noise = np.maximum(rest / count, 1.0)[:, None, None]
        covariance = np.linalg.inv(scaled / noise + eye)
        noise = noise[:, 0, 0]
        mean = np.einsum("kij,kj->ki", covariance, slope) / noise[:, None]
        sides = np.log(2.0) + log_ndtr(mean / np.sqrt(np.maximum(np.diagonal(covariance, 0, 1, 2), _TINY)))
        value = -0.5 * count * np.log(noise) - 0.5 * left / noise + 0.5 * (mean * slope).sum(axis=1) / noise
        value += 0.5 * np.linalg.slogdet(covariance)[1]
        total: Array = value + (sides * positive[sets].reshape(len(sets), -1)).sum(axis=1)
        return total

    @cached_property
    def _products(self) -> tuple[Array, Array, float, Array, Mask, int]:
        """Of columns and changes (F, p + 1, F, p + 1), with the effort (F, p + 1), its own; sd and sides (F, p); N."""
        used = self.data.used[:, self.joint]
        p = max((len(form.columns.sd) for form in self.forms), default=0)
        columns = np.zeros((len(self.forms), p + 1, int(used.sum())))
        sd, positive = np.ones((len(self.forms), p)), np.zeros((len(self.forms), p), dtype=bool)
        for k, form in enumerate(self.forms):
            own = form.columns
            if self.joint in own.rows:
                columns[k, : len(own.sd)] = own.rows[self.joint][used].T
            if self.joint in own.shift:
                columns[k, p] = own.shift[self.joint][used]
            sd[k, : len(own.sd)], positive[k, : len(own.sd)] = own.sd, own.positive
        model, effort, inverse = self._without(used)
        flat = columns.reshape(-1, columns.shape[2]) / self.data.floor[self.joint]
        across, of_effort = flat @ model, model.T @ effort
        products = flat @ flat.T - across @ inverse @ across.T
        with_effort = flat @ effort - across @ (inverse @ of_effort)
        left = float(effort @ effort - of_effort @ inverse @ of_effort)
        size = columns.shape[:2]
        return products.reshape(*size, *size), with_effort.reshape(size), left, sd, positive, len(effort)

    def _without(self, used: Mask) -> tuple[Array, Array, Array]:
        """(M, m) columns of the model and of others, (M,) the effort less what is expected of them, and (m, m) P."""
        floor, known = self.data.floor[self.joint], self.data.information
        here = [columns for columns in self.others if self.joint in columns.rows]
        model = np.hstack([self.data.columns[used, self.joint], *(columns.rows[self.joint][used] for columns in here)])
        expected = inverse_of(known.hessian) @ known.gradient
        effort = self.data.effort[used, self.joint] - model[:, : len(expected)] @ expected
        for columns in self.others:
            if self.joint in columns.shift:
                effort = effort - columns.shift[self.joint][used]
        hessian = np.diag(np.concatenate([np.zeros(len(expected)), *(columns.sd**-2.0 for columns in here)]))
        hessian[: len(expected), : len(expected)] += known.hessian
        model, effort = model / floor, effort / floor
        return model, effort, inverse_of(hessian + model.T @ model)


def _explained(matrix: Array, slope: Array) -> Array:
    """(K,) slope' matrix^-1 slope of K of each."""
    solved = np.linalg.solve(matrix, slope[:, :, None])[:, :, 0]
    explained: Array = (slope * solved).sum(axis=1)
    return explained


def _best_each(owners: Integers, scores: Array) -> list[int]:
    """The best set of each combination of effects (K, k), best first."""
    combination = np.sort(owners, axis=1)
    best = dict[tuple[int, ...], int]()
    for k in np.argsort(-scores, kind="stable").tolist():
        best.setdefault(tuple(combination[k].tolist()), k)
    return list(best.values())


def _one_more(sets: Integers, owner: Integers) -> Integers:
    """(K', k + 1) sets with one more form each, of another effect."""
    every = np.arange(len(owner))
    grown = np.column_stack([np.repeat(sets, len(every), axis=0), np.tile(every, len(sets))])
    new = (owner[grown[:, :-1]] != owner[grown[:, -1:]]).all(axis=1)
    if sets.shape[1] == 1:  # each pair once
        new &= grown[:, 0] < grown[:, 1]
    return grown[new]
