"""What a user sees: results on stdout, warnings and errors on stderr, coloured on a terminal unless NO_COLOR is set."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Collection, Iterable, Sequence
from functools import cache

from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from bayesid.errors import printable

OPTIONS = {
    name: f"--{name.rpartition('.')[2].replace('_', '-')}"
    for name in (
        *("about", "between", "capsules", "changes", "columns", "complete", "criterion", "cutoff", "duration", "each"),
        *(
            "effort_limits",
            "false_alarms",
            "floor",
            "gains",
            "hold",
            "holdout",
            "joints",
            "known_mass",
            "lag",
            "limits",
        ),
        *("margin", "noise", "payload", "q", "rate", "resume", "scheduler", "seed", "start", "terms", "tip", "tool"),
        *("topic", "trials", "unsigned", "validation", "workers", "Beam.initial_segments", "Beam.time_limit"),
        *("Beliefs.links", "Beliefs.nominal", "Certified.time_limit", "Preparation.max_memory", "Sampling.mode"),
        *("Sampling.time_limit", "TrajectoryShape.duration", "TrajectoryShape.harmonics", "TrajectoryShape.periods"),
        *("TrajectoryShape.rate",),
    )
} | {
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
_UNWRAPPED = 10_000
"""Columns of what is no terminal: a file's or a pipe's lines are as long as they are."""


_GAP = 3
"""Columns between those of a table."""


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
        width=None if on_terminal else _UNWRAPPED,
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
    drawn = Table(box=None, pad_edge=False, padding=(0, _GAP, 0, 0), header_style="bold")
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
