"""Bounded reading of text from outside: size, depth and digits are checked first.

Any bytes raise `InputError` or nothing. Files written by bayesid are read without these bounds.
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
"""Largest text file, 8 MiB: parsing TOML of this size takes 20 s."""
MOST_UNPACKED = 1 << 30
"""Largest unpacked size of a compressed or binary file, 1 GiB: a million rows of 20 joints with velocities have 0.5."""
DEEPEST = 32  # nesting of tables, lists or elements; URDFs have 6 levels at most
MOST_DIGITS = 18  # of a whole number in a name or an option, for 64 bits
LARGEST = 1e6
"""Largest number in a robot file, in SI units: above any robot's size, speed, effort or gear ratio."""


def read_source(path: str | Path, remedy: str, where: str = "") -> str:
    """The text of a file or a pipe in UTF-8, with or without a byte order mark; InputError if invalid or too long."""
    where = where or printable(str(path))
    try:
        with Path(path).open("rb") as file:
            content = file.read(MOST_BYTES + 1)
        if len(content) > MOST_BYTES:
            raise InputError(f"is longer than {MOST_BYTES >> 20} MiB", where, remedy)
        return content.decode("utf-8-sig")
    except InputError:
        raise
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read ({_reason(error)})", where, remedy) from None


def toml_of(text: str, where: str, remedy: str) -> dict[str, Any]:
    """The content of a TOML text; InputError if it is invalid or nested too deeply."""
    deep = InputError(f"has more than {DEEPEST} levels of tables or lists", where, remedy)
    names = re.split(r"[=,\n]", text)  # parsing time grows with the square of the dots in a name
    if max(name.count(".") for name in names) > 2 * DEEPEST:
        raise deep
    try:
        table = tomllib.loads(text)
        if _depth(table) <= DEEPEST + 1:
            return table
    except RecursionError:
        pass
    except ValueError as error:
        raise InputError(f"is not valid TOML ({_reason(error)})", where, remedy) from None
    raise deep


def xml_of(text: str, where: str) -> ET.Element:
    """The root of an XML text; InputError if nested too deeply, ParseError if invalid."""
    try:
        return ET.fromstring(text, ET.XMLParser(target=_Shallow(where)))
    except (ValueError, LookupError) as error:  # unknown encoding
        if isinstance(error, InputError):
            raise
        raise ET.ParseError(_reason(error)) from None


class _Shallow(ET.TreeBuilder):
    def __init__(self, where: str) -> None:
        super().__init__()
        self._where, self._depth = where, 0

    def start(self, tag: str, attrs: dict[str, str], /) -> ET.Element:
        self._depth += 1
        if self._depth > DEEPEST:
            raise InputError(f"has more than {DEEPEST} levels of elements", self._where, "give a URDF")
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> ET.Element:
        self._depth -= 1
        return super().end(tag)


def _depth(content: Any) -> int:
    inner = content.values() if isinstance(content, dict) else content if isinstance(content, list) else None
    return 0 if inner is None else 1 + max(map(_depth, inner), default=0)


def _reason(error: Exception) -> str:
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error) or type(error).__name__
    return printable(" ".join(text.split()))[:200]  # it may contain the file


def whole_number(text: str) -> int | None:
    """The number in a word of at most `MOST_DIGITS` digits 0 to 9; else None."""
    digits = text.isascii() and text.isdecimal() and len(text) <= MOST_DIGITS
    return int(text) if digits else None


def check_name(path: str | Path) -> Path:
    """The path, whether it exists or not; InputError if the system does not allow such a name."""
    try:
        os.stat(path)
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        pass
    except (OSError, ValueError) as error:
        seen = f"cannot be a file name ({_reason(error)})"
        raise InputError(seen, printable(str(path))[:200], "give another path") from None
    return Path(path)
