"""`bayesid report`: the report of a result folder, anew or with a validation."""

from __future__ import annotations

import argparse

from bayesid.cli.commands.validate import validation_of
from bayesid.cli.progress import StageBars
from bayesid.cli.tables import validation_parts
from bayesid.cli.terminal import show
from bayesid.progress import Progress
from bayesid.results.folders import make_report


def run(options: argparse.Namespace) -> None:
    """One file."""
    with StageBars(options.quiet) as bars:
        validation = None if options.validation is None else validation_of(options, options.validation, bars)
        bars.show("report", 0, 1)
        path = make_report(options.result, validation, options.out, Progress(bars.show))
    if not options.quiet:
        show(*([] if validation is None else validation_parts(validation)), f"written to {path}")
