"""What ends a command: a few lines and a table. What is said of a result is worded in `bayesid.report.verdicts`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from bayesid.cli.terminal import table
from bayesid.identification.checks import Check
from bayesid.identification.identification import KNOWN, SURE, Identification
from bayesid.identification.payload import PayloadReading
from bayesid.identification.prediction import PredictedEfforts, Validation
from bayesid.report.payload import HEADINGS, payload_checks, payload_rows
from bayesid.report.summary import Summary, summarise
from bayesid.report.verdicts import (
    EFFECT_HEADINGS,
    GAIN_HEADINGS,
    beyond_the_terms,
    effect_rows,
    gain_rows,
    gains,
    intervals,
    proof,
    sampling,
)
from bayesid.report.words import quantity
from bayesid.study.agreement import text as agreement_text
from bayesid.study.separate_logs import Separate

_COLOURS = {"good": "green", "look": "yellow", "bad": "bold red", "not done": "yellow"}


def identification_parts(result: Identification) -> list[RenderableType]:
    """What ends `bayesid identify`."""
    fit, search, summary = result.fit, result.search, summarise(result)
    segments, _, confidence = result.recorded_segments
    recorded = result.log.clock(result.signals.motion.t)[0] >= 0  # the pause between joined logs is not
    sure = np.maximum(result.probability, 1.0 - result.probability)[recorded] >= SURE
    effort = np.abs(result.signals.raw_effort)[recorded]
    share = (effort * sure).sum(axis=0) / np.maximum(effort.sum(axis=0), np.finfo(float).tiny)
    rows = []
    for j in range(result.model.robot.n_joints):
        of_joint = confidence[segments.joint == j]
        figures = f"{of_joint.min():.2f}", f"{share[j]:.1%}", f"{fit.relative_residual[j]:.1%}"
        rows.append([str(j + 1), str(len(of_joint)), *figures])
    settled = f", {result.settled_share:.1%} of samples settled" if search.certified else ""
    return [
        f"{summary.robot}: {summary.n_samples} rows, {summary.n_segments} segments ({summary.n_segments_searched} "
        f"searched), {summary.n_coefficients} coefficients ({result.n_known} known to {100 * KNOWN:g} %), condition "
        f"number {fit.condition:.0f}",
        *_payloads(summary),
        _verdict(
            f"search: {search.method}, {search.solves} cone problems, {result.timings['search']:.1f} s; ",
            proof(summary),
            settled,
        ),
        *(f"beyond the terms asked for: {check.message}" for check in beyond_the_terms(summary)),
        *([table(list(EFFECT_HEADINGS), [list(row) for row in effects])] if (effects := effect_rows(summary)) else []),
        *(_verdict("gains: ", check) for check in gains(summary)),
        *([table(list(GAIN_HEADINGS), [list(row) for row in told])] if (told := gain_rows(summary)) else []),
        _verdict("posterior: ", sampling(summary), _sampling_effort(result)),
        *([_verdict("intervals: ", check)] if (check := intervals(summary)).state == "look" else []),
        table(["joint", "segments", "least sure", f"|effort| sure to {100 * SURE:g} %", "relative residual"], rows),
    ]


def _payloads(summary: Summary) -> list[str]:
    """What each log carried, and what was found of it; nothing where none carried anything."""
    payloads = summary.payloads or {}
    carried = [f"{part.source}: {part.n_samples} rows, {part.payload or 'no payload'}" for part in summary.logs]
    found = [
        f"{label}: {_with_sd(one['mass'], 'kg')}, centre of mass at ({', '.join(map(_with_sd, one['com']))}) m in the "
        "last link's frame"
        for label, one in payloads.items()
    ]
    return [*carried, *found] if payloads else []


def _with_sd(one: Mapping[str, Any], unit: str = "") -> str:
    return quantity(one["value"], one["sd"] or 0.0, unit)


def _verdict(head: str, check: Check, tail: str = "") -> Text:
    return Text.assemble(head, (check.message, _COLOURS[check.state]), tail)


def line_of(check: Check) -> Text:
    """A check in its colour, with its remedy."""
    remedy = f"; {check.remedy}" if check.remedy else ""
    return Text.assemble((f"  {check.name}: ", _COLOURS[check.state]), check.message, remedy)


def _sampling_effort(result: Identification) -> str:
    posterior = result.posterior
    if posterior is None:
        return ""
    modes = "" if len(posterior.modes) == 1 else f", {len(posterior.modes)} modes"
    return f"{modes}; {posterior.seconds:.1f} s"


def separate_parts(separate: Separate) -> list[RenderableType]:
    """What ends `bayesid identify --each`."""
    rows = [
        [
            str(run.log),
            str(run.figures["n_samples"]),
            str(run.figures["n_segments"]),
            *(_yes_or_no(run.figures[key]) for key in ("certified", "converged")),
            f"{run.figures['worst_relative_residual']:.1%}",
        ]
        for run in separate.runs
        if run.figures
    ]
    headings = ["log", "samples", "segments", "proven", "converged", "worst relative residual"]
    few = "fewer than two results: nothing to compare"
    agreement = few if separate.agreement is None else agreement_text(separate.agreement)
    return [table(headings, rows, left=["log"]), "", agreement]


def _yes_or_no(value: object) -> str:
    return "-" if value == "" else "yes" if value else "NO"


def validation_parts(result: Validation) -> list[RenderableType]:
    """What ends `bayesid validate`."""
    figures = zip(result.rms_error, result.relative_residual, result.coverage, strict=True)
    rows = [
        [str(j), f"{error:.4g}", f"{relative:.1%}", f"{inside:.1%}"]
        for j, (error, relative, inside) in enumerate(figures, start=1)
    ]
    headings = ["joint", "RMS error, N m", "relative residual", "in the 95 % band"]
    seen = "no validation: the model was identified from this log"
    return [
        *([Text(seen, _COLOURS["bad"])] if result.seen else []),
        table(headings, rows),
        f"the band holds {result.band}",
    ]


def payload_parts(result: PayloadReading, folder: Path) -> list[RenderableType]:
    """What ends `bayesid payload`; the folder is that of the earlier log's result."""
    rows = [list(row) for row in payload_rows(result)]
    return [
        *map(line_of, payload_checks(result, str(folder))),
        "",
        table(list(HEADINGS), rows, left=["payload", "unit"]),
        f"centre of mass and inertia are in the frame of {result.frame}, inertia about the centre of mass; mass and "
        "inertia are in the scale of the efforts",
    ]


def prediction_parts(result: PredictedEfforts) -> list[RenderableType]:
    """What ends `bayesid predict`."""
    largest, half = np.abs(result.mean).max(axis=0), np.median(result.upper - result.mean, axis=0)
    figures = zip(result.units, largest, half, strict=True)
    rows = [[str(j), f"{most:.4g}", f"{width:.3g}", unit] for j, (unit, most, width) in enumerate(figures, start=1)]
    headings = ["joint", "largest effort", "95 % band: +-, in the middle", "unit"]
    return [table(headings, rows), f"the band holds {result.holds}"]
