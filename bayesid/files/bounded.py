"""Text from outside, read within bounds: its size, depth and digits are checked before anything else looks at it.

What passes here raises `InputError` and nothing else, whatever the bytes are. Files that bayesid itself wrote are read
without these bounds.
"""

from __future__ import annotations

import os
import re
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

from bayesid.errors import InputError, printable

MOST_BYTES = 1 << 23
"""Of a text that is read as a whole: 8 MiB, for which the parser of TOML takes 20 s. The longest of ours has 2."""
MOST_UNPACKED = 1 << 30
"""Bytes that a compressed or binary file may unpack to, 1 GiB: a million rows of 20 joints with velocities have 0.5."""
DEEPEST = 32  # tables in tables, lists in lists or elements in elements; ours and those of URDFs have 6 at most
MOST_DIGITS = 18  # of a whole number in a name or an option: 64 bits hold it
LARGEST = 1e6
"""Size of a number that a robot's file may hold, in SI units: no robot is so large, fast, strong or geared."""


def read_source(path: str | Path, remedy: str, where: str = "") -> str:
    """The text of a file or a pipe in UTF-8, with or without a mark of it; InputError where it is none, or too long."""
    where = where or printable(str(path))
    try:
        with Path(path).open("rb") as file:
            content = file.read(MOST_BYTES + 1)
        if len(content) > MOST_BYTES:
            raise InputError(f"is longer than {MOST_BYTES >> 20} MiB", where, remedy)
        return content.decode("utf-8-sig")
    except InputError:
        raise
    except (OSError, ValueError) as error:  # no name of a file, for one
        raise InputError(f"cannot be read ({_said(error)})", where, remedy) from None


def toml_of(text: str, where: str, remedy: str) -> dict[str, Any]:
    """What a text in TOML holds; InputError if it is none, too deep, or has a number with too many digits."""
    deep = InputError(f"has tables or lists in more than {DEEPEST} others", where, remedy)
    names = re.split(r"[=,\n]", text)  # the parser's time grows with the square of the dots of one
    if max(name.count(".") for name in names) > 2 * DEEPEST:
        raise deep
    try:
        table = tomllib.loads(text)
        if _depth(table) <= DEEPEST + 1:
            return table
    except RecursionError:
        pass
    except ValueError as error:
        raise InputError(f"is not valid TOML ({_said(error)})", where, remedy) from None
    raise deep


def xml_of(text: str, where: str) -> ET.Element:
    """The root of a text in XML; InputError if it is too deep, ParseError if it is none."""
    try:
        return ET.fromstring(text, ET.XMLParser(target=_Shallow(where)))
    except (ValueError, LookupError) as error:  # of the encoding that it names
        if isinstance(error, InputError):
            raise
        raise ET.ParseError(_said(error)) from None


class _Shallow(ET.TreeBuilder):
    def __init__(self, where: str) -> None:
        super().__init__()
        self._where, self._depth = where, 0

    def start(self, tag: str, attrs: dict[str, str], /) -> ET.Element:
        self._depth += 1
        if self._depth > DEEPEST:
            raise InputError(f"has elements in more than {DEEPEST} others", self._where, "give a URDF")
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> ET.Element:
        self._depth -= 1
        return super().end(tag)


def _depth(content: Any) -> int:
    inner = content.values() if isinstance(content, dict) else content if isinstance(content, list) else None
    return 0 if inner is None else 1 + max(map(_depth, inner), default=0)


def _said(error: Exception) -> str:
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error) or type(error).__name__
    return printable(" ".join(text.split()))[:200]  # it may repeat the file


def whole_number(text: str) -> int | None:
    """The whole number of a word of digits 0 to 9; None of all else, and of more digits than `MOST_DIGITS`."""
    digits = text.isascii() and text.isdecimal() and len(text) <= MOST_DIGITS
    return int(text) if digits else None


def check_name(path: str | Path) -> Path:
    """The path itself, if a system can have such a file, whether it is there or not; else an InputError."""
    try:
        os.stat(path)
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        pass
    except (OSError, ValueError) as error:
        said = f"cannot be the name of a file ({_said(error)})"
        raise InputError(said, printable(str(path))[:200], "give another path") from None
    return Path(path)
