"""Robots by a name or from a file."""

from __future__ import annotations

import tomllib
from importlib import resources
from pathlib import Path

from bayesid.errors import InputError
from bayesid.model.robot.arm import Robot
from bayesid.model.robot.dh_table import robot_from_table
from bayesid.model.robot.urdf import robot_from_urdf

BUILT_IN = ("kr5", "ur10e", "panda", "tx40")


def load_robot(source: str | Path) -> Robot:
    """A robot from a built-in name, a DH file (.toml) or a URDF file (.urdf, .xml).

    Raises:
        InputError: no such robot, or the file cannot be read as one.
    """
    if str(source) in BUILT_IN:
        text = (resources.files("bayesid.model") / "robots" / f"{source}.toml").read_text()
        return robot_from_table(tomllib.loads(text), f"built-in robot {source}")
    path = Path(source)
    if not path.is_file():
        remedy = f"give one of {', '.join(BUILT_IN)}, a DH file (.toml) or a URDF file"
        raise InputError("no such robot", str(source), remedy)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read ({error})", str(path), "give a text file in TOML or URDF") from None
    if path.suffix == ".toml":
        try:
            return robot_from_table(tomllib.loads(text), str(path))
        except tomllib.TOMLDecodeError as error:
            raise InputError(f"is not valid TOML ({error})", str(path), "correct the file") from None
    return robot_from_urdf(text, str(path))
