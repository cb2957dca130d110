"""What a format of recordings is. A new one is a file in this folder with a subclass of `Format`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from bayesid.log.formats.table import Table


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

    @property
    def choice(self) -> dict[str, Any]:
        """What `bayesid.log.formats.names.choose` is asked for."""
        return {"columns": self.columns, "motion": self.motion, "currents": self.currents, "part": self.part}


class Format(ABC):
    """A format of recordings.

    Attributes:
        name: for messages, as in "is a MATLAB file".
        magic: bytes with which its files begin.
        extensions: of its files, as in ".mat", where the first bytes do not decide.
        options: names of the fields of `Options` that mean something to it; `currents` may be ignored, `motion` means
            something to all.
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
