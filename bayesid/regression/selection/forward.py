"""Forward selection: adds the effects that evidence and held-back blocks of the log bear out, one after the other.

Blocks are predicted by fits to the folds that they are not in (`regression.selection.products`): that tells what
effects do to the error on data that had no say.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence, Set
from dataclasses import dataclass
from itertools import islice
from typing import Generic

import numpy as np

from bayesid.arrays import TINY, Array, Mask
from bayesid.regression.selection.explanation import LN10
from bayesid.regression.selection.hypotheses import EffectKey
from bayesid.regression.selection.products import Candidate, HeldBackErrors, Kind, Products
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

    What is chosen at the start goes too if it is not worth it beside the rest. Returns products whose noise is that of
    the result, and the candidates that were chosen.
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
        promising = [_with(chosen, tried[k]) for k in np.argsort(-gains) if gains[k] > rules.needed]
        more = _first_borne_out(products, promising, before, chosen)
        if more is None:
            break
        products, chosen = _settled(products, _exchanged(products, more), rules)
        refused |= _keys(more) - _keys(chosen)  # or it would come and go for ever
    return products, chosen


def _first_borne_out(
    products: Products[Kind],
    sets: Sequence[list[Candidate[Kind]]],
    before: HeldBackErrors,
    chosen: Sequence[Candidate[Kind]],
) -> list[Candidate[Kind]] | None:
    """The first set whose last candidate is borne out; None if there is none. More and more are looked at at once."""
    left, count = iter(sets), 1
    while some := list(islice(left, count)):
        after = products.held_back_each(some, chosen)
        for more, errors in zip(some, after, strict=True):
            if _borne_out(errors, before, more[-1]):
                return more
        count = min(2 * count, TUNING.sets_predicted_at_once)
    return None


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
        equal = [k for k in np.argsort(-gains) if gains[k] > gains.max() - LN10]  # Jeffreys 1961, appendix B
        winner = rivals[min(equal, key=lambda k: len(rivals[k].hypothesis.columns.sd))]
        exchanged = [winner if other is candidate else other for other in chosen]
        after, before = products.held_back_each([exchanged, others])
        if _borne_out(after, before, winner):
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
        after, *before = products.held_back_each([chosen, *(_without(chosen, c) for c in chosen)])
        idle = [c for c, errors in zip(chosen, before, strict=True) if not _borne_out(after, errors, c)]
        if not idle:
            break
        least = min(idle, key=lambda c: float(products.gains(_without(chosen, c), [c])[0]))
        chosen = _needed(products, _without(chosen, least), needed)
    return chosen


def _harmless(products: Products[Kind], chosen: list[Candidate[Kind]]) -> list[Candidate[Kind]]:
    """The chosen without those that harm a joint, the most harmful first."""
    nothing = products.held_back(())
    while (joints := harmed(products.held_back(chosen), nothing)).any():
        others = products.held_back_each([_without(chosen, c) for c in chosen])
        relative = [(errors.rms / nothing.rms)[joints].sum() for errors in others]
        chosen = _without(chosen, chosen[int(np.argmin(relative))])
    return chosen


def _borne_out(after: HeldBackErrors, before: HeldBackErrors, candidate: Candidate[Kind]) -> bool:
    return bears_out(after, before, candidate.hypothesis.columns.joints)


def _without(chosen: Sequence[Candidate[Kind]], left_out: Candidate[Kind]) -> list[Candidate[Kind]]:
    return [candidate for candidate in chosen if candidate is not left_out]
