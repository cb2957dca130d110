"""What a study is, and how it is run: a pure function of scenario and seed, mapped over a plan, its rows on disk.

The plan is the same for every number of trials, but for its length: `--resume` with more trials goes on with it. Rows
hold nothing of the clock, so they are the same to the last digit however many workers there are, in whatever order they
finish; what a trial says of the clock goes into a table of its own.
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
from bayesid.parallel import ALONE
from bayesid.studies.record import KEY, TIMINGS, MisfitError, Record, Row, read_rows
from bayesid.study.runner import LostSchedulerError, Outcome, run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Scenario = Any
"""A frozen dataclass whose fields are numbers, texts, or tuples of these: they become columns."""
Plan = Callable[[int, int], Sequence[tuple[Scenario, int]]]
"""From a number of trials and a first seed to so many scenarios and seeds."""
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
        trials: how many, unless others are asked for.
        plan: which scenarios and seeds.
        trial: from a scenario and a seed to numbers by name, the same ones each time; under "timings", what it says
            of the clock. A module-level function: it runs in other processes.
        report: from rows to tables and a conclusion.
        draw: draws rows into an empty figure.
        short: from rows to a line for each figure that is worse than it may be.
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
    """A study that was run to its end.

    Attributes:
        study: which one.
        rows: one a trial: trial, seed, the scenario's fields, error, worker_died, the results, and `timings`.
    """

    study: Study
    rows: list[Row]

    @property
    def failed(self) -> list[Row]:
        """Rows of trials that raised an error; they have no results."""
        return [row for row in self.rows if row[ERROR]]

    @property
    def good(self) -> list[Row]:
        """All other rows."""
        return [row for row in self.rows if not row[ERROR]]

    @property
    def short(self) -> list[str]:
        """A line for each figure that is worse than it may be."""
        return self.study.short(self.good)

    @property
    def report(self) -> str:
        """Tables and conclusion, and which trials failed."""
        text = self.study.report(self.good) if self.good else "no trial has a result"
        failed = [f"trial {row[KEY]} failed: {row[ERROR]}" for row in self.failed]
        return "\n".join([text, *failed])


def in_turn(scenarios: Sequence[Scenario]) -> Plan:
    """All scenarios with one seed, then all with the next: what is compared shares its seeds."""

    def plan(trials: int, seed: int) -> list[tuple[Scenario, int]]:
        rounds = math.ceil(trials / len(scenarios))
        return [(scenario, seed + k) for k in range(rounds) for scenario in scenarios][:trials]

    return plan


def mixed(parts: Sequence[Sequence[Any]]) -> list[Any]:
    """All items, those of each part in their order and evenly spread: a short run has some of every part."""
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
    """Runs a study, or the rest of it.

    Args:
        study: which one; see `bayesid.studies.load`.
        trials: how many; the study's own number by default.
        seed: of the first trials.
        workers: processes on this machine; one a core by default, 0 for none but this one.
        scheduler: address of a Dask scheduler, tcp://host:port, whose workers are used instead.
        out: folder for rows.parquet and timings.parquet, written as they come; none by default.
        resume: keep the rows that stand there. Trials whose workers died are tried again, other errors are results.
        progress: called after every batch.

    Raises:
        InputError: an option cannot be used, or rows of another run stand in the folder.
        LostSchedulerError: the scheduler ended before the study; all rows that came stand in the folder.
        KeyboardInterrupt: likewise, with a text that says so.
    """
    trials = study.trials if trials is None else trials
    if trials < 1:
        raise InputError(f"{trials} trials", field="trials", remedy="give 1 or more")
    if not 0 <= seed <= _LARGEST_SEED:
        raise InputError(f"{seed} is no seed", field="seed", remedy=f"give a whole number from 0 to {_LARGEST_SEED}")
    plan = study.plan(trials, seed)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()) if out is None else out)
        record = Record(folder, {"study": study.name, "bayesid": version("bayesid")}, resume)
        _check_resumed(record, plan, folder)
        try:
            _run_rest(study, plan, record, workers, scheduler, progress)
        except (KeyboardInterrupt, LostSchedulerError) as stop:
            done = sum(k in record.rows for k in range(trials))
            kept = (
                f"{done} of {trials} trials stand in {folder}; `resume` goes on"
                if out and done
                else "nothing was written"
            )
            raise type(stop)("; ".join([*map(str, stop.args), kept])) from None
        finally:
            record.save(now=True)
        return Finished(study, read_rows(folder)[:trials])


class _Task(NamedTuple):
    """What a worker gets."""

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
    """One row: the trial, its error, its results. Rows without results must not change the columns' order."""
    head = {KEY: k, SEED: seed, **asdict(scenario), ERROR: outcome.error, DIED: outcome.died}
    value = dict(outcome.value or {})
    timings = {"seconds": outcome.seconds, "worker": outcome.worker, **value.pop(TIMINGS, {})}
    if twice := sorted(head.keys() & value.keys()):
        raise ValueError(f"a result is named like a field of the scenario: {', '.join(twice)}")
    try:
        record.add({**head, **value}, timings)
    except MisfitError as error:
        record.add({**head, ERROR: f"the result cannot be kept: {error}"}, {"seconds": outcome.seconds})


def _check_resumed(record: Record, plan: Sequence[tuple[Scenario, int]], folder: Path) -> None:
    """The rows that are there belong to the trials of this plan, and those of dead workers are had again."""
    for k, (scenario, seed) in enumerate(plan):
        if k in record.rows:
            wanted = {SEED: seed, **asdict(scenario)}
            changed = next((name for name, value in wanted.items() if record.rows[k].get(name) != _kept(value)), None)
            if changed is not None:
                said = f"holds rows of another run ({changed} of trial {k} was {record.rows[k].get(changed)!r})"
                raise InputError(said, str(folder), "give the same `seed` (and `trials`), or `folder` a new folder")
    record.forget([k for k, row in record.rows.items() if row[DIED]])


def _kept(value: Any) -> Any:
    """A value as it comes back from a table."""
    return [_kept(item) for item in value] if isinstance(value, tuple) else value


# ---------------------------------------------------------------------------------------------------------------
# The folder of a study that has ended: report.txt and figure.svg, beside its rows
# ---------------------------------------------------------------------------------------------------------------
_FILES = {"rows.parquet", "timings.parquet", "report.txt", "figure.svg"}


def check_results(folder: Path) -> None:
    """Checks that a study may write there: nothing else is there.

    Raises:
        InputError: something else is, or nothing can be written.
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
    """As the study draws it, written aside first and without a date."""
    from matplotlib import rc_context  # takes a second to import
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 3.6), layout="constrained")
    finished.study.draw(finished.good, figure)
    with ALONE, rc_context({"svg.hashsalt": "bayesid"}):
        replace_file(path, lambda aside: figure.savefig(aside, format="svg", metadata={"Date": None}))
