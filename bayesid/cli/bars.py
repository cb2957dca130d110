"""Progress of long commands on stderr: a bar on a terminal, else a line every ten seconds."""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from datetime import timedelta
from typing import Any, Self

from rich.console import RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, ProgressColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars

from bayesid.cli.terminal import console, note
from bayesid.cli.tuning import TUNING
from bayesid.parallel import display_threads
from bayesid.progress import SILENT, Progress

Counts = Callable[[int, int, int], None]  # called as counts(done, total, failed)


@contextmanager
def stages(options: argparse.Namespace) -> Iterator[Progress]:
    """The progress of a command in stages."""
    if options.quiet:
        yield SILENT
    elif _on_terminal():
        with _StageBar() as bar:
            yield Progress(bar.show)
    else:
        with Lines(options.command) as lines:
            yield Progress(lines.show)


@contextmanager
def counts(options: argparse.Namespace, unit: str) -> Iterator[Counts]:
    """The progress of a command through many items; `unit` names them."""
    if options.quiet:
        yield lambda done, total, failed: None
    elif _on_terminal():
        with _CountBar(unit) as bar:
            bar.draw(unit, 0, None, pace="", failed="")
            yield bar.show
    else:
        pace = _Pace()
        with Lines(options.command) as lines:
            lines.write_line(unit)
            yield lambda done, total, failed: lines.write_line(
                pace.words(f"{done} of {total} {unit}", done, total, failed)
            )


def _on_terminal() -> bool:
    return sys.stderr.isatty() and not console(stderr=True).is_dumb_terminal


class Lines:
    """Progress without a terminal: a line every ten seconds.

    Args:
        command: the beginning of each line.
        write: writes a line.
        clock: s.
    """

    def __init__(
        self, command: str, write: Callable[[str], None] = note, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._command, self._write, self._clock = command, write, clock
        self._text, self._began, self._written = "", clock(), 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        with display_threads():
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def show(self, stage: str, done: int, total: int) -> None:
        """The progress of a stage."""
        steps = ", done" if done == total else f", {done} of {total}" if total > 1 else ""
        self.write_line(f"{stage}{steps}")

    def write_line(self, words: str) -> None:
        """Sets the text of the next line."""
        self._text = words

    def tick(self) -> None:
        """Writes a line if it is due."""
        seconds = self._clock() - self._began
        due = int(seconds / TUNING.between_lines)
        if due > self._written and self._text:
            self._written = due
            self._write(f"{self._command}: {self._text}, {seconds:.0f} s")

    def _run(self) -> None:
        with suppress(OSError, ValueError):  # stderr is closed
            while not self._ended.wait(_until(self._clock() - self._began)):
                self.tick()


def _until(seconds: float) -> float:
    return TUNING.between_lines - seconds % TUNING.between_lines


class _Bar(Bars):
    def __init__(self, *columns: ProgressColumn) -> None:
        drawn = TextColumn("{task.description}"), BarColumn(), *columns
        super().__init__(*drawn, console=console(stderr=True), transient=True, refresh_per_second=4.0)

    def __enter__(self) -> Self:
        with display_threads():
            return super().__enter__()

    def get_renderables(self) -> Iterable[RenderableType]:
        yield self.make_tasks_table([task for task in self.tasks if (task.elapsed or 0.0) > TUNING.patience])

    def draw(self, stage: str, done: int, total: int | None, **notes: Any) -> None:
        """Draws a stage; a new one replaces the one before."""
        for task in self.tasks:
            if task.description != stage or (task.finished and done == 0):
                self.remove_task(task.id)
        if not self.tasks:
            self.add_task(stage, **notes)
        (task,) = self.tasks
        task.total = total  # `update` cannot set None
        self.update(task.id, completed=done, refresh=done == total, **notes)  # shows the end of a stage


class _StageBar(_Bar):
    def __init__(self) -> None:
        super().__init__(TextColumn("{task.fields[steps]}"), TimeElapsedColumn())

    def show(self, stage: str, done: int, total: int) -> None:
        """The progress of a stage; without steps the bar pulses."""
        endless = total == 1 and done == 0
        steps = "done" if done == total else "" if endless else f"{done}/{total}"
        self.draw(stage, done, None if endless else total, steps=steps)


class _CountBar(_Bar):
    def __init__(self, unit: str) -> None:
        self._unit, self._pace = unit, _Pace()
        failed = TextColumn("{task.fields[failed]}", style="bold red")
        super().__init__(MofNCompleteColumn(), TextColumn("{task.fields[pace]}"), failed)

    def show(self, done: int, total: int, failed: int) -> None:
        """The numbers of items done and failed."""
        self.draw(self._unit, done, total, pace=self._pace(done, total), failed=f"{failed} failed" if failed else "")


class _Pace:
    """The rate since the first call and the time left."""

    def __init__(self) -> None:
        self._began, self._first = 0.0, -1

    def __call__(self, done: int, total: int) -> str:
        if self._first < 0:
            self._began, self._first = time.monotonic(), done  # items of an earlier run do not count
        seconds, new = time.monotonic() - self._began, done - self._first
        remaining = timedelta(seconds=(total - done) * seconds // max(new, 1))
        return f"{new / seconds:.3g}/s, {remaining} left" if new and seconds else ""

    def words(self, count: str, done: int, total: int, failed: int) -> str:
        """Count, failures, rate and time left."""
        return ", ".join(filter(None, (count, f"{failed} failed" if failed else "", self(done, total))))
