"""Rows of the tables of additional effects, gains and constraints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayesid.effects.catalogue import forms
from bayesid.effects.effect import Phrase
from bayesid.identification.checks import spread_in_words
from bayesid.identification.gains import GIVEN
from bayesid.identification.tuning import TUNING as IDENTIFICATION
from bayesid.number_text import percent, quantity, rounded
from bayesid.report.summary import Summary
from bayesid.report.words import label, readable_unit, sizes_in_words

EFFECT_HEADINGS = ("additional effect", "log10 Bayes factor", "size and sd", "fits equally well")
"""Of `effect_rows`."""


def effect_rows(summary: Summary) -> list[tuple[str, ...]]:
    """Added effects: name, Bayes factor, parameters, equivalent effects."""
    return [
        (
            label(effect.form, effect.joints),
            f"{effect.log10_bayes_factor or 0.0:.1f}",
            "; ".join(_number(effect.form, name, number) for name, number in effect.parameters.items()),
            ", ".join(label(other) for other in effect.equivalent),
        )
        for effect in (() if summary.complete is None else summary.complete.effects)
    ]


def effect_symbols(summary: Summary) -> str:
    """What symbols and fixed numbers in the table of effects mean; empty without effects."""
    found = () if summary.complete is None else summary.complete.effects
    sentences = dict.fromkeys(filter(None, (sizes_in_words(effect.form) for effect in found)))
    parts = [f"sizes in brackets: {'; '.join(sentences)}"] if sentences else []
    if any(number["sd"] is None for effect in found for number in effect.parameters.values()):
        parts.append("fixed: without an sd; the other sizes are given this value")
    return "; ".join(parts)


def _number(form: str, name: str, number: Mapping[str, Any]) -> str:
    readable = readable_unit(forms()[form].phrase if form in forms() else Phrase(), name, number["unit"])
    value = readable.factor * (number["value"] - readable.neutral)
    if number["sd"] is None:
        return f"{name} {quantity(value, 0.0, readable.unit)} (fixed)"
    return f"{name} {quantity(value, readable.factor * number['sd'], readable.unit)}"


GAIN_HEADINGS = ("gain of joint", "stated", "value and sd", "95 % interval", "sd of ratio to others", "decided by")
"""Of `gain_rows`."""


def gain_rows(summary: Summary) -> list[tuple[str, ...]]:
    """Estimated gains: stated, mean and sd, interval, sd of the ratio to the others, what decides it."""
    found = summary.gains
    if found is None:
        return []
    columns = (found.stated.split(","), found.mean, found.sd, found.lower, found.upper, found.ratio_sd)
    return [
        (
            str(joint),
            stated,
            _gain(mean or 0.0, sd or 0.0, found.unit),
            f"{rounded(lower or 0.0)} to {rounded(upper or 0.0)}",
            "" if by == GIVEN else percent(ratio or 0.0),
            by,
        )
        for joint, (stated, mean, sd, lower, upper, ratio, by) in enumerate(
            zip(*columns, found.decided_by, strict=True), start=1
        )
    ]


def _gain(mean: float, sd: float, unit: str) -> str:
    """With its deviation, or the factor to which it is known if that is large."""
    if sd <= IDENTIFICATION.wide_factor * abs(mean):
        return quantity(mean, sd, unit)
    return f"{rounded(mean, 2)} {unit}, to {spread_in_words(sd / abs(mean))}"


CONSTRAINT_HEADINGS = ("constraint", "cost of satisfying it", "draws at its edge", "limits the draws")
"""Of `constraint_rows`."""


def constraint_rows(summary: Summary) -> list[tuple[str, ...]]:
    """Stated constraints: cost, draws at the edge, and whether it limits the draws."""
    return [
        (
            constraint.label,
            _cost(2.0 * constraint.nats),
            "" if constraint.at_edge is None else percent(constraint.at_edge, 1),
            "" if constraint.at_edge is None else "yes" if constraint.presses else "no",
        )
        for constraint in summary.constraints
    ]


def _cost(cost: float) -> str:
    if cost == 0.0:
        return "none: the best fit satisfies it"
    return f"{cost:.1f}" if cost >= 0.05 else "under 0.1"
