"""Running a study: a pure function of scenario and seed, mapped over a plan; its rows are written to disk.

A plan with more trials begins with the same trials, so `--resume` can extend a study. Rows contain no times: they are
identical for any number of workers. Times go into a separate table.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from bayesid.errors import InputError
from bayesid.files.writing import check_place, replace_file
from bayesid.parallel import SETTINGS_LOCK
from bayesid.studies.record import KEY, TIMINGS, MisfitError, Record, Row, read_rows
from bayesid.study.runner import LostSchedulerError, Outcome, run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Scenario = Any
"""A frozen dataclass whose fields are numbers, texts, or tuples of these: they become columns."""
Plan = Callable[[int, int], Sequence[tuple[Scenario, int]]]
"""From a number of trials and a first seed to that many scenarios and seeds."""
Tally = Callable[[int, int, int], None]
"""Called as tally(done, total, failed) after every batch."""
SEED, ERROR, DIED = "seed", "error", "worker_died"
"""Columns of every row."""
_LARGEST_SEED = 2**62
"""A column holds 64 bits."""


@dataclass(frozen=True)
class Study:
    """A question, and how simulation answers it.

    Attributes:
        name: as on the command line.
        trials: default number.
        plan: scenarios and seeds.
        trial: from a scenario and a seed to results by name, always the same names; times under "timings". A
            module-level function: it runs in other processes.
        report: from rows to tables and a conclusion.
        draw: draws rows into an empty figure.
        short: from rows to one line per figure that misses its target.
    """

    name: str
    trials: int
    plan: Plan
    trial: Callable[[Scenario, int], Row]
    report: Callable[[Sequence[Row]], str]
    draw: Callable[[Sequence[Row], Figure], None]
    short: Callable[[Sequence[Row]], list[str]] = lambda rows: []


@dataclass(frozen=True)
class Finished:
    """A completed study.

    Attributes:
        study: the study.
        rows: one per trial: trial, seed, the scenario's fields, error, worker_died, the results, and `timings`.
    """

    study: Study
    rows: list[Row]

    @property
    def failed(self) -> list[Row]:
        """Rows of trials that raised an error, without results."""
        return [row for row in self.rows if row[ERROR]]

    @property
    def good(self) -> list[Row]:
        """Rows with results."""
        return [row for row in self.rows if not row[ERROR]]

    @property
    def short(self) -> list[str]:
        """One line per figure that misses its target."""
        return self.study.short(self.good)

    @property
    def report(self) -> str:
        """Tables, conclusion and failed trials."""
        text = self.study.report(self.good) if self.good else "no trial has a result"
        failed = [f"trial {row[KEY]} failed: {row[ERROR]}" for row in self.failed]
        return "\n".join([text, *failed])


def in_turn(scenarios: Sequence[Scenario]) -> Plan:
    """All scenarios with one seed, then all with the next: compared scenarios share their seeds."""

    def plan(trials: int, seed: int) -> list[tuple[Scenario, int]]:
        rounds = math.ceil(trials / len(scenarios))
        return [(scenario, seed + k) for k in range(rounds) for scenario in scenarios][:trials]

    return plan


def mixed(parts: Sequence[Sequence[Any]]) -> list[Any]:
    """All items, each part in its order and evenly spread, so that a short run has items of every part."""
    placed = [(k / len(part), item) for part in parts for k, item in enumerate(part)]
    return [item for _, item in sorted(placed, key=lambda pair: pair[0])]


def run_study(
    study: Study,
    trials: int | None = None,
    seed: int = 0,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    progress: Tally = lambda done, total, failed: None,
) -> Finished:
    """Runs a study, or its missing trials.

    Args:
        study: the study; see `bayesid.studies.load`.
        trials: number; the study's default if None.
        seed: of the first trials.
        workers: processes on this machine; one per core by default, 0 for this process only.
        scheduler: address of a Dask scheduler, tcp://host:port, whose workers are used instead.
        out: folder for rows.parquet and timings.parquet, updated during the run; none by default.
        resume: keep the rows in `out`. Trials whose workers died run again; other errors are results.
        progress: called after every batch.

    Raises:
        InputError: an option cannot be used, or the folder holds rows of another run.
        LostSchedulerError: the scheduler ended before the study; the folder holds all finished rows.
        KeyboardInterrupt: likewise; the message gives the number of rows.
    """
    trials = study.trials if trials is None else trials
    if trials < 1:
        raise InputError(f"{trials} trials", field="trials", remedy="give 1 or more")
    if not 0 <= seed <= _LARGEST_SEED:
        remedy = f"give a whole number from 0 to {_LARGEST_SEED}"
        raise InputError(f"{seed} cannot be a seed", field="seed", remedy=remedy)
    plan = study.plan(trials, seed)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()) if out is None else out)
        record = Record(folder, {"study": study.name, "bayesid": version("bayesid")}, resume)
        _check_resumed(record, plan, folder)
        try:
            _run_rest(study, plan, record, workers, scheduler, progress)
        except (KeyboardInterrupt, LostSchedulerError) as stop:
            done = sum(k in record.rows for k in range(trials))
            kept = f"{done} of {trials} trials are in {folder}; continue with `resume`"
            kept = kept if out and done else "nothing was written"
            raise type(stop)("; ".join([*map(str, stop.args), kept])) from None
        finally:
            record.save(now=True)
        return Finished(study, read_rows(folder)[:trials])


class _Task(NamedTuple):
    trial: Callable[[Scenario, int], Row]
    scenario: Scenario
    seed: int


def _try(task: _Task) -> Row:
    return task.trial(task.scenario, task.seed)


def _run_rest(
    study: Study,
    plan: Sequence[tuple[Scenario, int]],
    record: Record,
    workers: int | None,
    scheduler: str | None,
    progress: Tally,
) -> None:
    missing = [k for k in range(len(plan)) if k not in record.rows]
    done = len(plan) - len(missing)
    failed = sum(bool(row[ERROR]) for k, row in record.rows.items() if k < len(plan))
    tasks = [_Task(study.trial, *plan[k]) for k in missing]
    with closing(run(_try, tasks, workers, scheduler)) as batches:
        for batch in batches:
            for outcome in batch:
                k = missing[outcome.index]
                _add(record, k, *plan[k], outcome)
                failed += bool(record.rows[k][ERROR])
            done += len(batch)
            record.save()
            progress(done, len(plan), failed)


def _add(record: Record, k: int, scenario: Scenario, seed: int, outcome: Outcome) -> None:
    """Adds one row: trial, error, results. Rows without results must not change the order of the columns."""
    head = {KEY: k, SEED: seed, **asdict(scenario), ERROR: outcome.error, DIED: outcome.died}
    value = dict(outcome.value or {})
    timings = {"seconds": outcome.seconds, "worker": outcome.worker, **value.pop(TIMINGS, {})}
    if twice := sorted(head.keys() & value.keys()):
        raise ValueError(f"results and fields of the scenario share the names {', '.join(twice)}")
    try:
        record.add({**head, **value}, timings)
    except MisfitError as error:
        record.add({**head, ERROR: f"the result cannot be stored: {error}"}, {"seconds": outcome.seconds})


def _check_resumed(record: Record, plan: Sequence[tuple[Scenario, int]], folder: Path) -> None:
    """Checks that the rows belong to this plan; forgets those whose workers died."""
    for k, (scenario, seed) in enumerate(plan):
        if k in record.rows:
            planned = {SEED: seed, **asdict(scenario)}
            changed = next((name for name, value in planned.items() if record.rows[k].get(name) != _kept(value)), None)
            if changed is not None:
                message = f"holds rows of another run ({changed} of trial {k} was {record.rows[k].get(changed)!r})"
                raise InputError(message, str(folder), "give the same `seed` (and `trials`), or `folder` a new folder")
    record.forget([k for k, row in record.rows.items() if row[DIED]])


def _kept(value: Any) -> Any:
    """A value as it is read back from a table."""
    return [_kept(item) for item in value] if isinstance(value, tuple) else value


# ---------------------------------------------------------------------------------------------------------------
# Folder of a completed study: report.txt and figure.svg beside its rows
# ---------------------------------------------------------------------------------------------------------------
_FILES = {"rows.parquet", "timings.parquet", "report.txt", "figure.svg"}


def check_results(folder: Path) -> None:
    """Checks that a folder is writable and holds nothing but results of a study.

    Raises:
        InputError: it holds other files, or cannot be written.
    """
    remedy = "give `folder` a new folder"
    if folder.exists() and not folder.is_dir():
        raise InputError("is not a folder", str(folder), remedy)
    foreign = {path.name for path in folder.iterdir()} - _FILES if folder.is_dir() else set()
    visible = sorted(name for name in foreign if not name.startswith("."))
    if visible:
        raise InputError(f"holds other files ({visible[0]})", str(folder), remedy)
    check_place(folder)


def save_results(finished: Finished, folder: Path) -> str:
    """Writes report and figure, and returns the report."""
    text = finished.report
    replace_file(folder / "report.txt", lambda aside: aside.write_text(f"{text}\n", encoding="utf-8"))
    if finished.good:
        _save_figure(finished, folder / "figure.svg")
    return text


def _save_figure(finished: Finished, path: Path) -> None:
    """Writes the figure, without a date."""
    from matplotlib import rc_context  # takes a second to import
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 3.6), layout="constrained")
    finished.study.draw(finished.good, figure)
    with SETTINGS_LOCK, rc_context({"svg.hashsalt": "bayesid"}):
        replace_file(path, lambda aside: figure.savefig(aside, format="svg", metadata={"Date": None}))
