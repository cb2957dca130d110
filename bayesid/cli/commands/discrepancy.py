"""`bayesid discrepancy`: what the model of a result lacks to explain another log."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from bayesid.cli.discrepancy_tables import discrepancy_parts
from bayesid.cli.options import command_line, end_with, read, reading_options, sampling
from bayesid.cli.progress import StageBars
from bayesid.cli.terminal import show, warn
from bayesid.discrepancy.workflow import find_discrepancy
from bayesid.errors import InputError
from bayesid.files import reserved
from bayesid.identification.options import Preparation
from bayesid.progress import Progress
from bayesid.results.folders import check_result_folder, collect_incomplete, save_discrepancy, save_or_rescue
from bayesid.results.model_file import load_model
from bayesid.signs.search.certified import Certified


def run(options: argparse.Namespace) -> None:
    """A folder with the extended model."""
    folder = check_result_folder(options.out or Path(f"bayesid-discrepancy-{options.log.stem}"))
    for path in (options.result, options.log, *([] if options.holdout is None else [options.holdout])):
        if path.resolve() == folder.resolve() or path.resolve().parent == folder.resolve():
            said = f"holds {path.name}, which the result would replace"
            raise InputError(said, str(folder), "give --out a new folder")
    identified, reading = load_model(options.result), reading_options(options)
    logs = [options.log] if options.holdout is None else [options.log, options.holdout]
    with reserved(folder), StageBars(options.quiet) as bars:
        bars.show("read", 0, 1)
        log, *holdout = [read(path, reading) for path in logs]
        result = find_discrepancy(
            identified,
            log,
            holdout[0] if holdout else None,
            search=Certified(budget=options.search_budget, repeatable=options.repeatable),
            posterior=sampling(options),
            preparation=Preparation(cutoff=options.cutoff),
            progress=Progress(bars.show),
        )
        again = result.identification
        run_by = replace(again.provenance, command=command_line())
        result = replace(result, identification=replace(again, provenance=run_by))
        bars.show("write", 0, 1)
        with collect_incomplete() as incomplete:
            save_or_rescue(lambda place: save_discrepancy(result, place, progress=Progress(bars.show)), folder)
    for warning in result.warnings:
        warn(warning)
    if not options.quiet:
        show(*discrepancy_parts(result), f"written to {folder}/")
    end_with(incomplete)
