"""Files and folders that are whole or not there: written aside, then renamed into place.

An earlier folder is replaced only if it holds nothing but files that its writer names: other people's files are never
deleted. A process that is killed while it writes leaves a hidden folder or file beside the target (`.NAME-..`). Killed
between the two renames that replace a folder, it leaves the earlier one in there as `old`. Nothing repairs this later,
and nothing keeps two processes from replacing one target: the last one wins, as a whole.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Set
from contextlib import contextmanager
from pathlib import Path

from bayesid.errors import InputError
from bayesid.files.bounded import check_name


def replace_file(path: Path, write: Callable[[Path], object]) -> None:
    """Has `write` fill a file beside the target, then renames it; InputError where it cannot be written.

    Folders above it are made as needed.
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
    """The folder, if it may be replaced: it is new, empty, or an earlier one of its kind, and can be written.

    Args:
        folder: the place.
        files: names of the files that an earlier folder may hold.
        marker: the one of them by which an earlier folder is known.

    Raises:
        InputError: something else is there, or the place cannot be written.
    """
    folder = check_name(folder)
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
    """Has `write` fill a folder beside the target, then renames it; an error leaves everything as it was.

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
        aside = tempfile.TemporaryDirectory(prefix=f".{target.name}-", dir=target.parent, ignore_cleanup_errors=True)
        with aside as work:
            new, old = Path(work) / "new", Path(work) / "old"
            new.mkdir()
            write(new)
            check_folder(folder, files, marker)  # it may have taken long
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
