"""Several logs as one self-contained page: what changed, what lacked all along, a time line, the last comparison."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayesid.discrepancy.comparison import ALL_ALONG, CHANGED, GONE, EffectHistory, LogComparison
from bayesid.parallel import one_at_a_time
from bayesid.report.pages.discrepancy_page import discrepancy_content, subject
from bayesid.report.pages.rendering import Picture, picture, render
from bayesid.report.plot.paper import Paper
from bayesid.report.plot.timeline import MOST, by_date, timeline_figure
from bayesid.report.timeline_text import (
    SECTIONS,
    Moved,
    changes_lead,
    columns,
    log_names,
    moved_parameters,
    says,
    timeline_rule,
    tracked_name,
)
from bayesid.report.words import joints_in_words, label, quantity

_SECTIONS = {"changes": "What changed, what was missing all along", "timeline": "Time line"}
"""Of the page, before those of the last comparison: name and title."""


@one_at_a_time
def comparison_page(comparison: LogComparison) -> str:
    """The report of several logs, in HTML: opens in a browser from anywhere, light or dark, and prints."""
    last = discrepancy_content(comparison.found[-1])
    said = columns(comparison)
    logs = log_names(comparison)
    both = CHANGED, ALL_ALONG
    content = last | {
        "lead": changes_lead(comparison),
        "about": [("Robot", comparison.earlier.model.robot.name), ("Logs", "; ".join(logs)), *_about(comparison)],
        "contents": _SECTIONS | last["contents"],
        "status": {"colour": "", "text": _status(comparison)},
        "warnings": comparison.warnings,
        "columns": [(SECTIONS[which], said[which]) for which in both],
        "more": [(SECTIONS[which], lines) for which, lines in said.items() if lines and which not in both],
        "first": logs[0],
        "logs": logs,
        "histories": [_history(one) for one in comparison.effects if one.by_log],
        "rule": timeline_rule(comparison),
        "moved": [_moved(row) for row in moved_parameters(comparison)],
        "stayed": _stayed(comparison),
        "timeline_pictures": [_picture(comparison)],
        "last": logs[-1],
        "last_lead": last["lead"],
    }
    return render("comparison.html.jinja", "What changed since the first log", subject(comparison.found[-1]), **content)


def _status(comparison: LogComparison) -> str:
    """In a few words."""
    moved = bool(comparison.of(CHANGED) or comparison.timeline.moved.any() or comparison.of(GONE))
    along = "something was missing all along" if comparison.of(ALL_ALONG) else "nothing is known to be missing"
    return f"Something has changed, {along}" if moved else f"Nothing has surely changed, {along}"


def _about(comparison: LogComparison) -> list[tuple[str, str]]:
    return [("Order", comparison.dates.basis), ("Last one scored on", comparison.found[-1].holdout)]


def _history(history: EffectHistory) -> dict[str, Any]:
    return {
        "name": label(history.name),
        "joints": joints_in_words(history.joints).split(" ", 1)[1] if history.joints else "whole robot",
        "became": SECTIONS[history.became],
        "says": [says(what) for what in history.by_log],
    }


def _moved(row: Moved) -> dict[str, Any]:
    return {
        "name": row.name,
        "values": [
            (value, quantity(value, sd, row.unit)) if np.isfinite(sd) and np.isfinite(value) else None
            for value, sd in zip(row.value, row.sd, strict=True)
        ],
        "change": row.change,
        "z": [z for z in row.z if np.isfinite(z)][-1],
    }


def _stayed(comparison: LogComparison) -> dict[str, Any]:
    """Names of what did not move, and of what too few logs show."""
    line = comparison.timeline
    tested, moved = np.isfinite(line.p).any(axis=0), line.moved.any(axis=0)
    flat, unseen = np.flatnonzero(tested & ~moved).tolist(), np.flatnonzero(~tested).tolist()
    return {
        "flat": [tracked_name(line.tracked[c]) for c in flat],
        "unseen": [tracked_name(line.tracked[c]) for c in unseen],
    }


def _picture(comparison: LogComparison) -> Picture:
    rows = moved_parameters(comparison)
    over = "days since the first log" if by_date(comparison) else "the logs in their order"
    more = f" The {len(rows) - MOST} that moved least are in the table alone." if len(rows) > MOST else ""
    caption = (
        f"Parameters that moved, with 95 % intervals, over {over}.{more} Last: the changes of all others, in their "
        "standard deviations."
    )
    alt = "; ".join(row.text for row in rows) or "No parameter moved."
    return picture(timeline_figure(comparison, Paper), "timeline", caption, f"Time line. {alt}")
