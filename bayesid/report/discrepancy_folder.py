"""The folder of a discrepancy: discrepancy.json and the result folder of the extended model."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.discrepancy.comparison import EffectHistory, LogComparison
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.effects.catalogue import forms
from bayesid.files.writing import write_json, write_table
from bayesid.progress import SILENT, Progress
from bayesid.regression.selection.added_effect import AddedEffect
from bayesid.regression.selection.explanation import LN10
from bayesid.regression.selection.scores import Score
from bayesid.report.discrepancy_verdicts import testable_groups
from bayesid.report.folders import save_result
from bayesid.report.summary import as_json, as_object, taken
from bayesid.report.timeline_text import Moved, columns, moved_parameters, timeline_rule


def save_discrepancy(
    discrepancy: Discrepancy, folder: str | Path, report: bool = True, progress: Progress = SILENT
) -> Path:
    """Writes discrepancy.json, a report of it, and the result folder of the extended model.

    Args:
        discrepancy: what to write.
        folder: where; an earlier result there is replaced as a whole.
        report: whether the extended model's own report.html is made too, which takes some seconds.
        progress: called as progress("report", done, total).

    Raises:
        InputError: the folder cannot be written, or holds other files than an earlier result.
        KeyboardInterrupt: with a text that says so where the result stands already.

    Warns:
        IncompleteWarning: an export or a page could not be written; the rest stands.

    Example:
        >>> (bayesid.save_discrepancy(found, "found", report=False) / "discrepancy.json").is_file()
        True
    """

    def page() -> str:
        from bayesid.report.pages.discrepancy_page import discrepancy_page  # jinja2, for pages alone

        return discrepancy_page(discrepancy)

    def write(place: Path) -> None:
        write_json(place / "discrepancy.json", discrepancy_summary(discrepancy))

    return save_result(discrepancy.identification, folder, report, progress, write, page)


def save_comparison(
    comparison: LogComparison, folder: str | Path, report: bool = True, progress: Progress = SILENT
) -> Path:
    """Writes discrepancy.json, timeline.csv, a report of both, and the result folder of the last log's extended model.

    Arguments and errors are those of `save_discrepancy`.

    Example:
        >>> both = bayesid.compare_logs(robot, [log, other_log], terms, posterior=False)
        >>> (bayesid.save_comparison(both, "days", report=False) / "timeline.csv").is_file()
        True
    """

    def page() -> str:
        from bayesid.report.pages.discrepancy_page import comparison_page  # jinja2, for pages alone

        return comparison_page(comparison)

    def write(place: Path) -> None:
        write_json(place / "discrepancy.json", comparison_summary(comparison))
        write_table(place / "timeline.csv", timeline_rows(comparison))

    return save_result(comparison.found[-1].identification, folder, report, progress, write, page)


def discrepancy_summary(discrepancy: Discrepancy) -> dict[str, Any]:
    """discrepancy.json of a result: SI units, joints from 1, gaps as RMS in N m."""
    floor = discrepancy.floor
    refused = [
        taken(effect, "effect", "joints", "log10_bayes_factor", "equivalent") | _learned(effect)
        for effect in discrepancy.refused
    ]
    return as_object(
        {
            **taken(discrepancy, "status", "where"),
            "found": [_added(effect) for effect in discrepancy.added],
            "sets": [{"effects": _named(one.effects), "probability": one.probability} for one in discrepancy.sets],
            "gap": {
                **taken(discrepancy, "before", "after"),
                "noise_floor": floor.rms,
                "noise_floor_from": floor.origin,
                "noise_floor_white": floor.white,
                "noise_floor_lasting": np.flatnonzero(floor.lasting) + 1,
                "holdout": discrepancy.holdout,
            },
            "unexplained": [
                {"joint": joint, "ratio_to_floor": ratio, "seen_on": discrepancy.unexplained_on[joint]}
                for joint, ratio in discrepancy.unexplained
            ],
            "candidates": [_candidate(score) for score in discrepancy.scores],
            "not_borne_out": refused,
            "not_testable": _named(testable_groups(discrepancy)),
            "all_along": _named(discrepancy.all_along),
            "log": discrepancy.identification.log.source,
            **taken(discrepancy, "seconds", "warnings"),
        }
    )


def comparison_summary(comparison: LogComparison) -> dict[str, Any]:
    """discrepancy.json of several logs: that of the last one, what became of each effect, and the time line."""
    said, dates = columns(comparison), comparison.dates
    texts = dates.texts if dates.known else [None] * len(comparison.logs)
    more = as_object(
        {
            "logs": [{"log": log.source, "date": text} for log, text in zip(comparison.logs, texts, strict=True)],
            "dates_from": dates.basis,
            "in_words": said,
            **{which: [_history(comparison, one) for one in comparison.of(which)] for which in said},
            "moved": [_moved(comparison, row) for row in moved_parameters(comparison)],
            "moved_rule": timeline_rule(comparison),
            **taken(comparison, "warnings", "seconds"),
        }
    )
    return discrepancy_summary(comparison.found[-1]) | more


def timeline_rows(comparison: LogComparison) -> list[dict[str, object]]:
    """timeline.csv: one row a log and parameter, in the parameter's own unit; empty where nothing is known."""
    line, known = comparison.timeline, comparison.dates.known
    rows = []
    for k, log in enumerate(comparison.logs):
        for c, one in enumerate(line.tracked):
            numbers = {
                name: float(values[k, c]) if np.isfinite(values[k, c]) else ""
                for name in ("value", "sd", "change", "change_sd", "of_payload", "z", "p")
                for values in [getattr(line, name)]
            }
            row: dict[str, object] = {"log": log.source, "date": comparison.dates.texts[k] if known else ""}
            row |= {"parameter": one.name, "value": numbers.pop("value"), "sd": numbers.pop("sd"), "unit": one.unit}
            rows.append(row | {"moved": bool(line.moved[k, c]), "expression": one.expression} | numbers)
    return rows


def _history(comparison: LogComparison, history: EffectHistory) -> dict[str, Any]:
    by_log = zip(comparison.logs, history.by_log, strict=False)
    return {
        "effect": history.name,
        "form": history.effect.name,
        "joints": history.joints,
        "by_log": [{"log": log.source} | as_json(what) for log, what in by_log],
        "found": [{"log": comparison.logs[k].source, **_added(effect)} for k, effect in sorted(history.found.items())],
    }


def _moved(comparison: LogComparison, row: Moved) -> dict[str, Any]:
    line = comparison.timeline
    return {
        "parameter": line.tracked[row.place].name,
        "expression": row.symbol,
        "in_words": row.text,
        "unit": line.tracked[row.place].unit,
        "values": line.value[:, row.place],
        "sds": line.sd[:, row.place],
        "z": line.z[:, row.place],
        "p": line.p[:, row.place],
        "since": comparison.logs[row.since - 1].source,
        "change_in_words": row.change,
    }


def _added(effect: AddedEffect) -> dict[str, Any]:
    alike, size, cost = [*effect.equivalent, *(name for name, _ in effect.elsewhere)], effect.size, effect.cost
    numbers = {
        of: {name: {"value": value, "sd": sd, "unit": unit} for name, (value, sd, unit) in getattr(effect, of).items()}
        for of in ("parameters", "readable")
    }
    return {
        "effect": effect.effect,
        "form": effect.hypothesis.source.name,
        "joints": effect.joints,
        "change_of_what_was_there": bool(effect.hypothesis.changes),
        "equivalent": effect.equivalent,
        "equivalent_elsewhere": _named(effect.elsewhere),
        "told_apart_by": {name: forms()[name].shown_by for name in sorted({effect.effect, *alike})} if alike else {},
        **taken(effect, "log10_bayes_factor", "probability"),
        "inclusion_probability": effect.included,
        "probability_nothing_missing": effect.nothing_missing,
        "probability_something_else": effect.something_else,
        **numbers,
        "effort": size and taken(size, "joint", "rms", "largest", percent=100.0 * size.share, of=size.of),
        "cost_if_ignored": cost
        and taken(
            *(cost, "joint", "before", "after"),
            percent_before=100.0 * cost.share_before,
            percent_after=100.0 * cost.share_after,
        ),
        "alternatives": [_candidate(rival) for rival in effect.rivals[:5]],
        **_learned(effect),
    }


def _learned(effect: AddedEffect) -> dict[str, Any]:
    if effect.description is None:
        return {}
    told = {"description": effect.description.sentence, "looks_like": effect.description.families}
    return taken(effect, "variables", "formula", **told)


def _named(effects: Iterable[tuple[str, tuple[int, ...]]]) -> list[dict[str, Any]]:
    return [{"effect": name, "joints": joints} for name, joints in effects]


def _candidate(score: Score) -> dict[str, Any]:
    return taken(score.hypothesis, "effect", "joints", log10_bayes_factor=score.gain / LN10)
