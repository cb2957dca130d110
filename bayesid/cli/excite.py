"""`bayesid excite`: designs a motion for a robot or a result, or assesses the motion of a log."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.arrays import Array
from bayesid.cli.arguments import FOR_RESULT, FOR_ROBOT
from bayesid.cli.bars import stages
from bayesid.cli.options import (
    check_new,
    check_taken,
    finish,
    given_reading,
    given_robot,
    numbers,
    prior,
    read,
    reading_options,
    robot_of,
    term_names,
)
from bayesid.cli.terminal import warn
from bayesid.cli.tuning import TUNING
from bayesid.discrepancy.numbers import CHANGE_OF
from bayesid.errors import InputError
from bayesid.excitation.assessment import ExcitationAssessment, assess_excitation
from bayesid.excitation.design import design_for_robot
from bayesid.excitation.hypotheses import Hypotheses, equivalent_classes, hypotheses_of
from bayesid.excitation.limits import read_limits
from bayesid.excitation.next_motion import design_next
from bayesid.excitation.settings import MotionSettings
from bayesid.files.writing import read_json
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.identification.model_file import load
from bayesid.motion import Motion
from bayesid.progress import Progress
from bayesid.report.commands import LIMITS
from bayesid.report.motions import (
    DESIGN_FILES,
    DESIGN_MARKER,
    assessment_conclusion,
    assessment_text,
    check_next_folder,
    design_text,
    next_motion_text,
    save_design,
    save_next_motion,
)
from bayesid.report.report_data import read_report_data
from bayesid.robot import Robot
from bayesid.robot.collision import Capsules, CollisionModel, NoShapes, collision_model
from bayesid.simulation.trajectories import MotionLimits

_IDENTIFY = "bayesid", "identify"


@dataclass(frozen=True)
class _Place:
    effect: str
    joints: tuple[int, ...]


@dataclass(frozen=True)
class _Found(_Place):
    equivalent: tuple[str, ...]
    alternatives: tuple[_Place, ...]
    parameters: dict[str, dict[str, Any]]
    change_of_what_was_there: bool


@dataclass(frozen=True)
class _Discrepancy:
    found: tuple[_Found, ...]


def excite_command(options: argparse.Namespace) -> None:
    """Writes a designed motion, or prints the assessment of a log."""
    if options.result is not None:
        if options.log is not None:
            raise InputError("assesses a log, --for designs a motion", "--log", "give one of them")
        _refuse(options, FOR_ROBOT, "has no effect with --for: the result has its own", "leave it out")
        text, last = _design_for_result(options)
        finish(options, text, last=last)
        return
    _refuse(options, FOR_RESULT, "needs a result", "give --for RESULT_DIR")
    if options.robot is None:
        raise InputError("neither a robot nor a result is given", "excite", "give --robot R, or --for RESULT_DIR")
    robot = robot_of(options, notes=True)
    given = given_robot(options)
    if options.log is None:
        with stages(options) as progress:
            text, last = _design(robot, options, progress)
        last = f"{last}; next, with its recording: {shlex.join([*_IDENTIFY, 'RECORDED.csv', *given])}"
        finish(options, text, last=last)
        return
    with stages(options) as progress:
        judged = _judge(robot, options, progress)
    limits = [] if _urdf(robot) is not None or "--limits" in given else ["--limits", LIMITS]
    conclusion = assessment_conclusion(judged, shlex.join(["bayesid", "excite", *given, *limits]))
    last = (
        ""
        if conclusion.state == "bad"
        else f"next: {shlex.join([*_IDENTIFY, str(options.log), *given, *given_reading(options)])}"
    )
    finish(options, assessment_text(judged), conclusion=conclusion, last=last)


def _refuse(options: argparse.Namespace, refused: Sequence[str], reason: str, remedy: str) -> None:
    for name in refused:
        if name in options.given:
            raise InputError(reason, name, remedy)


def _judge(robot: Robot, options: argparse.Namespace, progress: Progress) -> ExcitationAssessment:
    with progress.stage("read"):
        log = read(options, options.log, reading_options(options), robot)
    with progress.stage("assess"):
        settings = {"noise": options.noise, "cutoff": options.cutoff, "rng": options.seed}
        return assess_excitation(robot, log, term_names(options), **settings)


def _design(robot: Robot, options: argparse.Namespace, progress: Progress) -> tuple[str, str]:
    folder = check_new(options, options.out, DESIGN_FILES, DESIGN_MARKER)
    design = design_for_robot(
        robot,
        term_names(options),
        settings=MotionSettings(
            duration=options.duration,
            rate=options.rate,
            harmonics=options.harmonics,
            periods=options.periods,
            limits=_limits(options, robot),
            noise=options.noise,
            changes=options.changes,
        ),
        prior=prior(options),
        seed=options.seed,
        progress=progress,
    )
    with progress.stage("write"):
        save_design(design, folder)
    return design_text(design), f"written to {folder}/"


def _design_for_result(options: argparse.Namespace) -> tuple[str, str]:
    folder = check_next_folder(options.out)
    check_taken(options, folder)
    with stages(options) as progress:
        with progress.stage("read"):
            identified = load(options.result)
            log, recorded = _recorded_motion(options.result)
            robot = _robot_with_shapes(options, identified)
            clearance = _clearance(options, robot, _poses(options, identified.model.robot, recorded))
        settings = MotionSettings(
            duration=options.duration,
            rate=options.rate,
            start=numbers(options.start, "--start"),
            limits=_limits(options, robot),
            clearance=clearance,
            payload=options.payload,
            changes=options.changes,
        )
        about, found = _words(options.about, "--about"), _hypotheses(options.result)
        if between := _words(options.between, "--between"):
            found = Hypotheses(hypotheses_of(between).classes, found.changed)
        elif about:
            found = Hypotheses()
        design = design_next(
            identified,
            about,
            found,
            settings=settings,
            recorded=recorded,
            criterion=options.criterion,
            progress=progress,
        )
        with progress.stage("write"):
            save_next_motion(design, folder)
    again = ["bayesid", "discrepancy", str(options.result), "RECORDED.csv"]
    if design.predicted.log10_bayes_factors == {}:
        again = [*_IDENTIFY, *log, "RECORDED.csv", "--config", f"{options.result}/bayesid.toml", "--out", "better"]
    return next_motion_text(design), f"written to {folder}/; next, with its recording: {shlex.join(again)}"


def _recorded_motion(folder: Path) -> tuple[list[str], Motion | None]:
    """The files of a result's log, and its motion; none if the folder does not hold it."""
    if not (folder / "findings.npz").exists():
        warn(f"{folder} holds no findings.npz: the motion of its log is unknown")
        return ["LOG.csv"], None
    data = read_report_data(folder)
    samples, parts = data.samples, [part.source for part in data.summary.logs] or [data.summary.log]
    ddq = np.gradient(samples.velocity, samples.t, axis=0)
    return parts, Motion(samples.t, samples.position, samples.velocity, ddq)


def _hypotheses(folder: Path) -> Hypotheses:
    """Equivalent hypotheses and changes that a discrepancy found; none of an identification."""
    path = folder / "discrepancy.json"
    if not path.exists():
        return Hypotheses()
    found = read_json(path, _Discrepancy, "give a folder that `bayesid discrepancy` wrote").found
    changed = {
        (added.effect, added.joints): {
            name.removeprefix(CHANGE_OF): float(quantity["value"]) for name, quantity in added.parameters.items()
        }
        for added in found
        if added.change_of_what_was_there
    }
    return Hypotheses(
        equivalent_classes([(added.effect, added.joints, _equivalents(added)) for added in found]), changed
    )


def _equivalents(found: _Found) -> dict[str, tuple[int, ...] | None]:
    """Effects that are equivalent to one, with their joints if the file has them."""
    places = {other.effect: other.joints for other in reversed(found.alternatives)}
    return {name: places.get(name) for name in found.equivalent}


def _robot_with_shapes(options: argparse.Namespace, identified: IdentifiedModel) -> Robot:
    """The robot with limits and shapes: of --robot if given, else of the result."""
    if options.robot is None:
        return identified.model.robot
    robot = robot_of(options)
    if not robot.same_kinematics(identified.model.robot):
        seen = f"is another robot than that of {options.result} ({identified.model.robot.name})"
        raise InputError(seen, options.robot, "give the result's robot, or leave it out")
    return robot


def _limits(options: argparse.Namespace, robot: Robot) -> MotionLimits | None:
    urdf = _urdf(robot)
    source = options.limits or urdf
    return None if source is None else read_limits(source, robot, urdf)


def _urdf(robot: Robot) -> Path | None:
    return None if robot.origin is None else robot.origin.urdf


def _clearance(options: argparse.Namespace, robot: Robot, poses: Array) -> CollisionModel | NoShapes:
    radii, tool = numbers(options.capsules, "--capsules"), numbers(options.tool, "--tool")
    if tool is not None and radii is None:
        raise InputError("needs --capsules", "--tool", "give --capsules too")
    if radii is not None and options.meshes:
        raise InputError("are not used with --capsules", "--meshes", "give one of them")
    capsules = None
    if radii is not None:
        capsules = Capsules(radii[0] if len(radii) == 1 else radii, (0.0, 0.0, 0.0) if tool is None else tool)
    if radii is None and (robot.origin is None or robot.origin.urdf is None):
        for name in ("--floor", "--margin", "--meshes"):
            if name in options.given:
                remedy = "give --capsules R, or --robot with a URDF that has collision shapes"
                raise InputError("has no effect: the shapes of the links are unknown", name, remedy)
    return collision_model(robot, poses, capsules, _height(options.floor), options.margin, options.meshes)


def _height(text: str) -> float | None:
    heights = (
        None if text == "none" else numbers(text, "--floor", "give the height over the base's origin in m, or none")
    )
    return None if heights is None else heights[0]


def _poses(options: argparse.Namespace, robot: Robot, recorded: Motion | None) -> Array:
    """(M, n) poses that the robot has reached."""
    start = numbers(options.start, "--start")
    parts = [] if start is None or len(start) != robot.n_joints else [np.array([start])]
    if recorded is not None:
        parts.append(recorded.q[:: max(1, len(recorded) // TUNING.poses)])
    return np.concatenate(parts) if parts else np.zeros((1, robot.n_joints))


def _words(text: str | None, option: str) -> tuple[str, ...]:
    words = () if text is None else tuple(word.strip() for word in text.split(",") if word.strip())
    if text is not None and not words:
        raise InputError("is empty", option, "give names separated by commas, or leave it out")
    return words
