"""Tables of an identification that terminals and pages show alike."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bayesid.identification.gains import GIVEN
from bayesid.report.summary import Summary
from bayesid.report.words import in_percent, label, quantity, rounded

GAIN_HEADINGS = ("gain of joint", "stated", "value and sd", "95 % interval", "ratio to others known to", "decided by")
"""Of `gain_rows`."""


def gain_rows(summary: Summary) -> list[tuple[str, ...]]:
    """Gains that were unknowns: as stated, as found, the interval, how well its ratio to others is known, by what."""
    of_log = summary.gains
    if of_log is None:
        return []
    stated = of_log.stated.split(",")
    columns = (stated, of_log.mean, of_log.sd, of_log.lower, of_log.upper, of_log.ratio_sd, of_log.decided_by)
    return [
        (
            str(joint),
            said,
            quantity(mean or 0.0, sd or 0.0, of_log.unit),
            f"{rounded(lower or 0.0)} to {rounded(upper or 0.0)}",
            "" if by == GIVEN else in_percent(ratio or 0.0),
            by,
        )
        for joint, (said, mean, sd, lower, upper, ratio, by) in enumerate(zip(*columns, strict=True), start=1)
    ]


EFFECT_HEADINGS = ("beyond the terms", "log10 Bayes factor", "size and sd", "not told from")
"""Of `effect_rows`."""


def effect_rows(summary: Summary) -> list[tuple[str, str, str, str]]:
    """The effects that came on top of the terms: which, its evidence, its numbers, what could stand in its place."""
    effects = () if summary.complete is None else summary.complete.effects
    return [
        (
            label(effect.form, effect.joints),
            f"{effect.log10_bayes_factor or 0.0:.1f}",
            "; ".join(_number(name, value) for name, value in effect.parameters.items()),
            ", ".join(label(other) for other in effect.equivalent),
        )
        for effect in effects
    ]


def _number(name: str, number: Mapping[str, Any]) -> str:
    sd = math.nan if number["sd"] is None else number["sd"]
    return f"{name} {quantity(number['value'], sd, number['unit'].removeprefix('1'))}"
