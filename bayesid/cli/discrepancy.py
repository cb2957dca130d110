"""`bayesid discrepancy`: what a result's model lacks to explain another log, or what changed between logs."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from bayesid.cli.bars import stages
from bayesid.cli.options import (
    check_new,
    command_line,
    config_of,
    finish,
    read,
    read_for,
    reading_options,
    robot_of,
    sampling,
    term_names,
)
from bayesid.cli.shared import TERMS
from bayesid.cli.terminal import line_of
from bayesid.discrepancy.comparison import ChangeReport, compare_logs
from bayesid.discrepancy.workflow import Discrepancy, explain_log
from bayesid.errors import InputError
from bayesid.files.config import CONFIG, read_config
from bayesid.identification.model_file import load
from bayesid.identification.options import Preprocessing
from bayesid.identification.pipeline import QUICK
from bayesid.log.formats import is_log_folder
from bayesid.log.sources import find_logs
from bayesid.report.brief import in_brief
from bayesid.report.comparison import comparison_conclusion
from bayesid.report.comparison import in_brief as changes_in_brief
from bayesid.report.discrepancy import discrepancy_conclusion
from bayesid.report.folders import (
    IDENTIFICATION_FILES,
    collect_incomplete,
    save_comparison,
    save_discrepancy,
    save_or_rescue,
)
from bayesid.report.result_files import MARKER
from bayesid.signs.search.certified import Certified


def discrepancy_command(options: argparse.Namespace) -> None:
    """Writes a folder with the extended model."""
    if _is_log(options):
        _compare_logs(options)
    else:
        _compare_with_result(options)


def _is_log(options: argparse.Namespace) -> bool:
    first = options.result
    if first.is_dir() and not is_log_folder(first):
        return False
    return bool(first.is_file() or first.is_dir() or options.robot is not None)


def _compare_with_result(options: argparse.Namespace) -> None:
    if len(options.logs) != 1:
        given = "no log" if not options.logs else f"{len(options.logs)} logs with a result"
        remedy = "give a result and one log (a second one by --holdout), or logs alone with --robot"
        raise InputError(given, str(options.result), remedy)
    for name in ("robot", "tip", "hold", "gravity", "terms", "constraints", "config"):
        if getattr(options, name) is not None:
            raise InputError("a result has its own robot, terms and constraints", f"--{name}", "leave it out")
    (path,) = options.logs
    folder = _folder(options, [options.result, path])
    identified = load(options.result)
    logs = [path] if options.holdout is None else [path, options.holdout]
    with stages(options) as progress:
        with progress.stage("read"):
            log, *holdout = [read_for(options, identified, path) for path in logs]
        result = explain_log(
            identified,
            log,
            holdout[0] if holdout else None,
            search=_search(options, QUICK.budget),
            posterior=sampling(options),
            preprocessing=Preprocessing(cutoff=options.cutoff),
            progress=progress,
        )
        result = _with_command(options, result)
        incomplete = _save(lambda place: save_discrepancy(result, place, progress=progress), folder)
    _end(options, result, folder, incomplete)


def _compare_logs(options: argparse.Namespace) -> None:
    paths = find_logs([options.result, *options.logs])
    for path in paths:
        if path.is_dir() and not is_log_folder(path):
            raise InputError("is a folder", str(path), "give a result and one log, or logs alone")
    if options.robot is None:
        remedy = "give --robot to compare logs, or a result folder as the first argument"
        raise InputError("is a log, not a result", str(paths[0]), remedy)
    if len(paths) < 2:
        remedy = "add a later log of the robot"
        raise InputError("is a single log; a comparison needs two or more", str(paths[0]), remedy)
    folder, reading = _folder(options, paths), reading_options(options)
    terms = term_names(argparse.Namespace(terms=TERMS if options.terms is None else options.terms))
    robot = robot_of(options, of_log=True)
    with stages(options) as progress:
        with progress.stage("read"):
            logs = [read(options, path, reading, robot) for path in paths]
            holdout = None if options.holdout is None else read(options, options.holdout, reading, robot)
        result = compare_logs(
            robot,
            logs,
            terms,
            holdout,
            constraints=options.constraints,
            search=_search(options, Certified().budget),
            posterior=sampling(options),
            preprocessing=Preprocessing(cutoff=options.cutoff),
            progress=progress,
        )
        result = replace(result, found=(*result.found[:-1], _with_command(options, result.found[-1])))
        incomplete = _save(lambda place: save_comparison(result, place, progress=progress), folder)
    _end(options, result, folder, incomplete)


def _folder(options: argparse.Namespace, given: Sequence[Path]) -> Path:
    """The result folder; it must not hold an input."""
    folder = options.out or Path(f"bayesid-discrepancy-{given[-1].stem}")
    for path in (*given, *([] if options.holdout is None else [options.holdout])):
        if path.resolve() == folder.resolve() or path.resolve().parent == folder.resolve():
            raise InputError(
                f"holds {path.name}, which the result would replace", str(folder), "give --out a new folder"
            )
    return check_new(options, folder, IDENTIFICATION_FILES, MARKER)


def _search(options: argparse.Namespace, usual: float) -> Certified:
    budget = usual if options.search_budget is None else options.search_budget
    return Certified(budget=budget, time_limit=options.time_limit)


def _with_command(options: argparse.Namespace, result: Discrepancy) -> Discrepancy:
    again, kept = result.identification, options.result / CONFIG
    config = read_config(kept) if kept.is_file() else config_of(options)
    run_by = replace(again.provenance, command=command_line(), config=config)
    return replace(result, identification=replace(again, provenance=run_by))


def _save(save: Callable[[Path], object], folder: Path) -> list[str]:
    with collect_incomplete() as incomplete:
        save_or_rescue(save, folder)
    return incomplete


def _end(options: argparse.Namespace, result: Discrepancy | ChangeReport, folder: Path, incomplete: list[str]) -> None:
    if isinstance(result, Discrepancy):
        lines, conclusion = in_brief(result), discrepancy_conclusion(result).in_brief()
    else:
        lines, conclusion = changes_in_brief(result), comparison_conclusion(result)
    last = f"open {folder}/discrepancy.html"
    finish(
        options, *map(line_of, lines), conclusion=conclusion, last=last, warnings=result.warnings, incomplete=incomplete
    )
