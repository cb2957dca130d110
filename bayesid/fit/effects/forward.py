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

from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar

import numpy as np
from scipy.special import log_ndtr

from bayesid.arrays import Array, Integers, Mask
from bayesid.fit.effects.columns import NO_COLUMNS, Columns
from bayesid.fit.effects.error_model import ErrorModel, bridged, fit_error
from bayesid.fit.effects.explanation import Observations
from bayesid.fit.effects.held_back import FOLDS, HeldBackErrors, bears_out, blocks_of, harmed
from bayesid.fit.effects.hypotheses import EffectKey
from bayesid.fit.effects.relevance import inverse_of

Kind = TypeVar("Kind", bound="Explaining")


EQUIVALENT = float(np.log(10.0))
"""Log Bayes factor below which two effects cannot be told apart (Jeffreys 1961, appendix B)."""


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
        change: index of the change that it makes by itself; -1 where it makes none.
    """

    hypothesis: Kind
    place: slice
    change: int = -1


@dataclass(eq=False)
class Products(Generic[Kind]):
    """Whitened columns of model and candidates, multiplied: G and g, joint by joint.

    Args:
        data: what is to be explained.
        hypotheses: the candidates, linear about their own numbers.
        errors: of each joint.
        uncertain: columns that the model may be wrong by in any case, beside those of every set of candidates.
        predicting: whether these may take part in predictions of held-back blocks. What evidence tells from them by
            their prior alone, such as an offset from an error of the geometry fifty times its tolerance, predictions
            do not.

    Attributes:
        candidates: the hypotheses and their places among all m columns.
        blocks: that the log is cut into.
        hessian: (m, m) G of all joints and folds.
        gradient: (m,) g of all joints and folds.
    """

    data: Observations
    hypotheses: Sequence[Kind]
    errors: list[ErrorModel]
    uncertain: Columns = NO_COLUMNS
    predicting: bool = True
    candidates: list[Candidate[Kind]] = field(init=False)
    blocks: int = field(init=False)
    hessian: Array = field(init=False)
    gradient: Array = field(init=False)
    _always: int = field(init=False)
    _precision: Array = field(init=False)
    _known: Array = field(init=False)
    _hessian: list[Array] = field(init=False)
    _gradient: list[Array] = field(init=False)
    _by_others: tuple[Array, Array] = field(init=False)
    _starts: Integers = field(init=False)
    _columns: list[tuple[Array, Array]] = field(init=False)

    def __post_init__(self) -> None:
        r = self.data.columns.shape[2]
        self._always = r + len(self.uncertain.sd)
        self.candidates, end = [], self._always
        for hypothesis in self.hypotheses:
            start, end = end, end + len(hypothesis.columns.sd)
            change = end if hypothesis.columns.shift else -1
            self.candidates.append(Candidate(hypothesis, slice(start, end), change))
            end += change >= 0
        known, own = self.data.information, np.zeros(end)
        own[r : self._always] = 1.0 / self.uncertain.sd**2
        for candidate in self.candidates:
            own[candidate.place] = 1.0 / candidate.hypothesis.columns.sd**2
        self._precision, self._known = np.diag(own), np.zeros(end)
        self._precision[:r, :r], self._known[:r] = known.hessian, known.gradient
        samples = len(self.data.used)
        self.blocks = blocks_of(samples / self.data.rate)
        self._starts = -(-np.arange(self.blocks + 1) * samples // self.blocks)
        self._columns = [self._of_joint(j) for j in range(len(self.errors))]
        products = [self._multiplied(j) for j in range(len(self.errors))]
        self._hessian, self._gradient = [p[0] for p in products], [p[1] for p in products]
        self._add_up()

    def _add_up(self) -> None:
        weights = [error.scale**-2.0 for error in self.errors]
        by_fold = [np.tensordot(weights, products, axes=1) for products in (self._hessian, self._gradient)]
        self.hessian, self.gradient = (products.sum(axis=0) for products in by_fold)
        self._by_others = self.hessian - by_fold[0], self.gradient - by_fold[1]

    def _rows(self, block: int) -> slice:
        return slice(self._starts[block], self._starts[block + 1])

    def _of_joint(self, joint: int) -> tuple[Array, Array]:
        """Indices (m,) of the columns that show in a joint, and (N, m) these columns."""
        r, used, own = self.data.columns.shape[2], self.data.used[:, joint, None], self.data.columns[:, joint]
        shows = np.flatnonzero(own.any(axis=0))  # no link shows in the joints behind it
        index, parts = [shows], [own[:, shows]]
        if joint in self.uncertain.rows:
            index.append(np.arange(r, self._always))
            parts.append(self.uncertain.rows[joint] * used)
        for candidate in self.candidates:
            columns = candidate.hypothesis.columns
            if joint in columns.rows:
                index.append(np.arange(candidate.place.start, candidate.place.stop))
                parts.append(columns.rows[joint] * used)
            if candidate.change >= 0 and joint in columns.shift:
                index.append(np.array([candidate.change]))
                parts.append(columns.shift[joint][:, None] * used)
        return np.concatenate(index), np.asfortranarray(np.concatenate(parts, axis=1))

    def _multiplied(self, joint: int) -> tuple[Array, Array]:
        index, columns = self._columns[joint]
        used = self.data.used[:, joint]
        white = self.errors[joint].innovations(
            bridged(np.column_stack([columns, self.data.effort[:, joint]]), used), used
        )
        size = len(self._known)
        hessian, gradient = np.zeros((FOLDS, size, size)), np.zeros((FOLDS, size))
        products = np.zeros((FOLDS, white.shape[1], white.shape[1]))
        for block in range(self.blocks):
            rows = white[self._rows(block)]
            products[block % FOLDS] += rows.T @ rows
        hessian[:, index[:, None], index], gradient[:, index] = products[:, :-1, :-1], products[:, :-1, -1]
        return hessian, gradient

    def indices(self, chosen: Sequence[Candidate[Kind]], *, uncertain: bool = True) -> Integers:
        """Of the columns that are always there, uncertain ones among them or not, and of those of some candidates."""
        always = self._always if uncertain else self.data.columns.shape[2]
        return np.concatenate([np.arange(always), *(np.arange(c.place.start, c.place.stop) for c in chosen)]).astype(
            int
        )

    def best(self, chosen: Sequence[Candidate[Kind]]) -> Array:
        """(m,) coefficients and amplitudes, one for changes, zero for what is not chosen."""
        return self._solved(self.hessian, self.gradient, chosen)[0]

    def _solved(
        self, hessian: Array, gradient: Array, chosen: Sequence[Candidate[Kind]], *, uncertain: bool = True
    ) -> tuple[Array, Array]:
        """The same for given G and g, and P."""
        index, best = self.indices(chosen, uncertain=uncertain), np.zeros(len(self._known))
        changes = np.array([c.change for c in chosen if c.change >= 0], dtype=np.int64)
        inverse = inverse_of(hessian[np.ix_(index, index)] + self._precision[np.ix_(index, index)])
        best[changes] = 1.0
        best[index] = inverse @ ((gradient + self._known)[index] - hessian[np.ix_(index, changes)].sum(axis=1))
        return best, inverse

    def residual(self, chosen: Sequence[Candidate[Kind]]) -> Array:
        """(N, n) what these leave, N m."""
        return self._without(self.best(chosen)[:, None])[:, :, 0]

    def _without(self, best: Array) -> Array:
        """(N, n, k) what k sets of coefficients and amplitudes (m, k) leave."""
        residual = np.empty((best.shape[1], *self.data.effort.shape))
        counts: Mask = np.any(best, axis=1)
        for j, (index, columns) in enumerate(self._columns):
            shows = counts[index]
            residual[:, :, j] = self.data.effort[:, j] - best[index[shows]].T @ columns[:, shows].T
        residual *= self.data.used
        return residual.transpose(1, 2, 0)

    def held_back(self, chosen: Sequence[Candidate[Kind]]) -> HeldBackErrors:
        """Every block predicted by a fit of some candidates to the folds that it is not in."""
        folds = zip(*self._by_others, strict=True)
        best = [self._solved(*others, chosen, uncertain=self.predicting)[0] for others in folds]
        residual = self._without(np.stack(best, axis=1))
        squares = [(residual[self._rows(b), :, b % FOLDS] ** 2).sum(axis=0) for b in range(self.blocks)]
        counts = [self.data.used[self._rows(b)].sum(axis=0) for b in range(self.blocks)]
        return HeldBackErrors(np.stack(squares), np.stack(counts))

    def with_forms(
        self, forms: Mapping[int, Kind], chosen: Sequence[Candidate[Kind]]
    ) -> tuple[Products[Kind], list[Candidate[Kind]]]:
        """The same with other forms of some hypotheses, by the ids of the old ones, and the chosen among them."""
        if not forms:
            return self, list(chosen)
        hypotheses = [forms.get(id(h), h) for h in self.hypotheses]
        products = Products(self.data, hypotheses, self.errors, self.uncertain, self.predicting)
        of_old = {id(old): new for old, new in zip(self.hypotheses, products.candidates, strict=True)}
        return products, [of_old[id(candidate.hypothesis)] for candidate in chosen]

    def with_noise_of(self, chosen: Sequence[Candidate[Kind]], joints: Iterable[int]) -> None:
        """Whitens some (0-based) joints anew, by the errors that a set of candidates leaves there."""
        residual = self.residual(chosen)
        for j in joints:
            before = self.errors[j]
            self.errors[j] = fit_error(residual[:, j], self.data.used[:, j], self.data.rate)[0]
            if self.errors[j].shape != before.shape:
                self._hessian[j], self._gradient[j] = self._multiplied(j)
        self._add_up()

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


@dataclass(frozen=True)
class Rules(Generic[Kind]):
    """What decides in a forward selection.

    Attributes:
        needed: log Bayes factor.
        most: candidates that are added.
        sharpen: new forms of hypotheses, by the ids of the old ones, once some candidates are chosen: of those that are
            linear near what was found alone.
    """

    needed: float
    most: int
    sharpen: Callable[[Products[Kind], Sequence[Candidate[Kind]]], Mapping[int, Kind]] = lambda products, chosen: {}


def select_forward(
    products: Products[Kind], rules: Rules[Kind], start: Set[EffectKey] = frozenset()
) -> tuple[Products[Kind], list[Candidate[Kind]]]:
    """Adds the borne-out candidate of the largest gain until none is left; what that makes needless goes.

    Args:
        products: of all candidates.
        rules: what decides.
        start: what is chosen to begin with, and goes if it is not worth it beside the rest.

    Returns:
        Products whose noise is that of the result, and the candidates that were chosen.
    """
    refused = set[EffectKey]()
    chosen = [candidate for candidate in products.candidates if candidate.hypothesis.key in start]
    if chosen:
        products, chosen = _settled(products, chosen, rules)
        chosen = _worth_it(products, chosen, rules.needed)
    while True:
        products, grown = _grown(products, chosen, rules, refused)
        chosen = _harmless(products, _worth_it(products, grown, rules.needed))
        if len(chosen) == len(grown):
            return products, chosen
        refused |= _keys(grown) - _keys(chosen)
        products, chosen = _settled(products, chosen, rules)


def _keys(chosen: Sequence[Candidate[Kind]]) -> set[EffectKey]:
    return {candidate.hypothesis.key for candidate in chosen}


def _grown(
    products: Products[Kind], chosen: list[Candidate[Kind]], rules: Rules[Kind], refused: set[EffectKey]
) -> tuple[Products[Kind], list[Candidate[Kind]]]:
    """With candidates added as long as one is borne out; what that makes needless is refused from then on."""
    while len(chosen) < rules.most:
        tried = [c for c in products.candidates if c.hypothesis.key not in _keys(chosen) | refused]
        gains = products.gains(chosen, tried)
        before = products.held_back(chosen)
        promising = (_with(chosen, tried[k]) for k in np.argsort(-gains) if gains[k] > rules.needed)
        more = next((more for more in promising if _borne_out(products.held_back(more), before, more[-1])), None)
        if more is None:
            break
        products, chosen = _settled(products, _exchanged(products, more), rules)
        refused |= _keys(more) - _keys(chosen)  # or it would come and go for ever
    return products, chosen


def _exchanged(products: Products[Kind], chosen: list[Candidate[Kind]]) -> list[Candidate[Kind]]:
    """The chosen, each replaced by what explains more in its joints, and is borne out, beside others that act there.

    What came first may be what resembles the sum of two best. Of what cannot be told apart, the one of fewest columns.
    """
    for candidate in list(chosen):
        others, joints = _without(chosen, candidate), candidate.hypothesis.columns.joints
        if not any(joints & other.hypothesis.columns.joints for other in others):
            continue
        taken = _keys(others)
        rivals = [
            c for c in products.candidates if c.hypothesis.columns.joints == joints and c.hypothesis.key not in taken
        ]
        gains = products.gains(others, rivals)
        equal = [k for k in np.argsort(-gains) if gains[k] > gains.max() - EQUIVALENT]
        winner = rivals[min(equal, key=lambda k: len(rivals[k].hypothesis.columns.sd))]
        exchanged = [winner if other is candidate else other for other in chosen]
        if _borne_out(products.held_back(exchanged), products.held_back(others), winner):
            chosen = exchanged
    return chosen


def _with(chosen: Sequence[Candidate[Kind]], entering: Candidate[Kind]) -> list[Candidate[Kind]]:
    """The chosen and one more, which takes the place of the same effect in some of its joints."""
    effect, joints = entering.hypothesis.key[0], entering.hypothesis.columns.joints
    covered = (c.hypothesis.key[0] == effect and c.hypothesis.columns.joints <= joints for c in chosen)
    return [*(c for c, gone in zip(chosen, covered, strict=True) if not gone), entering]


def _settled(
    products: Products[Kind], chosen: list[Candidate[Kind]], rules: Rules[Kind]
) -> tuple[Products[Kind], list[Candidate[Kind]]]:
    """The chosen in their sharpened forms, noise estimated anew, until none of them is needless."""
    while True:
        products, chosen = products.with_forms(rules.sharpen(products, chosen), chosen)
        products.with_noise_of(chosen, range(len(products.errors)))
        needed = _needed(products, chosen, rules.needed)
        if len(needed) == len(chosen) or not needed:
            return products, needed
        chosen = needed


def _needed(products: Products[Kind], chosen: list[Candidate[Kind]], needed: float) -> list[Candidate[Kind]]:
    """The chosen without those whose gain, given the others, is too small, the smallest first."""
    while chosen:
        gains = [float(products.gains(_without(chosen, c), [c])[0]) for c in chosen]
        if min(gains) > needed:
            break
        chosen = _without(chosen, chosen[int(np.argmin(gains))])
    return chosen


def _worth_it(products: Products[Kind], chosen: list[Candidate[Kind]], needed: float) -> list[Candidate[Kind]]:
    """The chosen without those that others make needless, or that held-back data do not bear out beside these."""
    chosen = _needed(products, chosen, needed)
    while chosen:
        after = products.held_back(chosen)
        idle = [c for c in chosen if not _borne_out(after, products.held_back(_without(chosen, c)), c)]
        if not idle:
            break
        least = min(idle, key=lambda c: float(products.gains(_without(chosen, c), [c])[0]))
        chosen = _needed(products, _without(chosen, least), needed)
    return chosen


def _harmless(products: Products[Kind], chosen: list[Candidate[Kind]]) -> list[Candidate[Kind]]:
    """The chosen without those that harm a joint, the most harmful first."""
    nothing = products.held_back(())
    while (joints := harmed(products.held_back(chosen), nothing)).any():
        relative = [(products.held_back(_without(chosen, c)).rms / nothing.rms)[joints].sum() for c in chosen]
        chosen = _without(chosen, chosen[int(np.argmin(relative))])
    return chosen


def _borne_out(after: HeldBackErrors, before: HeldBackErrors, candidate: Candidate[Kind]) -> bool:
    return bears_out(after, before, candidate.hypothesis.columns.joints)


def _without(chosen: Sequence[Candidate[Kind]], left_out: Candidate[Kind]) -> list[Candidate[Kind]]:
    return [candidate for candidate in chosen if candidate is not left_out]
