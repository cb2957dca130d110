"""`bayesid predict`: efforts of a motion by a result's model, with their uncertainty."""

from __future__ import annotations

import argparse
from pathlib import Path

from bayesid.cli.options import motion_options, read_positions
from bayesid.cli.progress import StageBars
from bayesid.cli.tables import prediction_parts
from bayesid.cli.terminal import show
from bayesid.errors import InputError
from bayesid.files.writing import check_place
from bayesid.identification.model_file import load_model


def run(options: argparse.Namespace) -> None:
    """One file."""
    _check(options.out, options.motion)
    with StageBars(options.quiet) as bars:
        bars.show("read", 0, 1)
        identified = load_model(options.result)
        motion = read_positions(options.motion, motion_options(options))
        bars.show("predict", 0, 1)
        predicted = identified.predict(motion, noise=not options.without_noise, cutoff=options.cutoff)
    predicted.save(options.out)
    if not options.quiet:
        show(*prediction_parts(predicted), f"written to {options.out}")


def _check(out: Path, motion: Path) -> None:
    """A place where the file may stand."""
    if out.is_dir():
        raise InputError("is a folder", str(out), "give --out the name of a file")
    if out.resolve() == motion.resolve():
        raise InputError("is the motion itself", str(out), "give --out another place")
    check_place(out)
