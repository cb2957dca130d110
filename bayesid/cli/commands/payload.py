"""`bayesid payload`: what a robot carries, from a log with it and the result of one without."""

from __future__ import annotations

import argparse

from bayesid.cli.options import read, reading_options
from bayesid.cli.progress import StageBars
from bayesid.cli.tables import payload_parts
from bayesid.cli.terminal import show, warn
from bayesid.errors import InputError
from bayesid.files.writing import check_folder
from bayesid.identification.model_file import load_model
from bayesid.identification.options import Preparation
from bayesid.identification.payload import PayloadReading, identify_payload
from bayesid.identification.pipeline import QUICK
from bayesid.posterior.sampler import Sampling
from bayesid.progress import Progress
from bayesid.results.folders import PAYLOAD, PAYLOAD_FILES, save_payload
from bayesid.signs.search.certified import Certified


def run(options: argparse.Namespace) -> None:
    """A table, and a folder where one is asked for."""
    folder = None if options.out is None else check_folder(options.out, PAYLOAD_FILES, PAYLOAD)
    with StageBars(options.quiet) as bars:
        result = _payload(options, bars)
    if folder is not None:
        save_payload(result, folder)
    for warning in result.warnings:
        warn(warning)
    if not options.quiet:
        parts = payload_parts(result, options.result)
        show(*parts, *([] if folder is None else [f"written to {folder}/"]))


def _payload(options: argparse.Namespace, bars: StageBars) -> PayloadReading:
    bars.show("read", 0, 1)
    known_mass = None if options.known_mass is None else _mass(options.known_mass)
    budget = QUICK.budget if options.search_budget is None else options.search_budget
    search = Certified(budget=budget, time_limit=options.time_limit)
    posterior = Sampling(budget=options.posterior_budget, time_limit=options.time_limit, seed=options.seed)
    identified = load_model(options.result)
    return identify_payload(
        identified,
        read(options.log, reading_options(options, identified)),
        known_mass=known_mass,
        search=search,
        posterior=posterior,
        preparation=Preparation(cutoff=options.cutoff),
        progress=Progress(bars.show),
    )


def _mass(text: str) -> tuple[float, float]:
    """KG or KG~SD."""
    mass, _, sd = text.partition("~")
    try:
        return float(mass), float(sd) if sd else 0.0
    except ValueError:
        raise InputError(f"{text!r} is no mass", "--known-mass", "give kg, as in 2.805 or 2.805~0.005") from None
