"""`bayesid floor`: the smallest error of any model of a robot, from two recordings of the same motion."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from bayesid.cli.bars import stages
from bayesid.cli.options import check_file, finish, given_reading, given_robot, read, reading_options, robot_of
from bayesid.cli.terminal import table
from bayesid.discrepancy.repeatability import Repeatability, repeatability
from bayesid.discrepancy.tuning import TUNING
from bayesid.files.writing import replace_file, write_json
from bayesid.identification.checks import Check, State
from bayesid.identification.tuning import TUNING as IDENTIFICATION
from bayesid.log.sources import find_logs
from bayesid.number_text import percent
from bayesid.regression.tuning import TUNING as REGRESSION
from bayesid.report.conclusion import conclude
from bayesid.report.grading import graded
from bayesid.report.summary import as_object

_VERDICTS: Mapping[State, str] = {
    "good": "The efforts repeat",
    "look": "The efforts repeat only roughly",
    "bad": "The efforts do not repeat",
}


def floor_command(options: argparse.Namespace) -> None:
    """Prints a table, and writes it to `--out`."""
    if options.out is not None:
        check_file(options, options.out)
    robot, reading = robot_of(options, of_log=True), reading_options(options)
    with stages(options) as progress:
        with progress.stage("read"):
            log, other = (read(options, path, reading, robot) for path in find_logs([options.log, options.again]))
        with progress.stage("compare"):
            result = repeatability(robot, log, other)
        if options.out is not None:
            _write(options.out, result)
    rows = [
        [str(j), *("-" if np.isnan(x) else f"{x:.4g}" for x in (difference, floor)), *map(_percent, shares)]
        for j, (difference, floor, *shares) in enumerate(
            zip(result.difference, result.floor, result.relative, result.position, strict=True), start=1
        )
    ]
    headings = ["joint", "RMS difference, N m", "floor, N m", "floor / effort", "positions differ by"]
    hidden = [str(j) for j, signed in enumerate(result.signed, start=1) if not signed]
    compared = f"{result.seconds:.4g} s of both logs, clock offset {result.shift:.3f} s"
    note = [f"signs are hidden in joints {', '.join(hidden)}: |effort| is compared"] if hidden else []
    checks = _checks(result)
    steps = [f"written to {options.out}"] if options.out else []
    steps += _next(options, repeat=checks[0].state == "good", uncertain=log.gains is not None)
    finish(
        options,
        table(headings, rows),
        compared,
        *note,
        "floor: smallest RMS error of any model; compare with `bayesid validate`",
        conclusion=conclude(checks, _VERDICTS),
        last="; ".join(steps),
    )


def _next(options: argparse.Namespace, *, repeat: bool, uncertain: bool) -> list[str]:
    """Identifies both recordings together, or finds what changed between them, which needs exact gains."""
    if not repeat and uncertain:
        return []
    command = "identify" if repeat else "discrepancy"
    logs = [str(options.log), str(options.again)]
    return [f"next: {shlex.join(['bayesid', command, *logs, *given_robot(options), *given_reading(options)])}"]


def _percent(share: float) -> str:
    return "-" if np.isnan(share) else percent(share, 2)


def _checks(result: Repeatability) -> list[Check]:
    worst, apart = float(np.nanmax([0.0, *result.relative])), float(result.position.max())
    limits = IDENTIFICATION.suspicious, REGRESSION.poor_fit
    floor = f"the floor is {percent(worst, 1)} of a joint's effort (good: up to {percent(limits[0], 0)})"
    remedy = "check what changed between the recordings: payload, temperature, gains"
    moved = f"positions differ by {percent(apart, 1)} of a joint's range (good: up to {percent(TUNING.repeated, 1)})"
    same = Check(
        "Motion",
        "good" if apart <= TUNING.repeated else "look",
        moved,
        "the true floor is lower: part of the difference comes from the motion",
    )
    return [graded("Repeatability", worst, limits, floor, remedy), same]


def _write(path: Path, result: Repeatability) -> None:
    replace_file(path, lambda aside: write_json(aside, as_object(vars(result))))
