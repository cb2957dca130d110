"""Forward selection by evidence over products of columns: many effects, one after the other, in little time.

All candidates are whitened together and multiplied once; what a candidate adds to a set is then linear algebra of its
own few columns (:eq:`forward-gain`)::

    gain = q' (Q + L)^-1 q / 2 - log det(1 + L^-1 Q) / 2,   Q = G_cc - G_cS P G_Sc,   q = g_c - G_cS P g_S,

with G, g the products of whitened columns and efforts, P the inverse of G_SS with what is known of the set before
(an earlier log's information of coefficients, amplitudes' own prior precisions), and L the precisions of the
candidate (Tipping and Faul 2003, for groups of columns). Noise is estimated anew, and the joints that
changed are whitened anew, whenever an effect has been added.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.special import log_ndtr

from bayesid.arrays import Array, Integers, Mask
from bayesid.regression.knowledge import RIDGE, inverse_of
from bayesid.regression.selection.columns import NO_COLUMNS, Columns
from bayesid.regression.selection.error_model import ErrorModel, fit_error
from bayesid.regression.selection.explanation import Observations
from bayesid.regression.selection.hypotheses import EffectKey, Hypothesis
from bayesid.regression.tuning import TUNING

SHORTEST_LOG = TUNING.folds * TUNING.shortest_block
"""s: a log that does not fill one block a fold tells nothing surely."""


@dataclass(frozen=True)
class HeldBackErrors:
    """Sums of squared errors (blocks, n), (N m)^2, on held-back blocks, and their numbers of samples (blocks, n)."""

    squares: Array
    counts: Array

    @property
    def rms(self) -> Array:
        """(n,) N m."""
        return np.sqrt(self.squares.sum(axis=0) / np.maximum(self.counts.sum(axis=0), 1))

    def rise(self, before: HeldBackErrors) -> tuple[Array, Array]:
        """(n,) rise of the mean squared error over that before, and (n,) its standard error over the blocks."""
        change, count = self.squares - before.squares, np.maximum(self.counts.sum(axis=0), 1)
        return change.sum(axis=0) / count, change.std(axis=0) * np.sqrt(len(change)) / count

    def surely_above(self, level: Array) -> Mask:
        """(n,) whether the RMS error is above a level (n,), N m, by more than its scatter over the blocks explains."""
        rise, error = self.rise(HeldBackErrors(self.counts * level**2, self.counts))
        above: Mask = rise > TUNING.sure * error
        return above

    def surely_grown(self, before: HeldBackErrors) -> Mask:
        """(n,) whether the mean squared error has risen: by as much, and as surely, as an effect must lower it."""
        rise, error = self.rise(before)
        grown: Mask = rise > np.maximum(TUNING.help * before.rms**2, TUNING.sure * error)
        return grown


def blocks_of(duration: float) -> int:
    """How many blocks a log of some seconds is cut into: fewer where they would be too short, but one a fold."""
    return int(np.clip(duration / TUNING.shortest_block, TUNING.folds, TUNING.blocks))


@dataclass(frozen=True, eq=False)
class Candidate:
    """What may explain efforts, and the place of its columns among all.

    The change that it makes by itself has an index too; -1 where it makes none.
    """

    hypothesis: Hypothesis
    place: slice
    change: int = -1

    @property
    def columns(self) -> Columns:
        """What it adds to the efforts."""
        return self.hypothesis.columns

    @property
    def key(self) -> EffectKey:
        """Effect and joints."""
        return self.hypothesis.key

    @property
    def own(self) -> Integers:
        """Indices of its columns."""
        return np.arange(self.place.start, self.place.stop)


@dataclass(frozen=True, eq=False)
class _Solved:
    """The least squares of some of the m columns: G, what is known before, g with what is known, and P."""

    hessian: Array
    precision: Array
    slope: Array
    index: Integers
    changes: Integers
    inverse: Array

    @cached_property
    def best(self) -> Array:
        """(m,) coefficients and amplitudes, one for changes, zero for what is not chosen."""
        best = np.zeros(len(self.slope))
        best[self.changes] = 1.0
        best[self.index] = self.inverse @ self.slope[self.index]
        return best

    def best_with(self, more: Candidate) -> Array:
        """(m,) the same with one more candidate: its own few columns are all that is solved for anew."""
        own, slope, best = more.own, self.slope, self.best.copy()
        if more.change >= 0:
            slope = slope - self.hessian[:, more.change]
            best[self.index] = self.inverse @ slope[self.index]
            best[more.change] = 1.0
        if not len(own):
            return best
        across = self.hessian[np.ix_(own, self.index)]
        moved = across @ self.inverse
        inner = self.hessian[np.ix_(own, own)] + np.diag(self.precision[own])
        inner += RIDGE * np.diag(np.diag(inner)) - moved @ across.T
        best[own] = np.linalg.solve(inner, slope[own] - across @ best[self.index])
        best[self.index] -= moved.T @ best[own]
        return best


class Products:
    """Whitened columns of model and candidates, multiplied: G and g, joint by joint.

    Args:
        data: what is to be explained.
        hypotheses: the candidates, linear about their own numbers.
        errors: of each joint.
        uncertain: columns that the model may be wrong by in any case, beside those of every set of candidates.
        predicting: whether these may take part in predictions of held-back blocks: what evidence tells from them by
            their prior alone, such as an offset from a large error of the geometry, predictions do not.

    Attributes:
        candidates: the hypotheses and their places among all m columns.
        blocks: that the log is cut into.
        hessian: (m, m) G of all joints and folds.
        gradient: (m,) g of all joints and folds.
    """

    def __init__(
        self,
        data: Observations,
        hypotheses: Sequence[Hypothesis],
        errors: list[ErrorModel],
        uncertain: Columns = NO_COLUMNS,
        predicting: bool = True,
    ) -> None:
        self.data, self.hypotheses, self.errors = data, hypotheses, errors
        self.uncertain, self.predicting = uncertain, predicting
        r = self.data.columns.shape[2]
        self._always = end = r + len(self.uncertain.sd)
        self.candidates = list[Candidate]()
        for hypothesis in self.hypotheses:
            start, end = end, end + len(hypothesis.columns.sd)
            change = end if hypothesis.columns.shift else -1
            self.candidates.append(Candidate(hypothesis, slice(start, end), change))
            end += change >= 0
        known, own = self.data.information, np.zeros(end)
        own[r : self._always] = 1.0 / self.uncertain.sd**2
        for candidate in self.candidates:
            own[candidate.place] = 1.0 / candidate.columns.sd**2
        self._precision, self._known = np.diag(own), np.zeros(end)
        self._precision[:r, :r], self._known[:r] = known.hessian, known.gradient
        samples = len(self.data.used)
        self.blocks = blocks_of(samples / self.data.rate)
        starts = (-(-np.arange(self.blocks + 1) * samples // self.blocks)).tolist()
        self._rows = [slice(start, stop) for start, stop in pairwise(starts)]
        self._columns = [self._of_joint(j) for j in range(len(self.errors))]
        products = [self._multiplied(j) for j in range(len(self.errors))]
        self._hessian, self._gradient = [p[0] for p in products], [p[1] for p in products]
        self._add_up()

    def _add_up(self) -> None:
        weights = [error.scale**-2.0 for error in self.errors]
        by_fold = [np.tensordot(weights, products, axes=1) for products in (self._hessian, self._gradient)]
        self.hessian, self.gradient = (products.sum(axis=0) for products in by_fold)
        self._by_others = self.hessian - by_fold[0], self.gradient - by_fold[1]

    def _of_joint(self, joint: int) -> tuple[Integers, Array]:
        """Indices (m,) of the columns that show in a joint, and (N, m) these columns."""
        r, used, own = self.data.columns.shape[2], self.data.used[:, joint, None], self.data.columns[:, joint]
        shows = np.flatnonzero(own.any(axis=0))  # no link shows in the joints behind it
        index, parts = [shows], [own[:, shows]]
        if joint in self.uncertain.rows:
            index.append(np.arange(r, self._always))
            parts.append(self.uncertain.rows[joint] * used)
        for candidate in self.candidates:
            columns = candidate.columns
            if joint in columns.rows:
                index.append(candidate.own)
                parts.append(columns.rows[joint] * used)
            if candidate.change >= 0 and joint in columns.shift:
                index.append(np.array([candidate.change]))
                parts.append(columns.shift[joint][:, None] * used)
        return np.concatenate(index), np.asfortranarray(np.concatenate(parts, axis=1))

    def _multiplied(self, joint: int) -> tuple[Array, Array]:
        index, columns = self._columns[joint]
        both = np.column_stack([columns, self.data.effort[:, joint]])
        white = self.errors[joint].whiten(both, self.data.used[:, joint])
        size = len(self._known)
        hessian, gradient = np.zeros((TUNING.folds, size, size)), np.zeros((TUNING.folds, size))
        products = np.zeros((TUNING.folds, white.shape[1], white.shape[1]))
        for block, place in enumerate(self._rows):
            rows = white[place]
            products[block % TUNING.folds] += rows.T @ rows
        hessian[:, index[:, None], index], gradient[:, index] = products[:, :-1, :-1], products[:, :-1, -1]
        return hessian, gradient

    def indices(self, chosen: Sequence[Candidate], *, uncertain: bool = True) -> Integers:
        """Of the columns that are always there, uncertain ones among them or not, and of those of some candidates."""
        always = self._always if uncertain else self.data.columns.shape[2]
        return np.concatenate([np.arange(always), *(c.own for c in chosen)]).astype(int)

    def best(self, chosen: Sequence[Candidate]) -> Array:
        """(m,) coefficients and amplitudes, one for changes, zero for what is not chosen."""
        return self._solved(self.hessian, self.gradient, chosen).best

    def _solved(
        self, hessian: Array, gradient: Array, chosen: Sequence[Candidate], *, uncertain: bool = True
    ) -> _Solved:
        """Least squares of the columns of some candidates for given G and g."""
        index = self.indices(chosen, uncertain=uncertain)
        changes = np.array([c.change for c in chosen if c.change >= 0], dtype=np.int64)
        inverse = inverse_of(hessian[np.ix_(index, index)] + self._precision[np.ix_(index, index)])
        slope = gradient + self._known - hessian[:, changes].sum(axis=1)
        return _Solved(hessian, np.diag(self._precision), slope, index, changes, inverse)

    def residual(self, chosen: Sequence[Candidate]) -> Array:
        """(N, n) what these leave, N m."""
        best, left = self.best(chosen)[:, None], np.empty_like(self.data.effort)
        for j in range(left.shape[1]):
            index, columns = self._showing(j, best)
            left[:, j] = self.data.effort[:, j] - columns[0] @ best[index[0], 0] - columns[1] @ best[index[1], 0]
        return left * self.data.used

    def _showing(self, joint: int, best: Array) -> tuple[list[Integers], list[Array]]:
        """Which columns count in a joint, those that are always there and others, and both kinds of columns."""
        index, columns = self._columns[joint]
        counts: Mask = np.any(best.reshape(len(best), -1), axis=1)[index]
        always = int(np.searchsorted(index, self._always))
        last = int(np.flatnonzero(counts[:always]).max(initial=-1)) + 1
        others = np.asarray(always + np.flatnonzero(counts[always:]), dtype=np.int64)
        return [index[:last], index[others]], [columns[:, :last], columns[:, others]]

    def held_back(self, chosen: Sequence[Candidate]) -> HeldBackErrors:
        """Every block predicted by a fit of some candidates to the folds that it is not in."""
        return self.held_back_each([chosen])[0]

    def held_back_each(
        self, sets: Sequence[Sequence[Candidate]], base: Sequence[Candidate] | None = None
    ) -> list[HeldBackErrors]:
        """The same of k sets of candidates, which takes far less time than one by one.

        Faster still where most of the sets are a base and one more at the end.
        """
        best = np.stack([self._without_fold(*others, sets, base) for others in zip(*self._by_others, strict=True)])
        squares = np.empty((self.blocks, self.data.effort.shape[1], len(sets)))
        for j in range(squares.shape[1]):
            index, columns = self._showing(j, best.transpose(1, 0, 2))
            used = self.data.used[:, j]
            for b, rows in enumerate(self._rows):
                fold = best[b % TUNING.folds]
                left = self.data.effort[rows, j, None] - columns[0][rows] @ fold[index[0]]
                left = (left - columns[1][rows] @ fold[index[1]]) * used[rows, None]
                squares[b, j] = np.einsum("ik,ik->k", left, left)
        counts = np.stack([self.data.used[rows].sum(axis=0) for rows in self._rows])
        return [HeldBackErrors(squares[:, :, k].copy(), counts) for k in range(len(sets))]

    def _without_fold(
        self, hessian: Array, gradient: Array, sets: Sequence[Sequence[Candidate]], base: Sequence[Candidate] | None
    ) -> Array:
        """(m, k) coefficients and amplitudes of k sets of candidates, from given G and g."""
        of_base = None if base is None else self._solved(hessian, gradient, base, uncertain=self.predicting)
        best = np.empty((len(gradient), len(sets)))
        for k, some in enumerate(sets):
            if of_base is not None and base is not None and _is_one_more(some, base):
                best[:, k] = of_base.best_with(some[-1])
            else:
                best[:, k] = self._solved(hessian, gradient, some, uncertain=self.predicting).best
        return best

    def with_forms(
        self, forms: Mapping[int, Hypothesis], chosen: Sequence[Candidate]
    ) -> tuple[Products, list[Candidate]]:
        """The same with other forms of some hypotheses, by the ids of the old ones, and the chosen among them."""
        if not forms:
            return self, list(chosen)
        hypotheses = [forms.get(id(h), h) for h in self.hypotheses]
        products = Products(self.data, hypotheses, self.errors, self.uncertain, self.predicting)
        of_old = {id(old): new for old, new in zip(self.hypotheses, products.candidates, strict=True)}
        return products, [of_old[id(candidate.hypothesis)] for candidate in chosen]

    def with_noise_of(self, chosen: Sequence[Candidate], joints: Iterable[int]) -> None:
        """Whitens some (0-based) joints anew, by the errors that a set of candidates leaves there."""
        residual = self.residual(chosen)
        for j in joints:
            before = self.errors[j]
            self.errors[j] = fit_error(residual[:, j], self.data.used[:, j], self.data.rate)[0]
            if self.errors[j].shape != before.shape:
                self._hessian[j], self._gradient[j] = self._multiplied(j)
        self._add_up()

    def gains(self, chosen: Sequence[Candidate], tried: Sequence[Candidate]) -> Array:
        """Log Bayes factors of candidates on top of a set (:eq:`forward-gain`)."""
        index, hessian, gradient = self.indices(chosen), self.hessian, self.gradient
        solved = self._solved(hessian, gradient, chosen)
        best, inverse = solved.best, solved.inverse
        gains = np.empty(len(tried))
        for k, candidate in enumerate(tried):
            own = candidate.own if candidate.change < 0 else np.append(candidate.own, candidate.change)
            across = hessian[np.ix_(own, index)]
            inner = hessian[np.ix_(own, own)] - across @ inverse @ across.T
            slope = gradient[own] - hessian[own] @ best
            gains[k] = _gain(inner, slope, candidate.columns)
        return gains


def _gain(inner: Array, slope: Array, columns: Columns) -> float:
    """Log Bayes factor of some columns, and of a change if there is one more than these (:eq:`forward-gain`)."""
    sd, p, base = columns.sd, len(columns.sd), 0.0
    if len(slope) > p:
        base = float(slope[p] - 0.5 * inner[p, p])
        slope = slope[:p] - inner[:p, p]
    scaled = inner[:p, :p] * np.outer(sd, sd) + np.eye(p)
    covariance = np.linalg.inv(scaled)
    amplitude = covariance @ (slope * sd)
    outside = amplitude[columns.positive] / np.sqrt(np.diag(covariance))[columns.positive]
    sides = float(np.sum(np.log(2.0) + log_ndtr(outside)))
    return base + float(0.5 * (slope * sd) @ amplitude - 0.5 * np.linalg.slogdet(scaled)[1]) + sides


def _is_one_more(some: Sequence[Candidate], base: Sequence[Candidate]) -> bool:
    return len(some) == len(base) + 1 and all(one is other for one, other in zip(some, base, strict=False))
