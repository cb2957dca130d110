"""Robots that come with bayesid: each is a Denavit-Hartenberg file in the folder robots/, its name the file's.

The files hold what `bayesid.robot.robot_from_table` reads, and three keys more: `description` (maker and
models), `source` (where the numbers are published) and `notes` (what the positions count, where the last frame sits).
"""

from __future__ import annotations

import tomllib
from importlib import resources
from typing import Any

_FOLDER = resources.files("bayesid.robot") / "robots"
BUILT_IN = tuple(sorted(file.name.removesuffix(".toml") for file in _FOLDER.iterdir() if file.name.endswith(".toml")))
"""Names of all of them."""


def built_in_text(name: str) -> str:
    """The file of a built-in robot."""
    return (_FOLDER / f"{name}.toml").read_text(encoding="utf-8")


def built_in_table(name: str) -> dict[str, Any]:
    """What the file of a built-in robot holds.

    >>> built_in_table("kr6r900")["description"]
    'KUKA KR 6 R900 sixx, KR 10 R900 sixx'
    """
    return tomllib.loads(built_in_text(name))
