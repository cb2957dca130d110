"""`bayesid completion`: a script for the user's shell."""

from __future__ import annotations

import argparse

import shtab

from bayesid.cli.parser import make_parser


def run(options: argparse.Namespace) -> None:
    """Prints it as it is."""
    main = make_parser()
    for parser in (main, *main.commands.values()):
        for action in parser.paths:
            vars(action)["complete"] = shtab.FILE
    print(shtab.complete(main, shell=options.shell))
