"""What a format of recordings is, and what is none. A new one is a file in this folder with a subclass of `Format`."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from bayesid.errors import InputError
from bayesid.log.formats.table import Table

_UNPACK = "unpack it, and give the log inside"
_TABLE = "write its columns as CSV, or give it from Python: bayesid.read_log(pandas.{}(FILE{}))"
_SHEET = "save the sheet with the log as CSV"
_FOREIGN = (
    (rb"\s*\{[^\n]*\}\s*\n\s*\{", "lines of JSON", _TABLE.format("read_json", ", lines=True")),
    (rb"\s*(\{\s*[\"}]|\[\s*[\[{\"\d-])", "JSON", _TABLE.format("read_json", "")),
    (rb"\s*<(!doctype html|html|head|body)", "a web page (HTML), no table of numbers", "save the table as CSV"),
    (rb"\s*<[!?a-z]", "XML", _TABLE.format("read_xml", "")),
    (rb"PK.{2,8192}(xl/|\[Content_Types\]\.xml)", "an Excel workbook", _SHEET),
    (rb"PK.{2,8192}content\.xml", "an OpenDocument spreadsheet", _SHEET),
    (rb"\xd0\xcf\x11\xe0", "an old Excel workbook", _SHEET),
    (rb"PK.{2,8192}\.npy", "an archive of NumPy", "give it from Python: bayesid.read_log(dict(numpy.load(FILE)))"),
    (
        rb"\x93NUMPY",
        "an array of NumPy",
        "give it from Python, with names: bayesid.read_log({'t': .., 'q': .., 'tau': ..})",
    ),
    (rb"PK\x03\x04", "a zip archive", _UNPACK),
    (rb"\x1f\x8b|BZh\d|\xfd7zXZ|\x28\xb5\x2f\xfd|7z\xbc\xaf", "compressed", _UNPACK),
    (rb"#ROSBAG V", "a bag of ROS 1", "convert it: rosbags-convert --src FILE --dst FOLDER"),
    (
        rb"\x89HDF",
        "an HDF5 file, but none of MATLAB",
        "give its arrays from Python: bayesid.read_log({'t': .., 'q': .., 'tau': ..})",
    ),
    (
        rb"DIAEXTENDED",
        "a header of DIAdem, as KUKA's trace writes it beside its .r64",
        "export the trace as a table of text (WorkVisual); a file a joint is given as 'trace_*.csv+'",
    ),
    (rb"TDSm|MDF {5}|UnFinMF", "a measurement file (TDMS or MDF)", "export its channels as CSV"),
    (rb"%PDF|\x89PNG|\xff\xd8\xff", "a document or a picture", "give the log that it shows"),
)


@dataclass(frozen=True, kw_only=True)
class Options:
    """What a user may say about a file beside its path; None where nothing is said.

    Attributes:
        topic: the one to read, of several.
        joints: names from base to tip.
        currents: whether efforts without a unit are currents, A.
        columns: what the log's columns are called, see `bayesid.log.formats.stated`.
        motion: whether the motion is all that is wanted: efforts are left out.
        part: whether the source is one of several of a run, so that it need not hold a whole log.
    """

    topic: str | None = None
    joints: Sequence[str] | None = None
    currents: bool = False
    columns: Mapping[str, str] | None = None
    motion: bool = False
    part: bool = False


class Format(ABC):
    """A format of recordings.

    Attributes:
        name: for messages, as in "is a MATLAB file".
        magic: bytes with which its files begin.
        extensions: of its files, as in ".mat", where the first bytes do not decide.
        options: which of `topic`, `joints` and `columns` mean something to it.
        order: formats are asked in ascending order whether they recognise a file; 0 for those that look into it, 1 for
            those that go by its name, 2 for the one that takes any.
    """

    name: ClassVar[str]
    magic: ClassVar[tuple[bytes, ...]] = ()
    extensions: ClassVar[tuple[str, ...]] = ()
    options: ClassVar[frozenset[str]] = frozenset()
    order: ClassVar[int] = 0

    def recognises(self, path: Path, head: bytes) -> bool:
        """Whether a file or folder, `head` its first bytes, none of a folder, is of this format."""
        return head.startswith(self.magic) or path.suffix.lower() in self.extensions

    def check_options(self, options: Options, where: str) -> None:
        """Raises InputError where something is said of a file that has none of it; `where` is for messages."""
        for name in {"topic", "joints", "columns"} - self.options:
            if getattr(options, name) is not None:
                raise InputError(f"is {self.name}, which has no {name}", where, f"leave `{name}` out")

    def is_folder(self, path: Path) -> bool:
        """Whether a folder is one recording, so that the files in it are none."""
        return False

    @abstractmethod
    def read(self, path: Path, options: Options) -> Table:
        """The columns of a log.

        Raises:
            InputError: they are not there, or damaged, or which is meant stays open.
            OSError: the file cannot be opened.
        """


def refuse_foreign(path: Path, head: bytes) -> None:
    """Raises InputError for a file that holds no log which could be read here: what it is, and how to come to a log."""
    begin = head.removeprefix(b"\xef\xbb\xbf")  # a mark of UTF-8
    for begins, name, remedy in _FOREIGN:
        if re.match(begins, begin, re.DOTALL | re.IGNORECASE):
            raise InputError(f"is {name}", str(path), remedy)
