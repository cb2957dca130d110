"""Forward selection: adds effects one by one if the evidence and held-back blocks of the log confirm them."""

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
"""Forms of effects linearised near the current fit, by the ids of the old forms."""


def select_forward(
    regression: Regression,
    *,
    needed: float,
    most: int,
    sharpen: Sharpen = lambda regression, chosen: {},
    start: Set[EffectKey] = frozenset(),
) -> tuple[Regression, list[Hypothesis]]:
    """Adds the confirmed effect of largest gain until no other is confirmed; removes effects that become unnecessary.

    An effect is confirmed if its gain (log Bayes factor) exceeds `needed` and it lowers the error on held-back blocks.
    At most `most` effects are selected. Effects in `start` are selected first, and removed if they are not confirmed.
    Returns a regression with the error model of the result, and the selected effects.
    """
    first = [effect for effect in regression.effects if effect.key in start]
    selection = _Selection(regression, first, needed, most, sharpen)
    if first:
        selection.refit()
        selection.drop_unconfirmed()
    while True:
        selection.grow()
        grown = selection.chosen
        selection.drop_unconfirmed()
        selection.drop_harmful()
        if len(selection.chosen) == len(grown):
            return selection.regression, selection.chosen
        selection.refuse(grown)
        selection.refit()


@dataclass(eq=False)
class _Selection:
    regression: Regression
    chosen: list[Hypothesis]
    needed: float
    most: int
    sharpen: Sharpen
    refused: set[EffectKey] = field(default_factory=set)

    def refuse(self, tried: Effects) -> None:
        """Excludes effects that were tried and are not selected; so the loop ends."""
        self.refused |= {effect.key for effect in tried} - {effect.key for effect in self.chosen}

    def grow(self) -> None:
        """Adds confirmed effects one by one; those that become unnecessary are not tried again."""
        while len(self.chosen) < self.most:
            taken = {effect.key for effect in self.chosen} | self.refused
            tried = [effect for effect in self.regression.effects if effect.key not in taken]
            gains = self.regression.gains(self.chosen, tried)
            more = self._first_confirmed([tried[k] for k in np.argsort(-gains) if gains[k] > self.needed])
            if more is None:
                break
            self.chosen = self._merged(self._exchanged(more))
            self.refit()
            self.refuse(more)

    def _first_confirmed(self, promising: Effects) -> list[Hypothesis] | None:
        """The selected effects and the first confirmed one; None if none is. Batches, evaluated together, grow."""
        before = self.regression.cross_validation(self.chosen)
        candidates, count = iter([_with(self.chosen, entering) for entering in promising]), 1
        while batch := list(islice(candidates, count)):
            for more, errors in zip(batch, self.regression.held_back_each(batch), strict=True):
                if confirms(errors, before, more[-1].columns.joints):
                    return more
            count = min(2 * count, TUNING.sets_predicted_at_once)
        return None

    def _exchanged(self, chosen: list[Hypothesis]) -> list[Hypothesis]:
        """Replaces an effect by a confirmed one that explains more in the same joints, given the other effects.

        The first added effect may only resemble a sum of two true ones. Of effects with Bayes factors within a factor
        of 10 (Jeffreys 1961, appendix B) the one with fewest columns is used.
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
        """Replaces two effects of the same joints by a confirmed one that explains nearly as much.

        Two effects may together imitate a third. Its gain must exceed that of either by `needed`. It may be lower than
        that of the pair, whose forms were fitted to the log, by up to twice `needed`.
        """
        for pair in combinations(chosen, 2):
            joints = pair[0].columns.joints
            if pair[1].columns.joints != joints or any(effect not in chosen for effect in pair):
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

    def refit(self) -> None:
        """Linearises the selected forms again and refits the noise until no effect is unnecessary."""
        while True:
            forms = self.sharpen(self.regression, self.chosen)
            self.chosen = [forms.get(id(effect), effect) for effect in self.chosen]
            self.regression = self.regression.with_forms(forms).weighed_by(self.chosen)
            count = len(self.chosen)
            self.drop_unneeded()
            if len(self.chosen) in (count, 0):
                return

    def drop_unneeded(self) -> None:
        """Removes effects whose gain, given the others, is too small, the smallest first."""
        while self.chosen:
            gains = [self._gain(effect) for effect in self.chosen]
            if min(gains) > self.needed:
                break
            self.chosen = _without(self.chosen, self.chosen[int(np.argmin(gains))])

    def drop_unconfirmed(self) -> None:
        """Removes effects that others make unnecessary, or that held-back data do not confirm."""
        self.drop_unneeded()
        while self.chosen:
            sets = [self.chosen, *(_without(self.chosen, effect) for effect in self.chosen)]
            after, *before = self.regression.held_back_each(sets)
            pairs = zip(self.chosen, before, strict=True)
            unconfirmed = [effect for effect, errors in pairs if not confirms(after, errors, effect.columns.joints)]
            if not unconfirmed:
                break
            self.chosen = _without(self.chosen, min(unconfirmed, key=self._gain))
            self.drop_unneeded()

    def drop_harmful(self) -> None:
        """Removes effects that raise the error of a joint, the most harmful first."""
        nothing = self.regression.cross_validation(())
        while (joints := harmed(self.regression.cross_validation(self.chosen), nothing)).any():
            others = self.regression.held_back_each([_without(self.chosen, effect) for effect in self.chosen])
            relative = [(errors.rms / nothing.rms)[joints].sum() for errors in others]
            self.chosen = _without(self.chosen, self.chosen[int(np.argmin(relative))])

    def _gain(self, effect: Hypothesis) -> float:
        return float(self.regression.gains(_without(self.chosen, effect), [effect])[0])


def _with(chosen: Effects, entering: Hypothesis) -> list[Hypothesis]:
    """The selected effects and one more; it replaces the same effect in a subset of its joints."""
    effect, joints = entering.key[0], entering.columns.joints
    return [*(other for other in chosen if not (other.key[0] == effect and other.columns.joints <= joints)), entering]


def _without(chosen: Effects, left_out: Hypothesis) -> list[Hypothesis]:
    return [effect for effect in chosen if effect is not left_out]
