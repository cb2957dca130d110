"""Output: results on stdout, warnings and errors on stderr, coloured on a terminal unless NO_COLOR is set."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING

from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from bayesid.cli.arguments import BAYESID
from bayesid.cli.tuning import TUNING
from bayesid.errors import printable

if TYPE_CHECKING:
    from bayesid.identification.checks import Check
    from bayesid.report.conclusion import Conclusion

COLOURS = {"good": "green", "look": "yellow", "bad": "bold red", "not done": "yellow"}
"""Of the states of a check."""
OPTIONS = {
    "Beam.budget": "--search-budget",
    "Beam.width": "--beam-width",
    "Certified.budget": "--search-budget",
    "Log.carrying": "--payload",
    "Sampling.budget": "--posterior-budget",
    "degrees=False": "--no-degrees",
    "effects": "--effect",
    "folder": "--out",
    "noise=False": "--without-noise",
}
"""Options for arguments with other names."""
_ARGUMENT = re.compile("`([^` ]+)`")
_WORD = re.compile(r"(?:`[^`]*`|\S)+(?: (?:%|kg|N m|N|s)(?![^\s,.;:)]))?")  # a number stays with its unit


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
        width=None if on_terminal else 10_000,  # no folding in files and pipes
        color_system="auto" if coloured else None,
        highlight=False,
        markup=False,
        emoji=False,
    )


def show(*parts: RenderableType) -> None:
    """Prints on stdout: sentences folded, tables and texts of several lines unchanged."""
    for part in parts:
        text = Text(part) if isinstance(part, str) else part
        if isinstance(text, Text) and "\n" not in text.plain:
            text = _folded(text, console().width if console().is_terminal else TUNING.width)
        console().print(text, soft_wrap=isinstance(text, Text))


def _folded(text: Text, width: int) -> Text:
    """A sentence folded to a width, with later lines indented; words and commands in backticks are not split."""
    indent = " " * (len(text.plain) - len(text.plain.lstrip()) + 2)
    cuts, begin = [], 0
    for word in _WORD.finditer(text.plain):
        if word.end() - begin > width and word.start() > begin + len(indent):
            cuts.append(word.start())
            begin = word.start() - len(indent)
    lines = list(text.divide(cuts))
    for line in lines:
        line.rstrip()
    return Text(f"\n{indent}").join(lines)


def table(
    headings: Sequence[str],
    rows: Iterable[Sequence[str]],
    left: Collection[str] = (),
    widest: Mapping[str, int] = MappingProxyType({}),
) -> Table:
    """A table without lines; numbers are right-aligned, columns with the headings `left` left-aligned.

    Cells of the columns in `widest` fold at the given number of characters.
    """
    drawn = Table(box=None, pad_edge=False, padding=(0, 3, 0, 0), header_style="bold")
    for heading in headings:
        drawn.add_column(
            heading, justify="left" if heading in left else "right", overflow="fold", max_width=widest.get(heading)
        )
    for row in rows:
        drawn.add_row(*row)
    return drawn


def line_of(check: Check) -> Text:
    """A check in its colour, with its remedy."""
    remedy = f"; {check.remedy}" if check.remedy else ""
    return Text.assemble((f"  {check.name}: ", COLOURS[check.state]), check.message, remedy)


def verdict_parts(conclusion: Conclusion) -> list[RenderableType]:
    """The verdict in its colour, then the actions."""
    parts: list[RenderableType] = ["", Text(conclusion.sentence, COLOURS[conclusion.state])]
    for action in conclusion.actions:
        message = in_options(action.message)
        parts.append(f"  {action.name}{f': {message}' if message else ''}")
        if action.remedy:
            parts.append(f"    -> {in_options(action.remedy)}")
    if conclusion.others:
        parts.append(f"  {conclusion.others} more check{'s' * (conclusion.others > 1)}: see the report")
    return parts


def in_options(text: str) -> str:
    """A message with options in place of arguments in backticks."""

    def option(found: re.Match[str]) -> str:
        name = f"--{found[1].rpartition('.')[2].removesuffix('=True').replace('_', '-')}"
        return OPTIONS.get(found[1], name if name in BAYESID.names else found[0])

    return _ARGUMENT.sub(option, text)


def note(message: str) -> None:
    """A line on stderr."""
    console(stderr=True).print(printable(message), soft_wrap=True)


def warn(message: str) -> None:
    """A warning in one line."""
    _print_message("warning", in_options(message), "bold yellow")


def complain(message: str, name: str = "bayesid") -> None:
    """An error in one line."""
    _print_message(name, in_options(message), "bold red")


def _print_message(head: str, message: str, style: str) -> None:
    console(stderr=True).print(Text.assemble((f"{head}:", style), " ", printable(message)), soft_wrap=True)
