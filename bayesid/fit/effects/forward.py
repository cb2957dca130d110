"""Forward selection by evidence over products of columns: many effects, one after the other, in little time.

All candidates are whitened together and multiplied once; what a candidate adds to a set is then linear algebra of its
own few columns (:eq:`forward-gain`)::

    gain = q' (Q + L)^-1 q / 2 - log det(1 + L^-1 Q) / 2,   Q = G_cc - G_cS P G_Sc,   q = g_c - G_cS P g_S,

with G, g the products of whitened columns and efforts, P the inverse of G_SS with the set's own prior precisions, and
L those of the candidate (Tipping and Faul 2003, for groups of columns). Noise is estimated anew, and the joints that
changed are whitened anew, whenever an effect has been added.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Generic, Protocol, TypeVar

import numpy as np
from scipy.special import log_ndtr

from bayesid.arrays import Array, Integers
from bayesid.fit.effects.error_model import ErrorModel, fit_error
from bayesid.fit.effects.explanation import Columns, Observations
from bayesid.fit.effects.held_back import BLOCKS, FOLDS, HeldBackErrors, bears_out, harmed
from bayesid.fit.effects.hypotheses import EffectKey
from bayesid.fit.effects.relevance import inverse_of

Kind = TypeVar("Kind", bound="Explaining")


class Explaining(Protocol):
    """What may explain efforts: a form of an effect, or how they change with the geometry."""

    @property
    def columns(self) -> Columns:
        """What it adds to the efforts."""

    @property
    def key(self) -> EffectKey:
        """Effect and joints."""


@dataclass(frozen=True, eq=False)
class Candidate(Generic[Kind]):
    """What may explain efforts, and its place among all columns.

    Attributes:
        hypothesis: one form of an effect.
        place: indices of its columns.
        change: index of the change that it makes by itself; -1 where it makes none, or that is taken off the efforts.
        sharpened: whether the efforts are without its change, and its columns are about the number that was found.
    """

    hypothesis: Kind
    place: slice
    change: int = -1
    sharpened: bool = False


@dataclass(eq=False)
class Products(Generic[Kind]):
    """Whitened columns of model and candidates, multiplied: G and g, joint by joint.

    Args:
        data: what is to be explained.
        hypotheses: the candidates, linear about their own numbers.
        errors: of each joint.
        taken_off: ids of hypotheses whose change the efforts are without.
    """

    data: Observations
    hypotheses: Sequence[Kind]
    errors: list[ErrorModel]
    taken_off: frozenset[int] = frozenset()
    candidates: list[Candidate[Kind]] = field(init=False)
    precision: Array = field(init=False)
    _hessian: list[Array] = field(init=False)
    _gradient: list[Array] = field(init=False)
    _fold: Integers = field(init=False)
    _block: Integers = field(init=False)
    _columns: list[tuple[Array, Array]] = field(init=False)

    def __post_init__(self) -> None:
        self.candidates, end = [], self.data.columns.shape[2]
        for hypothesis in self.hypotheses:
            start, end = end, end + len(hypothesis.columns.sd)
            taken_off = id(hypothesis) in self.taken_off
            change = end if hypothesis.columns.shift and not taken_off else -1
            self.candidates.append(Candidate(hypothesis, slice(start, end), change, taken_off))
            end += change >= 0
        self.precision = np.zeros(end)
        for candidate in self.candidates:
            self.precision[candidate.place] = 1.0 / candidate.hypothesis.columns.sd**2
        self._block = np.minimum(np.arange(len(self.data.used)) * BLOCKS // len(self.data.used), BLOCKS - 1)
        self._fold = self._block % FOLDS
        self._columns = [self._of_joint(j) for j in range(len(self.errors))]
        products = [self._multiplied(j) for j in range(len(self.errors))]
        self._hessian, self._gradient = [p[0] for p in products], [p[1] for p in products]

    def _of_joint(self, joint: int) -> tuple[Array, Array]:
        """Indices (m,) of the columns that show in a joint, and (N, m) these columns."""
        r, used = self.data.columns.shape[2], self.data.used[:, joint, None]
        index, parts = [np.arange(r)], [self.data.columns[:, joint]]
        for candidate in self.candidates:
            columns = candidate.hypothesis.columns
            if joint in columns.rows:
                index.append(np.arange(candidate.place.start, candidate.place.stop))
                parts.append(columns.rows[joint] * used)
            if candidate.change >= 0 and joint in columns.shift:
                index.append(np.array([candidate.change]))
                parts.append(columns.shift[joint][:, None] * used)
        return np.concatenate(index), np.concatenate(parts, axis=1)

    def _multiplied(self, joint: int) -> tuple[Array, Array]:
        index, columns = self._columns[joint]
        used = self.data.used[:, joint, None]
        white = self.errors[joint].whiten(np.column_stack([columns, self.data.effort[:, joint]])) * used
        size = len(self.precision)
        hessian, gradient = np.zeros((FOLDS, size, size)), np.zeros((FOLDS, size))
        for fold in range(FOLDS):
            rows = white[self._fold == fold]
            products = rows.T @ rows
            hessian[fold][np.ix_(index, index)], gradient[fold, index] = products[:-1, :-1], products[:-1, -1]
        return hessian, gradient

    @property
    def hessian(self) -> Array:
        """(m, m) G of all joints and folds."""
        return np.sum(self._hessian, axis=(0, 1))

    @property
    def gradient(self) -> Array:
        """(m,) g of all joints and folds."""
        return np.sum(self._gradient, axis=(0, 1))

    def indices(self, chosen: Sequence[Candidate[Kind]]) -> Integers:
        """Of the model's columns and of those of some candidates."""
        r = self.data.columns.shape[2]
        return np.concatenate([np.arange(r), *(np.arange(c.place.start, c.place.stop) for c in chosen)]).astype(int)

    def best(self, chosen: Sequence[Candidate[Kind]]) -> Array:
        """(m,) coefficients and amplitudes, one for changes, zero for what is not chosen."""
        return self._solved(self.hessian, self.gradient, chosen)[0]

    def _solved(self, hessian: Array, gradient: Array, chosen: Sequence[Candidate[Kind]]) -> tuple[Array, Array]:
        """The same for given G and g, and P."""
        index, best = self.indices(chosen), np.zeros(len(self.precision))
        changes = np.array([c.change for c in chosen if c.change >= 0], dtype=np.int64)
        inverse = inverse_of(hessian[np.ix_(index, index)] + np.diag(self.precision[index]))
        best[changes] = 1.0
        best[index] = inverse @ (gradient[index] - hessian[np.ix_(index, changes)].sum(axis=1))
        return best, inverse

    def residual(self, chosen: Sequence[Candidate[Kind]]) -> Array:
        """(N, n) what these leave, N m."""
        return self._without(self.best(chosen))

    def _without(self, best: Array) -> Array:
        parts = []
        for index, columns in self._columns:
            shows = np.flatnonzero(best[index])
            parts.append(columns[:, shows] @ best[index[shows]])
        return (self.data.effort - np.stack(parts, axis=1)) * self.data.used

    def held_back(self, chosen: Sequence[Candidate[Kind]]) -> HeldBackErrors:
        """Every block predicted by a fit of some candidates to the folds that it is not in."""
        residual = np.empty(self.data.effort.shape)
        by_fold, slopes = np.sum(self._hessian, axis=0), np.sum(self._gradient, axis=0)
        for fold in range(FOLDS):
            others = [k for k in range(FOLDS) if k != fold]
            best, _ = self._solved(by_fold[others].sum(axis=0), slopes[others].sum(axis=0), chosen)
            held = self._fold == fold
            residual[held] = self._without(best)[held]
        squares = np.stack([(residual[self._block == b] ** 2).sum(axis=0) for b in range(BLOCKS)])
        return HeldBackErrors(squares, np.stack([self.data.used[self._block == b].sum(axis=0) for b in range(BLOCKS)]))

    def sharpened(
        self, chosen: Sequence[Candidate[Kind]], sharper: Sequence[Kind]
    ) -> tuple[Products[Kind], list[Candidate[Kind]]]:
        """The same with other forms of some candidates, and these; what they change by themselves is taken off."""
        replaced = {id(c.hypothesis): new for c, new in zip(chosen, sharper, strict=True) if c.hypothesis is not new}
        effort = self.data.effort.copy()
        for candidate in chosen:
            if new := replaced.get(id(candidate.hypothesis)):
                old = candidate.hypothesis.columns.shift if candidate.sharpened else {}
                for j in new.columns.joints:
                    change = new.columns.shift.get(j, 0.0) - old.get(j, 0.0)
                    effort[:, j] -= change * self.data.used[:, j]
        hypotheses = [replaced.get(id(h), h) for h in self.hypotheses]
        taken_off = {id(c.hypothesis) for c in chosen if c.sharpened} | {id(new) for new in replaced.values()}
        products = Products(replace(self.data, effort=effort), hypotheses, self.errors, frozenset(taken_off))
        of = {id(c.hypothesis): c for c in products.candidates}
        return products, [of[id(new)] for new in sharper]

    def with_noise_of(self, chosen: Sequence[Candidate[Kind]], joints: Iterable[int]) -> None:
        """Whitens some (0-based) joints anew, by the errors that a set of candidates leaves there."""
        residual = self.residual(chosen)
        for j in joints:
            self.errors[j] = fit_error(residual[:, j], self.data.used[:, j], self.data.rate)[0]
            self._hessian[j], self._gradient[j] = self._multiplied(j)

    def gains(self, chosen: Sequence[Candidate[Kind]], tried: Sequence[Candidate[Kind]]) -> Array:
        """Log Bayes factors of candidates on top of a set (:eq:`forward-gain`)."""
        index, hessian, gradient = self.indices(chosen), self.hessian, self.gradient
        best, inverse = self._solved(hessian, gradient, chosen)
        gains = np.empty(len(tried))
        for k, candidate in enumerate(tried):
            own = np.arange(candidate.place.start, candidate.place.stop)
            own = own if candidate.change < 0 else np.append(own, candidate.change)
            across = hessian[np.ix_(own, index)]
            inner = hessian[np.ix_(own, own)] - across @ inverse @ across.T
            slope = gradient[own] - hessian[own] @ best
            gains[k] = _gain(inner, slope, candidate.hypothesis.columns)
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


def select_forward(
    products: Products[Kind],
    needed: float,
    most: int,
    sharpen: Callable[[Sequence[Kind]], Sequence[Kind]] = lambda chosen: chosen,
) -> tuple[Products[Kind], list[Candidate[Kind]]]:
    """Adds the borne-out candidate of the largest gain until none is left; what that makes needless goes.

    Args:
        products: of all candidates.
        needed: log Bayes factor.
        most: candidates that are added.
        sharpen: what becomes of candidates once their amplitudes are found: new ones of those that are linear about
            these alone.

    Returns:
        Products whose noise is that of the result, and the candidates that were chosen.
    """
    chosen: list[Candidate[Kind]] = []
    refused: set[EffectKey] = set()
    nothing = products.held_back(())
    while len(chosen) < most:
        keys = {c.hypothesis.key for c in chosen} | refused
        tried = [c for c in products.candidates if c.hypothesis.key not in keys]
        gains = products.gains(chosen, tried)
        before = products.held_back(chosen)
        promising = (tried[k] for k in np.argsort(-gains) if gains[k] > needed)
        entering = next((c for c in promising if _borne_out(products.held_back([*chosen, c]), before, c)), None)
        if entering is None:
            break
        sharper = sharpen([c.hypothesis for c in chosen if c.sharpened] + [entering.hypothesis])
        if sharper[-1] is entering.hypothesis:
            chosen.append(entering)
        else:  # a distortion changes what all terms stand for: they are chosen anew beside it
            products, chosen = products.sharpened([*(c for c in chosen if c.sharpened), entering], sharper)
        products.with_noise_of(chosen, range(len(products.errors)))
        needless = _needless(products, chosen, needed)
        refused |= {c.hypothesis.key for c in needless}  # or it would come and go for ever
        chosen = [c for c in chosen if c not in needless]
    while chosen and harmed(products.held_back(chosen), nothing).any():
        chosen = chosen[:-1]
    return products, chosen


def _needless(products: Products[Kind], chosen: list[Candidate[Kind]], needed: float) -> list[Candidate[Kind]]:
    """The first of the chosen whose gain, given the others, is too small; those that were sharpened stay."""
    for candidate in chosen[:-1]:
        others = [other for other in chosen if other is not candidate]
        if not candidate.sharpened and products.gains(others, [candidate])[0] <= needed:
            return [candidate]
    return []


def _borne_out(after: HeldBackErrors, before: HeldBackErrors, candidate: Candidate[Kind]) -> bool:
    return bears_out(after, before, sorted(candidate.hypothesis.columns.joints))
