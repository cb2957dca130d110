"""A discrepancy in plain words: what is missing, how large it is, and what it explains."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby

import numpy as np

from bayesid.discrepancy.compare import MODELS_RESIDUAL, REFIT, Excess
from bayesid.discrepancy.selection import GROWN, HELD_BACK, ON_LOG
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.fit.effects.added_effect import AddedEffect
from bayesid.fit.effects.scores import Score
from bayesid.model.catalogue import FORMS, noun
from bayesid.model.effects import Effect, ReadableUnit

Quantity = tuple[float, float, str]
"""Value, standard deviation (NaN where none is known) and unit."""

_UNITS = {"velocity": "rad/s", "position": "rad", "acceleration": "rad/s^2", "load": "N m", "time": "s"}
_SLIDING = {"velocity": "m/s", "position": "m", "acceleration": "m/s^2", "load": "N", "time": "s"}
_DIGITS = 3
"""Significant ones of a number: what a person remembers."""
_SMALL = 1e-4
"""Size below which numbers are written with a power of ten, as Python's `repr` does."""
_LARGE = 1e6
"""Size from which on they are."""
_MOST = 3
"""Joints whose gaps are named one by one: more make a sentence that nobody reads."""
_SURE = 0.9
"""Probability below which it is mentioned; a round number."""
_SAME = 0.98
"""Share of a gap from which on it has not fallen: 2 % hardly show in two digits."""


_WHOSE = {MODELS_RESIDUAL: "earlier model's", REFIT: "refitted model's"}
"""Own error a floor may be, by where it was taken from."""
_CHANGE = "change of "
"""Begins the names of what a parameter has changed by."""


# ---------------------------------------------------------------------------------------------------------------
# Numbers
# ---------------------------------------------------------------------------------------------------------------
def rounded(value: float, digits: int = _DIGITS) -> str:
    """A number to some significant digits, trailing zeros kept."""
    if not math.isfinite(value):
        return "unknown" if math.isnan(value) else "-infinite" if value < 0.0 else "infinite"
    if value and not _SMALL <= abs(value) < _LARGE:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{_decimals(value, digits)}f}"


def quantity(value: float, sd: float, unit: str) -> str:
    """1.9 +- 0.1 N m: the deviation to one digit, or two if the first is a one; no deviation where none is known."""
    if not math.isfinite(value) or not math.isfinite(sd) or sd <= 0.0:
        return f"{rounded(value)} {unit}".rstrip()
    exponent = math.floor(math.log10(max(abs(value), sd)))
    scaled = not math.log10(_SMALL) <= exponent < math.log10(_LARGE)
    factor = 10.0**exponent if scaled else 1.0
    decimals = _decimals(sd / factor, 2 if f"{sd:.1e}"[0] == "1" else 1)
    numbers = f"{value / factor:.{decimals}f} +- {sd / factor:.{decimals}f}"
    return f"({numbers})e{exponent} {unit}".rstrip() if scaled else f"{numbers} {unit}".rstrip()


def _decimals(value: float, digits: int) -> int:
    """Behind the point, for some significant digits of a number that is rounded to them."""
    return max(0, digits - 1 - int(f"{value:.{digits - 1}e}".split("e")[1]))


def unit_of(discrepancy: Discrepancy, joint: int, variable: str = "load") -> str:
    """Unit of a joint's (from 1) effort, or of another variable of it."""
    sliding = discrepancy.identification.model.robot.joints[joint - 1].prismatic
    return (_SLIDING if sliding else _UNITS)[variable]


# ---------------------------------------------------------------------------------------------------------------
# Names
# ---------------------------------------------------------------------------------------------------------------
def label(effect: str, joints: Sequence[int] = ()) -> str:
    """An effect without an article, and the joints (from 1) in which it acts."""
    plain = noun(effect).removeprefix("an ").removeprefix("a ")
    return f"{plain}, {joints_in_words(joints)}" if joints else plain


def score_label(score: Score) -> str:
    """A candidate and its joints."""
    return label(score.hypothesis.effect, score.hypothesis.joints)


def best_first(scores: Iterable[Score]) -> list[Score]:
    """Candidates by their Bayes factors."""
    return sorted(scores, key=lambda score: -score.gain)


def joints_in_words(joints: Iterable[int]) -> str:
    """Joint 3; joints 1 to 3 and 5."""
    ordered = sorted(set(joints))
    runs = [[joint for _, joint in run] for _, run in groupby(enumerate(ordered), key=lambda pair: pair[1] - pair[0])]
    parts = [text for run in runs for text in ([f"{run[0]} to {run[-1]}"] if len(run) > 2 else map(str, run))]
    return f"joint{'s' if len(ordered) > 1 else ''} {listed(parts)}"


def listed(parts: Sequence[str], last: str = "and") -> str:
    """One, two and three."""
    return f"{', '.join(parts[:-1])} {last} {parts[-1]}" if len(parts) > 1 else "".join(parts)


def _upper(text: str) -> str:
    return text[:1].upper() + text[1:]


# ---------------------------------------------------------------------------------------------------------------
# Sentences
# ---------------------------------------------------------------------------------------------------------------
def paragraph(discrepancy: Discrepancy) -> str:
    """What is missing, how large it is, how far it closes the gap, what remains, and what the log cannot tell."""
    sentences = [sentence for effect in discrepancy.added for sentence in _added(discrepancy, effect)]
    sentences += [_gap(discrepancy)] if discrepancy.added else [_nothing_found(discrepancy)]
    sentences += [_unexplained(discrepancy, joint, ratio) for joint, ratio in discrepancy.unexplained]
    sentences += _lasting_floor(discrepancy)
    sentences += _not_testable(discrepancy)
    return " ".join(sentences)


def distinguishing_motions(added: AddedEffect) -> str:
    """The motions that would tell an effect from its equivalents."""
    kinds = [added.hypothesis.source.shown_by, *(FORMS[name].shown_by for name in added.equivalent)]
    return ", or ".join(dict.fromkeys(kinds))


def testable_groups(discrepancy: Discrepancy) -> list[tuple[str, tuple[int, ...]]]:
    """Effects that the log could not show, and all joints in which it could not; none: the whole robot."""
    ordered = sorted(discrepancy.not_testable)
    grouped = [(effect, list(group)) for effect, group in groupby(ordered, key=lambda pair: pair[0])]
    return [(effect, tuple(sorted({j for _, joints in group for j in joints}))) for effect, group in grouped]


def _added(discrepancy: Discrepancy, added: AddedEffect) -> list[str]:
    sentences = [_change(discrepancy, added) if added.hypothesis.changes else _need(discrepancy, added)]
    if added.probability < _SURE:
        sentences.append(
            f"The probability of this is {_percent(added.probability)}; that nothing is missing in its place, "
            f"{_percent(added.nothing_missing)}, that it is something outside of the catalogue, "
            f"{_percent(added.something_else)}."
        )
    if added.equivalent:
        others = listed([noun(name) for name in added.equivalent], "or")
        sentences.append(f"This log cannot tell it from {others}; {distinguishing_motions(added)} would.")
    return sentences


def _percent(share: float) -> str:
    """A probability; one that rounds to nothing or to all is not said to be."""
    return "under 1 %" if share < 0.01 else "over 99 %" if share > 0.99 else f"{100.0 * share:.0f} %"


def _numbers(discrepancy: Discrepancy, added: AddedEffect, changes: bool = False) -> dict[str, Quantity]:
    """The parameters without the joint in their names, as people speak of them; or their changes."""
    numbers, source = {}, added.hypothesis.source
    suffixes = [str(joint) for joint in added.joints] or [str(len(discrepancy.before))]
    for name, number in added.parameters.items():
        if name.startswith(_CHANGE) != changes:
            continue
        symbol = name.removeprefix(_CHANGE)
        known = symbol in source.phrase.units or not symbol.endswith(tuple(suffixes))
        short = symbol if known else symbol[: -len(next(s for s in suffixes if symbol.endswith(s)))].rstrip("_")
        numbers[short] = _for_people(source, short, number, changes)
    return numbers


def _for_people(effect: Effect, symbol: str, number: Quantity, change: bool) -> Quantity:
    value, sd, unit = number
    people = effect.phrase.units.get(symbol, ReadableUnit("" if unit == "1" else unit))
    return people.factor * (value - (0.0 if change else people.neutral)), people.factor * sd, people.unit


def _need(discrepancy: Discrepancy, added: AddedEffect) -> str:
    """Joint 3 needs Coulomb friction of 1.9 +- 0.1 N m."""
    phrase, numbers = added.hypothesis.source.phrase, _numbers(discrepancy, added)
    if not phrase.sentence or len(added.joints) > 1:
        return _plainly(added, numbers)
    who = _upper(joints_in_words(added.joints)) if added.joints else "All joints"
    whose = f"{who}'s" if added.joints else f"{who}'"
    shape = added.hypothesis.source.shape.get(phrase.size, [0.0])[0]
    value, sd, unit = numbers.get(phrase.size, (shape, math.nan, ""))
    sentence = phrase.sentence
    if phrase.opposite and value < 0.0:
        sentence, numbers[phrase.size] = phrase.opposite, (-value, sd, unit)
    try:
        return sentence.format(who=who, whose=whose, **{key: quantity(*number) for key, number in numbers.items()})
    except KeyError:
        return _plainly(added, numbers)


def _plainly(added: AddedEffect, numbers: Mapping[str, Quantity]) -> str:
    """Without a sentence of its own, or without its numbers."""
    where = _upper(joints_in_words(added.joints)) if added.joints else "The robot"
    parts = ", ".join(f"{symbol} = {quantity(*number)}" for symbol, number in numbers.items())
    needs = "need" if len(added.joints) > 1 else "needs"
    return f"{where} {needs} {noun(added.hypothesis.source.name)}{f' ({parts})' if parts else ''}."


def _change(discrepancy: Discrepancy, added: AddedEffect) -> str:
    """Joint 3's Coulomb friction has changed by +0.40 +- 0.10 N m, to 1.90 N m."""
    name = added.hypothesis.source.name
    whose = f"{_upper(joints_in_words(added.joints))}'s" if len(added.joints) == 1 else "The"
    where = f" of {joints_in_words(added.joints)}" if len(added.joints) > 1 else ""
    plain = label(name)
    changes, now = _numbers(discrepancy, added, changes=True), _numbers(discrepancy, added)
    size = added.hypothesis.source.phrase.size
    if size in changes:
        changes = {size: changes[size]}
    parts = []
    for symbol, change in changes.items():
        sign = "+" if change[0] > 0.0 else ""
        named = f" in {symbol}" if len(changes) > 1 else ""
        to = f", to {quantity(now[symbol][0], math.nan, now[symbol][2])}" if symbol in now else ""
        parts.append(f"by {sign}{quantity(*change)}{named}{to}")
    return f"{whose} {plain}{where} has changed{f' {listed(parts)}' if parts else ''}."


def _gap(discrepancy: Discrepancy) -> str:
    """With it the gap on the holdout falls from 2.4 to 0.31 N m in joint 3, the noise floor being 0.30 N m."""
    joints, floor = _worth_naming(discrepancy), discrepancy.floor.rms
    with_ = "With it" if len(discrepancy.added) == 1 else "With them"
    falls = _falls(discrepancy, joints[:_MOST], with_floor=len(joints) > 1)
    sentence = f"{with_} the gap on {_data(discrepancy)} {falls}"
    if len(joints) == 1:
        return f"{sentence}, the noise floor being {_effort(discrepancy, floor[joints[0] - 1], joints[0])}."
    rest = joints[_MOST:]
    if not rest:
        return f"{sentence}."
    most = max(float(discrepancy.after[j - 1] / floor[j - 1]) for j in rest)
    at_most = " at most" if len(rest) > 1 else ""
    return f"{sentence}; in {joints_in_words(rest)} it ends at {rounded(most)} times the floor{at_most}."


def _worth_naming(discrepancy: Discrepancy) -> list[int]:
    """Joints whose gap is worth naming, the largest first: above the floor before, and not named as unexplained."""
    unexplained = {joint for joint, _ in discrepancy.unexplained}
    acting = {joint for added in discrepancy.added for joint in added.joints}
    above = {excess.joint for excess in discrepancy.where}
    preferred = above - unexplained, acting - unexplained, above, acting, set(range(1, len(discrepancy.before) + 1))
    chosen = next(joints for joints in preferred if joints)
    return sorted(chosen, key=lambda j: -float(discrepancy.before[j - 1] / discrepancy.floor.rms[j - 1]))


def _falls(discrepancy: Discrepancy, joints: Sequence[int], with_floor: bool) -> str:
    """Falls from 2.4 to 0.31 N m in joint 3 and from 1.2 to 0.20 N m in joint 5."""
    parts: list[str] = []
    verb = ""
    for joint in joints:
        before, after = float(discrepancy.before[joint - 1]), float(discrepancy.after[joint - 1])
        earlier, verb = verb, "falls" if after < _SAME * before else "stays" if after < before / _SAME else "rises"
        sizes = f"at {rounded(after)}" if verb == "stays" else f"from {rounded(before)} to {rounded(after)}"
        floor = f" (noise floor {rounded(float(discrepancy.floor.rms[joint - 1]))})" if with_floor else ""
        sentence = f"{sizes} {unit_of(discrepancy, joint)} in joint {joint}{floor}"
        parts.append(sentence if verb == earlier else f"{verb} {sentence}")
    return listed(parts)


def _data(discrepancy: Discrepancy) -> str:
    return "the stretches held back" if discrepancy.holdout.startswith("stretches ") else "the holdout"


def _effort(discrepancy: Discrepancy, value: float, joint: int) -> str:
    return f"{rounded(float(value))} {unit_of(discrepancy, joint)}"


def _nothing_found(discrepancy: Discrepancy) -> str:
    if discrepancy.unexplained:
        return "Something is missing from the model, but no effect of the catalogue explains it."
    if discrepancy.where:
        joints = joints_in_words(excess.joint for excess in discrepancy.where)
        falls = _falls(discrepancy, _worth_naming(discrepancy)[:_MOST], with_floor=True)
        sentence = f"No effect is missing from the model, but its parameters do not quite fit {joints}"
        return f"{sentence}: with these identified again, the gap on {_data(discrepancy)} {falls}."
    ratio = discrepancy.before / discrepancy.floor.rms
    worst = int(ratio.argmax())
    gap = _effort(discrepancy, discrepancy.before[worst], worst + 1)
    floor = _effort(discrepancy, discrepancy.floor.rms[worst], worst + 1)
    return (
        f"{nothing_missing(discrepancy)}: the model explains this log as it is. On {_data(discrepancy)} it leaves "
        f"{rounded(float(ratio[worst]))} times the noise floor in joint {worst + 1} ({gap}, the floor being {floor}), "
        "and no more than that in any other."
    )


def _unexplained(discrepancy: Discrepancy, joint: int, ratio: float) -> str:
    shown = next((excess for excess in discrepancy.where if excess.joint == joint), None)
    over = f", and it shows best over {_range(discrepancy, shown)}" if shown else ""
    says, data = discrepancy.unexplained_on[joint], _data(discrepancy)
    reasons = []
    if ON_LOG in says or HELD_BACK in says:
        where = "" if ON_LOG in says else f" on {data}"
        reasons.append(f"what is left there{where} is {rounded(ratio, 2)} times the noise floor{over}")
    if GROWN in says:
        before, after = rounded(float(discrepancy.before[joint - 1])), discrepancy.after[joint - 1]
        reasons.append(
            f"identified again, its gap on {data} rises from {before} to {_effort(discrepancy, after, joint)}"
        )
    return f"Joint {joint} stays unexplained: {'; '.join(reasons)}."


def _lasting_floor(discrepancy: Discrepancy) -> list[str]:
    """In joints 4 and 6 the noise floor is the earlier model's own error, or noise that a filter has smoothed."""
    floor, whose = discrepancy.floor, dict[str, list[int]]()
    for j in np.flatnonzero(floor.lasting).tolist():
        whose.setdefault(floor.origin[j], []).append(j)
    sentences = []
    for origin, joints in whose.items():
        most = sorted(joints, key=lambda j: -float(floor.rms[j] / floor.white[j]))[:_MOST]
        sizes = [
            f"{rounded(float(floor.white[j]))} of {_effort(discrepancy, floor.rms[j], j + 1)} in joint {j + 1}"
            for j in most
        ]
        sentences.append(
            f"In {joints_in_words(j + 1 for j in joints)} the noise floor is the {_WHOSE[origin]} own error, or noise "
            f"that lasts: only {listed(sizes)} change{'s' if len(sizes) == 1 else ''} from sample to sample; what is "
            "below the floor may still be wrong."
        )
    return sentences


def nothing_missing(discrepancy: Discrepancy) -> str:
    """As much as can be said: below a floor that is a model's own error something may be."""
    return "Nothing is missing" + (" above the noise floor" if discrepancy.floor.lasting.any() else "")


def _range(discrepancy: Discrepancy, where: Excess) -> str:
    """Velocity (0.10 to 0.50 rad/s)."""
    (low, high), unit = where.range, unit_of(discrepancy, where.joint, where.variable)
    return f"{where.variable} ({rounded(low, 2)} to {rounded(high, 2)} {unit})"


def _not_testable(discrepancy: Discrepancy) -> list[str]:
    by_joints: dict[tuple[int, ...], list[str]] = {}
    for effect, joints in testable_groups(discrepancy):
        by_joints.setdefault(joints, []).append(noun(effect))
    parts = [
        f"{listed(names, 'or')} in {joints_in_words(joints)}" if joints else listed(names, "or")
        for joints, names in by_joints.items()
    ]
    if not parts:
        return []
    return [f"Even of a usual size this log could not show {'; '.join(parts)}."]
