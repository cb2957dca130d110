"""Options that a bayesid.toml gives to a command: one that a user wrote, or that of a result folder."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayesid.files.config import CONFIG, read_config


@dataclass(frozen=True)
class Config:
    """Options of a file."""

    path: Path
    words: Mapping[str, Sequence[str]]  #: of the command line, by the long option
    replaced: Sequence[str]  #: options that the command line overrides

    @property
    def summary(self) -> str:
        """The options taken from the file."""
        words = [word for words in self.words.values() for word in words]
        return f"options of {self.path}: {shlex.join(words) or 'none'}"

    @property
    def contradiction(self) -> str:
        """The options that the command line overrides; empty if none."""
        return f"the command line overrides {', '.join(self.replaced)} of {self.path}" if self.replaced else ""


def find_config(
    typed: argparse.Namespace, given: Collection[str], actions: Mapping[str, argparse.Action]
) -> Config | None:
    """The options of the --config file or result folder, or of the working folder's file; None without one.

    Args:
        typed: options of the command line.
        given: the long options among its words.
        actions: the command's actions, by option.

    Raises:
        InputError: the file cannot be used.
    """
    path = typed.config or Path(CONFIG)
    path = path / CONFIG if path.is_dir() else path
    result = getattr(typed, "result", None)
    if (result is not None and (result / "model.toml").exists()) or not (typed.config or path.is_file()):
        return None
    words, replaced = dict[str, list[str]](), list[str]()
    for key, value in read_config(path).items():
        action = actions.get(f"--{key}")
        stated = [] if action is None else _words(f"--{key}", value, action, path.parent)
        if action is None or not stated:
            continue
        if not set(action.option_strings) & set(given):
            words[f"--{key}"] = stated
        elif not _same(stated, getattr(typed, action.dest), action, given):
            replaced.append(f"--{key}")
    return Config(path, words, replaced)


def _words(name: str, value: Any, action: argparse.Action, folder: Path) -> list[str]:
    """An option and its value; relative paths are relative to the folder."""
    if isinstance(value, bool):
        off = name.replace("--", "--no-", 1)
        return [name] if value else [off] if off in action.option_strings else []
    if isinstance(action.default, list):  # an option that may be repeated
        values = value if isinstance(value, list) else [value]
        return [f"{name}={_placed(str(value), folder, action)}" for value in values]
    if isinstance(value, dict):
        value = [f"{key}={one}" for key, one in value.items()]
    text = ",".join(map(str, value)) if isinstance(value, list) else str(value)
    return [f"{name}={_placed(text, folder, action)}"]


def _placed(text: str, folder: Path, action: argparse.Action) -> str:
    """A path relative to the working folder; other text unchanged."""
    what, at, file = text.rpartition("@")  # of a payload
    place = folder / file
    return f"{what}{at}{place}" if action.type is Path or at or place.is_file() else text


def _same(words: Sequence[str], typed: object, action: argparse.Action, given: Collection[str]) -> bool:
    if action.nargs == 0:
        return words[0] in given
    texts = [word.partition("=")[2] for word in words]
    try:
        values = [action.type(text) if callable(action.type) else text for text in texts]
    except (ValueError, argparse.ArgumentTypeError):
        return False
    return (values if isinstance(typed, list) else values[0]) == typed
