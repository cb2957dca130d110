"""The parser of the command line, with errors of one line that suggest the nearest name."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import Any, NoReturn

from bayesid.cli import UsageError
from bayesid.cli.config import find_config
from bayesid.errors import near_names
from bayesid.files.bounded import check_name, whole_number

Option = tuple[str, dict[str, Any]]
"""Name and keyword arguments of `argparse.ArgumentParser.add_argument`."""
WIDTH = 80
"""Columns of a help."""
_NUMBERS = re.compile(r"-[\d.][-+\d.e]*(?:,[-+\d.e]+)+")
"""Several numbers, the first one negative."""


@dataclass(frozen=True)
class Command:
    """A command, or a program of several commands, with its help."""

    name: str
    purpose: str  #: one line of help
    examples: Sequence[str]  #: command lines
    options: Sequence[Option] = ()  #: shown by `--help`
    sections: Mapping[str, Sequence[Option]] = field(default_factory=dict)  #: further options of `--help-all`, by title
    commands: Sequence[Command] = ()  #: subcommands
    more: str = ""  #: text at the end of its help
    details: str = ""  #: text at the end of `--help-all`
    moved: Mapping[str, str] = field(default_factory=dict)  #: former options, with a remedy

    @property
    def names(self) -> set[str]:
        """Names of its options and those of subcommands."""
        options = {name for part in (self.options, *self.sections.values()) for name, _ in part}
        return options.union(*(command.names for command in self.commands))


def option(name: str, help: str = "", **settings: Any) -> Option:
    """An argument `name` or an option `--name`, `--name VALUE` or `--name a|b`, with the first choice by default.

    A number has its default's type, and the help ends with the default.
    """
    name, _, value = name.partition(" ")
    if "|" in value:
        settings |= {"choices": value.split("|"), "default": value.partition("|")[0]}
    elif value:
        settings["metavar"] = value
    default = settings.get("default")
    if isinstance(default, float):
        settings["type"] = float
    if isinstance(default, int | float) and "default" not in help:
        help += " (default: %(default)g)"
    return name, {"help": help, **settings}


def flag(name: str, help: str) -> Option:
    """An option without a value."""
    return option(name, help, action="store_true")


def path(name: str, help: str, **settings: Any) -> Option:
    """A file or a folder."""
    return option(name, help, type=Path, **settings)


def several(name: str, help: str, **settings: Any) -> Option:
    """An option that may be repeated."""
    return option(name, help, action="append", default=[], **settings)


class _Help(argparse.RawDescriptionHelpFormatter):
    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=30, width=WIDTH)
        self._action_max_length = 16  # argparse ignores the indentation of commands


class Parser(argparse.ArgumentParser):
    """A parser with errors of one line that suggest the nearest name.

    Attributes:
        commands: parsers of the commands, by name.
        command: the command that it parses.
        options: names of the options.
    """

    def __init__(self, *, command: Command, **settings: Any) -> None:
        about = f"{command.purpose[0].upper()}{command.purpose[1:]}."
        super().__init__(**settings, description=about, usage=_usage(command), formatter_class=_Help)
        self.commands: dict[str, Parser] = {}
        self.command = command
        self.options = ["-h", "--help", "--help-all"]
        self.add_argument("--help-all", action=_HelpAll, nargs=0, help=argparse.SUPPRESS)

    def understand(self, arguments: Sequence[str]) -> argparse.Namespace:
        """The options of one command, with its name as `command`; exits after printing a requested help.

        `given` holds the long options of the command line, `configured` the options of a `bayesid.toml`. Long options
        are checked first: argparse would report missing arguments before a misspelled option.

        Raises:
            UsageError: they are bad.
            InputError: a `bayesid.toml` is invalid.
        """
        parser = self
        for word in arguments:
            if word not in parser.commands:
                if parser.commands and not word.startswith("-"):
                    return self.parse_args(arguments)  # raises: there is no such command
                break
            parser = parser.commands[word]
        if parser.commands and not arguments[1:] and (not arguments or arguments[0] in self.commands):
            parser.print_help()
            parser.exit()
        given: set[str] = set()
        words = takewhile(lambda word: word != "--", arguments)
        for name in [word.partition("=")[0] for word in words if word.startswith("--")]:
            meant = [known for known in parser.options if known.startswith(name)]  # argparse accepts abbreviations
            if not meant:
                moved = parser.command.moved.get(name)
                near = f"; {moved}" if moved else _suggestion(name, parser.options)
                parser.error(f"there is no option {name}{near}")
            given |= {name} if name in meant else set(meant)
        options = parser._with_config(self, _joined(arguments), given)
        for value in vars(options).values():
            if isinstance(value, Path) and "+" not in value.name:  # files of one recording
                check_name(value)
        return options

    def _with_config(self, program: Parser, words: Sequence[str], given: set[str]) -> argparse.Namespace:
        """The options of the command line, completed by those of a file."""
        options = program.parse_args(words)
        found = find_config(options, given, self._option_string_actions) if "--config" in self.options else None
        if found is not None:
            added = [word for stated in found.words.values() for word in stated]
            try:
                options = program.parse_args([words[0], *added, *words[1:]])
            except UsageError as error:
                raise UsageError(self.prog, f"{found.path}: {error.args[1]}") from None
        options.given, options.configured = frozenset(given), found
        return options

    def format_help(self, everything: bool = False) -> str:
        """The short help, or all options."""
        formatter = self._get_formatter()
        formatter.add_usage(self.usage, self._actions, self._mutually_exclusive_groups)
        formatter.add_text(self.description)
        for group in self._action_groups:
            if everything or group.title not in self.command.sections:
                formatter.start_section(group.title)
                formatter.add_arguments(group._group_actions)
                formatter.end_section()
        examples = "\n".join(["examples:", *(f"  {example}" for example in self.command.examples)])
        more = self.command.sections or self.command.details
        last = "" if everything or not more else f"all options: {self.prog} --help-all"
        for text in (examples, self.command.more, self.command.details if everything else "", last):
            formatter.add_text(text or None)
        return formatter.format_help()

    def error(self, message: str) -> NoReturn:
        """Raises a UsageError that suggests the nearest name."""
        if choice := re.search(r"invalid choice: '(.*)' \(choose from (.*)\)", message):
            message += _suggestion(choice[1], re.split(r"[', ]+", choice[2].strip("'")))
        raise UsageError(self.prog, f"{message}; see `{self.prog} --help`")


class _HelpAll(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        if isinstance(parser, Parser):
            print(parser.format_help(everything=True), end="")
        parser.exit()


def make_parser(command: Command, *, files: Any = None) -> Parser:
    """The parser of a program; `files` says how `shtab` completes an argument that is a file or a folder."""
    parser = Parser(prog=command.name, command=command)
    _fill(parser, "command", files)
    return parser


def _usage(command: Command) -> str:
    many = {"+": "{0} [{0} ...]", "*": "[{0} ...]", "?": "[{0}]", None: "{0}"}
    places = [(name, settings) for name, settings in command.options if not name.startswith("-")]
    words = [many[settings.get("nargs")].format(settings.get("metavar", name)) for name, settings in places]
    return " ".join(["%(prog)s", *words, *(["COMMAND"] * bool(command.commands)), "[options]"])


def _fill(parser: Parser, kind: str, files: Any) -> None:
    """Adds the options of a command and its subcommands, which are called `kind` in the help."""
    command = parser.command
    sections = {parser: command.options} | {parser.add_argument_group(t): more for t, more in command.sections.items()}
    for section, options in sections.items():
        for name, settings in options:
            action = section.add_argument(name, **settings)
            parser.options += action.option_strings
            if action.type is Path:
                vars(action)["complete"] = files
    if command.commands:
        below = parser.add_subparsers(
            required=True, dest=kind, metavar="COMMAND", prog=parser.prog, parser_class=Parser
        )
        for part in command.commands:
            parser.commands[part.name] = below.add_parser(part.name, help=part.purpose, command=part)
            _fill(parser.commands[part.name], "action", files)


def _suggestion(word: str, known: Sequence[str]) -> str:
    near = near_names(word, known)
    return f", {near}" if near else ""


def _whole(text: str, least: int) -> int:
    number = whole_number(text)
    if number is None or number < least:
        raise argparse.ArgumentTypeError(f"{text!r:.60} is not a whole number from {least} up")
    return number


seed, whole = partial(_whole, least=0), partial(_whole, least=1)


def _joined(arguments: Sequence[str]) -> list[str]:
    """Joins options and lists of numbers that begin with a minus sign, which argparse takes for options."""
    words: list[str] = []
    for word in arguments:
        if words and _NUMBERS.fullmatch(word) and re.fullmatch(r"--[a-z][a-z-]*", words[-1]):
            words[-1] += f"={word}"
        else:
            words.append(word)
    return words
