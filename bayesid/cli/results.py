"""Commands on a result: `bayesid validate`, `bayesid predict`, `bayesid report` and `bayesid payload`."""

from __future__ import annotations

import argparse
from pathlib import Path

from bayesid.cli.options import check_file, motion_options, read, read_positions, reading_options
from bayesid.cli.tables import payload_parts, prediction_parts, validation_parts
from bayesid.cli.terminal import StageBars, show, warn
from bayesid.errors import InputError
from bayesid.files.writing import check_folder
from bayesid.identification.model_file import load_model
from bayesid.identification.options import Preparation
from bayesid.identification.payload import PayloadReading, identify_payload
from bayesid.identification.pipeline import QUICK
from bayesid.identification.prediction import Validation
from bayesid.posterior.sampler import Sampling
from bayesid.progress import Progress
from bayesid.report.folders import VALIDATION_FILES, check_result_folder, make_report, save_validation
from bayesid.report.payload import PAYLOAD, PAYLOAD_FILES, save_payload
from bayesid.signs.search.certified import Certified


def validate_command(options: argparse.Namespace) -> None:
    """The model against another log: a table, and a folder where one is asked for."""
    folder = None if options.out is None else check_result_folder(options.out, VALIDATION_FILES)
    with StageBars(options.quiet) as bars:
        result = _validation(options, options.log, bars)
    if folder is not None:
        save_validation(result, folder)
    if not options.quiet:
        show(*validation_parts(result), *([] if folder is None else [f"written to {folder}/"]))


def _validation(options: argparse.Namespace, path: Path, bars: StageBars) -> Validation:
    bars.show("read", 0, 1)
    identified = load_model(options.result)
    log = read(path, reading_options(options, identified))
    bars.show("validate", 0, 1)
    return identified.validate(log, options.cutoff)


def predict_command(options: argparse.Namespace) -> None:
    """A file with the efforts of a motion, and how uncertain they are."""
    _check_out(options.out, options.motion)
    with StageBars(options.quiet) as bars:
        bars.show("read", 0, 1)
        identified = load_model(options.result)
        motion = read_positions(options.motion, motion_options(options))
        bars.show("predict", 0, 1)
        predicted = identified.predict(motion, noise=not options.without_noise, cutoff=options.cutoff)
    predicted.save(options.out)
    if not options.quiet:
        show(*prediction_parts(predicted), f"written to {options.out}")


def _check_out(out: Path, motion: Path) -> None:
    check_file(out)
    if out.resolve() == motion.resolve():
        raise InputError("is the motion itself", str(out), "give --out another place")


def report_command(options: argparse.Namespace) -> None:
    """The report of a result folder, anew or with a validation."""
    with StageBars(options.quiet) as bars:
        validation = None if options.validation is None else _validation(options, options.validation, bars)
        bars.show("report", 0, 1)
        path = make_report(options.result, validation, options.out, Progress(bars.show))
    if not options.quiet:
        show(*([] if validation is None else validation_parts(validation)), f"written to {path}")


def payload_command(options: argparse.Namespace) -> None:
    """What the robot carries, from a log with it: a table, and a folder where one is asked for."""
    folder = None if options.out is None else check_folder(options.out, PAYLOAD_FILES, PAYLOAD)
    with StageBars(options.quiet) as bars:
        result = _payload(options, bars)
    if folder is not None:
        save_payload(result, folder)
    for warning in result.warnings:
        warn(warning)
    if not options.quiet:
        parts = payload_parts(result, options.result)
        show(*parts, *([] if folder is None else [f"written to {folder}/"]))


def _payload(options: argparse.Namespace, bars: StageBars) -> PayloadReading:
    bars.show("read", 0, 1)
    known_mass = None if options.known_mass is None else _mass(options.known_mass)
    budget = QUICK.budget if options.search_budget is None else options.search_budget
    search = Certified(budget=budget, time_limit=options.time_limit)
    posterior = Sampling(budget=options.posterior_budget, time_limit=options.time_limit, seed=options.seed)
    identified = load_model(options.result)
    return identify_payload(
        identified,
        read(options.log, reading_options(options, identified)),
        known_mass=known_mass,
        search=search,
        posterior=posterior,
        preparation=Preparation(cutoff=options.cutoff),
        progress=Progress(bars.show),
    )


def _mass(text: str) -> tuple[float, float]:
    """KG or KG~SD."""
    mass, _, sd = text.partition("~")
    try:
        return float(mass), float(sd) if sd else 0.0
    except ValueError:
        raise InputError(f"{text!r} is no mass", "--known-mass", "give kg, as in 2.805 or 2.805~0.005") from None
