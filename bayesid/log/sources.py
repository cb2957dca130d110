"""Sources of logs and motions: files, file patterns, parts of one run, and data in memory."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from glob import glob
from itertools import chain
from pathlib import Path
from typing import TypeAlias

import numpy as np

from bayesid.errors import InputError
from bayesid.log.formats import Options, Table, is_log_folder, read_table
from bayesid.log.formats.memory import Variables, read_variables
from bayesid.log.formats.parts import JOINT, join_parts
from bayesid.log.formats.table import check
from bayesid.robot import Robot

Parts: TypeAlias = tuple["str | Path | Variables", ...]
"""Files, or data in memory, of one run; they are joined by time."""


def table_of(source: str | Path | Variables | Parts, options: Options) -> Table:
    """The table of a file or of data in memory; parts of one run are joined by time."""
    parts = source if isinstance(source, tuple) and all(map(_is_part, source)) else _named_parts(source)
    if parts:
        tables = [table_of(part, replace(options, part=True)) for part in parts]
        return check(join_parts(tables, options.named, motion=options.motion), options.columns)
    if isinstance(source, str | Path):
        return read_table(Path(source), options)
    for name in ("topic", "joints"):
        if getattr(options, name) is not None:
            raise InputError(f"is data in memory, which has no {name}", type(source).__name__, f"leave {name} out")
    return read_variables(source, options)


def _named_parts(source: object) -> list[str]:
    """The file names, perhaps patterns, in a name with `+` between them."""
    if not isinstance(source, str | Path) or JOINT not in str(source) or os.path.exists(source):
        return []
    names = [name.strip() for name in str(source).split(JOINT) if name.strip()]
    return [path for name in names for path in (sorted(glob(name)) or [name])]


def _is_part(source: object) -> bool:
    named = isinstance(source, np.ndarray) and source.dtype.names is not None
    return named or isinstance(source, str | Path | Mapping) or (hasattr(source, "columns"))


def joint_names(robot: Robot) -> tuple[str, ...]:
    """Names of a robot's joints from base to tip; empty unless every joint has one."""
    names = tuple(joint.name for joint in robot.joints)
    return names if all(names) else ()


def find_logs(patterns: Sequence[str | Path]) -> list[Path]:
    """Log files of paths and patterns such as "runs/*.csv"; those of a pattern in alphabetical order.

    InputError if a pattern matches no file, or a log is given twice.
    """
    named: dict[str, Path] = {}
    for path in chain.from_iterable(map(_matches, patterns)):
        place = os.path.realpath(path)
        if place in named:
            what = "is given twice" if named[place] == path else f"is the same file as {named[place]}"
            raise InputError(what, str(path), "give every log once")
        named[place] = path
    return list(named.values())


def _matches(pattern: str | Path) -> list[Path]:
    """The path itself, existing or not, or the logs that match it; not the files inside a log folder."""
    if os.path.exists(pattern) or JOINT in str(pattern) or not set("*?[") & set(str(pattern)):
        return [Path(pattern)]
    matches = [Path(match) for match in sorted(glob(str(pattern), recursive=True))]
    logs = [path for path in matches if is_log_folder(path) or (path.is_file() and not is_log_folder(path.parent))]
    if not logs:
        raise InputError("matches no file", str(pattern), "give the path of a log, or a pattern of several")
    return logs
