"""Recordings: files of many formats, each read into one table of a log's columns.

A reader a format, each in a file of this folder, turns a file into a `Table` and says what the file lacks; it is found
by what the file holds (see `bayesid.log.formats.base`). What a number must be is checked here, once for all of them;
what the numbers mean for an identification is `bayesid.log.reading`'s business.
"""

from __future__ import annotations

import os
import stat
import sys
import tempfile
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from glob import glob
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import BinaryIO

from bayesid.errors import InputError
from bayesid.files.bounded import check_name
from bayesid.log.formats.base import Format, Options, refuse_foreign
from bayesid.log.formats.parts import JOINT, join_parts
from bayesid.log.formats.table import Column, Table, check, rows_of
from bayesid.log.tuning import TUNING

__all__ = ["Column", "Format", "Options", "Table", "is_log_folder", "is_stream", "known_formats", "read_table"]

STANDARD_INPUT = "-"
"""What stands for it in place of a path."""


def known_formats() -> list[Format]:
    """A reader of every format, in the order in which they are asked."""
    for module in iter_modules(__path__):
        import_module(f"{__name__}.{module.name}")
    return sorted((reader() for reader in Format.__subclasses__()), key=lambda reader: (reader.order, reader.name))


def read_table(path: Path, options: Options) -> Table:
    """What a file, or a folder that is a recording, holds of a log, its numbers checked.

    Files of one run are joined: `path` is then their names with a `+` between them, each perhaps a pattern.

    Raises:
        InputError: there is no such file, or it cannot be used.
    """
    if parts := _parts_of(path):
        part = replace(options, part=True)
        tables = [read_table(one, part) for one in parts]
        return check(join_parts(tables, options.columns, motion=options.motion), options.columns)
    try:
        if is_stream(check_name(path)):
            return _read_stream(path, lambda copy: _read_file(copy, options))
        return _read_file(path, options)
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
        raise InputError("no such file", str(path), "give the path of a log") from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", str(path), "check the file") from None


def _read_file(path: Path, options: Options) -> Table:
    head = b""
    if not path.is_dir():
        with path.open("rb") as file:
            head = file.read(65536)
        if path.suffix.lower() != ".mat":
            refuse_foreign(path, head)
    reader = next(known for known in known_formats() if known.recognises(path, head))
    reader.check_options(options, str(path))
    return check(reader.read(path, options), options.columns)


def _parts_of(path: Path) -> list[Path]:
    """The files of one run that a name with a `+` stands for; none where it is the name of one file."""
    if JOINT not in str(path) or os.path.exists(path):
        return []
    names = [name.strip() for name in str(path).split(JOINT) if name.strip()]
    return [Path(one) for name in names for one in (sorted(glob(name)) or [name])]


def is_log_folder(path: Path) -> bool:
    """Whether a folder is one recording, as a ROS 2 bag is."""
    return any(known.is_folder(path) for known in known_formats())


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


def _read_stream(path: Path, read: Callable[[Path], Table]) -> Table:
    """What a stream holds, kept as a file for as long as it is read; messages call it by its own name."""
    name = "standard input" if str(path) == STANDARD_INPUT else str(path)
    with tempfile.TemporaryDirectory(prefix="bayesid-") as folder:
        copy = Path(folder) / "stream"
        with nullcontext(sys.stdin.buffer) if str(path) == STANDARD_INPUT else path.open("rb") as stream:
            _keep(stream, copy, name)
        try:
            table = read(copy)
        except InputError as error:
            what, where, remedy = (text.replace(str(copy), name) for text in (error.what, error.where, error.remedy))
            raise InputError(what, where, remedy, error.field) from None
    notes = tuple(note.replace(str(copy), name) for note in table.notes)
    return replace(table, source=name, place=rows_of(name), notes=notes)


def _keep(stream: BinaryIO, copy: Path, name: str) -> None:
    size = 0
    with copy.open("wb") as file:
        while chunk := stream.read(1 << 20):
            size += len(chunk)
            if size > TUNING.longest_stream:
                said = f"is longer than {TUNING.longest_stream >> 30} GiB"
                raise InputError(said, name, "give shorter logs, one after the other")
            file.write(chunk)
