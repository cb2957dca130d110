"""Forward selection: adds the effects that evidence and held-back blocks of the log bear out, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass, field
from itertools import combinations, islice

import numpy as np

from bayesid.regression.selection.cross_validation import confirms, harmed
from bayesid.regression.selection.fitted_effects import LN10
from bayesid.regression.selection.hypotheses import EffectKey, Hypothesis
from bayesid.regression.selection.regression import Effects, Regression
from bayesid.regression.tuning import TUNING

Sharpen = Callable[[Regression, Effects], Mapping[int, Hypothesis]]
"""New forms of effects, by the ids of the old ones, once some are chosen: of those that are linear near what was found
alone."""


def select_forward(
    regression: Regression,
    *,
    needed: float,
    most: int,
    sharpen: Sharpen = lambda regression, chosen: {},
    start: Set[EffectKey] = frozenset(),
) -> tuple[Regression, list[Hypothesis]]:
    """Adds the borne-out effect of the largest gain until none is left; what that makes needless goes.

    An effect needs a log Bayes factor, and so many are added at most. What is chosen at the start goes too if it is not
    worth it beside the rest. Returns a regression whose noise is that of the result, and the effects that were chosen.
    """
    begun = [effect for effect in regression.effects if effect.key in start]
    selection = _Selection(regression, begun, needed, most, sharpen)
    if begun:
        selection.settle()
        selection.drop_idle()
    while True:
        selection.grow()
        grown = selection.chosen
        selection.drop_idle()
        selection.drop_harmful()
        if len(selection.chosen) == len(grown):
            return selection.regression, selection.chosen
        selection.refuse(grown)
        selection.settle()


@dataclass(eq=False)
class _Selection:
    """What is chosen of the regression's effects, and what is never tried again."""

    regression: Regression
    chosen: list[Hypothesis]
    needed: float
    most: int
    sharpen: Sharpen
    refused: set[EffectKey] = field(default_factory=set)

    def refuse(self, tried: Effects) -> None:
        """Those that were tried and are not chosen would come and go for ever."""
        self.refused |= {effect.key for effect in tried} - {effect.key for effect in self.chosen}

    def grow(self) -> None:
        """Adds effects as long as one is borne out; what that makes needless is refused from then on."""
        while len(self.chosen) < self.most:
            taken = {effect.key for effect in self.chosen} | self.refused
            tried = [effect for effect in self.regression.effects if effect.key not in taken]
            gains = self.regression.gains(self.chosen, tried)
            more = self._first_borne_out([tried[k] for k in np.argsort(-gains) if gains[k] > self.needed])
            if more is None:
                break
            self.chosen = self._merged(self._exchanged(more))
            self.settle()
            self.refuse(more)

    def _first_borne_out(self, promising: Effects) -> list[Hypothesis] | None:
        """The chosen and the first effect that is borne out, if any. More and more are looked at at once."""
        before = self.regression.cross_validation(self.chosen)
        left, count = iter([_with(self.chosen, entering) for entering in promising]), 1
        while some := list(islice(left, count)):
            for more, errors in zip(some, self.regression.held_back_each(some), strict=True):
                if confirms(errors, before, more[-1].columns.joints):
                    return more
            count = min(2 * count, TUNING.sets_predicted_at_once)
        return None

    def _exchanged(self, chosen: list[Hypothesis]) -> list[Hypothesis]:
        """Some, each replaced by what explains more in its joints, and is borne out, beside others that act there.

        What came first may be what resembles the sum of two best. Of what cannot be told apart (Jeffreys 1961,
        appendix B), the one of fewest columns.
        """
        for effect in list(chosen):
            others, joints = _without(chosen, effect), effect.columns.joints
            if not any(joints & other.columns.joints for other in others):
                continue
            taken = {other.key for other in others}
            rivals = [e for e in self.regression.effects if e.columns.joints == joints and e.key not in taken]
            gains = self.regression.gains(others, rivals)
            equal = [k for k in np.argsort(-gains) if gains[k] > gains.max() - LN10]
            winner = rivals[min(equal, key=lambda k: len(rivals[k].columns.sd))]
            exchanged = [winner if other is effect else other for other in chosen]
            after, before = self.regression.held_back_each([exchanged, others])
            if confirms(after, before, winner.columns.joints):
                chosen = exchanged
        return chosen

    def _merged(self, chosen: list[Hypothesis]) -> list[Hypothesis]:
        """Pairs of one place, each replaced by a single effect that takes about their place, and is borne out.

        Two that are chosen one after the other may stand for one that neither resembles. It explains more than either
        by what an effect needs, and less than both by no more than what two need: their forms were chosen for it.
        """
        for pair in combinations(chosen, 2):
            joints = pair[0].columns.joints
            if pair[1].columns.joints != joints or any(one not in chosen for one in pair):
                continue
            others, taken = _without(_without(chosen, pair[0]), pair[1]), {effect.key for effect in chosen}
            rivals = [e for e in self.regression.effects if e.columns.joints == joints and e.key not in taken]
            if not rivals:
                continue
            *alone, gain = self.regression.gains(others, [*pair, winner := self._best(others, rivals)]).tolist()
            both = alone[0] + float(self.regression.gains([*others, pair[0]], [pair[1]])[0])
            if gain > max(*alone, both - 3.0 * self.needed) + self.needed:
                after, before = self.regression.held_back_each([[*others, winner], others])
                chosen = [*others, winner] if confirms(after, before, joints) else chosen
        return chosen

    def _best(self, others: Effects, rivals: Effects) -> Hypothesis:
        return rivals[int(np.argmax(self.regression.gains(others, rivals)))]

    def settle(self) -> None:
        """Sharpens the forms of the chosen and estimates noise anew, until none of them is needless."""
        while True:
            forms = self.sharpen(self.regression, self.chosen)
            self.chosen = [forms.get(id(effect), effect) for effect in self.chosen]
            self.regression = self.regression.with_forms(forms).weighed_by(self.chosen)
            count = len(self.chosen)
            self.drop_needless()
            if len(self.chosen) in (count, 0):
                return

    def drop_needless(self) -> None:
        """Leaves out those whose gain, given the others, is too small, the smallest first."""
        while self.chosen:
            gains = [self._gain(effect) for effect in self.chosen]
            if min(gains) > self.needed:
                break
            self.chosen = _without(self.chosen, self.chosen[int(np.argmin(gains))])

    def drop_idle(self) -> None:
        """Leaves out what others make needless, or what held-back data do not bear out beside these."""
        self.drop_needless()
        while self.chosen:
            sets = [self.chosen, *(_without(self.chosen, effect) for effect in self.chosen)]
            after, *before = self.regression.held_back_each(sets)
            pairs = zip(self.chosen, before, strict=True)
            idle = [effect for effect, errors in pairs if not confirms(after, errors, effect.columns.joints)]
            if not idle:
                break
            self.chosen = _without(self.chosen, min(idle, key=self._gain))
            self.drop_needless()

    def drop_harmful(self) -> None:
        """Leaves out those that harm a joint, the most harmful first."""
        nothing = self.regression.cross_validation(())
        while (joints := harmed(self.regression.cross_validation(self.chosen), nothing)).any():
            others = self.regression.held_back_each([_without(self.chosen, effect) for effect in self.chosen])
            relative = [(errors.rms / nothing.rms)[joints].sum() for errors in others]
            self.chosen = _without(self.chosen, self.chosen[int(np.argmin(relative))])

    def _gain(self, effect: Hypothesis) -> float:
        return float(self.regression.gains(_without(self.chosen, effect), [effect])[0])


def _with(chosen: Effects, entering: Hypothesis) -> list[Hypothesis]:
    """The chosen and one more, which takes the place of the same effect in some of its joints."""
    effect, joints = entering.key[0], entering.columns.joints
    return [*(one for one in chosen if not (one.key[0] == effect and one.columns.joints <= joints)), entering]


def _without(chosen: Effects, left_out: Hypothesis) -> list[Hypothesis]:
    return [effect for effect in chosen if effect is not left_out]
