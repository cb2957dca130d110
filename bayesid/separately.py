"""Several logs of one robot, each identified by itself on the runner, and whether the results agree.

Pooled (`bayesid.join_logs`) they would give one model with smaller standard deviations; separately they show whether
these standard deviations are true.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bayesid.agreement import Agreement, agreement
from bayesid.agreement import rows as agreement_rows
from bayesid.errors import InputError
from bayesid.identification import Identification, identify
from bayesid.log import read_log
from bayesid.results import check_folder, check_place, save_identification, save_table
from bayesid.robot import Robot, load_robot
from bayesid.runner import Outcome, run
from bayesid.tables import coefficient_rows

RUNS, AGREEMENT = "runs.csv", "agreement.csv"
_REMEDY = "give --out a new folder"
Progress = Callable[[int, int, int], None]
"""Called as progress(done, total, failed)."""


@dataclass(frozen=True)
class Run:
    """What became of one log.

    Attributes:
        log: its file.
        folder: its result folder.
        error: why there is none; empty if there is.
        bad_input: whether that is a fault of the log or an option.
        figures: for runs.csv.
        coefficients: rows of its coefficients.csv.
        warnings: what the user should know.
    """

    log: Path
    folder: Path
    error: str = ""
    bad_input: bool = False
    figures: Mapping[str, Any] = field(default_factory=dict)
    coefficients: Sequence[Mapping[str, Any]] = ()
    warnings: Sequence[str] = ()


@dataclass(frozen=True)
class Separate:
    """Runs, in the order of the logs, and how well they agree; None with fewer than two results."""

    runs: tuple[Run, ...]
    agreement: Agreement | None


@dataclass(frozen=True)
class _Job:
    """One log, for a worker."""

    robot: Robot
    log: Path
    folder: Path
    reading: Mapping[str, Any]
    options: Mapping[str, Any]
    report: bool


def identify_separately(
    robot: Robot | str | Path, logs: Sequence[str | Path], out: str | Path, *, gains: Sequence[float] | None = None,
    unsigned: str | None = None, degrees: bool | None = None, topic: str | None = None,
    joints: Sequence[str] | None = None, workers: int | None = None, scheduler: str | None = None,
    report: bool = True, progress: Progress | None = None, **options: Any,
) -> Separate:  # fmt: skip
    """Identifies a robot from each log by itself; results stand in a folder for each, named like its log.

    Args:
        robot: a robot, a built-in name or a file.
        logs: files, or folders of ROS bags.
        out: folder for the results' folders, runs.csv and agreement.csv.
        gains: see `bayesid.log.read_log`.
        unsigned: see there.
        degrees: see there.
        topic: see there.
        joints: see there.
        workers: processes on this machine; one a core by default, 0 for none but this one.
        scheduler: address of a Dask scheduler, whose workers are used instead; they must see the same files.
        report: whether each folder gets its report.html.
        progress: called after every batch.
        options: of `bayesid.identify`.

    Raises:
        InputError: the robot, a folder or the scheduler cannot be used. A log that cannot is a `Run` with its error.
        LostSchedulerError: the scheduler ended before the work.
    """
    robot = robot if isinstance(robot, Robot) else load_robot(robot)
    place, paths = Path(out), [Path(log) for log in logs]
    folders = [place / name for name in _names(paths)]
    _check(place, folders, paths)
    reading = {"gains": gains, "unsigned": unsigned, "degrees": degrees, "topic": topic, "joints": joints}
    jobs = [
        _Job(robot, log.absolute(), folder.absolute(), reading, options, report)
        for log, folder in zip(paths, folders, strict=True)
    ]
    done: dict[int, Run] = {}
    with closing(run(_identify, jobs, workers, scheduler)) as batches:
        for batch in batches:
            done.update({one.index: _run(paths[one.index], folders[one.index], one) for one in batch})
            if progress is not None:
                progress(len(done), len(jobs), sum(bool(one.error) for one in done.values()))
    runs = tuple(done[k] for k in range(len(jobs)))
    good = [one.coefficients for one in runs if not one.error]
    found = Separate(runs, agreement(good) if len(good) > 1 else None)
    _save(found, place)
    return found


def _identify(job: _Job) -> Run:
    """In the worker: reads, identifies, saves."""
    try:
        result = identify(job.robot, read_log(job.log, **job.reading), **job.options)
        save_identification(result, job.folder, report=job.report)
    except InputError as error:
        return Run(job.log, job.folder, str(error), bad_input=True)
    return Run(
        job.log, job.folder, figures=_figures(result), coefficients=coefficient_rows(result), warnings=result.warnings
    )


def _figures(result: Identification) -> dict[str, Any]:
    return {
        "n_samples": len(result.log),
        "n_segments": len(result.segments),
        "certified": bool(result.search.certified),
        "converged": "" if result.posterior is None else bool(result.posterior.converged),
        "condition_number": float(result.fit.condition),
        "worst_relative_residual": float(result.fit.relative_residual.max()),
        "seconds": float(sum(result.timings.values())),
    }


def _run(log: Path, folder: Path, outcome: Outcome) -> Run:
    if outcome.error:
        return Run(log, folder, outcome.error)
    there: Run = outcome.value
    error = there.error.replace(str(log.absolute()), str(log))
    return Run(log, folder, error, there.bad_input, there.figures, there.coefficients, there.warnings)


def _names(logs: Sequence[Path]) -> list[str]:
    """A folder's name for each log: its stem, with its own folder's name where stems repeat."""
    stems = Counter(log.stem for log in logs)
    names = [log.stem if stems[log.stem] == 1 else f"{log.absolute().parent.name}-{log.stem}" for log in logs]
    for name, count in Counter(names).items():
        if count > 1:
            raise InputError("several logs have this name", name, "rename one of them")
    return names


def _check(place: Path, folders: Sequence[Path], logs: Sequence[Path]) -> None:
    """The place holds nothing else, and no folder there is more than an earlier result."""
    if place.exists() and not place.is_dir():
        raise InputError("is not a folder", str(place), _REMEDY)
    others = [path.name for path in place.iterdir() if not path.is_dir()] if place.is_dir() else []
    strange = sorted(set(others) - {RUNS, AGREEMENT})
    if strange:
        raise InputError(f"holds other files ({strange[0]})", str(place), _REMEDY)
    check_place(place)
    for folder in folders:
        if any(log.resolve().parent == folder.resolve() for log in logs):
            raise InputError("holds a log, which the result would replace", str(folder), _REMEDY)
        check_folder(folder)


def _save(found: Separate, place: Path) -> None:
    place.mkdir(parents=True, exist_ok=True)
    names = [name for one in found.runs for name in one.figures]
    empty = dict.fromkeys(names, "")
    rows = [
        {"log": str(one.log), "folder": one.folder.name, "error": one.error, **empty, **one.figures}
        for one in found.runs
    ]
    save_table(place / RUNS, rows)
    if found.agreement is not None:
        save_table(place / AGREEMENT, agreement_rows(found.agreement))
    else:
        (place / AGREEMENT).unlink(missing_ok=True)
