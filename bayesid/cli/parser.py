"""What a command line is parsed by: one line on what is wrong, and the nearest name.

This module and `bayesid.cli.arguments` import nothing that computes, so that a shell has its answer at once.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Sequence
from itertools import takewhile
from pathlib import Path
from typing import Any, NoReturn

from bayesid.errors import near_names
from bayesid.files.bounded import check_name, whole_number

_NUMBERS = re.compile(r"-[\d.][-+\d.e]*(?:,[-+\d.e]+)+")
"""Several numbers, the first below zero."""


TERMS = "rigid_body,viscous_friction,coulomb_friction,torque_offset,rotor_inertia"
"""`bayesid.effects.STANDARD`, spelled out: to import the catalogue for a help text takes a second."""
ROBOT = "--robot", "--tip", "--hold"
"""Which robot, and which of its joints."""
MOTION = "--degrees", "--columns", "--topic", "--joints"
"""How a motion is to be read."""
READING = "--gains", "--unsigned", *MOTION
"""How a log is to be read, see `bayesid.read_log`."""


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, and which name is the nearest.

    Attributes:
        commands: parsers of the commands, by name.
        options: names of the options.
        paths: arguments that are files or folders, for the shell to complete.
    """

    def __init__(self, **options: Any) -> None:
        self.commands: dict[str, Parser] = {}
        self.options: list[str] = []
        self.paths: list[argparse.Action] = []
        super().__init__(**options, formatter_class=argparse.RawDescriptionHelpFormatter)

    def add_argument(self, *names: Any, **options: Any) -> argparse.Action:
        """As argparse does."""
        return self._noted(super().add_argument(*names, **options))

    def add_section(self, title: str) -> Callable[..., argparse.Action]:
        """A part of the help with a title, and what adds an option to it."""
        group = self.add_argument_group(title)
        return lambda *names, **options: self._noted(group.add_argument(*names, **options))

    def _noted(self, action: argparse.Action) -> argparse.Action:
        self.options += action.option_strings
        if action.type is Path:
            self.paths.append(action)
        return action

    def understand(self, arguments: Sequence[str]) -> argparse.Namespace:
        """The options of one command, its name as `command`; with bad ones, or where help is asked for, it exits.

        `given` holds the long options of the command line: a default may be what was given, and may not. Long options
        are looked up first: argparse would name those that are missing, not the misspelled one.
        """
        parser = self
        for word in arguments:
            if word not in parser.commands:
                if parser.commands and not word.startswith("-"):
                    return self.parse_args(arguments)  # there is no such command, whatever its options
                break
            parser = parser.commands[word]
        for name in _names(arguments):
            if not any(known.startswith(name) for known in parser.options):
                parser.error(f"there is no option {name}{_suggestion(name, parser.options)}")
        words = _joined(arguments)
        options = self.parse_args(words)
        options.given = frozenset(_options(parser, words))
        for value in vars(options).values():
            if isinstance(value, Path) and "+" not in value.name:  # between the files of one run
                check_name(value)
        return options

    def error(self, message: str) -> NoReturn:
        """Ends the program with one line on stderr."""
        from bayesid.cli.terminal import complain

        if choice := re.search(r"invalid choice: '(.*)' \(choose from (.*)\)", message):
            message += _suggestion(choice[1], re.split(r"[', ]+", choice[2].strip("'")))
        complain(f"{message}; see `{self.prog} --help`", self.prog)
        self.exit(2)


def _suggestion(word: str, known: Sequence[str]) -> str:
    near = near_names(word, known)
    return f", {near}" if near else ""


def seed(text: str) -> int:
    """A whole number from 0 up."""
    number = whole_number(text)
    if number is None:
        raise argparse.ArgumentTypeError(f"{text!r:.60} is not a whole number from 0 up")
    return number


def whole(text: str) -> int:
    """A whole number from 1 up."""
    number = whole_number(text)
    if number is None or number < 1:
        raise argparse.ArgumentTypeError(f"{text!r:.60} is not a whole number from 1 up")
    return number


def _names(words: Sequence[str]) -> list[str]:
    before = takewhile(lambda word: word != "--", words)
    return [word.partition("=")[0] for word in before if word.startswith("--")]


def _options(parser: Parser, words: Sequence[str]) -> list[str]:
    """Long options in full; argparse takes their beginnings too."""
    return [
        known
        for name in _names(words)
        for known in ([name] if name in parser.options else parser.options)
        if known.startswith(name)
    ]


def _joined(arguments: Sequence[str]) -> list[str]:
    """Options in one word with lists of numbers that begin with a minus sign: argparse takes these for options."""
    words: list[str] = []
    for word in arguments:
        if words and _NUMBERS.fullmatch(word) and re.fullmatch(r"--[a-z][a-z-]*", words[-1]):
            words[-1] += f"={word}"
        else:
            words.append(word)
    return words


SHARED: dict[str, dict[str, Any]] = {
    "--robot": {
        "required": True,
        "help": "built-in name (see `bayesid robot list`), DH file (.toml), URDF file, or a name of example-robot-data "
        "or robot_descriptions",
    },
    "--tip": {
        "metavar": "LINK",
        "help": "of a URDF: link or joint where the chain that is identified ends (default: all chains but grippers)",
    },
    "--hold": {"metavar": "JOINT=Q,..", "help": "of a URDF: more joints that are held, at these positions (rad, m)"},
    "--terms": {"default": TERMS, "help": "of the model (default: %(default)s)"},
    "--nominal": {
        "type": Path,
        "metavar": "CSV",
        "help": "parameters known beforehand, from CAD or a data sheet: name,mean,sd, names as in parameters.csv",
    },
    "--cutoff": {"type": float, "metavar": "HZ", "help": "of the motion's low-pass (default: from the data)"},
    "--gains": {
        "metavar": "K1,K2,..",
        "help": "N m/A of each joint, for a log of currents: exact, or to be estimated where uncertain, as in "
        "12~20%%,16~1.5,10 (sd), 'unknown' for one or all, or a CSV file with the columns gain,sd; uncertain ones may "
        "correct torques too; --gains=-12,.. where the first is negative",
    },
    "--unsigned": {"metavar": "JOINTS", "help": "all, none, or joints as in 1,3 (default: those never negative)"},
    "--degrees": {
        "action": argparse.BooleanOptionalAction,
        "help": "positions and velocities without a unit are in degrees; --no-degrees: in rad, however large",
    },
    "--columns": {
        "metavar": 'T="..",Q="..{}",..',
        "help": 'what the log calls its columns, as in t="Zeit [ms]",q="Achse{} [Grad]",i="Strom{} [A]", or a TOML '
        "file with such lines (default: the usual names)",
    },
    "--topic": {"metavar": "/NAME", "help": "of a ROS bag with joint states of several topics"},
    "--joints": {"metavar": "A,B,..", "help": "names of a ROS bag's joints, from base to tip"},
    "--max-memory": {
        "type": float,
        "metavar": "GB",
        "help": "that the run may need, or else it does not begin (default: 0.8 of the machine's)",
    },
    "--search-budget": {"type": float, "metavar": "S"},
    "--no-posterior": {"action": "store_true"},
    "--posterior-budget": {
        "type": float,
        "default": 60.0,
        "metavar": "S",
        "help": "work of sampling, about seconds of an idle machine; it ends when it has converged "
        "(default: %(default)g)",
    },
    "--noise": {"type": float, "default": 0.05, "metavar": "REL", "help": "of each joint's RMS (default: 0.05)"},
    "--seed": {"type": seed, "default": 0, "help": "of everything random (default: 0)"},
    "--time-limit": {
        "type": float,
        "default": 600.0,
        "metavar": "S",
        "help": "seconds on the clock, for the search and for sampling each; the result says where it stopped one. "
        "Budgets count work instead: the same result on a busy machine (default: %(default)g)",
    },
    "--workers": {"type": whole, "metavar": "K", "help": "processes on this machine (default: one a core)"},
    "--scheduler": {"metavar": "tcp://HOST:PORT", "help": "of a Dask cluster, to run on its workers instead"},
    "--out": {"type": Path},
    "--quiet": {"action": "store_true", "help": "print nothing but warnings and errors"},
}


def share(parser: Parser, *names: str, **changes: Any) -> None:
    """Adds options of several commands, changed where a command means something else by them."""
    for name in names:
        parser.add_argument(name, **{**SHARED[name], **changes})
