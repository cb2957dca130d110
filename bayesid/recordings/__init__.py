"""Recordings: files of many formats, each read into one table of a log's columns.

A reader a format (`text`, `kuka`, `parquet`, `matlab`, `ros`) turns a file into a `Table` and says what the file lacks;
which reader it is, the first bytes of the file decide. What a number must be is checked here, once for all of them;
what the numbers mean for an identification is `bayesid.log`'s business.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bayesid.errors import InputError
from bayesid.recordings import matlab, parquet, ros, text
from bayesid.recordings.table import Column, Table, check

__all__ = ["Column", "Table", "is_bag", "read_table"]

_PARQUET = b"PAR1"
_MATLAB = (b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file")
_BAGS = (b"\x89MCAP0\r\n", b"SQLite format 3\0")
_LONGEST = max(map(len, (_PARQUET, *_MATLAB, *_BAGS)))


def read_table(
    path: Path, *, topic: str | None = None, joints: Sequence[str] | None = None, currents: bool = False
) -> Table:
    """What a file holds of a log, its numbers checked.

    Args:
        path: a file, or the folder of a ROS 2 bag.
        topic: of a bag with joint states of several topics.
        joints: names of a bag's joints, from base to tip; all of them, in the order of the messages, when None.
        currents: whether efforts that a bag holds are currents, A.

    Raises:
        InputError: there is no such file, or it cannot be used.
    """
    try:
        head = b"" if is_bag(path) else _head(path)
        if is_bag(path) or head.startswith(_BAGS):
            return check(ros.read(path, topic, joints, currents))
        if topic is not None or joints is not None:
            said = "is no bag: it has neither topics nor joints with names"
            raise InputError(said, str(path), "leave --topic and --joints out")
        if head.startswith(_PARQUET):
            return check(parquet.read(path))
        if head.startswith(_MATLAB) or path.suffix.lower() == ".mat":
            return check(matlab.read(path))
        return check(text.read(path))
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
        if any(path.glob("*.mcap")) or any(path.glob("*.db3")):
            remedy = "run `ros2 bag reindex` on it, or give the file inside"
            raise InputError("is a bag without its metadata.yaml", str(path), remedy) from None
        raise InputError("no such file", str(path), "give the path of a log") from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", str(path), "check the file") from None


def is_bag(path: Path) -> bool:
    """Whether a folder is a ROS 2 bag."""
    return (path / "metadata.yaml").is_file()


def _head(path: Path) -> bytes:
    """The first bytes of a file."""
    with path.open("rb") as file:
        return file.read(_LONGEST)
