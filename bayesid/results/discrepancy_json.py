"""What discrepancy.json says."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from typing import Any

import numpy as np

from bayesid.discrepancy.workflow import Discrepancy
from bayesid.fit.effects.added_effect import AddedEffect, Quantity
from bayesid.fit.effects.explanation import LN10
from bayesid.fit.effects.scores import Score
from bayesid.model.catalogue import forms


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
        "log": discrepancy.identification.log.source,
        "seconds": discrepancy.seconds,
        "warnings": list(discrepancy.warnings),
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
        "alternatives": [_candidate(rival) for rival in effect.rivals[:5]],
        **_learned(effect),
    }


def _learned(effect: AddedEffect) -> dict[str, Any]:
    """Of an effect without a name."""
    if effect.description is None:
        return {}
    return {
        "variables": list(effect.variables),
        "formula": effect.formula,
        "description": effect.description.sentence,
        "looks_like": list(effect.description.families),
    }


def _quantities(named: Mapping[str, Quantity]) -> dict[str, Any]:
    return {name: {"value": value, "sd": sd, "unit": unit} for name, (value, sd, unit) in named.items()}


def _candidate(score: Score) -> dict[str, Any]:
    return {
        "effect": score.hypothesis.effect,
        "joints": list(score.hypothesis.joints),
        "log10_bayes_factor": score.gain / LN10,
    }
