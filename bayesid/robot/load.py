"""Robots by a name or from a file."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path

from bayesid.errors import InputError
from bayesid.files.bounded import read_source, toml_of
from bayesid.robot.arm import Origin, Robot
from bayesid.robot.built_in import BUILT_IN, built_in_text
from bayesid.robot.dh_table import robot_from_table
from bayesid.robot.installed import how_to_name, installed_names, installed_urdf
from bayesid.robot.urdf import robot_from_urdf

_NEAR = 0.8
"""Likeness from which on a name is proposed: a letter of five; less, and `_description` makes all names alike."""


def load_robot(source: str | Path, tip: str | None = None, hold: Mapping[str, float] | None = None) -> Robot:
    """A robot from a built-in name, a DH file (.toml), a URDF file, or the name of a robot of an installed package.

    Args:
        source: name or file. Names of example-robot-data and of robot_descriptions are known where these are installed.
        tip: of a URDF: link or joint at the end of the chain that is identified; all others are held. By default all
            chains are identified, but not grippers.
        hold: of a URDF: positions at which more joints are held, rad or m, by name.

    Returns:
        The robot; its `notes` say which joints are held, and whether its base is only taken as fixed.

    Raises:
        InputError: no such robot, the file cannot be read as one, or it has no such link or joint.

    Example:
        >>> bayesid.load_robot("ur10e").n_joints, bayesid.load_robot("robot.toml").name
        (6, 'arm')
    """
    chosen = Origin(str(source), tip=tip, hold=dict(hold or {}))
    if str(source) in BUILT_IN:
        return _from_table(built_in_text(str(source)), f"built-in robot {source}", chosen)
    path = Path(source) if os.path.isfile(source) else installed_urdf(str(source))
    if path is None:
        raise _unknown(str(source))
    text = read_source(path, "give a text file in TOML or URDF")
    if path.suffix == ".toml":
        return _from_table(text, str(path), chosen)
    return _loaded(robot_from_urdf(text, str(path), tip, hold), replace(chosen, urdf=path))


def _from_table(text: str, where: str, chosen: Origin) -> Robot:
    for name, value in (("tip", chosen.tip), ("hold", chosen.hold)):
        if value:
            raise InputError("is a table of one chain, whose joints are all identified", where, f"leave `{name}` out")
    return _loaded(robot_from_table(toml_of(text, where, "correct the file"), where), chosen)


def _loaded(robot: Robot, origin: Origin) -> Robot:
    """The robot with its origin, which no copy that is changed shall have."""
    object.__setattr__(robot, "origin", origin)
    return robot


def _unknown(name: str) -> InputError:
    files = "a DH file (.toml) or a URDF file"
    if Path(name).suffix or len(Path(name).parts) > 1:
        return InputError("no such file", name, f"give {files}, or a built-in name (`bayesid robot list`)")
    known = list(dict.fromkeys([*BUILT_IN, *installed_names()]))
    plain = re.sub(r"[\s-]+", "", name.lower())
    nearest = get_close_matches(plain, known, n=3, cutoff=_NEAR) or [other for other in known if plain in other][:3]
    suggestion = f", did you mean {' or '.join(nearest)}?" if nearest else ""
    remedy = f"give a built-in name (`bayesid robot list`), {files}, or {how_to_name()}"
    return InputError(f"no such robot{suggestion}", name, remedy)
