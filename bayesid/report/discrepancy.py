"""Report of a discrepancy: a check for each finding, and the content of discrepancy.json."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import groupby
from typing import Any

import numpy as np

from bayesid.discrepancy.case import MODELS_RESIDUAL, REFIT
from bayesid.discrepancy.numbers import CHANGE_OF
from bayesid.discrepancy.selection import GROWN, HELD_BACK, ON_LOG
from bayesid.discrepancy.sets import WeighedSet
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.effects.catalogue import forms, noun, owner
from bayesid.effects.effect import Effect
from bayesid.identification.checks import Check
from bayesid.identification.prediction import NORMAL_95
from bayesid.number_text import percent, quantity, rounded
from bayesid.regression.selection.added_effect import AddedEffect, Quantity
from bayesid.regression.selection.fitted_effects import LN10
from bayesid.regression.selection.scores import Score
from bayesid.report.conclusion import EXPLAINED, Conclusion, first, sentence
from bayesid.report.grading import failed
from bayesid.report.summary import as_object, taken
from bayesid.report.tuning import TUNING
from bayesid.report.words import joints_in_words, label, listed, readable_unit, unit_of, upper

_MODELS = {MODELS_RESIDUAL: "earlier model's", REFIT: "refitted model's"}
"""The model whose error a floor may contain, by the floor's source."""
HOLDOUT = "the holdout"
"""Name of another log that scores the models."""


def above_the_floor(discrepancy: Discrepancy) -> str:
    """Words for a noise floor that may contain a model's error, which hides smaller effects."""
    return " above the noise floor" if discrepancy.floor.mostly_coloured.any() else ""


def discrepancy_conclusion(discrepancy: Discrepancy) -> Conclusion:
    """The verdict, with its first remedies."""
    state, text = EXPLAINED.get(discrepancy.status, ("good", f"No effect is missing{above_the_floor(discrepancy)}"))
    reasons = [check for check in failed(discrepancy_checks(discrepancy)) if check.remedy and check.state != "not done"]
    return Conclusion(state, sentence(state, text), first(reasons))


def listed_sets(discrepancy: Discrepancy) -> list[WeighedSet]:
    """The sets that are probable enough to be listed."""
    return [effect_set for effect_set in discrepancy.sets if effect_set.probability >= TUNING.set_listed]


def set_in_words(effect_set: WeighedSet) -> str:
    """Such as Coulomb friction, joint 2 + joint spring, joint 2."""
    return " + ".join(label(effect, joints) for effect, joints in effect_set.effects) or "nothing"


# ---- A check for each finding ----
def discrepancy_checks(discrepancy: Discrepancy) -> tuple[Check, ...]:
    """Effects found (good or look), unexplained joints (bad), and effects that were not testable (not done)."""
    return (
        *(_found(discrepancy, added) for added in discrepancy.added),
        *(_unexplained(discrepancy, joint) for joint, _ in discrepancy.unexplained),
        *(_not_learned(discrepancy, refused) for refused in discrepancy.refused if refused.description is not None),
        *_preexisting(discrepancy),
        *_lasting_floor(discrepancy),
        *_not_testable(discrepancy),
    )


def _found(discrepancy: Discrepancy, added: AddedEffect) -> Check:
    name, motion = upper(label(added.effect, added.joints)), added.hypothesis.source.shown_by
    if impossible := below_zero(added):
        message = f"alone it would make {listed(impossible)} negative, which is impossible: a similar effect is present"
        return Check(name, "look", message, f"{motion} would identify it")
    changes, detail, n = bool(added.hypothesis.changes), added.hypothesis.source.phrase.detail, len(discrepancy.before)
    parts = [_change(added, n) if changes else _need(added, n)]
    if added.description is not None:
        parts = [f"{parts[0].removesuffix('.')}: {added.formula}. It {added.description.sentence}."]
    elif added.readable and detail and not changes:
        parts.append(detail.format(**{symbol: quantity(*number) for symbol, number in added.readable.items()}))
    if (size := added.size) is not None:
        largest = effort_in_words(discrepancy, size.largest, size.joint)
        parts.append(f"Its largest effort is {largest}, {percent(size.share)} of joint {size.joint}'s {size.of}.")
    uncertain, alike = added.probability < TUNING.sure, equivalents(added, noun)
    if uncertain:
        shares = added.probability, added.nothing_missing, added.something_else
        this, none, other = map(_percent, shares)
        parts.append(f"Probability: {this} this effect, {none} no effect, {other} another effect.")
    if alike:
        parts.append(f"This log cannot distinguish it from {listed(alike, 'or')}.")
    remedy = f"{motion} would distinguish them; `bayesid excite --for FOLDER` of this result designs one"
    return Check(
        name, "look" if uncertain or alike else "good", " ".join(parts).removesuffix("."), remedy if alike else ""
    )


def _not_learned(discrepancy: Discrepancy, refused: AddedEffect) -> Check:
    assert refused.description is not None
    learned = f"a function learned in {joints_in_words(refused.joints)} was not added"
    message = f"{learned}: {data_in_words(discrepancy)} did not confirm it. It {refused.description.sentence}"
    return Check("Learned function", "look", message, f"{refused.hypothesis.source.shown_by} would show it")


def below_zero(added: AddedEffect) -> list[str]:
    """Friction that an effect would make negative, which is impossible."""
    impossible = []
    for symbol, other in added.hypothesis.source.adds_to.items():
        term, coefficient = owner(other)
        for joint in added.joints:
            number = added.parameters.get(f"{other}{joint}", added.parameters.get(f"{symbol}{joint}"))
            if coefficient.nonnegative and number is not None and number[0] < 0.0:
                impossible.append(f"the {label(term.name)} of joint {joint}")
    return impossible


def equivalents(added: AddedEffect, called: Callable[[str], str]) -> list[str]:
    """Effects that the log cannot distinguish from this one, with joints if these differ."""
    rows = [f"{called(name)} ({joints_in_words(joints)})" for name, joints in added.elsewhere]
    return [*map(called, added.equivalent), *rows]


def _percent(share: float) -> str:
    return "under 1 %" if share < 0.01 else "over 99 %" if share > 0.99 else percent(share, 0)


def data_in_words(discrepancy: Discrepancy) -> str:
    """The data for scoring."""
    return "the held-back blocks" if discrepancy.holdout.startswith("held-back blocks ") else HOLDOUT


def new_model(discrepancy: Discrepancy) -> str:
    """What the model after the comparison is called: fitted to both logs, with the added effects if there are some."""
    return "extended model" if discrepancy.added else "refitted model"


def above_floor(discrepancy: Discrepancy, joint: int, ratio: float) -> float:
    """RMS of a joint (from 1) above its noise floor, N m, if its residual is `ratio` times the floor."""
    return float(discrepancy.floor.rms[joint - 1]) * math.sqrt(max(ratio**2 - 1.0, 0.0))


def effort_in_words(discrepancy: Discrepancy, value: float, joint: int) -> str:
    """An effort of a joint (from 1) with its unit."""
    return f"{rounded(float(value))} {unit_of(discrepancy, joint)}"


def over_the_floor(discrepancy: Discrepancy, joint: int) -> tuple[float, str]:
    """Ratio of an unexplained joint's residual to the noise floor, as in the table of gaps if held-back data show it.

    Otherwise that on the log. Also names the data.
    """
    shown_on = discrepancy.unexplained_on[joint]
    if ON_LOG in shown_on and HELD_BACK not in shown_on:
        return dict(discrepancy.unexplained)[joint], "the log"
    return float(discrepancy.after[joint - 1] / discrepancy.floor.rms[joint - 1]), data_in_words(discrepancy)


def _unexplained(discrepancy: Discrepancy, joint: int) -> Check:
    shown_on, data, reasons = discrepancy.unexplained_on[joint], data_in_words(discrepancy), list[str]()
    if ON_LOG in shown_on or HELD_BACK in shown_on:
        ratio, where = over_the_floor(discrepancy, joint)
        reasons.append(f"its residual on {where} is {rounded(ratio)} times the noise floor")
        for shown in (excess for excess in discrepancy.where if excess.joint == joint):
            (low, high), unit = shown.range, unit_of(discrepancy, joint, shown.variable)
            reasons[-1] += f", largest over {shown.variable} ({rounded(low, 2)} to {rounded(high, 2)} {unit})"
    if GROWN in shown_on:
        before, after = rounded(float(discrepancy.before[joint - 1])), discrepancy.after[joint - 1]
        reasons.append(f"its gap on {data} grows from {before} to {effort_in_words(discrepancy, after, joint)}")
    message = f"Joint {joint} is unexplained: {'; '.join(reasons)}"
    return Check("Unexplained", "bad", message, "see its residual in discrepancy.html: no tested effect explains it")


def _lasting_floor(discrepancy: Discrepancy) -> Iterator[Check]:
    """Joints whose noise floor is mostly correlated: a model's error, or filtered noise."""
    floor, by_origin = discrepancy.floor, dict[str, list[int]]()
    for j in np.flatnonzero(floor.mostly_coloured).tolist():
        by_origin.setdefault(floor.origin[j], []).append(j + 1)
    for origin, joints in by_origin.items():
        error = f"the {_MODELS[origin]} error, or filtered noise"
        message = f"In {joints_in_words(joints)} the noise floor is mostly correlated: {error}"
        yield Check("Noise floor", "look", message, "record the same motion twice: the difference is the noise")


def _preexisting(discrepancy: Discrepancy) -> Iterator[Check]:
    """Additional effects of the earlier model that this log shows too, unchanged."""
    changed = {added.hypothesis.key for added in discrepancy.added}
    if same := [label(effect, joints) for effect, joints in discrepancy.preexisting if (effect, joints) not in changed]:
        yield Check("In both logs", "good", f"{'; '.join(same)}: in the earlier model, and confirmed by this log")


def testable_groups(discrepancy: Discrepancy) -> list[tuple[str, tuple[int, ...]]]:
    """Effects that the log could not show and that were not found, with their joints; no joints: the whole robot."""
    found = {added.hypothesis.key for added in discrepancy.added}
    grouped = groupby(sorted(set(discrepancy.not_testable) - found), key=lambda pair: pair[0])
    return [(effect, tuple(sorted({j for _, joints in group for j in joints}))) for effect, group in grouped]


def _not_testable(discrepancy: Discrepancy) -> Iterator[Check]:
    by_joints: dict[tuple[int, ...], list[str]] = {}
    for effect, joints in testable_groups(discrepancy):
        by_joints.setdefault(joints, []).append(noun(effect))
    if by_joints:
        places = [f" in {joints_in_words(joints)}" if joints else "" for joints in by_joints]
        parts = [f"{listed(names, 'or')}{place}" for names, place in zip(by_joints.values(), places, strict=True)]
        message = f"This log cannot show the following effects, if they have their usual size: {'; '.join(parts)}"
        yield Check("Not testable", "not done", message, "record a motion of the last table")


# ---- Numbers of an effect in readable units ----
def _readable(source: Effect, name: str, number: Quantity) -> Quantity:
    value, sd, unit = number
    readable = readable_unit(source.phrase, name, unit)
    return readable.factor * (value - readable.neutral), readable.factor * sd, readable.unit


def parameter_text(added: AddedEffect, name: str) -> str:
    """Such as 1.9 +- 0.1 N m, or 9.1 -> 7.3 +- 0.5 N m if the earlier model has the parameter."""
    source, number = added.hypothesis.source, added.parameters[name]
    value, sd, unit = _readable(source, name, number)
    now = quantity(value, sd, unit)
    if (change := added.parameters.get(f"{CHANGE_OF}{name}")) is None:
        return now
    earlier = value - readable_unit(source.phrase, name, number[2]).factor * change[0]
    decimals = len(now.split()[0].partition(".")[2])
    return f"{f'{earlier:.{decimals}f}' if now[0] != '(' else rounded(earlier)} -> {now}"


def _numbers(added: AddedEffect, n: int) -> dict[str, str]:
    """Texts of the parameters, by symbols without the joint; of the earlier model's parameters before and now."""
    source, suffixes = added.hypothesis.source, [str(joint) for joint in added.joints] or [str(n)]
    texts = {}
    for name in added.parameters:
        known = name in source.phrase.units or not name.endswith(tuple(suffixes))
        symbol = name if known else name[: -len(next(s for s in suffixes if name.endswith(s)))]
        if name.startswith(CHANGE_OF) or symbol in source.adds_to.values():
            continue
        total = f"{source.adds_to.get(symbol, symbol)}{name[len(symbol) :]}"
        texts[symbol.rstrip("_")] = parameter_text(added, total if total in added.parameters else name)
    return texts


def main_number(added: AddedEffect, n: int) -> str:
    """The size of an effect of one joint or of the whole robot; empty if it has several parameters."""
    numbers, size = _numbers(added, n), added.hypothesis.source.phrase.size
    if added.readable or len(added.joints) > 1 or added.description is not None:
        return ""
    return numbers.get(size, "") if size or len(numbers) != 1 else next(iter(numbers.values()))


def _need(added: AddedEffect, n: int) -> str:
    """Such as Joint 3 needs Coulomb friction of 1.9 +- 0.1 N m."""
    numbers, phrase = _numbers(added, n), added.hypothesis.source.phrase
    sentence, size = phrase.sentence, _size(added)
    if not sentence or len(added.joints) > 1:
        return _plainly(added, numbers)
    who = upper(joints_in_words(added.joints)) if added.joints else "All joints"
    whose = f"{who}'s" if added.joints else f"{who}'"
    if phrase.opposite and size is not None and size[0] < 0.0:
        value, sd, unit = size
        sentence, numbers[phrase.size] = phrase.opposite, quantity(-value, sd, unit)
    try:
        return sentence.format(who=who, whose=whose, **numbers)
    except KeyError:
        return _plainly(added, numbers)


def _size(added: AddedEffect) -> Quantity | None:
    """The number whose sign selects a sentence or its opposite, if there is one."""
    source, size = added.hypothesis.source, added.hypothesis.source.phrase.size
    name = f"{size}{added.joints[0] if added.joints else ''}"
    if name in added.parameters:
        return _readable(source, size, added.parameters[name])
    return (source.shape[size][0], math.nan, "") if size in source.shape else None


def _plainly(added: AddedEffect, numbers: Mapping[str, str]) -> str:
    """Such as Joints 1 and 2 need Coulomb friction (Fc = 1.9 +- 0.1 N m)."""
    where = upper(joints_in_words(added.joints)) if added.joints else "The robot"
    parts = ", ".join(f"{symbol} = {number}" for symbol, number in numbers.items())
    needs = "need" if len(added.joints) > 1 else "needs"
    return f"{where} {needs} {noun(added.hypothesis.source.name)}{f' ({parts})' if parts else ''}."


def _change(added: AddedEffect, n: int) -> str:
    """Such as: It has changed: 9.1 -> 7.3 +- 0.5 N m."""
    source, numbers = added.hypothesis.source, _numbers(added, n)
    chosen = {source.phrase.size: numbers[source.phrase.size]} if source.phrase.size in numbers else numbers
    parts = [f"{symbol} " * (len(chosen) > 1) + text for symbol, text in chosen.items()]
    changes = [number for name, number in added.parameters.items() if name.startswith(CHANGE_OF)]
    insignificant = changes and all(abs(change) < NORMAL_95 * sd for change, sd, _ in changes)  # no for nan
    verb = "has not changed significantly" if insignificant else "has changed"
    return f"It {verb}{f': {listed(parts)}' if parts else ''}."


# ---- discrepancy.json ----
def discrepancy_summary(discrepancy: Discrepancy) -> dict[str, Any]:
    """discrepancy.json of a result: SI units, joints from 1, gaps as RMS in N m."""
    floor = discrepancy.floor
    return as_object(
        {
            **taken(discrepancy, "status", "where"),
            "found": [added_summary(effect) for effect in discrepancy.added],
            "sets": [{"effects": _named(each.effects), "probability": each.probability} for each in discrepancy.sets],
            "gap": {
                **taken(
                    discrepancy, "before", "after", "holdout", noise_floor=floor.rms, noise_floor_white=floor.white
                ),
                "noise_floor_from": floor.origin,
                "noise_floor_lasting": np.flatnonzero(floor.mostly_coloured) + 1,
            },
            "unexplained": [
                {"joint": joint, "ratio_to_floor": ratio, "seen_on": discrepancy.unexplained_on[joint]}
                for joint, ratio in discrepancy.unexplained
            ],
            "candidates": [_candidate(score) for score in discrepancy.scores],
            "not_borne_out": [
                taken(effect, "effect", "joints", "log10_bayes_factor", "equivalent") | _learned(effect)
                for effect in discrepancy.refused
            ],
            "not_testable": _named(testable_groups(discrepancy)),
            "preexisting": _named(discrepancy.preexisting),
            "log": discrepancy.identification.log.source,
            **taken(discrepancy, "seconds", "warnings"),
        }
    )


def added_summary(effect: AddedEffect) -> dict[str, Any]:
    """An added effect in discrepancy.json."""
    alike, size, cost = [*effect.equivalent, *(name for name, _ in effect.elsewhere)], effect.size, effect.cost
    numbers = {
        of: {name: dict(zip(("value", "sd", "unit"), number, strict=True)) for name, number in values.items()}
        for of, values in (("parameters", effect.parameters), ("readable", effect.readable))
    }
    return {
        **taken(effect, "effect", "joints", "log10_bayes_factor", "probability", "equivalent"),
        "form": effect.hypothesis.source.name,
        "change_of_what_was_there": bool(effect.hypothesis.changes),
        "equivalent_elsewhere": _named(effect.elsewhere),
        "told_apart_by": {name: forms()[name].shown_by for name in sorted({effect.effect, *alike})} if alike else {},
        "inclusion_probability": effect.included,
        "probability_nothing_missing": effect.nothing_missing,
        "probability_something_else": effect.something_else,
        **numbers,
        "effort": size and taken(size, "joint", "rms", "largest", "of", percent=100.0 * size.share),
        "cost_if_ignored": cost
        and taken(
            *(cost, "joint", "before", "after"),
            percent_before=100.0 * cost.share_before,
            percent_after=100.0 * cost.share_after,
        ),
        "alternatives": [_candidate(rival) for rival in effect.competing[:5]],
        **_learned(effect),
    }


def _learned(effect: AddedEffect) -> dict[str, Any]:
    if effect.description is None:
        return {}
    description, families = effect.description.sentence, effect.description.families
    return taken(effect, "variables", "formula", description=description, looks_like=families)


def _named(effects: Iterable[tuple[str, tuple[int, ...]]]) -> list[dict[str, Any]]:
    return [{"effect": name, "joints": joints} for name, joints in effects]


def _candidate(score: Score) -> dict[str, Any]:
    return taken(score.hypothesis, "effect", "joints", log10_bayes_factor=score.gain / LN10)
