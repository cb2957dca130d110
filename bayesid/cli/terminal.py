"""What a user sees: results on stdout, warnings and errors on stderr, coloured on a terminal unless NO_COLOR is set."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Collection, Iterable, Sequence
from datetime import timedelta
from functools import cache
from typing import Self

from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from bayesid.cli.tuning import TUNING
from bayesid.errors import printable
from bayesid.parallel import onlookers

_SAME = """about between capsules changes columns complete criterion cutoff duration each effort_limits false_alarms
floor gains hold holdout joints known_mass lag limits margin noise payload q rate resume scheduler seed start terms tip
tool topic trials unsigned validation workers Beam.initial_segments Beam.time_limit Beliefs.links Beliefs.nominal
Certified.time_limit Preparation.max_memory Sampling.mode Sampling.time_limit TrajectoryShape.duration
TrajectoryShape.harmonics TrajectoryShape.periods TrajectoryShape.rate"""
"""Arguments whose option has the same name."""
OPTIONS = {name: f"--{name.rpartition('.')[2].replace('_', '-')}" for name in _SAME.split()} | {
    "Beam.budget": "--search-budget",
    "Beam.width": "--beam-width",
    "Certified.budget": "--search-budget",
    "Log.carrying": "--payload",
    "Sampling.budget": "--posterior-budget",
    "degrees=False": "--no-degrees",
    "degrees=True": "--degrees",
    "effects": "--effect",
    "folder": "--out",
    "noise=False": "--without-noise",
}
"""The option of the command line for each argument that an error names."""
_ARGUMENT = re.compile("`([^` ]+)`")


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """`bayesid.cli.main` ends the command, not rich."""
        raise


@cache
def console(stderr: bool = False) -> Console:
    """The console of stdout or stderr."""
    on_terminal = (sys.stderr if stderr else sys.stdout).isatty()
    coloured = on_terminal and not os.environ.get("NO_COLOR")
    return _Console(
        stderr=stderr,
        width=None if on_terminal else 10_000,  # lines of a file or a pipe are as long as they are
        color_system="auto" if coloured else None,
        highlight=False,
        markup=False,
        emoji=False,
    )


def show(*parts: RenderableType) -> None:
    """What a command has to say, on stdout."""
    for part in parts:
        console().print(part, soft_wrap=isinstance(part, str | Text))


def table(headings: Sequence[str], rows: Iterable[Sequence[str]], left: Collection[str] = ()) -> Table:
    """A table without rules, numbers to the right; columns `left`, by their headings, hold words."""
    drawn = Table(box=None, pad_edge=False, padding=(0, 3, 0, 0), header_style="bold")
    for heading in headings:
        drawn.add_column(heading, justify="left" if heading in left else "right", overflow="fold")
    for row in rows:
        drawn.add_row(*row)
    return drawn


def in_options(text: str) -> str:
    """A sentence of the library, with options in place of the arguments that it names in backticks."""
    return _ARGUMENT.sub(lambda found: OPTIONS.get(found[1], found[0]), text)


def note(message: str) -> None:
    """What ends a command whose stdout belongs to another program, on stderr."""
    console(stderr=True).print(printable(message), soft_wrap=True)


def warn(message: str) -> None:
    """What the user should know, in one line."""
    _print_message("warning", in_options(message), "bold yellow")


def complain(message: str, name: str = "bayesid") -> None:
    """Why a command ends without what was asked for, in one line."""
    _print_message(name, in_options(message), "bold red")


def _print_message(head: str, message: str, style: str) -> None:
    console(stderr=True).print(Text.assemble((f"{head}:", style), " ", printable(message)), soft_wrap=True)


class _Bars(Progress):
    """Bars of the tasks that have taken a while, which vanish at the end."""

    def __init__(self, *columns: ProgressColumn) -> None:
        super().__init__(*columns, console=console(stderr=True), transient=True, refresh_per_second=4.0)

    def get_renderables(self) -> Iterable[RenderableType]:
        """What is drawn."""
        yield self.make_tasks_table([task for task in self.tasks if (task.elapsed or 0.0) > TUNING.patience])


class _Pace(ProgressColumn):
    """Steps a second since the bar began, and the time left at that pace: steps may take minutes, as trials do."""

    def render(self, task: Task) -> Text:
        """The column's text."""
        done, seconds = task.completed - task.fields["begun"], task.elapsed or 0.0
        if done <= 0 or seconds <= 0.0:
            return Text("")
        left = timedelta(seconds=(task.remaining or 0.0) * seconds // done)
        return Text(f"{done / seconds:.3g}/s, {left} left")


class _Steps(MofNCompleteColumn):
    """Steps done of all; nothing for a stage without steps, whose bar runs to and fro."""

    def render(self, task: Task) -> Text:
        """The column's text."""
        return Text("") if task.total is None else super().render(task)


class _Bar:
    """One bar at a time; none where nobody watches, or wants to."""

    def __init__(self, quiet: bool, *columns: ProgressColumn) -> None:
        self._bars = None if quiet or not sys.stderr.isatty() else _Bars(*columns)

    def __enter__(self) -> Self:
        if self._bars is not None:
            with onlookers():
                self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bars is not None:
            self._bars.stop()

    def _draw(self, stage: str, done: int, total: int | None, note: str = "") -> None:
        """A new stage takes the place of the one before; what was done before it began counts for no rate."""
        if self._bars is None:
            return
        for task in self._bars.tasks:
            if task.description == stage:
                task.total = total  # `update` cannot say that there is none
                self._bars.update(task.id, completed=done, note=note)
                return
            self._bars.remove_task(task.id)
        self._bars.add_task(stage, completed=done, total=total, note=note, begun=done)


class StageBars(_Bar):
    """A bar for each stage of a computation; `show` is what a `bayesid.progress.Progress` calls."""

    def __init__(self, quiet: bool) -> None:
        super().__init__(quiet, TextColumn("{task.description}"), BarColumn(), _Steps(), TimeElapsedColumn())

    def show(self, stage: str, done: int, total: int) -> None:
        """How far a stage has come; a stage without steps is one step that is not done yet."""
        self._draw(stage, done, None if total == 1 and done == 0 else total)


class CountBar(_Bar):
    """A bar with rate and time left, for many alike."""

    def __init__(self, unit: str, quiet: bool) -> None:
        self._unit = unit
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), _Pace()
        super().__init__(quiet, *columns, TextColumn("{task.fields[note]}", style="bold red"))

    def show(self, done: int, total: int, failed: int) -> None:
        """How many are done, and how many of them failed."""
        self._draw(self._unit, done, total, f"{failed} failed" if failed else "")
