"""Recordings that can be read once only: pipes, as in `<(zcat log.csv.gz)`, and what comes on standard input (`-`)."""

from __future__ import annotations

import os
import stat
import sys
import tempfile
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

from bayesid.errors import InputError
from bayesid.log.formats.table import Table, rows_of

STANDARD_INPUT = "-"
"""What stands for it in place of a path."""
_MOST = 1 << 32
"""Bytes of a stream that are kept, 4 GiB: more than a day of seven joints at 500 Hz has in text."""
_CHUNK = 1 << 20


def is_stream(path: Path) -> bool:
    """Whether a path is a pipe or stands for standard input.

    Raises:
        InputError: it is a device, which may never end.
    """
    if os.path.lexists(path):
        kind = os.stat(path).st_mode
        if stat.S_ISCHR(kind) or stat.S_ISBLK(kind) or stat.S_ISSOCK(kind):
            raise InputError("is a device, no file", str(path), "give the path of a log, or - for standard input")
        return stat.S_ISFIFO(kind)
    return str(path) == STANDARD_INPUT


def read_stream(path: Path, read: Callable[[Path], Table]) -> Table:
    """What a stream holds, kept as a file for as long as it is read; messages call it by its own name.

    Raises:
        InputError: it is longer than any log, or cannot be used.
        OSError: it cannot be read.
    """
    name = "standard input" if str(path) == STANDARD_INPUT else str(path)
    with tempfile.TemporaryDirectory(prefix="bayesid-") as folder:
        copy = Path(folder) / "stream"
        with nullcontext(sys.stdin.buffer) if str(path) == STANDARD_INPUT else path.open("rb") as stream:
            _keep(stream, copy, name)
        try:
            table = read(copy)
        except InputError as error:
            said = (text.replace(str(copy), name) for text in (error.what, error.where, error.remedy))
            raise InputError(*said, error.field) from None
    notes = tuple(note.replace(str(copy), name) for note in table.notes)
    return replace(table, source=name, place=rows_of(name), notes=notes)


def _keep(stream: BinaryIO, copy: Path, name: str) -> None:
    size = 0
    with copy.open("wb") as file:
        while chunk := stream.read(_CHUNK):
            size += len(chunk)
            if size > _MOST:
                raise InputError(f"is longer than {_MOST >> 30} GiB", name, "give shorter logs, one after the other")
            file.write(chunk)
