"""Progress bars on stderr: on a terminal only, of what takes over a second."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from datetime import timedelta
from typing import Self

from rich.console import RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn
from rich.text import Text

from bayesid.cli.terminal import console
from bayesid.parallel import onlookers

_PATIENCE = 1.0
"""s; what ends sooner is not worth a bar. A round number; not studied."""
_REFRESHES = 4.0
"""1/s; how often bars are drawn: an eye sees no more, and the computation shares the processor."""


class _Bars(Progress):
    """Bars of the tasks that have taken a while, which vanish at the end."""

    def __init__(self, *columns: ProgressColumn) -> None:
        super().__init__(*columns, console=console(stderr=True), transient=True, refresh_per_second=_REFRESHES)

    def get_renderables(self) -> Iterable[RenderableType]:
        """What is drawn."""
        yield self.make_tasks_table([task for task in self.tasks if (task.elapsed or 0.0) > _PATIENCE])


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
