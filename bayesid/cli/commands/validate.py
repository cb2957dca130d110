"""`bayesid validate`: a result's model against another log."""

from __future__ import annotations

import argparse
from pathlib import Path

from bayesid.cli.options import read, reading_options
from bayesid.cli.progress import StageBars
from bayesid.cli.tables import validation_parts
from bayesid.cli.terminal import show
from bayesid.identification.model_file import load_model
from bayesid.identification.validation import Validation
from bayesid.results.folders import VALIDATION_FILES, check_result_folder, save_validation


def run(options: argparse.Namespace) -> None:
    """A table, and a folder where one is asked for."""
    folder = None if options.out is None else check_result_folder(options.out, VALIDATION_FILES)
    with StageBars(options.quiet) as bars:
        result = validation_of(options, options.log, bars)
    if folder is not None:
        save_validation(result, folder)
    if not options.quiet:
        show(*validation_parts(result), *([] if folder is None else [f"written to {folder}/"]))


def validation_of(options: argparse.Namespace, path: Path, bars: StageBars) -> Validation:
    """The validation of the model in the folder `options.result` by a log."""
    bars.show("read", 0, 1)
    identified = load_model(options.result)
    log = read(path, reading_options(options, identified))
    bars.show("validate", 0, 1)
    return identified.validate(log, options.cutoff)
