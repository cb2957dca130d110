"""A discrepancy as one self-contained page: words, tables and figures; nothing is fetched, nothing runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayesid.discrepancy.compare import Excess
from bayesid.discrepancy.selection import GROWN, HELD_BACK, ON_LOG
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.fit.effects.added_effect import AddedEffect
from bayesid.fit.effects.explanation import LN10
from bayesid.fit.effects.hypotheses import Hypothesis
from bayesid.fit.effects.scores import Score
from bayesid.model.catalogue import FORMS
from bayesid.report.pages.rendering import Picture, picture, render
from bayesid.report.plot.discrepancy import BARS, candidate_figure, effort_figure, gap_figure, residual_figure
from bayesid.report.words import (
    best_first,
    distinguishing_motions,
    joints_in_words,
    label,
    nothing_missing,
    paragraph,
    quantity,
    rounded,
    score_label,
    testable_groups,
    unit_of,
)

_STATUS = {
    "explained": "Explained: what was missing is found",
    "unexplained": "Not explained: something is still missing",
}
_SAID = {ON_LOG: "on the log", HELD_BACK: "on what scores", GROWN: "the gap grew"}
"""Which data say that a joint is unexplained, in a cell."""
_CANDIDATES = 25
"""Candidates that are listed: a screen full."""


def discrepancy_page(discrepancy: Discrepancy) -> str:
    """The report of a comparison, in HTML: opens in a browser from anywhere, light or dark, and prints."""
    identification = discrepancy.identification
    robot = identification.model.robot.name
    return render(
        "discrepancy.html.jinja",
        "What the model lacks",
        robot,
        status={"colour": discrepancy.status, "text": _STATUS.get(discrepancy.status, nothing_missing(discrepancy))},
        lead=paragraph(discrepancy),
        about=[("Robot", robot), ("Log", identification.log.source), ("Scored on", discrepancy.holdout)],
        warnings=discrepancy.warnings,
        holdout=discrepancy.holdout,
        gaps=[_gap(discrepancy, j) for j in range(len(discrepancy.before))],
        gap_pictures=[_gap_picture(discrepancy)],
        added=[_added(effect) for effect in discrepancy.added],
        where=[_where(discrepancy, excess) for excess in discrepancy.where],
        residual_pictures=[_residual_picture(discrepancy, excess) for excess in discrepancy.where],
        unsigned=_unsigned(discrepancy),
        effort_pictures=[_effort_picture(discrepancy, j + 1) for j in range(len(discrepancy.before))],
        **_candidates(discrepancy),
        left_out=[label(effect, joints) for effect, joints in discrepancy.vetoed],
        not_testable=[
            (label(effect), _joints(joints), FORMS[effect].shown_by) for effect, joints in testable_groups(discrepancy)
        ],
    )


# ---------------------------------------------------------------------------------------------------------------
# Rows
# ---------------------------------------------------------------------------------------------------------------
def _gap(discrepancy: Discrepancy, j: int) -> dict[str, Any]:
    floor = discrepancy.floor
    return {
        "unit": unit_of(discrepancy, j + 1),
        "before": discrepancy.before[j],
        "after": discrepancy.after[j],
        "floor": floor.rms[j],
        "white": floor.white[j],
        "origin": floor.origin[j] + ("" if floor.sharp[j] else " (a lower bound)") + _whose_error(discrepancy, j),
        "unexplained": dict(discrepancy.unexplained).get(j + 1),
        "says": ", ".join(_SAID[which] for which in discrepancy.unexplained_on.get(j + 1, ())),
    }


def _whose_error(discrepancy: Discrepancy, j: int) -> str:
    return "; most of it lasts: that model's own error, or smoothed noise" if discrepancy.floor.lasting[j] else ""


def _added(effect: AddedEffect) -> dict[str, Any]:
    return {
        "name": _name(effect.hypothesis),
        "joints": _joints(effect.joints),
        "parameters": [
            (name, value, quantity(float(value), float(sd), unit))
            for name, (value, sd, unit) in effect.parameters.items()
        ],
        "gain": effect.gain / LN10,
        "probability": effect.probability,
        "nothing_missing": effect.nothing_missing,
        "something_else": effect.something_else,
        "equivalent": ", ".join(label(name) for name in effect.equivalent),
        "shown_by": distinguishing_motions(effect),
    }


def _where(discrepancy: Discrepancy, excess: Excess) -> dict[str, Any]:
    low, high = excess.range
    return {
        "joint": excess.joint,
        "excess": excess.excess,
        "effort_unit": unit_of(discrepancy, excess.joint),
        "variable": excess.variable,
        "low": low,
        "high": high,
        "unit": unit_of(discrepancy, excess.joint, excess.variable),
    }


def _unsigned(discrepancy: Discrepancy) -> str:
    joints = np.flatnonzero(~np.asarray(discrepancy.trial.signals.signed)) + 1
    return joints_in_words(joints.tolist()) if len(joints) else ""


def _candidates(discrepancy: Discrepancy) -> dict[str, Any]:
    scores = discrepancy.scores
    if not scores:
        return {"candidates": []}
    added = {(effect.effect, effect.joints) for effect in discrepancy.added}
    rows = [_candidate(score, score.key in added) for score in best_first(scores)[:_CANDIDATES]]
    caption = (
        f"The best {len(rows)} of {len(scores)} candidates, each added by itself to the model as it was. To be added, "
        f"an effect needs a log10 Bayes factor of {discrepancy.thresholds.log10_bayes_factor:g} and must be worth it; "
        "what explains the same as a better one no longer does once that is added. The last columns hold what an "
        "effect of a usual size would have reached, and the effect's worth: by how much it lowers a joint's mean "
        "squared residual, in units of the noise floor's or, where much more is left, of a part of that."
    )
    return {"candidates": rows, "candidates_caption": caption, "candidate_pictures": [_candidate_picture(discrepancy)]}


def _candidate(score: Score, added: bool) -> dict[str, Any]:
    return {
        "name": _name(score.hypothesis),
        "joints": _joints(score.hypothesis.joints),
        "gain": score.gain / LN10,
        "added": added,
        "expected_gain": score.expected_gain / LN10,
        "improvement": score.improvement,
    }


def _joints(joints: Sequence[int]) -> str:
    return joints_in_words(joints).split(" ", 1)[1] if joints else "whole robot"


def _name(hypothesis: Hypothesis) -> str:
    """An effect's name, which form of it, and whether it is a change of what the model has."""
    form = hypothesis.source.name
    remarks = [form.split(".", 1)[1].replace("_", " ")] if "." in form else []
    remarks += ["changed"] if hypothesis.changes else []
    return label(hypothesis.effect) + (f" ({', '.join(remarks)})" if remarks else "")


# ---------------------------------------------------------------------------------------------------------------
# Figures
# ---------------------------------------------------------------------------------------------------------------
def _gap_picture(discrepancy: Discrepancy) -> Picture:
    gaps = zip(discrepancy.before, discrepancy.after, discrepancy.floor.rms, strict=True)
    bars = "; ".join(
        f"joint {joint}: {rounded(float(before))} before, {rounded(float(after))} after, floor {rounded(float(floor))}"
        for joint, (before, after, floor) in enumerate(gaps, start=1)
    )
    caption = "The same in units of each joint's noise floor."
    return picture(gap_figure(discrepancy), "gap", caption, f"Bars of the gap of each joint in N m: {bars}")


def _residual_picture(discrepancy: Discrepancy, excess: Excess) -> Picture:
    joint, variable, (low, high) = excess.joint, excess.variable, excess.range
    caption = f"Joint {joint}: measured minus modelled effort over {variable}."
    alt = (
        f"Residual of joint {joint} over {variable}, of the model as it was and of the extended model. As it was, it "
        f"exceeds the noise floor by {rounded(excess.excess)} {unit_of(discrepancy, joint)}, most of it between "
        f"{rounded(low)} and {rounded(high)} {unit_of(discrepancy, joint, variable)}."
    )
    return picture(residual_figure(discrepancy, joint), f"residual{joint}", caption, alt)


def _effort_picture(discrepancy: Discrepancy, joint: int) -> Picture:
    alt = f"Effort of joint {joint} over time: measured, by the model as it was, and by the extended model."
    return picture(effort_figure(discrepancy, joint), f"effort{joint}", f"Joint {joint}.", alt)


def _candidate_picture(discrepancy: Discrepancy) -> Picture:
    scores = discrepancy.scores
    caption = f"The first {min(BARS, len(scores))}; blue: added. The dashed line is what an effect needs to be added."
    bars = "; ".join(f"{score_label(score)}: {rounded(score.gain / LN10)}" for score in best_first(scores)[:BARS])
    return picture(candidate_figure(discrepancy), "candidates", caption, f"Bars of log10 Bayes factors: {bars}")
