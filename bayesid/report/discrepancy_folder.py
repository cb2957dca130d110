"""The folder of a discrepancy: discrepancy.json and the result folder of the extended model."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.discrepancy.comparison import EffectHistory, LogComparison
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.effects.catalogue import forms
from bayesid.files.tables import write_json, write_table
from bayesid.progress import SILENT, Progress
from bayesid.regression.selection.added_effect import AddedEffect, Cost, EffortSize, Quantity
from bayesid.regression.selection.explanation import LN10
from bayesid.regression.selection.scores import Score
from bayesid.report.folders import save_result
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

    def write_page(path: Path) -> None:
        from bayesid.report.pages.discrepancy_page import discrepancy_page  # jinja2, for pages alone

        path.write_text(discrepancy_page(discrepancy), encoding="utf-8")

    def write_more(place: Path) -> None:
        write_json(place / "discrepancy.json", discrepancy_summary(discrepancy))

    pages = {"discrepancy.html": write_page}
    return save_result(discrepancy.identification, folder, write_more, pages, report, None, progress)


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

    def write_page(path: Path) -> None:
        from bayesid.report.pages.discrepancy_page import comparison_page  # jinja2, for pages alone

        path.write_text(comparison_page(comparison), encoding="utf-8")

    def write_more(place: Path) -> None:
        write_json(place / "discrepancy.json", comparison_summary(comparison))
        write_table(place / "timeline.csv", timeline_rows(comparison))

    pages = {"discrepancy.html": write_page}
    return save_result(comparison.found[-1].identification, folder, write_more, pages, report, None, progress)


def discrepancy_summary(discrepancy: Discrepancy) -> dict[str, Any]:
    """discrepancy.json of a result: SI units, joints from 1, gaps as RMS in N m."""
    return {
        "status": discrepancy.status,
        "where": [
            {"joint": at.joint, "excess": at.excess, "variable": at.variable, "range": list(at.range)}
            for at in discrepancy.where
        ],
        "found": [_added(effect) for effect in discrepancy.added],
        "sets": [
            {
                "effects": [{"effect": name, "joints": list(joints)} for name, joints in one.effects],
                "probability": one.probability,
            }
            for one in discrepancy.sets
        ],
        "gap": {
            "before": discrepancy.before.tolist(),
            "after": discrepancy.after.tolist(),
            "noise_floor": discrepancy.floor.rms.tolist(),
            "noise_floor_from": list(discrepancy.floor.origin),
            "noise_floor_white": discrepancy.floor.white.tolist(),
            "noise_floor_lasting": (np.flatnonzero(discrepancy.floor.lasting) + 1).tolist(),
            "holdout": discrepancy.holdout,
        },
        "unexplained": [
            {"joint": joint, "ratio_to_floor": ratio, "seen_on": list(discrepancy.unexplained_on[joint])}
            for joint, ratio in discrepancy.unexplained
        ],
        "candidates": [_candidate(score) for score in discrepancy.scores],
        "not_borne_out": [
            {
                "effect": effect.effect,
                "joints": list(effect.joints),
                "log10_bayes_factor": effect.log10_bayes_factor,
                "equivalent": list(effect.equivalent),
                **_learned(effect),
            }
            for effect in discrepancy.refused
        ],
        "not_testable": [
            {"effect": effect, "joints": sorted(j for _, joints in group for j in joints)}
            for effect, group in groupby(discrepancy.not_testable, key=lambda pair: pair[0])
        ],
        "all_along": [{"effect": effect, "joints": list(joints)} for effect, joints in discrepancy.all_along],
        "log": discrepancy.identification.log.source,
        "seconds": discrepancy.seconds,
        "warnings": list(discrepancy.warnings),
    }


def comparison_summary(comparison: LogComparison) -> dict[str, Any]:
    """discrepancy.json of several logs: that of the last one, what became of each effect, and the time line."""
    said = columns(comparison)
    logs = zip(comparison.logs, comparison.dates.texts, strict=True)
    return {
        **discrepancy_summary(comparison.found[-1]),
        "logs": [{"log": log.source, "date": text if comparison.dates.known else None} for log, text in logs],
        "dates_from": comparison.dates.basis,
        "in_words": said,
        **{which: [_history(comparison, one) for one in comparison.of(which)] for which in said},
        "moved": [_moved(comparison, row) for row in moved_parameters(comparison)],
        "moved_rule": timeline_rule(comparison),
        "warnings": list(comparison.warnings),
        "seconds": comparison.seconds,
    }


def timeline_rows(comparison: LogComparison) -> list[dict[str, object]]:
    """timeline.csv: one row a log and parameter, in the parameter's own unit; empty where nothing is known."""
    line, known = comparison.timeline, comparison.dates.known
    moved, z = line.moved, line.z
    return [
        {
            "log": log.source,
            "date": comparison.dates.texts[k] if known else "",
            "parameter": one.name,
            "value": _if_known(line.value[k, c]),
            "sd": _if_known(line.sd[k, c]),
            "unit": one.unit,
            "moved": bool(moved[k, c]),
            "expression": one.expression,
            "change": _if_known(line.change[k, c]),
            "change_sd": _if_known(line.change_sd[k, c]),
            "of_payload": _if_known(line.of_payload[k, c]),
            "z": _if_known(z[k, c]),
            "p": _if_known(line.p[k, c]),
        }
        for k, log in enumerate(comparison.logs)
        for c, one in enumerate(line.tracked)
    ]


def _if_known(value: float) -> object:
    return float(value) if np.isfinite(value) else ""


def _history(comparison: LogComparison, history: EffectHistory) -> dict[str, Any]:
    by_log = zip(comparison.logs, history.by_log, strict=False)
    return {
        "effect": history.name,
        "form": history.effect.name,
        "joints": list(history.joints),
        "by_log": [
            {
                "log": log.source,
                "says": what.says,
                "log10_bayes_factor": what.log10_bayes_factor,
                "log10_ratio": what.log10_ratio,
            }
            for log, what in by_log
        ],
        "found": [{"log": comparison.logs[k].source, **_added(effect)} for k, effect in sorted(history.found.items())],
    }


def _moved(comparison: LogComparison, row: Moved) -> dict[str, Any]:
    line = comparison.timeline
    return {
        "parameter": line.tracked[row.place].name,
        "expression": row.symbol,
        "in_words": row.text,
        "unit": line.tracked[row.place].unit,
        "values": line.value[:, row.place].tolist(),
        "sds": line.sd[:, row.place].tolist(),
        "z": line.z[:, row.place].tolist(),
        "p": line.p[:, row.place].tolist(),
        "since": comparison.logs[row.since - 1].source,
        "change_in_words": row.change,
    }


def _added(effect: AddedEffect) -> dict[str, Any]:
    alike = [*effect.equivalent, *(name for name, _ in effect.elsewhere)]
    return {
        "effect": effect.effect,
        "form": effect.hypothesis.source.name,
        "joints": list(effect.joints),
        "change_of_what_was_there": bool(effect.hypothesis.changes),
        "equivalent": list(effect.equivalent),
        "equivalent_elsewhere": [{"effect": name, "joints": list(joints)} for name, joints in effect.elsewhere],
        "told_apart_by": {name: forms()[name].shown_by for name in sorted({effect.effect, *alike})} if alike else {},
        "log10_bayes_factor": effect.log10_bayes_factor,
        "probability": effect.probability,
        "inclusion_probability": effect.included,
        "probability_nothing_missing": effect.nothing_missing,
        "probability_something_else": effect.something_else,
        "parameters": _quantities(effect.parameters),
        "readable": _quantities(effect.readable),
        "effort": _effort(effect.size),
        "cost_if_ignored": _cost(effect.cost),
        "alternatives": [_candidate(rival) for rival in effect.rivals[:5]],
        **_learned(effect),
    }


def _learned(effect: AddedEffect) -> dict[str, Any]:
    if effect.description is None:
        return {}
    return {
        "variables": list(effect.variables),
        "formula": effect.formula,
        "description": effect.description.sentence,
        "looks_like": list(effect.description.families),
    }


def _effort(size: EffortSize | None) -> dict[str, Any] | None:
    if size is None:
        return None
    percent = 100.0 * size.share
    return {"joint": size.joint, "rms": size.rms, "largest": size.largest, "percent": percent, "of": size.of}


def _cost(cost: Cost | None) -> dict[str, Any] | None:
    if cost is None:
        return None
    return {
        "joint": cost.joint,
        "before": cost.before,
        "after": cost.after,
        "percent_before": 100.0 * cost.share_before,
        "percent_after": 100.0 * cost.share_after,
    }


def _quantities(named: Mapping[str, Quantity]) -> dict[str, Any]:
    return {name: {"value": value, "sd": sd, "unit": unit} for name, (value, sd, unit) in named.items()}


def _candidate(score: Score) -> dict[str, Any]:
    return {
        "effect": score.hypothesis.effect,
        "joints": list(score.hypothesis.joints),
        "log10_bayes_factor": score.gain / LN10,
    }
