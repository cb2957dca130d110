"""Files and folders that are whole or not there: written aside, then renamed into place.

An earlier folder is replaced only if it holds nothing but files that its writer names: other people's files are never
deleted.
"""

from __future__ import annotations

import csv
import ctypes
import glob
import io
import json
import os
import re
import shutil
import socket
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TextIO

import numpy as np

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.files.bounded import check_name
from bayesid.motion import Motion
from bayesid.parallel import in_parallel

_AT_PATH, _EXCHANGE = -100, 2
"""AT_FDCWD and RENAME_EXCHANGE of Linux (linux/fcntl.h, linux/fs.h); RENAME_SWAP of macOS is 2 too (sys/stdio.h)."""
_OWNER = re.compile(r"-(\d+)(?:-\w+)?$")
"""At the end of the name of what is written aside: the process that writes it."""
_HERE = re.sub(r"\W", "_", socket.gethostname())
"""Part of such names: a process of another machine, which shares the folder, is not ours to judge."""

_BLOCK = 10_000
"""Rows that are made at once of a table that is written: it costs memory alone."""
_TOGETHER = 8
"""Such blocks that processors make together, some 20 MB of text. A round number."""


def replace_file(path: Path, write: Callable[[Path], object]) -> None:
    """Has `write` fill a file beside the target, then renames it; folders above it are made as needed."""
    aside = path.with_name(f"{_aside(path)}{os.getpid()}")
    with _input_error(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        tidy(path)
        try:
            write(aside)
            aside.replace(path)
        finally:
            aside.unlink(missing_ok=True)


def _aside(path: Path) -> str:
    return f".{path.name}-{_HERE}-"


def tidy(path: Path) -> None:
    """Removes what killed processes of this machine have left beside a path.

    An earlier folder that one of them had put aside, to put its own there, is put back.
    """
    if not path.parent.is_dir() or os.name != "posix":  # elsewhere no signal asks whether a process lives
        return
    for left in path.parent.glob(f"{glob.escape(_aside(path))}*"):
        owner = _OWNER.search(left.name)
        if owner is None or _lives(int(owner[1])):
            continue
        if (left / "old").is_dir() and not path.exists():
            (left / "old").rename(path)
        if left.is_dir():
            shutil.rmtree(left, ignore_errors=True)
        else:
            left.unlink(missing_ok=True)


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True


def save_table(path: Path, rows: Sequence[dict[str, object]]) -> None:
    """`write_table`, aside first and then renamed.

    Raises:
        InputError: the file cannot be written.
    """
    replace_file(path, lambda aside: write_table(aside, rows))


def check_folder(folder: str | Path, files: Set[str], marker: str) -> Path:
    """The folder, if it may be replaced: it is new, empty, or an earlier one of its kind, and can be written.

    Args:
        folder: the place.
        files: names of the files that an earlier folder may hold.
        marker: the one of them by which an earlier folder is known.

    Raises:
        InputError: something else is there, or the place cannot be written.
    """
    folder = check_name(folder)
    tidy(folder.resolve())
    for name in files:
        tidy(folder.resolve() / name)
    remedy = "give `folder` a new folder"
    if folder.is_dir():
        names = {path.name for path in folder.iterdir()}
        foreign = names if marker not in names else names - files
        if foreign:
            raise InputError(f"holds other files ({min(foreign)})", str(folder), remedy)
        if Path.cwd().is_relative_to(folder.resolve()):
            raise InputError("is the folder you are in", str(folder), remedy)
    elif folder.exists():
        raise InputError("is not a folder", str(folder), remedy)
    check_place(folder)
    return folder


def check_place(path: Path) -> None:
    """Checks that something new can be put at a path, folders above it made as needed.

    Raises:
        InputError: it cannot.
    """
    above = next(parent for parent in check_name(path).absolute().parents if parent.exists())
    if not above.is_dir() or not os.access(above, os.W_OK | os.X_OK):
        said = f"cannot be written ({above} is {'write-protected' if above.is_dir() else 'not a folder'})"
        raise InputError(said, str(path), "give `folder` another place")


def save_folder(folder: str | Path, files: Set[str], marker: str, write: Callable[[Path], None]) -> Path:
    """Has `write` fill a folder beside the target, then renames it; whatever goes wrong, nothing is left behind.

    Args:
        folder: the place; a link stays a link.
        files: names of the files that an earlier folder may hold.
        marker: the one of them by which an earlier folder is known.
        write: is given the folder to fill.

    Raises:
        InputError: the folder cannot be written, or holds other files than an earlier one of its kind.
    """
    folder = check_folder(folder, files, marker)
    target = folder.resolve()
    with _input_error(folder):
        target.parent.mkdir(parents=True, exist_ok=True)
        prefix = f"{_aside(target)}{os.getpid()}-"
        with tempfile.TemporaryDirectory(prefix=prefix, dir=target.parent, ignore_cleanup_errors=True) as work:
            new = Path(work) / "new"
            new.mkdir()
            write(new)
            check_folder(folder, files, marker)  # it may have taken long
            _put(new, target, Path(work) / "old")
    return folder


def _put(new: Path, target: Path, old: Path) -> None:
    """The new folder takes the target's place.

    Where the system exchanges names, one or the other is always there; else a kill between two renames leaves the
    earlier one aside, from where `tidy` puts it back.
    """
    if target.exists() and _exchanged(new, target):
        return
    if target.exists():
        target.rename(old)
    try:
        new.rename(target)
    except BaseException:
        if old.exists():
            old.rename(target)
        raise


def _exchanged(one: Path, other: Path) -> bool:
    """Whether two names were exchanged in one step, which Linux and macOS can on most file systems."""
    try:
        library = ctypes.CDLL(None, use_errno=True)
        if sys.platform == "darwin":
            failed = library.renamex_np(os.fsencode(one), os.fsencode(other), _EXCHANGE)
        else:
            failed = library.renameat2(_AT_PATH, os.fsencode(one), _AT_PATH, os.fsencode(other), _EXCHANGE)
    except (AttributeError, OSError, TypeError):  # no such function, or no such library
        return False
    return not failed


@contextmanager
def reserved(path: Path) -> Iterator[None]:
    """Keeps a place for one process of this system, for as long as the block runs or the process lives.

    Where the system has no file locks, as Windows, nothing is kept.

    Raises:
        InputError: another process is at work there, or the place cannot be written.
    """
    check_place(path)
    if fcntl is None:
        yield
        return
    target = path.resolve()
    above = next(parent for parent in target.parents if parent.exists())
    lock = above / f".{'-'.join(target.relative_to(above).parts)}-lock"
    with _locked(lock, path) as file:
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
        try:
            yield
        finally:
            lock.unlink(missing_ok=True)


def _locked(lock: Path, path: Path) -> TextIO:
    """The lock's file, held; the system lets go of it when its process ends, however it ends."""
    while True:
        with _input_error(path):
            file = lock.open("a+", encoding="utf-8")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if lock.exists() and os.path.samestat(lock.stat(), os.fstat(file.fileno())):
                return file  # else it is that of a run that has just ended
            file.close()
        except BlockingIOError:
            file.seek(0)
            owner = file.read() or "unknown"
            file.close()
            remedy = "wait for its end, or give `folder` another place"
            raise InputError(f"another run is writing there (process {owner})", str(path), remedy) from None


@contextmanager
def _input_error(path: Path) -> Iterator[None]:
    """Turns what the system says into an `InputError`."""
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", str(path), "give `folder` another place") from None


def write_json(path: Path, content: dict[str, Any] | list[dict[str, Any]]) -> None:
    """Writes a dictionary, or several, as JSON, infinity as null."""
    path.write_text(json.dumps(plain(content), indent=2) + "\n", encoding="utf-8")


def write_rows(path: Path, header: Sequence[str], rows: Iterable[Iterable[object]]) -> None:
    """Writes a CSV file; floats to their last digit, unless they come as text."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def write_table(path: Path, rows: Sequence[dict[str, object]]) -> None:
    """Writes a CSV file, one column a key; floats to nine digits."""
    write_rows(path, list(rows[0]), ([_text(row[key]) for key in rows[0]] for row in rows))


def _text(value: object) -> object:
    return f"{value:.9g}" if isinstance(value, float) else value


def write_motion(path: Path, motion: Motion) -> None:
    """t, q1..qn, dq1..dqn, ddq1..ddqn: s, rad, rad/s, rad/s^2 (m of prismatic joints), to nine decimals."""
    names = ["t", *(name for prefix in ("q", "dq", "ddq") for name in numbered(prefix, motion.n_joints))]
    values = np.round(np.column_stack([motion.t, motion.q, motion.dq, motion.ddq]), 9) + 0.0  # no -0
    write_rows(path, names, ([f"{t:.9g}", *(f"{value:.9f}" for value in row)] for t, *row in values.tolist()))


def write_columns(
    path: Path,
    names: Sequence[str],
    t: Array,
    values: Array | Callable[[slice], Array],
    digits: str = "",
    sources: Sequence[str] | None = None,
) -> None:
    """Writes columns over time as CSV, in bounded memory.

    Args:
        path: the file.
        names: of t and of the k columns.
        t: (N,) time; to the last digit, as it may count from 1970.
        values: (N, k), or what gives those of some rows.
        digits: format of the values; to the last digit by default.
        sources: (N,) the log that each row is of, in a last column; none by default.
    """

    def text(start: int) -> str:
        some = slice(start, start + _BLOCK)
        block = (values(some) if callable(values) else values[some]).tolist()
        last: list[list[str]] = [[]] * len(block) if sources is None else [[source] for source in sources[some]]
        lines = io.StringIO(newline="")
        csv.writer(lines, lineterminator="\n").writerows(
            [time, *([format(value, digits) for value in row] if digits else row), *log]
            for time, row, log in zip(t[some].tolist(), block, last, strict=True)
        )
        return lines.getvalue()

    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerow([*names, *([] if sources is None else ["log"])])
        for first in range(0, len(t), _TOGETHER * _BLOCK):
            starts = range(first, min(first + _TOGETHER * _BLOCK, len(t)), _BLOCK)
            file.writelines(in_parallel([partial(text, start) for start in starts]))


def numbered(prefix: str, n: int) -> list[str]:
    """Names of the columns of n joints."""
    return [f"{prefix}{j}" for j in range(1, n + 1)]


def plain(value: Any) -> Any:
    """A value as JSON can hold it; it has no infinity, and null stands for it."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value
