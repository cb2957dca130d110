"""`bayesid robot`: makes, shows and lists robot files."""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import RenderableType

from bayesid.arrays import Array
from bayesid.cli.options import check_file, finish, numbers, robot_of
from bayesid.cli.terminal import show, table
from bayesid.errors import InputError
from bayesid.export.robot_file import robot_file, robot_template
from bayesid.files.bounded import MOST_BYTES
from bayesid.files.writing import replace_file
from bayesid.log.formats.text import layout_of
from bayesid.log.tuning import TUNING
from bayesid.report.plot.robots import positions_text, skeleton_figure
from bayesid.robot import Robot
from bayesid.robot.kinematics import Pose, pose, reach
from bayesid.robot.load import BUILT_IN, built_in_table, is_built_in

_PICTURES = ".png", ".svg", ".pdf"


def robot_command(options: argparse.Namespace) -> None:
    """Makes, shows or lists robot files."""
    {"new": _new, "show": _show, "list": _list}[options.action](options)


def _new(options: argparse.Namespace) -> None:
    out: Path = options.out
    check_file(options, out)
    if out.suffix != ".toml":
        raise InputError("does not end in .toml", str(out), "give --out FILE.toml")
    name = options.name or out.stem
    fill = ""
    if options.table is None:
        text, fill = robot_template(name, str(out), options.convention or "standard"), "fill it in, then "
    else:
        if options.convention is None:
            remedy = "give standard or modified; see docs/how-to/data-sheet-robot.md"
            raise InputError("is needed with a table", "--convention", remedy)
        table_text, where = _table_of(options.table)
        text = robot_file(table_text, name, options.convention, where)
    replace_file(out, lambda aside: aside.write_text(text, encoding="utf-8"))
    finish(options, last=f"written to {out}; {fill}check it: bayesid robot show {out}")


def _table_of(source: str) -> tuple[str, str]:
    if "\n" in source or "\\n" in source:
        return source.replace("\\n", "\n"), "the table"
    try:
        with nullcontext(sys.stdin.buffer) if source == "-" else Path(source).open("rb") as file:
            content = file.read(MOST_BYTES)
        return content.decode(layout_of(content).encoding), "standard input" if source == "-" else source
    except (OSError, ValueError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not text"
        raise InputError(f"cannot be read ({reason})", source, "give a table as a text file, - or the text") from None


def _show(options: argparse.Namespace) -> None:
    out: Path | None = options.out
    if out is not None:
        check_file(options, out)
        if out.suffix.lower() not in _PICTURES:
            raise InputError("is not a picture", str(out), f"give a name that ends in {', '.join(_PICTURES)}")
    robot = robot_of(options, notes=True)
    here = pose(robot, None if options.q is None else _positions(options.q, options.degrees, robot))
    if out is not None:
        figure = skeleton_figure(robot, here.q)
        kind = out.suffix[1:].lower()
        replace_file(out, lambda aside: figure.savefig(aside, format=kind, dpi=150, facecolor="white"))
    about = built_in_table(options.robot) if is_built_in(options.robot) else {}
    finish(options, *_pose_parts(here, about), last="" if out is None else f"written to {out}")


def _pose_parts(here: Pose, about: Mapping[str, Any]) -> list[RenderableType]:
    robot, n = here.robot, here.robot.n_joints
    points = 1e3 * np.vstack([here.joint_frames[:, :3, 3], here.flange[:3, 3]]).round(9) + 0.0
    names = [*(f"joint {i} {joint.name}".rstrip() for i, joint in enumerate(robot.joints, start=1)), "flange"]
    rows = [(name, *(f"{x:.1f}" for x in at)) for name, at in zip(names, points, strict=True)]
    wrist = f", to the origin of joint {n - 1} {1e3 * reach(robot, n - 1):.1f} mm" if n > 2 else ""
    held = ", sliding joints at 0" if any(joint.prismatic for joint in robot.joints) else ""
    return [
        f"{robot.name}{': ' + about['description'] if about else ''}, {n} joints",
        f"q = {positions_text(here)}",
        table(["origin of", "x, mm", "y, mm", "z, mm"], rows, left=["origin of"]),
        f"gravity in the base frame: {', '.join(f'{g:g}' for g in robot.gravity)} m/s^2",
        f"reach from axis 1: to the flange {1e3 * reach(robot):.1f} mm{wrist}, stretched, without joint limits{held}",
        *(f"note: {note}" for note in about.get("notes", [])),
        *([f"source: {about['source']}"] if about else []),
    ]


def _positions(text: str, degrees: bool | None, robot: Robot) -> Array:
    values = np.array(numbers(text, "--q", "give Q1,Q2,.. as in 0,-1.57,1.57"))
    if len(values) != robot.n_joints:
        message = f"holds {len(values)} positions, {robot.name} has {robot.n_joints} joints"
        raise InputError(message, "--q", "give one number per joint")
    turning = np.array([not joint.prismatic for joint in robot.joints])
    if degrees is None and np.any(np.abs(values[turning]) > TUNING.few_turns):
        message = f"{text!r} looks like degrees"
        raise InputError(message, "--q", "give --degrees, or --no-degrees if they are in rad")
    return np.where(turning & bool(degrees), np.radians(values), values)


def _list(_options: argparse.Namespace) -> None:
    tables = {name: built_in_table(name) for name in BUILT_IN}
    rows = [(name, str(len(entry["joints"])), entry["description"]) for name, entry in tables.items()]
    show(table(["name", "joints", "robot"], rows, left=["name", "robot"]), "source of a table: bayesid robot show NAME")
