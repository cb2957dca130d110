"""`bayesid study`: trials of a study, its report and its figure."""

from __future__ import annotations

import argparse
from pathlib import Path

from bayesid.cli.progress import CountBar
from bayesid.cli.terminal import show, warn
from bayesid.errors import BayesidError, InputError
from bayesid.studies import load
from bayesid.study.study import check_results, run_study, save_results


def run(options: argparse.Namespace) -> None:
    """A folder with the trials' rows, a report and a figure."""
    if options.floor and options.trials is not None:
        raise InputError("--floor runs all logs", "--trials", "leave it out")
    study, folder = load(options.name, floor=options.floor), options.out or Path(f"bayesid-study-{options.name}")
    check_results(folder)
    with CountBar("trials", options.quiet) as bar:
        finished = run_study(
            study,
            options.trials,
            options.seed,
            workers=options.workers,
            scheduler=options.scheduler,
            out=folder,
            resume=options.resume,
            progress=bar.show,
        )
        text = save_results(finished, folder)
    for row in finished.failed:
        warn(f"trial {row['trial']} failed: {row['error']}")
    if not options.quiet:
        show(text, f"written to {folder}/")
    if finished.short:
        raise BayesidError(
            f"{options.name}: {len(finished.short)} figures are below their floor: see {folder}/report.txt"
        )
