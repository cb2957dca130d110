"""What each command does: reads, calls the Python interface, writes, prints."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import bayesid
from bayesid.cli.progress import CountBar, StageBars
from bayesid.cli.tables import discrepancy_table, identification_table, separate_table
from bayesid.demo import run_demo
from bayesid.errors import BayesidError, InputError
from bayesid.log import find_logs
from bayesid.results import VALIDATION_FILES, check_folder, check_place
from bayesid.simulation import parse_effect, simulate_log
from bayesid.terms import RigidBody


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
    if any(path.resolve().parent == folder.resolve() for path in logs):
        raise InputError("holds the log, which the result would replace", str(folder), "give --out a new folder")
    gains = _gains(options.gains)
    log = bayesid.join_logs([bayesid.read_log(path, gains, options.unsigned) for path in logs])
    with StageBars(options.quiet) as bars:
        result = bayesid.identify(options.robot, log, **settings, progress=bars.show)
    bayesid.save_identification(result, folder)
    for warning in result.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    if not options.quiet:
        print(identification_table(result))
        print(f"written to {folder}/")


def _settings(options: argparse.Namespace) -> dict[str, Any]:
    """Keyword arguments of `bayesid.identify`."""
    terms = [name.strip() for name in options.terms.split(",")]
    if RigidBody.name not in terms:
        raise InputError(f"{RigidBody.name} is missing", "--terms", "add it: a robot has links")
    return {
        "terms": terms, "search": options.search, "search_budget": options.search_budget,
        "beam_width": options.beam_width, "initial_segments": options.initial_segments, "cutoff": options.cutoff,
        "posterior": not options.no_posterior, "posterior_budget": options.posterior_budget, "seed": options.seed,
        "nominal": None if options.nominal is None else bayesid.read_nominal(options.nominal),
        "repeatable": options.repeatable,
    }  # fmt: skip


def _identify_each(options: argparse.Namespace, logs: Sequence[Path], settings: Mapping[str, Any]) -> None:
    folder = options.out or Path(f"bayesid-each-{logs[0].stem}")
    with CountBar(" logs", options.quiet) as bar:
        found = bayesid.identify_separately(
            options.robot, logs, folder, gains=_gains(options.gains), unsigned=options.unsigned,
            workers=options.workers, scheduler=options.scheduler, progress=bar.show, **settings,
        )  # fmt: skip
    for one in found.runs:
        for warning in one.warnings:
            print(f"warning: {one.log}: {warning}", file=sys.stderr)
        if one.error:
            print(f"bayesid: {one.log}: {one.error.removeprefix(f'{one.log}: ')}", file=sys.stderr)
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
    stored = bayesid.load_model(options.result)
    log = bayesid.read_log(options.log, _gains(options.gains), options.unsigned)
    result = bayesid.validate(stored.model, stored.theta, stored.noise, log, options.cutoff, stored.draws)
    print("joint   RMS error, N m   relative residual   in the 95 % band")
    figures = zip(result.rms_error, result.relative_residual, result.coverage, strict=True)
    for j, (error, relative, inside) in enumerate(figures, start=1):
        print(f"{j:>5}   {error:>14.4g}   {relative:>17.1%}   {inside:>16.1%}")
    print(f"the band holds {result.band}")
    if options.out is not None:
        print(f"written to {bayesid.save_validation(result, options.out)}/")


def discrepancy(options: argparse.Namespace) -> None:
    """What the model of a result lacks to explain another log."""
    folder = check_folder(options.out or Path(f"bayesid-discrepancy-{options.log.stem}"))
    for path in (options.result, options.log, *([] if options.holdout is None else [options.holdout])):
        if path.resolve() == folder.resolve() or path.resolve().parent == folder.resolve():
            said = f"holds {path.name}, which the result would replace"
            raise InputError(said, str(folder), "give --out a new folder")
    stored, gains = bayesid.load_model(options.result), _gains(options.gains)
    logs = [options.log] if options.holdout is None else [options.log, options.holdout]
    log, *holdout = [bayesid.read_log(path, gains, options.unsigned) for path in logs]
    with StageBars(options.quiet) as bars:
        result = bayesid.find_discrepancy(
            stored, log, holdout[0] if holdout else None, cutoff=options.cutoff, search_budget=options.search_budget,
            posterior=not options.no_posterior, posterior_budget=options.posterior_budget, seed=options.seed,
            progress=bars.show, repeatable=options.repeatable,
        )  # fmt: skip
    bayesid.save_discrepancy(result, folder)
    for warning in result.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    if not options.quiet:
        print(discrepancy_table(result))
        print(f"written to {folder}/")


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
    print(f"written to {options.out}, with the signs in {truth}")


def demo(options: argparse.Namespace) -> None:
    """The paper's experiment."""
    with StageBars(quiet=False) as bars:
        text = run_demo(options.out, options.seed, bars.show)
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
        print(f"warning: trial {row['trial']} failed: {row['error']}", file=sys.stderr)
    if not options.quiet:
        print(text)
        print(f"written to {folder}/")


def _gains(text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise InputError(f"{text!r} is not a list of numbers", "--gains", "give K1,K2,.. in N m/A") from None
