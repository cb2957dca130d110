"""What each command does: reads, calls the Python interface, writes, prints."""

from __future__ import annotations

import argparse
import shlex
import sys
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import shtab

import bayesid
from bayesid.cli.messages import complain, warn
from bayesid.cli.progress import CountBar, StageBars
from bayesid.cli.tables import discrepancy_table, identification_table, separate_table, validation_table
from bayesid.demo import run_demo
from bayesid.errors import BayesidError, InputError
from bayesid.excitation.files import DESIGN_FILES, DESIGN_MARKER
from bayesid.excitation.words import design_text, judgement_text
from bayesid.log import find_logs
from bayesid.results import VALIDATION_FILES, check_folder, check_place
from bayesid.simulation import parse_effect, simulate_log
from bayesid.terms import RigidBody

SHELLS = tuple(shtab.SUPPORTED_SHELLS)


def identify(options: argparse.Namespace) -> None:
    """One identification of all logs together, or one of each."""
    logs, settings = find_logs(options.logs), _settings(options)
    if options.each:
        _identify_each(options, logs, settings)
        return
    if options.workers is not None or options.scheduler is not None:
        said = "one identification runs in one process"
        raise InputError(said, "--workers or --scheduler", "leave it out, or add --each for one result a log")
    folder = check_folder(options.out or Path(f"bayesid-{logs[0].stem}"))
    if any(folder.resolve() in (path.resolve(), path.resolve().parent) for path in logs):  # a bag is a folder
        raise InputError("holds the log, which the result would replace", str(folder), "give --out a new folder")
    reading = _reading(options)
    with StageBars(options.quiet) as bars:
        bars.show("read", 0, 1)
        log = bayesid.join_logs([_read(path, reading) for path in logs])
        result = bayesid.identify(options.robot, log, **settings, progress=bars.show)
        result = replace(result, provenance=replace(result.provenance, command=_command_line()))
        bars.show("write", 0, 1)
        bayesid.save_identification(result, folder, report=not options.no_report, progress=bars.show)
    for warning in result.warnings:
        warn(warning)
    if not options.quiet:
        print(identification_table(result))
        print(f"written to {folder}/")


def _settings(options: argparse.Namespace) -> dict[str, Any]:
    """Keyword arguments of `bayesid.identify`."""
    return {
        "terms": _terms(options), "search": options.search, "search_budget": options.search_budget,
        "beam_width": options.beam_width, "initial_segments": options.initial_segments, "cutoff": options.cutoff,
        "posterior": not options.no_posterior, "posterior_budget": options.posterior_budget, "seed": options.seed,
        "nominal": None if options.nominal is None else bayesid.read_nominal(options.nominal),
        "repeatable": options.repeatable,
    }  # fmt: skip


def _terms(options: argparse.Namespace) -> list[str]:
    terms = [name.strip() for name in options.terms.split(",")]
    if RigidBody.name not in terms:
        raise InputError(f"{RigidBody.name} is missing", "--terms", "add it: a robot has links")
    return terms


def _identify_each(options: argparse.Namespace, logs: Sequence[Path], settings: Mapping[str, Any]) -> None:
    folder = options.out or Path(f"bayesid-each-{logs[0].stem}")
    with CountBar(" logs", options.quiet) as bar:
        found = bayesid.identify_separately(
            options.robot, logs, folder, **_reading(options), report=not options.no_report,
            workers=options.workers, scheduler=options.scheduler, progress=bar.show, **settings,
        )  # fmt: skip
    for one in found.runs:
        for warning in one.warnings:
            warn(f"{one.log}: {warning}")
        if one.error:
            complain(f"{one.log}: {one.error.removeprefix(f'{one.log}: ')}")
    if not options.quiet:
        print(separate_table(found))
        print(f"written to {folder}/")
    failed = [one for one in found.runs if one.error]
    if failed:
        said = f"{len(failed)} of {len(found.runs)} logs have no result"
        if all(one.bad_input for one in failed):
            raise InputError(said, str(folder), "see above; the other results are complete")
        raise BayesidError(f"{folder}: {said}; see above; the other results are complete")


def validate(options: argparse.Namespace) -> None:
    """A result's model against another log."""
    if options.out is not None:
        check_folder(options.out, VALIDATION_FILES)
    with StageBars(options.quiet) as bars:
        result = _validation(options, options.log, bars)
    folder = None if options.out is None else bayesid.save_validation(result, options.out)
    if not options.quiet:
        print(validation_table(result))
        if folder is not None:
            print(f"written to {folder}/")


def report(options: argparse.Namespace) -> None:
    """The report of a result folder, anew or with a validation."""
    with StageBars(options.quiet) as bars:
        validation = None if options.validation is None else _validation(options, options.validation, bars)
        bars.show("report", 0, 1)
        path = bayesid.make_report(options.result, validation, options.out, bars.show)
    if not options.quiet:
        if validation is not None:
            print(validation_table(validation))
        print(f"written to {path}")


def _validation(options: argparse.Namespace, path: Path, bars: StageBars) -> bayesid.Validation:
    bars.show("read", 0, 1)
    stored = bayesid.load_model(options.result)
    log = _read(path, _reading(options))
    bars.show("validate", 0, 1)
    return bayesid.validate(stored.model, stored.theta, stored.noise, log, options.cutoff, stored.draws)


def discrepancy(options: argparse.Namespace) -> None:
    """What the model of a result lacks to explain another log."""
    folder = check_folder(options.out or Path(f"bayesid-discrepancy-{options.log.stem}"))
    for path in (options.result, options.log, *([] if options.holdout is None else [options.holdout])):
        if path.resolve() == folder.resolve() or path.resolve().parent == folder.resolve():
            said = f"holds {path.name}, which the result would replace"
            raise InputError(said, str(folder), "give --out a new folder")
    stored, reading = bayesid.load_model(options.result), _reading(options)
    logs = [options.log] if options.holdout is None else [options.log, options.holdout]
    with StageBars(options.quiet) as bars:
        bars.show("read", 0, 1)
        log, *holdout = [_read(path, reading) for path in logs]
        result = bayesid.find_discrepancy(
            stored, log, holdout[0] if holdout else None, cutoff=options.cutoff, search_budget=options.search_budget,
            posterior=not options.no_posterior, posterior_budget=options.posterior_budget, seed=options.seed,
            progress=bars.show, repeatable=options.repeatable,
        )  # fmt: skip
        bars.show("write", 0, 1)
        bayesid.save_discrepancy(result, folder, progress=bars.show)
    for warning in result.warnings:
        warn(warning)
    if not options.quiet:
        print(discrepancy_table(result))
        print(f"written to {folder}/")


def excite(options: argparse.Namespace) -> None:
    """A motion that shows coefficients and signs, or what a log's motion leaves undecided."""
    with StageBars(options.quiet) as bars:
        if options.log is not None:
            log = _read(options.log, _reading(options))
            bars.show("judge", 0, 1)
            told = judgement_text(bayesid.judge_log(
                options.robot, log, _terms(options), noise=options.noise, cutoff=options.cutoff, seed=options.seed
            ))  # fmt: skip
        else:
            told = _design(options, bars)
    if not options.quiet:
        print(told)


def _design(options: argparse.Namespace, bars: StageBars) -> str:
    folder = check_folder(options.out, DESIGN_FILES, DESIGN_MARKER)
    source = options.limits or (options.robot if Path(options.robot).suffix in (".urdf", ".xml") else None)
    design = bayesid.design_excitation(
        options.robot, _terms(options), duration=options.duration, rate=options.rate,
        limits=None if source is None else bayesid.read_limits(source), harmonics=options.harmonics,
        periods=options.periods, seed=options.seed, noise=options.noise,
        nominal=None if options.nominal is None else bayesid.read_nominal(options.nominal), progress=bars.show,
    )  # fmt: skip
    bayesid.save_design(design, folder)
    return f"{design_text(design)}\nwritten to {folder}/"


def simulate(options: argparse.Namespace) -> None:
    """A log of |effort|, and the same log with its signs."""
    if options.out.is_dir():
        raise InputError("is a folder", str(options.out), "give --out the name of a file")
    check_place(options.out)
    robot = bayesid.load_robot(options.robot)
    effects = [parse_effect(text, robot) for text in options.effect]
    unsigned, signed = simulate_log(robot, options.duration, options.rate, options.noise, effects, options.seed)
    truth = options.out.with_name(f"{options.out.stem}_signed.csv")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    bayesid.write_log(options.out, unsigned)
    bayesid.write_log(truth, signed)
    if not options.quiet:
        print(f"written to {options.out}, with the signs in {truth}")


def demo(options: argparse.Namespace) -> None:
    """The paper's experiment."""
    with StageBars(options.quiet) as bars:
        text = run_demo(options.out, options.seed, bars.show)
    if not options.quiet:
        print(text)


def study(options: argparse.Namespace) -> None:
    """Trials of a study, its report and its figure."""
    try:
        from studies import load, run_study
        from studies.results import check_results, save_results
    except ModuleNotFoundError as error:
        remedy = "run it where bayesid was cloned, or install it from there"
        raise InputError(f"the studies are not installed ({error})", f"study {options.name}", remedy) from None
    study, folder = load(options.name), options.out or Path(f"bayesid-study-{options.name}")
    check_results(folder)
    with CountBar(" trials", options.quiet) as bar:
        finished = run_study(
            study, options.trials, options.seed, workers=options.workers, scheduler=options.scheduler, out=folder,
            resume=options.resume, progress=bar.show,
        )  # fmt: skip
    text = save_results(finished, folder)
    for row in finished.failed:
        warn(f"trial {row['trial']} failed: {row['error']}")
    if not options.quiet:
        print(text)
        print(f"written to {folder}/")


def completion(options: argparse.Namespace) -> None:
    """A script for the user's shell."""
    print(shtab.complete(options.parser, shell=options.shell))


# ---------------------------------------------------------------------------------------------------------------
# Logs
# ---------------------------------------------------------------------------------------------------------------
def _reading(options: argparse.Namespace) -> dict[str, Any]:
    """Keyword arguments of `bayesid.read_log`."""
    joints = None if options.joints is None else [name.strip() for name in options.joints.split(",")]
    return {
        "gains": _gains(options.gains), "unsigned": options.unsigned, "degrees": options.degrees,
        "topic": options.topic, "joints": joints,
    }  # fmt: skip


def _read(path: Path, reading: Mapping[str, Any]) -> bayesid.Log:
    """A log; what reading it warns of is told in one line each."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", UserWarning)
        log = bayesid.read_log(path, **reading)
    for one in told:
        warn(str(one.message))
    return log


def _command_line() -> str:
    """What the user typed, for the record."""
    return shlex.join(["bayesid", *sys.argv[1:]])


def _gains(text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise InputError(f"{text!r} is not a list of numbers", "--gains", "give K1,K2,.. in N m/A") from None
