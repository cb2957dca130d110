"""Atomic writing of files and folders: written under a temporary name, then renamed.

An earlier folder is replaced only if it holds no other files. A killed process leaves a hidden folder or file
(`.NAME-..`), which may hold the earlier folder as `old`. If two processes write the same target, the last one wins.
"""

from __future__ import annotations

import csv
import json
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError, printable
from bayesid.files.bounded import check_name
from bayesid.motion import Motion


def replace_file(path: Path, write: Callable[[Path], object]) -> None:
    """Calls `write` on a temporary file, then renames it; InputError if it cannot be written.

    Parent folders are created.
    """
    aside = path.with_name(f".{path.name}-{os.getpid()}")
    with _input_error(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            write(aside)
            aside.replace(path)
        finally:
            aside.unlink(missing_ok=True)


def check_folder(folder: str | Path, files: Set[str], marker: str) -> Path:
    """The folder, if it can be written and is new, empty or an earlier result; else an InputError.

    An earlier result holds its marker file, and only the named files.
    """
    folder = check_name(folder)
    remedy = "give `folder` a new folder"
    if folder.is_dir():
        names = {path.name for path in folder.iterdir()}
        foreign = names if marker not in names else names - files
        if foreign:
            raise InputError(f"holds other files ({min(foreign)})", str(folder), remedy)
        if Path.cwd().is_relative_to(folder.resolve()):
            raise InputError("is the working folder", str(folder), remedy)
    elif folder.exists():
        raise InputError("is not a folder", str(folder), remedy)
    check_place(folder)
    return folder


def check_place(path: Path) -> None:
    """Raises InputError unless a path can be created, with parent folders."""
    above = next(parent for parent in check_name(path).absolute().parents if parent.exists())
    if not above.is_dir() or not os.access(above, os.W_OK | os.X_OK):
        what = f"cannot be written ({above} is {'write-protected' if above.is_dir() else 'not a folder'})"
        raise InputError(what, str(path), "give `folder` another place")


def save_folder(folder: str | Path, files: Set[str], marker: str, write: Callable[[Path], None]) -> Path:
    """Calls `write` on a temporary folder, then renames it; an error changes nothing.

    `check_folder` checks that the earlier folder may be replaced. Symbolic links are kept.
    """
    folder = check_folder(folder, files, marker)
    target = folder.resolve()
    with _input_error(folder):
        target.parent.mkdir(parents=True, exist_ok=True)
        aside = tempfile.TemporaryDirectory(prefix=f".{target.name}-", dir=target.parent, ignore_cleanup_errors=True)
        with aside as work:
            new, old = Path(work) / "new", Path(work) / "old"
            new.mkdir()
            write(new)
            check_folder(folder, files, marker)  # again, since writing may take long
            if target.exists():
                target.rename(old)
            try:
                new.rename(target)
            except BaseException:
                if old.exists():
                    old.rename(target)
                raise
    return folder


@contextmanager
def _input_error(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", str(path), "give `folder` another place") from None


Kind = TypeVar("Kind")


def write_rows(path: Path, header: Sequence[str], rows: Iterable[Iterable[object]]) -> None:
    """Writes a CSV file; floats with all digits."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def write_table(path: Path, rows: Sequence[dict[str, object]]) -> None:
    """Writes a CSV file, one column per key; floats to nine digits."""
    table = ([row[key] for key in rows[0]] for row in rows)
    texts = ([f"{value:.9g}" if isinstance(value, float) else value for value in row] for row in table)
    write_rows(path, list(rows[0]), texts)


def save_table(path: Path, rows: Sequence[dict[str, object]]) -> None:
    """`write_table`, atomically; InputError if it cannot be written."""
    replace_file(path, lambda aside: write_table(aside, rows))


def write_columns(
    path: Path,
    names: Sequence[str],
    t: Array,
    values: Array | Callable[[slice], Array],
    digits: str = "",
    sources: Sequence[str] | None = None,
) -> None:
    """Writes time (N,) and values (N, k) as CSV, in bounded memory; time with all digits.

    `values` may be a function of a slice of rows; their format is `digits`, all digits by default. `sources` (N,) is a
    last column with the log of each row.
    """

    def rows() -> Iterable[list[object]]:
        at_once = 10_000  # rows that are in memory as text
        for start in range(0, len(t), at_once):
            some = slice(start, start + at_once)
            block = (values(some) if callable(values) else values[some]).tolist()
            logs = [[]] * len(block) if sources is None else [[source] for source in sources[some]]
            for time, row, log in zip(t[some].tolist(), block, logs, strict=True):
                yield [time, *([format(value, digits) for value in row] if digits else row), *log]

    write_rows(path, [*names, *([] if sources is None else ["log"])], rows())


def write_motion(path: Path, motion: Motion) -> None:
    """t, q1..qn, dq1..dqn, ddq1..ddqn: s, rad, rad/s, rad/s^2 (m of prismatic joints), to nine decimals."""
    names = ["t", *(name for prefix in ("q", "dq", "ddq") for name in numbered(prefix, motion.n_joints))]
    values = np.round(np.column_stack([motion.t, motion.q, motion.dq, motion.ddq]), 9) + 0.0  # no -0
    write_rows(path, names, ([f"{t:.9g}", *(f"{value:.9f}" for value in row)] for t, *row in values.tolist()))


def numbered(prefix: str, n: int) -> list[str]:
    """Names of the columns of n joints."""
    return [f"{prefix}{j}" for j in range(1, n + 1)]


def write_json(path: Path, content: dict[str, Any] | list[dict[str, Any]]) -> None:
    """Writes JSON; non-finite numbers become null."""
    path.write_text(json.dumps(plain(content), indent=2) + "\n", encoding="utf-8")


def plain(value: Any) -> Any:
    """A value for JSON; non-finite numbers become None."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


def typed(content: Any, kind: type[Kind]) -> Kind:
    """JSON content as a type of msgspec, without unknown keys; ValueError if it does not fit."""
    return msgspec.convert(content, kind)


def read_json(path: Path, kind: type[Kind], remedy: str) -> Kind:
    """The content of a JSON file of bayesid, as `typed` gives it; InputError if it does not fit."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except (OSError, RecursionError, ValueError) as error:  # msgspec's errors are ValueErrors
        reason = " ".join(printable(str(error)).split())
        raise InputError(f"is not a file of bayesid ({reason})", str(path), remedy) from None
