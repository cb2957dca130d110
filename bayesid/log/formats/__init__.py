"""Recording formats: each file is read into one table of a log's columns.

Each format is a subclass of `Format` in a file of this folder. It is found by the file's content, and turns the file
into a `Table`. Checks common to all formats are here; `bayesid.log.reading` interprets the numbers.
"""

from __future__ import annotations

import os
import re
import stat
import sys
import tempfile
from abc import ABC, abstractmethod
from contextlib import nullcontext
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import ClassVar

from bayesid.errors import InputError
from bayesid.files.bounded import check_name
from bayesid.log.formats.encodings import decode
from bayesid.log.formats.gaps import without_gaps
from bayesid.log.formats.labels import kind_part
from bayesid.log.formats.table import Column, Options, Table, check, rows_of, with_fractions
from bayesid.log.tuning import TUNING

__all__ = ["Column", "Format", "Options", "Table", "is_log_folder", "is_stream", "known_formats", "read_table"]

STANDARD_INPUT = "-"
_UNPACK = "unpack it and give the log inside"
_TABLE = "write its columns as CSV, or give it from Python: bayesid.read_log(pandas.{}(FILE{}))"
_ARRAYS = "bayesid.read_log({'t': .., 'q': .., 'tau': ..})"
_SHEET = "save the sheet with the log as CSV"
_FOREIGN = (
    (rb"\s*\{[^\n]*\}\s*\n\s*\{", "lines of JSON", _TABLE.format("read_json", ", lines=True")),
    (rb"\s*(\{\s*[\"}]|\[\s*[\[{\"\d-])", "JSON", _TABLE.format("read_json", "")),
    (rb"\s*<(!doctype html|html|head|body)", "a web page (HTML), not a table of numbers", "save the table as CSV"),
    (rb"\s*<(?!(\?xml[^>]*>\s*<)?Rob\b)[!?a-z]", "XML", _TABLE.format("read_xml", "")),
    (rb"PK.{2,8192}(xl/|\[Content_Types\]\.xml)", "an Excel workbook", _SHEET),
    (rb"PK.{2,8192}content\.xml", "an OpenDocument spreadsheet", _SHEET),
    (rb"\xd0\xcf\x11\xe0", "an old Excel workbook", _SHEET),
    (rb"PK.{2,8192}\.npy", "an archive of NumPy", "give it from Python: bayesid.read_log(dict(numpy.load(FILE)))"),
    (rb"\x93NUMPY", "an array of NumPy", f"give it from Python, with names: {_ARRAYS}"),
    (rb"PK\x03\x04", "a zip archive", _UNPACK),
    (rb"\x1f\x8b|BZh\d|\xfd7zXZ|\x28\xb5\x2f\xfd|7z\xbc\xaf", "compressed", _UNPACK),
    (rb"#ROSBAG V", "a bag of ROS 1", "convert it: rosbags-convert --src FILE --dst FOLDER"),
    (rb"\x89HDF", "an HDF5 file, but not from MATLAB", f"give its arrays from Python: {_ARRAYS}"),
    (
        rb"DIAEXTENDED",
        "a header of DIAdem, as KUKA's trace writes it beside its .r64",
        "export the trace as text (WorkVisual); one file per joint is given as 'trace_*.csv+'",
    ),
    (rb"TDSm|MDF {5}|UnFinMF", "a measurement file (TDMS or MDF)", "export its channels as CSV"),
    (rb"%PDF|\x89PNG|\xff\xd8\xff", "a document or an image", "give the log as a table"),
)  # first bytes of unsupported files, what they are, and what to do


class Format(ABC):
    """A format of recordings."""

    name: ClassVar[str]  #: name in messages, as in "is a MATLAB file"
    magic: ClassVar[tuple[bytes, ...]] = ()  #: first bytes of its files
    extensions: ClassVar[tuple[str, ...]] = ()  #: file extensions, as in ".mat", used if the first bytes do not decide
    options: ClassVar[frozenset[str]] = frozenset()  #: which of `topic`, `joints` and `columns` apply
    #: order in which formats are tried: 0 if recognised by content, 1 by name, 2 for the format that accepts any file
    order: ClassVar[int] = 0

    def recognises(self, path: Path, head: bytes) -> bool:
        """Whether a file or folder with these first bytes (empty for a folder) has this format."""
        return head.startswith(self.magic) or path.suffix.lower() in self.extensions

    def check_options(self, options: Options, where: str) -> None:
        """InputError if a given option does not apply to this format."""
        for name in {"topic", "joints", "columns"} - self.options:
            no_velocities = name == "columns" and not options.velocities and len(options.columns or ()) == 1
            if getattr(options, name) is not None and not no_velocities:
                raise InputError(f"is {self.name}, which has no {name}", where, f"leave `{name}` out")

    def is_folder(self, path: Path) -> bool:
        """Whether a folder is one recording, so that its files are not logs."""
        return False

    @abstractmethod
    def read(self, path: Path, options: Options) -> Table:
        """The columns of a log; InputError if they are missing, damaged or ambiguous; OSError is passed on."""


def known_formats() -> list[Format]:
    """A reader of every format, in the order in which they are tried."""
    for module in iter_modules(__path__):
        import_module(f"{__name__}.{module.name}")
    return sorted((reader() for reader in Format.__subclasses__()), key=lambda reader: (reader.order, reader.name))


def read_table(path: Path, options: Options) -> Table:
    """The checked table of a file, or of a folder that is a recording; else an InputError."""
    try:
        return (_read_stream if is_stream(check_name(path)) else _read_file)(path, options)
    except IsADirectoryError:
        raise InputError("is a folder, but not a recording", str(path), "give the path of a log") from None
    except (FileNotFoundError, NotADirectoryError):
        raise InputError("no such file", str(path), "give the path of a log") from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", str(path), "check the file") from None


def _read_file(path: Path, options: Options) -> Table:
    head = b""
    if not path.is_dir():
        with path.open("rb") as file:
            head = file.read(65536)
    begin = head.removeprefix(b"\xef\xbb\xbf")  # byte order mark
    for begins, name, remedy in _FOREIGN if path.suffix.lower() != ".mat" else ():
        if re.match(begins, begin, re.DOTALL | re.IGNORECASE):
            raise InputError(f"is {name}", str(path), remedy)
    reader = next(known for known in known_formats() if known.recognises(path, head))
    reader.check_options(options, str(path))
    table = reader.read(path, options)
    if not options.velocities:
        kept = {name: column for name, column in table.columns.items() if kind_part(name) != "dq"}
        table = replace(table, columns=kept)
    table = without_gaps(with_fractions(table), options)
    return check(decode(table, options.encoding), options.columns)


def is_log_folder(path: Path) -> bool:
    """Whether a folder is one recording, as a ROS 2 bag is."""
    return any(known.is_folder(path) for known in known_formats())


def is_stream(path: Path) -> bool:
    """Whether a path is a pipe or standard input; InputError for another device, which may never end."""
    if os.path.lexists(path):
        kind = os.stat(path).st_mode
        if stat.S_ISCHR(kind) or stat.S_ISBLK(kind) or stat.S_ISSOCK(kind):
            raise InputError("is a device, not a file", str(path), "give the path of a log, or - for standard input")
        return stat.S_ISFIFO(kind)
    return str(path) == STANDARD_INPUT


def _read_stream(path: Path, options: Options) -> Table:
    """The table of a stream, stored in a temporary file; messages use the stream's name."""
    from_input = str(path) == STANDARD_INPUT
    name, size = "standard input" if from_input else str(path), 0
    with tempfile.TemporaryDirectory(prefix="bayesid-") as folder:
        copy = Path(folder) / "stream"
        with nullcontext(sys.stdin.buffer) if from_input else path.open("rb") as stream, copy.open("wb") as file:
            while chunk := stream.read(1 << 20):
                size += len(chunk)
                if size > TUNING.longest_stream:
                    what = f"is longer than {TUNING.longest_stream >> 30} GiB"
                    raise InputError(what, name, "give shorter logs, one at a time")
                file.write(chunk)
        try:
            table = _read_file(copy, options)
        except InputError as error:
            what, where, remedy = (text.replace(str(copy), name) for text in (error.what, error.where, error.remedy))
            raise InputError(what, where, remedy, error.field) from None
    notes, repairs = (tuple(text.replace(str(copy), name) for text in part) for part in (table.notes, table.repairs))
    return replace(table, source=name, place=rows_of(name), notes=notes, repairs=repairs)
