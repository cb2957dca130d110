"""Commands on a result: `bayesid validate`, `bayesid predict`, `bayesid report` and `bayesid payload`."""

from __future__ import annotations

import argparse
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import RenderableType

from bayesid.cli.bars import stages
from bayesid.cli.options import check_file, check_new, finish, read_for, read_motion_for
from bayesid.cli.terminal import line_of, table
from bayesid.errors import InputError
from bayesid.identification.checks import Check, State
from bayesid.identification.model_file import load
from bayesid.identification.options import Preprocessing
from bayesid.identification.payload import identify_payload
from bayesid.identification.pipeline import QUICK
from bayesid.identification.prediction import Validation
from bayesid.number_text import percent
from bayesid.posterior.sampler import Sampling
from bayesid.regression.tuning import TUNING as REGRESSION
from bayesid.report.conclusion import VALIDATED, Conclusion, conclude, sentence
from bayesid.report.folders import REPORT, VALIDATION_FILES, make_report, save_validation
from bayesid.report.model_checks import validation
from bayesid.report.payload import (
    HEADINGS,
    PAYLOAD,
    PAYLOAD_FILES,
    payload_checks,
    payload_note,
    payload_rows,
    save_payload,
)
from bayesid.report.report_data import FILE, read_report_data
from bayesid.report.result_files import MARKER
from bayesid.report.verdicts import check_findings
from bayesid.report.words import joints_in_words
from bayesid.signs.search.certified import Certified

PREDICTION = "prediction.csv"
"""The file of `bayesid predict --out FOLDER`."""


def validate_command(options: argparse.Namespace) -> None:
    """Validates the model on another log: a table, the result's report, and a folder if `--out` is given."""
    folder = None if options.out is None else check_new(options, options.out, VALIDATION_FILES, MARKER)
    with stages(options) as progress:
        with progress.stage("read"):
            identified = load(options.result)
            log = read_for(options, identified, options.log)
        with progress.stage("validate"):
            result = identified.validate(log, options.cutoff)
        if folder is not None:
            with progress.stage("write"):
                save_validation(result, folder)
        last, incomplete = [_written(folder)] * (folder is not None), []
        if (options.result / FILE).exists() and not result.seen:
            try:
                earlier = read_report_data(options.result).prediction
                shown = f"open {make_report(options.result, result, progress=progress)}"
                if earlier is not None and earlier.source != result.log.source:
                    shown += f", where this log replaces {earlier.source}"
                last.append(shown)
            except InputError as error:
                incomplete.append(str(error))
        elif not result.seen:
            last.append(f"{options.result} holds no {FILE}: no report was made")
    conclusion = _validated(result, options.result)
    finish(options, *_validation_parts(result), conclusion=conclusion, last="; ".join(last), incomplete=incomplete)


def _written(folder: Path | None) -> str:
    return "" if folder is None else f"written to {folder}/"


def _validated(result: Validation, folder: Path) -> Conclusion | None:
    """The verdict on another log; None for a result without findings."""
    if result.seen:
        return _unvalidated(result)
    if not (folder / FILE).exists():
        return None
    findings = replace(read_report_data(folder), folder=str(folder)).with_validation(result)
    return conclude([validation(findings)], VALIDATED)


def _unvalidated(result: Validation) -> Conclusion:
    """The verdict on the log that the model was identified from."""
    seen, most = "No validation: the model was identified from this log", np.nanmax([0.0, *result.relative_residual])
    if most > REGRESSION.poor_fit:
        seen += f", and the relative residual is up to {percent(most, 0)} even there"
    state: State = "bad" if most > REGRESSION.poor_fit else "look"
    remedy = "give a log that the model has not seen"
    return Conclusion(state, sentence(state, seen), (Check("Validation", state, "", remedy),))


def _validation_parts(result: Validation) -> list[RenderableType]:
    figures, why = zip(result.rms_error, result.relative_residual, result.coverage, strict=True), result.not_compared
    rows = [
        [str(j), *([why[j], "-", "-"] if j in why else [f"{error:.4g}", percent(relative, 1), percent(inside, 1)])]
        for j, (error, relative, inside) in enumerate(figures, start=1)
    ]
    headings = ["joint", "RMS error, N m", "relative residual", "in the 95 % band"]
    return [table(headings, rows), f"95 % band: {result.band}"]


def predict_command(options: argparse.Namespace) -> None:
    """Writes the efforts of a motion with their bands, into a file, or into `prediction.csv` of an existing folder."""
    if (options.out / MARKER).exists():
        raise InputError("holds a result", str(options.out), "give --out a file or another folder")
    options.out = options.out / PREDICTION if options.out.is_dir() else options.out
    if options.out.resolve() == options.motion.resolve():
        raise InputError("is the motion itself", str(options.out), "give --out another place")
    check_file(options, options.out)
    with stages(options) as progress:
        with progress.stage("read"):
            identified = load(options.result)
            motion = read_motion_for(options, identified, options.motion)
            correct = options.correct or identified.motion_reading.get("correct")
        with progress.stage("predict"):
            result = identified.predict(motion, noise=not options.without_noise, cutoff=options.cutoff)
        with progress.stage("write"):
            result.save(options.out)
    largest, half = np.abs(result.mean).max(axis=0), np.median(result.upper - result.mean, axis=0)
    figures = zip(result.units, largest, half, strict=True)
    rows = [[str(j), f"{most:.4g}", f"{width:.3g}", unit] for j, (unit, most, width) in enumerate(figures, start=1)]
    headings = ["joint", "largest effort", "95 % band: +- (median)", "unit"]
    wide = (np.flatnonzero(half > largest) + 1).tolist()
    undetermined = "the band is wider than the effort: the log did not determine the coefficients"
    wide_bands = [f"{joints_in_words(wide)}: {undetermined}"] if wide else []
    again = shlex.join(["bayesid", "validate", str(options.result), "RECORDED.csv"])
    last = f"written to {options.out}; next, with a recording of the motion: {again}"
    corrected = [f"positions read with --correct {correct}; efforts in order and directions of the robot file"]
    finish(
        options,
        table(headings, rows),
        f"95 % band: {result.holds}",
        *(corrected if correct else []),
        *wide_bands,
        last=last,
    )


def report_command(options: argparse.Namespace) -> None:
    """Makes the report of a result folder."""
    if options.out is not None and options.out.resolve() != (options.result / REPORT).resolve():
        check_file(options, options.out)
    with stages(options) as progress:
        path = make_report(options.result, out=options.out, progress=progress)
    conclusion = conclude(check_findings(replace(read_report_data(options.result), folder=str(options.result))))
    finish(options, conclusion=conclusion, last=f"open {path}")


def payload_command(options: argparse.Namespace) -> None:
    """Identifies a payload: a table, and a folder if `--out` is given."""
    folder = None if options.out is None else check_new(options, options.out, PAYLOAD_FILES, PAYLOAD)
    known_mass = None if options.known_mass is None else _mass(options.known_mass)
    budget = QUICK.budget if options.search_budget is None else options.search_budget
    search = Certified(budget=budget, time_limit=options.time_limit)
    posterior = Sampling(budget=options.posterior_budget, time_limit=options.time_limit, rng=options.seed)
    with stages(options) as progress:
        with progress.stage("read"):
            identified = load(options.result)
            log = read_for(options, identified, options.log)
        result = identify_payload(
            identified,
            log,
            known_mass=known_mass,
            common_sd=None if options.common_sd is None else _share(options.common_sd),
            search=search,
            posterior=posterior,
            preprocessing=Preprocessing(cutoff=options.cutoff),
            progress=progress,
        )
        if folder is not None:
            with progress.stage("write"):
                save_payload(result, folder)
    checks = payload_checks(result, str(options.result))
    parts: list[RenderableType] = [
        *map(line_of, checks),
        "",
        table(HEADINGS, payload_rows(result), left=["payload", "unit"]),
        payload_note(result),
    ]
    conclusion = conclude(checks).in_brief()
    finish(options, *parts, conclusion=conclusion, last=_written(folder), warnings=result.warnings)


def _share(text: str) -> float:
    try:
        return float(text.removesuffix("%")) * (0.01 if text.endswith("%") else 1.0)
    except ValueError:
        raise InputError(f"{text!r} is not a share", "--common-sd", "give a share, as in 2% or 0.02") from None


def _mass(text: str) -> tuple[float, float]:
    mass, _, sd = text.partition("~")
    try:
        return float(mass), float(sd) if sd else 0.0
    except ValueError:
        raise InputError(f"{text!r} is not a mass", "--known-mass", "give kg, as in 2.805 or 2.805~0.005") from None
