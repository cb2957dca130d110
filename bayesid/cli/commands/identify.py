"""`bayesid identify`: one identification of all logs together, or one of each."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from bayesid.cli.options import beliefs, command_line, end_with, read, reading_options, robot_of, sampling, term_names
from bayesid.cli.progress import CountBar, StageBars
from bayesid.cli.recordings import Recording, is_list, known_masses, recordings
from bayesid.cli.tables import identification_parts, separate_parts
from bayesid.cli.terminal import complain, show, warn
from bayesid.errors import BayesidError, InputError
from bayesid.identification.options import Preparation
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log, join_logs
from bayesid.progress import Progress
from bayesid.results.folders import check_result_folder, collect_incomplete, save_identification, save_or_rescue
from bayesid.results.several_logs import identify_separately
from bayesid.signs.search.beam import Beam
from bayesid.signs.search.certified import Certified
from bayesid.signs.search.protocol import Search


def run(options: argparse.Namespace) -> None:
    """One result folder, or one a log with `--each`."""
    logs = recordings(options)
    settings = _settings(options, logs)
    if options.each:
        _identify_each(options, logs, settings)
        return
    if options.workers is not None or options.scheduler is not None:
        said = "one identification runs in one process"
        raise InputError(said, "--workers or --scheduler", "leave it out, or add --each for one result a log")
    folder = check_result_folder(options.out or Path(f"bayesid-{_stem(options, logs)}"))
    if any(folder.resolve() in (one.path.resolve(), one.path.resolve().parent) for one in logs):  # a bag is a folder
        raise InputError("holds the log, which the result would replace", str(folder), "give --out a new folder")
    robot, reading, replaced = robot_of(options), reading_options(options), folder.is_dir() and any(folder.iterdir())
    with StageBars(options.quiet) as bars:
        bars.show("read", 0, 1)
        log = join_logs([_read(one, reading) for one in logs])
        result = identify(robot, log, **settings, progress=Progress(bars.show))
        result = replace(result, provenance=replace(result.provenance, command=command_line()))
        bars.show("write", 0, 1)
        with collect_incomplete() as incomplete:
            shown, progress = not options.no_report, Progress(bars.show)
            save_or_rescue(lambda place: save_identification(result, place, report=shown, progress=progress), folder)
    for warning in result.warnings:
        warn(warning)
    if not options.quiet:
        show(*identification_parts(result), f"written to {folder}/{', in place of an earlier result' * replaced}")
    end_with(incomplete)


def _stem(options: argparse.Namespace, logs: Sequence[Recording]) -> str:
    """What a folder is named after: the file that lists the logs, or the first log."""
    return str((options.logs[0] if is_list(options.logs[0]) else logs[0].path).stem)


def _read(one: Recording, reading: Mapping[str, Any]) -> Log:
    log = read(one.path, reading)
    return log.carrying(one.payload) if one.payload else log


def _settings(options: argparse.Namespace, logs: Sequence[Recording]) -> dict[str, Any]:
    """Keyword arguments of `bayesid.identify`."""
    return {
        "terms": term_names(options),
        "complete": options.complete,
        "search": _search(options),
        "posterior": sampling(options),
        "preparation": Preparation(cutoff=options.cutoff, max_memory=options.max_memory),
        "beliefs": beliefs(options, known_masses(logs)),
    }


def _search(options: argparse.Namespace) -> Search:
    beam = Beam(width=options.beam_width, initial_segments=options.initial_segments)
    if options.search == "beam":
        return beam.limited(options.search_budget, options.time_limit)
    return Certified(budget=options.search_budget, time_limit=options.time_limit, fallback=beam)


def _identify_each(options: argparse.Namespace, logs: Sequence[Recording], settings: Mapping[str, Any]) -> None:
    for one in logs:
        if one.payload:
            said = f"{one.path} carries a payload, which only a log without it tells from the last link"
            raise InputError(said, "--each", "leave --each out, or name the log without its payload")
    folder, robot = options.out or Path(f"bayesid-each-{_stem(options, logs)}"), robot_of(options)
    with CountBar("logs", options.quiet) as bar:
        settings = {**settings, "reading": reading_options(options), "report": not options.no_report}
        settings |= {"workers": options.workers, "scheduler": options.scheduler, "progress": bar.show}
        separate = identify_separately(robot, [one.path for one in logs], folder, **settings)
    failed = [result for result in separate.runs if result.error]
    for result in separate.runs:
        for warning in result.warnings:
            warn(f"{result.log}: {warning}")
        if result.error:
            complain(f"{result.log}: {result.error.removeprefix(f'{result.log}: ')}")
    if not options.quiet:
        show(*separate_parts(separate), f"written to {folder}/")
    if failed:
        said = f"{len(failed)} of {len(separate.runs)} logs have no result"
        if all(result.bad_input for result in failed):
            raise InputError(said, str(folder), "see above; the other results are complete")
        raise BayesidError(f"{folder}: {said}; see above; the other results are complete")
