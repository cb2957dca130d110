"""`bayesid simulate`: a log of |effort|, and the same log with its signs."""

from __future__ import annotations

import argparse

from bayesid.cli.options import robot_of
from bayesid.cli.terminal import show, warn
from bayesid.errors import InputError
from bayesid.files.writing import check_place
from bayesid.log.log import write_log
from bayesid.simulation.logs import parse_effect, simulate_log


def run(options: argparse.Namespace) -> None:
    """Two files."""
    if options.out.is_dir():
        raise InputError("is a folder", str(options.out), "give --out the name of a file")
    check_place(options.out)
    robot = robot_of(options)
    for note in robot.notes:
        warn(note)
    effects = [parse_effect(text, robot) for text in options.effect]
    unsigned, signed = simulate_log(robot, options.duration, options.rate, options.noise, effects, options.seed)
    truth = options.out.with_name(f"{options.out.stem}_signed.csv")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_log(options.out, unsigned)
    write_log(truth, signed)
    if not options.quiet:
        show(f"written to {options.out}, with the signs in {truth}")
