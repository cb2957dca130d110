"""What goes to stderr: warnings and errors, coloured on a terminal unless NO_COLOR is set."""

from __future__ import annotations

import os
import sys

_RED, _YELLOW = 31, 33


def warn(told: str) -> None:
    """What the user should know, in one line."""
    _say("warning", told, _YELLOW)


def complain(told: str, name: str = "bayesid") -> None:
    """Why a command ends without what was asked for."""
    _say(name, told, _RED)


def _say(head: str, told: str, colour: int) -> None:
    plain = not sys.stderr.isatty() or os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    print(f"{head}: {told}" if plain else f"\x1b[1;{colour}m{head}:\x1b[0m {told}", file=sys.stderr)
