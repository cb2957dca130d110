"""Recordings: files of many formats, each read into one table of a log's columns.

A reader a format, each in a file of this folder, turns a file into a `Table` and says what the file lacks; it is found
by what the file holds (see `bayesid.log.formats.base`). What a number must be is checked here, once for all of them;
what the numbers mean for an identification is `bayesid.log.log`'s business.
"""

from __future__ import annotations

import os
from dataclasses import fields, replace
from glob import glob
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from bayesid.errors import InputError
from bayesid.files.bounded import check_name
from bayesid.log.formats.base import Format, Options
from bayesid.log.formats.parts import JOINT, join_parts
from bayesid.log.formats.streams import is_stream, read_stream
from bayesid.log.formats.table import Column, Table, check

__all__ = ["Column", "Format", "Options", "Table", "is_log_folder", "known_formats", "read_table"]

_HEAD = 65536
"""Bytes of a file by which it is recognised: more than any header is long."""


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
            return read_stream(path, lambda copy: _read_file(copy, options))
        return _read_file(path, options)
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
        raise InputError("no such file", str(path), "give the path of a log") from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", str(path), "check the file") from None


def _read_file(path: Path, options: Options) -> Table:
    """What a file or a folder holds, that can be read more than once."""
    head = b"" if path.is_dir() else _head(path)
    reader = next(known for known in known_formats() if known.recognises(path, head))
    _check_options(path, reader, options)
    return check(reader.read(path, options), options.columns)


def _parts_of(path: Path) -> list[Path]:
    """The files of one run that a name with a `+` stands for; none where it is the name of a file, or has none."""
    if JOINT not in str(path) or os.path.exists(path):
        return []
    names = [name.strip() for name in str(path).split(JOINT) if name.strip()]
    return [Path(one) for name in names for one in (sorted(glob(name)) or [name])]


def is_log_folder(path: Path) -> bool:
    """Whether a folder is one recording, as a ROS 2 bag is."""
    return any(known.is_folder(path) for known in known_formats())


def _check_options(path: Path, reader: Format, options: Options) -> None:
    for field in fields(options):
        if getattr(options, field.name) not in (None, False) and field.name not in {
            *reader.options,
            "currents",
            "motion",
            "part",
        }:
            raise InputError(f"is {reader.name}, which has no {field.name}", str(path), f"leave `{field.name}` out")


def _head(path: Path) -> bytes:
    """The first bytes of a file."""
    with path.open("rb") as file:
        return file.read(_HEAD)
