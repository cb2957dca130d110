"""Files that are something else than a log: what they are by their first bytes, and how to come to a log."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple, NoReturn

from bayesid.errors import InputError
from bayesid.log.formats.base import Format, Options


class _Kind(NamedTuple):
    """A kind of file: what its first bytes look like, what it is, and what to do; {} stands for the file."""

    begins: re.Pattern[bytes]
    name: str
    remedy: str


def _kind(begins: bytes, name: str, remedy: str) -> _Kind:
    return _Kind(re.compile(begins, re.DOTALL | re.IGNORECASE), name, remedy)


_UNPACK = "unpack it, and give the log inside"
_TABLE = "write its columns as CSV, or give it from Python: bayesid.read_log(pandas.{}(FILE{}))"
_SHEET = "save the sheet with the log as CSV"
_KINDS = (
    _kind(rb"\s*\{[^\n]*\}\s*\n\s*\{", "lines of JSON", _TABLE.format("read_json", ", lines=True")),
    _kind(rb"\s*(\{\s*[\"}]|\[\s*[\[{\"\d-])", "JSON", _TABLE.format("read_json", "")),
    _kind(rb"\s*<(!doctype html|html|head|body)", "a web page (HTML), no table of numbers", "save the table as CSV"),
    _kind(rb"\s*<[!?a-z]", "XML", _TABLE.format("read_xml", "")),
    _kind(rb"PK.{2,8192}(xl/|\[Content_Types\]\.xml)", "an Excel workbook", _SHEET),
    _kind(rb"PK.{2,8192}content\.xml", "an OpenDocument spreadsheet", _SHEET),
    _kind(rb"\xd0\xcf\x11\xe0", "an old Excel workbook", _SHEET),
    _kind(rb"PK.{2,8192}\.npy", "an archive of NumPy", "give it from Python: bayesid.read_log(dict(numpy.load(FILE)))"),
    _kind(
        rb"\x93NUMPY",
        "an array of NumPy",
        "give it from Python, with names: bayesid.read_log({'t': .., 'q': .., 'tau': ..})",
    ),
    _kind(rb"PK\x03\x04", "a zip archive", _UNPACK),
    _kind(rb"\x1f\x8b|BZh\d|\xfd7zXZ|\x28\xb5\x2f\xfd|7z\xbc\xaf", "compressed", _UNPACK),
    _kind(rb"#ROSBAG V", "a bag of ROS 1", "convert it: rosbags-convert --src FILE --dst FOLDER"),
    _kind(
        rb"\x89HDF",
        "an HDF5 file, but none of MATLAB",
        "give its arrays from Python: bayesid.read_log({'t': .., 'q': .., 'tau': ..})",
    ),
    _kind(
        rb"DIAEXTENDED",
        "a header of DIAdem, as KUKA's trace writes it beside its .r64",
        "export the trace as a table of text (WorkVisual); a file a joint is given as 'trace_*.csv+'",
    ),
    _kind(rb"TDSm|MDF {5}|UnFinMF", "a measurement file (TDMS or MDF)", "export its channels as CSV"),
    _kind(rb"%PDF|\x89PNG|\xff\xd8\xff", "a document or a picture", "give the log that it shows"),
)


class ForeignFile(Format):
    """What is known to hold no log that could be read here."""

    name = "another format"
    options = frozenset({"topic", "joints", "columns"})

    def recognises(self, path: Path, head: bytes) -> bool:
        """Whether it begins as one of them."""
        return not path.is_dir() and path.suffix.lower() != ".mat" and _kind_of(head) is not None

    def read(self, path: Path, options: Options) -> NoReturn:
        """Says what it is.

        Raises:
            InputError: always.
        """
        with path.open("rb") as file:
            kind = _kind_of(file.read(65536))
        assert kind is not None, "it was recognised"
        raise InputError(f"is {kind.name}", str(path), kind.remedy)


def _kind_of(head: bytes) -> _Kind | None:
    """What a file is by its first bytes; a mark of UTF-8 before them does not matter."""
    begin = head.removeprefix(b"\xef\xbb\xbf")
    return next((kind for kind in _KINDS if kind.begins.match(begin)), None)
