"""`bayesid excite`: a motion to record, for a robot or for a result, or what a log's motion leaves undecided."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from bayesid.cli.next_motion import design_for_result
from bayesid.cli.options import beliefs, read, reading_options, robot_of, term_names
from bayesid.cli.progress import StageBars
from bayesid.cli.terminal import show, warn
from bayesid.errors import InputError
from bayesid.excitation.design import ExcitationDesign, Objective, TrajectoryShape, design_excitation
from bayesid.excitation.judgement import judge_log
from bayesid.excitation.limits import read_limits
from bayesid.files.writing import check_folder
from bayesid.progress import Progress
from bayesid.report.excitation_text import design_text, judgement_text
from bayesid.results.motions import DESIGN_FILES, DESIGN_MARKER, save_design
from bayesid.robot import Robot

_FOR_RESULT = (
    *("--about", "--between", "--criterion", "--start", "--payload", "--effort-limits"),
    *("--capsules", "--tool", "--floor", "--margin", "--meshes", "--changes"),
)
"""Options that mean nothing without `--for`."""
_FOR_ROBOT = (
    *("--terms", "--harmonics", "--periods", "--noise", "--nominal", "--cutoff", "--seed"),
    *("--gains", "--unsigned", "--degrees", "--no-degrees", "--columns", "--topic", "--joints"),
)
"""Options that mean nothing with it: the result has its own terms, noise and parameters."""


def run(options: argparse.Namespace) -> None:
    """A design's folder, or a judgement."""
    if options.result is not None:
        if options.log is not None:
            raise InputError("asks for a judgement and for a design", "--log", "leave it or --for out")
        _refuse(options, _FOR_ROBOT, "means nothing for a result, which has its own", "leave it or --for out")
        show_unless_quiet(design_for_result(options), options)
        return
    _refuse(options, _FOR_RESULT, "is for the motion after a result", "give --for RESULT_DIR")
    if options.robot is None:
        raise InputError("no robot and no result", "excite", "give --robot R, or --for RESULT_DIR")
    robot = robot_of(options)
    for note in robot.notes:
        warn(note)
    with StageBars(options.quiet) as bars:
        text = _design(robot, options, bars) if options.log is None else _judge(robot, options, bars)
    show_unless_quiet(text, options)


def _refuse(options: argparse.Namespace, names: Sequence[str], said: str, remedy: str) -> None:
    """Raises InputError if one of some options was given."""
    for name in names:
        if name in options.given:
            raise InputError(said, name, remedy)


def show_unless_quiet(text: str, options: argparse.Namespace) -> None:
    """Prints a text, unless nothing is to be printed."""
    if not options.quiet:
        show(text)


def _judge(robot: Robot, options: argparse.Namespace, bars: StageBars) -> str:
    log = read(options.log, reading_options(options))
    bars.show("judge", 0, 1)
    terms = term_names(options)
    return judgement_text(judge_log(robot, log, terms, noise=options.noise, cutoff=options.cutoff, seed=options.seed))


def _design(robot: Robot, options: argparse.Namespace, bars: StageBars) -> str:
    folder = check_folder(options.out, DESIGN_FILES, DESIGN_MARKER)
    design = _designed(robot, options, bars)
    save_design(design, folder)
    return f"{design_text(design)}\nwritten to {folder}/"


def _designed(robot: Robot, options: argparse.Namespace, bars: StageBars) -> ExcitationDesign:
    source = options.limits or (None if robot.origin is None else robot.origin.urdf)
    return design_excitation(
        robot,
        term_names(options),
        shape=TrajectoryShape(
            duration=options.duration, rate=options.rate, harmonics=options.harmonics, periods=options.periods
        ),
        limits=None if source is None else read_limits(source, robot),
        objective=Objective(noise=options.noise),
        beliefs=beliefs(options),
        seed=options.seed,
        progress=Progress(bars.show),
    )
