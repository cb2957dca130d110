"""`bayesid completion`: a script for the user's shell."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import shtab

from bayesid.cli.parser import Parser, make_parser


def run(options: argparse.Namespace) -> None:
    """Prints it as it is."""
    main = make_parser()
    for parser in _parsers(main):
        for action in parser.paths:
            vars(action)["complete"] = shtab.FILE
    print(shtab.complete(main, shell=options.shell))


def _parsers(parser: Parser) -> Iterator[Parser]:
    """A parser and those of its commands."""
    yield parser
    for command in parser.commands.values():
        yield from _parsers(command)
