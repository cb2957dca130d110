"""Several logs of one robot, identified separately, and the agreement of the results.

Logs that are identified together (`bayesid.read_log`) give one model with smaller standard deviations. Separate results
test whether the standard deviations are right.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from bayesid.errors import InputError
from bayesid.files.writing import check_place, save_table
from bayesid.identification.identification import Identification
from bayesid.identification.pipeline import identify
from bayesid.log.formats import is_stream
from bayesid.log.reading import read_log
from bayesid.progress import SILENT, Progress, Show
from bayesid.report.folders import check_result_folder, collect_incomplete, save_identification
from bayesid.report.grading import worst
from bayesid.report.report_data import report_data
from bayesid.report.result_files import coefficient_rows
from bayesid.report.verdicts import check_findings
from bayesid.robot import Robot, load_robot
from bayesid.study.agreement import Agreement, agreement
from bayesid.study.agreement import rows as agreement_rows
from bayesid.study.runner import Outcome, run

RUNS, AGREEMENT = "runs.csv", "agreement.csv"
"""Files beside the results' folders."""
_REMEDY = "give `folder` a new folder"


@dataclass(frozen=True)
class Run:
    """Outcome of one log."""

    log: Path  #: its file
    folder: Path  #: its result folder
    error: str = ""  #: why there is no result; empty if there is one
    bad_input: bool = False  #: whether the error is of the log or an option
    figures: Mapping[str, Any] = field(default_factory=dict)  #: for runs.csv
    coefficients: Sequence[Mapping[str, Any]] = ()  #: rows of its coefficients.csv
    warnings: Sequence[str] = ()  #: of the identification


@dataclass(frozen=True)
class BatchResult:
    """Results of several logs and their agreement."""

    runs: tuple[Run, ...]  #: in the order of the logs
    agreement: Agreement | None  #: None with fewer than two results

    def __repr__(self) -> str:
        outcomes = [run.error or f"{len(run.coefficients)} coefficients in {run.folder}" for run in self.runs]
        count = "nothing to compare" if self.agreement is None else f"{len(self.agreement.names)} coefficients compared"
        lines = [f"{run.log}: {outcome}" for run, outcome in zip(self.runs, outcomes, strict=True)]
        return "\n  ".join([f"BatchResult: {len(self.runs)} logs, {count}", *lines])


def identify_each(  # noqa: PLR0913  of one identification, and of the batch
    robot: Robot | str | Path,
    logs: Sequence[str | Path],
    out: str | Path,
    *,
    reading: Mapping[str, Any] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    report: bool = True,
    run_by: Mapping[str, Any] = MappingProxyType({}),
    progress: Progress | Show = SILENT,
    **options: Any,
) -> BatchResult:
    """Identifies a robot from each log separately; each result is saved in a folder with the name of its log.

    Args:
        robot: a robot, a built-in name or a file.
        logs: files, or folders of ROS bags.
        out: folder for the result folders, runs.csv and agreement.csv.
        reading: options of `bayesid.read_log`, such as `gains`.
        workers: processes on this machine; by default one per core, 0 for this process.
        scheduler: address of a Dask scheduler, whose workers are used instead; they must have access to the same files.
        report: whether each folder gets its report.html.
        run_by: `command` and `config` of the provenance of each result, if a command runs this.
        progress: called as progress("logs", done, total) at the start and after every batch.
        options: of `bayesid.identify`.

    Raises:
        InputError: the robot, a folder or the scheduler cannot be used. A log that cannot be used is a `Run` with an
            error.
        LostSchedulerError: the connection to the scheduler was lost.
        KeyboardInterrupt: its text counts the results that were saved.

    Example:
        >>> days = ["week/monday.csv", "week/tuesday.csv"]
        >>> both = bayesid.identify_each("robot.toml", days, "both", workers=1, report=False, posterior=False)
        >>> len(both.runs), both.agreement is None
        (2, False)
    """
    robot = robot if isinstance(robot, Robot) else load_robot(robot)
    place, paths = Path(out), [Path(log) for log in logs]
    folders = [place / name for name in _names(paths)]
    _check(place, folders, paths)
    jobs = [(log.absolute(), folder.absolute()) for log, folder in zip(paths, folders, strict=True)]
    work = partial(_identify, robot=robot, reading=reading or {}, options=options, report=report, run_by=dict(run_by))
    done: dict[int, Run] = {}
    show = Progress.of(progress).show
    show("logs", 0, len(jobs))
    try:
        with closing(run(work, jobs, workers, scheduler)) as batches:
            for batch in batches:
                found = {result.index: _run(paths[result.index], folders[result.index], result) for result in batch}
                done.update(found)
                show("logs", len(done), len(jobs))
    except KeyboardInterrupt:
        saved = sum(not result.error for result in done.values())
        text = f"{saved} of {len(jobs)} results were saved in {place}" if saved else "nothing was written"
        raise KeyboardInterrupt(text) from None
    runs = tuple(done[k] for k in range(len(jobs)))
    good = [result.coefficients for result in runs if not result.error]
    batch_result = BatchResult(runs, agreement(good) if len(good) > 1 else None)
    if good or not all(result.bad_input for result in runs):  # refused input leaves no files
        _save(batch_result, place)
    return batch_result


def _identify(
    place: tuple[Path, Path],
    robot: Robot,
    reading: Mapping[str, Any],
    options: Mapping[str, Any],
    report: bool,
    run_by: Mapping[str, Any],
) -> Run:
    log, folder = place
    try:
        result = identify(robot, read_log(log, **reading, robot=robot), **options)
        result = replace(result, provenance=replace(result.provenance, **run_by))
        with collect_incomplete() as incomplete:
            save_identification(result, folder, report=report)
    except InputError as error:
        return Run(log, folder, str(error), bad_input=True)
    warnings = [*result.warnings, *incomplete]
    return Run(log, folder, figures=_figures(result), coefficients=coefficient_rows(result), warnings=warnings)


def _figures(result: Identification) -> dict[str, Any]:
    return {
        "n_samples": len(result.log),
        "n_segments": len(result.segments),
        "certified": bool(result.search.certified),
        "converged": "" if result.posterior is None else bool(result.posterior.converged),
        "condition_number": float(result.fit.condition),
        "worst_relative_residual": float(result.fit.relative_residual.max()),
        "seconds": float(sum(result.timings.values())),
        "verdict": worst(check_findings(report_data(result))),
    }


def _run(log: Path, folder: Path, outcome: Outcome) -> Run:
    if outcome.error:
        return Run(log, folder, outcome.error)
    result: Run = outcome.value
    return replace(result, log=log, folder=folder, error=result.error.replace(str(log.absolute()), str(log)))


def _names(logs: Sequence[Path]) -> list[str]:
    """Folder name of each log: its stem, after the name of its folder if stems repeat."""
    stems = Counter(log.stem for log in logs)
    names = [log.stem if stems[log.stem] == 1 else f"{log.absolute().parent.name}-{log.stem}" for log in logs]
    for name, count in Counter(names).items():
        if count > 1:
            raise InputError("several logs have this name", name, "rename one of them")
    return names


def _check(place: Path, folders: Sequence[Path], logs: Sequence[Path]) -> None:
    """Raises InputError if logs are streams, or files other than an earlier batch would be overwritten."""
    for log in logs:
        if is_stream(log):
            problem = "is a stream, which can be read only once"
            raise InputError(problem, str(log), "save it as a file, or identify without `each`")
    if place.exists() and not place.is_dir():
        raise InputError("is not a folder", str(place), _REMEDY)
    files = {path.name for path in place.iterdir() if not path.is_dir()} if place.is_dir() else set()
    if foreign := files - {RUNS, AGREEMENT}:
        raise InputError(f"holds other files ({min(foreign)})", str(place), _REMEDY)
    check_place(place)
    for folder in folders:
        if any(log.resolve().parent == folder.resolve() for log in logs):
            raise InputError("holds a log, which the result would overwrite", str(folder), _REMEDY)
        check_result_folder(folder)


def _save(separate: BatchResult, place: Path) -> None:
    place.mkdir(parents=True, exist_ok=True)
    empty = dict.fromkeys((name for run in separate.runs for name in run.figures), "")
    rows = [
        {"log": str(run.log), "folder": run.folder.name, "error": run.error, **empty, **run.figures}
        for run in separate.runs
    ]
    save_table(place / RUNS, rows)
    if separate.agreement is not None:
        save_table(place / AGREEMENT, agreement_rows(separate.agreement))
    else:
        (place / AGREEMENT).unlink(missing_ok=True)
