"""A planned motion as robot controllers read it: tables and programs, each at a tenth, a third and all of the speed.

`PlannedMotion` says what is to be run, `save_programs` writes it; a module for each maker's language. A program is text
of the motion alone: nothing here looks at limits or collisions, so each says in its head what its caller has checked.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bayesid.errors import InputError
from bayesid.excitation.next_motion import SPEEDS
from bayesid.export.controllers.kuka import krl_program, rsi_table
from bayesid.export.controllers.planned import PlannedMotion
from bayesid.export.controllers.ros import joint_trajectory
from bayesid.export.controllers.universal_robots import urscript
from bayesid.files.tables import write_motion

__all__ = ["PROGRAM_FILES", "PROGRAM_FOLDERS", "PlannedMotion", "Programs", "check_programs", "save_programs"]

_TABLE = "motion.csv"
_WRITERS: Mapping[str, Callable[[PlannedMotion], str]] = {
    "joint_trajectory.yaml": joint_trajectory,
    "motion.script": urscript,
    "motion.src": krl_program,
    "rsi.csv": rsi_table,
}
PROGRAM_FILES = frozenset({_TABLE, *_WRITERS})
"""What a folder of a speed may hold."""


def speed_folder(share: float) -> str:
    """The name of a speed's folder, as speed_30."""
    return f"speed_{100.0 * share:.0f}"


PROGRAM_FOLDERS = frozenset(map(speed_folder, SPEEDS))
"""What `save_programs` makes in a folder, for `bayesid.files.writing.save_folder`."""


@dataclass(frozen=True)
class Programs:
    """What `save_programs` has written.

    Attributes:
        folders: one a speed, the slowest first.
        files: names of the files in each of them.
        left_out: names of the files that this robot cannot have, and why.
    """

    folders: tuple[Path, ...]
    files: tuple[str, ...]
    left_out: Mapping[str, str]


def save_programs(planned: PlannedMotion, place: Path, shares: Sequence[float] = SPEEDS) -> Programs:
    """Writes speed_10, speed_30 and speed_100 with the motion as a table and as programs of controllers.

    Args:
        planned: the motion at its full speed.
        place: a folder that is there, as `save_folder` gives it.
        shares: of the planned speed, each of which gets a folder.
    """
    left_out, files = {}, [_TABLE]
    folders = tuple(place / speed_folder(share) for share in shares)
    motions = [planned.slowed(share) for share in shares]
    for folder, motion in zip(folders, motions, strict=True):
        folder.mkdir()
        write_motion(folder / _TABLE, motion.sampled())
    for name, text in _WRITERS.items():
        try:
            texts = [text(motion) for motion in motions]
        except InputError as error:
            left_out[name] = str(error)
            continue
        files.append(name)
        for folder, content in zip(folders, texts, strict=True):
            (folder / name).write_text(content, encoding="ascii", newline="\n")
    return Programs(folders, tuple(sorted(files)), left_out)


def check_programs(folder: Path) -> None:
    """Checks that the folders of speeds in an earlier folder hold nothing but programs, so that they may be replaced.

    Raises:
        InputError: they hold something else.
    """
    for name in sorted(PROGRAM_FOLDERS):
        inside = folder / name
        foreign = {path.name for path in inside.iterdir()} - PROGRAM_FILES if inside.is_dir() else set()
        if foreign:
            raise InputError(f"holds other files ({min(foreign)})", str(inside), "give `folder` a new folder")
