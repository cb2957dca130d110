"""Forward selection: adds the effects that evidence and held-back blocks of the log bear out, one after the other.

Blocks are predicted by fits to the folds that they are not in (`regression.selection.products`): that tells what
effects do to the error on data that had no say.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence, Set
from dataclasses import dataclass, field
from itertools import islice

import numpy as np

from bayesid.arrays import TINY, Array, Mask
from bayesid.regression.selection.explanation import LN10
from bayesid.regression.selection.hypotheses import EffectKey, Hypothesis
from bayesid.regression.selection.products import Candidate, HeldBackErrors, Products
from bayesid.regression.tuning import TUNING


def bears_out(
    after: HeldBackErrors, before: HeldBackErrors, joints: Collection[int], least: float = TUNING.help
) -> bool:
    """Whether an effect in some (0-based) joints surely helps there, and all joints together do not lose by it.

    It must lower the joints' mean squared errors, as shares of what they were and added up, by `least`. The standard
    error is that of the blocks which it helps less than on average: what helps a lot where it acts, and does nothing
    where it does not, is no luck.
    """
    relative = (after.squares - before.squares) / np.maximum(before.squares.sum(axis=0), TINY)
    of_blocks = relative[:, sorted(joints)].sum(axis=1)
    return bool(_surely_more(-of_blocks, least) and relative.sum() < 0.0)


def harmed(after: HeldBackErrors, before: HeldBackErrors) -> Mask:
    """(n,) whether a joint's mean squared error has risen by more than its standard error, and visibly."""
    rise, error = after.rise(before)
    risen: Mask = (rise > error) & (rise > TUNING.harm * before.rms**2)
    return risen


def log_density(residual: Array, used: Mask, sd: Array) -> Array:
    """(N,) log predictive density of residuals (N, n), joints added up, up to a constant that all predictions share.

    Student's t of four degrees about the errors' scale sd (n,), the usual choice where a few errors may be large
    (Lange, Little, Taylor 1989): a few samples where friction turns round decide nothing. Only used samples (N, n)
    count.
    """
    degrees = 4.0
    density = -0.5 * (degrees + 1.0) * np.log1p((residual / sd) ** 2 / degrees)
    of_rows: Array = (density * used).sum(axis=1)
    return of_rows


def surely_better(one: Array, other: Array, least: float) -> bool:
    """Whether log densities (blocks,) of one set of effects are above another's by `least` in sum, and surely."""
    return _surely_more(one - other, least)


def _surely_more(of_blocks: Array, least: float) -> bool:
    """Whether gains of blocks add up to more than `least`, and than their scatter on the side of less explains."""
    less = np.minimum(of_blocks - of_blocks.mean(), 0.0)
    return bool(of_blocks.sum() > max(least, TUNING.sure * float(np.sqrt(2.0 * np.sum(less**2)))))


@dataclass(frozen=True)
class Rules:
    """What decides in a forward selection.

    Attributes:
        needed: log Bayes factor.
        most: candidates that are added.
        sharpen: new forms of hypotheses, by the ids of the old ones, once some candidates are chosen: of those that are
            linear near what was found alone.
    """

    needed: float
    most: int
    sharpen: Callable[[Products, Sequence[Candidate]], Mapping[int, Hypothesis]] = lambda products, chosen: {}


def select_forward(
    products: Products, rules: Rules, start: Set[EffectKey] = frozenset()
) -> tuple[Products, list[Candidate]]:
    """Adds the borne-out candidate of the largest gain until none is left; what that makes needless goes.

    What is chosen at the start goes too if it is not worth it beside the rest. Returns products whose noise is that of
    the result, and the candidates that were chosen.
    """
    selection = _Selection(products, rules, [candidate for candidate in products.candidates if candidate.key in start])
    if selection.chosen:
        selection.settle()
        selection.drop_idle()
    while True:
        selection.grow()
        grown = selection.chosen
        selection.drop_idle()
        selection.drop_harmful()
        if len(selection.chosen) == len(grown):
            return selection.products, selection.chosen
        selection.refuse(grown)
        selection.settle()


@dataclass(eq=False)
class _Selection:
    """What is chosen of the products' candidates, and what is never tried again."""

    products: Products
    rules: Rules
    chosen: list[Candidate]
    refused: set[EffectKey] = field(default_factory=set)

    def refuse(self, tried: Sequence[Candidate]) -> None:
        """Those that were tried and are not chosen would come and go for ever."""
        self.refused |= {candidate.key for candidate in tried} - {candidate.key for candidate in self.chosen}

    def grow(self) -> None:
        """Adds candidates as long as one is borne out; what that makes needless is refused from then on."""
        while len(self.chosen) < self.rules.most:
            taken = {candidate.key for candidate in self.chosen} | self.refused
            tried = [candidate for candidate in self.products.candidates if candidate.key not in taken]
            gains = self.products.gains(self.chosen, tried)
            more = self._first_borne_out([tried[k] for k in np.argsort(-gains) if gains[k] > self.rules.needed])
            if more is None:
                break
            self.chosen = self._exchanged(more)
            self.settle()
            self.refuse(more)

    def _first_borne_out(self, promising: Sequence[Candidate]) -> list[Candidate] | None:
        """The chosen and the first candidate that is borne out, if any. More and more are looked at at once."""
        before = self.products.held_back(self.chosen)
        left, count = iter([_with(self.chosen, entering) for entering in promising]), 1
        while some := list(islice(left, count)):
            after = self.products.held_back_each(some, self.chosen)
            for more, errors in zip(some, after, strict=True):
                if bears_out(errors, before, more[-1].columns.joints):
                    return more
            count = min(2 * count, TUNING.sets_predicted_at_once)
        return None

    def _exchanged(self, chosen: list[Candidate]) -> list[Candidate]:
        """Some, each replaced by what explains more in its joints, and is borne out, beside others that act there.

        What came first may be what resembles the sum of two best. Of what cannot be told apart (Jeffreys 1961,
        appendix B), the one of fewest columns.
        """
        for candidate in list(chosen):
            others, joints = _without(chosen, candidate), candidate.columns.joints
            if not any(joints & other.columns.joints for other in others):
                continue
            taken = {other.key for other in others}
            rivals = [c for c in self.products.candidates if c.columns.joints == joints and c.key not in taken]
            gains = self.products.gains(others, rivals)
            equal = [k for k in np.argsort(-gains) if gains[k] > gains.max() - LN10]
            winner = rivals[min(equal, key=lambda k: len(rivals[k].columns.sd))]
            exchanged = [winner if other is candidate else other for other in chosen]
            after, before = self.products.held_back_each([exchanged, others])
            if bears_out(after, before, winner.columns.joints):
                chosen = exchanged
        return chosen

    def settle(self) -> None:
        """Sharpens the forms of the chosen and estimates noise anew, until none of them is needless."""
        while True:
            forms = self.rules.sharpen(self.products, self.chosen)
            self.products, self.chosen = self.products.with_forms(forms, self.chosen)
            self.products.with_noise_of(self.chosen, range(len(self.products.errors)))
            count = len(self.chosen)
            self.drop_needless()
            if len(self.chosen) in (count, 0):
                return

    def drop_needless(self) -> None:
        """Leaves out those whose gain, given the others, is too small, the smallest first."""
        while self.chosen:
            gains = [self._gain(candidate) for candidate in self.chosen]
            if min(gains) > self.rules.needed:
                break
            self.chosen = _without(self.chosen, self.chosen[int(np.argmin(gains))])

    def drop_idle(self) -> None:
        """Leaves out what others make needless, or what held-back data do not bear out beside these."""
        self.drop_needless()
        while self.chosen:
            after, *before = self.products.held_back_each(
                [self.chosen, *(_without(self.chosen, c) for c in self.chosen)]
            )
            pairs = zip(self.chosen, before, strict=True)
            idle = [c for c, errors in pairs if not bears_out(after, errors, c.columns.joints)]
            if not idle:
                break
            self.chosen = _without(self.chosen, min(idle, key=self._gain))
            self.drop_needless()

    def drop_harmful(self) -> None:
        """Leaves out those that harm a joint, the most harmful first."""
        nothing = self.products.held_back(())
        while (joints := harmed(self.products.held_back(self.chosen), nothing)).any():
            others = self.products.held_back_each([_without(self.chosen, c) for c in self.chosen])
            relative = [(errors.rms / nothing.rms)[joints].sum() for errors in others]
            self.chosen = _without(self.chosen, self.chosen[int(np.argmin(relative))])

    def _gain(self, candidate: Candidate) -> float:
        return float(self.products.gains(_without(self.chosen, candidate), [candidate])[0])


def _with(chosen: Sequence[Candidate], entering: Candidate) -> list[Candidate]:
    """The chosen and one more, which takes the place of the same effect in some of its joints."""
    effect, joints = entering.key[0], entering.columns.joints
    return [*(c for c in chosen if not (c.key[0] == effect and c.columns.joints <= joints)), entering]


def _without(chosen: Sequence[Candidate], left_out: Candidate) -> list[Candidate]:
    return [candidate for candidate in chosen if candidate is not left_out]
