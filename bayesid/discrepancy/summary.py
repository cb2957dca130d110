"""What discrepancy.json says."""

from __future__ import annotations

from itertools import groupby
from typing import Any

from bayesid.discrepancy.evidence import LN10
from bayesid.discrepancy.hypotheses import kind_of
from bayesid.discrepancy.scores import Score
from bayesid.discrepancy.workflow import Discrepancy, Found


def discrepancy_summary(discrepancy: Discrepancy) -> dict[str, Any]:
    """discrepancy.json of a result: SI units, joints from 1, gaps as RMS in N m."""
    return {
        "status": discrepancy.status,
        "where": [
            {"joint": one.joint, "excess": one.excess, "variable": one.variable, "range": list(one.range)}
            for one in discrepancy.where
        ],
        "found": [_found(one) for one in discrepancy.found],
        "gap": {
            "before": discrepancy.before.tolist(),
            "after": discrepancy.after.tolist(),
            "noise_floor": discrepancy.floor.rms.tolist(),
            "noise_floor_from": list(discrepancy.floor.origin),
            "holdout": discrepancy.holdout,
        },
        "unexplained": [{"joint": joint, "ratio_to_floor": ratio} for joint, ratio in discrepancy.unexplained],
        "candidates": [_candidate(one) for one in discrepancy.scores],
        "not_borne_out": [{"effect": effect, "joints": list(joints)} for effect, joints in discrepancy.vetoed],
        "not_testable": [
            {"effect": effect, "joints": sorted(j for _, joints in group for j in joints)}
            for effect, group in groupby(discrepancy.not_testable, key=lambda one: one[0])
        ],
        "log": discrepancy.identification.log.source,
        "seconds": discrepancy.seconds,
        "warnings": list(discrepancy.warnings),
    }


def _found(one: Found) -> dict[str, Any]:
    verdict = one.verdict
    return {
        "effect": one.effect,
        "form": verdict.hypothesis.source.name,
        "joints": list(one.joints),
        "change_of_what_was_there": bool(verdict.hypothesis.changes),
        "equivalent": list(verdict.equivalent),
        "told_apart_by": {name: kind_of(name).told_by for name in (one.effect, *verdict.equivalent)}
        if verdict.equivalent
        else {},
        "log10_bayes_factor": verdict.gain / LN10,
        "probability": verdict.probability,
        "probability_nothing_missing": verdict.nothing,
        "probability_something_else": verdict.something_else,
        "parameters": {
            name: {"value": value, "sd": sd, "unit": unit} for name, (value, sd, unit) in one.parameters.items()
        },
        "alternatives": [_candidate(rival) for rival in verdict.rivals[:5]],
    }


def _candidate(score: Score) -> dict[str, Any]:
    return {
        "effect": score.hypothesis.effect,
        "joints": list(score.hypothesis.joints),
        "log10_bayes_factor": score.gain / LN10,
    }
