"""bayesid.toml: options for all logs of a robot, by the long names of the command line."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayesid.errors import InputError, near_names, printable
from bayesid.files.bounded import read_source, toml_of

CONFIG = "bayesid.toml"
OF_READING = ("columns", "correct", "degrees", "encoding", "gains", "joints", "topic", "unsigned")
"""Options of `bayesid.read_log`."""
OF_MODEL = (
    *("robot", "tip", "hold", "gravity", "terms", "complete", "constraints", "nominal", "links"),
    *("kinematic-tolerance", "cutoff"),
)
"""Options of a robot and its model."""
OF_RUN = (
    *("payload", "search", "search-budget", "beam-width", "initial-segments", "no-posterior", "posterior-budget"),
    *("time-limit", "seed", "mode", "max-memory", "workers", "scheduler", "each", "anyway", "no-report", "strict"),
    "quiet",
)
"""Other options of `bayesid identify`."""
_ON_THE_COMMAND_LINE = ("config", "out", "force")
_REMEDY = "give long options without dashes, as in robot = 'ur10e'"


def read_config(path: Path) -> dict[str, Any]:
    """The options of a file.

    Raises:
        InputError: it cannot be read, or is invalid.
    """
    where, known = printable(str(path)), (*OF_READING, *OF_MODEL, *OF_RUN)
    table = toml_of(read_source(path, _REMEDY), where, _REMEDY)
    for key, value in table.items():
        if key not in known:
            if key in _ON_THE_COMMAND_LINE:
                raise InputError(f"{key} is not allowed in this file", where, f"give --{key} on the command line")
            near = near_names(key, known)
            raise InputError(f"unknown key {key!r:.60}", where, f"{near} {_REMEDY}".strip())
        items = list(value.values()) if isinstance(value, dict) else value if isinstance(value, list) else [value]
        if not all(isinstance(item, str | bool | int | float) for item in items):
            raise InputError(f"{key} is not a text, number or list", where, _REMEDY)
    return table


def plain_config(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options for a file; paths of existing files become absolute, so that the file can be copied."""
    plain: dict[str, Any] = {}
    for name, value in options.items():
        found = isinstance(value, str | Path) and Path(value).is_file()
        plain[name] = str(Path(value).resolve()) if found else list(value) if isinstance(value, tuple) else value
    return plain
